"""The lines of islands in short pieces: where their heat goes into the layer, and when, by each way of driving."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.hatch import Vectors

WAYS = 4
"""Ways of driving an island, as in :class:`~ebamcheck.scan.drive.IslandDrive`."""


class Pieces(NamedTuple):
    """Pieces of lines, side by side those of one island.

    Parameters
    ----------
    first
        (I + 1,) first piece of each island.
    place
        (M, 2) middle, mm.
    share
        (M,) of the island's heat, and of its area.
    passed
        (4, M) share of the island's time after which the beam is there, by the way of driving.
    variance
        (M,) of the heat around the middle along one axis, mm^2: that of a square tile of the same area.
    """

    first: Ints
    place: Floats
    share: Floats
    passed: Floats
    variance: Floats


def line_pieces(lines: Vectors, centroid: Floats, area_mm2: Floats, longest_mm: float) -> Pieces:
    """Cut the lines of islands into pieces; an island without lines is one piece at its centroid.

    The beam counts as passing from line to line in no time, and as driving all of them in the island's time.

    Parameters
    ----------
    lines
        Sorted by island.
    centroid, area_mm2
        (I, 2) and (I,) of the islands.
    longest_mm
        Longest piece.
    """
    count = len(area_mm2)
    bare = np.flatnonzero(np.bincount(lines.island, minlength=count) == 0)
    island = np.concatenate([lines.island, bare])
    by_island = np.argsort(island, kind="stable")
    island = island[by_island]
    start = np.concatenate([lines.start, centroid[bare]])[by_island]
    end = np.concatenate([lines.end, centroid[bare]])[by_island]
    length = np.hypot(*(end - start).T)
    length[np.isin(island, bare)] = 1.0
    total = np.bincount(island, length, count)
    after = np.cumsum(length)
    before = after - length - (np.cumsum(total) - total)[island]

    pieces = np.maximum(np.ceil(length / longest_mm).astype(np.int64), 1)
    line = np.repeat(np.arange(len(length)), pieces)
    number = np.arange(len(line)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    along = (number + 0.5) / pieces[line]
    owner = island[line]
    forward = (before[line] + along * length[line]) / total[owner]
    turned = (before[line] + (1.0 - along) * length[line]) / total[owner]
    share = length[line] / pieces[line] / total[owner]
    return Pieces(
        first=np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=count))]).astype(np.int64),
        place=start[line] + along[:, None] * (end - start)[line],
        share=share,
        passed=np.stack([forward, turned, 1.0 - forward, 1.0 - turned]),
        variance=share * area_mm2[owner] / 12.0,
    )


def spread_over(pieces: Pieces, islands: NDArray[np.object_]) -> Pieces:
    """Pieces moved and scaled as a whole, so that those of an island have the centroid and the polar moment of its area."""
    owner = np.repeat(np.arange(len(islands)), np.diff(pieces.first))
    centroid, moment_mm2 = shapely.get_coordinates(shapely.centroid(islands)), polar_moment_mm2(islands)

    def total(values: Floats) -> Floats:
        return np.bincount(owner, pieces.share * values, len(islands)).astype(np.float64)

    middle = np.column_stack([total(pieces.place[:, 0]), total(pieces.place[:, 1])])
    away = pieces.place - middle[owner]
    scale = np.sqrt(moment_mm2 / total((away**2).sum(axis=1) + 2.0 * pieces.variance))[owner]
    return pieces._replace(
        place=np.ascontiguousarray(centroid[owner] + scale[:, None] * away),
        variance=scale**2 * pieces.variance,
    )


def polar_moment_mm2(islands: NDArray[np.object_]) -> Floats:
    """Mean of the squared distance from the centroid over the area of polygons, (I,) mm^2.

    The integral over a polygon is that over the triangles of its edges with the origin, here the centroid:
    (a x b) (a^2 + a b + b^2) / 12, holes turning the other way.
    """
    centroid = shapely.get_coordinates(shapely.centroid(islands))
    parts, owner = shapely.get_parts(islands, return_index=True)
    rings, part = shapely.get_rings(shapely.orient_polygons(parts), return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    island = owner[part][ring]
    points = points - centroid[island]
    a, b, same = points[:-1], points[1:], ring[1:] == ring[:-1]
    cross = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * same
    square = (a**2 + a * b + b**2).sum(axis=1)
    whole = np.bincount(island[:-1], cross * square, len(islands)) / 12.0
    return np.asarray(whole / shapely.area(islands), np.float64)
