"""The stage of the fit: curves by the chosen method and what speaks for them, beside those of the others and a reference."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.backend import Progress
from ebamcheck.curves import (
    LIFTED,
    METHODS,
    Curves,
    contour_error,
    error_reduction,
    fit_deviation,
    fit_for_program,
)
from ebamcheck.curves.accuracy import CURVE_TOLERANCE_MM
from ebamcheck.curves.columns import Evidence
from ebamcheck.curves.gate import CAUSES, StackEvidence, stack_evidence
from ebamcheck.curves.gate import METHODS as FALLBACKS
from ebamcheck.curves.lifting import with_edges
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.pipeline.tables import Table
from ebamcheck.result import Place
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part

# Causes of `ebamcheck.curves.gate.CAUSES` in words, and what to do
TOLD: Mapping[str, tuple[str, str]] = {
    "sagitta": ("the mesh is no evidence for so much of a lift, or the settings allow less (curves.section_tolerance_mm)",
                "give a finer mesh, or set curves.method = 'chord'"),
    "plane": ("a planar facet would have moved", "lower curves.crease_angle_deg, or set curves.method = 'chord'"),
    "crossing": ("it crosses itself or another ring", "give a finer mesh, or lower curves.tolerance_mm"),
    "turned": ("it encloses nothing, or runs the other way", "give a finer mesh"),
    "nesting": ("it lies in another ring than its contour", "give a finer mesh"),
}  # fmt: skip

REFERENCE_FIGURES = ("normal_rms_mm", "normal_max_abs_mm")  # must not be greater than the contour's


@dataclass(frozen=True)
class FitVerdict:
    """What speaks for the curves of a fit and what against them, and what a person has to know of it."""

    curves: Curves
    evidence: Evidence
    stack: StackEvidence | None  # none where the part or its edges are not known
    # Errors of contours and curves against a finer mesh of the part; None without one
    reference: Mapping[str, Any] | None
    farthest_mm: float = 0.0  # greatest distance between curves and their contours
    most_mm: float = math.inf  # how far the user lets curves lie from contours, whatever speaks for it

    @property
    def open_rings(self) -> int:
        """Rings that no method was found for."""
        return int((~self.evidence.accepted).sum())

    @property
    def worse(self) -> list[str]:
        """Errors against the reference that are greater than the contour's, in words."""
        if self.reference is None:
            return []
        before, after = self.reference["contour"], self.reference["curve"]
        return [
            f"{name.removesuffix('_mm').replace('_', ' ')} {after[name]:.4f} mm, that of the contours is {before[name]:.4f} mm"
            for name in REFERENCE_FIGURES
            if after[name] > before[name] + CURVE_TOLERANCE_MM
        ]

    @property
    def faults(self) -> int:
        """What shuts the gate: rings, layers and errors."""
        layers = 0
        if self.stack is not None:
            layers = int(((self.stack.jump_excess_mm > 0.0) | (self.stack.volume_excess_mm3 > 0.0)).sum())
        return self.open_rings + layers + len(self.worse) + (self.farthest_mm > self.most_mm)

    def place_of(self, ring: int) -> str:
        """Layer, height and place of a ring."""
        layer = int(np.searchsorted(self.curves.layer_starts, ring, side="right")) - 1
        x, y = (float(v) for v in self.evidence.at[ring])  # noqa: PD008
        return str(Place(layer=layer, cut_mm=float(self.curves.heights[layer]), x_mm=x, y_mm=y))


def largest_move_mm(config: Config) -> float:
    """How far a user lets a curve lie from its contour: the largest lift or bulge, and what fit and cleaning may move."""
    curves = config.curves
    if curves.method in LIFTED:
        return curves.largest_lift_mm + curves.tolerance_mm + curves.near_point_mm
    return curves.largest_bulge_mm + curves.near_point_mm + curves.collinear_mm


