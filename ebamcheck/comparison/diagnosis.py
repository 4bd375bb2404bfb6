"""Systematic causes of the difference between two slicers, each with its size and the share that it explains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ebamcheck.comparison.fit_causes import (
    GROUPS,
    FieldFit,
    Fitted,
    coarse_grid,
    field_cause,
    other_rule,
    turned_over,
    wrong_unit,
)
from ebamcheck.comparison.place_causes import MeshFlaws
from ebamcheck.comparison.sheets import Reader, Sheet, sample, total_mm2
from ebamcheck.comparison.sources import LayerSource
from ebamcheck.comparison.whole_causes import Cause, layer_causes, ring_causes
from ebamcheck.kernels import Floats, Ints

ENOUGH = 0.9  # share of a difference from which a single cause is enough
ALL = 0.98  # share of a difference from which a cause leaves nothing to look for
# Least share of a difference that the causes together must explain to be named: noise, too, fits some cause by chance, and a scale
# that explains 51 % fits a square that has lost a corner
NAMED = 0.55
LEAST = 0.1  # least share of a difference that one cause among several must explain
AS_WELL = 0.01  # causes whose shares differ by less than this cannot be told apart on these layers
LARGE = 1.5  # factor of size from which sections differ by their unit


def diagnose(
    a: LayerSource, b: LayerSource, differing: Ints, heights: Floats, areas: Floats, rings: Ints, flaws: MeshFlaws,
    origin_mm: tuple[float, float],
) -> tuple[Cause, ...]:  # fmt: skip
    """Systematic causes of the differences of slicer `a` from slicer `b`, the one that explains most first; none for noise.

    They differ on the layers `differing` (n,), rising; heights (L,), areas and numbers of closed rings (2, L) are of all layers, those
    of `a` first. At most :data:`~ebamcheck.comparison.sheets.MOST_SHEETS` layers are examined, from an origin in the part's middle.
    """
    reader_b = Reader(b)
    solid = differing[rings[0, differing] > 0]
    sheets = sample(solid, rings.sum(axis=0), heights, Reader(a), reader_b, origin_mm)
    unit = _unit(sheets, flaws)
    if unit is not None:
        return (unit,)
    causes, left = layer_causes(sheets, differing, areas, rings, reader_b)
    remains = max(1.0 - sum(cause.share for cause in causes), 0.0)
    if left and remains > LEAST:
        step_mm = float(np.median(np.diff(heights))) if heights.size > 1 else 1.0
        causes += [cause.scaled(remains) for cause in _in_sheets(left, flaws, step_mm)]
    causes = sorted((c for c in causes if c.share >= LEAST), key=lambda c: -c.share)
    return tuple(causes) if sum(c.share for c in causes) >= NAMED else ()


def cause_of(causes: Sequence[Cause], layer: int) -> Cause | None:
    """The cause that explains most, of those that affect a layer; None if there is none."""
    return next((cause for cause in causes if cause.layers is None or layer in cause.layers), None)


def _unit(sheets: Sequence[Sheet], flaws: MeshFlaws) -> Cause | None:
    """A mistaken unit of the whole part, which also changes the section at each height."""
    solid = [sheet for sheet in sheets if sheet.both_solid]
    areas = [[float(np.abs(stack.ring_areas).sum()) for stack in (sheet.a, sheet.b)] for sheet in solid]
    ratios = [of_a / max(of_b, 1e-300) for of_a, of_b in areas]
    if not ratios or 1.0 / LARGE < math.sqrt(float(np.median(ratios))) < LARGE:
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
    others = [grid, turned_over(sheets), other_rule(sheets, flaws)] if best < ALL else [grid]
    most = max((c for c in others if c is not None), key=lambda c: c.share, default=None)
    if most is not None and most.share > best + AS_WELL:
        return [most]
    if best < LEAST:
        return []
    near = [f for f in fits if f.share >= best - AS_WELL]
    fewest, plainest_first = min(len(f.names) for f in near), list(GROUPS)
    near = [f for f in near if len(f.names) == fewest]
    near.sort(key=lambda f: sum(map(plainest_first.index, f.names)))
    origin_mm = sheets[0].origin_mm
    first = _named(near[0], fits, origin_mm)
    if fewest == 1:
        # Scale and rotation include a translation: if that alone is enough, they are not causes.
        other = [] if near[0].names == ("translation",) else near[1:]
        also = tuple(_named(f, fits, origin_mm)[0].text for f in other)
        first = [replace(first[0], also=also)]
    return first


def _named(fitted: Fitted, fits: Sequence[Fitted], origin_mm: tuple[float, float]) -> list[Cause]:
    """Name the causes of a fit; of two, the stronger gets the share that it explains alone, if that is over half of it."""
    alone = {f.names[0]: f.share for f in fits if len(f.names) == 1}
    names = sorted(fitted.names, key=lambda n: -alone.get(n, 0.0))
    shares = [fitted.share]
    if len(names) == 2:
        first = min(alone.get(names[0], 0.0), fitted.share)
        shares = [first, fitted.share - first] if first > 0.5 * fitted.share else [0.5 * fitted.share] * 2
    return [field_cause(name, fitted, share, origin_mm) for name, share in zip(names, shares, strict=True)]
