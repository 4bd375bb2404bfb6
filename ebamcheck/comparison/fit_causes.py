"""Causes that move, map or round whole contours: each predicts the contours of the slicer that differs.

A fit predicts the other slicer's contours, cut at another height, scaled and turned about the middle of the part, translated, and
then offset outward. Least squares with a soft L1 loss minimise the remaining distances, so that their sum counts and not the few
largest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ebamcheck.comparison import whole_causes as systematic
from ebamcheck.comparison.outline import outline, windings
from ebamcheck.comparison.place_causes import MeshFlaws
from ebamcheck.comparison.sweep import overlap
from ebamcheck.comparison.whole_causes import Cause, Sheet, from_origin, ring_segments
from ebamcheck.geometry.nearest import distances
from ebamcheck.kernels import Bools, Floats, Ints

MOST_STEPS = 30  # most steps of the fit
SOFT = (
    0.1  # distance up to which its square counts, over the median at the start: beyond it distances count as they are
)
FARTHEST = 0.5  # largest movement of a fit, over the size of the part: contours moved farther hardly overlap, and the fit is lost
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


class FieldFit:
    """Fits over some sheets on which both slicers have contours."""

    def __init__(self, sheets: Sequence[Sheet], flaws: MeshFlaws, step_mm: float) -> None:
        self.sheets = sheets
        self.size_mm = max(float(np.hypot(*flaws.part.size[:2])), 1e-9)
        self.step_mm = step_mm
        self.places = [along(sheet.contours_a) for sheet in sheets]
        self.longest_mm = max([1e-300, *(length_mm for _, length_mm in self.places)])
        z_mm, origins = [sheet.height_mm for sheet in sheets], [sheet.origin_mm for sheet in sheets]
        self._cut = cache(lambda k, dz_mm: mesh_contours(flaws, z_mm[k] + dz_mm, origins[k]))
        self.apart_mm2 = self._left_mm2(np.zeros(6), False)

    def best(self, enough: float) -> list[Fitted]:
        """Fits of single causes, best first, and of two together where no single one explains `enough`."""
        if not self.apart_mm2 > 0.0:
            return []
        single = sorted((self.fit((name,)) for name in GROUPS), key=lambda f: -f.share)
        # Scale and rotation include a translation: if that alone explains as much, it is the one to go on from.
        near = [f for f in single if f.share >= single[0].share - NESTED]
        first = min(near, key=lambda f: len(GROUPS[f.names[0]]))
        fits = list(single)
        if PROMISING <= first.share < enough:
            bases = [first, *(f for f in single if f.names == ("translation",) and f is not first)]
            fits += [
                self.fit((*base.names, *other.names), [base.parameters, other.parameters])
                for base in bases[: 1 + (first.names[0] in ("scale", "rotation"))]
                for other in single
                if other not in bases
            ]
        return sorted(fits, key=lambda f: -f.share)

    def fit(self, names: tuple[str, ...], starts: Sequence[Floats] = ()) -> Fitted:
        """Fit some causes together, from the best of several starts."""
        free = sorted({p for name in names for p in GROUPS[name]})
        cut_again, nothing = DZ in free, np.zeros(6)
        others = [(self._left_mm2(q, cut_again), q) for q in (*starts, *self._starts(names))]
        left_mm2, near = min(others, key=lambda other: other[0], default=(math.inf, nothing))
        fits = [Fitted(names, nothing, 0.0)]
        for start in ([] if starts else [nothing]) + ([near] if left_mm2 < self.apart_mm2 else []):
            q = self._descended(start, free)
            fits.append(Fitted(names, q, 1.0 - self._left_mm2(q, cut_again) / self.apart_mm2))
        return max(fits, key=lambda f: f.share)

    def _starts(self, names: tuple[str, ...]) -> Iterator[Floats]:
        """Start values of a fit beside 0: other heights, and values estimated from areas and their centroids."""
        start = np.zeros(6)
        if "height" in names:
            for share in (0.5, -0.5, 1.0, -1.0):
                start[DZ] = share * self.step_mm
                yield start.copy()
        elif names != ("offset",):
            middle_a, area_a = centroid(sheet.contours_a for sheet in self.sheets)
            middle_b, area_b = centroid(sheet.contours_b for sheet in self.sheets)
            if "scale" in names and area_a > 0.0 and area_b > 0.0:
                start[E] = 0.5 * math.log(area_a / area_b)
            start[[TX, TY]] = middle_a - math.exp(start[E]) * middle_b
            yield start

    def _descended(self, start: Floats, free: list[int]) -> Floats:
        """Parameters of the least sum of distances; the start where the fit is lost."""
        from scipy.optimize import least_squares  # which loads when it is needed

        scale = np.array([1.0, 1.0, 1.0, self.size_mm, self.size_mm, 1.0])[free]

        def changed(by_mm: Floats) -> Floats:
            q = start.copy()
            q[free] += by_mm / scale
            return q

        def apart(by_mm: Floats) -> Floats:
            return self._distances(changed(by_mm), DZ in free)

        still = np.zeros(len(free))
        first, most_mm = np.abs(apart(still)), FARTHEST * self.size_mm
        soft_mm = SOFT * max(float(np.median(first)), 1e-3 * float(first.mean()), 1e-12)
        by_mm = least_squares(
            apart, still, bounds=(-most_mm, most_mm), loss="soft_l1", f_scale=soft_mm, max_nfev=MOST_STEPS
        ).x
        return start if np.abs(by_mm).max() >= 0.999 * most_mm else changed(by_mm)

    def _predicted(self, q: Floats, cut_again: bool) -> Iterator[Floats]:
        """Contours of each sheet by these parameters, but for the offset: of the other slicer, or the mesh cut again."""
        for k, sheet in enumerate(self.sheets):
            yield moved(self._cut(k, float(q[DZ])) if cut_again else sheet.contours_b, q)

    def _distances(self, q: Floats, cut_again: bool) -> Floats:
        """Distances of the places along the contours that differ from those predicted, mm, weighed by their lengths."""
        found = [np.zeros(1)]
        for (places, length_mm), contours in zip(self.places, self._predicted(q, cut_again), strict=True):
            rest = np.clip(beside(contours, places) - q[D], -self.size_mm, self.size_mm)
            found.append(length_mm / self.longest_mm * rest)
        return np.concatenate(found)

    def _left_mm2(self, q: Floats, cut_again: bool) -> float:
        """Area between the contours that differ and those predicted, mm2."""
        both = zip(self.sheets, self._predicted(q, cut_again), strict=True)
        return sum(gap_mm2(sheet.contours_a, b, float(q[D]), self.size_mm) for sheet, b in both)


def moved(contours: Floats, q: Floats) -> Floats:
    """Contours (S, 4) scaled, turned about the origin, and translated by the parameters of a fit."""
    c, s = math.exp(q[E]) * math.cos(q[TURN]), math.exp(q[E]) * math.sin(q[TURN])
    ends = contours.reshape(-1, 2) @ np.array([[c, s], [-s, c]]) + q[[TX, TY]]
    return np.asarray(ends.reshape(-1, 4))


def centroid(contours: Iterable[Floats]) -> tuple[Floats, float]:
    """Centroid (2,) of all solid area, mm from the origin, and that area, mm2."""
    total, moment = 0.0, np.zeros(2)
    for one in contours:
        x0, y0, x1, y1 = one.T
        cross = x0 * y1 - x1 * y0
        total += 0.5 * float(cross.sum())
        moment += [float(((x0 + x1) * cross).sum()) / 6.0, float(((y0 + y1) * cross).sum()) / 6.0]
    return (moment / total if total else moment), total


# -- Areas between contours by distances, which a fit can follow --------------------------------------------------

PLACES = 160  # places along the contours of a sheet at which distances are taken
MOST_SEGMENTS = 4000  # most segments whose winding numbers on both sides are computed, in quadratic time
ASIDE = 1e-6  # distance beside a segment, over its length, at which the winding number is computed


def along(contours: Floats) -> tuple[Floats, float]:
    """Places (N, 2) at equal steps along all contours, and the length that each represents, mm."""
    ends = contours[:, 2:] - contours[:, :2]
    extent = np.hypot(ends[:, 0], ends[:, 1])
    reach = np.cumsum(extent)
    total = float(reach[-1]) if reach.size else 0.0
    if not total > 0.0:
        return np.zeros((0, 2)), 0.0
    at = (np.arange(PLACES) + 0.5) / PLACES * total
    s = np.minimum(np.searchsorted(reach, at, side="right"), len(contours) - 1)
    t = 1.0 - (reach[s] - at) / np.maximum(extent[s], np.finfo(np.float64).tiny)
    return contours[s, :2] + t[:, None] * ends[s], total / PLACES


def beside(contours: Floats, places: Floats) -> Floats:
    """Distances (N,) mm of places (N, 2) from contours, negative inside the solid; infinite where there are none."""
    contours, places = np.ascontiguousarray(contours), np.ascontiguousarray(places)
    return np.where(windings(contours, places) > 0, -1.0, 1.0) * distances(places, contours)


def gap_mm2(a: Floats, b: Floats, offset_mm: float = 0.0, farthest_mm: float = math.inf) -> float:
    """Area between contours `a` and `b`, the latter offset outward: distances, at most the farthest, times lengths."""
    total = 0.0
    for one, other, outward_mm in ((a, b, -offset_mm), (b, a, offset_mm)):
        places, length_mm = along(one)
        apart = np.abs(beside(other, places) + outward_mm)
        total += 0.5 * length_mm * float(np.minimum(apart, farthest_mm).sum())
    return total


def share_explained(sheets: Sequence[Sheet], guess: Callable[[Sheet], Floats]) -> float:
    """Share of the difference that is explained if these are the contours (S, 4) of the slicer that differs, 0 .. 1."""
    before = sum(gap_mm2(sheet.contours_a, sheet.contours_b) for sheet in sheets)
    after = sum(gap_mm2(sheet.contours_a, guess(sheet)) for sheet in sheets)
    return max(1.0 - after / before, 0.0) if before > 0.0 else 0.0


def mesh_contours(flaws: MeshFlaws, height_mm: float, origin_mm: tuple[float, float]) -> Floats:
    """Section of the mesh, from an origin; where bodies overlap, without the segments that lie inside another body."""
    segments = from_origin(flaws.section(height_mm), origin_mm)
    if flaws.bodies > 1 and len(segments) <= MOST_SEGMENTS:
        middle, way = 0.5 * (segments[:, :2] + segments[:, 2:]), segments[:, 2:] - segments[:, :2]
        aside = ASIDE * np.column_stack([-way[:, 1], way[:, 0]])
        left, right = windings(segments, middle + aside) > 0, windings(segments, middle - aside) > 0
        segments = segments[left != right]
    return segments


def field_cause(name: str, fitted: Fitted, share: float, origin_mm: tuple[float, float]) -> Cause:
    """Name one cause with its size."""
    q = fitted.parameters
    if name == "offset":
        text = f"constant offset of {abs(q[D]):.4g} mm {'outward' if q[D] > 0.0 else 'inward'}"
        return Cause(systematic.OFFSET, float(q[D]), "mm", text, share)
    if name == "translation":
        text = f"translation by ({q[TX]:.4g}, {q[TY]:.4g}) mm"
        return Cause(systematic.TRANSLATION, math.hypot(q[TX], q[TY]), "mm", text, share)
    if name == "height":
        text = f"wrong height: cut {abs(q[DZ]):.4g} mm too {'high' if q[DZ] > 0.0 else 'low'}"
        return Cause(systematic.HEIGHT, float(q[DZ]), "mm", text, share)
    factor, cosine, sine = math.exp(q[E]), math.cos(q[TURN]), math.sin(q[TURN])
    linear = factor * np.array([[cosine, -sine], [sine, cosine]])
    centre = np.linalg.lstsq(np.eye(2) - linear, q[[TX, TY]], rcond=None)[0] + origin_mm
    about = f"about ({centre[0]:.3f}, {centre[1]:.3f}) mm"
    if name == "rotation":
        degrees = math.degrees(q[TURN])
        text = f"rotation by {degrees:.4g} degrees {about}"
        return Cause(systematic.ROTATION, degrees, "degrees", text, share)
    if words := unit_of(factor):
        return unit_cause(words, factor, share)
    return Cause(systematic.SCALE, factor, "", f"scale by {factor:.6g} {about}", share)


# -- Mirrors and quarter turns, units, winding rules, grids ------------------------------------------------------

# Quarter turns with their angles, and mirrors with the direction that is reversed (x, y, or both exchanged)
Turn = tuple[str, float, tuple[tuple[int, int], tuple[int, int]]]
TURNS: tuple[Turn, ...] = (
    (systematic.ROTATION, 180.0, ((-1, 0), (0, -1))),
    (systematic.ROTATION, 90.0, ((0, -1), (1, 0))),
    (systematic.ROTATION, -90.0, ((0, 1), (-1, 0))),
    (systematic.MIRROR, 0.0, ((-1, 0), (0, 1))),
    (systematic.MIRROR, 90.0, ((1, 0), (0, -1))),
    (systematic.MIRROR, 45.0, ((0, 1), (1, 0))),
    (systematic.MIRROR, 135.0, ((0, -1), (-1, 0))),
)
MIRRORED = {0.0: "X", 90.0: "Y", 45.0: "X and Y exchanged", 135.0: "X and Y exchanged with their signs"}

# Units that are mistaken for one another, and how many of the second make one of the first
LENGTHS = (
    ("inches", "millimetres", 25.4), ("centimetres", "millimetres", 10.0), ("metres", "millimetres", 1000.0),
    ("feet", "millimetres", 304.8), ("inches", "centimetres", 2.54),
)  # fmt: skip
# Factors by which a part is too large if its unit was mistaken
UNITS: dict[str, float] = {
    f"{one} taken for {other}": factor
    for long, short, ratio in LENGTHS
    for one, other, factor in ((long, short, 1.0 / ratio), (short, long, ratio))
}
UNIT_SHARE = 0.005  # largest relative difference of a scale from the factor of a unit that it is mistaken for

# Winding rules other than the default, winding > 0
RULES: dict[str, Callable[[Ints], Bools]] = {
    "odd": lambda w: w % 2 == 1,
    "winding != 0": lambda w: w != 0,
    "1..1": lambda w: w == 1,
    "winding > 1": lambda w: w > 1,
}
MOST_PIECES = 2000  # most pieces of a sheet's difference at which winding numbers are computed, the largest
CELLS = 23  # rows and columns of places at which a rule is checked against the whole section
MOST_WRONG = 0.02  # largest share of the solid at which a rule may be wrong, because of places on contours

LEAST_GAP_MM = 1e-7  # coordinates nearer to each other than this are the same
GRID_SHARE = 1e-3  # largest distance of coordinates from a grid, over its step
GRID_POINTS = 4  # fewest different coordinates that a grid must have


def turned_over(sheets: Sequence[Sheet]) -> Cause:
    """A mirroring, or a turn by 90 or 180 degrees, about any centre."""
    middle_a, _ = centroid(sheet.contours_a for sheet in sheets)
    middle_b, _ = centroid(sheet.contours_b for sheet in sheets)

    def share(turn: Turn) -> float:
        def guess(sheet: Sheet) -> Floats:
            ends = (sheet.contours_b.reshape(-1, 2) - middle_b) @ np.array(turn[2]).T + middle_a
            order = [2, 3, 0, 1] if turn[0] == systematic.MIRROR else [0, 1, 2, 3]
            return np.asarray(ends.reshape(-1, 4)[:, order])

        return round(share_explained(sheets, guess), 3)  # of the turns that explain as much, the first

    explained, (kind, angle, linear) = max(((share(t), t) for t in TURNS), key=lambda found: found[0])
    if kind == systematic.ROTATION:
        return Cause(systematic.ROTATION, angle, "degrees", f"rotation by {angle:g} degrees", explained)
    text = f"mirrored: {MIRRORED[angle]}"
    if angle in (0.0, 90.0):
        axis = int(angle == 90.0)
        shift = (middle_a - np.array(linear) @ middle_b)[axis]
        text += f" about {'xy'[axis]} = {0.5 * shift + sheets[0].origin_mm[axis] + 0.0:.3f} mm"
    return Cause(systematic.MIRROR, angle, "degrees", text, explained)


def wrong_unit(sheets: Sequence[Sheet], flaws: MeshFlaws) -> Cause:
    """Another unit of the whole part, its height included: all of it larger by a factor from the file's origin."""

    def share(factor: float) -> float:
        def guess(sheet: Sheet) -> Floats:
            section = factor * mesh_contours(flaws, sheet.height_mm / factor, (0.0, 0.0))
            return from_origin(section, sheet.origin_mm)

        return share_explained(sheets, guess)

    shares = {words: share(factor) for words, factor in UNITS.items()}
    words = max(shares, key=lambda w: shares[w])
    return unit_cause(words, UNITS[words], shares[words])


