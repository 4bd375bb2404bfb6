"""From agreed contours to a verified program: fit, partition, order, write, read back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck import layer_files, registry
from ebamcheck.config import Config
from ebamcheck.curves import LIFTED, Curves, contour_error, error_reduction, fit, fit_deviation
from ebamcheck.layers import Layers, from_polygons
from ebamcheck.part import Part
from ebamcheck.pipeline import gates
from ebamcheck.pipeline.cross_check import CrossCheck
from ebamcheck.pipeline.gates import Gate
from ebamcheck.pipeline.work import Job
from ebamcheck.program import Check, mark_validated, program_summary, read_program, verify_program
from ebamcheck.scan import ScanPlan, plan_stack
from ebamcheck.slicing import slice_part

SAMPLING_MM = 0.002
"""Beads are planned inside of polylines this near to the fitted curves: a tenth of the fit's tolerance."""

TOTALS = ("motions", "contour_mm", "hatch_mm", "travel_mm", "deposit_s", "travel_s", "wire_mm", "wire_kg")
"""Columns of the program's summary that add up over the layers."""


def make_program(
    job: Job, primary: str, checked: CrossCheck, fine: Part | None, validated_so_far: bool
) -> list[Gate]:
    """Fit, partition, order, write, read back and verify."""
    config, layers = job.config, job.folder.read_layers(primary)
    curves, deviation = _fit(job, layers, checked.outcomes[primary].error_bound_mm, fine)
    with job.stage("partition and order", len(layers)):
        smooth = smooth_layers(curves)
        plan = plan_stack(smooth, config, progress=job.observer.advance)
        plan.to_parquet(job.folder.path / "scan.parquet")
        plan.metrics.to_csv(job.folder.path / "scan.csv", index=False)
    with job.stage("program", 1):
        beads = bead_paths(smooth, plan, config)
        beads.to_parquet(job.folder.path / "beads.parquet")
        checks = _write_and_verify(job, beads, plan, _witness(job, layers, checked.done))
    made = [
        gates.fit_gate(deviation, config),
        gates.coverage_gate(plan.metrics, config),
        gates.program_gate(checks),
    ]
    job.record["scan"] = {
        "order": config.scan.order,
        "seed": config.scan.seed,
        "islands": len(plan.islands),
        "hatch_mm": float(plan.metrics["hatch_length_mm"].sum()),
        "travel_mm": float(plan.metrics["travel_mm"].sum()),
        "starts": int(plan.metrics["starts"].sum()),
        "time_s": float(plan.metrics["time_s"].sum()),
    }
    if validated_so_far and all(gate.passed for gate in made):
        files = mark_validated(job.record.pop("files"))
    else:
        files = job.record.pop("files")
    job.record["program"]["validated"] = files.validated
    job.record["program"]["files"] = [
        {"name": name, "sha256": files.sha256[name], "blocks": files.blocks[name]} for name in files.names
    ]
    return made


def _fit(job: Job, layers: Layers, error_bound_mm: float, fine: Part | None) -> tuple[Curves, pd.DataFrame]:
    """Fit the contours, measure the fit, and both against the reference where there is one."""
    # What a slicer's own error makes of a contour, a staircase of pixels say, is no shape: no corners come of it.
    settings = job.config.curves
    settings = settings.model_copy(update={"collinear_mm": max(settings.collinear_mm, error_bound_mm)})
    with job.stage("fit", len(layers)):
        curves = fit(layers, settings.method, settings, job.observer.advance, job.part)
        curves.to_parquet(job.folder.path / "curves.parquet")
        deviation = fit_deviation(curves, layers)
        deviation.to_csv(job.folder.path / "fit.csv", index=False)
    job.record["fit"] = {
        "method": curves.method,
        "blocks": int(curves.block_count()),
        "points": len(layers.points),
        "max_points_mm": float(deviation["points_mm"].max()),
        "max_bulge_mm": float(deviation["bulge_mm"].max()),
    }
    if fine is not None:
        with job.stage("reference", len(layers)):
            job.record["reference"] = _against_reference(job, layers, curves, fine)
    return curves, deviation


