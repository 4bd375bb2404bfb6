"""The cells laid over a layer: hexagons by the paper's odd/even rule (section 4.1), squares and stripes as baselines, as wide as
those.

The paper's rule, worked out: along the short side L1 stand ``n = round(L1 / d) + 1`` hexagons, one more where that is even, so that
one centre lies on the midpoint of L1; centres are ``sqrt(3) d`` apart. Rows follow each other along L2 at ``1.5 d``, every other
one shifted by half a step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from ebamcheck.errors import GeometryError, SettingsError
from ebamcheck.kernels import Floats, Ints
from ebamcheck.settings.config import Config

SQRT3 = math.sqrt(3.0)
ZONES = 60  # islands that an ordinary layer is divided into: enough to spread the heat, few enough wire starts
# Fewest and most beads across a hexagon: under 4 the ends of beads rule the island, over 12 its lines grow as long as those to be avoided
BEADS_ACROSS = (4, 12)
ROUNDING = 1e-12  # relative rounding of a length that must not cost a row of hexagons
HEXAGON = "hexagon"  # kind of cells
MOST_CELLS = 1_000_000  # more cells than this on one layer are a mistyped side


@dataclass(frozen=True, eq=False)
class Lattice:
    """Cells of one layer."""

    kind: str  # ``hexagon``, ``square`` or ``stripe``
    side_mm: float  # side d of a hexagon; of the hexagon of the same width, where the cells are others
    centres: Floats  # (H, 2) mm, row by row along the long side of the rectangle
    colour: Ints  # (H,) 0, 1 or 2, such that no two cells with a common side have the same one; the hatch turns by it
    # (H,) polygons; cells with a common side share its two corners to the last bit
    cells: NDArray[np.object_]

    @property
    def width_mm(self) -> float:
        """Distance between two opposite sides of a cell."""
        return SQRT3 * self.side_mm


def hexagons_across(short_mm: float, side_mm: float) -> int:
    """Hexagons along the short side, always odd (paper, section 4.1; halves round up).

    >>> hexagons_across(100.0, 10.0), hexagons_across(110.0, 10.0)
    (11, 13)
    """
    count = math.floor(short_mm / side_mm + 0.5) + 1
    # The rule gives one hexagon where L1 < d/2; a single shifted one would then miss half of the rectangle.
    return max(count + 1 - count % 2, 3)


def rows_along(long_mm: float, side_mm: float) -> int:
    """Rows along the long side, the first one centred on its start: as many as reach its end."""
    return max(0, math.ceil((long_mm - 0.5 * side_mm) / (1.5 * side_mm) - ROUNDING)) + 1


def hexagon_lattice(rectangle: Rectangle, side_mm: float) -> Lattice:
    """Lay hexagons of a given side over all of a rectangle; raises SettingsError for more than :data:`MOST_CELLS`."""
    across = hexagons_across(rectangle.short_mm, side_mm)
    row, column = _numbers(across, rows_along(rectangle.long_mm, side_mm), rectangle, side_mm)
    # Half steps of sqrt(3)/2 d along L1 and of d/2 along L2: corners of neighbours are the same integers.
    half = 2 * column - (across - 1) + row % 2
    third = 3 * row
    corner_half = half[:, None] + np.array([0, 1, 1, 0, -1, -1])
    corner_third = third[:, None] + np.array([-2, -1, 1, 2, 1, -1])
    steps_mm = 0.5 * SQRT3 * side_mm, 0.5 * side_mm
    return Lattice(
        kind=HEXAGON,
        side_mm=side_mm,
        centres=_place(rectangle, steps_mm, half, third),
        # Axial coordinates: a step along the row and a step to either row above change it differently.
        colour=((column - row // 2 - row) % 3).astype(np.int64),
        cells=np.asarray(shapely.polygons(_place(rectangle, steps_mm, corner_half, corner_third)), object),
    )


def square_lattice(rectangle: Rectangle, side_mm: float) -> Lattice:
    """Lay squares as wide as hexagons of a given side over a rectangle, one centre on the midpoint of L1, as with hexagons; errors
    likewise."""
    across = _count_over(rectangle.short_mm, SQRT3 * side_mm)
    return _boxes(rectangle, side_mm, "square", across + 1 - across % 2, SQRT3 * side_mm)


def stripe_lattice(rectangle: Rectangle, side_mm: float) -> Lattice:
    """Lay stripes as wide as hexagons of a given side across a rectangle, from one long side to the other; errors likewise."""
    return _boxes(rectangle, side_mm, "stripe", 1, max(rectangle.short_mm, SQRT3 * side_mm))


def _boxes(rectangle: Rectangle, side_mm: float, kind: str, across: int, length_mm: float) -> Lattice:
    """Rows of boxes, an odd number of them across, each `length_mm` long along L1."""
    row, column = _numbers(across, _count_over(rectangle.long_mm, SQRT3 * side_mm), rectangle, side_mm)
    along, up = 2 * column - (across - 1), 2 * row + 1
    steps_mm = 0.5 * length_mm, 0.5 * SQRT3 * side_mm
    right, above = np.array([-1, 1, 1, -1]), np.array([-1, -1, 1, 1])
    corners = _place(rectangle, steps_mm, along[:, None] + right, up[:, None] + above)
    centres, colour = _place(rectangle, steps_mm, along, up), ((row + column) % 2).astype(np.int64)
    return Lattice(kind, side_mm, centres, colour, np.asarray(shapely.polygons(corners), object))


def _count_over(length_mm: float, cell_mm: float) -> int:
    """Cells side by side that cover a length, at least one."""
    return max(1, math.ceil(length_mm / cell_mm - ROUNDING))


def _numbers(across: int, rows: int, rectangle: Rectangle, side_mm: float) -> tuple[Ints, Ints]:
    """Row and column of each cell, row by row; raises SettingsError for too many cells."""
    if across * rows > MOST_CELLS:
        raise SettingsError(
            f"scan.hexagon_side_mm {side_mm:g} lays {across} x {rows} cells over one layer of "
            f"{rectangle.short_mm:g} x {rectangle.long_mm:g} mm, over the limit of {MOST_CELLS}: give a larger side"
        )
    row, column = np.mgrid[0:rows, 0:across]
    return row.ravel(), column.ravel()


def _place(rectangle: Rectangle, steps_mm: tuple[float, float], along_short: Ints, along_long: Ints) -> Floats:
    """Points at whole steps: along L1 from its midpoint, along L2 from its start."""
    return rectangle.to_world(along_short * steps_mm[0], along_long * steps_mm[1] - 0.5 * rectangle.long_mm)


# Lattices by the name of their partition, see `scan.partition`
LATTICES: dict[str, Callable[[Rectangle, float], Lattice]] = {
    "hexagons": hexagon_lattice,
    "squares": square_lattice,
    "stripes": stripe_lattice,
}


def planned_side_mm(area_mm2: float, perimeter_mm: float, spacing_mm: float) -> float:
    """Side of the hexagons from the area of a layer and its thickness (paper, introduction, point 2).

    The layer is divided into about :data:`ZONES` islands, none wider than the layer is thick on average (2 A / P); then the width
    between two sides is rounded to a whole number m of beads within :data:`BEADS_ACROSS`: ``sqrt(3) d = m spacing``.

    >>> round(planned_side_mm(30_000.0, 800.0, 4.32), 2)  # 300 x 100 mm, six beads across
    14.96
    """
    width = SQRT3 * math.sqrt(2.0 * area_mm2 / (3.0 * SQRT3 * ZONES))
    if perimeter_mm > 0:
        width = min(width, 2.0 * area_mm2 / perimeter_mm)
    fewest, most = BEADS_ACROSS
    return min(max(round(width / spacing_mm), fewest), most) * spacing_mm / SQRT3


# -- Where the lattice lies on each layer: along the smallest rectangle, then shifted and turned from layer to layer. Borders of islands
# that lay over each other would grow into walls of lack of fusion through the part. So each layer turns the lattice on, which leaves
# borders of two layers at most points in common, and shifts it, so that layers whose turns are alike again do not repeat it. The lowest
# layer has the lattice of the paper.


def layer_place(points: ArrayLike, side_mm: float, config: Config, layer: int) -> Rectangle:
    """Rectangle around the points (N, 2), mm, of a section's border over which the cells of a layer are laid, shifted and turned by
    the settings.

    The rule of the lattice counts from the midpoint of L1 and from the start of L2. So a rectangle that is moved, and grown by as
    much as it moves, shifts the lattice and still holds every point."""
    smallest = minimum_rectangle(points, config.scan.rectangle)
    turn = math.radians(layer * config.scan.lattice_angle_deg)
    around = smallest if turn == 0.0 else rectangle_along(points, smallest.angle_rad + turn)
    if not config.scan.lattice_shift or layer == 0:
        return around
    first, second = shift_shares(layer)
    # Rows of hexagons repeat along L2 after three sides d; squares and stripes after less, so that all are shifted over their period.
    return shifted(around, (first - 0.5) * SQRT3 * side_mm, second * 3.0 * side_mm)


def shift_shares(layer: int) -> tuple[float, float]:
    """Shift of a layer's lattice along L1 and L2, as shares of its periods, each in [0, 1)."""
    # Real root of x^3 = x + 1, whose inverse and its square spread pairs of fractions evenly (M. Roberts, 2018: the sequence R2).
    plastic = 1.324717957244746
    return layer / plastic % 1.0, layer / plastic**2 % 1.0


