"""What happens to a mesh on its way: turned, rounded by its file, split into slivers, decimated, noisy, irregular."""

from __future__ import annotations

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

    def mesh(chord_mm: float) -> Triangles:
        cutter = tool(chord_mm)
        moved = Triangles(cutter.vertices @ rotation.T + place, cutter.faces)
        return _triangles(_manifold(body(chord_mm)) - _manifold(moved))

    return mesh


def joined(body: Solid, other: Solid, place: Floats, rotation: Floats) -> Solid:
    """Two bodies as one (Manifold)."""

    def mesh(chord_mm: float) -> Triangles:
        second = other(chord_mm)
        moved = Triangles(second.vertices @ rotation.T + place, second.faces)
        return _triangles(_manifold(body(chord_mm)) + _manifold(moved))

    return mesh


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


def irregular_convex(surface: Callable[[Floats], Floats], points: int, seed: int) -> Triangles:
    """Hull of random points of a convex surface, which maps unit vectors (n, 3) to points of it."""
    directions = np.random.default_rng(seed).normal(size=(points, 3))
    at = surface(directions / np.linalg.norm(directions, axis=1)[:, None])
    hull = ConvexHull(at)
    faces = hull.simplices.astype(np.int64)
    a, b, c = (at[faces[:, k]] for k in range(3))
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
