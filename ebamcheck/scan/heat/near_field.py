"""The fresh heat that truncated modes cannot show: where the beam enters, and in islands beside the last ones.

The temperature of an island by the modes of its section is right for heat that is old: waves shorter than an island
die out within seconds. Heat younger than a horizon is therefore left out of the modes
(:mod:`ebamcheck.scan.heat.aged_heat`), and comes, between islands that are near each other, from Green's functions of the
conduction itself; at islands farther apart it has not arrived yet, and what the modes would have of it is the ripple of
those that they lack.
The Green's function is a Gaussian in the plane, times the exact function of
the depth. What the free Gaussian would lose through the outline stays in the metal: it is divided by its own share in
the metal in sight (:mod:`ebamcheck.scan.heat.near_field`), which is exact far from the outline, on a straight border, in a
corner, and in a thin wall. No heat of this kind passes a gap.

Two figures come from it, both on top of the old heat: the mean temperature of an island, heated by islands that are warm
as a whole; and the temperature under the beam at the point of entry, heated by the lines of islands in the sequence
in which they were driven.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapely.geometry.base import BaseGeometry

from ebamcheck.heat.depth import DepthModes, depth_modes
from ebamcheck.heat.medium import BEAM_SHARE
from ebamcheck.heat.model import HeatModel
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.filling.hatch import Vectors
from ebamcheck.scan.filling.schedule import IslandSchedule
from ebamcheck.scan.heat.pieces import OPTIONS, Pieces, Tiles, island_tiles, line_pieces

DIED_OUT = 3.0
"""Exponent by which the shortest wave of the modes has fallen at the horizon, at least: to 5 %."""

WITHIN_AN_ISLAND = 0.15
"""Horizon, at least, in times in which heat crosses an island, w^2 / alpha: until then its sides differ by much."""

SIGMAS = 2.5
"""Islands farther apart than so many standard deviations of the spread until the horizon do not count as near."""

MOST_REACH = 6.0
"""Reach of what is near, at most, in widths of an island: on over 3000 islands, of 140 to each."""

PIECES = 4.0
"""Pieces of a line of an island's width, at most."""

SHORTEST = 0.5
"""Shortest piece, over the width of a bead."""

AGES = 10
"""Intervals of the tables; age n lies at n^2."""

DEPTH_WAVES = 6.0
"""Waves of the depth in the thickness of a layer: they carry the exact function of the depth."""

MOST_DEPTH_WAVES = 2000
"""Waves of the depth at most."""

FAR = 16.0
"""Squared distances over this times the variance bring nothing: exp(-8)."""

SPARE = 1e-9
"""Share, and mm^2, by which a spread that brings nothing stays under the one that would."""

FEWEST_PAIRS = 16
"""Pairs of islands that a thread is worth."""


class NearField(NamedTuple):
    """Fresh heat between islands that are near each other.

    Tables have a column for each of Q + 1 ages, horizon (n / Q)^2.

    Parameters
    ----------
    horizon_s
        Age of heat from which on the modes have it.
    spread_mm2_s
        Growth of the variance of a Gaussian along one axis, 2 alpha.
    beam_mm2
        Variance of the beam and of its reading at an entry.
    first, other, pair
        (I + 1,), (P,), (P,) islands near each island, itself among them, and the rows of both in the next tables.
    exact
        (U, Q + 1) rise of the mean temperature of an island by heat of up to an age in the other one, over K mm^3/s
        of heating.
    depth
        (2 Q + 1,) mean of the layer's temperature by heat in it at ages horizon (n / 2 Q)^2, 1/mm.
    inside
        (I, 4, Q + 1) share of the heat around each entry that is in the section.
    pieces
        Lines in pieces.
    entry
        (I, 4, 2) points of entry, mm.
    """

    horizon_s: float
    spread_mm2_s: float
    beam_mm2: float
    first: Ints
    other: Ints
    pair: Ints
    exact: Floats
    depth: Floats
    inside: Floats
    pieces: Pieces
    entry: Floats


