"""From compared layers to the finished run folder: gates, program, record, reports, certificate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from ebamcheck.comparison import Comparison
from ebamcheck.errors import ExitCode
from ebamcheck.pipeline import gates, noticed
from ebamcheck.pipeline.choice import unavailable_backends
from ebamcheck.pipeline.cross_check import CrossCheck, primary_of
from ebamcheck.pipeline.manifest import manifest as make_manifest
from ebamcheck.pipeline.report_writers import write_reports
from ebamcheck.pipeline.section_volume import volume_off
from ebamcheck.pipeline.work import Job
from ebamcheck.record.certificate import write_certificate
from ebamcheck.record.run_folder import FINGERPRINT, RunFolder
from ebamcheck.result import Check, gate_of_record, has_fault

if TYPE_CHECKING:
    from ebamcheck.pipeline.programming import ProgramResult

ProgramStage: TypeAlias = "Callable[[Job, CrossCheck, bool], ProgramResult]"
"""Makes a program from agreed contours; its last argument tells whether all gates so far are passed."""


@dataclass(frozen=True)
class RunResult:
    """What a run came to."""

    folder: RunFolder
    gates: tuple[Check, ...]
    exit_code: ExitCode
    manifest: Mapping[str, Any] = field(repr=False)


def finished_result(run: RunFolder) -> RunResult:
    """What a finished run came to, by its record."""
    manifest = run.manifest()
    found = tuple(gate_of_record(gate) for gate in manifest["gates"])
    return RunResult(run, found, ExitCode(manifest["exit_code"]), manifest)


class SlabRecord(NamedTuple):
    """What the record of a check in slabs says of them."""

    settings: Mapping[str, Mapping[str, Any]]
    """Settings of each backend."""
    figures: Mapping[str, Any]


def finish(
    job: Job, checked: CrossCheck, program: ProgramStage | None, slabs: SlabRecord | None = None
) -> RunResult:
    """All stages from the gates of the cross-check to the finished folder.

    Parameters
    ----------
    program
        Makes the program; None where none is wanted.
    slabs
        Of a part that was taken in slabs, whose mesh is never there as a whole.
    """
    primary = primary_of(job, checked)
    outcomes = {**checked.outcomes, **unavailable_backends(job.config)}
    judged = [
        gates.input_gate(job.found, _volume_off(job, checked.comparison, primary) if slabs is None else ""),
        gates.agreement_gate(
            checked.comparison, outcomes, len(job.heights), job.config.layer_height_mm, job.config.base_mm
        ),
    ]
    job.add_finding(*noticed.of_doubt(checked.comparison.pairs, job.config))
    job.add_finding(*noticed.of_set_aside(checked.comparison.pairs))
    job.add_finding(*(noticed.unavailable(o) for o in outcomes.values() if o.failure == "unavailable"))
    made = None
    if program is not None and primary:
        job.add_finding(*noticed.of_profile(job.config))
        made = program(job, checked, all(gate.passed for gate in judged))
        judged += made.gates
    code = gates.exit_code(judged, checked.comparison.compared_layers, outcomes)
    if code is ExitCode.PASS and has_fault(job.findings):
        code = ExitCode.OUT_OF_TOLERANCE
    manifest = make_manifest(job, outcomes, checked.comparison, primary, made, judged, code)
    if slabs is not None:
        for name, settings in slabs.settings.items():
            manifest["backends"][name]["settings"] = settings
        manifest["slabs"] = slabs.figures
    job.folder.write_manifest(manifest)
    write_reports(job.folder.path, job.observer.note)
    if program is not None:
        # Last of all: it lists every file, and so finds any byte that is changed after it.
        write_certificate(RunFolder(job.folder.path))
    (job.folder.path / FINGERPRINT).unlink()
    return RunResult(job.folder.finish(), tuple(judged), code, manifest)


def _volume_off(job: Job, comparison: Comparison, primary: str) -> str:
    """How far the volume of the part is off its sections; nothing where it has none, or none were compared."""
    if primary not in comparison.stacks or not job.found.passed:
        return ""
    areas = comparison.stacks[primary]["area_mm2"].to_numpy(np.float64)
    return volume_off(job.part, np.asarray(job.heights), areas, job.config)
