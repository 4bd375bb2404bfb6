"""Causes in whole rings: missing or extra ones, and those with the wrong direction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ebamcheck.comparison.diagnosis.cause import (
    EXTRA_HOLE,
    EXTRA_OUTER,
    MISSING_HOLE,
    MISSING_OUTER,
    NESTING,
    ORIENTATION,
    Cause,
)
from ebamcheck.comparison.diagnosis.sheets import Sheet, one_layer, total_mm2
from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.rings import Bools, Floats, Ints

LEAST_LIKENESS = 0.25
"""Least likeness of two slicers' rings to be the same one: overlap of their boxes times ratio of their areas."""

MOST_RINGS = 3000
"""Most rings of a layer that are matched, as every one is compared with every other."""

DEEP = 2
"""Nesting depth of a ring inside a hole: from here on a slicer derives the direction from the nesting."""


class Matched(NamedTuple):
    """Rings of both slicers on one layer."""

    missing: Ints
    """Rings of the other slicer that the slicer that differs does not have."""
    extra: Ints
    """Rings that only the slicer that differs has."""
    turned: Ints
    """Rings of the slicer that differs that have the opposite direction."""
    deep: Bools
    """Whether each of the turned rings is nested in a hole."""


def ring_causes(sheets: Sequence[Sheet], least_share: float) -> tuple[list[Cause], list[Sheet]]:
    """Causes in whole rings, and the sheets without their effect."""
    causes: list[Cause] = []
    matched = [match(sheet) for sheet in sheets]
    for kinds in ((ORIENTATION, NESTING), (MISSING_OUTER, MISSING_HOLE, EXTRA_OUTER, EXTRA_HOLE)):
        whole = total_mm2(sheets)
        if not whole > 0.0:
            break
        for kind in kinds:
            chosen = [_chosen(kind, sheet, found) for sheet, found in zip(sheets, matched, strict=True)]
            count = sum(c.size for c in chosen)
            if not count:
                continue
            mended = [_mended(kind, s, c) if c.size else s for s, c in zip(sheets, chosen, strict=True)]
            before = total_mm2(sheets)
            share = (before - total_mm2(mended)) / whole
            if share < least_share:
                continue
            causes.append(_cause(kind, count, share, sheets, chosen))
            sheets, matched = mended, [match(sheet) for sheet in mended]
    return causes, list(sheets)


def _cause(kind: str, count: int, share: float, sheets: Sequence[Sheet], chosen: Sequence[Ints]) -> Cause:
    """Make the cause for the rings of one kind."""
    concerned = [sheet.layer for sheet, rings in zip(sheets, chosen, strict=True) if rings.size]
    mean = count / len(concerned)
    text = f"{kind}: {mean:.3g} a layer"
    if kind in (ORIENTATION, NESTING):
        deep = "rings nested in a hole" if kind == NESTING else "rings"
        text = f"{kind}: {mean:.3g} {deep} a layer run the wrong way round"
    return Cause(kind, mean, "rings", text, share)


def match(sheet: Sheet) -> Matched:
    """Match the closed rings of both slicers; if some are missing and others extra, as after a shift, neither is reported."""
    a, b = sheet.a, sheet.b
    own, theirs = np.flatnonzero(a.closed), np.flatnonzero(b.closed)
    nothing = np.zeros(0, np.int64)
    if max(own.size, theirs.size) > MOST_RINGS:
        return Matched(nothing, nothing, nothing, np.zeros(0, np.bool_))
    pairs = _pairs(_likeness(a, own, b, theirs))
    missing = np.setdiff1d(theirs, theirs[pairs[:, 1]])
    extra = np.setdiff1d(own, own[pairs[:, 0]])
    if missing.size and extra.size:
        missing = extra = nothing
    first, second = own[pairs[:, 0]], theirs[pairs[:, 1]]
    turned = a.ring_areas[first] * b.ring_areas[second] < 0.0
    return Matched(missing, extra, first[turned], _depths(b)[second[turned]] >= DEEP)


def _likeness(a: Layers, own: Ints, b: Layers, theirs: Ints) -> Floats:
    """Likeness of each ring of one slicer to each of the other, (A, B) 0 .. 1."""
    box_a, box_b = a.ring_bounds[own][:, None], b.ring_bounds[theirs][None]
    low, high = np.maximum(box_a[..., :2], box_b[..., :2]), np.minimum(box_a[..., 2:], box_b[..., 2:])
    common = np.prod(np.clip(high - low, 0.0, None), axis=-1)
    size_a, size_b = (np.prod(box[..., 2:] - box[..., :2], axis=-1) for box in (box_a, box_b))
    union = size_a + size_b - common
    area_a, area_b = np.abs(a.ring_areas[own])[:, None], np.abs(b.ring_areas[theirs])[None]
    ratio = np.minimum(area_a, area_b) / np.maximum(np.maximum(area_a, area_b), np.finfo(np.float64).tiny)
    like: Floats = np.where(union > 0.0, common / np.where(union > 0.0, union, 1.0), 0.0) * ratio
    return like


def _pairs(like: Floats) -> Ints:
    """Pairs (n, 2) of rings, the most alike first, each ring once."""
    rows, columns = np.nonzero(like >= LEAST_LIKENESS)
    order = np.argsort(-like[rows, columns], kind="stable")
    used_a, used_b = np.zeros(like.shape[0], np.bool_), np.zeros(like.shape[1], np.bool_)
    found = []
    for k in order.tolist():
        i, j = int(rows[k]), int(columns[k])
        if not (used_a[i] or used_b[j]):
            used_a[i] = used_b[j] = True
            found.append((i, j))
    return np.array(found, np.int64).reshape(-1, 2)


def _depths(layers: Layers) -> Ints:
    """Number of rings around each ring, (R,)."""
    depth = np.zeros(layers.closed.size, np.int64)
    above = layers.parents.copy()
    while (above >= 0).any():
        depth += above >= 0
        above = np.where(above >= 0, layers.parents[np.maximum(above, 0)], -1)
    return depth


def _chosen(kind: str, sheet: Sheet, found: Matched) -> Ints:
    """Rings of one kind."""
    if kind in (ORIENTATION, NESTING):
        # If rings outside of holes are turned as well, the nesting is not the cause.
        nested = bool(found.turned.size) and bool(found.deep.all())
        chosen: Ints = found.turned if nested == (kind == NESTING) else found.turned[:0]
        return chosen
    rings, areas = (
        (found.missing, sheet.b.ring_areas)
        if kind in (MISSING_OUTER, MISSING_HOLE)
        else (found.extra, sheet.a.ring_areas)
    )
    of_kind: Ints = rings[(areas[rings] > 0.0) == (kind in (MISSING_OUTER, EXTRA_OUTER))]
    return of_kind


def _mended(kind: str, sheet: Sheet, rings: Ints) -> Sheet:
    """Return the sheet with these rings corrected."""
    a, own = sheet.a, [r for r in sheet.a.rings_of(0) if sheet.a.closed[r]]
    wrong = set(rings.tolist())
    if kind in (ORIENTATION, NESTING):
        made = [a.ring(r)[::-1] if r in wrong else a.ring(r) for r in own]
    elif kind in (MISSING_OUTER, MISSING_HOLE):
        made = [*(a.ring(r) for r in own), *(sheet.b.ring(r) for r in rings.tolist())]
    else:
        made = [a.ring(r) for r in own if r not in wrong]
    return sheet.with_a(one_layer(sheet.height_mm, made))
