"""Fit of causes that move whole contours: offset, translation, height, scale and rotation, one or two at a time.

The model: the contours of the slicer that differs are those of the other one, cut at another height, scaled and rotated
about the middle of the part, translated, and then offset outward. The remaining distances between the two are minimised by
iteratively reweighted least squares (Gauss-Newton), so that their sum counts and not the few largest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ebamcheck.comparison.causes import MeshFlaws
from ebamcheck.comparison.diagnosis.sheets import Sheet
from ebamcheck.comparison.outline import Outline
from ebamcheck.geometry.nearest import SegmentTree, nearest_segment, tree_over
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints

PLACES = 160
"""Places along the contours of each sheet."""

STEPS = 10
"""Most steps of the fit."""

SETTLED = 1e-3
"""Step, relative to the parameters, below which the fit has converged."""

FARTHEST = 0.5
"""Largest movement of a fit, over the size of the part; beyond it the fit is lost, as contours moved so far hardly overlap."""

NESTED = 0.01
"""Least gain in the share explained for which a fit with more parameters is preferred."""

PROMISING = 0.3
"""Share that a single cause must explain before two together are tried."""

D, TX, TY, E, TURN, DZ = range(6)
"""Parameters: offset mm, translation mm, logarithm of the scale, angle rad, height mm."""

GROUPS: dict[str, tuple[int, ...]] = {
    "translation": (TX, TY),
    "offset": (D,),
    "height": (DZ,),
    "scale": (E, TX, TY),
    "rotation": (TURN, TX, TY),
}
"""Parameters of each cause that is fitted: scale and rotation have a centre, which needs a translation."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fit: which causes, their parameters, and the share of the difference that they explain."""

    names: tuple[str, ...]
    parameters: Floats
    share: float


@dataclass(eq=False)
class Seen:
    """One sheet, with what the fit reads of it."""

    sheet: Sheet
    flaws: MeshFlaws

    @cached_property
    def a(self) -> SegmentTree:
        """Contours that differ."""
        return contours_of(self.sheet.outline_a)

    @cached_property
    def b(self) -> SegmentTree:
        """Contours of the other slicer."""
        return contours_of(self.sheet.outline_b)

    @cached_property
    def _moved(self) -> dict[float, tuple[SegmentTree, Floats]]:
        return {}

    @cached_property
    def places_a(self) -> tuple[Floats, float]:
        """Places along `a` (N, 2) mm, and the length that each represents, mm."""
        return along(self.a, PLACES)

    def reference(self, dz_mm: float, moving: bool) -> tuple[SegmentTree, Floats | None]:
        """Contours that the model moves onto `a`: those of `b`, or the mesh's at another height, with their rates."""
        if not moving:
            return self.b, None
        if dz_mm not in self._moved:
            self._moved[dz_mm] = mesh_contours(self.flaws, self.sheet.height_mm + dz_mm, self.sheet.origin_mm)
        return self._moved[dz_mm]


