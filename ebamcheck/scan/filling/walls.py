"""Beads along thin walls: the centre line of a wall, and lines parallel to it, as many as fit side by side.

The centre line is the part of the Voronoi diagram of points on the wall's border that separates its two sides: an edge counts where
its two border points lie much further apart along the border than straight across. Where three branches meet, the two that go
straightest on are one bead. A pointed end is left to the round end of its one bead, which stops where the wall is narrower than a
share of the bead."""

from __future__ import annotations

import itertools
import math
from collections import Counter

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import QhullError, Voronoi
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.regions import NO_WIDTH_MM, mean_width_mm
from ebamcheck.kernels import Floats, Ints

# Border points per wall width: with three of them, out of step on its two sides, two of five blocks of a wall were zigzag
SAMPLES_ACROSS = 9.0
MOST_SAMPLES = 20_000  # border points of one wall; a wall that would need more is sampled more coarsely
# Border length between two facing points over their distance, at least: 1.4 in a square corner, 1.6 around a rounded end
ARC_OVER_CHORD = 2.0
# A bead stops where the wall's end is narrower than the first times the bead width, or the second times the wall's greatest width, if less
TAPER, TAPER_SHARE = 0.2, 0.1
LEAST_APART = 0.5  # no bead of a wall lies nearer to another one of it than this times the spacing: there one has the metal of both
LEAST_BEAD = 0.5  # no bead reaches less far than this times the bead width, unless the wall has no longer one
STRAIGHT_ON_DEG = 60.0  # turn at a fork up to which one bead goes on through it
STRAIGHTNESS = 0.02  # deviation of the centre line from its samples, over the wall's width, by which it is simplified
ARC_SEGMENTS = 16  # chords in a quarter of the round around a bead's end


def wall_lines(wall: shapely.Polygon, bead_width_mm: float, spacing_mm: float, to_the_end: bool = True) -> list[Floats]:
    """Polylines (k, 2), mm, along which beads fill a thin wall, side by side where it is wide enough; none for a wall that has no
    centre line.

    Every line lies in the wall, and reaches its end, or that of its taper, unless it is not `to_the_end`: then the round end of its
    bead does, as where there is no other metal around. No two are nearer than :data:`LEAST_APART`, none is shorter than
    :data:`LEAST_BEAD` where there is another one."""
    width = mean_width_mm(wall)
    if width <= NO_WIDTH_MM:
        return []
    branches = centre_line(wall, width)
    ends, beads = _fork_counts(branches), []
    for path in _straight_on(branches):
        free = [ends[end] == 1 and not path.is_ring for end in _ends(path)]
        beads += _side_by_side(path, free, wall, bead_width_mm, spacing_mm, to_the_end)
    inside = shapely.intersection(np.asarray(beads, object), wall) if beads else np.zeros(0, object)
    pieces = [part for part in shapely.get_parts(inside) if part.length > 0]
    apart = _apart(pieces, LEAST_APART * spacing_mm, LEAST_BEAD * bead_width_mm)
    return [shapely.get_coordinates(line)[:: 1 if n % 2 == 0 else -1] for n, line in enumerate(apart)]


def centre_line(wall: shapely.Polygon, width_mm: float) -> list[shapely.LineString]:
    """Branches of the centre line of a wall of the given width, from fork to fork or end to end; a free end lies half a width
    before that of the wall."""
    points, place, around, ring = _border_samples(wall, width_mm)
    middle = points.mean(axis=0)  # Qhull joggles, and rounds, by the greatest coordinate
    try:
        # Joggled by some 1e-11 of the extent: else time grows with the square of the points on a straight side.
        diagram = Voronoi(points - middle, qhull_options="Qbb Qc QJ")
    except (QhullError, ValueError):  # fewer than three points apart, or all of them on one line
        return []
    ridges, (a, b) = np.asarray(diagram.ridge_vertices), np.asarray(diagram.ridge_points).T
    # Border points that face each other across the wall.
    chord, one_way = np.hypot(*(points[a] - points[b]).T), np.abs(place[a] - place[b])
    arc = np.minimum(one_way, around[a] - one_way)
    facing = (ring[a] != ring[b]) | (arc > ARC_OVER_CHORD * chord)
    corners = diagram.vertices + middle
    inside = shapely.contains_xy(wall, corners)
    segments = _weeded(corners, ridges[facing & (ridges >= 0).all(axis=1) & inside[ridges].all(axis=1)])
    if not len(segments):
        return []
    lines = np.asarray(shapely.linestrings(segments), np.object_)
    merged = shapely.line_merge(shapely.multilinestrings(lines.tolist()))
    branches = _without_spurs([p for p in shapely.get_parts(merged) if p.length > 0], width_mm)
    straight = [shapely.simplify(branch, STRAIGHTNESS * width_mm) for branch in branches]
    # In an order, and each in a direction, that do not depend on how they were found.
    return sorted((b if _ends(b)[0] <= _ends(b)[1] else shapely.reverse(b) for b in straight), key=_ends)


