"""A finished run made ready for work between its layers: part, settings, plan and times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.checks.metal_rules import MetalBelow
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.heat.balance import HeatColumn, LayerShape
from ebamcheck.heat.part_heat import PartHeat
from ebamcheck.live.before import Before
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import read_part
from ebamcheck.nc.inputs import deposition_heights, layer_thickness
from ebamcheck.numeric.rings import Floats
from ebamcheck.record.run_folder import MANIFEST, RunFolder
from ebamcheck.scan.plan.columns import PlanOfLayers
from ebamcheck.scan.plan.preheated import preheated
from ebamcheck.settings.config import Config, validated
from ebamcheck.verification.verify import part_of_run


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

    def before(self, layer: int) -> Before:
        """What stands under the layer of that index, laid as the run planned it: heat by the balance alone, sums where it has a table.

        What differs across a section decays while the next layer is laid; the mean stays. An order that begins on it knows
        the mean of the whole body, and what differs from the layer on which it works.
        """
        found = Before(PartHeat(self._column_under(layer)))
        table = self.folder.path / "deposit.csv"
        if not table.is_file():
            return found
        laid = pd.read_csv(table).iloc[:layer]
        return replace(found, below=MetalBelow().and_layers(laid, self.config.process))

    def _column_under(self, layer: int) -> HeatColumn:
        """Balance of the heat of the layers under one, by sections, waits and power of the plan."""
        config, plan, thickness_mm = self.config, self.plan, self.thickness_mm
        column = HeatColumn(config)
        if plan.sections is None:
            return column
        wait_s, share = (np.nan_to_num(plan.metrics[name].to_numpy()) for name in ("wait_s", "power_share"))
        share = np.where(share > 0.0, share, 1.0)
        table = pd.read_csv(self.folder.path / "process.csv")
        on_s = table["deposit_s"].to_numpy()
        # With the beam off: travel, and the waits within the layer.
        off_s = (table["travel_s"] + np.maximum(table["wait_s"] - wait_s, 0.0)).to_numpy()
        full_w = config.process.power_w * config.material.absorptivity
        none = np.zeros(len(wait_s))
        scans = plan.metrics["preheat_passes"].to_numpy() if "preheat_passes" in plan.metrics else none
        sections, z_mm = list(plan.sections), np.concatenate([[0.0], np.cumsum(thickness_mm)])
        for k in range(layer):
            shape = LayerShape.of(plan.sections[k], float(thickness_mm[k]))
            if shape.area_mm2 <= 0.0:
                continue
            if scans[k] > 0:
                column = preheated(PartHeat(column), sections, k, float(z_mm[k]), config)[0].column
            column.advance(float(wait_s[k]))
            column.lay(shape)
            column.advance(float(on_s[k] + off_s[k]), float(on_s[k] * share[k]) * full_w)
        return column

    def program_of(self, layer: int) -> dict[str, Any] | None:
        """Name and hash of the run's own program of a layer; None where all layers are in one file."""
        files = self.manifest["program"]["files"]
        return files[layer + 1] if layer + 1 < len(files) else None


def finished_run(
    folder: Path, part: Path | None = None, direction: tuple[float, ...] | None = None
) -> FinishedRun:
    """Load a finished run and its part; refused is a run without a program, and a part of which it was not made."""
    run = RunFolder(folder)
    manifest = run.manifest()
    if not manifest.get("program") or not (folder / "scan.parquet").is_file():
        raise InputError(f"{folder}: has no program: make it with `ebamcheck run`, not `check`")
    config = validated(manifest["settings"], f"{MANIFEST}: settings")
    if direction is not None:
        config = config.changed(part={"direction": direction})
    file = part or part_of_run(run, manifest)
    placed, _ = read_part(file, config.part)
    if placed.source_sha256 != manifest["part"]["sha256"]:
        raise SettingsError(f"{file}: is not the part that {folder} was made of: its hash differs")
    return FinishedRun(run, manifest, config, placed, file)
