"""Fit of causes that move whole contours: offset, translation, height, scale and rotation, one or two at a time.

The model: the contours of the slicer that differs are those of the other one, cut at another height, scaled and rotated
about the middle of the part, translated, and then offset outward. The remaining distances between the two are minimised by
least squares with a soft L1 loss, so that their sum counts and not the few largest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ebamcheck.comparison.outline import Outline, winding
from ebamcheck.comparison.place_causes import MeshFlaws
from ebamcheck.comparison.whole_causes import Sheet
from ebamcheck.geometry.nearest import distances
from ebamcheck.kernels import Bools, Floats, Ints, kernel

PLACES = 160  # places along the contours of each sheet
MOST_STEPS = 30  # most steps of the fit
# Distance up to which its square counts, over the median at the start: beyond it distances count as they are
SOFT = 0.1
# Largest movement of a fit, over the size of the part; beyond it the fit is lost, as contours moved so far hardly overlap
FARTHEST = 0.5
NESTED = 0.01  # least gain in the share explained for which a fit with more parameters is preferred
PROMISING = 0.3  # share that a single cause must explain before two together are tried
# Parameters: offset mm, translation mm, logarithm of the scale, angle rad, height mm
D, TX, TY, E, TURN, DZ = range(6)
# Parameters of each cause that is fitted: scale and rotation have a centre, which needs a translation
GROUPS: dict[str, tuple[int, ...]] = {
    "translation": (TX, TY),
    "offset": (D,),
    "height": (DZ,),
    "scale": (E, TX, TY),
    "rotation": (TURN, TX, TY),
}


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
    def a(self) -> Floats:
        """Contours that differ."""
        return contours_of(self.sheet.outline_a)

    @cached_property
    def b(self) -> Floats:
        """Contours of the other slicer."""
        return contours_of(self.sheet.outline_b)

    @cached_property
    def _moved(self) -> dict[float, Floats]:
        return {}

    @cached_property
    def places_a(self) -> tuple[Floats, float]:
        """Places along `a` (N, 2) mm, and the length that each represents, mm."""
        return along(self.a, PLACES)

    def reference(self, dz_mm: float, moving: bool) -> Floats:
        """Contours that the model moves onto `a`: those of `b`, or the mesh's at another height."""
        if not moving:
            return self.b
        if dz_mm not in self._moved:
            self._moved[dz_mm] = mesh_contours(self.flaws, self.sheet.height_mm + dz_mm, self.sheet.origin_mm)
        return self._moved[dz_mm]


class FieldFit:
    """Fits over some sheets on which both slicers have contours."""

    def __init__(self, sheets: Sequence[Sheet], flaws: MeshFlaws, step_mm: float) -> None:
        self.seen = [Seen(sheet, flaws) for sheet in sheets]
        self.size_mm = max(float(np.hypot(*flaws.part.size[:2])), 1e-9)
        self.step_mm = step_mm
        self.longest_mm = max([1e-300, *(one.places_a[1] for one in self.seen)])
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
        middle_a, area_a = centroid(one.a for one in self.seen)
        middle_b, area_b = centroid(one.b for one in self.seen)
        start = np.zeros(6)
        if "scale" in names and area_a > 0.0 and area_b > 0.0:
            start[E] = 0.5 * math.log(area_a / area_b)
        start[[TX, TY]] = middle_a - math.exp(start[E]) * middle_b
        yield start

    def _descended(self, start: Floats, free: list[int]) -> Floats:
        """Parameters of the least sum of distances; the start where the fit is lost."""
        from scipy.optimize import least_squares  # which loads when it is needed

        scale = np.array([1.0, 1.0, 1.0, self.size_mm, self.size_mm, 1.0])[free]

        def moved(change_mm: Floats) -> Floats:
            q = start.copy()
            q[free] += change_mm / scale
            return q

        def distances(change_mm: Floats) -> Floats:
            return self._distances(moved(change_mm), DZ in free)

        first = np.abs(distances(np.zeros(len(free))))
        loss_mm = SOFT * max(float(np.median(first)), 1e-3 * float(first.mean()), 1e-12)
        most_mm = FARTHEST * self.size_mm
        found = least_squares(
            distances,
            np.zeros(len(free)),
            bounds=(-most_mm, most_mm),
            loss="soft_l1",
            f_scale=loss_mm,
            max_nfev=MOST_STEPS,
        )
        lost = np.abs(found.x).max() >= 0.999 * most_mm
        return start if lost else moved(found.x)

    def _distances(self, q: Floats, moving: bool) -> Floats:
        """Distances of the places along the contours that differ from the model's, mm, weighed by their lengths."""
        found = []
        for one in self.seen:
            places, length = one.places_a
            contours = one.reference(float(q[DZ]), moving)
            if len(places):
                rest = math.exp(q[E]) * beside(contours, _moved_back(places, q)) - q[D]
                # Where the model has no contour, any is far.
                found.append(length / self.longest_mm * np.clip(rest, -self.size_mm, self.size_mm))
        return np.concatenate([np.zeros(1), *found])

    def _left(self, q: Floats, moving: bool) -> float:
        """Area between the contours and the model's, mm2: distances times lengths, measured from both."""
        total = 0.0
        for one in self.seen:
            places, length = one.places_a
            contours = one.reference(float(q[DZ]), moving)
            there, there_length = along(contours, PLACES)
            if not len(places) or not len(there):
                total += self.size_mm * (length * len(places) + there_length * len(there))
                continue
            rest = math.exp(q[E]) * beside(contours, _moved_back(places, q)) - q[D]
            again = beside(one.a, _moved(there, q)) + q[D]
            total += 0.5 * (length * float(np.abs(rest).sum()))
            total += 0.5 * (there_length * math.exp(q[E]) * float(np.abs(again).sum()))
        return total


