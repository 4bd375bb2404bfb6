"""A finished run made ready for work between its layers, and one of its layers made again at a measured height."""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count, takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.atomic_file import made_folder
from ebamcheck.checks.metal_rules import MetalBelow
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.heat.balance import HeatColumn, LayerShape
from ebamcheck.heat.part_heat import PartHeat
from ebamcheck.heat.preheating import preheated
from ebamcheck.json_values import json_text
from ebamcheck.kernels import Floats
from ebamcheck.live import publishing
from ebamcheck.live.before import Before, Ground
from ebamcheck.live.height_map import MapCells, Reading, Refused, check_height
from ebamcheck.live.heights import height_rule
from ebamcheck.live.making import LayerMaker, MadeLayer, Wanted
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import on_table, read_part
from ebamcheck.nc.inputs import deposition_heights, layer_thickness
from ebamcheck.nc.templates import checked_tilt
from ebamcheck.record.run_folder import MANIFEST, RunFolder
from ebamcheck.scan.plan.columns import PlanOfLayers
from ebamcheck.settings.config import Config, validated
from ebamcheck.verification.verify import part_of_run
from ebamcheck.writing.blocks import BlockFormat
from ebamcheck.writing.table import tilt_of


@dataclass(frozen=True, eq=False)
class Relayered:
    """What came of a layer that was made again."""

    made: MadeLayer
    certificate: dict[str, Any]
    said: tuple[str, ...]  # of the heights
    place: Path | None  # where it lies; None: it was kept back


def check_below(folder: Path, run: FinishedRun, layer: int, measured_mm: float) -> None:
    """Refuse a height that the layer below, by `relayer` in the folder or by the run, cannot have by the rule of `live`."""
    if layer == 0:
        base_mm, top_mm, by = -float(run.thickness_mm[0]), 0.0, "the base plate"
    else:
        top_mm = float(run.tops_mm[layer - 1])
        base_mm, by = top_mm - float(run.thickness_mm[layer - 1]), "the run"
        if made := _made_before(folder, run.config.machine.program_name, layer - 1):
            paper = json.loads((made[-1] / publishing.CERTIFICATE).read_text(encoding="utf-8"))
            base_mm, top_mm, by = float(paper["base_mm"]), float(paper["top_mm"]), made[-1].name
    try:
        check_height(Reading(layer, measured_mm), base_mm, top_mm)
    except Refused as fault:
        said = f"layer {layer + 1}: the measured height {measured_mm:g} mm cannot be: {fault}"
        plan = f"what stands is planned to end at {top_mm:.3f} mm by {by}: measure it again"
        how = "where layers below came out otherwise, make each of them by `relayer`, or lead the build by `live`"
        raise SettingsError(f"{said}; {plan}; {how}") from None


def tilted(before: FinishedRun, now: FinishedRun, built_mm: float) -> Config:
    """Settings of a layer of a part that was built up to a height and is turned by the table, if that can; those given where the
    user turns it."""
    config, machine = now.config, now.config.machine
    if not machine.rotary:
        return config
    part = config.part.model_copy(update={"on_table": on_table(before.part, now.part, built_mm)})
    config = config.model_copy(update={"part": part})
    checked_tilt(config, machine.control)
    tilt_of(config, BlockFormat(machine.printed_decimals))
    return config


def _made_before(folder: Path, program: str, layer: int) -> list[Path]:
    """Folders of the layer of that number, the newest last."""
    names = (publishing.layer_name(program, layer, number) for number in count(1))
    return [*takewhile(Path.exists, (folder / publishing.LAYERS / name for name in names))]


def relayer(
    maker: LayerMaker,
    before: Before,
    layer: int,
    measured_mm: float,
    folder: Path,
    cells: MapCells | None = None,
) -> Relayered:
    """Make a layer at a measured height, the mean of a map if there are `cells`, and publish it under a new name if every gate is
    open."""
    program = maker.config.machine.program_name
    made_folder(folder)
    if (folder / publishing.JOURNAL).is_file():
        what = "is the folder of a build, whose own layers would come to the same names: give another with -o"
        raise SettingsError(f"{folder}: {what}")
    plan = height_rule(maker.part, maker.config).plan(measured_mm)
    if not len(plan):
        left = f"nothing is left to be laid{f': {plan.said[0]}' if plan.said else ''}"
        what = f"the part is {maker.height_mm:.3f} mm high, {left}"
        raise SettingsError(f"--measured-z {measured_mm:g}: {what}")
    # As high as it has to be for the rest to end at the part's top.
    name = publishing.layer_name(program, layer, len(_made_before(folder, program, layer)) + 1)
    wanted = Wanted(layer, measured_mm, float(plan.thickness_mm[0]), name)
    ground = Ground.of(Reading(layer, measured_mm, cells), before, maker.config)
    for share in ground.mending:
        staged = Path(tempfile.mkdtemp(prefix=".making.", dir=folder))
        try:
            made = maker.make(wanted, ground.mended(share), staged / publishing.PROGRAM)
            certificate = publishing.certificate_of(made, maker, ground.told(share))
            if made.passed:
                publishing.publish(folder, made, certificate)
                return Relayered(made, certificate, plan.said, folder / publishing.LAYERS / wanted.name)
        finally:
            shutil.rmtree(staged, ignore_errors=True)
    (folder / f"{wanted.name}.refused.json").write_text(json_text(certificate), encoding="utf-8")
    return Relayered(made, certificate, plan.said, None)


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
        """What stands under the layer of that index, as the run planned it: sums where it has a table, heat by the balance alone.

        What differs across a section decays while the next layer is laid; the mean stays.
        """
        found = Before(PartHeat(self._column_under(layer)))
        table = self.folder.path / "deposit.csv"
        if not table.is_file():
            return found
        laid = pd.read_csv(table).iloc[:layer]
        return replace(found, below=MetalBelow().and_layers(laid, self.config.process))

    def _column_under(self, layer: int) -> HeatColumn:
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
        scans = plan.metrics.get("preheat_passes", pd.Series(np.zeros(len(wait_s)))).to_numpy()
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


def finished_run(folder: Path, part: Path | None = None, direction: tuple[float, ...] | None = None) -> FinishedRun:
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
