"""Faults in the machine profile: templates that do more, or less, than their names say.

They are not in a program but in what programs are made from: the run must refuse them, or its checks must fail.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.faults.finished import Workshop
from benchmarks.faults.judging import Said, Verdict, failures
from benchmarks.faults.results import Result
from benchmarks.faults.subjects import CONTROLS, SUBJECTS
from ebamcheck import registry
from ebamcheck.config import Config
from ebamcheck.curves import Curves
from ebamcheck.pipeline import run_job
from ebamcheck.pipeline.verify import verify_against_part, verify_run
from ebamcheck.program import Check
from ebamcheck.scan import ScanPlan

SINUMERIK, LINUXCNC, PLAIN = CONTROLS

BEGIN = {
    SINUMERIK: ("G91", "G70", "TRANS X5", "ROT RPL=5", "SCALE X2 Y2", "MIRROR X0", "G500", "G55", "G19", "G95", "GOTOF ENDE", "M0", "POS[X]=5", "G0 X5 Y5", "BRISK", "M30"),
    LINUXCNC: ("G91", "G20", "G92 X5", "G10 L2 P1 X5", "G55", "G19", "G93", "M0", "O100 CALL", "G0 X5 Y5", "G43 H2", "M2", "G64 P5", "#1=5"),
    PLAIN: ("G91", "G20", "G92 X5", "G55", "G19", "G93", "M0", "G0 X5 Y5", "G28", "M2", "M220 S50"),
}  # fmt: skip
"""Blocks of `layer_begin` and `layer_end` that are no business of a template."""

OF_SWITCHES: dict[str, tuple[tuple[str, str, tuple[str, ...]], ...]] = {
    SINUMERIK: (
        ("beam_on twice", "beam_on", ("M60", "M60")),
        ("beam_on with G91", "beam_on", ("G91", "M60")),
        ("beam_on with a move", "beam_on", ("G1 X5 Y5", "M60")),
        ("beam_on with the wire's code", "beam_on", ("M62", "M60")),
        ("beam_off that does nothing", "beam_off", ("H9=0",)),
        ("beam_off of a comment's code", "beam_off", ("H9=0 ; M61 beam off",)),
        ("wire_stop that does nothing", "wire_stop", ("H9=1",)),
        ("set_power of twice the value", "set_power", ("H2={power_w}",)),
        ("set_power with a digit more", "set_power", ("H2=1{current_ma}",)),
        ("volts and amperes exchanged", "set_beam", ("H1={current_ma}", "H2={voltage_kv}")),
        ("set_beam without current", "set_beam", ("H1={voltage_kv}",)),
        ("wire_start without speed", "wire_start", ("M62",)),
        ("layer_pause of no time", "layer_pause", ("G4 F0.{layer_pause_s}",)),
    ),
    LINUXCNC: (
        ("beam_on twice", "beam_on", ("M64 P0", "M64 P0")),
        ("beam_on with G91", "beam_on", ("G91", "M64 P0")),
        ("beam_on with a move", "beam_on", ("G1 X5 Y5", "M64 P0")),
        ("beam_off that does nothing", "beam_off", ("M65 P7",)),
        ("wire_stop that does nothing", "wire_stop", ("M65 P8",)),
        ("set_power of twice the value", "set_power", ("M67 E1 Q{power_w}",)),
        ("volts and amperes exchanged", "set_beam", ("M68 E0 Q{current_ma}", "M68 E1 Q{voltage_kv}")),
        ("wire_start without speed", "wire_start", ("M64 P1",)),
        ("beam_off that is on", "beam_off", ("M64 P0",)),
    ),
    PLAIN: (
        ("beam_on twice", "beam_on", ("M3 S{power_w}", "M3 S{power_w}")),
        ("beam_on with G91", "beam_on", ("G91", "M3 S{power_w}")),
        ("beam_on with a move", "beam_on", ("G1 X5 Y5", "M3 S{power_w}")),
        ("beam_off that does nothing", "beam_off", ("M42 P7 S0",)),
        ("wire_stop that does nothing", "wire_stop", ("M42 P8 S0",)),
        ("set_power by the current", "set_power", ("S{current_ma}",)),
        ("wire_start without speed", "wire_start", ("M8",)),
    ),
}
"""Name, template and blocks."""


@dataclass(frozen=True)
class ProfileFault:
    """A template that is not what its name says."""

    kind: str
    control: str
    variant: str
    template: str
    blocks: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name of the fault."""
        return f"{self.kind}/{self.control}/{self.variant}"


def profile_faults(kinds: str = "", controls: tuple[str, ...] = CONTROLS) -> Iterator[ProfileFault]:
    """All faults of templates, or those whose kind's name contains a text."""
    found = [
        ProfileFault("template of a layer", c, b, "layer_begin", (b,)) for c in CONTROLS for b in BEGIN[c]
    ]
    found += [
        ProfileFault("template after a layer", c, b, "layer_end", (b,))
        for c in CONTROLS
        for b in BEGIN[c][:3]
    ]
    found += [
        ProfileFault("template of a switch", c, v, t, b) for c in CONTROLS for v, t, b in OF_SWITCHES[c]
    ]
    return (f for f in found if kinds in f.kind and f.control in controls)


def judged_profile(fault: ProfileFault, workshop: Workshop, folder: Path) -> Result:
    """Run the job by the spoiled profile, and verify what it makes; write the program by it, and verify the text."""
    made = workshop.finished(SUBJECTS["cube"], fault.control)
    change = {"machine": {fault.template: fault.blocks}}
    run = _verdict(
        fault,
        failures(lambda: _run(made.part, folder / "profile", made.subject.config(fault.control, **change))),
    )
    text = _verdict(
        fault,
        failures(
            lambda: _text(
                made.run, made.part, folder / "posted", made.subject.config(fault.control, **change)
            )
        ),
    )
    return Result(
        name=fault.name,
        kind=fault.kind,
        changes="state",
        control=fault.control,
        part=made.subject.name,
        variant=fault.variant,
        what=f"machine.{fault.template} = {list(fault.blocks)}",
        where=f"machine.{fault.template}",
        unseen="",
        run_checks=tuple(s.check for s in run.said),
        run_found=run.found,
        run_right=run.right,
        text_checks=tuple(s.check for s in text.said),
        text_found=text.found,
        text_right=text.right,
        notes=tuple(
            " | ".join(f"{s.check} {s.where} {s.text[:90]}" for s in v.said[:4]) for v in (run, text)
        ),
    )


def _run(part: Path, folder: Path, config: Config) -> list[Check]:
    """Checks of a run by a profile: its gates, and its verification."""
    result = run_job(part, folder, config)
    failed = [Check(f"gate {g.name}", g.passed, g.figure, g.limit, g.unit, "", g.text) for g in result.gates]
    return failed + verify_run(result.folder.path, part)


def _text(run: Path, part: Path, folder: Path, config: Config) -> list[Check]:
    """Checks of a program that is written by a profile from the curves and the plan of a sound run."""
    write = registry.plugin(registry.POSTS, config.machine.control)
    curves, plan = Curves.from_parquet(run / "beads.parquet"), ScanPlan.from_parquet(run / "scan.parquet")
    files = write(curves, plan, config, folder)
    return verify_against_part(files.main, part, config)


def _verdict(fault: ProfileFault, said: list[Said]) -> Verdict:
    """The right place is the template by its name, or one of its blocks."""
    names = (fault.template, *(code.partition(" ;")[0] for code in fault.blocks))
    return Verdict(tuple(said), any(any(name in s.text for name in names) for s in said))
