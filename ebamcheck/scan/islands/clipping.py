"""Islands: cells clipped to the solids of a layer, small ones whole, slivers merged into neighbours."""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.regions import equivalent_rectangles_mm, ring_columns, valid_polygons
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.scan.islands.lattice import SQRT3, Lattice, long_direction_rad

# Kinds of islands beside those of cells: a solid not divided, a thin wall, a spot left by all of these
WHOLE, THIN_WALL, GAP = "whole", "thin wall", "gap"
SLIVER_AREA = 1.0  # islands under this times the squared bead width are slivers: a bead hardly starts before it stops
SLIVER_WIDTH = 0.5  # islands narrower than this times the bead spacing are slivers: a line there lies on its neighbours
# No island is a sliver with more than this share of a hexagon's area, or of its width: hexagons set small against the bead are wanted
SLIVER_SHARE = 0.2
ON_BORDER_MM = (
    1e-9  # faces of no area, which rounding leaves along a border, count as inside a solid up to so far from it
)
DEPTH_SHARE = 0.01  # depth of a point in a face, over the root of its area, that is enough, and the precision of that of the deepest one


@dataclass(frozen=True, eq=False)
class Cells:
    """Islands of one layer before they are filled."""

    polygons: NDArray[np.object_]  # (I,)
    kind: NDArray[np.str_]  # (I,)
    colour: Ints  # (I,)


def hexagon_area_mm2(side_mm: float) -> float:
    """Area of a hexagon, 3 sqrt(3) / 2 d^2."""
    return 1.5 * SQRT3 * side_mm**2


def partition(solids: Sequence[shapely.Polygon], lattice: Lattice, bead_width_mm: float, spacing_mm: float) -> Cells:
    """Divide solids into islands by a lattice; together they are the solids, and no two overlap.

    A solid smaller than one hexagon stays whole. No other island is under the least area (the lesser of :data:`SLIVER_AREA` and
    :data:`SLIVER_SHARE`) or the least width (:data:`SLIVER_WIDTH`, likewise), unless its whole solid is."""
    small = hexagon_area_mm2(lattice.side_mm)
    whole = [p for p in solids if p.area <= small]
    large = [p for p in solids if p.area > small]
    pieces, cell = clip_lattice(large, lattice)
    groups = sliver_groups(pieces, *least_island_mm(lattice, bead_width_mm, spacing_mm))
    merged, first = _united(pieces, groups)
    return Cells(
        polygons=column([*merged, *whole]),
        kind=np.array([lattice.kind] * len(merged) + [WHOLE] * len(whole), dtype=np.str_),
        colour=np.concatenate([lattice.colour[cell[first]], np.zeros(len(whole), np.int64)]),
    )


def least_island_mm(lattice: Lattice, bead_width_mm: float, spacing_mm: float) -> tuple[float, float]:
    """Least area (mm2) and least width (mm) of an island."""
    area_mm2 = min(SLIVER_AREA * bead_width_mm**2, SLIVER_SHARE * hexagon_area_mm2(lattice.side_mm))
    return area_mm2, min(SLIVER_WIDTH * spacing_mm, SLIVER_SHARE * lattice.width_mm)


def undivided(solids: Sequence[shapely.Polygon]) -> Cells:
    """Return every solid as one island."""
    return Cells(column(solids), np.full(len(solids), WHOLE), np.zeros(len(solids), np.int64))


def clip_lattice(solids: Sequence[shapely.Polygon], lattice: Lattice) -> tuple[NDArray[np.object_], Ints]:
    """Parts of every cell that lie in a solid, and the cell of each, in order of the cells.

    Cells inside are kept as they are. Those on a border are cut together, so that two parts with a common border share its points
    to the last bit, where a cut of each cell by itself leaves hairs between them."""
    pieces, owners = [np.zeros(0, object)], [np.zeros(0, np.int64)]
    for solid in solids:
        shapely.prepare(solid)
        near = np.flatnonzero(shapely.intersects(solid, lattice.cells))
        full = shapely.contains_properly(solid, lattice.cells[near])
        faces, cell = _faces(solid, lattice.cells[near[~full]])
        pieces += [lattice.cells[near[full]], faces]
        owners += [near[full], near[~full][cell]]
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(pieces)[order], owner[order]