def fitted(
    layers: Layers, part: Part, config: Config, error_bound_mm: float, progress: Progress | None = None
) -> tuple[FitVerdict, pd.DataFrame]:
    """Fit contours by the method of the settings and judge the fit; with its table, one row a layer."""
    curves = fit_for_program(layers, config.curves, part, "", error_bound_mm, progress)
    return judged(curves, layers, part, config)


def judged(curves: Curves, layers: Layers, part: Part, config: Config) -> tuple[FitVerdict, pd.DataFrame]:
    """What speaks for the curves of a fit, and its table, one row a layer."""
    found, deviation = _evidence(curves), fit_deviation(curves, layers)
    far_mm = float(deviation[["points_mm", "bulge_mm"]].to_numpy().max(initial=0.0))
    stack = stack_evidence(curves, layers, part, found) if found.known else None
    verdict = FitVerdict(curves, found, stack, None, far_mm, largest_move_mm(config))
    return verdict, columns(verdict, deviation)


def columns(verdict: FitVerdict, deviation: pd.DataFrame) -> pd.DataFrame:
    """The table of the fit with what speaks for it, one row a layer: adds `allowed_mm` (greatest mean of what is allowed),
    `lift_mm` (mean lift), `polyline_rings` (rings that fell back) and `open_rings` (that nothing was found for)."""
    of_ring, found = verdict.curves.ring_layer, verdict.evidence
    count = len(verdict.curves)
    table = deviation.copy()

    def rings(which: Any) -> Any:
        return np.bincount(of_ring[which], minlength=count)

    allowed = np.zeros(count)
    np.maximum.at(allowed, of_ring, found.mean_limit_mm)
    table["allowed_mm"] = allowed
    table["lift_mm"] = 0.0 if verdict.stack is None else verdict.stack.lift_mm
    for fallen, name in enumerate(FALLBACKS):
        if fallen:
            table[f"{name}_rings"] = rings(found.method == fallen)
    table["open_rings"] = rings(~found.accepted)
    return table


def gate_text(verdict: FitVerdict) -> str:
    """What the gate says: how many rings are as asked, and what shuts it."""
    found = verdict.evidence
    count = found.cause.size
    fallen = [f"{int((found.method == k).sum())} by {name}" for k, name in enumerate(FALLBACKS) if k]
    asked = f"{int((found.method == 0).sum())} of {count} rings by {verdict.curves.method}"
    text = ", ".join([asked, *fallen])
    if verdict.open_rings:
        ring = int(np.flatnonzero(~found.accepted)[0])
        cause = CAUSES[int(found.cause[ring])]
        text += f"; there is no evidence for {verdict.open_rings}: first at {verdict.place_of(ring)}: {': '.join(TOLD[cause])}"
    stack = verdict.stack
    if stack is not None and not stack.accepted:
        k = int(np.argmax(np.maximum(stack.jump_excess_mm, stack.volume_excess_mm3)))
        text += (
            f"; layer {k + 1}, z = {verdict.curves.heights[k]:.3f} mm, does not agree with the one below or with the mesh "
            "between them: set curves.method = 'chord'"
        )
    if verdict.farthest_mm > verdict.most_mm:
        text += (
            f"; curves leave their contours by {verdict.farthest_mm:.4f} mm, over {verdict.most_mm:.4f} mm: give a finer mesh, "
            "or raise curves.largest_lift_mm"
        )
    if verdict.worse:
        text += (
            f"; farther from the reference than the contours: {'; '.join(verdict.worse)}: lower curves.tolerance_mm, "
            "or set curves.method = 'surface' or 'chord'"
        )
    return text


# -- beside other methods and a reference ------------------------------------------------------------


@dataclass(frozen=True)
class FitResult:
    """The curves of a run with what speaks for them, beside those of the other methods."""

    verdict: FitVerdict
    points: int  # points of the contours
    # By method, the chosen one first: `blocks`, and how far its curves leave the contours, `max_points_mm` and `max_bulge_mm`
    methods: Mapping[str, Mapping[str, float]]
    tables: Mapping[str, Table]  # its files in a run folder

    @property
    def curves(self) -> Curves:
        """Curves by the chosen method."""
        return self.verdict.curves


