"""One layer of a finished run made again at a measured height."""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ebamcheck.atomic_file import made_folder
from ebamcheck.errors import SettingsError
from ebamcheck.json_values import json_text
from ebamcheck.live.ground import Ground
from ebamcheck.live.heat_so_far import HeatSoFar
from ebamcheck.live.height_map import MapCells
from ebamcheck.live.heights import height_rule
from ebamcheck.live.making import LayerMaker, MadeLayer, Wanted
from ebamcheck.live.metal_so_far import MetalSoFar
from ebamcheck.live.publishing import (
    CERTIFICATE,
    JOURNAL,
    LAYERS,
    PROGRAM,
    certificate_of,
    layer_name,
    publish,
)
from ebamcheck.live.readings import Reading, fault_of
from ebamcheck.numeric.rings import Floats


@dataclass(frozen=True, eq=False)
class Relayered:
    """What came of it: the layer, its certificate, what was said of the heights, and where it lies; None: it was kept back."""

    made: MadeLayer
    certificate: dict[str, Any]
    said: tuple[str, ...]
    place: Path | None


def wanted_layer(
    maker: LayerMaker, layer: int, measured_mm: float, name: str
) -> tuple[Wanted, tuple[str, ...]]:
    """Return the layer on a measured height, as high as it has to be for the rest to end at the part's top.

    Raises
    ------
    SettingsError
        If nothing is left to be laid there.
    """
    plan = height_rule(maker.part, maker.config).plan(measured_mm)
    if not len(plan):
        said = f": {plan.said[0]}" if plan.said else ""
        raise SettingsError(
            f"--measured-z {measured_mm:g}: the part is {maker.height_mm:.3f} mm high, nothing is left to be laid{said}"
        )
    return Wanted(layer, measured_mm, float(plan.thickness_mm[0]), name), plan.said


def check_height(
    folder: Path, program: str, layer: int, measured_mm: float, tops_mm: Floats, thickness_mm: Floats
) -> None:
    """Refuse a height that the layer below cannot have, by the rule of `live`.

    Parameters
    ----------
    folder, program
        Folder of the layers that `relayer` made, and name of the run's program: the newest of them below stands for that of the run.
    tops_mm, thickness_mm
        (L,) Z of the tops and heights of the layers of the run.

    Raises
    ------
    SettingsError
        If the height is further from the top of the layer below than a bead can come out.
    """
    if layer == 0:
        base_mm, top_mm, by = -float(thickness_mm[0]), 0.0, "the base plate"
    else:
        top_mm = float(tops_mm[layer - 1])
        base_mm, by = top_mm - float(thickness_mm[layer - 1]), "the run"
        if made := _newest(folder, program, layer - 1):
            paper = json.loads((made / CERTIFICATE).read_text(encoding="utf-8"))
            base_mm, top_mm, by = float(paper["base_mm"]), float(paper["top_mm"]), made.name
    if fault := fault_of(Reading(layer, measured_mm), base_mm, top_mm):
        raise SettingsError(
            f"layer {layer + 1}: the measured height {measured_mm:g} mm cannot be: {fault.reason}; what stands is planned to end at {top_mm:.3f} mm by {by}: measure it "
            "again; where layers below came out otherwise, make each of them by `relayer`, or lead the build by `live`"
        )


def _newest(folder: Path, program: str, layer: int) -> Path | None:
    """Folder of the layer of that number that was made last; None where none was."""
    number, found = 1, None
    while (place := folder / LAYERS / layer_name(program, layer, number)).is_dir():
        number, found = number + 1, place
    return found


def relayer(
    maker: LayerMaker,
    heat: HeatSoFar,
    layer: int,
    measured_mm: float,
    folder: Path,
    metal: MetalSoFar | None = None,
    cells: MapCells | None = None,
) -> Relayered:
    """Make a layer at a measured height, and publish it under a new name in `folder` if every gate is open.

    What is known of the metal under it, `metal`, counts where sums and means over all layers are judged. Of a map, `cells`, of
    which `measured_mm` is the mean, as much is mended as can be proved.
    """
    number = 1
    program = maker.config.machine.program_name
    made_folder(folder)
    if (folder / JOURNAL).is_file():
        raise SettingsError(
            f"{folder}: is the folder of a build, whose own layers would come to the same names: give another with -o"
        )
    while (folder / LAYERS / layer_name(program, layer, number)).exists():
        number += 1
    wanted, said = wanted_layer(maker, layer, measured_mm, layer_name(program, layer, number))
    known = MetalSoFar() if metal is None else metal
    reading = Reading(layer, measured_mm) if cells is None else Reading.of_map(layer, measured_mm, cells)
    ground = Ground.of(reading, heat, known, maker.config)
    for share in ground.mending:
        staged = Path(tempfile.mkdtemp(prefix=".making.", dir=folder))
        try:
            under = None if metal is None else ground.surface(share)
            made = maker.make(wanted, heat, staged / PROGRAM, under)
            certificate = certificate_of(made, maker.part, maker.primary, maker.witness, ground.told(share))
            if made.passed:
                publish(folder, made, certificate)
                return Relayered(made, certificate, said, folder / LAYERS / wanted.name)
        finally:
            shutil.rmtree(staged, ignore_errors=True)
    (folder / f"{wanted.name}.refused.json").write_text(json_text(certificate), encoding="utf-8")
    return Relayered(made, certificate, said, None)