def near_field(
    model: HeatModel,
    complete: float,
    schedule: IslandSchedule,
    lines: Vectors,
    section: BaseGeometry,
    islands: NDArray[np.object_],
    bead_mm: float,
) -> NearField:
    """Tabulate the fresh heat of a layer.

    Parameters
    ----------
    model
        The heat model.
    complete
        Eigenvalue up to which it has all modes, 1/mm^2.
    lines
        Lines of the islands, sorted by island.
    section
        Solid region of the layer.
    islands
        (I,) polygons.
    bead_mm
        Width of a bead.
    """
    centroid, area_mm2 = shapely.get_coordinates(shapely.centroid(islands)), shapely.area(islands)
    alpha = model.medium.diffusivity_mm2_s
    count, width2 = len(area_mm2), float(area_mm2.mean())
    longest_mm2 = 0.5 * width2 * (MOST_REACH / SIGMAS) ** 2
    horizon_s = min(max(DIED_OUT / complete, WITHIN_AN_ISLAND * width2), longest_mm2) / alpha
    pieces = line_pieces(lines, centroid, area_mm2, max(SHORTEST * bead_mm, math.sqrt(width2) / PIECES))
    pairs = near_pairs(pieces, count, SIGMAS * math.sqrt(2.0 * alpha * horizon_s))
    first, other, pair = by_island(pairs, count)
    root = np.linspace(0.0, 1.0, 2 * AGES + 1)
    age = horizon_s * root**2
    depth = of_layer(exact_depth(model), model, age)
    spread = 2.0 * alpha * age
    # Means are those of whole islands, as the modes have them; lines end short of their borders.
    tiles = island_tiles(islands)
    free = np.concatenate(
        run_blocks(lambda a, b: between_pieces(*tiles, pairs[a:b], spread), len(pairs), FEWEST_PAIRS)
    )
    inside = of_islands(section, tiles, spread)
    free /= 0.5 * (inside[pairs[:, 0]] + inside[pairs[:, 1]])
    free[hidden(section, pieces, pairs, centroid, bead_mm)] = 0.0
    beam_mm2, entry = 2.0 * (BEAM_SHARE * bead_mm) ** 2, np.ascontiguousarray(schedule.entry)
    around = beam_mm2 + float(pieces.variance.mean()) + spread[::2]
    return NearField(
        horizon_s=horizon_s,
        spread_mm2_s=2.0 * alpha,
        beam_mm2=beam_mm2,
        first=first,
        other=other,
        pair=pair,
        exact=cumulated(free * depth, horizon_s),
        depth=depth,
        inside=enclosed_share(section, entry.reshape(-1, 2), np.tile(around, (OPTIONS * count, 1))).reshape(
            count, OPTIONS, -1
        ),
        pieces=pieces,
        entry=entry,
    )


