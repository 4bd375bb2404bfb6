"""Triangle mesh: vertices and facets, and the measures that follow from them alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False, repr=False)
class Mesh:
    """Triangles with common vertices.

    Parameters
    ----------
    vertices
        (V, 3) mm.
    faces
        (F, 3) rows of `vertices`, counter-clockwise seen from outside.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Box of the vertices that facets use, (2, 3) mm: least and greatest corner."""
        if not len(self.faces):
            return np.zeros((2, 3))
        used = (
            self.vertices if len(self.vertices) <= 3 * len(self.faces) else self.vertices[self.faces.ravel()]
        )
        # Column by column: many times faster than numpy's reduction along the first axis of three columns.
        columns = [used[:, c] for c in range(3)]
        return np.array([[column.min() for column in columns], [column.max() for column in columns]])

    @property
    def size(self) -> NDArray[np.float64]:
        """Extents along x, y and z, (3,) mm."""
        result: NDArray[np.float64] = self.bounds[1] - self.bounds[0]
        return result

    @property
    def triangles(self) -> NDArray[np.float64]:
        """Corner points of every facet, (F, 3, 3) mm."""
        return self.vertices[self.faces]

    @cached_property
    def signed_volume(self) -> float:
        """Signed volume, mm3, about the centre of the box: bodies that overlap count twice where they do."""
        a, b, c = np.moveaxis(self.triangles - self.bounds.mean(axis=0), 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def degenerate(mesh: Mesh) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Facets (F,) with a repeated vertex, and facets without area."""
    a, b, c = mesh.faces.T
    repeated = (a == b) | (b == c) | (c == a)
    p, q, r = np.moveaxis(mesh.triangles, 1, 0)
    return repeated, (np.cross(q - p, r - p) == 0.0).all(axis=1)
