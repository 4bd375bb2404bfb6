"""Placing: contour points on exact surfaces move onto the surfaces' sections, and take their directions."""

from __future__ import annotations

import numpy as np

from ebamcheck.curves.exact.forms import FLAT, KIND
from ebamcheck.curves.exact.sections import on_both, on_one, set_along
from ebamcheck.curves.sides import Sides
from ebamcheck.curves.surface_edges import SurfaceMesh, Vector
from ebamcheck.numeric.kernels import kernel

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
