"""Islands: cells clipped to the solids of a layer, small ones whole, slivers merged into neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.layers import valid_polygons
from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.borders import shared_borders
from ebamcheck.scan.lattice import SQRT3, Lattice
from ebamcheck.scan.regions import equivalent_rectangles_mm

WHOLE, THIN_WALL, GAP = "whole", "thin wall", "gap"
"""Kinds of islands beside those of cells: a solid not divided, a thin wall, a spot left by all of these."""

SLIVER_AREA = 1.0
"""Islands under this times the squared bead width are slivers: a bead hardly starts before it stops."""

SLIVER_WIDTH = 0.5
"""Islands narrower than this times the bead spacing are slivers: a line there lies on its neighbours."""

SLIVER_SHARE = 0.2
"""No island is a sliver that has more than this share of a hexagon's area, or of its width: hexagons
that are set small against the bead are what was asked for."""

CUT_TOGETHER = 8
"""Hexagons that are cut against one part of a solid."""

CUT_MARGIN_MM = 1.0
"""How far that part reaches beyond them, so that its own border touches none."""

UNION_GRID_MM = 1e-7
"""Merged islands are united on this grid, which closes the rounding between their common borders."""


@dataclass(frozen=True, eq=False)
class Cells:
    """Islands of one layer before they are filled: `polygons` (I,), `kind` (I,), `colour` (I,)."""

    polygons: NDArray[np.object_]
    kind: NDArray[np.str_]
    colour: Ints


def hexagon_area_mm2(side_mm: float) -> float:
    """Area of a hexagon, 3 sqrt(3) / 2 d^2."""
    return 1.5 * SQRT3 * side_mm**2


def partition(
    solids: Sequence[shapely.Polygon], lattice: Lattice, bead_width_mm: float, spacing_mm: float
) -> Cells:
    """Divide solids into islands by a lattice; together they are the solids, and no two overlap.

    A solid smaller than one hexagon stays whole.
    """
    small = hexagon_area_mm2(lattice.side_mm)
    whole = [p for p in solids if p.area <= small]
    large = [p for p in solids if p.area > small]
    clipped, cell = clip_lattice(large, lattice)
    groups = sliver_groups(
        clipped,
        min(SLIVER_AREA * bead_width_mm**2, SLIVER_SHARE * small),
        min(SLIVER_WIDTH * spacing_mm, SLIVER_SHARE * lattice.width_mm),
    )
    merged, first = _united(clipped, groups)
    return Cells(
        polygons=column([*merged, *whole]),
        kind=np.array([lattice.kind] * len(merged) + [WHOLE] * len(whole), dtype=np.str_),
        colour=np.concatenate([lattice.colour[cell[first]], np.zeros(len(whole), np.int64)]),
    )


def undivided(solids: Sequence[shapely.Polygon]) -> Cells:
    """Return every solid as one island."""
    return Cells(column(solids), np.full(len(solids), WHOLE), np.zeros(len(solids), np.int64))


def clip_lattice(solids: Sequence[shapely.Polygon], lattice: Lattice) -> tuple[NDArray[np.object_], Ints]:
    """Parts of every hexagon that lie in a solid, and the hexagon of each, in order of the hexagons.

    Hexagons inside are kept as they are; only those on a border are cut.
    """
    pieces: list[NDArray[np.object_]] = []
    owners: list[Ints] = []
    for solid in solids:
        shapely.prepare(solid)
        near = np.flatnonzero(shapely.intersects(solid, lattice.cells))
        full = shapely.contains_properly(solid, lattice.cells[near])
        cut = near[~full]
        parts, source = shapely.get_parts(_cut(solid, lattice.cells[cut]), return_index=True)
        solid_parts = shapely.area(parts) > 0.0
        pieces += [lattice.cells[near[full]], parts[solid_parts]]
        owners += [near[full], cut[source[solid_parts]]]
    if not pieces:
        return np.zeros(0, object), np.zeros(0, np.int64)
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(pieces)[order], owner[order]


def _cut(solid: shapely.Polygon, hexagons: NDArray[np.object_]) -> NDArray[np.object_]:
    """Intersection of each hexagon with a solid.

    A cut costs time with every point of the solid; so blocks of hexagons that lie side by side are cut
    against the part of the solid around them.
    """
    found = np.empty(hexagons.size, object)
    order = np.argsort(shapely.bounds(hexagons)[:, 0], kind="stable")
    for start in range(0, hexagons.size, CUT_TOGETHER):
        block = order[start : start + CUT_TOGETHER]
        x0, y0, x1, y1 = shapely.total_bounds(hexagons[block])
        around = shapely.box(x0 - CUT_MARGIN_MM, y0 - CUT_MARGIN_MM, x1 + CUT_MARGIN_MM, y1 + CUT_MARGIN_MM)
        found[block] = shapely.intersection(hexagons[block], shapely.intersection(solid, around))
    return found


def sliver_groups(islands: NDArray[np.object_], area_mm2: float, width_mm: float) -> Ints:
    """Group of every island (I,): slivers are in the group of the neighbour with the longest border.

    The smallest slivers choose first; one that has no neighbour stays alone. A group is named by its
    largest island.
    """
    area = shapely.area(islands)
    width, _ = equivalent_rectangles_mm(islands)
    slivers = np.flatnonzero((area < area_mm2) | (width < width_mm)).tolist()
    root = np.arange(islands.size)
    if not slivers:
        return root
    pairs, border = shared_borders(islands)
    for i in sorted(slivers, key=lambda i: (area[i], i)):
        if _find(root, i) != i:  # already part of a larger one
            continue
        beside = np.concatenate([pairs[pairs[:, 0] == i, 1], pairs[pairs[:, 1] == i, 0]])
        lengths = np.concatenate([border[pairs[:, 0] == i], border[pairs[:, 1] == i]])
        groups = np.array([_find(root, int(j)) for j in beside], np.int64)
        others = np.flatnonzero(groups != i)
        if others.size:
            best = int(groups[others[np.lexsort((beside[others], -lengths[others]))[0]]])
            keep, lose = (best, i) if area[best] >= area[i] else (i, best)
            root[lose] = keep
    return np.array([_find(root, i) for i in range(islands.size)], np.int64)


def _find(root: Ints, i: int) -> int:
    while root[i] != i:
        i = int(root[i])
    return i


def _united(islands: NDArray[np.object_], groups: Ints) -> tuple[list[shapely.Polygon], Ints]:
    """Islands by group, and the island that names each."""
    names, sizes = np.unique(groups, return_counts=True)
    merged: list[shapely.Polygon] = []
    first: list[int] = []
    for name, size in zip(names, sizes, strict=True):
        if size == 1:
            found = [islands[name]]
        else:
            found = valid_polygons(shapely.union_all(islands[groups == name], grid_size=UNION_GRID_MM))
        merged += found
        first += [int(name)] * len(found)
    return merged, np.array(first, np.int64)


def column(polygons: Sequence[BaseGeometry]) -> NDArray[np.object_]:
    """Polygons as an object array (I,), also where there are none or one."""
    found = np.empty(len(polygons), object)
    found[:] = polygons
    return found


def centroids(islands: NDArray[np.object_]) -> Floats:
    """Centroid of each island, (I, 2) mm."""
    return np.asarray(shapely.get_coordinates(shapely.centroid(islands)), np.float64).reshape(-1, 2)