def _faces(solid: shapely.Polygon, cut: NDArray[np.object_]) -> tuple[NDArray[np.object_], Ints]:
    """Faces inside a solid between its border and the edges of cells, and the cell that holds each."""
    edges, _ = polygon_edges(cut)
    once = np.asarray(shapely.linestrings(np.unique(edges, axis=0).reshape(-1, 2, 2)), object)
    crossed = shapely.union_all([*once.tolist(), solid.boundary])
    faces = shapely.get_parts(shapely.polygonize(shapely.get_parts(crossed)))
    point = _inner_points(faces)
    faces, point = (column[shapely.dwithin(solid, point, ON_BORDER_MM)] for column in (faces, point))
    face, cell = shapely.STRtree(cut).query(point, predicate="dwithin", distance=ON_BORDER_MM)
    # What lies in none of these cells is the room of those that are not cut; a hair on an edge lies in two.
    held, first = np.unique(face, return_index=True)
    return faces[held], cell[first]


def _inner_points(faces: NDArray[np.object_]) -> NDArray[np.object_]:
    """Point of each face far from its border: not in a hair that hangs on it. A corner of those that are hairs."""
    points = np.asarray(shapely.get_point(shapely.get_exterior_ring(faces), 0), object)
    area = shapely.area(faces)
    wide = np.flatnonzero(area > ON_BORDER_MM * shapely.length(faces))
    with np.errstate(over="ignore"):  # of faces a rounding wide
        points[wide] = shapely.point_on_surface(faces[wide])
    depth_mm = shapely.distance(points[wide], shapely.boundary(faces[wide]))
    # Where that is no proof, the deepest point of all is looked for, which takes fifty times as long.
    doubtful = wide[~(depth_mm > DEPTH_SHARE * np.sqrt(area[wide]))]
    with np.errstate(over="ignore"):  # slopes of edges whose ends differ by less than any normal number
        circles = shapely.maximum_inscribed_circle(faces[doubtful], DEPTH_SHARE * np.sqrt(area[doubtful]))
    points[doubtful] = shapely.get_point(circles, 0)
    return points


def sliver_groups(pieces: NDArray[np.object_], area_mm2: float, width_mm: float) -> Ints:
    """Group of every piece (I,), named by its largest piece: the smallest sliver joins the neighbour with the longest border, until
    none is left.

    A group is a sliver as long as it is under the least area or width, all of it; one that has no neighbour is a whole solid.
    """
    area, border = shapely.area(pieces), shapely.length(pieces)
    largest = area.copy()
    joined = np.arange(pieces.size)

    def is_sliver(i: int) -> bool:
        return bool(area[i] < area_mm2 or rectangle_width_mm(area[i], border[i]) < width_mm)

    waiting = [(area[i], i) for i in range(pieces.size) if is_sliver(i)]
    if not waiting:
        return joined
    beside: list[dict[int, float]] = [{} for _ in range(pieces.size)]
    for (a, b), length in zip(*(column.tolist() for column in shared_edges(pieces)), strict=True):
        beside[a][b] = beside[b][a] = length
    heapq.heapify(waiting)
    while waiting:
        size, i = heapq.heappop(waiting)
        if joined[i] != i or size != area[i] or not beside[i]:  # part of another, grown since, or alone
            continue
        j = max(beside[i], key=lambda j: (beside[i][j], -j))
        keep, lose = (i, j) if (largest[i], -i) > (largest[j], -j) else (j, i)
        area[keep] += area[lose]
        border[keep] += border[lose] - 2.0 * beside[i][j]
        joined[lose] = keep
        for other, length in beside[lose].items():
            del beside[other][lose]
            if other != keep:
                beside[keep][other] = beside[other][keep] = beside[keep].get(other, 0.0) + length
        if is_sliver(keep):
            heapq.heappush(waiting, (area[keep], keep))
    while (joined != joined[joined]).any():
        joined = joined[joined]
    return joined.astype(np.int64)


def rectangle_width_mm(area_mm2: float, border_mm: float) -> float:
    """Width as of a wall, see :func:`ebamcheck.geometry.regions.equivalent_rectangles_mm`."""
    quarter = 0.25 * border_mm
    return area_mm2 / (quarter + math.sqrt(max(quarter**2 - area_mm2, 0.0)))


