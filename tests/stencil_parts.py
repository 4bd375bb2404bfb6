"""Small meshes for the tests of the stencil backend: vertices (V, 3) mm and facets (F, 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]


def box(low=(0.0, 0.0, 0.0), high=(1.0, 1.0, 1.0)) -> Mesh:
    """An axis-aligned box of 12 facets."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return np.array(low) + corners * (np.array(high) - np.array(low)), np.array(faces)


def prism(outline, low: float, high: float) -> Mesh:
    """A convex outline (n, 2), counter-clockwise, drawn out along z."""
    outline = np.asarray(outline, float)
    n = len(outline)
    vertices = np.vstack([np.column_stack([outline, np.full(n, z)]) for z in (low, high)])
    i = np.arange(n)
    j = (i + 1) % n
    sides = np.vstack([np.column_stack([i, j, j + n]), np.column_stack([i, j + n, i + n])])
    fan = np.column_stack([np.zeros(n - 2, int), i[1:-1], i[2:]])
    return vertices, np.vstack([sides, fan[:, ::-1], fan + n])


def cylinder(radius: float, height: float, sides: int = 96) -> Mesh:
    angle = 2 * np.pi * np.arange(sides) / sides
    return prism(radius * np.column_stack([np.cos(angle), np.sin(angle)]), 0.0, height)


def torus(major: float, minor: float, around: int = 96, across: int = 48) -> Mesh:
    """A torus about the z axis."""
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = 2 * np.pi * u.ravel() / around, 2 * np.pi * v.ravel() / across
    ring = major + minor * np.cos(b)
    vertices = np.column_stack([ring * np.cos(a), ring * np.sin(a), minor * np.sin(b)])

    def at(i, k):
        return ((i % around) * across + k % across).ravel()

    p, q, r, s = at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)
    return vertices, np.vstack([np.column_stack([p, q, r]), np.column_stack([p, r, s])])


def joined(*meshes: Mesh) -> Mesh:
    """Several bodies as one mesh."""
    bases = np.cumsum([0, *(len(v) for v, _ in meshes)])
    return (
        np.vstack([v for v, _ in meshes]),
        np.vstack([f + b for (_, f), b in zip(meshes, bases[:-1], strict=True)]),
    )


def turned(mesh: Mesh, axis, angle: float) -> Mesh:
    """A mesh rotated about an axis through the origin (Rodrigues), angle in radians."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return mesh[0] @ rotation.T, mesh[1]


def moved(mesh: Mesh, offset) -> Mesh:
    return mesh[0] + np.asarray(offset, float), mesh[1]


def reversed_mesh(mesh: Mesh) -> Mesh:
    """Every facet turned over: inside out."""
    return mesh[0], mesh[1][:, ::-1]
