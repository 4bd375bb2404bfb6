"""From compared layers to the finished run folder: gates, program, record, reports, certificate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ebamcheck.errors import ExitCode
from ebamcheck.mesh.part import Part
from ebamcheck.pipeline import findings, gates
from ebamcheck.pipeline.cross_check import CrossCheck, primary_of, unavailable_backends
from ebamcheck.pipeline.job import Job, RunResult
from ebamcheck.pipeline.manifest import manifest as make_manifest
from ebamcheck.pipeline.programming import make_program
from ebamcheck.pipeline.reports import write_reports
from ebamcheck.pipeline.tables import tables_of_comparison, write_tables
from ebamcheck.preflight.report import Ready
from ebamcheck.record.certificate import write_certificate
from ebamcheck.record.run_folder import FINGERPRINT, RunFolder
from ebamcheck.result import has_fault


class SlabRecord(NamedTuple):
    """What the record of a check in slabs says of them."""

    settings: Mapping[str, Mapping[str, Any]]  # settings of each backend
    figures: Mapping[str, Any]


def finish(
    job: Job,
    checked: CrossCheck,
    begun: Ready | None = None,
    fine: Part | None = None,
    slabs: SlabRecord | None = None,
) -> RunResult:
    """All stages from the gates of the cross-check to the finished folder; `fine` is a finer tessellation, which the curves are held against.

    A part that was taken in `slabs` was not made ready (`begun`), and its mesh is never there as a whole.
    """
    config, comparison = job.config, checked.comparison
    primary = primary_of(checked, config)
    outcomes = {**checked.outcomes, **unavailable_backends(config)}
    off = ""
    if slabs is None and primary in comparison.stacks and job.found.passed:
        areas = comparison.stacks[primary]["area_mm2"].to_numpy(np.float64)
        off = gates.volume_off(job.part, np.asarray(job.heights), areas, config)
    judged = [
        gates.input_gate(job.found, off),
        gates.agreement_gate(comparison, outcomes, len(job.heights), config.layer_height_mm, config.base_mm),
    ]
    told = [
        *(findings.begun_findings(begun) if begun is not None else ()),
        *findings.part_findings(job.found, config),
        *findings.slicer_findings(checked.outcomes, outcomes, comparison, config),
    ]
    made, tables = None, tables_of_comparison(comparison)
    if job.kind == "run" and primary:
        told += findings.profile_findings(config)
        sound = all(gate.passed for gate in judged) and not has_fault(told)
        made = make_program(job, primary, checked, fine, sound)
        judged += made.gates
        told += made.findings
        tables |= made.tables
    write_tables(job.folder.path, tables)
    code = gates.exit_code(judged, comparison.compared_layers, outcomes)
    if code is ExitCode.PASS and has_fault(told):
        code = ExitCode.OUT_OF_TOLERANCE
    manifest = make_manifest(job, outcomes, comparison, primary, made, judged, told, code)
    if slabs is not None:
        for name, settings in slabs.settings.items():
            manifest["backends"][name]["settings"] = settings
        manifest["slabs"] = slabs.figures
    job.folder.write_manifest(manifest)
    write_reports(job.folder.path, job.observer.note)
    if job.kind == "run":
        # Last of all: it lists every file, and so finds any byte that is changed after it.
        write_certificate(RunFolder(job.folder.path))
    (job.folder.path / FINGERPRINT).unlink()
    return RunResult(job.folder.finish(), tuple(judged), code, manifest)