def _united(pieces: NDArray[np.object_], groups: Ints) -> tuple[list[shapely.Polygon], Ints]:
    """Islands by group, and the piece that names each: common edges go; a group without area, a hair beside the solid, is no
    island."""
    merged: list[shapely.Polygon] = []
    first: list[int] = []
    by_group = np.argsort(groups, kind="stable")
    names, starts = np.unique(groups[by_group], return_index=True)
    for name, held in zip(names.tolist(), np.split(pieces[by_group], starts[1:]), strict=False):
        if (shapely.area(held) > ON_BORDER_MM * shapely.length(held)).any():
            merged += [held[0]] if held.size == 1 else valid_polygons(shapely.coverage_union_all(held))
            first += [name] * (len(merged) - len(first))
    return merged, np.array(first, np.int64)


def column(polygons: Sequence[BaseGeometry]) -> NDArray[np.object_]:
    """Polygons as an object array (I,), also where there are none or one."""
    found = np.empty(len(polygons), object)
    found[:] = polygons
    return found


# -- Which islands of a layer touch, and along which length ----------------------------------------------------

TOUCH_MM = 1e-6  # borders nearer than this coincide: islands are cut from one region, so only rounding parts them


def shared_borders(islands: NDArray[np.object_]) -> tuple[Ints, Floats]:
    """Pairs (P, 2) of islands, the lesser first, sorted, with a common border, and its length (P,); those that meet in a point only
    are left out."""
    if islands.size < 2:
        return np.zeros((0, 2), np.int64), np.zeros(0)
    boxes = shapely.box(*(shapely.bounds(islands) + np.array([-1, -1, 1, 1]) * TOUCH_MM).T)
    a, b = shapely.STRtree(islands).query(boxes)
    pairs = np.column_stack([a, b])[a < b].astype(np.int64)
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    points, (ring_starts, island_rings) = ring_columns(islands)
    lengths = common_lengths(points, ring_starts, island_rings, pairs, TOUCH_MM)
    touching = lengths > TOUCH_MM
    return pairs[touching], lengths[touching]


def polygon_edges(polygons: NDArray[np.object_]) -> tuple[Floats, Ints]:
    """Edges (E, 4) of polygons, x0, y0, x1, y1 with the lesser end first, and the polygon of each (E,)."""
    rings, owner = shapely.get_rings(polygons, return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    inner = np.flatnonzero(ring[:-1] == ring[1:])
    start, end = points[inner], points[inner + 1]
    turned = (start[:, 0] > end[:, 0]) | ((start[:, 0] == end[:, 0]) & (start[:, 1] > end[:, 1]))
    ends = np.where(turned[:, None], np.hstack([end, start]), np.hstack([start, end]))
    return ends.astype(np.float64), owner[ring[inner]].astype(np.int64)


def shared_edges(polygons: NDArray[np.object_]) -> tuple[Ints, Floats]:
    """Pairs of polygons with common edges, equal to the last bit, and their length; columns as of :func:`shared_borders`."""
    ends, owner = polygon_edges(polygons)
    order = np.lexsort((owner, *ends.T))
    ends, owner = ends[order], owner[order]
    common = np.flatnonzero((ends[:-1] == ends[1:]).all(axis=1) & (owner[:-1] != owner[1:]))
    length = np.hypot(*(ends[common, 2:] - ends[common, :2]).T)
    pairs, place = np.unique(np.column_stack([owner[common], owner[common + 1]]), axis=0, return_inverse=True)
    lengths = np.bincount(place.ravel(), length, len(pairs))
    return pairs.reshape(-1, 2).astype(np.int64), lengths.astype(np.float64)


@kernel
def common_lengths(points: Floats, ring_starts: Ints, island_rings: Ints, pairs: Ints, tolerance: float) -> Floats:
    """Length over which the borders of each pair of polygons coincide within a tolerance, (P,)."""
    result = np.zeros(len(pairs))
    for n in range(len(pairs)):
        for r in range(island_rings[pairs[n, 0]], island_rings[pairs[n, 0] + 1]):
            for i in range(ring_starts[r], ring_starts[r + 1] - 1):
                ax, ay, bx, by = points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1]
                length = np.hypot(bx - ax, by - ay)
                if length == 0.0:
                    continue
                ux, uy = (bx - ax) / length, (by - ay) / length
                left, right = min(ax, bx) - tolerance, max(ax, bx) + tolerance
                low, high = min(ay, by) - tolerance, max(ay, by) + tolerance
                for q in range(island_rings[pairs[n, 1]], island_rings[pairs[n, 1] + 1]):
                    for k in range(ring_starts[q], ring_starts[q + 1] - 1):
                        cx, cy, dx, dy = points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1]
                        if max(cx, dx) < left or min(cx, dx) > right or max(cy, dy) < low or min(cy, dy) > high:
                            continue
                        off = max(abs(ux * (cy - ay) - uy * (cx - ax)), abs(ux * (dy - ay) - uy * (dx - ax)))
                        if off <= tolerance:
                            c, d = ux * (cx - ax) + uy * (cy - ay), ux * (dx - ax) + uy * (dy - ay)
                            result[n] += max(0.0, min(length, max(c, d)) - max(0.0, min(c, d)))
    return result