def _border_samples(wall: shapely.Polygon, width_mm: float) -> tuple[Floats, Floats, Floats, Ints]:
    """Points on the border, their place along their ring, that ring's length, and the ring's number."""
    step = max(width_mm / SAMPLES_ACROSS, wall.length / MOST_SAMPLES)
    points, place, around, ring = [], [], [], []
    for number, line in enumerate((wall.exterior, *wall.interiors)):
        found = shapely.get_coordinates(shapely.segmentize(line, step))
        steps = np.hypot(*np.diff(found, axis=0).T)
        points.append(found[:-1])
        place.append(np.concatenate([[0.0], np.cumsum(steps)[:-1]]))
        around.append(np.full(len(found) - 1, steps.sum()))
        ring.append(np.full(len(found) - 1, number))
    return np.concatenate(points), np.concatenate(place), np.concatenate(around), np.concatenate(ring)


def _weeded(corners: Floats, edges: Ints) -> Floats:
    """Ends of the edges (S, 2, 2) of a diagram without short ones, whose ends are one: where four arms meet, it has two forks
    instead."""
    short = edges[np.hypot(*(corners[edges[:, 0]] - corners[edges[:, 1]]).T) < 1e-4]
    joins = coo_array((np.ones(len(short), np.bool_), (short[:, 0], short[:, 1])), shape=(len(corners),) * 2)
    _, group = connected_components(joins, directed=False)
    _, first = np.unique(group, return_index=True)
    segments = corners[first[group]][edges]
    return np.asarray(segments[(segments[:, 0] != segments[:, 1]).any(axis=1)], np.float64)


def _ends(branch: shapely.LineString) -> tuple[tuple[float, ...], tuple[float, ...]]:
    points = shapely.get_coordinates(branch)
    return tuple(points[0]), tuple(points[-1])


def _fork_counts(branches: list[shapely.LineString]) -> Counter[tuple[float, ...]]:
    return Counter(end for branch in branches for end in _ends(branch))


def _without_spurs(branches: list[shapely.LineString], width_mm: float) -> list[shapely.LineString]:
    """Leave out dead ends shorter than the wall is wide, and join what they forked."""
    if len(branches) == 1:
        return branches
    forks = _fork_counts(branches)
    kept = [b for b in branches if b.length >= width_mm or all(forks[e] > 1 for e in _ends(b)) or b.is_ring]
    if not kept:
        return [max(branches, key=lambda b: float(b.length))]
    return list(shapely.get_parts(shapely.line_merge(shapely.multilinestrings(kept))))


def _straight_on(branches: list[shapely.LineString]) -> list[shapely.LineString]:
    """Join at every fork the two branches that go straightest on, up to :data:`STRAIGHT_ON_DEG`."""
    ways: dict[tuple[float, ...], list[tuple[int, int]]] = {}
    for n, branch in enumerate(branches):
        if not branch.is_ring:
            for side, end in enumerate(_ends(branch)):
                ways.setdefault(end, []).append((n, side))

    def leaving(n: int, side: int) -> Floats:
        """Unit direction in which a branch leaves its start (0) or its end (1)."""
        points = shapely.get_coordinates(branches[n])[:: 1 if side == 0 else -1]
        way = points[1] - points[0]
        return np.asarray(way / max(float(np.hypot(*way)), np.finfo(float).tiny), np.float64)

    turns = []
    for arms in ways.values():
        ahead = [leaving(*arm) for arm in arms]
        for (i, a), (j, b) in itertools.combinations(enumerate(arms), 2):
            if a[0] != b[0]:
                turn = math.degrees(math.acos(max(-1.0, min(1.0, -float(ahead[i] @ ahead[j])))))
                turns.append((round(turn, 6), a, b))
    path = [shapely.get_coordinates(branch) for branch in branches]
    place = {(n, side): (n, side) for n in range(len(branches)) for side in (0, 1)}
    for turn, a, b in sorted(turns):
        if turn > STRAIGHT_ON_DEG or a not in place or b not in place or place[a][0] == place[b][0]:
            continue
        (i, side), (j, other) = place.pop(a), place.pop(b)
        first = path[i] if side == 1 else path[i][::-1]
        second = path[j] if other == 0 else path[j][::-1]
        path[i], path[j] = np.vstack([first, second[1:]]), np.zeros((0, 2))
        place = {key: (i, int(n == j)) if n in (i, j) else (n, at) for key, (n, at) in place.items()}
    return [shapely.LineString(points) for points in path if len(points)]


