"""Solids with flat faces: unions of convex pieces, whose sections are known in every direction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck_models.model import SECTION_TOLERANCE_MM, Floats, Solid, checked_tolerance, rotation, single

Ints = NDArray[np.int64]

JOIN_GRID_MM = 1e-9
"""Grid on which sections of neighbouring pieces are joined: above rounding, far below any feature."""

HEXAHEDRON_FACETS = np.array(
    [
        *([0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]),
        *([0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5]),
        *([2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]),
    ]
)
"""Facets of a block with corners 0 .. 3 counter-clockwise below and 4 .. 7 above them."""


@dataclass(frozen=True, eq=False)
class Polyhedron(Solid):
    """A union of convex pieces that share faces but no volume; see :class:`ebamcheck_models.TurnableModel`."""

    name: str
    summary: str
    corners: Floats  # (V, 3) vertices of the surface and of the pieces, mm
    facets: Ints  # (F, 3) rows of `corners`: the surface, counter-clockwise seen from outside
    pieces: Ints  # (P, K) rows of `corners`, of which each piece is the convex hull
    euler_number: int
    shells: int = 1
    two_manifold: bool = True

    @cached_property
    def bounds(self) -> Floats:
        """Least and greatest corner, (2, 3) mm."""
        used = self.corners[np.unique(self.facets)]
        return np.stack([used.min(axis=0), used.max(axis=0)])

    def section(self, z: float, tolerance_mm: float = SECTION_TOLERANCE_MM) -> list[shapely.Polygon]:
        """Solid regions at height `z` (that of z + 0 at a face); exact at any tolerance."""
        joined = shapely.union_all(self._cuts(z), grid_size=JOIN_GRID_MM)
        return [p for p in shapely.get_parts(joined).tolist() if isinstance(p, shapely.Polygon) and p.area > 0]

    def area(self, z: float) -> float:
        """Exact area of the section at height `z`, mm2: the sum over the pieces."""
        return float(shapely.area(self._cuts(z)).sum())

    @cached_property
    def volume(self) -> float:
        """Exact volume, mm3: tetrahedra from the origin to every facet."""
        a, b, c = np.moveaxis(self.corners[self.facets], 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)

    def turned(self, direction: ArrayLike) -> Polyhedron:
        """Return the solid turned so that `direction` points up."""
        return replace(self, corners=self.corners @ rotation(direction).T)

    def tessellate(self, tolerance_mm: float) -> Part:
        """Return the surface itself: flat faces need no more facets at a finer tolerance."""
        checked_tolerance(tolerance_mm)
        used, facets = np.unique(self.facets, return_inverse=True)
        return from_arrays(single(self.corners[used]), facets.reshape(-1, 3), self.name)

    def _cuts(self, z: float) -> NDArray[np.object_]:
        """Convex section of every piece that the plane just above `z` meets.

        A convex set is met where segments between its corners below and above the plane meet it, so
        the section is the hull of those points; no edges need be known.
        """
        heights = self._heights
        met = (heights.min(axis=1) <= z) & (z < heights.max(axis=1))
        piece = self.corners[self.pieces[met]]
        first, second = np.triu_indices(self.pieces.shape[1], 1)
        one, other = piece[:, first], piece[:, second]
        crosses = (one[..., 2] <= z) != (other[..., 2] <= z)
        rise = np.where(crosses, other[..., 2] - one[..., 2], 1.0)
        part = (z - one[..., 2]) / rise
        points = one[..., :2] + part[..., None] * (other[..., :2] - one[..., :2])
        owner = np.broadcast_to(np.arange(len(piece))[:, None], crosses.shape)[crosses]
        clouds = shapely.multipoints(shapely.points(points[crosses]), indices=owner)
        hulls: NDArray[np.object_] = shapely.convex_hull(clouds)
        flat: NDArray[np.object_] = hulls[shapely.get_type_id(hulls) == shapely.GeometryType.POLYGON]
        return flat

    @cached_property
    def _heights(self) -> Floats:
        """z of the corners of every piece, (P, K)."""
        result: Floats = self.corners[self.pieces, 2]
        return result


def block(name: str, summary: str, corners: Floats) -> Polyhedron:
    """Convex block with eight corners, 0 .. 3 counter-clockwise below and 4 .. 7 above them."""
    return Polyhedron(name, summary, single(corners), HEXAHEDRON_FACETS, np.arange(8)[None, :], 2)


def box_corners(low: ArrayLike, high: ArrayLike) -> Floats:
    """Corners (8, 3) of a box between two opposite ones."""
    (x0, y0, z0), (x1, y1, z1) = np.asarray(low, float).tolist(), np.asarray(high, float).tolist()
    return np.array([(x, y, z) for z in (z0, z1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))])


def cells(
    name: str,
    summary: str,
    edges: tuple[ArrayLike, ArrayLike, ArrayLike],
    filled: NDArray[np.bool_],
    euler_number: int,
    shells: int = 1,
    two_manifold: bool = True,
) -> Polyhedron:
    """Union of the filled cells of a grid between planes along x, y, z, mm; 32-bit floats, so that meshes are exact."""
    planes = [single(np.asarray(e, dtype=np.float64)) for e in edges]
    shape = tuple(len(p) for p in planes)
    corners = np.stack(np.meshgrid(*planes, indexing="ij"), axis=-1).reshape(-1, 3)
    numbers = np.arange(len(corners)).reshape(shape)
    i, j, k = np.nonzero(filled)
    pieces = np.stack(
        [numbers[i + a, j + b, k + c] for c in (0, 1) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))], axis=1
    )
    padded = np.pad(filled, 1)
    quads = []
    for axis in range(3):
        for side in (0, 1):
            step = np.zeros(3, dtype=np.int64)
            step[axis] = 2 * side - 1
            bare = ~padded[i + 1 + step[0], j + 1 + step[1], k + 1 + step[2]]
            quads.append(pieces[bare][:, _SIDES[axis][side]])
    around = np.concatenate(quads)
    facets = np.concatenate([around[:, [0, 1, 2]], around[:, [0, 2, 3]]])
    return Polyhedron(name, summary, corners, facets, pieces, euler_number, shells, two_manifold)


_SIDES = (([3, 0, 4, 7], [1, 2, 6, 5]), ([0, 1, 5, 4], [2, 3, 7, 6]), ([0, 3, 2, 1], [4, 5, 6, 7]))
"""Corners of a cell's side at its lower and upper end along x, y, z, counter-clockwise from outside."""