def scaled_section(flaws: MeshFlaws, factor: float) -> Callable[[Sheet], Floats]:
    """Sections of a part that was read in another unit: all of it larger by a factor from the file's origin."""

    def contours(sheet: Sheet) -> Floats:
        section = mesh_contours(flaws, sheet.height_mm / factor, (0.0, 0.0))
        return np.asarray(factor * section - np.array([*sheet.origin_mm, *sheet.origin_mm]))

    return contours


def share_of(sheets: Sequence[Sheet], predicted: Callable[[Sheet], Floats]) -> float:
    """Share of the difference that is explained if these are the contours of the slicer that differs."""
    before = after = 0.0
    for sheet in sheets:
        a, b, guess = contours_of(sheet.outline_a), contours_of(sheet.outline_b), predicted(sheet)
        if not len(guess):
            return 0.0
        before += _gap(a, b)
        after += _gap(a, guess)
    return max(1.0 - after / before, 0.0) if before > 0.0 else 0.0


def _gap(a: Floats, b: Floats) -> float:
    """Area between two contours, mm2: distances times lengths, measured from both."""
    total = 0.0
    for one, other in ((a, b), (b, a)):
        places, length = along(one, PLACES)
        total += 0.5 * length * float(np.abs(beside(other, places)).sum()) if len(places) else 0.0
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


# Most segments for which the winding number on both sides is computed, which takes quadratic time
MOST_SEGMENTS = 4000
ASIDE = 1e-6  # distance beside a segment, over its length, at which the winding number is computed


def centroid(contours: Iterable[Floats]) -> tuple[Floats, float]:
    """Centroid (2,) of all solid area, mm from the origin, and that area, mm2."""
    total, moment = 0.0, np.zeros(2)
    for one in contours:
        x0, y0, x1, y1 = one.T
        cross = x0 * y1 - x1 * y0
        total += 0.5 * float(cross.sum())
        moment += [float(((x0 + x1) * cross).sum()) / 6.0, float(((y0 + y1) * cross).sum()) / 6.0]
    return (moment / total if total else moment), total


def contours_of(outline: Outline) -> Floats:
    """Segments (S, 4) of the closed rings of an outline."""
    return outline.segments[: outline.paths[outline.rings]]


def mesh_contours(flaws: MeshFlaws, height_mm: float, origin_mm: tuple[float, float]) -> Floats:
    """Section of the mesh, from an origin."""
    segments: Floats = flaws.section(height_mm) - np.array([*origin_mm, *origin_mm])
    if flaws.bodies > 1 and len(segments) <= MOST_SEGMENTS:
        # Where bodies overlap, segments inside the solid of another body are no contour.
        segments = segments[_between_solid_and_not(segments)]
    return segments


def along(contours: Floats, count: int) -> tuple[Floats, float]:
    """Places (N, 2) at equal steps along all contours, and the length that each represents, mm."""
    ends = contours[:, 2:] - contours[:, :2]
    extent = np.hypot(ends[:, 0], ends[:, 1])
    reach = np.cumsum(extent)
    total = float(reach[-1]) if reach.size else 0.0
    if not total > 0.0:
        return np.zeros((0, 2)), 0.0
    at = (np.arange(count) + 0.5) / count * total
    s = np.minimum(np.searchsorted(reach, at, side="right"), len(contours) - 1)
    t = 1.0 - (reach[s] - at) / np.maximum(extent[s], np.finfo(np.float64).tiny)
    return contours[s, :2] + t[:, None] * ends[s], total / count


def beside(contours: Floats, places: Floats) -> Floats:
    """Distances (N,) mm of places (N, 2) from contours, negative inside the solid; infinite where there are none."""
    places = np.ascontiguousarray(places)
    return np.where(windings(contours, places) > 0, -1.0, 1.0) * distances(places, contours)


@kernel
def windings(segments: Floats, places: Floats) -> Ints:
    """Winding number of closed segments about each of some places (N, 2)."""
    found = np.zeros(len(places), np.int64)
    for i in range(len(places)):
        found[i] = winding(segments, places[i, 0], places[i, 1])
    return found


def _between_solid_and_not(segments: Floats) -> Bools:
    """Whether each segment has solid on only one side."""
    middle, along_it = 0.5 * (segments[:, :2] + segments[:, 2:]), segments[:, 2:] - segments[:, :2]
    aside = ASIDE * np.column_stack([-along_it[:, 1], along_it[:, 0]])
    left, right = windings(segments, middle + aside) > 0, windings(segments, middle - aside) > 0
    return np.asarray(left != right)