def unit_cause(words: str, factor: float, share: float) -> Cause:
    """Make the cause for a mistaken unit."""
    return Cause(systematic.UNIT, factor, "", f"wrong unit: {words}, {factor:.6g} times too large", share)


def unit_of(factor: float) -> str:
    """The mistaken unit that gives this scale; empty if there is none."""
    near = (words for words, known in UNITS.items() if abs(math.log(factor / known)) < UNIT_SHARE)
    return next(near, "")


def other_rule(sheets: Sequence[Sheet], flaws: MeshFlaws) -> Cause | None:
    """Another rule for the winding numbers that are solid, found in the pieces in which the two slicers differ.

    It must hold in the whole section, too, not only where the slicers differ.
    """
    whole, explained, wrong = 0.0, np.zeros(len(RULES)), np.zeros(len(RULES))
    for sheet in sheets:
        # Winding numbers are those of all segments, also of those inside of another body.
        mesh = from_origin(flaws.section(sheet.height_mm), sheet.origin_mm)
        other = outline(sheet.b, 0, sheet.origin_mm)
        y0, y1, l0, l1, r0, r1 = overlap(sheet.outline_a, other, True).difference.T[:6]
        left, right = 0.5 * (l0 + l1), 0.5 * (r0 + r1)
        area = np.abs(right - left) * (y1 - y0)
        whole += float(area.sum())
        largest = np.argsort(-area, kind="stable")[:MOST_PIECES]
        places = np.column_stack([0.5 * (left + right), 0.5 * (y0 + y1)])[largest]
        in_a, in_b = (windings(c, places) > 0 for c in (sheet.contours_a, sheet.contours_b))
        numbers = windings(mesh, places)
        as_mesh = ((numbers > 0) == in_b) & (in_a != in_b)
        explained += [area[largest][as_mesh & (rule(numbers) == in_a)].sum() for rule in RULES.values()]
        if len(mesh):
            low, high = mesh.reshape(-1, 2).min(axis=0), mesh.reshape(-1, 2).max(axis=0)
            steps = low + (high - low) * ((np.arange(CELLS) + 0.5) / CELLS)[:, None]
            places = np.ascontiguousarray(np.stack(np.meshgrid(*steps.T), axis=-1).reshape(-1, 2))
            numbers, in_a = windings(mesh, places), windings(sheet.contours_a, places) > 0
            for k, rule in enumerate(RULES.values()):
                solid = rule(numbers)
                either = int((solid | in_a).sum())
                wrong[k] += float((solid != in_a).sum() / either) if either else 1.0
    if not whole > 0.0:
        return None
    explained[wrong > MOST_WRONG * len(sheets)] = 0.0
    best = int(np.argmax(explained))
    text = f"other winding rule: solid is {list(RULES)[best]} where the other takes winding > 0"
    return Cause(systematic.WINDING_RULE, float(best), "", text, float(explained[best]) / whole)


