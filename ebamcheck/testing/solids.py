"""Small closed solids on which slicers are tested, and their exact sections by plain means: segments, polygons between them,
winding numbers.

Solids of :data:`SIMPLE` have one winding number, so any slicer should take them. Sections share no code with a slicer; their time
grows with the square of the number of segments."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.mesh.part import Part, from_arrays

FRAME_MM = (
    40.0  # side of the box around every attacking solid: a slicer's bound, which may depend on it, is the same for all
)
Matrix = NDArray[np.float64]
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


# -- maps ----------------------------------------------------------------------------------------------


def mapped(part: Part, matrix: ArrayLike = IDENTITY, shift: ArrayLike = (0.0, 0.0, 0.0)) -> Part:
    """Apply a linear map and a shift to a part; a map that mirrors turns the facets over, so the solid stays solid."""
    linear = np.asarray(matrix, dtype=np.float64)
    faces = part.faces if np.linalg.det(linear) > 0.0 else part.faces[:, ::-1]
    return from_arrays(part.vertices @ linear.T + np.asarray(shift, dtype=np.float64), faces, part.name)


def turn(degrees: float, axis: str = "z") -> Matrix:
    """Rotation about an axis of coordinates, (3, 3)."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    matrix = np.eye(3)
    matrix[j, j] = matrix[k, k] = c
    matrix[j, k], matrix[k, j] = -s, s
    return matrix


def joined(*parts: Part) -> Part:
    """Put bodies into one mesh; they share no vertex."""
    bases = np.cumsum([0, *(len(p.vertices) for p in parts)])
    vertices = np.concatenate([p.vertices for p in parts])
    faces = np.concatenate([p.faces + base for p, base in zip(parts, bases[:-1], strict=True)])
    return from_arrays(vertices, faces, " + ".join(p.name for p in parts))


# -- bodies --------------------------------------------------------------------------------------------


def prism(outline: BaseGeometry, low_mm: float, high_mm: float) -> Part:
    """Draw a polygon with holes, or several of them apart, out along z."""
    return joined(*(_prism(p, low_mm, high_mm) for p in shapely.get_parts(outline)))


def _prism(outline: shapely.Polygon, low_mm: float, high_mm: float) -> Part:
    outline = shapely.orient_polygons(outline)
    rings = [shapely.get_coordinates(r)[:-1] for r in (outline.exterior, *outline.interiors)]
    flat = np.concatenate(rings)
    count = len(flat)
    index = {point: k for k, point in enumerate(map(tuple, flat.tolist()))}
    triangles = shapely.orient_polygons(shapely.get_parts(shapely.constrained_delaunay_triangles(outline)))
    corners = [shapely.get_coordinates(t)[:3].tolist() for t in triangles]
    lid = np.array([[index[tuple(corner)] for corner in corners_of] for corners_of in corners])
    faces = [lid[:, ::-1], lid + count]
    base = 0
    for ring in rings:
        i = base + np.arange(len(ring))
        j = base + (np.arange(len(ring)) + 1) % len(ring)
        faces += [np.stack([i, j, j + count], axis=1), np.stack([i, j + count, i + count], axis=1)]
        base += len(ring)
    vertices = np.concatenate([np.column_stack([flat, np.full(count, z)]) for z in (low_mm, high_mm)])
    return from_arrays(vertices, np.concatenate(faces), "prism")


def box(low: ArrayLike, high: ArrayLike) -> Part:
    """Box with sides along the axes."""
    (x0, y0, z0), (x1, y1, z1) = np.asarray(low, float).tolist(), np.asarray(high, float).tolist()
    return prism(shapely.box(x0, y0, x1, y1), z0, z1)


def regular(sides: int, radius_mm: float, x_mm: float = 0.0, y_mm: float = 0.0) -> shapely.Polygon:
    """Regular polygon; its first corner lies off the axes."""
    angle = 0.1 + 2.0 * math.pi * np.arange(sides) / sides
    x, y = x_mm + radius_mm * np.cos(angle), y_mm + radius_mm * np.sin(angle)
    return shapely.Polygon(np.column_stack([x, y]))


