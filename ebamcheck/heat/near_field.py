"""The fresh heat that truncated modes cannot show: where the beam enters, and in islands beside the last ones.

Waves shorter than an island die out within seconds: its temperature by the modes of the section is right for old heat. Heat younger
than a horizon is left out of the modes (:mod:`ebamcheck.heat.field`), and comes, between islands near each other, from Green's
functions of the conduction. For distant islands it is zero; truncated modes would only add ringing. The Green's function is a
Gaussian in the plane, times the exact function of the depth. What the free Gaussian would lose through the outline stays in the
metal: it is divided by its own share in the metal in sight, which is exact far from the outline, on a straight border, in a corner,
and in a thin wall. No heat of this kind passes a gap.

Two figures come from it, both on top of the old heat: the mean temperature of an island, heated by islands that are warm as a whole;
and the temperature under the beam at the point of entry, heated by the lines of islands in the sequence in which they were driven.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.raster import each_of
from ebamcheck.geometry.regions import equivalent_rectangles_mm
from ebamcheck.heat.field import falling
from ebamcheck.heat.medium import BEAM_SHARE
from ebamcheck.heat.model import DepthModes, HeatModel, depth_modes
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.threads import run_blocks

OPTIONS = 4  # entry options of an island, as in :class:`~ebamcheck.scan.filling.schedule.IslandSchedule`
# Times that the triangles of an island are halved: a hexagon has 8 tiles then, each a Gaussian of its moment; and decimals of the
# corners, mm, by which they are cut
HALVED, DECIMALS = 1, 6
FLAT = 0.05  # deviation, over its width, by which the border of an island is simplified before it is cut into triangles
DIED_OUT = 3.0  # exponent by which the shortest wave of the modes has fallen at the horizon, at least: to 5 %
# Horizon, at least, in times in which heat crosses an island, w^2 / alpha: until then its sides differ by much
WITHIN_AN_ISLAND = 0.15
# Islands farther apart than so many standard deviations of the spread until the horizon, or than so many widths of an island, do
# not count as near
SIGMAS, MOST_REACH = 2.5, 6.0
AGES = 10  # intervals of the tables; age n lies at n^2
# Waves of the depth in the thickness of a layer, which carry the exact function of the depth; and in all, at most
DEPTH_WAVES, MOST_DEPTH_WAVES = 6.0, 2000
FAR = 16.0  # squared distances over this times the variance bring nothing: exp(-8)
SPARE = 1e-9  # share, and mm^2, by which a spread that brings nothing stays under the one that would
FEWEST_PAIRS, FEWEST_POINTS = 16, 64  # pairs of islands, and points, that a thread is worth


class NearField(NamedTuple):
    """Fresh heat between islands that are near each other. Tables have a column for each of Q + 1 ages, horizon (n / Q)^2."""

    horizon_s: float  # age of heat from which on the modes have it
    spread_mm2_s: float  # growth of the variance of a Gaussian along one axis, 2 alpha
    beam_mm2: float  # variance of the beam and of its reading at an entry
    first: Ints  # (I + 1,) first row of the islands near each island
    other: Ints  # (P,) islands near each island, itself among them
    pair: Ints  # (P,) rows of both in the next tables
    exact: Floats  # (U, Q + 1) rise of an island's mean by heat of up to an age in the other, over K mm^3/s
    depth: Floats  # (2 Q + 1,) mean of the layer by heat in it at ages horizon (n / 2 Q)^2, 1/mm
    inside: Floats  # (I, 4, Q + 1) share of the heat around each entry that is in the section
    pieces: Pieces
    entry: Floats  # (I, 4, 2) points of entry, mm


def near_field(
    model: HeatModel,
    complete: float,
    entry: Floats,
    lines: tuple[Ints, Floats, Floats],
    section: BaseGeometry,
    islands: NDArray[np.object_],
    bead_mm: float,
) -> NearField:
    """Tabulate the fresh heat of a layer.

    `complete` is the eigenvalue up to which the model has all modes, 1/mm^2; `entry` (I, 4, 2) are the points at which the
    islands (I,) of a section may be entered, mm, `lines` the island, start and end of their lines, sorted by island.
    """
    centroid, area_mm2 = shapely.get_coordinates(shapely.centroid(islands)), shapely.area(islands)
    alpha, count, width2 = model.medium.diffusivity_mm2_s, len(area_mm2), float(area_mm2.mean())
    longest_mm2 = 0.5 * width2 * (MOST_REACH / SIGMAS) ** 2
    horizon_s = min(max(DIED_OUT / complete, WITHIN_AN_ISLAND * width2), longest_mm2) / alpha
    # A line of an island's width is at most four pieces; none is shorter than half a bead.
    pieces = line_pieces(lines, centroid, area_mm2, max(0.5 * bead_mm, math.sqrt(width2) / 4.0))
    tree, owner = cKDTree(pieces.place), np.repeat(np.arange(count), np.diff(pieces.first))
    keys = _pair_keys(tree, owner, SIGMAS * math.sqrt(2.0 * alpha * horizon_s))
    pairs = np.stack([keys // count, keys % count], axis=1)
    age = horizon_s * np.linspace(0.0, 1.0, 2 * AGES + 1) ** 2
    depth, spread = of_layer(exact_depth(model), model, age), 2.0 * alpha * age
    # Means are those of whole islands, as the modes have them; lines end short of their borders.
    tiles = island_tiles(islands)
    columns = tiles.first, tiles.place, tiles.share, tiles.variance
    free = np.concatenate(
        run_blocks(lambda a, b: between_pieces(*columns, pairs[a:b], spread), len(pairs), FEWEST_PAIRS)
    )
    # Share of the heat of each island that stays in the metal in sight when it has spread so far.
    held = enclosed_share(section, tiles.place, np.add.outer(2.0 * tiles.variance, spread))
    inside = np.add.reduceat(tiles.share[:, None] * held, tiles.first[:-1])
    free /= 0.5 * (inside[pairs[:, 0]] + inside[pairs[:, 1]])
    apart = np.flatnonzero(~np.isin(keys, _pair_keys(tree, owner, bead_mm)))
    free[apart[_hidden(section, centroid[pairs[apart]])]] = 0.0
    beam_mm2, entry = 2.0 * (BEAM_SHARE * bead_mm) ** 2, np.ascontiguousarray(entry)
    around = beam_mm2 + float(pieces.variance.mean()) + spread[::2]
    at_entries = enclosed_share(section, entry.reshape(-1, 2), np.tile(around, (OPTIONS * count, 1)))
    # The pairs from the view of each island.
    unlike = np.flatnonzero(pairs[:, 0] != pairs[:, 1])
    one, other = (np.concatenate([pairs[:, k], pairs[unlike, 1 - k]]) for k in (0, 1))
    sort = np.lexsort((other, one))
    return NearField(
        horizon_s=horizon_s,
        spread_mm2_s=2.0 * alpha,
        beam_mm2=beam_mm2,
        first=_first_rows(one, count),
        other=other[sort],
        pair=np.concatenate([np.arange(len(pairs)), unlike])[sort],
        exact=cumulated(free * depth, horizon_s),
        depth=depth,
        inside=at_entries.reshape(count, OPTIONS, -1),
        pieces=pieces,
        entry=entry,
    )


def _pair_keys(tree: cKDTree, owner: Ints, reach_mm: float) -> Ints:
    """Pairs a <= b of I islands with pieces within a reach, and each with itself, as sorted keys a I + b; `owner` has each piece's."""
    count = int(owner[-1]) + 1
    close = np.sort(owner[tree.query_pairs(reach_mm, output_type="ndarray")], axis=1)
    return np.union1d(close @ np.array([count, 1]), np.arange(count) * (count + 1))


