"""A part placed for a program that cuts the middles of layers of one height, from the bed upwards.

Magnified across the plane as the program needs it, and stretched along z so that a plane of the lattice lies in the
middle of every layer: then no layer height has to be rounded to what the program can read. A small mark in layer 0, below
the part, and one above it keep the program from moving the part down and from leaving layers out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ebamcheck.errors import BackendFailed
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import edge_groups
from ebamcheck.numeric.rings import EPSILON, Floats
from ebamcheck.slicers.outside.lattices import SAME_PLANE_MM, Lattice

LAYERS_OF_A_SINGLE = 16
"""Layers over the height of a part of which one single plane is wanted: coordinates then lose no bit to the margins."""

MARK_SHARE = 2.0**-10
"""Side of a mark over the smaller side of the part."""

MARK_LAYERS = 0.6
"""Height of a mark over that of a layer: the lower one is cut in the middle of layer 0, the upper one nowhere."""

MARK = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
MARK_FACETS = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)])
"""A tetrahedron with facets counter-clockwise seen from outside."""

HALF_STEP = 2.0**-25
"""Largest rounding of a 32-bit float, over its value."""


@dataclass(frozen=True)
class Placement:
    """Coordinates as a program gets them.

    Parameters
    ----------
    part, lattice
        The part, and the planes that are wanted.
    scale
        Magnification across the plane.
    layer
        Height of a layer in the program's coordinates, where the bed is at z = 0.
    """

    part: Part
    lattice: Lattice
    scale: float
    layer: float

    @property
    def step_mm(self) -> float:
        """Height of a layer in the part, mm."""
        return (
            self.lattice.step_mm if self.lattice.count > 1 else float(self.part.size[2]) / LAYERS_OF_A_SINGLE
        )

    @property
    def first_layer(self) -> int:
        """Layer in whose middle the lattice begins; the part stands above the middle of layer 0."""
        return math.floor((self.lattice.first_mm - float(self.part.bounds[0, 2])) / self.step_mm) + 1

    @property
    def layer_count(self) -> int:
        """Layers from the bed to the upper mark."""
        above_mm = float(self.part.bounds[1, 2]) - self.lattice.first_mm
        return self.first_layer + math.floor(above_mm / self.step_mm) + 2

    def triangles(self) -> Floats:
        """Corners of all facets and of the two marks, (F + 8, 3, 3)."""
        placed = self.part.triangles - (*self.part.bounds[0, :2].tolist(), self.lattice.first_mm)
        placed *= (self.scale, self.scale, self.layer / self.step_mm)
        placed[:, :, 2] += (self.first_layer + 0.5) * self.layer
        side = MARK_SHARE * self.scale * float(self.part.size[:2].min())
        mark = (MARK * (side, side, MARK_LAYERS * self.layer))[MARK_FACETS]
        top = (0.0, 0.0, (self.layer_count - 0.25) * self.layer)
        return np.concatenate([placed, mark, mark + top])

    def layers(self, found: dict[int, list[Floats]], **labels: Any) -> Layers:
        """Make layers of rings by the program's layer; a ring that ends where it begins is closed, another open."""
        wanted = [found.get(self.first_layer + k, []) for k in range(self.lattice.count)]
        rings = [ring for layer in wanted for ring in layer]
        points = np.concatenate(rings) if rings else np.zeros((0, 2))
        return canonical(
            self.lattice.heights,
            points / self.scale + self.part.bounds[0, :2],
            np.concatenate([[0], np.cumsum([len(ring) for ring in rings], dtype=np.int64)]),
            np.concatenate([[0], np.cumsum([len(layer) for layer in wanted], dtype=np.int64)]),
            np.array([bool((ring[0] == ring[-1]).all()) for ring in rings], np.bool_),
            **labels,
        )


def scale_to(part: Part, size: float) -> float:
    """Power of two that takes the larger side of a part across the plane to between half of a size and that size."""
    side = float(part.size[:2].max())
    exponent = math.frexp(size / side)[1] - 1 if side > 0.0 else 0
    return math.ldexp(1.0, max(-200, min(200, exponent)))


def coordinate_rounding_mm(part: Part) -> float:
    """Largest rounding of a coordinate across the plane to 32 bits and back, mm."""
    return HALF_STEP * float(part.size[:2].max()) + 4.0 * EPSILON * float(np.abs(part.bounds).max())


def height_rounding_mm(part: Part) -> float:
    """Largest rounding of a height to 32 bits, mm: a lattice has a plane at every half of the part at least."""
    largest = float(np.abs(part.bounds).max())
    return HALF_STEP * 2.0 * float(part.size[2]) + SAME_PLANE_MM + 8.0 * EPSILON * largest


def refuse_what_is_mended(part: Part, program: str) -> None:
    """Raise :class:`BackendFailed` for parts that a program would mend in silence: its slices were of another part."""
    groups = edge_groups(part.faces, len(part.vertices))
    uneven = int(np.count_nonzero(np.diff(groups.starts) % 2))
    if uneven:
        raise BackendFailed(
            f"part {part.name!r} is open: {uneven} edges have an odd number of facets, and {program} would close them in "
            "its own way; mend the mesh or use another backend"
        )
    if part.volume < 0.0:
        raise BackendFailed(
            f"part {part.name!r} has a negative volume ({part.volume:.6g} mm3), and {program} would turn it; turn its "
            "facets (--fix-orientation) or use another backend"
        )