def revolved(profile: Sequence[tuple[float, float]], around: int, closed: bool) -> Part:
    """Turn a profile (radius, z) around z; its ends lie on the axis, or it closes on itself (a ring's)."""
    angle = 2.0 * math.pi * np.arange(around) / around
    rows = np.asarray(profile if closed else profile[1:-1], dtype=np.float64)
    r, z = rows.T
    x, y = np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))
    vertices = np.stack([x, y, np.repeat(z[:, None], around, 1)], -1).reshape(-1, 3)
    last = len(rows) if closed else len(rows) - 1
    i, j = np.meshgrid(np.arange(last), np.arange(around), indexing="ij")
    a, b = i * around + j, i * around + (j + 1) % around
    c, d = (a + around) % len(vertices), (b + around) % len(vertices)
    faces = [np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)]
    if not closed:
        south, north = len(vertices), len(vertices) + 1
        vertices = np.vstack([vertices, [(0.0, 0.0, profile[0][1]), (0.0, 0.0, profile[-1][1])]])
        k = np.arange(around)
        after = (k + 1) % around
        top = (len(rows) - 1) * around
        faces.append(np.column_stack([np.full(around, south), after, k]))
        faces.append(np.column_stack([np.full(around, north), top + k, top + after]))
    return from_arrays(vertices, np.concatenate(faces), "revolved")


def sphere(radius_mm: float = 10.0, rows: int = 12, around: int = 24) -> Part:
    """Sphere of latitude and longitude, its poles single vertices."""
    latitude = np.linspace(-0.5 * math.pi, 0.5 * math.pi, rows + 1)
    profile = [(radius_mm * math.cos(a), radius_mm * math.sin(a)) for a in latitude]
    return revolved(profile, around, closed=False)


def torus(major_mm: float = 12.0, minor_mm: float = 4.0, around: int = 30, across: int = 14) -> Part:
    """Torus about z; planes meet vertices only at the heights of its rows."""
    angle = 0.05 + 2.0 * math.pi * np.arange(across) / across
    profile = [(major_mm + minor_mm * math.cos(a), minor_mm * math.sin(a)) for a in angle]
    return revolved(profile, around, closed=True)


def steps() -> Part:
    """A block, a tower on it and a box apart: level faces that look up at 3, 5 and 8 mm, and down at 0, 2 and 5 mm."""
    block = box((0, 0, 0), (20, 14, 5))
    tower = box((4, 3, 5), (11, 9, 8))
    return joined(block, tower, box((25, 0, 2), (31, 6, 3)))


def named(name: str, part: Part) -> Part:
    """The same mesh under another name."""
    return from_arrays(part.vertices, part.faces, name)


def _plate() -> BaseGeometry:
    return (
        shapely.box(0, 0, 26, 17).difference(regular(16, 4.0, 8.0, 9.0)).difference(shapely.box(15.3, 4.1, 21.7, 7.9))
    )


def _comb() -> BaseGeometry:
    """A back with teeth 0.02 .. 2 mm wide, and as wide gaps between them."""
    widths = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.4, 2.0)
    x, teeth = 1.0, [shapely.box(0, 0, 1.0, 9.0)]
    for width in widths:
        x += width
        teeth.append(shapely.box(x, 1.0, x + width, 9.0))
        x += width
    return shapely.union_all([*teeth, shapely.box(0.0, 0.0, x + 1.0, 2.0)])


# Posts from 0.01 to 3 mm across, each far from the next
_ACROSS_MM = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
_PILLARS = [regular(7, 0.5 * mm, 4.3 * k, 2.1 * (k % 3)) for k, mm in enumerate(_ACROSS_MM)]

# Closed meshes of one winding number
SIMPLE: dict[str, Callable[[], Part]] = {
    "box": lambda: box((0, 0, 0), (20, 14, 6)),
    "plate with holes": lambda: prism(_plate(), 0.0, 4.0),
    "tilted plate": lambda: mapped(prism(_plate(), 0.0, 9.0), turn(33.0, "x") @ turn(21.0, "y")),
    "sphere": lambda: mapped(sphere(), shift=(3.0, -2.0, 1.0)),
    "torus": torus,
    "upright torus": lambda: mapped(torus(), turn(90.0, "x") @ turn(7.0, "z")),
    "pyramid": lambda: revolved([(0.0, 0.0), (9.0, 0.0), (0.0, 11.0)], 5, closed=False),
    "two bodies": lambda: joined(box((0, 0, 0), (6, 5, 4)), mapped(sphere(4.0, 8, 12), shift=(14.0, 6.0, 3.0))),
    "cavity": lambda: joined(box((0, 0, 0), (16, 13, 10)), mapped(sphere(4.0, 8, 12), shift=(9, 6, 5)).reversed()),
    "comb": lambda: prism(_comb(), 0.0, 3.0),
    "turned comb": lambda: mapped(prism(_comb(), 0.0, 3.0), turn(31.0)),
    "pillars": lambda: prism(shapely.union_all(_PILLARS), 0.0, 3.0),
    "wedge": lambda: mapped(prism(shapely.Polygon([(0, 0), (20, 0.6), (0, 1.2)]), 0.0, 3.0), turn(44.9)),
}