class FieldFit:
    """Fits over some sheets on which both slicers have contours."""

    def __init__(self, sheets: Sequence[Sheet], flaws: MeshFlaws, step_mm: float) -> None:
        self.seen = [Seen(sheet, flaws) for sheet in sheets]
        self.size_mm = max(float(np.hypot(*flaws.part.size[:2])), 1e-9)
        self.step_mm = step_mm
        self.apart_mm2 = self._left(np.zeros(6), False)

    def best(self, enough: float) -> list[Fitted]:
        """Fits of single causes, best first, and of two together where no single one explains `enough`."""
        if not self.apart_mm2 > 0.0:
            return []
        single = sorted((self.fit((name,)) for name in GROUPS), key=lambda f: -f.share)
        # Scale and rotation include a translation: if that alone explains as much, it is the one to go on from.
        first = min(
            (f for f in single if f.share >= single[0].share - NESTED), key=lambda f: len(GROUPS[f.names[0]])
        )
        found = list(single)
        if PROMISING <= first.share < enough:
            bases = [first, *(f for f in single if f.names == ("translation",) and f is not first)]
            found += [
                self.fit((*base.names, *other.names), [base.parameters, other.parameters])
                for base in bases[: 1 + (first.names[0] in ("scale", "rotation"))]
                for other in single
                if other not in bases
            ]
        return sorted(found, key=lambda f: -f.share)

    def fit(self, names: tuple[str, ...], starts: Sequence[Floats] = ()) -> Fitted:
        """Fit some causes together, from several starts."""
        free = sorted({p for name in names for p in GROUPS[name]})
        moving = DZ in free
        nothing = np.zeros(6)
        others = [
            (self._left(start, moving), k, start) for k, start in enumerate((*starts, *self._starts(names)))
        ]
        best = Fitted(names, nothing, 0.0)
        chosen = [nothing] if not starts else []
        if others and min(others)[0] < self.apart_mm2:
            chosen.append(min(others)[2])
        for start in chosen:
            q = self._descended(start, free)
            share = 1.0 - self._left(q, moving) / self.apart_mm2
            if share > best.share:
                best = replace(best, parameters=q, share=share)
        return best

    def _starts(self, names: tuple[str, ...]) -> Iterator[Floats]:
        """Further start values of a fit: other heights, and values estimated from areas and their centroids."""
        if "height" in names:
            for share in (0.5, -0.5, 1.0, -1.0):
                start = np.zeros(6)
                start[DZ] = share * self.step_mm
                yield start
            return
        if names == ("offset",):
            return
        middle_a, area_a = self._middle("a")
        middle_b, area_b = self._middle("b")
        start = np.zeros(6)
        if "scale" in names and area_a > 0.0 and area_b > 0.0:
            start[E] = 0.5 * math.log(area_a / area_b)
        start[[TX, TY]] = middle_a - math.exp(start[E]) * middle_b
        yield start

    def _middle(self, which: str) -> tuple[Floats, float]:
        """Centroid of all solid area, from the origin, and that area."""
        total, moment = 0.0, np.zeros(2)
        for one in self.seen:
            x0, y0, x1, y1 = getattr(one, which).segments.T
            cross = x0 * y1 - x1 * y0
            total += 0.5 * float(cross.sum())
            moment += [float(((x0 + x1) * cross).sum()) / 6.0, float(((y0 + y1) * cross).sum()) / 6.0]
        return (moment / total if total else moment), total

    def _descended(self, start: Floats, free: list[int]) -> Floats:
        """Parameters after the steps of the fit."""
        q = start.copy()
        scale = np.array([1.0, 1.0, 1.0, self.size_mm, self.size_mm, 1.0])[free]
        for _ in range(STEPS):
            rows, rest, weights = self._system(q, DZ in free)
            if not rest.size:
                return q
            spread = max(float(np.median(np.abs(rest))), 1e-3 * float(np.abs(rest).mean()), 1e-12)
            root = np.sqrt(weights / np.maximum(np.abs(rest), spread))
            step, *_ = np.linalg.lstsq(rows[:, free] / scale * root[:, None], -rest * root, rcond=1e-9)
            q[free] += step / scale
            if np.abs((q - start)[free] * scale).max() > FARTHEST * self.size_mm:
                return start
            if np.abs(step).max() <= SETTLED * np.abs(q[free] * scale).max():
                break
        return q

    def _system(self, q: Floats, moving: bool) -> tuple[Floats, Floats, Floats]:
        """Derivatives (N, 6), residuals (N,) mm and lengths (N,) of the places along the contours that differ."""
        rows, rests, weights = [], [], []
        for one in self.seen:
            places, length = one.places_a
            contours, rate = one.reference(float(q[DZ]), moving)
            if not len(contours.segments) or not len(places):
                continue
            back = _moved_back(places, q)
            near = beside(contours, back)
            scale = math.exp(q[E])
            row = np.zeros((len(places), 6))
            n = near.normal
            row[:, D] = -1.0
            row[:, TX], row[:, TY] = -_turned(n, q[TURN]).T
            row[:, E] = -scale * (n * back).sum(axis=1)
            row[:, TURN] = -scale * (n[:, 1] * back[:, 0] - n[:, 0] * back[:, 1])
            row[:, DZ] = 0.0 if rate is None else -scale * rate[near.segment]
            rows.append(row)
            rests.append(scale * near.distance_mm - q[D])
            weights.append(np.full(len(places), length))
        if not rows:
            return np.zeros((0, 6)), np.zeros(0), np.zeros(0)
        return np.concatenate(rows), np.concatenate(rests), np.concatenate(weights)

    def _left(self, q: Floats, moving: bool) -> float:
        """Area between the contours and the model's, mm2: distances times lengths, measured from both."""
        total = 0.0
        for one in self.seen:
            places, length = one.places_a
            contours, _ = one.reference(float(q[DZ]), moving)
            there, there_length = along(contours, PLACES)
            if not len(places) or not len(there):
                total += self.size_mm * (length * len(places) + there_length * len(there))
                continue
            rest = math.exp(q[E]) * beside(contours, _moved_back(places, q)).distance_mm - q[D]
            again = beside(one.a, _moved(there, q)).distance_mm + q[D]
            total += 0.5 * (length * float(np.abs(rest).sum()))
            total += 0.5 * (there_length * math.exp(q[E]) * float(np.abs(again).sum()))
        return total