def _hidden(section: BaseGeometry, ends: Floats) -> Bools:
    """Whether a gap lies between the centroids (U, 2, 2) of pairs of islands."""
    # A line from an island leaves the metal only where the outline is nearer than its other end.
    outline = shapely.boundary(section)
    shapely.prepare([outline, section])
    long_mm = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    doubtful = np.asarray(shapely.dwithin(outline, shapely.points(ends[:, 0]), long_mm), np.bool_)
    doubtful[doubtful] = ~shapely.covers(section, shapely.linestrings(ends[doubtful]))
    return doubtful


def _first_rows(owner: Ints, count: int) -> Ints:
    """First row (I + 1,) of each of the islands that own some rows, where these are sorted by island."""
    return np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=count))]).astype(np.int64)


def exact_depth(model: HeatModel) -> DepthModes:
    """Modes of the model's depth that carry waves much shorter than a layer."""
    depth = model.depth
    count = min(MOST_DEPTH_WAVES, math.ceil(DEPTH_WAVES * depth.depth_mm / model.layer_mm) + 1)
    return depth_modes(depth.depth_mm, count, depth.cooled, model.medium.loss_per_mm)


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
def between_pieces(first: Ints, place: Floats, share: Floats, variance: Floats, pairs: Ints, spread: Floats) -> Floats:
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
                    spread_mm2 = variances[k] + spread[q]
                    power = falling(-0.5 * away[k] / spread_mm2)
                    dense = power / (2.0 * np.pi * spread_mm2)
                    part[k] = 0.0 if away[k] > FAR * spread_mm2 else weight[k] * dense
                for k in range(count):
                    result[n, q] += part[k]
    return result


