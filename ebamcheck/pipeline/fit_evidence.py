"""What a run says of the evidence for its curves: figures by layer, findings, and the gate's text."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.curves import LIFTED, Curves, fit_deviation
from ebamcheck.curves.accuracy import CURVE_TOLERANCE_MM
from ebamcheck.curves.columns import Evidence
from ebamcheck.curves.evidence import CAUSES
from ebamcheck.curves.fallback import METHODS, POLYLINE
from ebamcheck.curves.stack_evidence import StackEvidence, stack_evidence
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.result import Check, Place
from ebamcheck.settings.config import Config

WHY: Mapping[str, str] = {
    "sagitta": "the mesh is no evidence for so much of a lift, or the settings allow less (curves.section_tolerance_mm)",
    "plane": "a planar facet would have moved",
    "crossing": "it crosses itself or another ring",
    "turned": "it encloses nothing, or runs the other way",
    "nesting": "it lies in another ring than its contour",
}
"""Causes of :data:`ebamcheck.curves.evidence.CAUSES` in words."""

REMEDY: Mapping[str, str] = {
    "sagitta": "give a finer mesh, or set curves.method = 'chord'",
    "plane": "lower curves.crease_angle_deg, or set curves.method = 'chord'",
    "crossing": "give a finer mesh, or lower curves.tolerance_mm",
    "turned": "give a finer mesh",
    "nesting": "give a finer mesh",
}

REFERENCE_FIGURES = ("normal_rms_mm", "normal_max_abs_mm")
"""Errors against a reference that must not be greater than the contour's."""


@dataclass(frozen=True)
class FitVerdict:
    """What speaks for the curves of a fit and what against them, and what a person has to know of it."""

    curves: Curves
    evidence: Evidence
    stack: StackEvidence | None
    """None where the part or its edges are not known."""
    reference: Mapping[str, Any] | None
    """Errors of contours and curves against a finer mesh of the part; None without one."""
    farthest_mm: float = 0.0
    """Greatest distance between curves and their contours."""
    most_mm: float = math.inf
    """How far the user lets curves lie from contours, whatever speaks for it."""

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


def judged(curves: Curves, layers: Layers, part: Part, config: Config) -> tuple[FitVerdict, pd.DataFrame]:
    """What speaks for the curves of a fit, and its table, one row a layer."""
    found = curves.evidence
    if found is None:
        raise ValueError("curves of a fit carry its evidence")
    deviation = fit_deviation(curves, layers)
    far_mm = float(deviation[["points_mm", "bulge_mm"]].to_numpy().max(initial=0.0))
    stack = stack_evidence(curves, layers, part, found) if found.known else None
    verdict = FitVerdict(curves, found, stack, None, far_mm, largest_move_mm(config))
    return verdict, columns(verdict, deviation)


def columns(verdict: FitVerdict, deviation: pd.DataFrame) -> pd.DataFrame:
    """The table of the fit with what speaks for it, one row a layer.

    Adds ``allowed_mm`` (mean of what is allowed), ``lift_mm`` (mean lift), ``chord_rings``, ``polyline_rings`` and
    ``open_rings`` (rings that fell back, or that nothing was found for).
    """
    of_ring, found = verdict.curves.ring_layer, verdict.evidence
    count = len(verdict.curves)
    table = deviation.copy()

    def rings(which: Any) -> Any:
        return np.bincount(of_ring[which], minlength=count)

    allowed = np.zeros(count)
    np.maximum.at(allowed, of_ring, found.mean_limit_mm)
    table["allowed_mm"] = allowed
    table["lift_mm"] = 0.0 if verdict.stack is None else verdict.stack.lift_mm
    for fallen, name in enumerate(METHODS):
        if fallen:
            table[f"{name}_rings"] = rings(found.method == fallen)
    table["open_rings"] = rings(~found.accepted)
    return table


def findings(verdict: FitVerdict) -> Iterator[Check]:
    """Rings that fell back, by cause, and what no method was found for."""
    found = verdict.evidence
    if not found.known:
        yield Check.finding(
            "note",
            "curves-not-lifted",
            "the contours do not lie on the edges of the part's mesh, and so the curves follow them as they are",
            remedy="slice with an exact method",
        )
    for number, cause in enumerate(CAUSES):
        rings = np.flatnonzero((found.cause == number) & (found.method > 0))
        if not number or not rings.size:
            continue
        worst = int(rings[np.argmax((found.value_mm - found.limit_mm)[rings])])
        plain = int((found.method[rings] == POLYLINE).sum())
        distance = cause in ("sagitta", "plane")
        yield Check.finding(
            "note",
            "curve-fell-back",
            f"{rings.size} of {found.cause.size} rings fell back to a more cautious fit, {plain} of them to the contour "
            f"itself, because {WHY[cause]}",
            place=verdict.place_of(worst),
            figure=float(found.value_mm[worst]) if distance else None,
            limit=float(found.limit_mm[worst]) if distance else None,
            unit="mm" if distance else "",
            remedy=REMEDY[cause],
        )


def gate_text(verdict: FitVerdict) -> str:
    """What the gate says: how many rings are as asked, and what shuts it."""
    found = verdict.evidence
    count = found.cause.size
    fallen = [f"{int((found.method == k).sum())} by {name}" for k, name in enumerate(METHODS) if k]
    text = (
        f"{int((found.method == 0).sum())} of {count} rings by {verdict.curves.method}, {', '.join(fallen)}"
    )
    if verdict.open_rings:
        ring = int(np.flatnonzero(~found.accepted)[0])
        cause = CAUSES[int(found.cause[ring])]
        text += f"; there is no evidence for {verdict.open_rings}: first at {verdict.place_of(ring)}: {WHY[cause]}: {REMEDY[cause]}"
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