# Turns that are tried, in this order, in steps of the angle that is set
STEPS = np.concatenate([np.arange(12.0) + part for part in (0.0, 0.5, 0.25, 0.75)])
ROUNDING_DEG = 1e-6


def hatch_directions(found: Cells, spacing_mm: float, turn_deg: float, island_angle_deg: float) -> Floats:
    """Direction of the lines of each island, (I,) rad; islands narrower than `spacing_mm` are filled along their long side.

    `turn_deg` is the direction of the first colour on this layer, `island_angle_deg` the turn from colour to colour; at a multiple
    of 180 there is but one."""
    width, _ = equivalent_rectangles_mm(found.polygons)
    narrow = width < spacing_mm
    angle = turn_deg + island_angle_deg * found.colour.astype(np.float64)
    angle[narrow] = [math.degrees(long_direction_rad(island)) for island in found.polygons[narrow]]
    least = least_turn_deg(island_angle_deg)
    if least > ROUNDING_DEG:
        pairs, _ = shared_borders(found.polygons)
        area = np.asarray(shapely.area(found.polygons), np.float64)
        for i in _clashing(pairs, angle, narrow, area, least):
            beside = np.concatenate([pairs[pairs[:, 0] == i, 1], pairs[pairs[:, 1] == i, 0]])
            tried = np.concatenate([angle[i : i + 1], turn_deg + island_angle_deg * STEPS])
            apart = turn_between_deg(tried[:, None], angle[beside]).min(axis=1)
            wide = np.flatnonzero(apart >= least - ROUNDING_DEG)
            angle[i] = tried[wide[0] if wide.size else np.argmax(apart)]
    return np.radians(angle)


def least_turn_deg(island_angle_deg: float) -> float:
    """Least angle between the hatches of two islands that touch: a quarter of the turn from island to island, so that halves between
    always part, and of the usual turn at most."""
    turn = float(turn_between_deg(np.float64(island_angle_deg), np.float64(0.0)))
    return min(15.0, 0.25 * turn)


def turn_between_deg(first: Floats | np.float64, second: Floats | np.float64) -> Floats:
    """Angle between two directions of lines, 0 to 90."""
    turn = np.abs(first - second) % 180.0
    return np.asarray(np.minimum(turn, 180.0 - turn), np.float64)


def _clashing(pairs: Ints, angle: Floats, narrow: Bools, area: Floats, least_deg: float) -> list[int]:
    """Of each two that touch and share a direction the one that is to turn: not the narrow one, else the smaller."""
    a, b = pairs.T
    same = turn_between_deg(angle[a], angle[b]) < least_deg - ROUNDING_DEG
    a, b = (column[same & ~(narrow[a] & narrow[b])] for column in (a, b))
    first = np.where(narrow[a] | narrow[b], narrow[b], area[a] <= area[b])
    turned = np.unique(np.where(first, a, b))
    by_area: list[int] = turned[np.lexsort((turned, area[turned]))].tolist()
    return by_area