def simple(name: str) -> Part:
    """Solid of that name, of :data:`SIMPLE`."""
    return named(name, SIMPLE[name]())


# -- solids made to break a bound ----------------------------------------------------------------------

WIDTHS = (0.35, 0.7, 0.95, 1.2, 1.5, 1.8, 1.95, 2.05, 2.2, 2.6, 3.2)  # over the bound; those over 2 are kept
REPEATS = 9  # times that each width occurs, at another place between the samples of a slicer
GOLDEN = 0.6180339887498949  # steps by this share of a sample visit all places between samples evenly


def _framed(pieces: Iterable[BaseGeometry]) -> BaseGeometry:
    """Pieces within the frame, and posts in two of its corners that hold its size."""
    side = FRAME_MM
    posts = [shapely.box(0, 0, 0.8, 0.8), shapely.box(side - 0.8, side - 0.8, side, side)]
    return shapely.union_all([*pieces, *posts])


def _strips(bound_mm: float) -> list[BaseGeometry]:
    """Strips of all widths that lie at places that never repeat modulo a sample."""
    k = np.arange(len(WIDTHS) * REPEATS)
    pitch = (FRAME_MM - 6.0) / k.size
    x = 2.0 + k * pitch + (k * GOLDEN % 1.0) * min(2.0 * bound_mm, 0.2 * pitch)
    y = 10.0 + (k * GOLDEN * GOLDEN % 1.0) * 2.0 * bound_mm
    width = np.minimum(np.resize(WIDTHS, k.size) * bound_mm, 0.7 * pitch)
    return list(shapely.box(x, y, x + width, y + 2.0))


def _turned(pieces: Sequence[BaseGeometry], degrees: float) -> list[BaseGeometry]:
    """Turn pieces about the middle of the frame, and shrink them to 0.66 so that they stay inside it."""
    middle = 0.5 * FRAME_MM
    c, s = 0.66 * math.cos(math.radians(degrees)), 0.66 * math.sin(math.radians(degrees))
    matrix = np.array([[c, -s], [s, c]])
    return [shapely.transform(p, lambda xy: (xy - middle) @ matrix.T + middle) for p in pieces]


