"""A systematic cause: its kind, its size, and the share of a difference that it explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.comparison.outline import Outline, outline
from ebamcheck.comparison.sources import LayerSource
from ebamcheck.comparison.sweep import overlap
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers, canonical

OFFSET = "constant offset"
TRANSLATION = "translation"
HEIGHT = "wrong height"
SCALE = "scale"
UNIT = "wrong unit"
ROTATION = "rotation"
MIRROR = "mirrored"
MISSING_OUTER, MISSING_HOLE = "missing outer rings", "missing holes"
EXTRA_OUTER, EXTRA_HOLE = "extra outer rings", "extra holes"
NESTING = "wrong nesting"
ORIENTATION = "wrong ring direction"
WINDING_RULE = "other winding rule"
QUANTISATION = "quantised coordinates"
DROPPED = "dropped layers"
DUPLICATED = "duplicated layers"
SHIFTED = "shifted layers"

# Every kind, each of which has a remedy and a meaning
KINDS = (
    OFFSET, TRANSLATION, HEIGHT, SCALE, UNIT, ROTATION, MIRROR, MISSING_OUTER, MISSING_HOLE, EXTRA_OUTER, EXTRA_HOLE,
    NESTING, ORIENTATION, WINDING_RULE, QUANTISATION, DROPPED, DUPLICATED, SHIFTED,
)  # fmt: skip


@dataclass(frozen=True)
class Cause:
    """One systematic cause of the difference between two slicers."""

    kind: str
    """One of :data:`KINDS`."""
    size: float
    """Fitted size: mm, a factor, degrees, or a number of rings or layers; of a translation its length."""
    unit: str
    text: str
    """Description with the size: ``translation by (0.120, -0.050) mm``."""
    share: float
    """Share of the difference that it explains, 0 .. 1."""
    layers: frozenset[int] | None = None
    """Layers that the cause affects; None: all on which the two differ."""
    also: tuple[str, ...] = ()
    """Descriptions of other causes that explain these layers as well: on a cylinder, scaling is the same as an offset."""
    vector_mm: tuple[float, float] | None = None
    """Translation along X and Y; None for other kinds."""

    def scaled(self, share: float) -> Cause:
        """Return the same cause with its share multiplied by `share`, as it was found in that part of a difference only."""
        return replace(self, share=self.share * share)

    def in_words(self) -> str:
        """Description of the cause, of what else it may be, and of how much it explains.

        Examples
        --------
        >>> Cause(HEIGHT, 0.05, "mm", "cut 0.05 mm too high", 0.981).in_words()
        'cut 0.05 mm too high (explains 98 % of the difference)'
        """
        other = f", or {', or '.join(self.also)}" if self.also else ""
        return f"{self.text}{other} (explains {100.0 * self.share:.0f} % of the difference)"


# -- Causes in whole layers: dropped, duplicated, or taken from another height of the stack --------------------


FARTHEST_SHIFT = 5  # largest shift of a stack, in layers, that is recognised
# Two layers are the same if they differ by less than this share of the difference to be explained
SAME_SHARE = 0.02


def layer_causes(
    sheets: Sequence[Sheet], differing: Ints, areas: Floats, rings: Ints, b: Reader
) -> tuple[list[Cause], list[Sheet]]:
    """Causes in whole layers, and the sheets that these do not explain.

    `differing` are the layers on which the two disagree; `areas`, mm2, and closed `rings` (2, L) those of every layer of both, the
    one that differs first.
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


# -- Causes in whole rings: missing or extra ones, and those with the wrong direction --------------------------


# Least likeness of two slicers' rings to be the same one: overlap of their boxes times ratio of their areas
LEAST_LIKENESS = 0.25
MOST_MATCHED = 3000  # most rings of a layer that are matched, as every one is compared with every other
# Nesting depth of a ring inside a hole: from here on a slicer derives the direction from the nesting
DEEP = 2


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
    if max(own.size, theirs.size) > MOST_MATCHED:
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


