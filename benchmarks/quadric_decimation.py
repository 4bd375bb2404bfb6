"""Decimation by quadric error metrics, as mesh programs do it: vertices leave the surface (Garland, Heckbert 1997)."""

from __future__ import annotations

import heapq

import numpy as np

from benchmarks.curve_parts_solids import Floats, Triangles

STIFFNESS = 1e-3
"""Weight of an edge's middle, over the trace of its quadric: where planes do not tell a place it stays on the edge."""

COST_DECIMALS, PLACE_DECIMALS = 12, 9
"""Of costs, mm2, and places, mm: edges of a symmetrical part cost the same, and rounding, which differs from one processor to
another, is not to choose among them."""

LEAST_COSINE = 0.2
"""Of the angle by which a facet may turn when an edge is collapsed."""


def quadric_decimated(mesh: Triangles, share: float) -> Triangles:
    """Collapse edges, the cheapest first, until so large a share of the facets is left or no edge may go."""
    points = mesh.vertices.copy()
    faces = [list(f) for f in mesh.faces.tolist()]
    around: list[set[int]] = [set() for _ in points]
    quadrics = np.zeros((len(points), 4, 4))
    for f, corners in enumerate(faces):
        n = np.cross(points[corners[1]] - points[corners[0]], points[corners[2]] - points[corners[0]])
        size = float(np.linalg.norm(n))
        if size > 0.0:
            plane = np.append(n / size, -float(n @ points[corners[0]]) / size)
            quadrics[corners] += 0.5 * size * np.outer(plane, plane)
        for v in corners:
            around[v].add(f)
    version = [0] * len(points)

    def ring(v: int) -> set[int]:
        return {w for f in around[v] for w in faces[f]} - {v}

    def entry(a: int, b: int) -> tuple[float, int, int, int, int, tuple[float, ...]]:
        place, cost = _best(quadrics[a] + quadrics[b], points[a], points[b])
        return cost, a, b, version[a], version[b], tuple(place.tolist())

    heap = [entry(a, b) for a in range(len(points)) for b in ring(a) if a < b]
    heapq.heapify(heap)
    alive = len(faces)
    while heap and alive > share * len(faces):
        _, a, b, seen_a, seen_b, to = heapq.heappop(heap)
        if (version[a], version[b]) != (seen_a, seen_b) or len(ring(a) & ring(b)) != 2:
            continue
        place = np.array(to)
        gone = around[a] & around[b]
        if any(_turns(points, faces[f], v, place) for v in (a, b) for f in around[v] - gone):
            continue
        points[a] = place
        quadrics[a] += quadrics[b]
        for f in gone:
            for v in faces[f]:
                around[v].discard(f)
        for f in around[b]:
            faces[f] = [a if v == b else v for v in faces[f]]
            around[a].add(f)
        around[b] = set()
        alive -= len(gone)
        version[a] += 1
        version[b] += 1
        for w in ring(a):
            heapq.heappush(heap, entry(min(a, w), max(a, w)))
    kept = sorted(set().union(*around))
    used, ids = np.unique(np.array([faces[f] for f in kept]), return_inverse=True)
    return Triangles(points[used], ids.reshape(-1, 3).astype(np.int64))


def _best(quadric: Floats, a: Floats, b: Floats) -> tuple[Floats, float]:
    """Place with the least error near to an edge, and its cost."""
    A, middle = quadric[:3, :3], 0.5 * (a + b)
    weight = STIFFNESS * max(float(np.trace(A)), 1e-12)
    place = np.linalg.solve(A + weight * np.eye(3), weight * middle - quadric[:3, 3])
    if np.linalg.norm(place - middle) > np.linalg.norm(b - a):
        place = middle
    at = np.append(place, 1.0)
    return np.round(place, PLACE_DECIMALS), round(float(at @ quadric @ at), COST_DECIMALS)


def _turns(points: Floats, corners: list[int], moved: int, place: Floats) -> bool:
    """Whether a facet turns over, or nearly, when one of its corners moves."""
    old = [points[v] for v in corners]
    new = [place if v == moved else points[v] for v in corners]
    n, m = np.cross(old[1] - old[0], old[2] - old[0]), np.cross(new[1] - new[0], new[2] - new[0])
    return bool(n @ m <= LEAST_COSINE * float(np.linalg.norm(n) * np.linalg.norm(m)))