def _posts(bound_mm: float) -> list[BaseGeometry]:
    """Small posts, three- to eight-sided, of all widths and at all places."""
    k = np.arange(len(WIDTHS) * REPEATS)
    x = 3.0 + 3.2 * (k % 11) + (k * GOLDEN % 1.0) * 2.0 * bound_mm
    y = 3.0 + 3.2 * (k // 11) + (k * GOLDEN * GOLDEN % 1.0) * 2.0 * bound_mm
    radius = np.minimum(0.6 * np.resize(WIDTHS, k.size) * bound_mm, 1.2)
    return [regular(3 + n % 6, *place) for n, place in enumerate(np.stack([radius, x, y], 1).tolist())]


def _wedges() -> list[BaseGeometry]:
    wedges: list[BaseGeometry] = []
    for k, angle in enumerate((1.0, 2.0, 4.0, 8.0, 15.0, 30.0, 60.0, 80.0)):
        row, column = divmod(k, 4)
        x, y, direction = 7.0 + 8.7 * column, 12.0 + 15.0 * row, math.radians(23.7 + 47.0 * k)
        sides = (direction - math.radians(0.5 * angle), direction + math.radians(0.5 * angle))
        corners = [(x + 3.7 * math.cos(side), y + 3.7 * math.sin(side)) for side in sides]
        wedges.append(shapely.Polygon([(x, y), *corners]))
    return wedges


def attackers(bound_mm: float) -> dict[str, Part]:
    """Prisms with features about as thin as a bound: thin walls, slits, posts and pores, wedges; all in the box of :func:`frame`,
    and so of one bound."""
    plate = shapely.box(0.0, 0.0, FRAME_MM, FRAME_MM)
    across = shapely.box(1.0, 8.0, FRAME_MM - 1.0, 14.0)
    strips, posts = _strips(bound_mm), _posts(bound_mm)
    turned_45 = _turned(strips, 45.0)
    outlines = {
        "thin walls": _framed(strips),
        "thin walls at 45 degrees": _framed(turned_45),
        "thin walls at 17 degrees": _framed(_turned(strips, 17.0)),
        "slits": _framed([across.difference(shapely.union_all(strips))]),
        "slits at 45 degrees": plate.difference(shapely.union_all(turned_45)),
        "posts": _framed(posts),
        "pores": plate.difference(shapely.union_all(posts)),
        "wedges": _framed(_wedges()),
    }
    return {name: named(name, prism(outline, 0.0, 4.0)) for name, outline in outlines.items()}


def frame() -> Part:
    """The box of all attacking solids."""
    return named("frame", box((0, 0, 0), (FRAME_MM, FRAME_MM, 4.0)))


# -- sections by plain means -----------------------------------------------------------------------

WindingRule = Callable[[int], bool]  # whether a winding number is solid
HOUSE_RULE = "winding > 0"


def winding_rule(text: str) -> WindingRule | None:
    """Read an inside rule: ``winding > 0``, ``winding != 0``, ``odd`` or a range ``1..2``; None for any other.

    >>> [w for w in range(-1, 4) if winding_rule("1..2")(w)]
    [1, 2]
    """
    if text in RULES or not (span := re.fullmatch(r"(-?\d+)\.\.(-?\d+)", text)):
        return RULES.get(text)
    low, high = int(span[1]), int(span[2])
    return lambda count: low <= count <= high


def house_rule(winding: int) -> bool:
    """Overlapping shells unite; what is inside out is empty."""
    return winding > 0


RULES: dict[str, WindingRule] = {
    HOUSE_RULE: house_rule,
    "winding != 0": lambda count: count != 0,
    "odd": lambda count: count % 2 == 1,
}


def segments(part: Part, height: float) -> NDArray[np.float64]:
    """Directed segments of the plane z = height + 0, (S, 2, 2) mm, material on the left; an edge is cut where ``min <= height <
    max``.

    The crossing is computed from its lower vertex, so that both facets of an edge give the same point.
    """
    corners = part.triangles
    above = corners[:, :, 2] > height
    crossing = above.any(axis=1) & ~above.all(axis=1)
    corners, above = corners[crossing], above[crossing]
    found = np.empty((len(corners), 2, 2))
    for tail, head in ((0, 1), (1, 2), (2, 0)):
        for end, rising in enumerate((False, True)):
            rows = np.flatnonzero((above[:, tail] != above[:, head]) & (above[:, head] == rising))
            lower = corners[rows, tail if rising else head]
            upper = corners[rows, head if rising else tail]
            t = (height - lower[:, 2]) / (upper[:, 2] - lower[:, 2])
            found[rows, end] = lower[:, :2] + t[:, None] * (upper - lower)[:, :2]
    return found


def winding_number(cut: NDArray[np.float64], x: float, y: float) -> int:
    """Winding number of closed directed segments about a point."""
    (x0, y0), (x1, y1) = cut[:, 0].T, cut[:, 1].T
    side = (x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)
    upward = (y0 <= y) & (y < y1) & (side > 0)
    downward = (y1 <= y) & (y < y0) & (side < 0)
    return int(np.count_nonzero(upward) - np.count_nonzero(downward))


def section(part: Part, height: float, rule: WindingRule) -> list[shapely.Polygon]:
    """Solid regions of a closed part in the plane z = height + 0."""
    cut = segments(part, height)
    cut = cut[(cut[:, 0] != cut[:, 1]).any(axis=1)]
    if not len(cut):
        return []
    lines = shapely.node(shapely.multilinestrings(shapely.linestrings(cut)))
    cells = shapely.get_parts(shapely.polygonize([lines]))
    middles = shapely.get_coordinates(shapely.point_on_surface(cells))
    solid = [cell for cell, (x, y) in zip(cells, middles, strict=True) if rule(winding_number(cut, x, y))]
    parts = shapely.get_parts(shapely.union_all(solid))
    return [part for part in parts if part.geom_type == "Polygon" and part.area > 0.0]


def sections(part: Part, heights: ArrayLike, rule: WindingRule) -> Layers:
    """Sections of a closed part as layers, one a height."""
    planes = np.asarray(heights, dtype=np.float64).reshape(-1)
    return from_polygons(planes, [section(part, h, rule) for h in planes.tolist()], part=part.sha256)


def region(layers: Layers, layer: int) -> BaseGeometry:
    """Union of the solid regions of a layer."""
    return shapely.union_all(layers.polygons(layer))
