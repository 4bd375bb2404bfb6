"""Systematic causes of the difference between two slicers, each with its size and the share that it explains."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ebamcheck.comparison import sweep
from ebamcheck.comparison.fit_causes import (
    DZ,
    TURN,
    TX,
    TY,
    D,
    E,
    FieldFit,
    Fitted,
    centroid,
    contours_of,
    scaled_section,
    share_of,
    windings,
)
from ebamcheck.comparison.outline import outline
from ebamcheck.comparison.place_causes import MeshFlaws
from ebamcheck.comparison.sources import LayerSource
from ebamcheck.comparison.whole_causes import (
    HEIGHT,
    MIRROR,
    OFFSET,
    QUANTISATION,
    ROTATION,
    SCALE,
    TRANSLATION,
    UNIT,
    WINDING_RULE,
    Cause,
    Reader,
    Sheet,
    apart_mm2,
    layer_causes,
    moved_points,
    ring_causes,
    sample,
    total_mm2,
)
from ebamcheck.kernels import Bools, Floats, Ints

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
    :data:`~ebamcheck.comparison.whole_causes.MOST_SHEETS` layers are examined.
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
    return unit if unit is not None and unit.share >= ENOUGH else None


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
        return Cause(TRANSLATION, math.hypot(x, y), "mm", text, share, vector_mm=(x, y))
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


# Factors by which a part is too large if its unit was mistaken
UNITS: dict[str, float] = {
    "inches taken for millimetres": 1.0 / 25.4,
    "millimetres taken for inches": 25.4,
    "centimetres taken for millimetres": 0.1,
    "millimetres taken for centimetres": 10.0,
    "metres taken for millimetres": 0.001,
    "millimetres taken for metres": 1000.0,
    "feet taken for millimetres": 1.0 / 304.8,
    "millimetres taken for feet": 304.8,
    "inches taken for centimetres": 1.0 / 2.54,
    "centimetres taken for inches": 2.54,
}
# Largest relative difference between a scale and the factor of a unit for the scale to be a mistaken unit
UNIT_SHARE = 0.005
# Quarter turns with their angles, and mirrors with the direction that is reversed (x, y, or both exchanged)
TURNS: tuple[tuple[str, float, tuple[tuple[int, int], tuple[int, int]]], ...] = (
    (ROTATION, 180.0, ((-1, 0), (0, -1))),
    (ROTATION, 90.0, ((0, -1), (1, 0))),
    (ROTATION, -90.0, ((0, 1), (-1, 0))),
    (MIRROR, 0.0, ((-1, 0), (0, 1))),
    (MIRROR, 90.0, ((1, 0), (0, -1))),
    (MIRROR, 45.0, ((0, 1), (1, 0))),
    (MIRROR, 135.0, ((0, -1), (-1, 0))),
)

MIRRORED = {0.0: "X", 90.0: "Y", 45.0: "X and Y exchanged", 135.0: "X and Y exchanged with their signs"}

# Winding rules other than the default, winding > 0
RULES: dict[str, Callable[[Ints], Bools]] = {
    "odd": lambda w: w % 2 == 1,
    "winding != 0": lambda w: w != 0,
    "1..1": lambda w: w == 1,
    "winding > 1": lambda w: w > 1,
}
# Most pieces of a sheet's difference at which winding numbers are computed, the largest ones
MOST_PIECES = 2000
CELLS = 23  # rows and columns of places at which a rule is checked against the whole section
MOST_WRONG = 0.02  # largest share of the solid at which a rule may be wrong, because of places on contours
LEAST_GAP_MM = 1e-7  # coordinates nearer to each other than this are the same
GRID_SHARE = 1e-3  # largest distance of coordinates from a grid, over its step
GRID_POINTS = 4  # fewest different coordinates that a grid must have


def turned_over(sheets: Sequence[Sheet]) -> Cause | None:
    """A mirroring, or a turn by 90 or 180 degrees, about any centre."""
    before = total_mm2(sheets)
    if not before > 0.0:
        return None
    middle_a, middle_b = (
        centroid(contours_of(getattr(s, which)) for s in sheets)[0] for which in ("outline_a", "outline_b")
    )
    best: tuple[float, str, float, Floats] | None = None
    for kind, angle, turn in TURNS:
        linear = np.array(turn, np.float64)
        after = 0.0
        for sheet in sheets:
            local = sheet.a.points - sheet.origin_mm - middle_a
            points = (
                local @ linear + middle_b + sheet.origin_mm
            )  # the inverse of a turn or mirror is its transpose
            made = moved_points(sheet.a, points, kind == MIRROR)
            after += apart_mm2(outline(made, 0, sheet.origin_mm), sheet.outline_b)
        share = 1.0 - after / before
        if best is None or share > best[0] + 1e-3:
            best = (share, kind, angle, middle_a - linear @ middle_b)
    assert best is not None
    share, kind, angle, shift = best
    if kind == ROTATION:
        return Cause(ROTATION, angle, "degrees", f"rotation by {angle:g} degrees", max(share, 0.0))
    text = f"mirrored: {MIRRORED[angle]}"
    if angle in (0.0, 90.0):
        axis = int(angle == 90.0)
        text += f" about {'xy'[axis]} = {0.5 * shift[axis] + sheets[0].origin_mm[axis] + 0.0:.3f} mm"
    return Cause(MIRROR, angle, "degrees", text, max(share, 0.0))


def wrong_unit(sheets: Sequence[Sheet], flaws: MeshFlaws) -> Cause | None:
    """Another unit of the whole part, its height included."""
    best: Cause | None = None
    for words, factor in UNITS.items():
        share = share_of(sheets, scaled_section(flaws, factor))
        if best is None or share > best.share:
            best = unit_cause(words, factor, share)
    return best


def unit_cause(words: str, factor: float, share: float) -> Cause:
    """Make the cause for a mistaken unit."""
    return Cause(UNIT, factor, "", f"wrong unit: {words}, {factor:.6g} times too large", share)


def unit_of(factor: float) -> str:
    """The mistaken unit that gives this scale; empty if there is none."""
    for words, known in UNITS.items():
        if abs(math.log(factor / known)) < UNIT_SHARE:
            return words
    return ""


def other_rule(sheets: Sequence[Sheet], flaws: MeshFlaws) -> Cause | None:
    """Another rule for the winding numbers that are solid, found in the pieces in which the two slicers differ."""
    whole, explained, wrong = 0.0, dict.fromkeys(RULES, 0.0), dict.fromkeys(RULES, 0.0)
    for sheet in sheets:
        pieces = sweep.overlap(sheet.outline_a, sheet.outline_b, True).difference
        y = 0.5 * (pieces[:, sweep.Y0] + pieces[:, sweep.Y1])
        left = 0.5 * (pieces[:, sweep.L0] + pieces[:, sweep.L1])
        right = 0.5 * (pieces[:, sweep.R0] + pieces[:, sweep.R1])
        area = np.abs(right - left) * (pieces[:, sweep.Y1] - pieces[:, sweep.Y0])
        whole += float(area.sum())
        largest = np.argsort(-area, kind="stable")[:MOST_PIECES]
        places = np.ascontiguousarray(np.column_stack([0.5 * (left + right), y])[largest])
        # Winding numbers are those of all segments, also of those inside of another body.
        mesh = flaws.section(sheet.height_mm) - np.array([*sheet.origin_mm, *sheet.origin_mm])
        numbers = windings(mesh, places)
        in_a, in_b = (_solid(contours_of(o), places) for o in (sheet.outline_a, sheet.outline_b))
        for name, rule in RULES.items():
            fits = (rule(numbers) == in_a) & ((numbers > 0) == in_b) & (in_a != in_b)
            explained[name] += float(area[largest][fits].sum())
        _count_elsewhere(sheet, mesh, wrong)
    if not whole > 0.0:
        return None
    name = max(explained, key=lambda n: explained[n] * (wrong[n] <= MOST_WRONG * len(sheets)))
    share = explained[name] / whole if wrong[name] <= MOST_WRONG * len(sheets) else 0.0
    text = f"other winding rule: solid is {name} where the other takes winding > 0"
    return Cause(WINDING_RULE, float(list(RULES).index(name)), "", text, share)


def coarse_grid(sheets: Sequence[Sheet]) -> Cause | None:
    """Coordinates rounded to a grid, or to single precision, where those of the other slicer are not."""
    before = total_mm2(sheets)
    points = [sheet.a.points for sheet in sheets]
    values = np.unique(np.concatenate([np.zeros((0, 2)), *points]))
    other = np.unique(np.concatenate([np.zeros((0, 2)), *(sheet.b.points for sheet in sheets)]))
    if not before > 0.0 or values.size < GRID_POINTS:
        return None
    step = _grid_step(values)
    if step > 0.0:
        if other.size and _on_grid(other, step, values[0]):
            return None
        shares = [
            1.0 - sum(_apart_snapped(s, step, float(values[0]), way) for s in sheets) / before
            for way in _WAYS
        ]
        share = max(*shares, 0.0)
        return Cause(QUANTISATION, step, "mm", f"coordinates are rounded to a grid of {step:.6g} mm", share)
    single = values.astype(np.float32).astype(np.float64)
    if np.array_equal(single, values) and not np.array_equal(
        other.astype(np.float32).astype(np.float64), other
    ):
        after = sum(
            apart_mm2(
                sheet.outline_a, outline(moved_points(sheet.b, _single(sheet.b.points)), 0, sheet.origin_mm)
            )
            for sheet in sheets
        )
        step = float(np.spacing(np.float32(np.abs(values).max())))
        text = f"coordinates are rounded to single precision, {step:.3g} mm at the largest"
        return Cause(QUANTISATION, step, "mm", text, max(1.0 - after / before, 0.0))
    return None


def _count_elsewhere(sheet: Sheet, mesh: Floats, wrong: dict[str, float]) -> None:
    """Add to each rule the share of the solid that it gets wrong: it must hold everywhere, not only where the slicers differ."""
    if not len(mesh):
        return
    ends = mesh.reshape(-1, 2)
    low, high = ends.min(axis=0), ends.max(axis=0)
    steps = (np.arange(CELLS) + 0.5) / CELLS
    places = np.stack(np.meshgrid(*(low + (high - low) * steps[:, None]).T), axis=-1).reshape(-1, 2)
    places = np.ascontiguousarray(places)
    numbers, in_a = windings(mesh, places), _solid(contours_of(sheet.outline_a), places)
    for name, rule in RULES.items():
        solid = rule(numbers) | in_a
        wrong[name] += float((rule(numbers) != in_a).sum() / solid.sum()) if solid.any() else 1.0


# -- grids -------------------------------------------------------------------------------------------

_WAYS: tuple[Callable[[Floats], Floats], ...] = (np.round, np.floor, np.ceil, np.trunc)


def _grid_step(values: Floats) -> float:
    """Step of the grid on which ascending values lie; 0 if there is none."""
    gaps = np.diff(values)
    gaps = gaps[gaps > LEAST_GAP_MM]
    if gaps.size < GRID_POINTS:
        return 0.0
    smallest = float(gaps.min())
    for parts in (1, 2, 3, 4, 5, 6):
        rough = smallest / parts
        if rough < 2.0 * LEAST_GAP_MM:
            break
        # The smallest gap has few significant digits; the range of all values has more.
        near = values - values[0]
        counts = np.round(near / rough)
        if not counts[-1]:
            continue
        step = rough
        for far in np.geomspace(rough, near[-1], 12):
            within = (near <= far * 1.000001) & (near > 0.0)
            if within.any():
                top = near[within][-1]
                step = float(top / max(np.round(top / step), 1.0))
        if _on_grid(values, step, values[0]):
            return float(f"{step:.12g}")
    return 0.0


def _on_grid(values: Floats, step: float, first: float) -> bool:
    """Whether values lie on a grid through one of them."""
    count = (values - first) / step
    return bool((np.abs(count - np.round(count)) <= GRID_SHARE).all())


def _apart_snapped(sheet: Sheet, step: float, first: float, way: Callable[[Floats], Floats]) -> float:
    """Area between the contours that differ and the other slicer's contours rounded to the grid, mm2."""
    # Grids mostly go through zero; the offset of another one is known up to whole steps.
    shift = first - step * float(np.round(first / step))
    shift = 0.0 if abs(shift) < GRID_SHARE * step else shift
    snapped = way((sheet.b.points - shift) / step) * step + shift
    return apart_mm2(sheet.outline_a, outline(moved_points(sheet.b, snapped), 0, sheet.origin_mm))


def _single(points: Floats) -> Floats:
    return np.asarray(points.astype(np.float32).astype(np.float64))


def _solid(contours: Floats, places: Floats) -> Bools:
    return np.asarray(windings(contours, places) > 0)
