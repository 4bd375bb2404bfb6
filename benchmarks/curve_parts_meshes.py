"""What happens to a mesh on its way: turned, rounded by its file, split into slivers, decimated, noisy, irregular."""

from __future__ import annotations

import heapq
from collections.abc import Callable

import manifold3d
import numpy as np
from scipy.spatial import ConvexHull, Delaunay

from benchmarks.curve_parts_solids import Floats, Ints, Solid, Triangles

FORMATS = ("float64", "float32", "ascii4")
"""How coordinates are kept: as they are; in a binary STL; in a text of four decimals, which is then read as 32 bits."""


def turn(seed: int) -> Floats:
    """Rotation (3, 3) drawn evenly by a seed; that of 0 leaves parts upright."""
    if seed == 0:
        return np.eye(3)
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    if np.linalg.det(q) < 0.0:
        q[:, 0] = -q[:, 0]
    return np.asarray(q)


def turned(mesh: Triangles, seed: int) -> Triangles:
    """The mesh turned by :func:`turn`."""
    return Triangles(mesh.vertices @ turn(seed).T, mesh.faces)


def as_file(mesh: Triangles, kind: str) -> Triangles:
    """The mesh as it comes back from a file of a format; vertices that became equal are one."""
    if kind == "float64":
        return mesh
    rounded = np.round(mesh.vertices, 4) if kind == "ascii4" else mesh.vertices
    points, ids = np.unique(rounded.astype(np.float32).astype(np.float64), axis=0, return_inverse=True)
    faces = ids.reshape(-1)[mesh.faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return Triangles(points, faces[whole])


def split_edges(mesh: Triangles, count: int, off_mm: float, seed: int) -> Triangles:
    """Split edges, no two of one facet, near their middles by points a little off them: slivers, and bent planes."""
    rng = np.random.default_rng(seed)
    faces = mesh.faces.tolist()
    facet_of = {(f[k], f[(k + 1) % 3]): i for i, f in enumerate(faces) for k in range(3)}
    edges = sorted(edge for edge in facet_of if edge[0] < edge[1])
    points = mesh.vertices.tolist()
    used: set[int] = set()
    done = 0
    for place in rng.permutation(len(edges)).tolist():
        a, b = edges[place]
        f, g = facet_of[a, b], facet_of[b, a]
        if done == count or f in used or g in used:
            continue
        t = rng.uniform(0.3, 0.7)
        new = len(points)
        middle = (1.0 - t) * mesh.vertices[a] + t * mesh.vertices[b]
        points.append((middle + rng.uniform(-off_mm, off_mm, 3)).tolist())
        for i, (p, q) in ((f, (a, b)), (g, (b, a))):
            third = next(k for k in faces[i] if k not in (p, q))
            faces[i] = [p, new, third]
            faces.append([new, q, third])
            used.update((i, len(faces) - 1))
        done += 1
    return Triangles(np.array(points), np.array(faces, dtype=np.int64))


def noisy(mesh: Triangles, noise_mm: float, seed: int) -> Triangles:
    """Every vertex moved by normal noise of a standard deviation."""
    noise = np.random.default_rng(seed).normal(size=mesh.vertices.shape)
    return Triangles(mesh.vertices + noise_mm * noise, mesh.faces)


def decimated(mesh: Triangles, tolerance_mm: float) -> Triangles:
    """Collapse edges as long as the surface stays within a tolerance (Manifold)."""
    return _triangles(_manifold(mesh).simplify(tolerance_mm))


def bored(body: Solid, tool: Solid, place: Floats, rotation: Floats) -> Solid:
    """A body less a tool that is turned and put somewhere (Manifold): along their seam lie slivers."""
    return lambda chord_mm: _triangles(_manifold(body(chord_mm)) - _placed(tool(chord_mm), place, rotation))


def joined(body: Solid, other: Solid, place: Floats, rotation: Floats) -> Solid:
    """Two bodies as one (Manifold)."""
    return lambda chord_mm: _triangles(_manifold(body(chord_mm)) + _placed(other(chord_mm), place, rotation))


def _placed(mesh: Triangles, place: Floats, rotation: Floats) -> manifold3d.Manifold:
    return _manifold(Triangles(mesh.vertices @ rotation.T + place, mesh.faces))


def _manifold(mesh: Triangles) -> manifold3d.Manifold:
    return manifold3d.Manifold(
        manifold3d.Mesh64(
            vert_properties=np.ascontiguousarray(mesh.vertices),
            tri_verts=np.ascontiguousarray(mesh.faces.astype(np.uint64)),
        )
    )


def _triangles(body: manifold3d.Manifold) -> Triangles:
    made = body.to_mesh64()
    return Triangles(
        np.asarray(made.vert_properties)[:, :3].astype(np.float64),
        np.asarray(made.tri_verts).astype(np.int64),
    )


def irregular_convex(surface: Callable[[Floats], Floats], points: int, seed: int, star: bool = False) -> Triangles:
    """Hull of random points of a convex surface, which maps unit vectors (n, 3) to points of it; of a `star` that of the vectors."""
    directions = np.random.default_rng(seed).normal(size=(points, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    at = surface(directions)
    corners = directions if star else at
    faces = ConvexHull(corners).simplices.astype(np.int64)
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * (a + b + c)).sum(axis=1) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return Triangles(at, faces)


def irregular_torus(surface: Callable[[Floats, Floats], Floats], points: int, seed: int) -> Triangles:
    """Delaunay's triangles over random places of a surface that closes along u and v, each 0 .. 1."""
    uv = np.random.default_rng(seed).random((points, 2))
    wide = np.concatenate([uv + np.array((i, j)) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    triangles = Delaunay(wide).simplices
    middle = wide[triangles].mean(axis=1)
    triangles = triangles[((middle >= 0.0) & (middle < 1.0)).all(axis=1)]
    a, b, c = (wide[triangles[:, k]] for k in range(3))
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0.0
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    faces: Ints = (triangles % points).astype(np.int64)
    return Triangles(surface(uv[:, 0], uv[:, 1]).T, faces)


# -- decimation by quadric error metrics, as mesh programs do it: vertices leave the surface (Garland, Heckbert 1997) --


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
