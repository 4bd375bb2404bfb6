"""Causes in whole layers: dropped, duplicated, or taken from another height of the stack."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ebamcheck.comparison.diagnosis.cause import DROPPED, DUPLICATED, SHIFTED, Cause
from ebamcheck.comparison.diagnosis.sheets import Reader, Sheet, apart_mm2, total_mm2
from ebamcheck.comparison.outline import outline
from ebamcheck.numeric.rings import Floats, Ints

FARTHEST_SHIFT = 5
"""Largest shift of a stack, in layers, that is recognised."""

SAME_SHARE = 0.02
"""Two layers are the same if they differ by less than this share of the difference to be explained."""


def layer_causes(
    sheets: Sequence[Sheet], differing: Ints, areas: Floats, rings: Ints, b: Reader
) -> tuple[list[Cause], list[Sheet]]:
    """Causes in whole layers, and the sheets that these do not explain.

    Parameters
    ----------
    differing
        Layers on which the two disagree.
    areas, rings
        (2, L) area, mm2, and closed rings of every layer of both, the one that differs first.
    """
    causes: list[Cause] = []
    left = list(sheets)
    empty = differing[(rings[0, differing] == 0) & (rings[1, differing] > 0)]
    if empty.size:
        share = _share(areas, rings, differing, empty)
        solid = int(np.count_nonzero(rings[1] > 0))
        text = f"dropped layers: {empty.size} of {solid} are empty, the first is layer {int(empty[0]) + 1}"
        causes.append(Cause(DROPPED, float(empty.size), "layers", text, share, frozenset(empty.tolist())))
        gone = set(empty.tolist())
        left = [sheet for sheet in left if sheet.layer not in gone]
    rest = np.setdiff1d(differing, empty)
    share = _share(areas, rings, differing, rest)
    if not left or not rest.size:
        return causes, left
    # Duplicated layers are also shifted ones: if both explain as much, they are called duplicated.
    found = [c for c in (_duplicated(left, areas, rings, rest, b), _shifted(left, areas.shape[1], b)) if c]
    if not found:
        return causes, left
    cause = max(found, key=lambda c: c.share)
    causes.append(cause.scaled(share))
    return causes, [s for s in left if cause.layers is not None and s.layer not in cause.layers]


def _share(areas: Floats, rings: Ints, differing: Ints, some: Ints) -> float:
    """Share of the solid area of the layers that differ that lies in some of these layers."""

    def weight(layers: Ints) -> float:
        return float(np.where(rings[1, layers] > 0, np.abs(areas[1, layers]), np.abs(areas[0, layers])).sum())

    whole = weight(differing)
    return weight(some) / whole if whole > 0.0 else 0.0


def _shifted(sheets: Sequence[Sheet], count: int, b: Reader) -> Cause | None:
    """Layers that equal those of the other slicer some layers higher or lower."""
    before = sum(sheet.difference_mm2 for sheet in sheets)
    best = (SAME_SHARE * before, 0)
    for shift in sorted(range(-FARTHEST_SHIFT, FARTHEST_SHIFT + 1), key=abs):
        if not shift:
            continue
        after = 0.0
        for sheet in sheets:
            k = min(max(sheet.layer + shift, 0), count - 1)
            after += apart_mm2(sheet.outline_a, outline(b.layer(k), 0, sheet.origin_mm))
            if after >= best[0]:
                break
        if after < best[0]:
            best = (after, shift)
    if not best[1] or not before > 0.0:
        return None
    way = "higher" if best[1] > 0 else "lower"
    text = f"shifted layers: each is the one {abs(best[1])} {way}"
    return Cause(SHIFTED, float(best[1]), "layers", text, 1.0 - best[0] / before)


def _duplicated(
    sheets: Sequence[Sheet], areas: Floats, rings: Ints, differing: Ints, b: Reader
) -> Cause | None:
    """Layers that repeat a neighbour although they do not in the other slicer's stack."""
    for step, which in ((-1, "below"), (1, "above")):
        source = _sources(areas[0], rings[0], step)
        again = differing[source[differing] != differing]
        if not again.size:
            continue
        concerned = set(again.tolist())
        seen = [sheet for sheet in sheets if sheet.layer in concerned]
        before = total_mm2(seen)
        after = sum(
            apart_mm2(s.outline_a, outline(b.layer(int(source[s.layer])), 0, s.origin_mm)) for s in seen
        )
        if seen and after <= SAME_SHARE * before:
            text = f"duplicated layers: {again.size} are the layer {which} again, the first is layer {int(again[0]) + 1}"
            share = again.size / differing.size
            return Cause(DUPLICATED, float(again.size), "layers", text, share, frozenset(concerned))
    return None


def _sources(areas: Floats, rings: Ints, step: int) -> Ints:
    """First layer, from below or from above, of the run of equal ones in which each lies, (L,)."""
    count = areas.size
    order = np.arange(count)[::-step]
    new = np.ones(count, np.bool_)
    one, before = order[1:], order[:-1]
    new[1:] = ~(np.isclose(areas[one], areas[before], rtol=1e-12, atol=0.0) & (rings[one] == rings[before]))
    source = np.empty(count, np.int64)
    source[order] = order[np.maximum.accumulate(np.where(new, np.arange(count), 0))]
    return source
