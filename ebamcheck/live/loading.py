"""A finished run made ready for work between its layers: part, settings, plan and times."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.checks.metal_rules import MetalBelow
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.live.metal_so_far import MetalSoFar
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Floats
from ebamcheck.pipeline.placement import placed_part
from ebamcheck.record.run_folder import MANIFEST, RunFolder
from ebamcheck.scan.plan.columns import PlanOfLayers
from ebamcheck.settings.config import Config, validated
from ebamcheck.verification.verify import part_of_run
from ebamcheck.writing.inputs import deposition_heights, layer_thickness


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A run whose program passed: its record, settings and part."""

    folder: RunFolder
    manifest: dict[str, Any]
    config: Config
    part: Part
    part_file: Path

    @property
    def primary(self) -> str:
        """Slicer whose contours became the program."""
        return str(self.manifest["primary"])

    @property
    def tops_mm(self) -> Floats:
        """(L,) Z of the top of each layer."""
        return deposition_heights(self.plan.heights, self.config.layer_height_mm, self.config.base_mm)

    @property
    def thickness_mm(self) -> Floats:
        """(L,) height of each layer."""
        return layer_thickness(self.tops_mm, self.config.base_mm)

    @cached_property
    def plan(self) -> PlanOfLayers:
        """What the run's scan plan knows of its layers."""
        return PlanOfLayers.from_parquet(self.folder.path / "scan.parquet")

    def busy_s(self) -> Floats:
        """(L, 2) time of each layer with the beam on, and with it off: travel, and the waits within the layer."""
        table = pd.read_csv(self.folder.path / "process.csv")
        before_s = np.nan_to_num(self.plan.metrics["wait_s"].to_numpy())
        off_s = table["travel_s"] + np.maximum(table["wait_s"] - before_s, 0.0)
        return np.column_stack([table["deposit_s"], off_s])

    def metal_under(self, layer: int) -> MetalSoFar | None:
        """Sums of the metal under a layer of the run; None where the run has no table of it."""
        table = self.folder.path / "deposit.csv"
        if not table.is_file():
            return None
        found = pd.read_csv(table).iloc[:layer]
        return MetalSoFar(MetalBelow().and_layers(found, self.config.process))

    def program_of(self, layer: int) -> dict[str, Any] | None:
        """Name and hash of the run's own program of a layer; None where all layers are in one file."""
        files = self.manifest["program"]["files"]
        return files[layer + 1] if layer + 1 < len(files) else None


def finished_run(
    folder: Path, part: Path | None = None, direction: tuple[float, ...] | None = None
) -> FinishedRun:
    """Load a finished run and its part.

    Raises
    ------
    InputError
        If it is no run folder, or has no program.
    SettingsError
        If the part is not found, or is not the one that the run was made of.
    """
    run = RunFolder(folder)
    manifest = run.manifest()
    if not manifest.get("program") or not (folder / "scan.parquet").is_file():
        raise InputError(f"{folder}: has no program: make it with `ebamcheck run`, not `check`")
    config = validated(manifest["settings"], f"{MANIFEST}: settings")
    if direction is not None:
        config = config.changed(part={"direction": direction})
    file = part or part_of_run(run, manifest)
    placed, _, _ = placed_part(file, config)
    if placed.source_sha256 != manifest["part"]["sha256"]:
        raise SettingsError(f"{file}: is not the part that {folder} was made of: its hash differs")
    return FinishedRun(run, manifest, config, placed, file)