def coarse_grid(sheets: Sequence[Sheet]) -> Cause | None:
    """Coordinates rounded to a grid, or to single precision, where those of the other slicer are not."""
    values = np.unique(np.concatenate([sheet.a.points for sheet in sheets]))
    other = np.unique(np.concatenate([sheet.b.points for sheet in sheets]))
    if values.size < GRID_POINTS:
        return None

    def share(rounded: Callable[[Floats], Floats]) -> float:
        return share_explained(sheets, lambda s: from_origin(rounded(ring_segments(s.b)), s.origin_mm))

    def single(numbers: Floats) -> Floats:
        return numbers.astype(np.float32).astype(np.float64)

    step = _grid_step(values)
    if step > 0.0:
        if other.size and _on_grid(other, step, values[0]):
            return None
        # Grids mostly go through zero; the offset of another one is known up to whole steps.
        shift = values[0] - step * float(np.round(values[0] / step))
        shift = 0.0 if abs(shift) < GRID_SHARE * step else shift

        def snapped(way: Callable[[Floats], Floats]) -> float:
            return share(lambda ends: way((ends - shift) / step) * step + shift)

        text = f"coordinates are rounded to a grid of {step:.6g} mm"
        explained = max(snapped(way) for way in (np.round, np.floor, np.ceil, np.trunc))
        return Cause(systematic.QUANTISATION, step, "mm", text, explained)
    if np.array_equal(single(values), values) and not np.array_equal(single(other), other):
        step = float(np.spacing(np.float32(np.abs(values).max())))
        text = f"coordinates are rounded to single precision, {step:.3g} mm at the largest"
        return Cause(systematic.QUANTISATION, step, "mm", text, share(single))
    return None


