"""From compared layers to the finished run folder: gates, program, record (``run.json``), reports, certificate."""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.checks.consumables import plate_record
from ebamcheck.comparison import Comparison
from ebamcheck.curves.gate import METHODS as FALLBACKS
from ebamcheck.errors import ExitCode
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.json_values import sha256_of_file, sha256_of_json
from ebamcheck.layers.files import LayerFile
from ebamcheck.mesh.part import Part
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.pipeline import findings, gates
from ebamcheck.pipeline.cross_check import CrossCheck, evidence_records, primary_of, unavailable_backends
from ebamcheck.pipeline.entry_program import ENTRY, LIVE
from ebamcheck.pipeline.fit import FitResult
from ebamcheck.pipeline.job import Job, RunResult
from ebamcheck.pipeline.programming import ProgramResult, make_program
from ebamcheck.pipeline.reports import write_reports
from ebamcheck.pipeline.tables import sums_of, tables_of_comparison, write_tables
from ebamcheck.plugins import registry
from ebamcheck.preflight.report import Ready
from ebamcheck.record.certificate import write_certificate
from ebamcheck.record.form import FORMAT_VERSION, PLATE
from ebamcheck.record.run_folder import FINGERPRINT, MANIFEST, RunFolder
from ebamcheck.result import Check, check_record, finding_records, gate_record, has_fault
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Outcome
from ebamcheck.version import __version__

# Columns of the program's summary that add up over the layers
TOTALS = (
    "motions", "contour_mm", "hatch_mm", "travel_mm", "deposit_s", "travel_s", "pause_s", "wire_mm", "wire_kg",
)  # fmt: skip


def finish(
    job: Job,
    checked: CrossCheck,
    begun: Ready | None = None,
    fine: Part | None = None,
    slabs: Mapping[str, Any] | None = None,
    settings: Mapping[str, Mapping[str, Any]] | None = None,
) -> RunResult:
    """All stages from the gates of the cross-check to the finished folder; `fine` is a finer tessellation, which the curves are
    held against.

    A part that was taken in `slabs`, of which the record has figures and `settings` of each backend, was not made ready: its mesh
    is never whole."""
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
    record = manifest(job, outcomes, comparison, primary, made, judged, told, code)
    for name, used in (settings or {}).items():
        record["backends"][name]["settings"] = used
    if slabs is not None:
        record["slabs"] = slabs
    job.folder.write_manifest(record)
    write_reports(job.folder.path, job.observer.note)
    if job.kind == "run":
        # Last of all: it lists every file, and so finds any byte that is changed after it.
        write_certificate(RunFolder(job.folder.path))
    (job.folder.path / FINGERPRINT).unlink()
    return RunResult(job.folder.finish(), tuple(judged), code, record)


# -- the record -------------------------------------------------------------------------------------


def manifest(
    job: Job,
    outcomes: Mapping[str, Outcome],
    comparison: Comparison,
    primary: str,
    program: ProgramResult | None,
    gates: Sequence[Check],
    findings: Sequence[Check],
    code: ExitCode,
) -> dict[str, Any]:
    """Everything that is known of a run; only what stands under ``timings`` differs from one run to the next.

    That goes into a file of its own (:meth:`~ebamcheck.record.run_folder.RunFolder.write_manifest`).
    """
    config, part = job.config.model_dump(), job.config.part
    placed = part.place_at_mm is not None or part.rotate_deg
    plate = program.proof.plate if program else plate_record(job.part, job.config)
    return {
        "format": FORMAT_VERSION,
        "job": job.kind,
        FINGERPRINT: job.fingerprint,
        "ebamcheck": __version__,
        "python": platform.python_version(),
        "part": {
            "name": job.part.name,
            "source": Path(job.part.source).name,
            "sha256": job.part.source_sha256,
            "mesh_sha256": job.part.sha256,
            "units": job.part.units,
            "units_from": job.part.units_from,
            "direction": list(job.part.direction),
            # Where the settings give the part neither place nor turn, nothing is said of them.
            **({"place_at_mm": part.place_at_mm, "rotate_deg": part.rotate_deg} if placed else {}),
            "inspection": job.found.as_dict(),
        },
        "settings": config,
        "settings_sha256": sha256_of_json(config),
        "heights": {
            "count": len(job.heights),
            "first_mm": float(job.heights[0]),
            "last_mm": float(job.heights[-1]),
            "layer_height_mm": job.config.layer_height_mm,
        },
        "primary": primary,
        "backends": {
            name: _backend_record(job, outcome, comparison.stacks.get(name)) for name, outcome in outcomes.items()
        },
        "comparison": _comparison_record(comparison, job.config),
        **({PLATE: list(plate)} if plate else {}),
        **(_program_records(program, job.config) if program else {}),
        "gates": [gate_record(gate) for gate in gates],
        "findings": finding_records(findings),
        "exit_code": int(code),
        "files": _file_hashes(job.folder.path),
        "timings": _timings(job, outcomes),
    }


def _timings(job: Job, outcomes: Mapping[str, Outcome]) -> dict[str, Any]:
    """What differs from one run to the next: dates, machine, folders, seconds, megabytes."""
    figures = ("prepare_s", "slice_s", "peak_mb")
    return {
        "finished": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "machine": platform.machine(),
        "part_path": str(Path(job.part.source).resolve()),
        "stages_s": job.timings,
        "backends": {
            name: {figure: getattr(outcome, figure) for figure in figures} for name, outcome in outcomes.items()
        },
    }


