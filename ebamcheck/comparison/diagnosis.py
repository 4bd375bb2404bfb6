"""Systematic causes of the difference between two slicers, each with its size and the share that it explains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ebamcheck.comparison.fit_causes import (
    DZ,
    TURN,
    TX,
    TY,
    D,
    E,
    FieldFit,
    Fitted,
    coarse_grid,
    other_rule,
    turned_over,
    unit_cause,
    unit_of,
    wrong_unit,
)
from ebamcheck.comparison.place_causes import MeshFlaws
from ebamcheck.comparison.sheets import Reader, Sheet, sample, total_mm2
from ebamcheck.comparison.sources import LayerSource
from ebamcheck.comparison.whole_causes import (
    HEIGHT,
    OFFSET,
    ROTATION,
    SCALE,
    TRANSLATION,
    Cause,
    layer_causes,
    ring_causes,
)
from ebamcheck.kernels import Floats, Ints

ENOUGH = 0.9  # share of a difference from which a single cause is enough
ALL = 0.98  # share of a difference from which a cause leaves nothing to look for

NAMED = 0.55
"""Least share of a difference that the causes together must explain to be named: noise, too, fits some cause by chance, and
a scale that explains 51 % fits a square that has lost a corner."""

LEAST = 0.1  # least share of a difference that one cause among several must explain
AS_WELL = 0.01  # causes whose shares differ by less than this cannot be told apart on these layers
LARGE = 1.5  # factor of size from which sections differ by their unit


@dataclass(frozen=True, eq=False)
class Differing:
    """Layers on which two slicers disagree, and the figures of all layers of both."""

    layers: Ints
    """(n,) layers on which they disagree, rising."""
    heights: Floats
    """(L,) mm."""
    areas: Floats
    """(2, L) mm2, the slicer that differs first."""
    rings: Ints
    """(2, L) numbers of closed rings."""


def diagnose(
    a: LayerSource, b: LayerSource, found: Differing, flaws: MeshFlaws, origin_mm: tuple[float, float]
) -> tuple[Cause, ...]:
    """Find what the differences of slicer `a`, in coordinates from the part's middle, from slicer `b` have in common.

    The cause that explains most comes first; there is none if nothing explains enough of the difference. At most
    :data:`~ebamcheck.comparison.sheets.MOST_SHEETS` layers are examined.
    """
    reader_a, reader_b = Reader(a), Reader(b)
    solid = found.layers[found.rings[0, found.layers] > 0]
    sheets = sample(solid, found.rings.sum(axis=0), found.heights, reader_a, reader_b, origin_mm)
    unit = _unit(sheets, flaws)
    if unit is not None:
        return (unit,)
    causes, left = layer_causes(sheets, found.layers, found.areas, found.rings, reader_b)
    remains = max(1.0 - sum(cause.share for cause in causes), 0.0)
    if left and remains > LEAST:
        causes += [cause.scaled(remains) for cause in _in_sheets(left, flaws, _step(found.heights))]
    causes = sorted((c for c in causes if c.share >= LEAST), key=lambda c: -c.share)
    return tuple(causes) if sum(c.share for c in causes) >= NAMED else ()


def cause_of(causes: Sequence[Cause], layer: int) -> Cause | None:
    """The cause that explains most, of those that affect a layer; None if there is none."""
    return next((cause for cause in causes if cause.layers is None or layer in cause.layers), None)


def _step(heights: Floats) -> float:
    return float(np.median(np.diff(heights))) if heights.size > 1 else 1.0


def _unit(sheets: Sequence[Sheet], flaws: MeshFlaws) -> Cause | None:
    """A mistaken unit of the whole part, which also changes the section at each height."""
    solid = [sheet for sheet in sheets if sheet.both_solid]
    if not solid:
        return None
    ratios = [
        float(np.abs(s.a.ring_areas).sum() / max(float(np.abs(s.b.ring_areas).sum()), 1e-300)) for s in solid
    ]
    if 1.0 / LARGE < math.sqrt(float(np.median(ratios))) < LARGE:
        return None
    unit = wrong_unit(solid, flaws)
    return unit if unit.share >= ENOUGH else None


def _in_sheets(sheets: list[Sheet], flaws: MeshFlaws, step_mm: float) -> list[Cause]:
    """Causes in whole rings, and in the position and size of contours."""
    rule = other_rule(sheets, flaws)
    if rule is not None and rule.share >= ENOUGH:
        return [rule]
    before = total_mm2(sheets)
    causes, mended = ring_causes(sheets, LEAST)
    remains = total_mm2(mended) / before if before > 0.0 else 0.0
    solid = [sheet for sheet in mended if sheet.both_solid]
    if remains > LEAST and solid:
        causes += [cause.scaled(remains) for cause in _lying(solid, flaws, step_mm)]
    return causes


def _lying(sheets: list[Sheet], flaws: MeshFlaws, step_mm: float) -> list[Cause]:
    """Causes in position and size of matching contours: the simplest of those that explain about as much."""
    grid = coarse_grid(sheets)
    if grid is not None and grid.share >= ENOUGH:
        return [grid]
    fits = FieldFit(sheets, flaws, step_mm).best(ENOUGH)
    best = fits[0].share if fits else 0.0
    turned = turned_over(sheets) if best < ALL else None
    others = [c for c in (grid, turned, other_rule(sheets, flaws) if best < ALL else None) if c is not None]
    most = max(others, key=lambda c: c.share, default=None)
    if most is not None and most.share > best + AS_WELL:
        return [most]
    if best < LEAST:
        return []
    near = [f for f in fits if f.share >= best - AS_WELL]
    fewest = min(len(f.names) for f in near)
    near = sorted((f for f in near if len(f.names) == fewest), key=lambda f: _plainness(f))
    origin_mm = sheets[0].origin_mm
    first = _named(near[0], fits, origin_mm)
    if fewest == 1:
        # Scale and rotation include a translation: if that alone is enough, they are not causes.
        other = [] if near[0].names == ("translation",) else near[1:]
        also = tuple(_named(f, fits, origin_mm)[0].text for f in other)
        first = [replace(first[0], also=also)]
    return first


_PLAIN = ("translation", "offset", "height", "scale", "rotation")


def _plainness(fitted: Fitted) -> int:
    return sum(_PLAIN.index(name) for name in fitted.names)


def _named(fitted: Fitted, fits: Sequence[Fitted], origin_mm: tuple[float, float]) -> list[Cause]:
    """Name the causes of a fit; of two, the stronger gets the share that it explains alone, if that is over half of it."""
    alone = {f.names[0]: f.share for f in fits if len(f.names) == 1}
    names = sorted(fitted.names, key=lambda n: -alone.get(n, 0.0))
    shares = [fitted.share]
    if len(names) == 2:
        first = min(alone.get(names[0], 0.0), fitted.share)
        shares = [first, fitted.share - first] if first > 0.5 * fitted.share else [0.5 * fitted.share] * 2
    return [_field_cause(name, fitted, share, origin_mm) for name, share in zip(names, shares, strict=True)]


def _field_cause(name: str, fitted: Fitted, share: float, origin_mm: tuple[float, float]) -> Cause:
    """Name one cause with its size."""
    q = fitted.parameters
    if name == "offset":
        way = "outward" if q[D] > 0.0 else "inward"
        return Cause(OFFSET, float(q[D]), "mm", f"constant offset of {abs(q[D]):.4g} mm {way}", share)
    if name == "translation":
        x, y = float(q[TX]), float(q[TY])
        text = f"translation by ({x:.4g}, {y:.4g}) mm"
        return Cause(TRANSLATION, math.hypot(x, y), "mm", text, share)
    if name == "height":
        way = "high" if q[DZ] > 0.0 else "low"
        return Cause(HEIGHT, float(q[DZ]), "mm", f"wrong height: cut {abs(q[DZ]):.4g} mm too {way}", share)
    linear = math.exp(q[E]) * np.array(
        [[math.cos(q[TURN]), -math.sin(q[TURN])], [math.sin(q[TURN]), math.cos(q[TURN])]]
    )
    centre = np.linalg.lstsq(np.eye(2) - linear, q[[TX, TY]], rcond=None)[0] + origin_mm
    about = f"about ({centre[0]:.3f}, {centre[1]:.3f}) mm"
    if name == "rotation":
        degrees = math.degrees(q[TURN])
        return Cause(ROTATION, degrees, "degrees", f"rotation by {degrees:.4g} degrees {about}", share)
    factor = math.exp(q[E])
    if words := unit_of(factor):
        return unit_cause(words, factor, share)
    return Cause(SCALE, factor, "", f"scale by {factor:.6g} {about}", share)