PYRAMID = Polyhedron(
    "pyramid",
    "square pyramid, base 40 mm, height 50 mm, its apex over the middle",
    np.array([[-20.0, -20.0, 0.0], [20.0, -20.0, 0.0], [20.0, 20.0, 0.0], [-20.0, 20.0, 0.0], [0.0, 0.0, 50.0]]),
    np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]),
    np.arange(5)[None, :],
    2,
)

_PLATE = block(
    "tilted-plate",
    "plane-parallel plate of 60 x 40 x 1 mm, turned so that (0.35, -0.2, 0.5) points up",
    box_corners((-30.0, -20.0, -0.5), (30.0, 20.0, 0.5)),
)
# Turned after its corners were rounded: the solid keeps plane faces, only its meshes are rounded.
TILTED_PLATE = _PLATE.turned((0.35, -0.2, 0.5))


SIDE_MM = 27.0

EULER_NUMBERS = (-8, -160, -2816)
"""2 - 2 g with g = 5, 81, 1409 for levels 1, 2, 3."""


def menger(level: int) -> Polyhedron:
    """Sponge of a level: a cell is solid if, in no place of their base-3 digits, two coordinates have a 1."""
    side = 3**level
    digits = np.arange(side)[:, None] // 3 ** np.arange(level) % 3 == 1
    ones = digits[:, None, None].astype(np.int64) + digits[None, :, None] + digits[None, None, :]
    planes = np.arange(side + 1) * (SIDE_MM / side)
    return cells(
        f"menger-{level}",
        f"Menger sponge of level {level}, side 27 mm: {20**level} cubes of {27 // side} mm",
        (planes, planes, planes),
        (ones < 2).all(axis=-1),
        EULER_NUMBERS[level - 1],
    )


MENGER_1, MENGER_2, MENGER_3 = (menger(level) for level in (1, 2, 3))


WIDTHS_MM = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Widths of the comb's gaps and of the thin walls, from left to right."""

PITCH_MM = 5.0
"""Width of a tooth of the comb, and of the free space between two thin walls."""


def _planes() -> list[float]:
    """Alternating wide and narrow intervals, beginning and ending with a wide one."""
    steps = [width for narrow in WIDTHS_MM for width in (PITCH_MM, narrow)]
    return list(accumulate([*steps, PITCH_MM], initial=0.0))


def _comb() -> Polyhedron:
    planes = _planes()
    filled = np.ones((len(planes) - 1, 2, 2), dtype=bool)
    filled[1::2, 1, 1] = False
    return cells(
        "comb",
        "block with gaps of 0.01, 0.02, 0.05, 0.1, 0.2, 0.5 and 1 mm: below a plate, above a comb",
        (planes, (0.0, 6.0, 30.0), (0.0, 4.0, 20.0)),
        filled,
        2,
    )


def _thin_walls() -> Polyhedron:
    planes = _planes()
    filled = np.zeros((len(planes) - 1, 3, 1), dtype=bool)
    filled[1::2] = True
    filled[:, [0, 2]] = True
    return cells(
        "thin-walls",
        "ladder of two rails whose rungs are walls of 0.01, 0.02, 0.05, 0.1, 0.2, 0.5 and 1 mm",
        (planes, (0.0, 5.0, 25.0, 30.0), (0.0, 20.0)),
        filled,
        2 - 2 * (len(WIDTHS_MM) - 1),
    )


COMB, THIN_WALLS = _comb(), _thin_walls()
