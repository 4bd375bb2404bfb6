"""A few dozen faults on one part, and those of them that are not found yet: a list that may only get shorter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from benchmarks.faults.finished import Workshop
from benchmarks.faults.planting import Planter, faults
from benchmarks.faults.results import Result
from benchmarks.faults.settings_faults import judged_setting, setting_faults
from benchmarks.faults.subjects import SUBJECTS

PART = "prism"
"""It has long ways, and is verified in a quarter of a second; where a fault needs bores or arcs, another part serves."""

MISSED = Path(__file__).with_name("missed.txt")
"""Ways of verification and names of faults that are missed, one a line."""

NAMES = (
    "rapid through the metal/sinumerik-840d-sl/under the top",
    "retract deleted/linuxcnc",
    "every retract deleted/plain-gcode",
    "X, Y and Z in one rapid/sinumerik-840d-sl",
    "plunge/linuxcnc/into the plate",
    "no rise at the end/plain-gcode/deleted",
    "bead beside the part/sinumerik-840d-sl/in the main program",
    "bead beside the part/linuxcnc/before the first role",
    "bead beside the part/plain-gcode/as turns",
    "bead across a channel/plain-gcode/in a role",
    "hatch line 100 mm out/linuxcnc/end",
    "extra bead in an island/sinumerik-840d-sl/in a role",
    "contour twice/plain-gcode",
    "layers swapped/linuxcnc",
    "layers swapped/plain-gcode",
    "layer omitted/sinumerik-840d-sl",
    "island omitted/linuxcnc",
    "layer shifted/plain-gcode/0.3",
    "slip in a contour/sinumerik-840d-sl/digit",
    "slip in the hatch/linuxcnc/sign",
    "arc the other way round/plain-gcode",
    "coefficient of a polynomial/sinumerik-840d-sl/second",
    "feed and wire halved everywhere/linuxcnc",
    "volts and milliamperes exchanged/sinumerik-840d-sl",
    "feed of one bead/plain-gcode/0.5",
    "power of one bead/linuxcnc/2.5",
    "switch deleted/sinumerik-840d-sl/beam_off",
    "order of switches/plain-gcode/wire on before beam on",
    "order of switches/sinumerik-840d-sl/wire speed after wire on",
    "wait in a bead/linuxcnc/2.0",
    "work offset, in a layer/sinumerik-840d-sl/G55",
    "smoothing, in a layer/sinumerik-840d-sl/G641 ADIS=5",
    "acceleration, in a layer/sinumerik-840d-sl/BRISK",
    "distance mode, in a layer/plain-gcode/G91",
    "program flow, in a layer/linuxcnc/%",
    "mode missing/linuxcnc/G91.1",
    "mode after the modes/plain-gcode/G55",
    "header says not validated/sinumerik-840d-sl/every file",
    "header of another run/linuxcnc/PART SHA-256",
    "$PATH/sinumerik-840d-sl/another",
    "file cut off/plain-gcode/a third",
    "body that begins in the air/plain-gcode/1",
    "body over an empty layer/linuxcnc",
    "island that floats in a bore/sinumerik-840d-sl",
    "template of a layer/sinumerik-840d-sl/TRANS X5",
    "template of a switch/linuxcnc/beam_off that does nothing",
)
"""Faults of the table by which this harness began, and some more, each for one control."""


def quick_results(workshop: Workshop, seed: int, names: tuple[str, ...] = NAMES) -> Iterator[Result]:
    """Judge the quick faults, or some of them."""
    planter = Planter(workshop, seed, (PART,))
    for fault in faults():
        if fault.name in names:
            yield planter.judged(fault, workshop.folder)
    for spoiled in setting_faults():
        if spoiled.name in names:
            yield judged_setting(replace(spoiled, subject=SUBJECTS[PART]), workshop, workshop.folder)


def misses(result: Result) -> list[str]:
    """Lines of the list for a fault."""
    run, text = result.run_missed, result.text_missed
    return [f"{way} {result.name}" for way, missed in (("run", run), ("text", text)) if missed]


def known_misses() -> list[str]:
    """The list as it stands."""
    return MISSED.read_text(encoding="utf-8").splitlines() if MISSED.is_file() else []


def shorten(missed: list[str]) -> None:
    """Take what is found by now off the list; nothing is put on it, once it is there."""
    kept = [line for line in known_misses() if line in missed] if MISSED.is_file() else missed
    MISSED.write_text("".join(f"{line}\n" for line in kept), encoding="utf-8")
