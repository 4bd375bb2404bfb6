"""Beads along thin walls: the centre line of a wall, and lines parallel to it.

The centre line is the part of the Voronoi diagram of points on the wall's border that separates its two
sides: an edge counts where its two border points lie much further apart along the border than straight
across, which leaves out the spurs into corners.
"""

from __future__ import annotations

import numpy as np
import shapely
from scipy.spatial import QhullError, Voronoi

from ebamcheck.rings import Bools, Floats, Ints
from ebamcheck.scan.hatch import lines_across, widest_pitch_mm
from ebamcheck.scan.regions import NO_WIDTH_MM, mean_width_mm

SAMPLES_ACROSS = 3.0
"""Border points per wall width; the centre line of a straight wall is then exact to a few percent of it."""

MOST_SAMPLES = 20_000
"""Border points of one wall; a wall that would need more is sampled more coarsely."""

ARC_OVER_CHORD = 2.0
"""Border length between two facing points over their distance, at least: 1.4 in a square corner, 1.6
around a rounded end, 2 where a wall is as long as half its width."""

STRAIGHTNESS = 0.02
"""Deviation of the centre line from its samples, over the wall's width, by which it is simplified."""

QHULL_OPTIONS = "Qbb Qc QJ"
"""The border points are joggled by some 1e-11 of their extent before their diagram is drawn: without it, its time
grows with the square of the points on a straight side, to 10 s for those of a hair of metal."""

WEED_MM = 1e-7
"""Corners of the Voronoi diagram closer than this are one."""


def wall_lines(wall: shapely.Polygon, bead_width_mm: float, spacing_mm: float) -> list[Floats]:
    """Polylines (k, 2), mm, along which beads fill a thin wall, side by side where it is wide enough.

    Every line lies in the wall and reaches its ends. The list is empty only where the wall is so
    crooked, so short, or so much a hair, that it has no centre line.
    """
    width = mean_width_mm(wall)
    if width <= NO_WIDTH_MM:
        return []
    beads = lines_across(width, spacing_mm, widest_pitch_mm(bead_width_mm, spacing_mm))
    branches = centre_line(wall, width)
    forks = _fork_counts(branches)
    lines = []
    for branch in branches:
        free = [forks[end] == 1 and not branch.is_ring for end in _ends(branch)]
        for n in range(beads):
            beside = _beside(branch, wall, (n + 0.5) / beads - 0.5, width)
            lines.append(_extended(beside, free, width))
    inside = shapely.intersection(np.asarray(lines, object), wall) if lines else np.zeros(0, object)
    found = [shapely.get_coordinates(part) for part in shapely.get_parts(inside) if part.length > 0]
    return [line if n % 2 == 0 else line[::-1] for n, line in enumerate(found) if len(line) > 1]


def centre_line(wall: shapely.Polygon, width_mm: float) -> list[shapely.LineString]:
    """Branches of the centre line of a wall of the given width, each from fork to fork or end to end.

    A free end lies half a width before the end of the wall.
    """
    points, place, around, ring = _border_samples(wall, width_mm)
    middle = points.mean(axis=0)  # Qhull joggles, and rounds, by the greatest coordinate
    try:
        diagram = Voronoi(points - middle, qhull_options=QHULL_OPTIONS)
    except (QhullError, ValueError):  # fewer than three points apart, or all of them on one line
        return []
    ridges = np.asarray(diagram.ridge_vertices)
    facing = _facing(points, place, around, ring, np.asarray(diagram.ridge_points))
    corners = diagram.vertices + middle
    inside = shapely.contains_xy(wall, corners)
    kept = facing & (ridges >= 0).all(axis=1) & inside[ridges].all(axis=1)
    segments = _weeded(corners[ridges[kept]])
    if not len(segments):
        return []
    merged = shapely.line_merge(shapely.MultiLineString(list(segments)))
    branches = _without_spurs([p for p in shapely.get_parts(merged) if p.length > 0], width_mm)
    return _sorted([shapely.simplify(branch, STRAIGHTNESS * width_mm) for branch in branches])


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