def _side_by_side(
    path: shapely.LineString,
    free: list[bool],
    wall: shapely.Polygon,
    bead_width_mm: float,
    spacing_mm: float,
    to_the_end: bool,
) -> list[shapely.LineString]:
    """Lines along a path, as many at each place as the wall is wide there; free ends reach the end of the wall."""
    # At least three points, and the wall's width at each.
    points = shapely.get_coordinates(shapely.segmentize(path, min(0.25 * bead_width_mm, 0.5 * path.length)))
    local = 2.0 * np.atleast_1d(shapely.distance(shapely.points(points), wall.boundary))
    steps = np.hypot(*np.diff(points, axis=0).T)
    least_mm = min(TAPER * bead_width_mm, TAPER_SHARE * float(local.max()))
    low = _end_of_taper(local, steps, least_mm) if free[0] else 0
    high = len(points) - 1 - (_end_of_taper(local[::-1], steps[::-1], least_mm) if free[1] else 0)
    reached = [free[0] and low == 0, free[1] and high == len(points) - 1]
    if high == low:  # a point is no line
        low, high = max(low - 1, 0), min(high + 1, len(points) - 1)
    points, local, steps = points[low : high + 1], local[low : high + 1], steps[low:high]
    # Beads side by side; one alone fills a wall a hair wider than itself. A wall must be wider or narrower over a bead width before
    # they change in number: junctions are wider than their walls.
    nearest = np.floor(local / spacing_mm + 0.5)
    needed = np.ceil(local / max(spacing_mm, 1.01 * bead_width_mm))
    counts = np.maximum(1, np.maximum(nearest, needed)).astype(np.int64)
    counts = _steady(counts, steps, bead_width_mm)
    normal = _normals(points, path.is_ring)
    runs = np.split(np.arange(len(counts)), np.flatnonzero(np.diff(counts)) + 1)
    growing: list[tuple[Floats, bool]] = []
    done: list[tuple[Floats, list[bool]]] = []
    for run in runs:
        count = int(counts[run[0]])
        going_on = _going_on(len(growing), count)
        done += [(line, [begun, False]) for k, (line, begun) in enumerate(growing) if k not in going_on]
        before = [growing[k] if k >= 0 else (points[:0], bool(run[0] == 0)) for k in going_on]
        offsets = [((n + 0.5) / count - 0.5) * local[run, None] * normal[run] for n in range(count)]
        grown = zip(before, offsets, strict=True)
        growing = [(np.vstack([line, points[run] + offset]), begun) for (line, begun), offset in grown]
    done += [(line, [begun, True]) for line, begun in growing]
    coarse_mm = STRAIGHTNESS * float(local.mean())
    # Free ends go on beyond the end of a wall cut from other metal, else half-way to it.
    beyond_mm = (2.0 if to_the_end else 0.25) * float(local.max())
    lines = []
    for points, at in done:
        points = _without_hooks(shapely.simplify(shapely.LineString(points), coarse_mm), bead_width_mm)
        if reached[0] and at[0]:
            points = np.vstack([_beyond(points[1], points[0], beyond_mm), points])
        if reached[1] and at[1]:
            points = np.vstack([points, _beyond(points[-2], points[-1], beyond_mm)])
        lines.append(shapely.LineString(points))
    return lines


