"""Systematic causes of the difference of two slicers; sheets, by which they are found; those in whole layers and rings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.comparison.outline import Outline, outline
from ebamcheck.comparison.sources import Reader
from ebamcheck.comparison.sweep import overlap
from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.stack import Layers, from_rings

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

    kind: str  # one of `KINDS`
    size: float  # fitted size: mm, a factor, degrees, or a number of rings or layers; of a translation its length
    unit: str
    text: str  # description with the size: "translation by (0.120, -0.050) mm"
    share: float  # share of the difference that it explains, 0 .. 1
    layers: frozenset[int] | None = None  # layers that the cause affects; None: all on which the two differ
    # Descriptions of other causes that explain these layers as well: on a cylinder, scaling is the same as an offset
    also: tuple[str, ...] = ()

    def scaled(self, share: float) -> Cause:
        """Return the same cause, found in this share of a difference only."""
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


# -- Layers of two slicers side by side ---------------------------------------------------------------------------

MOST_SHEETS = 12  # most layers of a pair that are examined: enough to find what they have in common
# Most rings of these layers, of both slicers together: fewer are taken where each has over 25,000, as specks of a raster may be
MOST_RINGS = 300_000


@dataclass(frozen=True, eq=False)
class Sheet:
    """One layer of the slicer that differs, `a`, and of the one that it is compared with, as stacks of one layer each."""

    layer: int
    height_mm: float
    a: Layers
    b: Layers
    origin_mm: tuple[float, float]

    @cached_property
    def outline_a(self) -> Outline:
        """Outline of `a` from the origin."""
        return outline(self.a, 0, self.origin_mm)

    @cached_property
    def contours_a(self) -> Floats:
        """Segments (S, 4) of the closed rings of `a` from the origin."""
        return from_origin(ring_segments(self.a), self.origin_mm)

    @cached_property
    def contours_b(self) -> Floats:
        """Segments (S, 4) of the closed rings of `b` from the origin."""
        return from_origin(ring_segments(self.b), self.origin_mm)

    @cached_property
    def difference_mm2(self) -> float:
        """Area of the symmetric difference."""
        return self.apart_mm2(self.b)

    def apart_mm2(self, other: Layers) -> float:
        """Area of the symmetric difference of `a` and another layer; infinite if they have too many crossings."""
        swept = overlap(self.outline_a, outline(other, 0, self.origin_mm), False)
        return float(swept.symmetric_difference_mm2) if swept.sound else np.inf

    @property
    def both_solid(self) -> bool:
        """Whether both have a closed ring."""
        return bool(self.a.closed.any() and self.b.closed.any())

    def with_rings(self, rings: Sequence[ArrayLike]) -> Sheet:
        """Return the sheet with other closed rings in place of those of `a`."""
        return replace(self, a=from_rings([self.height_mm], [rings]))


def ring_segments(layers: Layers) -> Floats:
    """Segments (S, 4) of all closed rings: ``x0, y0, x1, y1`` with the solid on their left."""
    following = np.arange(1, len(layers.points) + 1)
    following[layers.ring_starts[1:] - 1] = layers.ring_starts[:-1]
    closed = np.repeat(layers.closed, np.diff(layers.ring_starts))
    return np.hstack([layers.points, layers.points[following]])[closed]


def from_origin(segments: Floats, origin_mm: tuple[float, float]) -> Floats:
    """The same segments (S, 4) from an origin."""
    return np.asarray(segments - np.array([*origin_mm, *origin_mm]))


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


def total_mm2(sheets: Sequence[Sheet]) -> float:
    """Area of the symmetric difference on all sheets, mm2."""
    return float(sum(sheet.difference_mm2 for sheet in sheets))


# -- Causes in whole layers: dropped, duplicated, or taken from another height of the stack --------------------

FARTHEST_SHIFT = 5  # largest shift of a stack, in layers, that is recognised
SAME_SHARE = 0.02  # layers that differ by less than this share of the difference to be explained are the same


def layer_causes(
    sheets: Sequence[Sheet], differing: Ints, areas: Floats, rings: Ints, b: Reader
) -> tuple[list[Cause], list[Sheet]]:
    """Causes in whole layers, and the sheets that these do not explain.

    The two disagree on the layers `differing`; `areas`, mm2, and closed `rings` (2, L) are of every layer of both, the one that
    differs first.
    """

    def share_of(some: Ints) -> float:
        """Share of the solid area of the layers that differ."""
        which = (rings[1] > 0).astype(np.int64), np.arange(rings.shape[1])
        solid = np.abs(areas)[which]
        whole = float(solid[differing].sum())
        return float(solid[some].sum()) / whole if whole > 0.0 else 0.0

    causes: list[Cause] = []
    empty = differing[(rings[0, differing] == 0) & (rings[1, differing] > 0)]
    if empty.size:
        solid = int(np.count_nonzero(rings[1] > 0))
        text = f"dropped layers: {empty.size} of {solid} are empty, the first is layer {int(empty[0]) + 1}"
        gone = frozenset(empty.tolist())
        causes.append(Cause(DROPPED, float(empty.size), "layers", text, share_of(empty), gone))
    left = [sheet for sheet in sheets if sheet.layer not in empty]
    rest = np.setdiff1d(differing, empty)
    if not left or not rest.size:
        return causes, left
    # Duplicated layers are also shifted ones: if both explain as much, they are called duplicated.
    both = _duplicated(left, areas[0], rings[0], rest, b), _shifted(left, rings.shape[1], b)
    cause = max((c for c in both if c), key=lambda c: c.share, default=None)
    if cause is None:
        return causes, left
    causes.append(cause.scaled(share_of(rest)))
    return causes, [s for s in left if cause.layers is not None and s.layer not in cause.layers]


def _shifted(sheets: Sequence[Sheet], count: int, b: Reader) -> Cause | None:
    """Layers that equal those of the other slicer some layers higher or lower."""
    before = total_mm2(sheets)
    least, best = SAME_SHARE * before, 0
    for shift in sorted(range(-FARTHEST_SHIFT, FARTHEST_SHIFT + 1), key=abs)[1:]:
        after = 0.0
        for sheet in sheets:
            k = min(max(sheet.layer + shift, 0), count - 1)
            after += sheet.apart_mm2(b.layer(k))
            if after >= least:
                break
        else:
            least, best = after, shift
    if not best or not before > 0.0:
        return None
    text = f"shifted layers: each is the one {abs(best)} {'higher' if best > 0 else 'lower'}"
    return Cause(SHIFTED, float(best), "layers", text, 1.0 - least / before)


def _duplicated(sheets: Sequence[Sheet], areas: Floats, rings: Ints, differing: Ints, b: Reader) -> Cause | None:
    """Layers that repeat a neighbour although they do not in the other slicer's stack; areas and rings (L,) by layer."""
    equal = np.isclose(areas[1:], areas[:-1], rtol=1e-12, atol=0.0) & (rings[1:] == rings[:-1])
    every = np.arange(areas.size)
    # First layer, from below or from above, of the run of equal ones in which each lies.
    lowest = np.maximum.accumulate(np.where(np.append(False, equal), 0, every))
    highest = np.minimum.accumulate(np.where(np.append(equal, False), areas.size, every)[::-1])[::-1]
    for source, which in ((lowest, "below"), (highest, "above")):
        again = differing[source[differing] != differing]
        seen = [sheet for sheet in sheets if sheet.layer in again]
        apart = [sheet.apart_mm2(b.layer(int(source[sheet.layer]))) for sheet in seen]
        if seen and sum(apart) <= SAME_SHARE * total_mm2(seen):
            text = (
                f"duplicated layers: {again.size} are the layer {which} again, the first is layer {int(again[0]) + 1}"
            )
            share, layers = again.size / differing.size, frozenset(again.tolist())
            return Cause(DUPLICATED, float(again.size), "layers", text, share, layers)
    return None


