"""The lines of islands in short pieces: where their heat goes into the layer, and when, by each entry option."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.filling.hatch import Vectors

OPTIONS = 4
"""Entry options of an island, as in :class:`~ebamcheck.scan.filling.schedule.IslandSchedule`."""


HALVED = 1
"""Times that the triangles of an island are halved: a hexagon has 8 tiles then, each a Gaussian of its moment."""


DECIMALS = 6
"""Of the corners of islands, mm, by which they are cut into tiles."""


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
        (4, M) share of the island's time after which the beam is there, by the entry option.
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


class Tiles(NamedTuple):
    """Islands in tiles that cover them, as :class:`Pieces` has their lines: first, place, share and variance alike."""

    first: Ints
    place: Floats
    share: Floats
    variance: Floats


def island_tiles(islands: NDArray[np.object_]) -> Tiles:
    """Cut polygons (I,) into triangles, each halved :data:`HALVED` times across its longest edge."""
    centroid = shapely.get_coordinates(shapely.centroid(islands))
    cut = [_triangles(polygon) for polygon in _at_origin(islands, centroid)]
    corners, island = np.concatenate(cut), np.repeat(np.arange(len(cut)), [len(own) for own in cut])
    for _ in range(HALVED):
        corners, island = _halved(corners), np.repeat(island, 2)
    edge = np.diff(corners, axis=1)
    area = 0.5 * np.abs(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0])
    place = corners.mean(axis=1)
    # The mean squared distance from the centroid of a triangle is a twelfth of the sum of those of its corners.
    variance = ((corners - place[:, None]) ** 2).sum(axis=(1, 2)) / 24.0
    return Tiles(
        first=np.concatenate([[0], np.cumsum(np.bincount(island, minlength=len(islands)))]).astype(np.int64),
        place=place + centroid[island],
        share=area / np.bincount(island, area, len(islands))[island],
        variance=variance,
    )


def _at_origin(islands: NDArray[np.object_], centroid: Floats) -> NDArray[np.object_]:
    """Shift islands (I,) to their centroids, their corners rounded unless that makes them invalid.

    The triangles of a regular hexagon are a matter of rounding: seen from its centroid it is the same wherever it lies.
    A hair thinner than :data:`DECIMALS` falls onto itself by that.
    """
    points, owner = shapely.get_coordinates(islands, return_index=True)
    seen = points - centroid[owner]
    rounded = shapely.set_coordinates(islands.copy(), np.round(seen, DECIMALS))
    broken = ~shapely.is_valid(rounded) | (shapely.area(rounded) <= 0.0)
    rounded[broken] = shapely.set_coordinates(islands.copy(), seen)[broken]
    return rounded


def _triangles(polygon: shapely.Polygon) -> Floats:
    """Corners (T, 3, 2) of triangles that cover a polygon; those of its hull where it cannot be cut into its own."""
    try:
        parts = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    except shapely.GEOSException:
        parts = np.zeros(0, object)
    if shapely.area(parts).sum() > 0.0:
        return np.asarray(shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3], np.float64)
    ring = shapely.get_coordinates(shapely.convex_hull(polygon))[:-1]
    return np.stack([np.broadcast_to(ring[0], ring[2:].shape), ring[1:-1], ring[2:]], axis=1)


def _halved(corners: Floats) -> Floats:
    """Both halves (2 T, 3, 2) of triangles (T, 3, 2), side by side."""
    longest = ((np.roll(corners, -1, axis=1) - corners) ** 2).sum(axis=2).argmax(axis=1)
    turned = np.take_along_axis(corners, (longest[:, None] + np.arange(3))[:, :, None] % 3, axis=1)
    a, b, c = turned[:, 0], turned[:, 1], turned[:, 2]
    middle = 0.5 * (a + b)
    return np.stack([a, middle, c, middle, b, c], axis=1).reshape(-1, 3, 2)