@kernel
def at_root(table: Floats, root: float) -> float:
    """Value of a table whose columns lie evenly between roots 0 and 1, linear in between; beyond, the last one."""
    place = root * (len(table) - 1)
    node = min(int(place), len(table) - 2)
    share = min(place - node, 1.0)
    return float(table[node] + (table[node + 1] - table[node]) * share)


@kernel
def young_mean(near: NearField, pair: int, since: float, time: float) -> float:
    """Rise of an island's mean temperature by heat younger than the horizon in the other of a pair, over K mm^3/s of heating.

    The heating ended a time ago, and took a time, s.
    """
    horizon, exact = near.horizon_s, near.exact[pair]
    late = np.sqrt(min(max((since + time) / horizon, 0.0), 1.0))
    early = np.sqrt(min(max(since / horizon, 0.0), 1.0))
    return at_root(exact, late) - at_root(exact, early)


@kernel
def entry_rise(
    near: NearField, island: int, option: int, source: int, left_by: int, since: float, time: float
) -> float:
    """Rise of the temperature at an entry by another island that was entered by an option, as :func:`young_mean`."""
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
        root = np.sqrt(age / horizon)
        dense = share[m] * (falling(-0.5 * away / variance) / (2.0 * np.pi * variance))
        total += dense * at_root(depth, root) / at_root(inside, root)
    return total * time


# -- Enclosed share: how much of a Gaussian around a point lies in the metal that the point sees ---------------


# Rays from each point to the outline, and the exponent from which on what a Gaussian has beyond the outline counts as nothing: at
# three standard deviations
DIRECTIONS, FELT = 32, 4.5
LEAST_SHARE = 0.05  # least share, that of a wedge of 18 degrees: a point on a tip holds its heat
# Crossings nearer than this are the outline on which the point lies, not what its ray meets
ON_OUTLINE_MM = 1e-6
# Segments of the outline that are passed over together where all of them are too far away to be felt
STRETCH = 64


def enclosed_share(section: BaseGeometry, points: Floats, variance_mm2: Floats) -> Floats:
    """Share (P, Q) of Gaussians around points (P, 2), mm, that lies in the metal in sight, by their variances (P, Q) along each axis.

    Along a ray the Gaussian has the share 1 - exp(-r^2 / (2 variance)) up to its first crossing of the outline; the mean over all
    directions is exact for what is in sight. Heat does not pass a gap, and what is out of sight behind a bend is far.
    """
    rings = [shapely.get_coordinates(line) for line in shapely.get_parts(shapely.boundary(section))]
    outline = np.concatenate(rings)
    goes_on = np.ones(len(outline), np.bool_)
    goes_on[np.cumsum([len(ring) for ring in rings]) - 1] = False
    starts = np.arange(0, len(outline) - 1, STRETCH)
    # Each stretch ends with the first point of the next one.
    stops = np.minimum(starts + STRETCH, len(outline) - 1)
    low = np.minimum(np.minimum.reduceat(outline, starts), outline[stops])
    high = np.maximum(np.maximum.reduceat(outline, starts), outline[stops])
    boxes = np.ascontiguousarray(np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1))
    rays = ray_table()
    share = np.concatenate(
        run_blocks(
            lambda a, b: in_sight(points[a:b], variance_mm2[a:b], outline, goes_on, boxes, rays),
            len(points),
            FEWEST_POINTS,
        )
    )
    return np.asarray(np.maximum(share, LEAST_SHARE), np.float64)


@cache
def ray_table() -> Floats:
    """Directions of the rays, and the share (32,) of all directions that each stands for, (3, 32).

    They are even along a square on its corner: the way along it stands for the angle.
    """
    along = np.arange(2 * DIRECTIONS + 1) * (2.0 / DIRECTIONS)
    x = np.where(along <= 2.0, 1.0 - along, along - 3.0)
    y = np.where(along <= 1.0, along, np.where(along <= 3.0, 2.0 - along, along - 4.0))
    turn = np.unwrap(np.arctan2(y, x)) / (2.0 * np.pi)
    size = np.hypot(x, y)
    return np.stack([(x / size)[1::2], (y / size)[1::2], np.diff(turn[::2])])


