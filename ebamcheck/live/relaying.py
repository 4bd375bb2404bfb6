"""One layer of a finished run made again at a measured height."""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import dataclass
from itertools import count, takewhile
from pathlib import Path
from typing import Any

from ebamcheck.atomic_file import made_folder
from ebamcheck.errors import SettingsError
from ebamcheck.json_values import json_text
from ebamcheck.live.before import Before, Ground
from ebamcheck.live.height_map import MapCells, Refused
from ebamcheck.live.heights import height_rule
from ebamcheck.live.loading import FinishedRun
from ebamcheck.live.making import LayerMaker, MadeLayer, Wanted
from ebamcheck.live.publishing import (
    CERTIFICATE,
    JOURNAL,
    LAYERS,
    PROGRAM,
    certificate_of,
    layer_name,
    publish,
)
from ebamcheck.live.readings import Reading, check_height
from ebamcheck.mesh.on_table import on_table
from ebamcheck.nc.templates import checked_tilt
from ebamcheck.settings.config import Config
from ebamcheck.writing.blocks import BlockFormat
from ebamcheck.writing.table import tilt_of


@dataclass(frozen=True, eq=False)
class Relayered:
    """What came of it: the layer, its certificate, what was said of the heights, and where it lies; None: it was kept back."""

    made: MadeLayer
    certificate: dict[str, Any]
    said: tuple[str, ...]
    place: Path | None


def check_below(folder: Path, run: FinishedRun, layer: int, measured_mm: float) -> None:
    """Refuse a height that the layer below cannot have, by the rule of `live`.

    The newest of the layers below that `relayer` made in the folder stands for that of the run.
    """
    if layer == 0:
        base_mm, top_mm, by = -float(run.thickness_mm[0]), 0.0, "the base plate"
    else:
        top_mm = float(run.tops_mm[layer - 1])
        base_mm, by = top_mm - float(run.thickness_mm[layer - 1]), "the run"
        if made := _made_before(folder, run.config.machine.program_name, layer - 1):
            paper = json.loads((made[-1] / CERTIFICATE).read_text(encoding="utf-8"))
            base_mm, top_mm, by = float(paper["base_mm"]), float(paper["top_mm"]), made[-1].name
    try:
        check_height(Reading(layer, measured_mm), base_mm, top_mm)
    except Refused as fault:
        raise SettingsError(
            f"layer {layer + 1}: the measured height {measured_mm:g} mm cannot be: {fault}; what stands is planned to end at {top_mm:.3f} mm by {by}: measure it "
            "again; where layers below came out otherwise, make each of them by `relayer`, or lead the build by `live`"
        ) from None


def tilted(before: FinishedRun, now: FinishedRun, built_mm: float) -> Config:
    """Settings of a layer of a part that was built up to a height and is turned by the table; those given where the user turns it.

    Refused is a control without frames, and a direction into which the table cannot turn the part.
    """
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
    places = (folder / LAYERS / layer_name(program, layer, number) for number in count(1))
    return [*takewhile(Path.exists, places)]


def relayer(
    maker: LayerMaker,
    before: Before,
    layer: int,
    measured_mm: float,
    folder: Path,
    cells: MapCells | None = None,
) -> Relayered:
    """Make a layer at a measured height, and publish it under a new name in `folder` if every gate is open.

    Of a map, `cells`, of which `measured_mm` is the mean, as much is mended as can be proved.
    """
    program = maker.config.machine.program_name
    made_folder(folder)
    if (folder / JOURNAL).is_file():
        raise SettingsError(
            f"{folder}: is the folder of a build, whose own layers would come to the same names: give another with -o"
        )
    plan = height_rule(maker.part, maker.config).plan(measured_mm)
    if not len(plan):
        said = f": {plan.said[0]}" if plan.said else ""
        raise SettingsError(
            f"--measured-z {measured_mm:g}: the part is {maker.height_mm:.3f} mm high, nothing is left to be laid{said}"
        )
    # As high as it has to be for the rest to end at the part's top.
    name = layer_name(program, layer, len(_made_before(folder, program, layer)) + 1)
    wanted = Wanted(layer, measured_mm, float(plan.thickness_mm[0]), name)
    reading = Reading(layer, measured_mm) if cells is None else Reading.of_map(layer, measured_mm, cells)
    ground = Ground.of(reading, before, maker.config)
    for share in ground.mending:
        staged = Path(tempfile.mkdtemp(prefix=".making.", dir=folder))
        try:
            made = maker.make(wanted, ground.mended(share), staged / PROGRAM)
            certificate = certificate_of(made, maker, ground.told(share))
            if made.passed:
                publish(folder, made, certificate)
                return Relayered(made, certificate, plan.said, folder / LAYERS / wanted.name)
        finally:
            shutil.rmtree(staged, ignore_errors=True)
    (folder / f"{wanted.name}.refused.json").write_text(json_text(certificate), encoding="utf-8")
    return Relayered(made, certificate, plan.said, None)