def near_pairs(pieces: Pieces, count: int, reach_mm: float) -> Ints:
    """Pairs (U, 2) of islands of which some pieces lie within a reach, the lesser first, and each with itself."""
    owner = np.repeat(np.arange(count), np.diff(pieces.first))
    close = owner[cKDTree(pieces.place).query_pairs(reach_mm, output_type="ndarray")]
    both = np.unique(np.sort(close, axis=1) @ np.array([count, 1])) if len(close) else np.zeros(0, np.int64)
    itself = np.arange(count) * (count + 1)
    keys = np.union1d(both, itself)
    return np.column_stack([keys // count, keys % count]).astype(np.int64)


def of_islands(section: BaseGeometry, pieces: Tiles, spread_mm2: Floats) -> Floats:
    """Share of the heat of each island that stays in the metal in sight when it has spread by a variance, (I, Q)."""
    share = enclosed_share(section, pieces.place, np.add.outer(2.0 * pieces.variance, spread_mm2))
    return np.add.reduceat(pieces.share[:, None] * share, pieces.first[:-1])


def hidden(section: BaseGeometry, pieces: Pieces, pairs: Ints, centroid: Floats, bead_mm: float) -> Bools:
    """Whether there is a gap between the islands of each pair (U,): none where pieces lie within a bead's width."""
    count = len(centroid)
    close = near_pairs(pieces, count, bead_mm) @ np.array([count, 1])
    apart = np.flatnonzero(~np.isin(pairs @ np.array([count, 1]), close))
    apart_mm = np.hypot(*(centroid[pairs[apart, 1]] - centroid[pairs[apart, 0]]).T)
    # A line from an island leaves the metal only where the outline is nearer than its other end.
    outline = shapely.boundary(section)
    shapely.prepare(outline)
    apart = apart[shapely.dwithin(outline, shapely.points(centroid[pairs[apart, 0]]), apart_mm)]
    shapely.prepare(section)
    sight = shapely.linestrings(np.stack([centroid[pairs[apart, 0]], centroid[pairs[apart, 1]]], axis=1))
    found = np.zeros(len(pairs), np.bool_)
    found[apart] = ~shapely.covers(section, sight)
    return found


def by_island(pairs: Ints, count: int) -> tuple[Ints, Ints, Ints]:
    """Pairs from the view of each island: first entry (I + 1,), the other island (P,), row of the pair (P,)."""
    apart = np.flatnonzero(pairs[:, 0] != pairs[:, 1])
    one = np.concatenate([pairs[:, 0], pairs[apart, 1]])
    other = np.concatenate([pairs[:, 1], pairs[apart, 0]])
    row = np.concatenate([np.arange(len(pairs)), apart])
    sort = np.lexsort((other, one))
    first = np.concatenate([[0], np.cumsum(np.bincount(one, minlength=count))])
    return first.astype(np.int64), other[sort], row[sort]


def exact_depth(model: HeatModel) -> DepthModes:
    """Modes of the model's depth that carry waves much shorter than a layer."""
    depth = model.depth
    count = min(MOST_DEPTH_WAVES, math.ceil(DEPTH_WAVES * depth.depth_mm / model.layer_mm) + 1)
    loss = model.medium.radiation_w_mm2k / model.medium.conductivity_w_mmk
    return depth_modes(depth.depth_mm, count, depth.cooled, loss)


def of_layer(depth: DepthModes, model: HeatModel, age_s: Floats) -> Floats:
    """Mean temperature of the layer by heat that was set free all over it some time ago, 1/mm."""
    square = depth.mean_of_layer(model.layer_mm) ** 2
    rate = model.medium.diffusivity_mm2_s * depth.wave_number**2
    return np.asarray(np.exp(-np.multiply.outer(age_s, rate)) @ square, np.float64)


def cumulated(values: Floats, horizon_s: float) -> Floats:
    """Integrals (U, Q + 1) of values at ages horizon (n / 2 Q)^2 from 0 to every other age, by Simpson's rule."""
    root = np.linspace(0.0, 1.0, values.shape[1])
    over_root = values * (2.0 * horizon_s * root)
    parts = (over_root[:, :-1:2] + 4.0 * over_root[:, 1::2] + over_root[:, 2::2]) * root[1] / 3.0
    return np.pad(np.cumsum(parts, axis=1), ((0, 0), (1, 0)))


@kernel
def between_pieces(
    first: Ints, place: Floats, share: Floats, variance: Floats, pairs: Ints, spread: Floats
) -> Floats:
    """Share of the heat of one island of each pair in a unit area of the other in an endless plane, (U, Q) 1/mm^2."""
    result = np.zeros((len(pairs), len(spread)))
    most = np.diff(first).max() if len(first) > 1 else 0
    away, variances, weight, part = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    for n in range(len(pairs)):
        start, count = first[pairs[n, 1]], first[pairs[n, 1] + 1] - first[pairs[n, 1]]
        for a in range(first[pairs[n, 0]], first[pairs[n, 0] + 1]):
            for k in range(count):
                b = start + k
                away[k] = (place[a, 0] - place[b, 0]) ** 2 + (place[a, 1] - place[b, 1]) ** 2
                variances[k], weight[k] = variance[a] + variance[b], share[a] * share[b]
            least = np.inf
            for k in range(count):
                least = min(least, away[k] / FAR - variances[k])
            for q in range(len(spread)):
                # Nothing has come so far yet; by a hair more than rounding, so that none is left out.
                if spread[q] * (1.0 + SPARE) < least - SPARE:
                    continue
                # Side by side, which the processor does for several at once, and then added up one after the other.
                for k in range(count):
                    part[k] = weight[k] * gaussian(away[k], variances[k] + spread[q])
                for k in range(count):
                    result[n, q] += part[k]
    return result


@kernel
def gaussian(away: float, variance: float) -> float:
    """Density of a Gaussian of a variance along each axis, 1/mm^2, at the square of a distance."""
    dense = np.true_divide(falling(np.true_divide(-0.5 * away, variance)), 2.0 * np.pi * variance)
    return 0.0 if away > FAR * variance else dense


@kernel
def at_root(table: Floats, root: float) -> float:
    """Value of a table whose columns lie evenly between roots 0 and 1, linear in between; beyond, the last one."""
    place = root * (len(table) - 1)
    node = min(int(place), len(table) - 2)
    share = min(place - node, 1.0)
    return float(table[node] + (table[node + 1] - table[node]) * share)


@kernel
def young_rise(
    near: NearField, pair: int, island: int, option: int, source: int, left_by: int, since: float, time: float
) -> tuple[float, float]:
    """Rise of an island's mean temperature, and of that of its entry, by heat younger than the horizon; over K mm^3/s.

    Parameters
    ----------
    pair
        Row of the two islands.
    island, option
        Island, and its entry.
    source, left_by
        Island that was heated, and its entry option.
    since, time
        Time since the end of its heating, and the time that took, s.
    """
    mean = young_mean(near, pair, since, time)
    return mean, entry_rise(near, island, option, source, left_by, since, time)


@kernel
def young_mean(near: NearField, pair: int, since: float, time: float) -> float:
    """Rise of an island's mean temperature by the other one of a pair, over K mm^3/s: see :func:`young_rise`."""
    late, early = root_of(near, since + time), root_of(near, since)
    return at_root(near.exact[pair], late) - at_root(near.exact[pair], early)


@kernel
def entry_rise(
    near: NearField, island: int, option: int, source: int, left_by: int, since: float, time: float
) -> float:
    """Rise of the temperature at an entry by another island, over K mm^3/s of heating: see :func:`young_rise`."""
    pieces, depth, horizon = near.pieces, near.depth, near.horizon_s
    first, passed, variances, place, share = (
        pieces.first, pieces.passed[left_by], pieces.variance, pieces.place, pieces.share,
    )  # fmt: skip
    # Taken out once: each part of a column taken in a loop is counted as one that is in use.
    inside, beam, spread = near.inside[island, option], near.beam_mm2, near.spread_mm2_s
    x, y = near.entry[island, option, 0], near.entry[island, option, 1]
    total = 0.0
    for m in range(first[source], first[source + 1]):
        age = since + (1.0 - passed[m]) * time
        variance = variances[m] + beam + spread * age
        away = (place[m, 0] - x) ** 2 + (place[m, 1] - y) ** 2
        if age > horizon or away > FAR * variance:
            continue
        root = np.sqrt(np.true_divide(age, horizon))
        dense = share[m] * gaussian(away, variance)
        total += np.true_divide(dense * at_root(depth, root), at_root(inside, root))
    return total * time


@kernel
def root_of(near: NearField, age: float) -> float:
    """Place of an age in the tables: 0 for none, 1 for the horizon and beyond."""
    return float(np.sqrt(min(max(age / near.horizon_s, 0.0), 1.0)))


# -- Powers of e that fall, in plain arithmetic, so that a kernel works out several at once --------------------


LEAST = -40.0
"""Exponent under which the result is that of this one, 4e-18: nothing beside 1."""


@kernel
def falling(exponent: float) -> float:
    """Return e to an exponent of at most 0, to 1e-14 of 1.

    The processor has no such function; the library's takes one value at a time and 8 ns. The series of a 64th of the
    exponent, squared six times, is the same to rounding, has no branch, and takes 1 ns in a loop over a column.

    Examples
    --------
    >>> round(falling(-1.0), 12)
    0.367879441171
    """
    part = max(exponent, LEAST) / 64.0
    power = 1.0 + part * (1.0 / 11.0)
    power = 1.0 + part * (1.0 / 10.0) * power
    power = 1.0 + part * (1.0 / 9.0) * power
    power = 1.0 + part * (1.0 / 8.0) * power
    power = 1.0 + part * (1.0 / 7.0) * power
    power = 1.0 + part * (1.0 / 6.0) * power
    power = 1.0 + part * (1.0 / 5.0) * power
    power = 1.0 + part * (1.0 / 4.0) * power
    power = 1.0 + part * (1.0 / 3.0) * power
    power = 1.0 + part * (1.0 / 2.0) * power
    power = 1.0 + part * power
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    return power * power


# -- Enclosed share: how much of a Gaussian around a point lies in the metal that the point sees ---------------


DIRECTIONS = 32
"""Rays from each point to the outline."""

SIGHT_SIGMAS = 3.0
"""The outline farther away than so many standard deviations takes nothing."""

LEAST_SHARE = 0.05
"""Least share, that of a wedge of 18 degrees: a point on a tip holds its heat."""

ON_OUTLINE_MM = 1e-6
"""Crossings nearer than this are the outline on which the point lies, not what its ray meets."""

SECTOR_BINS, SECTOR_ROUNDING = 1024, 1e-9
"""Bins in a quarter turn by which sectors between rays are looked up: so fine that few hold a ray; and the rounding, in
sectors, that is allowed for at their edges, far more than there is."""

DOUBTFUL = 64
"""Added to the sector of a bin that holds a ray."""

FELT = 38.0
"""Exponent from which on what a Gaussian has beyond the outline is nothing beside 1, not even by rounding."""

STRETCH = 64
"""Segments of the outline that are passed over together where all of them are too far away to be felt; whole words of marks."""

FEWEST_POINTS = 64
"""Points that a thread is worth."""


def enclosed_share(section: BaseGeometry, points: Floats, variance_mm2: Floats) -> Floats:
    """Share of Gaussians around points that lies in the metal in sight, (P, Q).

    Along a ray the Gaussian has the share 1 - exp(-r^2 / (2 variance)) up to its first crossing of the outline; the
    mean over all directions is exact for what is in sight. Heat does not pass a gap, and what is out of sight behind
    a bend is far.

    Parameters
    ----------
    section
        Polygon or multi-polygon.
    points
        (P, 2) mm.
    variance_mm2
        (P, Q) along each axis.
    """
    outline = shapely.boundary(section)
    shapely.prepare(outline)
    reach = SIGHT_SIGMAS * np.sqrt(variance_mm2.max(initial=0.0))
    near = np.flatnonzero(shapely.dwithin(outline, shapely.points(points), reach))
    share = np.ones(variance_mm2.shape)
    rings = [shapely.get_coordinates(line) for line in shapely.get_parts(outline)]
    points_of, goes_on = (
        np.concatenate(rings),
        np.concatenate([np.arange(1, len(r) + 1) < len(r) for r in rings]),
    )
    seen, variance = points[near], variance_mm2[near]
    share[near] = np.concatenate(
        run_blocks(
            lambda a, b: in_sight(seen[a:b], variance[a:b], points_of, goes_on), len(near), FEWEST_POINTS
        )
    )
    return np.maximum(share, LEAST_SHARE)


@kernel
def in_sight(points: Floats, variance: Floats, outline: Floats, goes_on: Bools) -> Floats:
    """See :func:`enclosed_share`; from each of the points (S, 2) of the `outline` to the next goes a segment, or none."""
    nearest, angle = np.empty(DIRECTIONS), 2.0 * np.pi * (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    dx, dy = np.cos(angle), np.sin(angle)
    share, parts = np.zeros(variance.shape), np.empty((DIRECTIONS, variance.shape[1]))
    count, sectors, boxes = len(outline), sector_table(), _stretches(outline)
    x, y, sector = np.empty(STRETCH + 1), np.empty(STRETCH + 1), np.empty(STRETCH + 1, np.uint8)
    # What may be crossed is marked by itself, which the processor does for several segments at once, and looked for by words.
    marked = np.zeros(STRETCH, np.uint8)
    words = marked.view(np.uint64)
    for p in range(len(points)):
        nearest[:] = np.inf
        px, py, felt = points[p, 0], points[p, 1], 2.0 * FELT * variance[p].max()
        for b in range(len(boxes)):
            beside = max(boxes[b, 0] - px, px - boxes[b, 1], 0.0)
            above = max(boxes[b, 2] - py, py - boxes[b, 3], 0.0)
            if beside * beside + above * above > felt:
                continue
            first = b * STRETCH
            length = min(STRETCH, count - 1 - first)
            for s in range(length + 1):
                x[s], y[s] = outline[first + s, 0] - px, outline[first + s, 1] - py
            for s in range(length + 1):
                sector[s] = sectors[int(SECTOR_BINS * diamond(x[s], y[s]))]
            marked[length:] = 0
            for s in range(length):
                marked[s] = goes_on[first + s] & ((sector[s] != sector[s + 1]) | (sector[s] >= DOUBTFUL))
            for word in range(len(words)):
                if words[word] != 0:
                    for s in range(8 * word, 8 * word + 8):
                        if marked[s] != 0:
                            _cross(nearest, dx, dy, x[s], y[s], x[s + 1], y[s + 1], sector[s], sector[s + 1])
        for n in range(DIRECTIONS):
            for q in range(variance.shape[1]):
                parts[n, q] = np.true_divide(-0.5 * nearest[n] * nearest[n], variance[p, q])
        flat = parts.ravel()
        for m in range(len(flat)):
            flat[m] = (1.0 - falling(flat[m])) / DIRECTIONS
        for n in range(DIRECTIONS):
            for q in range(variance.shape[1]):
                share[p, q] += parts[n, q]
    return share


@kernel
def _stretches(outline: Floats) -> Floats:
    """Boxes (B, 4), least and greatest x, then y, around each :data:`STRETCH` segments of an outline (S, 2)."""
    boxes = np.empty((max(0, len(outline) - 2 + STRETCH) // STRETCH, 4))
    for b in range(len(boxes)):
        part = outline[b * STRETCH : b * STRETCH + STRETCH + 1]
        boxes[b, 0], boxes[b, 1] = part[:, 0].min(), part[:, 0].max()
        boxes[b, 2], boxes[b, 3] = part[:, 1].min(), part[:, 1].max()
    return boxes


@kernel
def _cross(
    nearest: Floats, dx: Floats, dy: Floats, ax: float, ay: float, bx: float, by: float, start: int, end: int
) -> None:
    """Note how far the rays go to a segment from `start` to `end`, sectors as of :func:`sector_table`.

    Only rays between the two, and those behind them, can have its ends on two sides; each is asked itself.
    """
    first, last = int(start) % DOUBTFUL, int(end) % DOUBTFUL
    rays = (last - first) % DIRECTIONS
    if rays > DIRECTIONS // 2:
        first, rays = last, DIRECTIONS - rays
    if start >= DOUBTFUL or end >= DOUBTFUL:
        rays = min(rays + 1, DIRECTIONS // 2)
    for m in range(2 * rays):
        n = (first + m // 2 + (m % 2) * (DIRECTIONS // 2)) % DIRECTIONS
        ahead, behind = dx[n] * ay - dy[n] * ax, dx[n] * by - dy[n] * bx
        if (ahead > 0.0) == (behind > 0.0):
            continue
        part = ahead / (ahead - behind)
        reach = dx[n] * (ax + part * (bx - ax)) + dy[n] * (ay + part * (by - ay))
        if ON_OUTLINE_MM < reach < nearest[n]:
            nearest[n] = reach


@kernel
def diamond(x: float, y: float) -> float:
    """Stand-in for the angle of a point, from 0 to 4, which grows with it: the way along a square on its corner."""
    around = abs(x) + abs(y)
    up = np.true_divide(y, around if around > 0.0 else 1.0)
    ahead = up if up >= 0.0 else 4.0 + up
    return float(ahead if x >= 0.0 else 2.0 - up)


@kernel
def sector_table() -> NDArray[np.uint8]:
    """Sector between rays by even bins of :func:`diamond`; :data:`DOUBTFUL` more where it may be the next one, too.

    Sector n lies before ray n. Beyond the last bin is that of an angle that was rounded up to a whole turn.
    """
    count = 4 * SECTOR_BINS
    edge = np.empty(count + 1)
    for n in range(count + 1):
        a = n / SECTOR_BINS
        x = 1.0 - a if a < 2.0 else a - 3.0
        y = a if a < 1.0 else 2.0 - a if a < 3.0 else a - 4.0
        turn = np.arctan2(y, x) / (2.0 * np.pi)
        edge[n] = turn if turn >= 0.0 and n < count else turn + 1.0
    table = np.empty(count + 1, np.uint8)
    for n in range(count):
        low = int(np.floor(edge[n] * DIRECTIONS + 0.5 - SECTOR_ROUNDING))
        high = int(np.floor(edge[n + 1] * DIRECTIONS + 0.5 + SECTOR_ROUNDING))
        table[n] = low % DIRECTIONS + (DOUBTFUL if high > low else 0)
    table[count] = 0
    return table