def _facing(points: Floats, place: Floats, around: Floats, ring: Ints, pairs: Ints) -> Bools:
    """Which pairs of border points face each other across the wall."""
    a, b = pairs[:, 0], pairs[:, 1]
    chord = np.hypot(*(points[a] - points[b]).T)
    one_way = np.abs(place[a] - place[b])
    arc = np.minimum(one_way, around[a] - one_way)
    return np.asarray((ring[a] != ring[b]) | (arc > ARC_OVER_CHORD * chord), np.bool_)


def _weeded(segments: Floats) -> Floats:
    """Segments (S, 2, 2) whose nearly equal ends are equal; those without length are left out."""
    if not len(segments):
        return segments
    snapped = np.round(segments / WEED_MM) * WEED_MM
    return np.asarray(snapped[(snapped[:, 0] != snapped[:, 1]).any(axis=1)], np.float64)


def _ends(branch: shapely.LineString) -> tuple[tuple[float, ...], tuple[float, ...]]:
    points = shapely.get_coordinates(branch)
    return tuple(points[0]), tuple(points[-1])


def _fork_counts(branches: list[shapely.LineString]) -> dict[tuple[float, ...], int]:
    counts: dict[tuple[float, ...], int] = {}
    for branch in branches:
        for end in _ends(branch):
            counts[end] = counts.get(end, 0) + 1
    return counts


def _without_spurs(branches: list[shapely.LineString], width_mm: float) -> list[shapely.LineString]:
    """Leave out dead ends shorter than the wall is wide, and join what they forked."""
    if len(branches) == 1:
        return branches
    forks = _fork_counts(branches)
    kept = [b for b in branches if b.length >= width_mm or all(forks[e] > 1 for e in _ends(b)) or b.is_ring]
    if not kept:
        return [max(branches, key=lambda b: float(b.length))]
    merged = shapely.line_merge(shapely.multilinestrings(kept))
    return list(shapely.get_parts(merged))


def _sorted(branches: list[shapely.LineString]) -> list[shapely.LineString]:
    """Branches in an order, and each in a direction, that do not depend on how they were found."""
    turned = [b if _ends(b)[0] <= _ends(b)[1] else shapely.reverse(b) for b in branches]
    return sorted(turned, key=_ends)


def _beside(
    line: shapely.LineString, wall: shapely.Polygon, share: float, width_mm: float
) -> shapely.LineString:
    """Line at a share (-1/2 .. 1/2) of the wall's local width to the left of its centre line."""
    if share == 0.0:
        return line
    points = shapely.get_coordinates(shapely.segmentize(line, width_mm))
    along = np.asarray(np.gradient(points, axis=0), np.float64)
    if line.is_ring:
        along[0] = along[-1] = points[1] - points[-2]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    normal /= np.maximum(np.hypot(normal[:, 0], normal[:, 1]), np.finfo(float).tiny)[:, None]
    local = 2.0 * np.atleast_1d(shapely.distance(shapely.points(points), wall.boundary))
    moved = shapely.LineString(points + share * local[:, None] * normal)
    return shapely.simplify(moved, STRAIGHTNESS * width_mm)


def _extended(line: shapely.LineString, free: list[bool], width_mm: float) -> shapely.LineString:
    """Lengthen the free ends by the wall's width, so that the line reaches the end of the wall."""
    points = shapely.get_coordinates(line)
    if free[0]:
        points = np.vstack([_beyond(points[1], points[0], width_mm), points])
    if free[1]:
        points = np.vstack([points, _beyond(points[-2], points[-1], width_mm)])
    return shapely.LineString(points)


def _beyond(before: Floats, end: Floats, distance_mm: float) -> Floats:
    """Point at a distance beyond the end of a segment."""
    length = max(float(np.hypot(*(end - before))), np.finfo(float).tiny)
    return np.asarray(end + (distance_mm / length) * (end - before), np.float64)
