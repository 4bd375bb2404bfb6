"""Faults in the settings: templates that do more, or less, than their names say, and a fit that rounds a part.

They are not in a program but in what programs are made from: the run must refuse them, or its checks must fail.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from benchmarks.faults.judging import Verdict, failures, reseal, strip
from benchmarks.faults.kinds import LINUXCNC, METAL, PLAIN, SINUMERIK, STATE, Ground, Place, kind
from benchmarks.faults.subjects import TWELVE, Finished
from ebamcheck.curves import Curves
from ebamcheck.json_values import write_json
from ebamcheck.nc.control import control
from ebamcheck.pipeline import run_job
from ebamcheck.program import Check, ProgramFiles, mark_validated
from ebamcheck.record.run_folder import MANIFEST, RunFolder
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config
from ebamcheck.verification.verify import verify_against_part, verify_run

BEGIN = {
    SINUMERIK: ("G91", "G70", "TRANS X5", "ROT RPL=5", "SCALE X2 Y2", "MIRROR X0", "G500", "G55", "G19", "G95", "GOTOF ENDE", "M0", "POS[X]=5", "G0 X5 Y5", "BRISK", "M30"),
    LINUXCNC: ("G91", "G20", "G92 X5", "G10 L2 P1 X5", "G55", "G19", "G93", "M0", "O100 CALL", "G0 X5 Y5", "G43 H2", "M2", "G64 P5", "#1=5"),
    PLAIN: ("G91", "G20", "G92 X5", "G55", "G19", "G93", "M0", "G0 X5 Y5", "G28", "M2", "M220 S50"),
}  # fmt: skip
"""Blocks of `layer_begin` and `layer_end` that are no business of a template."""

OF_SWITCHES: dict[str, dict[str, tuple[str, tuple[str, ...]]]] = {
    SINUMERIK: {
        "beam_on twice": ("beam_on", ("M60", "M60")),
        "beam_on with G91": ("beam_on", ("G91", "M60")),
        "beam_on with a move": ("beam_on", ("G1 X5 Y5", "M60")),
        "beam_on with the wire's code": ("beam_on", ("M62", "M60")),
        "beam_off that does nothing": ("beam_off", ("H9=0",)),
        "beam_off of a comment's code": ("beam_off", ("H9=0 ; M61 beam off",)),
        "wire_stop that does nothing": ("wire_stop", ("H9=1",)),
        "set_power of twice the value": ("set_power", ("H2={power_w}",)),
        "set_power with a digit more": ("set_power", ("H2=1{current_ma}",)),
        "volts and amperes exchanged": ("set_beam", ("H1={current_ma}", "H2={voltage_kv}")),
        "set_beam without current": ("set_beam", ("H1={voltage_kv}",)),
        "wire_start without speed": ("wire_start", ("M62",)),
        "layer_pause of no time": ("layer_pause", ("G4 F0.{layer_pause_s}",)),
    },
    LINUXCNC: {
        "beam_on twice": ("beam_on", ("M64 P0", "M64 P0")),
        "beam_on with G91": ("beam_on", ("G91", "M64 P0")),
        "beam_on with a move": ("beam_on", ("G1 X5 Y5", "M64 P0")),
        "beam_off that does nothing": ("beam_off", ("M65 P7",)),
        "wire_stop that does nothing": ("wire_stop", ("M65 P8",)),
        "set_power of twice the value": ("set_power", ("M67 E1 Q{power_w}",)),
        "volts and amperes exchanged": ("set_beam", ("M68 E0 Q{current_ma}", "M68 E1 Q{voltage_kv}")),
        "wire_start without speed": ("wire_start", ("M64 P1",)),
        "beam_off that is on": ("beam_off", ("M64 P0",)),
    },
    PLAIN: {
        "beam_on twice": ("beam_on", ("M3 S{power_w}", "M3 S{power_w}")),
        "beam_on with G91": ("beam_on", ("G91", "M3 S{power_w}")),
        "beam_on with a move": ("beam_on", ("G1 X5 Y5", "M3 S{power_w}")),
        "beam_off that does nothing": ("beam_off", ("M42 P7 S0",)),
        "wire_stop that does nothing": ("wire_stop", ("M42 P8 S0",)),
        "set_power by the current": ("set_power", ("S{current_ma}",)),
        "wire_start without speed": ("wire_start", ("M8",)),
    },
}  # fmt: skip
"""By control and name: template and blocks."""


def _template(ground: Ground, template: str = "") -> list[Place]:
    """Blocks in a template: those of the variant's name, or the variant itself."""
    template, blocks = (template, (ground.variant,)) if template else OF_SWITCHES[ground.text.control][ground.variant]
    ground.settings = {"machine": {template: blocks}}
    return [Place(name, 1, 1) for name in (template, *(code.partition(" ;")[0] for code in blocks))]