def other_fits(
    layers: Layers, part: Part, config: Config, error_bound_mm: float, go_on: Callable[[], None]
) -> dict[str, Curves]:
    """Curves by the methods that were not chosen, which record and report alone ask for; `go_on` is called between them."""
    settings = config.curves
    others = [name for name in METHODS if name != settings.method]
    if "surface" in others and with_edges(layers, part, settings.near_point_mm) is None:
        others.remove("surface")
    found = {}
    for name in others:
        go_on()
        found[name] = fit_for_program(layers, settings, part, name, error_bound_mm)
    return found


def fit_result(
    verdict: FitVerdict,
    table: pd.DataFrame,
    layers: Layers,
    others: Mapping[str, Curves],
    fine: Part | None,
    go_on: Callable[[], None],
) -> FitResult:
    """Put a fit beside those of other methods, and beside a finer tessellation of the part where there is one."""
    curves = verdict.curves
    figures = {name: _figures(one) for name, one in {curves.method: curves, **others}.items()}
    tables: dict[str, Table] = {"curves.parquet": curves, "fit.csv": table}
    if fine is not None:
        found, of_reference = _against_reference(layers, {curves.method: curves, **others}, fine, go_on)
        verdict, tables = replace(verdict, reference=found), tables | of_reference
    return FitResult(verdict, len(layers.points), figures, tables)


def _evidence(curves: Curves) -> Evidence:
    if curves.evidence is None:
        raise ValueError("curves of a fit carry its evidence")
    return curves.evidence


def _figures(curves: Curves) -> dict[str, float]:
    found = _evidence(curves)
    points_mm, bulge_mm = float(found.points_mm.max(initial=0.0)), float(found.bulge_mm.max(initial=0.0))
    return {"blocks": int(curves.block_count()), "max_points_mm": points_mm, "max_bulge_mm": bulge_mm}


def _against_reference(
    layers: Layers, of_methods: Mapping[str, Curves], fine: Part, go_on: Callable[[], None]
) -> tuple[dict[str, Any], dict[str, Table]]:
    """Errors of contours and curves against the finer tessellation (paper, section 5.2); the chosen method is first."""
    truth = slice_part(fine, layers.heights)
    go_on()
    before = contour_error(layers, truth)
    of_curves = {}
    for name, curves in of_methods.items():
        go_on()
        of_curves[name] = contour_error(curves, truth)
    after = next(iter(of_curves.values()))
    both = pd.concat([before.assign(of="contour"), after.assign(of="curve")])
    tables: dict[str, Table] = {"reference.parquet": truth, "reference.csv": both}
    figures = ("polar_min_mm", "polar_max_mm", "normal_min_mm", "normal_max_mm", "normal_max_abs_mm")
    return {
        "part": {"source": Path(fine.source).name, "sha256": fine.source_sha256, "facets": len(fine.faces)},
        "contour": {f: _extreme(before[f], f) for f in figures} | _rms(before),
        "curve": {f: _extreme(after[f], f) for f in figures} | _rms(after),
        "reduction": error_reduction(before, after).to_dict(),
        "methods": {name: error_reduction(before, error).to_dict() for name, error in of_curves.items()},
        "unmatched_rings": int(before["unmatched"].sum()),
    }, tables


def _extreme(column: pd.Series[float], name: str) -> float:
    return float(column.min() if "_min_" in name else column.max())


def _rms(errors: pd.DataFrame) -> dict[str, float]:
    """Root mean square of both errors over all rings of the stack; NaN where one is defined nowhere."""
    result = {}
    for figure, rings in (("polar_rms_mm", "polar_rings"), ("normal_rms_mm", "rings")):
        known = errors[errors[figure].notna()]
        weight, squares = known[rings].sum(), (known[figure] ** 2 * known[rings]).sum()
        result[figure] = float(np.sqrt(squares / weight)) if weight else float("nan")
    return result