def shifted(rectangle: Rectangle, along_short_mm: float, along_long_mm: float) -> Rectangle:
    """Move the midpoint of L1 along it, and the start of L2 against it by at least 0; the rectangle grows so that it holds what it
    held."""
    x, y = rectangle.to_world(along_short_mm, -0.5 * along_long_mm).tolist()
    short_mm, long_mm = rectangle.short_mm + 2.0 * abs(along_short_mm), rectangle.long_mm + along_long_mm
    return Rectangle(x, y, rectangle.angle_rad, short_mm, long_mm)


@dataclass(frozen=True)
class Rectangle:
    """A rectangle that may be turned; of a smallest one L1 <= L2, and the direction lies in [0, pi)."""

    x_mm: float  # centre
    y_mm: float
    angle_rad: float  # direction of the side L1, counter-clockwise from +X
    short_mm: float  # length L1
    long_mm: float  # length L2

    @property
    def area_mm2(self) -> float:
        """Area L1 L2."""
        return self.short_mm * self.long_mm

    def to_world(self, along_short: ArrayLike, along_long: ArrayLike) -> Floats:
        """Points (..., 2), mm, from coordinates along the short and the long side about the centre."""
        a, b = np.asarray(along_short, np.float64), np.asarray(along_long, np.float64)
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        return np.stack([self.x_mm + c * a - s * b, self.y_mm + s * a + c * b], axis=-1)

    def polygon(self) -> shapely.Polygon:
        """The rectangle as a polygon."""
        a, b = 0.5 * self.short_mm, 0.5 * self.long_mm
        return shapely.Polygon(self.to_world([-a, a, a, -a], [-b, -b, b, b]))