def scaled_section(flaws: MeshFlaws, factor: float) -> Callable[[Sheet], SegmentTree]:
    """Sections of a part that was read in another unit: all of it larger by a factor from the file's origin."""

    def contours(sheet: Sheet) -> SegmentTree:
        section, _ = mesh_contours(flaws, sheet.height_mm / factor, (0.0, 0.0))
        return contours_over(factor * section.segments - np.array([*sheet.origin_mm, *sheet.origin_mm]))

    return contours


def share_of(sheets: Sequence[Sheet], predicted: Callable[[Sheet], SegmentTree]) -> float:
    """Share of the difference that is explained if these are the contours of the slicer that differs."""
    before = after = 0.0
    for sheet in sheets:
        a, b, guess = contours_of(sheet.outline_a), contours_of(sheet.outline_b), predicted(sheet)
        if not len(guess.segments):
            return 0.0
        before += _gap(a, b)
        after += _gap(a, guess)
    return max(1.0 - after / before, 0.0) if before > 0.0 else 0.0


def _gap(a: SegmentTree, b: SegmentTree) -> float:
    """Area between two contours, mm2: distances times lengths, measured from both."""
    total = 0.0
    for one, other in ((a, b), (b, a)):
        places, length = along(one, PLACES)
        total += 0.5 * length * float(np.abs(beside(other, places).distance_mm).sum()) if len(places) else 0.0
    return total


