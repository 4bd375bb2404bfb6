"""The stage of the fit: curves by the chosen method, beside those of the others, and later against a reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.curves import METHODS, Curves, contour_error, error_reduction, fit_deviation, fit_for_program
from ebamcheck.curves.edges import with_edges
from ebamcheck.layer_numbers import numbered
from ebamcheck.layers import files as layer_files
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.pipeline import fit_evidence
from ebamcheck.pipeline.fit_evidence import FitVerdict
from ebamcheck.pipeline.work import Job
from ebamcheck.slicers.slicing import slice_part


@dataclass(frozen=True)
class MethodFigures:
    """What a fit takes, and how far it leaves the contours."""

    blocks: int
    max_points_mm: float
    """Greatest distance of a contour's points from the curve."""
    max_bulge_mm: float
    """Greatest distance of the curve from the contour."""


@dataclass(frozen=True)
class FitResult:
    """The curves of a run with what speaks for them, beside those of the other methods."""

    verdict: FitVerdict
    table: pd.DataFrame
    """One row a layer (`fit.csv`)."""
    points: int
    """Points of the contours."""
    methods: Mapping[str, MethodFigures]
    """Figures by method; those of the chosen one are first."""
    of_methods: Mapping[str, Curves] = field(repr=False)
    """Curves by method; the chosen one's are first. None any more when they were held against the reference."""

    @property
    def curves(self) -> Curves:
        """Curves by the chosen method."""
        return self.verdict.curves


def fitted(job: Job, layers: Layers, error_bound_mm: float) -> FitResult:
    """Fit the contours by the chosen method, and measure the fit.

    What is found of the part's surface is to be kept meanwhile (:func:`~ebamcheck.curves.per_part.surface_kept`), and until
    the fits of the other methods are made.
    """
    settings, told = job.config.curves, job.observer.advance
    with job.stage("fit", len(layers)):
        curves = fit_for_program(layers, settings, job.part, "", error_bound_mm, told)
        curves.to_parquet(job.folder.path / "curves.parquet")
        verdict, table = fit_evidence.judged(curves, layers, job.part, job.config)
        numbered(table).to_csv(job.folder.path / "fit.csv", index=False)
        figures = {curves.method: _figures(curves, table)}
    job.add_finding(*fit_evidence.findings(verdict))
    return FitResult(verdict, table, len(layers.points), figures, {curves.method: curves})


def beside_others(job: Job, layers: Layers, fit_result: FitResult, error_bound_mm: float) -> FitResult:
    """The same fit beside those of the other methods.

    Nothing but the record and the report asks for them, so that they are worked out beside the program.
    """
    with job.beside("other fits"):
        others = _other_fits(job, layers, error_bound_mm)
        figures = {name: _figures(other, fit_deviation(other, layers)) for name, other in others.items()}
    return replace(
        fit_result,
        methods={**fit_result.methods, **figures},
        of_methods={**fit_result.of_methods, **others},
    )


def held_against(job: Job, layers: Layers, fit_result: FitResult, fine: Part | None) -> FitResult:
    """The same fit with the errors of contours and curves against the reference, where there is one.

    Nothing but the gate of the fit asks for it, so that it is worked out beside the program.
    """
    verdict = fit_result.verdict
    if fine is not None:
        with job.beside("reference"):
            found = _against_reference(job, layers, fit_result.of_methods, fine)
            verdict = replace(verdict, reference=found)
    return replace(fit_result, verdict=verdict, of_methods={})


def _other_fits(job: Job, layers: Layers, error_bound_mm: float) -> dict[str, Curves]:
    """Curves by the methods that were not chosen, to be compared with those of the one that was."""
    settings = job.config.curves
    others = [name for name in METHODS if name != settings.method]
    if "surface" in others and with_edges(layers, job.part, settings.near_point_mm) is None:
        others.remove("surface")
    found = {}
    for name in others:
        job.go_on()
        found[name] = fit_for_program(layers, settings, job.part, name, error_bound_mm)
    return found


def _figures(curves: Curves, deviation: pd.DataFrame) -> MethodFigures:
    return MethodFigures(
        blocks=int(curves.block_count()),
        max_points_mm=float(deviation["points_mm"].max()),
        max_bulge_mm=float(deviation["bulge_mm"].max()),
    )


def _against_reference(
    job: Job, layers: Layers, of_methods: Mapping[str, Curves], fine: Part
) -> dict[str, Any]:
    """Errors of contours and curves against the finer tessellation (paper, section 5.2); the chosen method is first."""
    truth = slice_part(fine, layers.heights)
    layer_files.write_parquet(truth, job.folder.path / "reference.parquet")
    job.go_on()
    before = contour_error(layers, truth)
    of_curves = {}
    for name, curves in of_methods.items():
        job.go_on()
        of_curves[name] = contour_error(curves, truth)
    after = next(iter(of_curves.values()))
    numbered(pd.concat([before.assign(of="contour"), after.assign(of="curve")])).to_csv(
        job.folder.path / "reference.csv", index=False
    )
    figures = ("polar_min_mm", "polar_max_mm", "normal_min_mm", "normal_max_mm", "normal_max_abs_mm")
    return {
        "part": {"source": Path(fine.source).name, "sha256": fine.source_sha256, "facets": len(fine.faces)},
        "contour": {f: _extreme(before[f], f) for f in figures} | _rms(before),
        "curve": {f: _extreme(after[f], f) for f in figures} | _rms(after),
        "reduction": error_reduction(before, after).to_dict(),
        "methods": {name: error_reduction(before, error).to_dict() for name, error in of_curves.items()},
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