@kernel
def in_sight(points: Floats, variance: Floats, outline: Floats, goes_on: Bools, boxes: Floats, rays: Floats) -> Floats:
    """Shares as :func:`enclosed_share` gives them, before their least.

    From each of the points (S, 2) of the `outline` to the next goes a segment, where it `goes_on`; `boxes` (B, 4) are those of its
    stretches, `rays` those of :func:`ray_table`.
    """
    count, nearest = len(outline), np.empty(DIRECTIONS)
    share = np.zeros(variance.shape)
    x, y, place = np.empty(STRETCH + 1), np.empty(STRETCH + 1), np.empty(STRETCH + 1)
    for p in range(len(points)):
        nearest[:] = np.inf
        px, py, felt = points[p, 0], points[p, 1], 2.0 * FELT * variance[p].max()
        for b in range(len(boxes)):
            beside = max(boxes[b, 0] - px, px - boxes[b, 1], 0.0)
            above = max(boxes[b, 2] - py, py - boxes[b, 3], 0.0)
            if beside * beside + above * above > felt:
                continue
            start = b * STRETCH
            length = min(STRETCH, count - 1 - start)
            for s in range(length + 1):
                x[s], y[s] = outline[start + s, 0] - px, outline[start + s, 1] - py
                # The number of the ray in this direction, with the share on the way to the next.
                around = abs(x[s]) + abs(y[s])
                up = y[s] / (around if around > 0.0 else 1.0)
                ahead = up if up >= 0.0 else 4.0 + up
                place[s] = 0.25 * DIRECTIONS * (ahead if x[s] >= 0.0 else 2.0 - up) - 0.5
            for s in range(length):
                low, high = min(place[s], place[s + 1]), max(place[s], place[s + 1])
                if high - low > 0.5 * DIRECTIONS:
                    low, high = high, low + DIRECTIONS
                first, last = int(np.ceil(low)), int(np.floor(high))
                if first > last or not goes_on[start + s]:
                    continue
                for ray in range(first, last + 1):
                    n = (ray + DIRECTIONS) % DIRECTIONS
                    dx, dy = rays[0, n], rays[1, n]
                    left, right = dx * y[s] - dy * x[s], dx * y[s + 1] - dy * x[s + 1]
                    part = left / (left - right) if left != right else 0.0
                    reach = dx * (x[s] + part * (x[s + 1] - x[s])) + dy * (y[s] + part * (y[s + 1] - y[s]))
                    if ON_OUTLINE_MM < reach < nearest[n]:
                        nearest[n] = reach
        for n in range(DIRECTIONS):
            for q in range(variance.shape[1]):
                share[p, q] += rays[2, n] * (1.0 - falling(-0.5 * nearest[n] * nearest[n] / variance[p, q]))
    return share


class Pieces(NamedTuple):
    """Pieces of lines, or tiles that cover islands, sorted by island."""

    first: Ints  # (I + 1,) first piece of each island
    place: Floats  # (M, 2) middle, mm
    share: Floats  # (M,) share of the island's heat, and of its area
    passed: Floats  # (4, M) share of the island's time after which the beam is there, by the entry option; no rows for tiles
    variance: Floats  # (M,) of the heat around the middle along one axis, mm^2: of a square tile of the same area


def line_pieces(lines: tuple[Ints, Floats, Floats], centroid: Floats, area_mm2: Floats, longest_mm: float) -> Pieces:
    """Cut lines into pieces of at most a length; an island without lines is one piece at its centroid.

    The beam counts as passing from line to line in no time, and as driving all of them in the island's time.
    """
    count, (of, starts, ends) = len(area_mm2), lines
    bare = np.flatnonzero(np.bincount(of, minlength=count) == 0)
    island = np.concatenate([of, bare])
    by_island = np.argsort(island, kind="stable")
    island = island[by_island]
    start = np.concatenate([starts, centroid[bare]])[by_island]
    end = np.concatenate([ends, centroid[bare]])[by_island]
    length = np.hypot(*(end - start).T)
    length[np.isin(island, bare)] = 1.0
    total = np.bincount(island, length, count)
    after = np.cumsum(length)
    before = after - length - (np.cumsum(total) - total)[island]

    pieces = np.maximum(np.ceil(length / longest_mm).astype(np.int64), 1)
    line, number = each_of(pieces)
    along = (number + 0.5) / pieces[line]
    owner = island[line]
    forward = (before[line] + along * length[line]) / total[owner]
    turned = (before[line] + (1.0 - along) * length[line]) / total[owner]
    share = length[line] / pieces[line] / total[owner]
    return Pieces(
        first=_first_rows(owner, count),
        place=start[line] + along[:, None] * (end - start)[line],
        share=share,
        passed=np.stack([forward, turned, 1.0 - forward, 1.0 - turned]),
        variance=share * area_mm2[owner] / 12.0,
    )