def _without_hooks(line: shapely.LineString, bead_width_mm: float) -> Floats:
    """Points of a line but for corners at which it turns back on itself, by more than 120 degrees, for less than a quarter of a bead:
    inside a bend, lines beside its middle cross themselves."""
    points = shapely.get_coordinates(line)
    while len(points) > 3:
        steps = np.diff(points, axis=0)
        length = np.maximum(np.hypot(*steps.T), np.finfo(float).tiny)
        straight = (steps[1:] * steps[:-1]).sum(axis=1) / (length[1:] * length[:-1])
        hooks = (straight < -0.5) & (np.minimum(length[1:], length[:-1]) < 0.25 * bead_width_mm)
        if not hooks.any():
            break
        points = points[np.concatenate([[True], ~hooks, [True]])]
    return np.asarray(points, np.float64)


def _end_of_taper(local_mm: Floats, steps_mm: Floats, least_mm: float) -> int:
    """First place along a path that is as wide as a least width; the least is halved while too much metal lies before it."""
    area = np.append(0.0, np.cumsum(0.5 * (local_mm[1:] + local_mm[:-1]) * steps_mm))
    while True:
        place = int(np.flatnonzero(local_mm >= least_mm)[0])
        # A leg of even width holds more of the area, and is no taper.
        if area[place] <= 0.02 * area[-1]:
            return place
        least_mm *= 0.5


def _going_on(before: int, after: int) -> list[int]:
    """Of some lines side by side the one (or -1) that goes on in each of another number: as many as can, the nearest."""
    few, many = sorted((before, after))
    nearest = [min(range(many), key=lambda k: (abs((2 * k + 1) * few - (2 * n + 1) * many), k)) for n in range(few)]
    if before >= after:
        return nearest
    return [nearest.index(n) if n in nearest else -1 for n in range(after)]


def _steady(counts: Ints, steps_mm: Floats, least_mm: float) -> Ints:
    """Counts (n,) whose runs of one number are no shorter than a length: the shortest first takes that of its longer neighbour."""
    counts = counts.copy()
    around = 0.5 * (np.append(steps_mm, 0.0) + np.append(0.0, steps_mm))
    while True:
        edges = np.concatenate([[0], np.flatnonzero(np.diff(counts)) + 1, [len(counts)]])
        lengths = np.add.reduceat(around, edges[:-1])
        k = int(np.argmin(lengths))
        if len(lengths) == 1 or lengths[k] >= least_mm:
            return counts
        beside = [j for j in (k - 1, k + 1) if 0 <= j < len(lengths)]
        longer = max(beside, key=lambda j: float(lengths[j]))
        counts[edges[k] : edges[k + 1]] = counts[edges[longer]]


def _normals(points: Floats, is_ring: bool) -> Floats:
    """Unit vectors (n, 2) to the left of a polyline."""
    along = np.asarray(np.gradient(points, axis=0), np.float64)
    if is_ring and (points[0] == points[-1]).all():
        along[0] = along[-1] = points[1] - points[-2]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    normal /= np.maximum(np.hypot(normal[:, 0], normal[:, 1]), np.finfo(float).tiny)[:, None]
    return np.asarray(normal, np.float64)


def _apart(pieces: list[shapely.LineString], apart_mm: float, least_mm: float) -> list[shapely.LineString]:
    """Lines, the longest as it is and every other one cut back from those before it; short rests are left out."""

    def reach_mm(line: shapely.LineString) -> float:
        """Diagonal of the box around a line: beside a narrow bend a line goes to and fro, and is longer than what it covers."""
        x0, y0, x1, y1 = shapely.bounds(line).tolist()
        return math.hypot(x1 - x0, y1 - y0)

    kept: list[tuple[int, shapely.LineString]] = []
    taken: BaseGeometry = shapely.Polygon()
    # No chord of the round around a bead's end lies nearer than this distance.
    around_mm = apart_mm / math.cos(0.25 * math.pi / ARC_SEGMENTS)
    for n in sorted(range(len(pieces)), key=lambda n: (-round(float(pieces[n].length), 6), n)):
        left = shapely.get_parts(shapely.difference(pieces[n], taken))
        long = [part for part in left if reach_mm(part) >= least_mm or not kept]
        kept += [(n, part) for part in long]
        taken = shapely.union_all([taken, *shapely.buffer(long, around_mm, quad_segs=ARC_SEGMENTS)])
    return [part for _, part in sorted(kept, key=lambda item: item[0])]


def _beyond(before: Floats, end: Floats, distance_mm: float) -> Floats:
    """Point at a distance beyond the end of a segment."""
    length = max(float(np.hypot(*(end - before))), np.finfo(float).tiny)
    return np.asarray(end + (distance_mm / length) * (end - before), np.float64)