MOST_SHEETS = 12  # most layers of a pair that are examined: enough to find what they have in common
# Most rings of these layers, of both slicers together: fewer are taken where each has over 25,000, as specks of a raster may be
MOST_RINGS = 300_000
WINDOW = 32  # layers read from a file at once


@dataclass(frozen=True, eq=False)
class Sheet:
    """One layer of the slicer that differs and of the one that it is compared with, as stacks of one layer each."""

    layer: int
    height_mm: float
    a: Layers
    """Of the slicer that differs."""
    b: Layers
    """Of the other."""
    origin_mm: tuple[float, float]

    @cached_property
    def outline_a(self) -> Outline:
        """Contours of `a`, from the origin."""
        return outline(self.a, 0, self.origin_mm)

    @cached_property
    def outline_b(self) -> Outline:
        """Contours of `b`, from the origin."""
        return outline(self.b, 0, self.origin_mm)

    @cached_property
    def difference_mm2(self) -> float:
        """Area of the symmetric difference."""
        return apart_mm2(self.outline_a, self.outline_b)

    @property
    def both_solid(self) -> bool:
        """Whether both have a closed ring."""
        return bool(self.a.closed.any() and self.b.closed.any())

    def with_a(self, a: Layers) -> Sheet:
        """Return the sheet with other contours in place of those that differ."""
        return replace(self, a=a)


def apart_mm2(a: Outline, b: Outline) -> float:
    """Area of the symmetric difference of two outlines, mm2; infinite if they have too many crossings."""
    found = overlap(a, b, False)
    return float(found.symmetric_difference_mm2) if found.sound else np.inf


def total_mm2(sheets: Sequence[Sheet]) -> float:
    """Area of the symmetric difference on all sheets, mm2."""
    return float(sum(sheet.difference_mm2 for sheet in sheets))


def one_layer(height_mm: float, rings: Sequence[ArrayLike]) -> Layers:
    """Stack of one layer of closed rings."""
    arrays = [np.asarray(ring, np.float64).reshape(-1, 2) for ring in rings]
    return canonical(
        [height_mm],
        np.concatenate([np.zeros((0, 2)), *arrays]),
        np.concatenate([[0], np.cumsum([len(a) for a in arrays], dtype=np.int64)]),
        np.array([0, len(arrays)]),
        np.ones(len(arrays), np.bool_),
    )


def moved_points(layers: Layers, points: Floats, mirrored: bool = False) -> Layers:
    """The same closed rings with other points, in canonical form; reversed if the map of the points mirrors."""
    found = replace(layers, points=np.ascontiguousarray(points))
    step = -1 if mirrored else 1
    return one_layer(
        float(layers.heights[0]), [found.ring(r)[::step] for r in found.rings_of(0) if found.closed[r]]
    )


class Reader:
    """Single layers of a stack in memory or in a file, read a window at a time."""

    def __init__(self, source: LayerSource) -> None:
        self._source = source
        self._first = -1
        self._window: Layers | None = None

    def layer(self, layer: int) -> Layers:
        """One layer as a stack of its own."""
        first = layer - layer % WINDOW
        if self._window is None or first != self._first:
            stop = min(first + WINDOW, len(self._source))
            self._window = self._source.block(first, stop)
            self._first = first
        assert self._window is not None
        return self._window.block(layer - first, layer - first + 1)


def sample(
    layers: Ints, rings: Ints, heights: Floats, a: Reader, b: Reader, origin_mm: tuple[float, float]
) -> list[Sheet]:
    """Sheets of a few of the layers on which two stacks differ, spread evenly; `rings` (L,) is how many each has."""
    if not layers.size:
        return []
    # The more rings the layers have, by their median, the fewer are taken; points are not counted before a layer is read.
    typical = max(float(np.median(rings[layers])), 1.0)
    count = int(np.clip(MOST_RINGS / typical, 1, min(MOST_SHEETS, layers.size)))
    at = np.unique(np.round(np.linspace(0, layers.size - 1, count + 2)[1:-1]).astype(np.int64))
    return [Sheet(k, float(heights[k]), a.layer(k), b.layer(k), origin_mm) for k in layers[at].tolist()]