def _comparison_record(comparison: Comparison, config: Config) -> dict[str, Any]:
    heights = comparison.layers["height_mm"].to_numpy(np.float64)
    z_mm = deposition_heights(heights, config.layer_height_mm, config.base_mm).tolist()
    return {
        "compared_layers": comparison.compared_layers,
        "passed": comparison.passed,
        "verdicts": comparison.layers["verdict"].value_counts().sort_index().to_dict(),
        "classes": comparison.layers["class"].value_counts().sort_index().to_dict(),
        "pairs": _pair_records(comparison.pairs),
        "evidence": evidence_records(comparison),
        "no_evidence": dict(comparison.without_weight),
        # With the number of the layer, from 1, and its height in the program
        "findings": [{**asdict(f), "layer": f.layer + 1, "program_z_mm": z_mm[f.layer]} for f in comparison.findings],
    }


def _program_records(made: ProgramResult, config: Config) -> dict[str, Any]:
    reference = made.fit.verdict.reference
    proof, files, sums = made.proof, made.files, sums_of(made.tables)
    scan = {name: value for name, value in sums["scan"].items() if name != "layer"}
    program = {
        "checks": [check_record(check) for check in proof.checks],
        "witness": proof.witness,
        "totals": {name: sums["program.totals"][name] for name in TOTALS},
        "validated": files.validated,
        "files": [{"name": name, "sha256": files.sha256[name], "blocks": files.blocks[name]} for name in files.names],
    }
    others = {ENTRY: made.entry and made.entry.record(), LIVE: made.live}
    return {
        "fit": _fit_record(made.fit),
        **({"reference": reference} if reference is not None else {}),
        "kinematics": sums["kinematics"],
        "heat": {"limit_k": entry_limit_k(config), "build_s": proof.build_s},
        "program": {**program, **{name: other for name, other in others.items() if other is not None}},
        "scan": {
            "order": config.scan.order,
            "seed": config.scan.seed,
            "islands": len(made.plan.islands),
            **scan,
            "time_s": scan["deposit_s"] + scan["travel_s"] + scan["wait_s"],
        },
    }


def _fit_record(made: FitResult) -> dict[str, Any]:
    evidence = made.verdict.evidence
    fallen = {name: int((evidence.method == k).sum()) for k, name in enumerate(FALLBACKS) if k}
    return {
        "method": made.curves.method,
        "points": made.points,
        "rings": evidence.cause.size,
        "fallen_rings": fallen,
        "open_rings": made.verdict.open_rings,
        **made.methods[made.curves.method],
        "methods": dict(made.methods),
    }


def _file_hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file that the stages wrote; the reports that follow are renderings of these."""
    written = sorted(file for file in folder.rglob("*") if file.is_file())
    others = (file for file in written if file.name not in (MANIFEST, FINGERPRINT))
    return {file.relative_to(folder).as_posix(): sha256_of_file(file) for file in others}


def _backend_record(job: Job, outcome: Outcome, figures: pd.DataFrame | None) -> dict[str, Any]:
    slicer = registry.slicer(outcome.name)
    totals = {"rings": 0, "open_paths": 0, "points": 0}
    if figures is not None:
        totals = {name: int(figures[name].sum()) for name in totals}
    file, settings = job.folder.layers_file(outcome.name), dict[str, Any]()
    # Not where they were dropped slab by slab.
    is_kept = outcome.file is not None and file.is_file()
    if is_kept:
        with LayerFile(file) as opened:  # settings as the slicer has filled them in, with what it declared
            settings = opened.settings
    return {
        "status": outcome.failure or "done",
        "why": outcome.why,
        **{name: getattr(slicer, name) for name in ("summary", "exact", "coplanar_rule", "inside_rule")},
        "device": outcome.probe.device,
        "versions": dict(outcome.probe.versions),
        "error_bound_mm": outcome.error_bound_mm,
        "height_bound_mm": outcome.height_bound_mm,
        "settings": settings,
        **totals,
        "file": f"layers/{outcome.name}.parquet" if is_kept else "",
    }


def _pair_records(pairs: pd.DataFrame) -> list[dict[str, Any]]:
    """One record a pair of backends: the worst figures over its layers."""
    records: list[dict[str, Any]] = []
    for (a, b), rows in pairs.groupby(["a", "b"], sort=True) if len(pairs) else ():
        gated = rows[rows["gated"]]
        records.append(
            {
                "a": a,
                "b": b,
                "layers": len(rows),
                "gated": len(gated),
                "agree": int(gated["agrees"].sum()),
                "limit_mm": float(rows["limit_mm"].max()),
                "max_depth_mm": float(gated["depth_mm"].max()),
                "max_hausdorff_mm": float(gated["hausdorff_mm"].max()),
                "max_p95_mm": float(np.nanmax(gated[["p95_ab_mm", "p95_ba_mm"]].to_numpy(), initial=0.0)),
                "max_area_difference_mm2": float(gated["area_difference_mm2"].abs().max()),
                "min_iou": float(gated["iou"].min()),
            }
        )
    return records
