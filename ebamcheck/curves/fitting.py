"""The fit: from contours to curves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ebamcheck.backend import Progress
from ebamcheck.config import Config, CurveSettings
from ebamcheck.curves.bulge import bulges
from ebamcheck.curves.cleaning import clean
from ebamcheck.curves.columns import Curves
from ebamcheck.curves.interpolation import interpolate
from ebamcheck.curves.splitting import LINE, split
from ebamcheck.errors import GeometryError, SettingsError
from ebamcheck.layers import Layers

LAYERS_A_STEP = 256
"""Layers fitted between two reports of progress; bounds the working memory, too."""

DEFAULTS = CurveSettings()


def fit(
    layers: Layers,
    method: str = "paper",
    settings: CurveSettings = DEFAULTS,
    progress: Progress | None = None,
    **changes: Any,
) -> Curves:
    """Fit curves to the contours of a stack.

    Contours are cleaned, split at their corners into straight and curved runs, and every curved run
    gets a cubic B-spline that goes through its points; a ring without a split becomes one closed curve
    without a kink. Rings too small for the cleaning tolerances stay polylines.

    Contours traced from pixels turn by 45 or 90 degrees at every vertex, so that all of it is corners:
    by default they come back as the polylines they are. With ``collinear_mm`` of about the pixel size
    the staircase goes before the corners are looked for.

    Parameters
    ----------
    layers
        The contours.
    method
        ``"paper"``: centripetal clamped interpolation (Section 3.2, equations 5 to 10).
    settings
        Corner angle and cleaning tolerances.
    progress
        Called with the number of layers finished since the last call.
    **changes
        Single settings in place of those in `settings`, as ``corner_angle_deg=150``.

    Raises
    ------
    SettingsError
        If the method or a setting is unknown or out of range.
    GeometryError
        If a contour point is not finite.
    """
    if method not in METHODS:
        raise SettingsError(f"curve method {method!r} is unknown: choose one of {', '.join(METHODS)}")
    checked = Config(curves=settings).changed(curves=changes).curves
    _check_finite(layers)
    blocks = []
    for start in range(0, max(len(layers), 1), LAYERS_A_STEP):
        stop = min(start + LAYERS_A_STEP, len(layers))
        blocks.append(METHODS[method](layers.block(start, stop), checked))
        if progress is not None and stop > start:
            progress(stop - start)
    return _join(blocks, layers, method, checked)


def _fit_paper(layers: Layers, settings: CurveSettings) -> Curves:
    cleaned = clean(
        layers.points, layers.ring_starts, layers.closed, settings.near_point_mm, settings.collinear_mm
    )
    runs = split(
        layers.points,
        cleaned,
        layers.closed,
        settings.corner_angle_deg,
        settings.straight_run_mm,
    )
    control, control_starts, knots, knot_starts = interpolate(runs)
    bulging = bulges(control, control_starts, knots, knot_starts, runs.kind) > settings.largest_bulge_mm
    if bulging.any():
        runs = runs._replace(kind=np.where(bulging, np.uint8(LINE), runs.kind))
        control, control_starts, knots, knot_starts = interpolate(runs)
    return Curves(
        heights=layers.heights,
        layer_starts=layers.layer_starts,
        ring_starts=runs.ring_starts,
        closed=layers.closed,
        kind=runs.kind,
        control_starts=control_starts,
        control=control,
        knot_starts=knot_starts,
        knots=knots,
    )


METHODS: dict[str, Callable[[Layers, CurveSettings], Curves]] = {"paper": _fit_paper}
"""Fits by name; each takes a block of layers and returns its curves."""


def _check_finite(layers: Layers) -> None:
    bad = np.flatnonzero(~np.isfinite(layers.points).all(axis=1))
    if bad.size:
        ring = int(np.searchsorted(layers.ring_starts, bad[0], side="right")) - 1
        layer = int(np.searchsorted(layers.layer_starts, ring, side="right")) - 1
        raise GeometryError(
            f"layer {layer} (z = {layers.heights[layer]:g} mm), ring {ring}: point {layers.points[bad[0]].tolist()} "
            "is not finite; slice the part anew"
        )


def _join(blocks: list[Curves], layers: Layers, method: str, settings: CurveSettings) -> Curves:
    """Put blocks of one stack together again, under the labels of its layers."""

    def starts(name: str) -> np.ndarray[Any, np.dtype[np.int64]]:
        sizes = np.concatenate([np.diff(getattr(block, name)) for block in blocks])
        return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)

    return Curves(
        heights=layers.heights,
        layer_starts=layers.layer_starts,
        ring_starts=starts("ring_starts"),
        closed=layers.closed,
        kind=np.concatenate([block.kind for block in blocks]),
        control_starts=starts("control_starts"),
        control=np.concatenate([block.control for block in blocks]),
        knot_starts=starts("knot_starts"),
        knots=np.concatenate([block.knots for block in blocks]),
        method=method,
        settings=settings.model_dump(),
        part=layers.part,
        direction=layers.direction,
        backend=layers.backend,
    )