# -- Causes in whole rings: missing or extra ones, and those with the wrong direction --------------------------

LEAST_LIKENESS = 0.25  # least overlap of boxes times ratio of areas for two rings to be the same
MOST_MATCHED = 3000  # most rings of a layer that are matched, as every one is compared with every other
DEEP = 2  # nesting depth inside a hole: from here on a slicer derives the direction from the nesting


def ring_causes(sheets: Sequence[Sheet], least_share: float) -> tuple[list[Cause], list[Sheet]]:
    """Causes in whole rings, and the sheets without their effect."""
    causes: list[Cause] = []
    differing = [match(sheet) for sheet in sheets]
    for kinds in ((ORIENTATION, NESTING), (MISSING_OUTER, MISSING_HOLE, EXTRA_OUTER, EXTRA_HOLE)):
        whole = total_mm2(sheets)
        if not whole > 0.0:
            break
        for kind in kinds:
            wrong = [rings[kind].tolist() if kind in rings else [] for rings in differing]
            if not any(wrong):
                continue
            mended = [_mended(kind, sheet, rings) for sheet, rings in zip(sheets, wrong, strict=True)]
            share = (total_mm2(sheets) - total_mm2(mended)) / whole
            if share < least_share:
                continue
            mean = sum(map(len, wrong)) / sum(map(bool, wrong))
            turned = {ORIENTATION: " rings", NESTING: " rings nested in a hole"}.get(kind, "")
            text = f"{kind}: {mean:.3g}{turned} a layer{' run the wrong way round' if turned else ''}"
            causes.append(Cause(kind, mean, "rings", text, share))
            sheets, differing = mended, [match(sheet) for sheet in mended]
    return causes, list(sheets)


