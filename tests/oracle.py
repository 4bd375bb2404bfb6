"""Sections of a triangle mesh in rational arithmetic: slow, exact, and meant to be read and believed.

Every coordinate of a mesh is a float and so a fraction; no step here rounds. The section is that of the plane
z = h + 0: a vertex at z = h lies below the plane, so an edge is cut where ``min <= h < max``. Material lies
to the left of every segment. The mesh may be any soup of triangles, except where `rings` says otherwise.
"""

from __future__ import annotations

from fractions import Fraction
from typing import NamedTuple


class Point(NamedTuple):
    x: Fraction
    y: Fraction


class Segment(NamedTuple):
    """What one facet leaves in the plane: from one cut edge of the mesh to another."""

    start: Point
    end: Point
    from_edge: frozenset
    to_edge: frozenset


def section(vertices, faces, height) -> list[Segment]:
    """Directed segments of the plane z = height + 0; one a facet that crosses it."""
    h = Fraction(height)
    corners = [tuple(Fraction(float(c)) for c in vertex) for vertex in vertices]
    found = []
    for face in faces:
        i, j, k = (int(v) for v in face)
        down, up = None, None
        for tail, head in ((i, j), (j, k), (k, i)):
            tail_above, head_above = corners[tail][2] > h, corners[head][2] > h
            if tail_above and not head_above:
                down = (tail, head)
            if head_above and not tail_above:
                up = (tail, head)
        if up is None:
            continue
        # A facet that looks towards +x and runs counter-clockwise seen from there climbs at its greater y:
        # so the way with the material on the left is from the edge that goes down to the one that goes up.
        found.append(
            Segment(
                _cut(corners[down[0]], corners[down[1]], h),
                _cut(corners[up[0]], corners[up[1]], h),
                frozenset(down),
                frozenset(up),
            )
        )
    return found


def _cut(a, b, h) -> Point:
    t = (h - a[2]) / (b[2] - a[2])
    return Point(a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]))


def signed_area(segments) -> Fraction:
    """Sum over all points of their winding number (Green's theorem), mm2; the segments close."""
    return sum((s.start.x * s.end.y - s.end.x * s.start.y for s in segments), Fraction(0)) / 2


def winding(segments, x, y) -> int | None:
    """Winding number about a point: crossings of the ray towards +x; None where a segment passes through it."""
    p, q = Fraction(x), Fraction(y)
    total = 0
    for (x0, y0), (x1, y1), _, _ in segments:
        side = (x1 - x0) * (q - y0) - (p - x0) * (y1 - y0)  # > 0: the point is on the left
        if side == 0 and min(x0, x1) <= p <= max(x0, x1) and min(y0, y1) <= q <= max(y0, y1):
            return None
        if y0 <= q < y1 and side > 0:
            total += 1
        if y1 <= q < y0 and side < 0:
            total -= 1
    return total


def inside(segments, x, y) -> bool | None:
    """Whether a point is solid (winding number > 0); None on a contour, even one inside the solid."""
    count = winding(segments, x, y)
    return None if count is None else count > 0


def rings(segments) -> list[list[Point]]:
    """Rings of a mesh in which two facets meet at every edge: followed from cut edge to cut edge.

    Points may repeat and rings may be a mere line or point, as where the plane passes through vertices.
    """
    after = {s.from_edge: s for s in segments}
    assert len(after) == len(segments), "an edge of the mesh has more than two facets"
    found = []
    while after:
        first = next(iter(after))
        ring, edge = [], first
        while edge in after:
            step = after.pop(edge)
            ring.append(step.start)
            edge = step.to_edge
        assert edge == first, "a ring of the section does not close"
        found.append(ring)
    return found


def ring_area(ring) -> Fraction:
    """Signed area of one ring, mm2: counter-clockwise positive."""
    total = Fraction(0)
    for (x0, y0), (x1, y1) in zip(ring, ring[1:] + ring[:1], strict=True):
        total += x0 * y1 - x1 * y0
    return total / 2


def square_distance(segments, x, y) -> Fraction:
    """Square of the distance of a point from the nearest segment, mm2."""
    p, q = Fraction(float(x)), Fraction(float(y))
    best = None
    for (x0, y0), (x1, y1), _, _ in segments:
        dx, dy = x1 - x0, y1 - y0
        length = dx * dx + dy * dy
        t = ((p - x0) * dx + (q - y0) * dy) / length if length else Fraction(0)
        t = min(max(t, Fraction(0)), Fraction(1))
        square = (x0 + t * dx - p) ** 2 + (y0 + t * dy - q) ** 2
        best = square if best is None else min(best, square)
    assert best is not None, "an empty section is at no distance"
    return best
