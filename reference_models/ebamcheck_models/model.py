"""Base of reference models: solids with an exact section at every height, and meshes of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import SettingsError
from ebamcheck.mesh.part import Part, rotation_to_z, unit_vector
from ebamcheck.mesh.stl import write_triangles
from ebamcheck.plugins.registry import Model as PublicModel

LEAST_TOLERANCE_MM = 1e-4
"""Finest tessellation: vertices are 32-bit floats, whose steps at 500 mm are 0.00003 mm."""

COARSEST_TOLERANCE_MM = 2.0
"""Coarsest tessellation: up to this tolerance no two curved walls of a model can meet; thinner walls and gaps have flat sides."""

SECTION_TOLERANCE_MM = 1e-4
"""Chord error of the dense rings that represent an exact section."""

Floats = NDArray[np.float64]


@runtime_checkable
class Model(PublicModel, Protocol):
    """A solid known in closed form, in mm, resting on or about z = 0, of which more is known than strangers need tell."""

    @property
    def mesh_volume(self) -> float:
        """Limit of the signed volume of meshes, mm3: `volume`, with overlaps of shells counted once more."""
        ...

    @property
    def shells(self) -> int:
        """Number of closed surfaces that share no vertex: bodies and closed voids."""
        ...

    @property
    def two_manifold(self) -> bool:
        """Whether every edge of a mesh has two facets; four where solids touch along an edge."""
        ...


@runtime_checkable
class TurnableModel(Model, Protocol):
    """A model whose sections are known in every direction."""

    def turned(self, direction: ArrayLike) -> TurnableModel:
        """Return the solid turned so that `direction` points up, as :meth:`ebamcheck.mesh.part.Part.along` turns.

        ``model.turned(d).section(h)`` is the section of the upright model by the plane ``d . p = h``.

        Raises
        ------
        SettingsError
            If the direction is zero or not finite.
        """
        ...


class Solid(ABC):
    """Defaults that hold for most models: one closed surface, no overlaps, no touching bodies."""

    @property
    @abstractmethod
    def volume(self) -> float:
        """Exact volume, mm3."""

    @property
    def shells(self) -> int:
        """Number of closed surfaces that share no vertex."""
        return 1

    @property
    def two_manifold(self) -> bool:
        """Whether every edge of a mesh has two facets."""
        return True

    @property
    def mesh_volume(self) -> float:
        """Limit of the signed volume of meshes, mm3."""
        return self.volume


def rotation(direction: ArrayLike) -> Floats:
    """Rotation (3, 3) that :meth:`ebamcheck.mesh.part.Part.along` turns by."""
    return rotation_to_z(unit_vector(direction))


def checked_tolerance(tolerance_mm: float) -> float:
    """Return the tolerance; refuse one that a mesh could not keep, or at which it would intersect itself."""
    if not LEAST_TOLERANCE_MM <= tolerance_mm <= COARSEST_TOLERANCE_MM:
        raise SettingsError(
            f"tolerance {tolerance_mm} mm: give {LEAST_TOLERANCE_MM:g} .. {COARSEST_TOLERANCE_MM:g} mm, "
            "which 32-bit vertices can keep and the models' walls allow"
        )
    return tolerance_mm


def single(points: Floats) -> Floats:
    """Round coordinates to 32-bit floats, which STL keeps: a part and its file are the same mesh."""
    return points.astype(np.float32).astype(np.float64)


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


def capped_tube(poles: Floats, rings: Floats, columns: int) -> tuple[Floats, NDArray[np.int64]]:
    """Vertices and facets, looking outward, of level rings (n, 3) from bottom to top, closed by a pole (2, 3) at either end."""
    points = np.concatenate([poles, rings])
    ring = np.arange(columns)
    bottom, top = 2 + ring, len(points) - columns + ring
    faces = [
        np.column_stack([np.zeros_like(ring), np.roll(bottom, -1), bottom]),
        grid_faces(2, len(rings) // columns, columns),
        np.column_stack([np.ones_like(ring), top, np.roll(top, -1)]),
    ]
    return single(points), np.concatenate(faces)


def write_stl(part: Part, path: str | Path) -> None:
    """Write a part as binary STL; the file appears whole or not at all, and equal parts give equal bytes.

    Coordinates become 32-bit floats, which keeps every bit of a tessellated reference model.

    Raises
    ------
    SettingsError
        If the file cannot be written.
    """
    with replacing(path) as temporary:
        write_triangles(part.triangles, temporary, part.name)