def match(sheet: Sheet) -> dict[str, Ints]:
    """Rings that differ, by kind: missing ones by their number in `b`, all others in `a`.

    If some are missing and others extra, as after a shift, neither is reported.
    """
    a, b = sheet.a, sheet.b
    own, theirs = np.flatnonzero(a.closed), np.flatnonzero(b.closed)
    if max(own.size, theirs.size) > MOST_MATCHED:
        return {}
    pairs = _pairs(_likeness(a, own, b, theirs))
    first, second = own[pairs[:, 0]], theirs[pairs[:, 1]]
    missing, extra = np.setdiff1d(theirs, second), np.setdiff1d(own, first)
    if missing.size and extra.size:
        missing = extra = np.zeros(0, np.int64)
    turned = a.ring_areas[first] * b.ring_areas[second] < 0.0
    # If rings outside of holes are turned as well, the nesting is not the cause.
    nested = bool((_depths(b)[second[turned]] >= DEEP).all())
    outer_missing, outer_extra = b.ring_areas[missing] > 0.0, a.ring_areas[extra] > 0.0
    return {
        NESTING if nested else ORIENTATION: first[turned],
        MISSING_OUTER: missing[outer_missing],
        MISSING_HOLE: missing[~outer_missing],
        EXTRA_OUTER: extra[outer_extra],
        EXTRA_HOLE: extra[~outer_extra],
    }


def _likeness(a: Layers, own: Ints, b: Layers, theirs: Ints) -> Floats:
    """Likeness of each ring of one slicer to each of the other, (A, B) 0 .. 1."""
    box_a, box_b = a.ring_bounds[own][:, None], b.ring_bounds[theirs][None]
    low, high = np.maximum(box_a[..., :2], box_b[..., :2]), np.minimum(box_a[..., 2:], box_b[..., 2:])
    common = np.prod(np.clip(high - low, 0.0, None), axis=-1)
    size_a, size_b = (np.prod(box[..., 2:] - box[..., :2], axis=-1) for box in (box_a, box_b))
    union = size_a + size_b - common
    area_a, area_b = np.abs(a.ring_areas[own])[:, None], np.abs(b.ring_areas[theirs])[None]
    ratio = np.minimum(area_a, area_b) / np.maximum(np.maximum(area_a, area_b), np.finfo(np.float64).tiny)
    return np.asarray(np.divide(common, union, out=np.zeros_like(union), where=union > 0.0) * ratio)


def _pairs(like: Floats) -> Ints:
    """Pairs (n, 2) of rings, the most alike first, each ring once."""
    rows, columns = np.nonzero(like >= LEAST_LIKENESS)
    order = np.argsort(-like[rows, columns], kind="stable")
    pairs: dict[int, int] = {}
    partners = set[int]()
    for i, j in zip(rows[order].tolist(), columns[order].tolist(), strict=True):
        if i not in pairs and j not in partners:
            pairs[i] = j
            partners.add(j)
    return np.array(list(pairs.items()), np.int64).reshape(-1, 2)


def _depths(layers: Layers) -> Ints:
    """Number of rings around each ring, (R,)."""
    depth = np.zeros(layers.closed.size, np.int64)
    above = layers.parents.copy()
    while (above >= 0).any():
        depth += above >= 0
        above = np.where(above >= 0, layers.parents[np.maximum(above, 0)], -1)
    return depth


def _mended(kind: str, sheet: Sheet, wrong: Sequence[int]) -> Sheet:
    """Return the sheet with these rings corrected."""
    if not wrong:
        return sheet
    own = np.flatnonzero(sheet.a.closed).tolist()
    if kind in (MISSING_OUTER, MISSING_HOLE):
        return sheet.with_rings([*map(sheet.a.ring, own), *map(sheet.b.ring, wrong)])
    if kind in (EXTRA_OUTER, EXTRA_HOLE):
        return sheet.with_rings([sheet.a.ring(r) for r in own if r not in wrong])
    return sheet.with_rings([sheet.a.ring(r)[::-1] if r in wrong else sheet.a.ring(r) for r in own])