def _rounding_fit(ground: Ground) -> list[Place]:
    ground.settings = {"curves": {"crease_angle_deg": 40.0}}
    return [Place("fit", 1, 1), Place("MAIN", 1, 1)]


def judged_settings(ground: Ground, sound: Finished, folder: Path, places: list[Place]) -> tuple[Verdict, Verdict]:
    """Verify the run and the text that the spoiled settings make, as far as they are not refused; a message names what is wrong."""
    spoiled = folder / "spoiled"
    shutil.rmtree(spoiled, ignore_errors=True)

    def verdict(checks: Callable[[Finished, Path, Config], list[Check]]) -> Verdict:
        said = failures(lambda: checks(sound, spoiled, sound.subject.config(sound.control, **ground.settings)))
        right = [s.check for s in said if any(place.file in f"{s.where} {s.text}" for place in places)]
        return Verdict(tuple(said), tuple(dict.fromkeys(right)))

    return verdict(_posted if "machine" in ground.settings else _run), verdict(_text)


def _run(sound: Finished, folder: Path, config: Config) -> list[Check]:
    """Checks of a run by other settings: its gates, and its verification."""
    result = run_job(sound.part, folder, config, force=True)
    gates = [Check(f"gate {g.name}", g.passed, g.value, g.limit, g.unit, "", g.text) for g in result.gates]
    return gates + verify_run(result.folder.path, sound.part)


def _posted(sound: Finished, folder: Path, config: Config) -> list[Check]:
    """Checks of a run whose program is written anew by another profile: what is not geometry differs."""
    shutil.copytree(sound.run, folder)
    record = RunFolder(folder).manifest()
    record["settings"] = config.model_dump()
    write_json(record, folder / MANIFEST)
    written = _write(sound, config, folder / "program")
    mark_validated(written)
    reseal(folder, written.names[0])
    return verify_run(folder, sound.part)


def _write(sound: Finished, config: Config, folder: Path) -> ProgramFiles:
    """Write a program by a profile from curves and plan of a sound run."""
    post = control(config.machine.control).load("writer")
    curves = Curves.from_parquet(sound.run / "beads.parquet")
    written: ProgramFiles = post(curves, ScanPlan.from_parquet(sound.run / "scan.parquet"), config, folder)
    return written


def _text(sound: Finished, spoiled: Path, config: Config) -> list[Check]:
    """Checks of the bare text that was made by the spoiled settings, or would have been."""
    program = spoiled / "program"
    if not program.is_dir():
        _write(sound, config, program)
    alone = spoiled.with_name("alone") / "program"
    shutil.rmtree(alone.parent, ignore_errors=True)
    shutil.copytree(program, alone)
    strip(alone)
    return verify_against_part(alone, sound.part, config)


# -- the kinds -------------------------------------------------------------------------------------------

# fmt: off
kind("template of a layer", STATE, _template, BEGIN, subjects=("cube",), template="layer_begin")
kind("template after a layer", STATE, _template, {c: blocks[:3] for c, blocks in BEGIN.items()}, subjects=("cube",), template="layer_end")
kind("template of a switch", STATE, _template, {c: tuple(some) for c, some in OF_SWITCHES.items()}, subjects=("cube",))
kind("fit that rounds edges", METAL, _rounding_fit, ("0.988 mm",), subjects=(TWELVE.name,))
# fmt: on
