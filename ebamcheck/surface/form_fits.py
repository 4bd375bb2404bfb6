"""Fits of forms to vertices: the simplest first, each by least squares of the distances.

A form is accepted only if its vertices determine it, with at least one place to spare in each of its two directions. Two rims
of vertices lie on a cylinder, but also on many other quadrics; only flat strips between them show that the surface is straight
from rim to rim. A sphere or general quadric must be the only quadric through its vertices; through those of a torus there must
be none.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.optimize import least_squares

from ebamcheck.kernels import Floats
from ebamcheck.surface.exact_forms import (
    CONE,
    CYLINDER,
    KIND,
    OWN,
    PLACE,
    QUADRIC,
    SIZE,
    SPHERE,
    TORUS,
    signed_distances,
)

MOST_POINTS = 400  # Most vertices used for a fit, evenly spread; all are then checked against it
LEAST_POINTS = 6  # Fewest vertices for a fit: any five lie on a cylinder, or nearly so
LEAST_RULINGS = 4  # Fewest distinct rulings of a cylinder or cone: three always lie on one
SPARE = 7  # Vertices beyond the unknowns of a form without strips: a decimated mesh has six or eight on many a cylinder by chance
LEAST_HEIGHTS = 3  # Fewest distinct heights along the axis of a cylinder or cone that only vertices support
APART = 20.0  # Least distance between places that count as distinct, in tolerances
LEAST_PROFILE = 4  # Fewest distinct points on the profile of a torus: three always lie on one circle
CUBIC_TERMS = 20  # Coefficients of a cubic surface: from this many vertices on, cubics through them can contradict the quadric

OWN_CUBICS = 4
"""Independent cubics that contain a given quadric (it times x, y, z or 1); if more pass through the vertices, these do not
determine the quadric."""

MOST_RADIUS = 1e3  # Largest radius over the size of the fitted points: beyond it they may as well be flat


def told_forms(
    points: Floats,
    places: Floats,
    normals: Floats,
    tolerance_mm: float,
    straight: bool = False,
) -> Iterator[Floats]:
    """Forms (SIZE,) on which vertices (n, 3) lie, the simplest first; their side is to be set.

    The first guess is by middles and normals of facets. `straight`: all of these are strips, which show that the surface is
    straight from rim to rim.
    """
    if len(points) > MOST_POINTS:
        points = points[np.linspace(0, len(points) - 1, MOST_POINTS).astype(np.int64)]
    if len(places) > MOST_POINTS:
        chosen = np.linspace(0, len(places) - 1, MOST_POINTS).astype(np.int64)
        places, normals = places[chosen], normals[chosen]
    if len(points) < LEAST_POINTS:
        return
    size = float(np.ptp(points, axis=0).max())
    if size <= 0.0:
        return
    middle = points.mean(axis=0)
    quadrics = _Quadrics(points, middle, size, tolerance_mm)
    if quadrics.count:
        if quadrics.count == 1 and (quadrics.borne_out or len(points) < CUBIC_TERMS):
            yield from _kept(_sphere(points, middle), points, size, tolerance_mm)
        for first in (_cylinder, _cone):
            for row in _kept(first(points, places, normals), points, size, tolerance_mm):
                if _is_ruled(row, points, tolerance_mm, straight):
                    yield row
    if len(points) >= 7 + SPARE and not quadrics.count:
        for row in _kept(_torus(points, places, normals), points, size, tolerance_mm):
            if _profile_points(row, points, tolerance_mm) >= LEAST_PROFILE:
                yield row
    if quadrics.count == 1 and quadrics.borne_out:
        yield quadrics.only


def _kept(row: Floats | None, points: Floats, size: float, tolerance_mm: float) -> Iterator[Floats]:
    """The form refined from its first guess, if the points lie on it."""
    if row is None or not np.isfinite(row).all():
        return
    found = refined(row, points, tolerance_mm)
    if np.abs(found[OWN : OWN + 5]).max() > MOST_RADIUS * size:
        return
    off = signed_distances(found[None], points)[:, 0]
    if np.abs(off).max() <= tolerance_mm:
        yield found


class _Quadrics:
    """Quadrics through points: `count` independent ones; if that is 1, `only` is it, and `borne_out` if cubics confirm it."""

    def __init__(self, points: Floats, middle: Floats, size: float, tolerance_mm: float) -> None:
        unit = (points - middle) / size
        least = tolerance_mm / size
        rows = _monomials(unit)
        self.count = 0
        self.borne_out = False
        if len(unit) < rows.shape[1]:
            self.count = 2
            return
        _, values, vectors = np.linalg.svd(rows / np.sqrt(len(unit)), full_matrices=False)
        self.count = int(np.count_nonzero(values <= least))
        if self.count != 1:
            return
        own = vectors[-1]
        row = np.zeros(SIZE)
        row[PLACE - 1], row[PLACE : PLACE + 3] = QUADRIC, middle
        row[OWN : OWN + 10] = own / np.concatenate([np.full(6, size * size), np.full(3, size), [1.0]])
        if np.abs(signed_distances(row[None], points)[:, 0]).max() > tolerance_mm:
            self.count = 0
            return
        self.only = row
        cubics = np.concatenate([rows, _cubic_monomials(unit)], axis=1)
        if len(unit) >= CUBIC_TERMS:
            values = np.linalg.svd(cubics / np.sqrt(len(unit)), compute_uv=False)
            self.borne_out = int(np.count_nonzero(values <= least)) <= OWN_CUBICS


def _monomials(p: Floats) -> Floats:
    x, y, z = p.T
    return np.column_stack([x * x, y * y, z * z, x * y, x * z, y * z, x, y, z, np.ones(len(p))])


def _cubic_monomials(p: Floats) -> Floats:
    x, y, z = p.T
    squares = (x * x, y * y, z * z)
    return np.column_stack([s * t for s in squares for t in (x, y, z)] + [x * y * z])


# -- first guesses -----------------------------------------------------------------------------------------


def _sphere(points: Floats, middle: Floats) -> Floats:
    off = points - middle
    rows = np.column_stack([2.0 * off, np.ones(len(off))])
    solution = np.linalg.lstsq(rows, (off * off).sum(axis=1), rcond=None)[0]
    row = np.zeros(SIZE)
    row[0], row[PLACE : PLACE + 3] = SPHERE, middle + solution[:3]
    row[OWN] = np.linalg.norm(off - solution[:3], axis=1).mean()
    return row


def _axis_by_normals(normals: Floats) -> Floats:
    """The unit direction with which all normals make the same angle, as nearly as can be."""
    return np.asarray(np.linalg.svd(normals - normals.mean(axis=0), full_matrices=False)[2][-1])


def _across(axis: Floats) -> Floats:
    """Two unit vectors (2, 3) perpendicular to an axis and to each other."""
    return np.asarray(np.linalg.svd(axis[None])[2][1:])


def _cylinder(points: Floats, places: Floats, normals: Floats) -> Floats | None:
    axis = np.linalg.svd(normals, full_matrices=False)[2][-1]
    frame = _across(axis)
    centre, radius = _circle(points @ frame.T)
    row = np.zeros(SIZE)
    row[0], row[PLACE : PLACE + 3] = CYLINDER, centre @ frame + axis * float((points @ axis).mean())
    row[OWN : OWN + 3], row[OWN + 3] = axis, radius
    return row


def _cone(points: Floats, places: Floats, normals: Floats) -> Floats | None:
    axis = _axis_by_normals(normals)
    tip = np.linalg.lstsq(normals, (normals * places).sum(axis=1), rcond=None)[0]
    off = points - tip
    along = off @ axis
    if along.mean() < 0.0:
        axis, along = -axis, -along
    across = np.linalg.norm(off - along[:, None] * axis, axis=1)
    angle = float(np.median(np.arctan2(across, along)))
    row = np.zeros(SIZE)
    row[0], row[PLACE : PLACE + 3] = CONE, tip
    row[OWN : OWN + 5] = *axis, np.cos(angle), np.sin(angle)
    return row


def _torus(points: Floats, places: Floats, normals: Floats) -> Floats | None:
    """Axis: the line that all normals meet (Pottmann and Wallner, Computational Line Geometry, 2001, chapter 4)."""
    middle = points.mean(axis=0)
    size = float(np.ptp(points, axis=0).max())
    off = (places - middle) / size
    lines = np.concatenate([np.cross(off, normals), normals], axis=1)
    direction, moment = np.split(np.linalg.svd(lines, full_matrices=False)[2][-1], 2)
    length = float(np.linalg.norm(direction))
    if length < 1e-9:
        return None
    axis = direction / length
    foot = np.cross(direction, moment) / (length * length)
    at = (points - middle) / size - foot
    along = at @ axis
    across = np.linalg.norm(at - along[:, None] * axis, axis=1)
    centre, tube = _circle(np.column_stack([across, along]))
    row = np.zeros(SIZE)
    row[0], row[PLACE : PLACE + 3] = TORUS, middle + size * (foot + centre[1] * axis)
    row[OWN : OWN + 5] = *axis, size * centre[0], size * tube
    return row


def _circle(points: Floats) -> tuple[Floats, float]:
    """Centre and radius of the circle through points (n, 2)."""
    middle = points.mean(axis=0)
    off = points - middle
    rows = np.column_stack([2.0 * off, np.ones(len(off))])
    solution = np.linalg.lstsq(rows, (off * off).sum(axis=1), rcond=None)[0]
    return middle + solution[:2], float(np.linalg.norm(off - solution[:2], axis=1).mean())


# -- what is told ------------------------------------------------------------------------------------------


def _is_ruled(row: Floats, points: Floats, tolerance_mm: float, straight: bool) -> bool:
    """Whether points determine the rulings of a cylinder or cone: by two on each where there are strips, else by three heights."""
    axis = row[OWN : OWN + 3]
    off = points - row[PLACE : PLACE + 3]
    flat = off @ _across(axis).T
    reach = float(np.linalg.norm(flat, axis=1).max())
    around = np.sort(np.arctan2(flat[:, 1], flat[:, 0])) * reach
    rulings = _distinct(around, APART * tolerance_mm)
    # One ruling may have its points on both sides of the half turn.
    rulings -= rulings > 1 and around[0] + 2.0 * np.pi * reach - around[-1] <= APART * tolerance_mm
    if rulings < LEAST_RULINGS:
        return False
    if straight and len(points) >= 2 * rulings:
        return True
    if len(points) < SPARE + (6 if int(row[0]) == CONE else 5):
        return False
    return _distinct(off @ axis, APART * tolerance_mm) >= LEAST_HEIGHTS


def _profile_points(row: Floats, points: Floats, tolerance_mm: float) -> int:
    """Number of distinct points on the profile of a torus, by their angle about its tube."""
    axis = row[OWN : OWN + 3]
    off = points - row[PLACE : PLACE + 3]
    along = off @ axis
    across = np.linalg.norm(off - along[:, None] * axis, axis=1) - row[OWN + 3]
    return _distinct(np.sort(np.arctan2(along, across)) * abs(row[OWN + 4]), APART * tolerance_mm)


def _distinct(places: Floats, apart: float) -> int:
    return 1 + int(np.count_nonzero(np.diff(np.sort(places)) > apart))


# -- the form of least squares --------------------------------------------------------------------------------

FIRST_STEPS = 8  # Steps after which a form that is still far from its points is given up
LOST = 100.0  # Largest root mean square distance after that many steps, in tolerances

MOST_STEPS = 40

STEP = 1e-6  # of the difference quotients: a fraction of the points' extent, or rad

UNKNOWNS = {SPHERE: 4, CYLINDER: 5, CONE: 6, TORUS: 7}


def refined(row: Floats, points: Floats, tolerance: float) -> Floats:
    """The form (SIZE,) of least squares from a first guess; one that stays far beyond the tolerance is given up early."""
    size = float(np.ptp(points, axis=0).max())
    count = UNKNOWNS[int(row[KIND])]
    frame = _across(row[OWN : OWN + 3])
    tries = np.concatenate([np.zeros((1, count)), STEP * np.eye(count)])

    def off(moves: Floats) -> Floats:
        rows = np.repeat(_moved(row, frame, moves, size), len(points), axis=0)
        found = signed_distances(rows, np.tile(points, (len(moves), 1)))[:, 0]
        return np.asarray(found.reshape(len(moves), -1) / size)

    def off_at(move: Floats) -> Floats:
        return np.asarray(off(move[None])[0])

    def slopes(move: Floats) -> Floats:
        here, *beside = off(move + tries)
        return np.column_stack([there - here for there in beside]) / STEP

    move = np.zeros(count)
    for steps in (FIRST_STEPS, MOST_STEPS):
        found = least_squares(
            off_at,
            move,
            slopes,
            method="lm",
            max_nfev=steps,
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        move = found.x
        if not np.sqrt(np.mean(found.fun * found.fun)) * size <= LOST * tolerance:
            break
    return np.asarray(_moved(row, frame, move[None], size)[0])


def _moved(row: Floats, frame: Floats, moves: Floats, size: float) -> Floats:
    """A form after small moves (n, unknowns): of its place and sizes in units of `size`, of its axis and angles in rad."""
    kind = int(row[KIND])
    found = np.repeat(row[None], len(moves), axis=0)
    if kind == SPHERE:
        found[:, PLACE : PLACE + 3] += size * moves[:, :3]
        found[:, OWN] += size * moves[:, 3]
        return found
    axis = row[OWN : OWN + 3]
    turned = axis + moves[:, :2] @ frame
    found[:, OWN : OWN + 3] = turned / np.linalg.norm(turned, axis=1)[:, None]
    found[:, PLACE : PLACE + 3] += size * (moves[:, 2:4] @ frame)
    if kind == CYLINDER:
        found[:, OWN + 3] += size * moves[:, 4]
        return found
    found[:, PLACE : PLACE + 3] += size * moves[:, 4:5] * axis
    if kind == CONE:
        angle = np.arctan2(row[OWN + 4], row[OWN + 3]) + moves[:, 5]
        found[:, OWN + 3], found[:, OWN + 4] = np.cos(angle), np.sin(angle)
    else:
        found[:, OWN + 3 : OWN + 5] += size * moves[:, 5:7]
    return found