def island_tiles(islands: NDArray[np.object_]) -> Pieces:
    """Cut polygons (I,) into triangles, each halved :data:`HALVED` times across its longest edge."""
    centroid = shapely.get_coordinates(shapely.centroid(islands))
    corners, island = _triangles(_simplified(islands, centroid))
    for _ in range(HALVED):
        corners, island = _halved(corners), np.repeat(island, 2)
    edge = np.diff(corners, axis=1)
    area = 0.5 * np.abs(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0])
    place = corners.mean(axis=1)
    # The mean squared distance from the centroid of a triangle is a twelfth of the sum of those of its corners.
    variance = ((corners - place[:, None]) ** 2).sum(axis=(1, 2)) / 24.0
    share = area / np.bincount(island, area, len(islands))[island]
    return Pieces(
        _first_rows(island, len(islands)),
        place + centroid[island],
        share,
        np.zeros((0, len(share))),
        variance,
    )


def _simplified(islands: NDArray[np.object_], centroid: Floats) -> NDArray[np.object_]:
    """Islands (I,) shifted to their centroids, without corners that hardly matter; in full where one vanishes by that.

    The triangles of a regular hexagon are a matter of rounding: seen from its centroid it is the same wherever it lies.
    """
    points, owner = shapely.get_coordinates(islands, return_index=True)
    seen = points - centroid[owner]
    width_mm, _ = equivalent_rectangles_mm(islands)
    rounded = shapely.set_coordinates(islands.copy(), np.round(seen, DECIMALS))
    rounded = np.asarray(shapely.simplify(rounded, FLAT * width_mm), object)
    broken = ~shapely.is_valid(rounded) | ~(shapely.area(rounded) > 0.0)
    rounded[broken] = shapely.set_coordinates(islands.copy(), seen)[broken]
    return rounded


def _triangles(polygons: NDArray[np.object_]) -> tuple[Floats, Ints]:
    """Corners (T, 3, 2) of triangles that cover polygons (I,), and whose each is; those of the hull of one that cannot be cut."""

    def cut_or_nothing(polygon: shapely.Polygon) -> BaseGeometry:
        try:
            return shapely.constrained_delaunay_triangles(polygon)
        except shapely.GEOSException:
            return shapely.Polygon()

    try:
        cut = np.asarray(shapely.constrained_delaunay_triangles(polygons), object)
    except shapely.GEOSException:
        cut = np.array([cut_or_nothing(polygon) for polygon in polygons], object)
    lost = shapely.area(cut) <= 0.0
    parts, owner = shapely.get_parts(cut[~lost], return_index=True)
    corners = [shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]]
    owners = [np.flatnonzero(~lost)[owner]]
    for i in np.flatnonzero(lost):
        ring = shapely.get_coordinates(shapely.convex_hull(polygons[i]))[:-1]
        corners.append(np.stack([np.broadcast_to(ring[0], ring[2:].shape), ring[1:-1], ring[2:]], axis=1))
        owners.append(np.full(len(ring) - 2, i))
    order = np.argsort(np.concatenate(owners), kind="stable")
    return np.concatenate(corners)[order], np.concatenate(owners)[order]


def _halved(corners: Floats) -> Floats:
    """Both halves (2 T, 3, 2) of triangles (T, 3, 2), side by side."""
    longest = ((np.roll(corners, -1, axis=1) - corners) ** 2).sum(axis=2).argmax(axis=1)
    turned = np.take_along_axis(corners, (longest[:, None] + np.arange(3))[:, :, None] % 3, axis=1)
    a, b, c = turned[:, 0], turned[:, 1], turned[:, 2]
    middle = 0.5 * (a + b)
    return np.stack([a, middle, c, middle, b, c], axis=1).reshape(-1, 3, 2)