def _against_reference(job: Job, layers: Layers, curves: Curves, fine: Part) -> dict[str, Any]:
    """Errors of contour and curve against the finer tessellation (paper, section 5.2)."""
    truth = slice_part(fine, layers.heights)
    layer_files.write_parquet(truth, job.folder.path / "reference.parquet")
    before, after = contour_error(layers, truth), contour_error(curves, truth)
    pd.concat([before.assign(of="contour"), after.assign(of="curve")]).to_csv(
        job.folder.path / "reference.csv", index=False
    )
    figures = ("polar_min_mm", "polar_max_mm", "normal_min_mm", "normal_max_mm")
    return {
        "part": {"source": Path(fine.source).name, "sha256": fine.source_sha256, "facets": len(fine.faces)},
        "contour": {f: _extreme(before[f], f) for f in figures} | _rms(before),
        "curve": {f: _extreme(after[f], f) for f in figures} | _rms(after),
        "reduction": error_reduction(before, after).to_dict(),
        "unmatched_rings": int(before["unmatched"].sum()),
    }


def _extreme(column: pd.Series[float], name: str) -> float:
    return float(column.min() if "_min_" in name else column.max())


def _rms(errors: pd.DataFrame) -> dict[str, float]:
    """Root mean square of both errors over all rings of the stack; NaN where one is defined nowhere."""
    result = {}
    for figure, rings in (("polar_rms_mm", "polar_rings"), ("normal_rms_mm", "rings")):
        known = errors[errors[figure].notna()]
        weight = known[rings].sum()
        result[figure] = (
            float(np.sqrt((known[figure] ** 2 * known[rings]).sum() / weight)) if weight else float("nan")
        )
    return result


def smooth_layers(curves: Curves) -> Layers:
    """Polylines along fitted contours, inside of which beads are planned."""
    return curves.sample_tolerance(SAMPLING_MM)


def bead_paths(layers: Layers, plan: ScanPlan, config: Config) -> Curves:
    """Curves along the centre lines of the contour beads."""
    lines = from_polygons(
        layers.heights,
        [[region] for region in plan.contours],
        part=layers.part,
        direction=layers.direction,
        backend=layers.backend,
        settings=layers.settings,
    )
    # What lies along a bead was lifted with the contour; an inset has no edges of the mesh of its own.
    method = "bounded" if config.curves.method in LIFTED else config.curves.method
    return fit(lines, method, config.curves)


def _witness(job: Job, layers: Layers, done: Sequence[str]) -> Layers:
    """Contours by another exact method than the one that made the program, where there is one."""
    others = [n for n in done if n != layers.backend and registry.slicer(n).exact]
    best = max(others, key=lambda n: registry.slicer(n).priority, default="")
    return job.folder.read_layers(best) if best else layers


def _write_and_verify(job: Job, beads: Curves, plan: ScanPlan, witness: Layers) -> list[Check]:
    """Write the program, read its text back and check it against what it was made from."""
    header = {"PART SHA-256": job.part.source_sha256 or job.part.sha256}
    write_program = registry.plugin(registry.POSTS, job.config.machine.control)
    files = write_program(beads, plan, job.config, job.folder.program_folder, header=header)
    program = read_program(files.main, job.config)
    checks = verify_program(
        program,
        config=job.config,
        curves=beads,
        plan=plan,
        layers=witness,
        sha256=files.sha256,
        section_tolerance_mm=gates.section_tolerance_mm(job.config),
    )
    summary = program_summary(program, job.config)
    summary.to_csv(job.folder.path / "program.csv", index=False)
    job.record["files"] = files
    job.record["program"] = {
        "checks": [asdict(check) for check in checks],
        "witness": witness.backend,
        "totals": {c: float(summary[c].sum()) for c in TOTALS},
    }
    return checks
