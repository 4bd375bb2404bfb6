"""The part: a welded triangle mesh in millimetres, with its source and its slicing direction."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.showing import short_text


@dataclass(frozen=True, eq=False, repr=False)
class Mesh:
    """Triangles: vertices (V, 3), mm, and faces (F, 3), rows of them, counter-clockwise seen from outside."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Box of the vertices that facets use, (2, 3) mm: least and greatest corner."""
        if not len(self.faces):
            return np.zeros((2, 3))
        used = self.vertices if len(self.vertices) <= 3 * len(self.faces) else self.vertices[self.faces.ravel()]
        # Column by column: many times faster than numpy's reduction along the first axis of three columns.
        columns = [used[:, c] for c in range(3)]
        return np.array([[column.min() for column in columns], [column.max() for column in columns]])

    @property
    def size(self) -> NDArray[np.float64]:
        """Extents along x, y and z, (3,) mm."""
        return np.asarray(self.bounds[1] - self.bounds[0])

    @property
    def triangles(self) -> NDArray[np.float64]:
        """Corner points of every facet, (F, 3, 3) mm."""
        return self.vertices[self.faces]

    @cached_property
    def signed_volume(self) -> float:
        """Signed volume, mm3, about the centre of the box: bodies that overlap count twice where they do."""
        a, b, c = np.moveaxis(self.triangles - self.bounds.mean(axis=0), 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


# Vertices rotated at a time: BLAS spreads larger products over threads that wait for each other, on a busy machine for very long
MOST_ROWS = 8192

FROM_FILE = "from the file"
FROM_FORMAT = "by default of 3MF"
FROM_SETTINGS = "from --units (part.units)"
FROM_DEFAULT = "by default"
FROM_PARTS = "from each part of the plate"  # where the unit of a part's file comes from

Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Part(Mesh):
    """A triangle mesh in which equal vertices are merged.

    Parameters
    ----------
    vertices
        (V, 3) float64, mm, in build coordinates.
    faces
        (F, 3) int32 rows of `vertices`, counter-clockwise seen from outside.
    name
        Name of the part in reports.
    source, source_sha256
        File it was read from and the SHA-256 of that file's bytes; empty for a part made in memory.
    units, units_from
        Unit of the file's numbers, converted once at reading, and where it comes from.
    direction
        Slicing direction in the coordinates of the file; `vertices` are rotated so that it points up.
    notes
        Remarks from reading the file.

    Examples
    --------
    >>> corners = [(0, 0, 0), (2, 0, 0), (0, 2, 0), (0, 0, 3)]
    >>> part = from_arrays(corners, [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)], "tip")
    >>> part, part.volume
    (<Part: tip, 4 facets, 2 x 2 x 3 mm>, 2.0)
    """

    name: str = "part"
    source: str = ""
    source_sha256: str = ""
    units: str = "mm"
    units_from: str = FROM_DEFAULT
    direction: Vector = (0.0, 0.0, 1.0)
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        facets = short_text.counted(len(self.faces), "facet")
        return short_text.line("Part", self.name, facets, short_text.size(self.size.tolist()))

    def _repr_html_(self) -> str:
        """Show the part in a notebook."""
        facts = {
            "file": self.source or "made in memory",
            "facets": len(self.faces),
            "vertices": len(self.vertices),
            "size": short_text.size(self.size.tolist()),
            "lowest corner": ", ".join(f"{v:.6g}" for v in self.bounds[0]) + " mm",
            "volume": f"{self.volume:.6g} mm3",
            "unit of the file": f"{self.units} ({self.units_from})",
            "slicing direction": ", ".join(f"{v:g}" for v in self.direction),
        }
        return short_text.html(self.name, facts)

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the facets on three-dimensional matplotlib axes; `style` is of its surface."""
        from ebamcheck.showing.plotting import plot_facets

        return plot_facets(self.vertices, self.faces, self.name, ax, **style)

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the mesh itself: vertices and faces as they will be sliced."""
        digest = hashlib.sha256(np.ascontiguousarray(self.vertices).data)
        digest.update(np.ascontiguousarray(self.faces).data)
        return digest.hexdigest()

    @property
    def volume(self) -> float:
        """Volume of what is built, mm3: of the places with a winding number over 0; the signed one of an open part."""
        from ebamcheck.mesh.bodies import bodies_of  # kernels load when they are needed

        return bodies_of(self).volume_mm3

    def along(self, direction: ArrayLike) -> Part:
        """Rotate the part, once, so that `direction` (in the coordinates of the file) points up; +z changes no bit."""
        target = unit_vector(direction)
        if self.direction != (0.0, 0.0, 1.0):
            raise SettingsError(f"part {self.name!r} is turned to {self.direction} already: load it again")
        if target == (0.0, 0.0, 1.0):
            return self
        rotation = rotation_to_z(target).T
        vertices = np.empty_like(self.vertices)
        # Shares of about equal size: a share of a single row would be rounded differently.
        shares = len(vertices) // MOST_ROWS + 1
        for k in range(shares):
            rows = slice(len(vertices) * k // shares, len(vertices) * (k + 1) // shares)
            np.matmul(self.vertices[rows], rotation, out=vertices[rows])
        return replace(self, vertices=vertices, direction=target)

    def reversed(self) -> Part:
        """Return the part with every facet reversed."""
        return replace(self, faces=np.ascontiguousarray(self.faces[:, ::-1]))


def unit_vector(direction: ArrayLike) -> Vector:
    """Normalise a direction; an axis comes out exact."""
    vector = np.asarray(direction, dtype=np.float64).reshape(-1)
    length = float(np.linalg.norm(vector)) if vector.size == 3 else 0.0
    if vector.size != 3 or not np.isfinite(length) or length == 0.0:
        raise SettingsError(f"slicing direction {direction!r} is not a direction: give three numbers, not all 0")
    x, y, z = (vector / length + 0.0).tolist()
    return (x, y, z)


def rotation_to_z(direction: Vector) -> NDArray[np.float64]:
    """Smallest rotation (3, 3) that takes a unit vector to +z (Rodrigues); half a turn about x for -z."""
    x, y, z = direction
    if z < -1.0 + 1e-14:
        return np.diag([1.0, -1.0, -1.0])
    # Near -z little is left of 1 + z, and that is rounded: with x^2 + y^2 = 1 - z^2 the same has all its digits.
    k = 1.0 / (1.0 + z) if z >= 0.0 else (1.0 - z) / (x * x + y * y)
    return np.array([[1.0 - x * x * k, -x * y * k, -x], [-x * y * k, 1.0 - y * y * k, -y], [x, y, z]]) + 0.0


def from_arrays(vertices: ArrayLike, faces: ArrayLike, name: str = "part") -> Part:
    """Make a part from arrays, for models and tests."""
    points = np.ascontiguousarray(vertices, dtype=np.float64).reshape(-1, 3)
    index = np.ascontiguousarray(faces, dtype=np.int64).reshape(-1, 3)
    wrong = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if wrong.size:
        told = f"vertex {wrong[0]} is {points[wrong[0]].tolist()}: coordinates must be finite"
        raise InputError(f"{name}: {told}")
    wrong = np.flatnonzero(((index < 0) | (index >= len(points))).any(axis=1))
    if wrong.size:
        told = f"facet {wrong[0]} is {index[wrong[0]].tolist()}, but there are {len(points)} vertices"
        raise InputError(f"{name}: {told}")
    return Part(points, index.astype(np.int32), name=name)