def _grid_step(values: Floats) -> float:
    """Step of the grid on which ascending values lie; 0 if there is none."""
    gaps = np.diff(values)
    gaps = gaps[gaps > LEAST_GAP_MM]
    if gaps.size < GRID_POINTS:
        return 0.0
    # The smallest gap has few significant digits; the range of all values has more.
    near = values - values[0]
    for parts in (1, 2, 3, 4, 5, 6):
        step = rough = float(gaps.min()) / parts
        if rough < 2.0 * LEAST_GAP_MM:
            break
        if not np.round(near[-1] / rough):
            continue
        for far in np.geomspace(rough, near[-1], 12):
            within = near[(near <= far * 1.000001) & (near > 0.0)]
            if within.size:
                step = float(within[-1] / max(np.round(within[-1] / step), 1.0))
        if _on_grid(values, step, values[0]):
            return float(f"{step:.12g}")
    return 0.0


def _on_grid(values: Floats, step: float, first: float) -> bool:
    """Whether values lie on a grid through one of them."""
    count = (values - first) / step
    return bool((np.abs(count - np.round(count)) <= GRID_SHARE).all())


# -- The simplest causes that explain about as much as any --------------------------------------------------------

ENOUGH = 0.9  # share of a difference from which a single cause is enough
ALL = 0.98  # share of a difference from which a cause leaves nothing to look for
LEAST = 0.1  # least share of a difference that one cause among several must explain
AS_WELL = 0.01  # causes whose shares differ by less than this cannot be told apart on these layers


def contour_causes(sheets: list[Sheet], flaws: MeshFlaws, step_mm: float) -> list[Cause]:
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
    first = _fitted_causes(near[0], fits, origin_mm)
    if fewest == 1:
        # Scale and rotation include a translation: if that alone is enough, they are not causes.
        other = [] if near[0].names == ("translation",) else near[1:]
        also = tuple(_fitted_causes(f, fits, origin_mm)[0].text for f in other)
        first = [replace(first[0], also=also)]
    return first


def _fitted_causes(fitted: Fitted, fits: Sequence[Fitted], origin_mm: tuple[float, float]) -> list[Cause]:
    """Name the causes of a fit; of two, the stronger gets the share that it explains alone, if that is over half of it."""
    alone = {f.names[0]: f.share for f in fits if len(f.names) == 1}
    names = sorted(fitted.names, key=lambda n: -alone.get(n, 0.0))
    shares = [fitted.share]
    if len(names) == 2:
        first = min(alone.get(names[0], 0.0), fitted.share)
        shares = [first, fitted.share - first] if first > 0.5 * fitted.share else [0.5 * fitted.share] * 2
    return [field_cause(name, fitted, share, origin_mm) for name, share in zip(names, shares, strict=True)]