def minimum_rectangle(points: ArrayLike, method: Literal["paper", "exact"] = "exact") -> Rectangle:
    """Find the rectangle of least area around points (N, 2), mm; raises GeometryError for no point, or one that is not finite.

    ``paper`` tries the rotations 0, pi/10, 2 pi/10, ... (equation 11); ``exact`` every direction of an edge of the hull, where the
    minimum lies."""
    column = np.asarray(points, np.float64).reshape(-1, 2)
    if not len(column) or not np.isfinite(column).all():
        raise GeometryError(f"minimum rectangle of {len(column)} points: give at least one point, all of them finite")
    hull = _convex_hull(column)
    if method == "paper":
        angles = np.arange(10) * (math.pi / 10)
        boxes = _envelopes(hull, np.stack([np.cos(angles), np.sin(angles)], axis=-1))
    else:
        edges = np.roll(hull, -1, axis=0) - hull
        lengths = np.hypot(edges[:, 0], edges[:, 1])
        directions = edges[lengths > 0] / lengths[lengths > 0, None]
        # About a million corners times directions are worked out together.
        parts = np.array_split(directions, max(1, len(hull) * len(directions) // 1_000_000))
        any_way = np.array([[1.0, 0.0]])
        boxes = np.concatenate([_envelopes(hull, part if len(part) else any_way) for part in parts])
    return _smallest(boxes)


@lru_cache(maxsize=256)
def long_direction_rad(island: shapely.Polygon) -> float:
    """Direction of the long side of the smallest rectangle around an island, which is asked for twice where it is narrow."""
    return minimum_rectangle(shapely.get_coordinates(shapely.convex_hull(island))).angle_rad + 0.5 * math.pi


def rectangle_along(points: ArrayLike, angle_rad: float) -> Rectangle:
    """Rectangle around points (N, 2), mm, at least one, all finite, whose side L1 has a given direction, also where it is the
    longer one."""
    direction = np.array([[math.cos(angle_rad), math.sin(angle_rad)]])
    ux, uy, amin, amax, bmin, bmax = _envelopes(np.asarray(points, np.float64).reshape(-1, 2), direction)[0]
    a, b = 0.5 * (amin + amax), 0.5 * (bmin + bmax)
    return Rectangle(ux * a - uy * b, uy * a + ux * b, angle_rad, amax - amin, bmax - bmin)


def _convex_hull(points: Floats) -> Floats:
    """Corners of the convex hull, counter-clockwise, (H, 2); fewer than three where it has no area."""
    hull = shapely.convex_hull(shapely.LineString(points) if len(points) > 1 else shapely.Point(points[0]))
    if hull.geom_type == "Polygon":
        return shapely.get_coordinates(shapely.orient_polygons(hull))[:-1]
    return shapely.get_coordinates(hull)


def _envelopes(hull: Floats, directions: Floats) -> Floats:
    """Extent of the hull along and across each direction, (K, 6): ux, uy, amin, amax, bmin, bmax."""
    along = directions @ hull.T
    across = np.stack([-directions[:, 1], directions[:, 0]], axis=-1) @ hull.T
    extents = [along.min(axis=1), along.max(axis=1), across.min(axis=1), across.max(axis=1)]
    return np.column_stack([directions, *extents])


def _smallest(boxes: Floats) -> Rectangle:
    """The box of least area, among equal ones the first, its sides named by their length and its direction in [0, pi)."""
    areas = (boxes[:, 3] - boxes[:, 2]) * (boxes[:, 5] - boxes[:, 4])
    k = int(np.flatnonzero(areas <= areas.min() * (1.0 + 1e-12))[0])
    ux, uy, amin, amax, bmin, bmax = boxes[k].tolist()
    a, b = 0.5 * (amin + amax), 0.5 * (bmin + bmax)
    x, y = ux * a - uy * b, uy * a + ux * b
    angle = math.atan2(uy, ux)
    first, second = amax - amin, bmax - bmin
    if first > second:
        angle, first, second = angle + 0.5 * math.pi, second, first
    return Rectangle(x, y, angle % math.pi, first, second)
