"""What a reference model is: a solid with an exact section at every height, and meshes of it."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.errors import SettingsError
from ebamcheck.part import Part, from_arrays

LEAST_TOLERANCE_MM = 1e-4
"""Finest tessellation: vertices are 32-bit floats, whose steps at 500 mm are 0.00003 mm."""

COARSEST_TOLERANCE_MM = 2.0
"""Walls of the models are at least 6 mm apart; up to this tolerance no two of their meshes can meet."""

SECTION_TOLERANCE_MM = 1e-4
"""Chord error of the dense rings that stand for an exact section."""

Floats = NDArray[np.float64]


@runtime_checkable
class Model(Protocol):
    """A solid known in closed form, in mm, resting on or about z = 0.

    Attributes
    ----------
    name
        Key in the entry point group ``ebamcheck.models``, and the name of its parts.
    summary
        What it is, in one line.
    """

    @property
    def name(self) -> str:
        """Key of the model."""
        ...

    @property
    def summary(self) -> str:
        """What it is, in one line."""
        ...

    @property
    def euler_number(self) -> int:
        """Vertices - edges + faces of any mesh of the surface: 2 - 2 (through holes) for one body."""
        ...

    @property
    def bounds(self) -> Floats:
        """Least and greatest corner, (2, 3) mm."""
        ...

    def section(self, z: float, tolerance_mm: float = SECTION_TOLERANCE_MM) -> list[shapely.Polygon]:
        """Solid regions at height `z` (that of z + 0 at a step), rings as dense as the tolerance asks."""
        ...

    def area(self, z: float) -> float:
        """Exact area of the section at height `z`, mm2."""
        ...

    @property
    def volume(self) -> float:
        """Exact volume, mm3."""
        ...

    def tessellate(self, tolerance_mm: float) -> Part:
        """Return a closed, outward mesh whose vertices lie on the surface and no point of which is farther from it.

        Raises
        ------
        SettingsError
            If the tolerance is not within :data:`LEAST_TOLERANCE_MM` .. :data:`COARSEST_TOLERANCE_MM`.
        """
        ...


def checked_tolerance(tolerance_mm: float) -> float:
    """Return the tolerance, refused where a mesh could not keep it or would cut itself."""
    if not LEAST_TOLERANCE_MM <= tolerance_mm <= COARSEST_TOLERANCE_MM:
        raise SettingsError(
            f"tolerance {tolerance_mm} mm: give {LEAST_TOLERANCE_MM:g} .. {COARSEST_TOLERANCE_MM:g} mm, "
            "which 32-bit vertices can keep and walls of 6 mm allow"
        )
    return tolerance_mm


def single(points: Floats) -> Floats:
    """Round coordinates to 32-bit floats, which STL keeps: a part and its file are the same mesh."""
    return points.astype(np.float32).astype(np.float64)


def make_part(vertices: Floats, faces: NDArray[np.int64], name: str) -> Part:
    """Part from vertices that are rounded already."""
    return from_arrays(vertices, faces, name=name)


def grid_faces(first: int, rows: int, columns: int) -> NDArray[np.int64]:
    """Two facets for each cell of a grid that closes along its rows, (2 (rows - 1) columns, 3).

    Vertex (k, j) is ``first + k columns + j``. Where row 0 runs counter-clockwise seen from above and
    later rows lie higher, the facets look outward.
    """
    k, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a = first + k * columns + j
    b = first + k * columns + (j + 1) % columns
    lower = np.stack([a, b, b + columns], axis=-1)
    upper = np.stack([a, b + columns, a + columns], axis=-1)
    return np.stack([lower, upper], axis=2).reshape(-1, 3).astype(np.int64)