def _turned(points: Floats, angle_rad: float) -> Floats:
    """Points (N, 2) turned about the origin, counter-clockwise."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turned: Floats = points @ np.array([[c, s], [-s, c]])
    return turned


def _moved(points: Floats, q: Floats) -> Floats:
    """Points of the other slicer, moved to those of the slicer that differs, except for the offset."""
    moved: Floats = math.exp(q[E]) * _turned(points, q[TURN]) + q[[TX, TY]]
    return moved


def _moved_back(points: Floats, q: Floats) -> Floats:
    """Points of the slicer that differs, moved back to those of the other, except for the offset."""
    return _turned(points - q[[TX, TY]], -q[TURN]) / math.exp(q[E])


# -- Signed distances from contours given as segments in any order, with the solid on their left ---------------


STEEPEST = 1e4
"""Largest movement of a contour per mm of height: at a level facet it would be infinite."""

MOST_SEGMENTS = 4000
"""Most segments for which the winding number on both sides is computed, which takes quadratic time."""

ASIDE = 1e-6
"""Distance beside a segment, over its length, at which the winding number is computed."""


class Near(NamedTuple):
    """Distances of places from contours."""

    distance_mm: Floats
    """(N,) distance from the contours, negative inside the solid."""
    normal: Floats
    """(N, 2) outward direction, the gradient of the distance."""
    segment: Ints
    """(N,) nearest segment."""


def contours_of(outline: Outline) -> SegmentTree:
    """Closed rings of an outline."""
    if int(outline.rings) == len(outline.paths) - 1:
        return outline.tree
    return contours_over(outline.segments[: outline.paths[outline.rings]])


def contours_over(segments: Floats) -> SegmentTree:
    """Contours of segments (S, 4) that lie in any order."""
    return tree_over(np.ascontiguousarray(segments, np.float64).reshape(-1, 4))


def mesh_contours(
    flaws: MeshFlaws, height_mm: float, origin_mm: tuple[float, float]
) -> tuple[SegmentTree, Floats]:
    """Section of the mesh, and the outward movement of each segment per mm of height, (S,)."""
    segments = np.ascontiguousarray(flaws.section(height_mm) - np.array([*origin_mm, *origin_mm]))
    a, b, c = np.moveaxis(flaws.part.triangles[flaws.crossing(height_mm)], 1, 0)
    normal = np.cross(b - a, c - a)
    flat = np.hypot(normal[:, 0], normal[:, 1])
    rate = -normal[:, 2] / np.maximum(flat, np.finfo(np.float64).tiny)
    rate = np.clip(np.where(flat > 0.0, rate, 0.0), -STEEPEST, STEEPEST)
    if flaws.bodies > 1 and len(segments) <= MOST_SEGMENTS:
        # Where bodies overlap, segments inside the solid of another body are no contour.
        shown = _between_solid_and_not(segments)
        segments, rate = segments[shown], rate[shown]
    return contours_over(segments), rate


def along(contours: SegmentTree, count: int) -> tuple[Floats, float]:
    """Places (N, 2) at equal steps along all contours, and the length that each represents, mm."""
    segments = contours.segments
    ends = segments[:, 2:] - segments[:, :2]
    extent = np.hypot(ends[:, 0], ends[:, 1])
    reach = np.cumsum(extent)
    total = float(reach[-1]) if reach.size else 0.0
    if not total > 0.0:
        return np.zeros((0, 2)), 0.0
    at = (np.arange(count) + 0.5) / count * total
    s = np.minimum(np.searchsorted(reach, at, side="right"), len(segments) - 1)
    t = 1.0 - (reach[s] - at) / np.maximum(extent[s], np.finfo(np.float64).tiny)
    return segments[s, :2] + t[:, None] * ends[s], total / count


def beside(contours: SegmentTree, places: Floats) -> Near:
    """Distances of places (N, 2) from contours."""
    distance, normal, segment = _beside(contours, np.ascontiguousarray(places))
    return Near(distance, normal, segment)


@kernel
def _beside(contours: SegmentTree, places: Floats) -> tuple[Floats, Floats, Ints]:
    """Distances, normals and nearest segments; see :class:`Near`."""
    segments, count = contours.segments, len(places)
    distance, normal, near = np.full(count, np.inf), np.zeros((count, 2)), np.full(count, -1)
    if len(segments) == 0:
        return distance, normal, near
    guess = -1
    for i in range(count):
        x, y = places[i, 0], places[i, 1]
        square, guess = nearest_segment(contours, x, y, guess)
        away, near[i] = math.sqrt(square), guess
        inside = winding_of(segments, x, y) > 0
        distance[i] = -away if inside else away
        ax, ay, bx, by = segments[guess, 0], segments[guess, 1], segments[guess, 2], segments[guess, 3]
        ux, uy = bx - ax, by - ay
        square = ux * ux + uy * uy
        t = 0.0
        if square > 0.0:
            t = min(max(((x - ax) * ux + (y - ay) * uy) / square, 0.0), 1.0)
        if 0.0 < t < 1.0 or away == 0.0:
            long = np.sqrt(square) if square > 0.0 else 1.0
            normal[i, 0], normal[i, 1] = uy / long, -ux / long
        else:
            sign = -1.0 if inside else 1.0
            normal[i, 0] = sign * (x - ax - t * ux) / away
            normal[i, 1] = sign * (y - ay - t * uy) / away
    return distance, normal, near


@kernel
def winding_of(segments: Floats, x: float, y: float) -> int:
    """Winding number of closed segments about (x, y), in whatever order they lie."""
    total = 0
    for i in range(len(segments)):
        if (segments[i, 1] <= y) != (segments[i, 3] <= y):
            rises = segments[i, 1] <= y
            low, high = (0, 2) if rises else (2, 0)
            across = (segments[i, high] - segments[i, low]) * (y - segments[i, low + 1])
            across -= (x - segments[i, low]) * (segments[i, high + 1] - segments[i, low + 1])
            if across < 0.0:
                total += -1 if rises else 1
    return total


@kernel
def windings(segments: Floats, places: Floats) -> Ints:
    """Winding number of closed segments about each of some places (N, 2)."""
    found = np.zeros(len(places), np.int64)
    for i in range(len(places)):
        found[i] = winding_of(segments, places[i, 0], places[i, 1])
    return found


def _between_solid_and_not(segments: Floats) -> Bools:
    """Whether each segment has solid on only one side."""
    middle, along_it = 0.5 * (segments[:, :2] + segments[:, 2:]), segments[:, 2:] - segments[:, :2]
    aside = ASIDE * np.column_stack([-along_it[:, 1], along_it[:, 0]])
    left, right = windings(segments, middle + aside) > 0, windings(segments, middle - aside) > 0
    return np.asarray(left != right)
