"""Sections of exact surfaces: the place near a contour point where a layer cuts one surface, or two that meet at an edge."""

from __future__ import annotations

import numpy as np

from ebamcheck.curves.exact.forms import FLAT, KIND, SIDE, Signed, signed_distance
from ebamcheck.curves.sides import Sides
from ebamcheck.curves.surface_edges import SurfaceMesh, Vector
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

MOST_STEPS = 40
"""Most Newton steps; each doubles the digits, so a few are enough unless the surface is nearly level."""

CLOSE_MM = 1e-10
"""A point this near to a surface lies on it."""

LEAST_SLOPE = 0.02
"""Horizontal part of a unit gradient below which a surface is level in the layer: a point does not determine its section."""

LEAST_SINE = np.sin(np.deg2rad(5.0))
"""Least sine of the angle between the sections of two surfaces at which these determine a common point."""

MOST_GROWTH = 3.0
"""Farthest move of a point, over its first-order distance from the surface: a section farther off is another one."""

Place = tuple[bool, float, float]
"""Whether there is such a place, and its x and y, mm."""


@kernel
def slope_of(at: Signed) -> float:
    """Horizontal part of a unit gradient."""
    return float(np.sqrt(at[1] * at[1] + at[2] * at[2]))


@kernel
def on_one(row: Floats, x: float, y: float, z: float) -> Place:
    """The place on a surface's section straight ahead of a point."""
    at = signed_distance(row, x, y, z)
    slope = slope_of(at)
    if slope < LEAST_SLOPE:
        return False, x, y
    allowed = MOST_GROWTH * abs(at[0]) / slope + CLOSE_MM
    u, v = x, y
    for _ in range(MOST_STEPS):
        if abs(at[0]) <= CLOSE_MM:
            break
        square = at[1] * at[1] + at[2] * at[2]
        if square < LEAST_SLOPE * LEAST_SLOPE:
            return False, x, y
        u -= at[0] * at[1] / square
        v -= at[0] * at[2] / square
        at = signed_distance(row, u, v, z)
    if abs(at[0]) > CLOSE_MM or np.hypot(u - x, v - y) > allowed:
        return False, x, y
    return True, u, v


@kernel
def on_both(row: Floats, other: Floats, x: float, y: float, z: float) -> Place:
    """The place where the sections of two surfaces meet beside a point; where they touch, midway between both."""
    at, beside = signed_distance(row, x, y, z), signed_distance(other, x, y, z)
    slope, sloping = slope_of(at), slope_of(beside)
    if slope < LEAST_SLOPE or sloping < LEAST_SLOPE:
        return False, x, y
    sine = abs(at[1] * beside[2] - at[2] * beside[1]) / (slope * sloping)
    if sine < LEAST_SINE:
        return _midway(row, other, x, y, z)
    allowed = MOST_GROWTH * (abs(at[0]) / slope + abs(beside[0]) / sloping) + CLOSE_MM
    u, v = x, y
    for _ in range(MOST_STEPS):
        if abs(at[0]) <= CLOSE_MM and abs(beside[0]) <= CLOSE_MM:
            break
        determinant = at[1] * beside[2] - at[2] * beside[1]
        if abs(determinant) < 1e-9:
            return False, x, y
        u -= (at[0] * beside[2] - beside[0] * at[2]) / determinant
        v -= (at[1] * beside[0] - beside[1] * at[0]) / determinant
        at, beside = signed_distance(row, u, v, z), signed_distance(other, u, v, z)
    if max(abs(at[0]), abs(beside[0])) > CLOSE_MM or np.hypot(u - x, v - y) > allowed:
        return False, x, y
    return True, u, v


@kernel
def _midway(row: Floats, other: Floats, x: float, y: float, z: float) -> Place:
    """Midway between the places on two surfaces that touch; a plane stays one."""
    if int(row[KIND]) == FLAT or int(other[KIND]) == FLAT:
        return on_one(row if int(row[KIND]) == FLAT else other, x, y, z)
    found, u, v = on_one(row, x, y, z)
    too, s, t = on_one(other, x, y, z)
    if not found or not too:
        return False, x, y
    return True, 0.5 * (u + s), 0.5 * (v + t)


@kernel
def set_along(row: Floats, x: float, y: float, z: float, direction: Floats) -> bool:
    """Set the direction of a section with the solid to its left; whether it has one."""
    _, u, v, _ = signed_distance(row, x, y, z)
    slope = np.sqrt(u * u + v * v)
    if slope < LEAST_SLOPE:
        return False
    direction[0], direction[1] = -row[SIDE] * v / slope, row[SIDE] * u / slope
    return True


# -- Placing: contour points on exact surfaces move onto the surfaces' sections, and take their directions -----


SMOOTH_COSINE = np.cos(np.deg2rad(0.5))
"""Least cosine between the directions of two sections at which a contour is smooth. A larger angle would let the uncertain
place of their joint bend a long segment beside a small rounding."""


@kernel
def is_placed(mesh: SurfaceMesh, up: int, down: int, z: float, i: int, found: Sides) -> bool:
    """Place point i of contours, on the edge of two half-edges, if the surfaces on both sides are known.

    Planes count as surfaces beside others; two of them have a straight edge.
    """
    mine, other = mesh.exact[up // 3], mesh.exact[down // 3]
    if mine < 0 or other < 0:
        return False
    curved = int(mesh.forms[mine, KIND]) != FLAT, int(mesh.forms[other, KIND]) != FLAT
    if not (curved[0] or curved[1]):
        return False
    x, y = found.points[i, 0], found.points[i, 1]
    if mine == other:
        known, x, y = on_one(mesh.forms[mine], x, y, z)
    else:
        known, x, y = on_both(mesh.forms[mine], mesh.forms[other], x, y, z)
    if not known:
        return False
    before, after = found.before[i], found.after[i]
    if not set_along(mesh.forms[mine], x, y, z, before) or not set_along(mesh.forms[other], x, y, z, after):
        return False
    found.points[i, 0], found.points[i, 1] = x, y
    found.smooth[i] = before[0] * after[0] + before[1] * after[1] >= SMOOTH_COSINE
    if curved[0]:
        found.form_before[i] = mine
    if curved[1]:
        found.form_after[i] = other
    found.flat[i] = found.flat[i] and not curved[1]
    return True


@kernel
def place_beside(mesh: SurfaceMesh, up: int, down: int, at: Vector, i: int, found: Sides) -> None:
    """Place point i, lifted by normals from `at`, on the one surface that is known on one side of its edge alone."""
    mine, other = mesh.exact[up // 3], mesh.exact[down // 3]
    if (mine < 0) == (other < 0):
        return
    form = max(mine, other)
    if int(mesh.forms[form, KIND]) == FLAT:
        return
    known, x, y = on_one(mesh.forms[form], at[0], at[1], at[2])
    along = found.before[i] if mine >= 0 else found.after[i]
    if not known or not set_along(mesh.forms[form], x, y, at[2], along):
        return
    found.points[i, 0], found.points[i, 1] = x, y
    if mine >= 0:
        found.form_before[i] = form
    else:
        found.form_after[i] = form
