"""Small generated parts that several test files share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.mesh.part import Part, from_arrays

BOX_FACES = np.array(
    [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4),
     (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)]
)  # fmt: skip


def box(lower: ArrayLike = (0, 0, 0), upper: ArrayLike = (2, 2, 2)) -> Part:
    (x0, y0, z0), (x1, y1, z1) = np.asarray(lower, float), np.asarray(upper, float)
    corners = [(x, y, z) for z in (z0, z1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
    return from_arrays(corners, BOX_FACES, "box")


def join(*parts: Part) -> Part:
    """Put parts side by side in one mesh, vertices of different parts kept apart."""
    offsets = np.cumsum([0] + [len(p.vertices) for p in parts])
    return from_arrays(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.faces + o for p, o in zip(parts, offsets[:-1], strict=True)]),
        "joined",
    )


def welded(part: Part) -> Part:
    from ebamcheck.mesh.files import weld

    return from_arrays(*weld(part.triangles), part.name)


def sphere(radius: float = 10.0, rings: int = 24, segments: int = 48) -> Part:
    """UV sphere, closed, poles as single vertices."""
    theta = np.linspace(0, np.pi, rings + 1)[1:-1]
    phi = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    grid = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    vertices = radius * np.vstack([grid, [(0, 0, 1), (0, 0, -1)]])
    north, south = len(grid), len(grid) + 1
    faces = []
    for j in range(segments):
        k = (j + 1) % segments
        faces.append((north, j, k))
        last = (rings - 2) * segments
        faces.append((south, last + k, last + j))
        for i in range(rings - 2):
            a, b = i * segments, (i + 1) * segments
            faces += [(a + j, b + j, b + k), (a + j, b + k, a + k)]
    return from_arrays(vertices, faces, "sphere")


def torus(major: float = 20.0, minor: float = 6.0, m: int = 48, n: int = 24) -> Part:
    """Torus about z; generic in z as long as no height is one of its rings."""
    u, v = np.meshgrid(np.arange(m) * 2 * np.pi / m, np.arange(n) * 2 * np.pi / n, indexing="ij")
    r = major + minor * np.cos(v)
    vertices = np.stack([r * np.cos(u), r * np.sin(u), minor * np.sin(v)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(m), np.arange(n), indexing="ij")
    a, b = i * n + j, (i + 1) % m * n + j
    c, d = (i + 1) % m * n + (j + 1) % n, i * n + (j + 1) % n
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return from_arrays(vertices, faces, "torus")


def moved(part: Part, matrix: ArrayLike = ((1, 0, 0), (0, 1, 0), (0, 0, 1)), shift: ArrayLike = (0, 0, 0)) -> Part:
    """Apply a linear map and a shift; a mirroring map turns the facets over as well."""
    m = np.asarray(matrix, float)
    faces = part.faces if np.linalg.det(m) > 0 else part.faces[:, ::-1]
    return from_arrays(part.vertices @ m.T + np.asarray(shift, float), faces, part.name)


def turn_z(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def tilted(part: Part) -> Part:
    """Turn a part so that no face of a box is parallel to an axis."""
    a, b = np.radians(33.0), np.radians(21.0)
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return moved(part, x @ y)
