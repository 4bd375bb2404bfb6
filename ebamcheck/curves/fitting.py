"""The fit: from contours to curves."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ebamcheck.backend import Progress
from ebamcheck.curves.columns import Curves, joined, of_layers
from ebamcheck.curves.gate import Slack, gated
from ebamcheck.curves.interpolation import CENTRIPETAL, CHORD_LENGTH, bulges, interpolate
from ebamcheck.curves.lifting import Lifting, Limits, with_edges
from ebamcheck.curves.oriented_contours import FLAT_MM, as_they_are, orient
from ebamcheck.curves.runs import LINE, CleanRings, clean, split
from ebamcheck.curves.segments import curves_of, reduced_segments, smooth_segments
from ebamcheck.errors import GeometryError, SettingsError
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.settings.config import Config
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.surface.part_surface import once_a_part, surface_of
from ebamcheck.surface.planes import coordinate_error_mm

LAYERS_A_STEP = 256  # Layers fitted between two reports of progress; also bounds the working memory

METHODS = ("bounded", "surface", "chord", "paper")
LIFTED = ("bounded", "surface")  # Methods that lift the points of contours where they can

DEFAULTS = CurveSettings()


def fit(
    layers: Layers,
    method: str = "bounded",
    settings: CurveSettings = DEFAULTS,
    progress: Progress | None = None,
    part: Part | None = None,
    largest_mm: float = math.inf,
    **changes: Any,
) -> Curves:
    """Fit curves to the contours of a stack.

    ``"bounded"``
        The fewest lines, arcs and cubics within `tolerance_mm` of the ``surface`` curve, joined without a kink.
    ``"surface"``
        A cubic from each point to the next, after the points were lifted from the straight edges of the mesh to
        the curved edges of the surface that it approximates. Creases of the mesh (`crease_angle_deg`) are the corners;
        flat facets stay exact. Needs the part, and contours that carry their edges (those of `planecut` do).
    ``"chord"``
        As ``paper``, with parameter steps by chord length: rounder than any other, but one point out of line has a wider effect.
    ``"paper"``
        Clamped centripetal interpolation of runs between corners of under `corner_angle_deg` (paper, section 3.2,
        equations 5 to 10). Its points lie on the chords of the mesh, so the curve keeps the chord error.

    Without part or edges ``bounded`` follows the contour itself; its corners are then those of the paper. Contours
    traced from pixels are first freed of their staircase by ``collinear_mm`` of about the pixel size.

    Parameters
    ----------
    layers
        The contours.
    method
        One of :data:`METHODS`.
    settings
        Corner and crease angles, tolerances.
    progress
        Called with the number of layers finished since the last call.
    part
        The mesh that was sliced, for ``surface`` and ``bounded``.
    largest_mm
        Distance from its contour beyond which a ring falls back, whatever speaks for it.
    **changes
        Single settings that replace those in `settings`, such as ``tolerance_mm=0.05``.

    Returns
    -------
    Curves
        Curves of the same layers and rings, with the evidence for each ring.

    Raises
    ------
    SettingsError
        If the method or a setting is unknown or out of range, if ``surface`` lacks the part or edges, or if the
        layers were cut from another part.
    GeometryError
        If a contour point is not finite.

    Examples
    --------
    The side of a ball is a circle again, though its mesh is coarse:

    >>> from ebamcheck_models import MODELS
    >>> part = MODELS["sphere"].tessellate(0.2)
    >>> from ebamcheck.slicers.slicing import slice_part
    >>> layers = slice_part(part, [0.5])
    >>> curves = fit(layers, part=part)
    >>> len(layers.points) > 20, curves.block_count() < 5
    (True, True)
    """
    if method not in METHODS:
        raise SettingsError(f"curve method {method!r} is unknown: choose one of {', '.join(METHODS)}")
    checked = Config(curves=settings).changed(curves=changes).curves
    _check_finite(layers)
    part = _part_of(layers, part)
    known = None if part is None else with_edges(layers, part, checked.near_point_mm)
    lifting = None if part is None or known is None else _lifting_of(part, checked)
    if lifting is None and method == "surface" and len(layers.points):
        slicer = layers.backend or "their slicer"
        lacking = "part=" if part is None else f"contours on the edges of the part: those of {slicer} are not"
        raise SettingsError(f"curve method 'surface' needs {lacking}: use 'bounded', or slice with planecut")
    contours = layers if known is None else known
    blocks = []
    for start in range(0, max(len(layers), 1), LAYERS_A_STEP):
        stop = min(start + LAYERS_A_STEP, len(layers))
        block = contours.block(start, stop)
        curves = ungated(method, block, checked, lifting)
        blocks.append(_accepted(curves, block, checked, lifting, largest_mm))
        if progress is not None and stop > start:
            progress(stop - start)
    return replace(
        joined(blocks),
        method=method,
        settings=checked.model_dump(),
        part=layers.part,
        direction=layers.direction,
        backend=layers.backend,
    )


def fit_for_program(
    layers: Layers,
    settings: CurveSettings,
    part: Part | None = None,
    method: str = "",
    error_bound_mm: float = 0.0,
    progress: Progress | None = None,
) -> Curves:
    """Fit contours as :func:`fit` does, for a program: no curve leaves its contour by more than the program's path may.

    `error_bound_mm` is the slicer's own error, such as a staircase of pixels: what it makes of a contour is no shape.
    """
    settings = settings.model_copy(update={"collinear_mm": max(settings.collinear_mm, error_bound_mm)})
    name, largest_mm = method or settings.method, settings.section_tolerance_mm
    return fit(layers, name, settings, progress, part, largest_mm=largest_mm)


def _part_of(layers: Layers, part: Part | None) -> Part | None:
    """The part that layers were cut from: the one given, else the mesh that the layers refer to."""
    if part is None:
        return layers.mesh
    if layers.part and layers.part != part.sha256:
        other = f"layers were cut from another mesh than {part.name!r}"
        raise SettingsError(f"{other}: give the part that was sliced")
    return part


@once_a_part
def _lifting_of(part: Part, settings: CurveSettings) -> Lifting:
    """Lifting of a part, kept so that the mesh is judged only once when layers are fitted one by one."""
    return Lifting(surface_of(part, settings), max(FLAT_MM, 4.0 * coordinate_error_mm(part)))


def ungated(method: str, layers: Layers, settings: CurveSettings, lifting: Lifting | None) -> Curves:
    """Curves of a block of layers before the gate."""
    if lifting is not None and method in LIFTED:
        contours = orient(*lifting.lifted_rings(layers), layers.closed, settings)
    else:
        near_mm, collinear_mm = settings.near_point_mm, settings.collinear_mm
        cleaned = clean(layers.points, layers.ring_starts, layers.closed, near_mm, collinear_mm)
        if method not in LIFTED:
            power = CENTRIPETAL if method == "paper" else CHORD_LENGTH
            return _interpolated(layers, cleaned, settings, power)
        sides = as_they_are(np.ascontiguousarray(layers.points)[cleaned.rows])
        # A segment may bulge by half of the gate's limit; the rest is left for the cleaning.
        contours = orient(sides, cleaned.starts, layers.closed, settings, 0.5 * settings.largest_bulge_mm)
    segments = smooth_segments(contours, layers.closed)
    if method == "bounded":
        segments = reduced_segments(segments, settings.tolerance_mm)
    return curves_of(segments, layers)


def _interpolated(layers: Layers, cleaned: CleanRings, settings: CurveSettings, power: float) -> Curves:
    """Splines through the points of runs; those that bulge too far are lines."""
    corner_deg, straight_mm = settings.corner_angle_deg, settings.straight_run_mm
    runs = split(layers.points, cleaned, layers.closed, corner_deg, straight_mm)
    control, knots = interpolate(runs, power)
    bulging = bulges(control, knots, runs.kind) > settings.largest_bulge_mm
    if bulging.any():
        runs = runs._replace(kind=np.where(bulging, np.uint8(LINE), runs.kind))
        control, knots = interpolate(runs, power)
    return of_layers(layers, runs.ring_starts, runs.kind, control, knots)


def _accepted(
    curves: Curves, layers: Layers, settings: CurveSettings, lifting: Lifting | None, largest_mm: float
) -> Curves:
    """Curves of a block of layers, and polylines in place of rings that the gate does not accept."""
    cleaning_mm = settings.near_point_mm + settings.collinear_mm
    slack_mm = settings.tolerance_mm + cleaning_mm
    if lifting is None:
        free = np.full(len(layers.points), settings.largest_bulge_mm)
        limits, rounding_mm = Limits(free, np.zeros(len(layers.points), np.bool_)), 0.0
    else:
        limits, rounding_mm = lifting.allowed(layers), lifting.flat_mm
    limits = limits._replace(of_point=np.minimum(limits.of_point, max(largest_mm - slack_mm, 0.0)))
    curves = gated(curves, layers, limits, Slack(slack_mm, cleaning_mm + rounding_mm))
    if lifting is None and curves.evidence is not None:
        curves = replace(curves, evidence=replace(curves.evidence, known=False))
    return curves


def _check_finite(layers: Layers) -> None:
    bad = np.flatnonzero(~np.isfinite(layers.points).all(axis=1))
    if bad.size:
        ring = int(np.searchsorted(layers.ring_starts, bad[0], side="right")) - 1
        layer = int(np.searchsorted(layers.layer_starts, ring, side="right")) - 1
        raise GeometryError(
            f"layer {layer + 1} (z = {layers.heights[layer]:g} mm), ring {ring}: point {layers.points[bad[0]].tolist()} "
            "is not finite; slice the part anew"
        )
