"""Forms of exact surfaces as rows of numbers: signed distances from them, and fits of them to the vertices of a mesh.

A row holds the kind, a reference point, the parameters of the kind, and last the sign of the side on which there is no solid.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import least_squares

from ebamcheck.kernels import Floats, kernel

SPHERE, CYLINDER, CONE, TORUS, QUADRIC, FLAT = range(6)

NAMES = ("sphere", "cylinder", "cone", "torus", "quadric", "plane")  # Kinds by number
SIZE = 15  # Numbers in a row: kind, reference point (3), parameters of the kind (10), side

KIND, PLACE, OWN, SIDE = 0, 1, 4, 14
"""Indices within a row: of the kind, the reference point, the first parameter and the side.

Parameters are, of a sphere, its radius; of a cylinder, its axis (3) and radius; of a cone, whose reference point is its tip,
its axis (3) and the cosine and sine of its half angle; of a torus, its axis (3) and the radii of its ring and its tube; of a
quadric, in coordinates from the reference point, the coefficients of x^2, y^2, z^2, xy, xz, yz, x, y, z and 1; of a plane, its
normal (3).
"""

LEAST = 1e-300

Signed = tuple[float, float, float, float]  # Signed distance, mm, and its gradient, a unit vector


@kernel
def signed_distance(row: Floats, x: float, y: float, z: float) -> Signed:
    """Signed distance of a point from a surface, and its gradient; of a quadric to first order."""
    kind = int(row[KIND])
    x, y, z = x - row[PLACE], y - row[PLACE + 1], z - row[PLACE + 2]
    if kind == SPHERE:
        away = max(np.sqrt(x * x + y * y + z * z), LEAST)
        return away - row[OWN], x / away, y / away, z / away
    if kind == QUADRIC:
        own = row[OWN:SIDE]
        gx = 2.0 * own[0] * x + own[3] * y + own[4] * z + own[6]
        gy = 2.0 * own[1] * y + own[3] * x + own[5] * z + own[7]
        gz = 2.0 * own[2] * z + own[4] * x + own[5] * y + own[8]
        value = 0.5 * (x * (gx + own[6]) + y * (gy + own[7]) + z * (gz + own[8])) + own[9]
        slope = max(np.sqrt(gx * gx + gy * gy + gz * gz), LEAST)
        return value / slope, gx / slope, gy / slope, gz / slope
    u, v, w = row[OWN], row[OWN + 1], row[OWN + 2]
    along = x * u + y * v + z * w
    if kind == FLAT:
        return along, u, v, w
    x, y, z = x - along * u, y - along * v, z - along * w
    across = max(np.sqrt(x * x + y * y + z * z), LEAST)
    x, y, z = x / across, y / across, z / across
    if kind == CYLINDER:
        return across - row[OWN + 3], x, y, z
    if kind == CONE:
        cosine, sine = row[OWN + 3], row[OWN + 4]
        x, y, z = x * cosine - u * sine, y * cosine - v * sine, z * cosine - w * sine
        return across * cosine - along * sine, x, y, z
    off = across - row[OWN + 3]
    away = max(np.sqrt(off * off + along * along), LEAST)
    off, along = off / away, along / away
    return away - row[OWN + 4], x * off + u * along, y * off + v * along, z * off + w * along


@kernel
def signed_distances(rows: Floats, points: Floats) -> Floats:
    """Signed distances of points (n, 3) from a surface each, mm, and their gradients, (n, 4); one row of surfaces serves all."""
    found = np.empty((len(points), 4))
    for i in range(len(points)):
        row = rows[i if len(rows) > 1 else 0]
        found[i] = signed_distance(row, points[i, 0], points[i, 1], points[i, 2])
    return found


# -- fits: the simplest form first, each by least squares of the distances ---------------------------------
#
# A form is accepted only if its vertices determine it, with at least one place to spare in each of its two directions. Two rims
# of vertices lie on a cylinder, but also on many other quadrics; only flat strips between them show that the surface is straight
# from rim to rim. A sphere or general quadric must be the only quadric through its vertices; through those of a torus there must
# be none.

SPARE = 7  # Vertices beyond the unknowns of a form without strips: a decimated mesh has six or eight on many a cylinder by chance
APART = 20.0  # Least distance between places that count as distinct, in tolerances


def told_forms(
    points: Floats, places: Floats, normals: Floats, tolerance_mm: float, straight: bool = False
) -> Iterator[Floats]:
    """Forms (SIZE,) on which vertices (n, 3) lie, the simplest first; their side is to be set.

    The first guess is by middles and normals of facets. `straight`: all of these are strips, which show that the surface is
    straight from rim to rim. No form is 1000 times larger than its points: it may as well be flat.
    """
    points, (places, normals) = _spread(points)[0], _spread(places, normals)
    size = float(np.ptp(points, axis=0).max(initial=0.0))
    if len(points) < 6 or size <= 0.0:  # any five points lie on a cylinder, or nearly so
        return

    def kept(first: Floats | None) -> Iterator[Floats]:
        """The form refined from its first guess, if the points lie on it."""
        if first is None or not np.isfinite(first).all():
            return
        row = refined(first, points, tolerance_mm)
        if np.abs(row[OWN : OWN + 5]).max() <= 1e3 * size and _farthest(row, points) <= tolerance_mm:
            yield row

    count, only = _quadrics(points, size, tolerance_mm)
    if count:
        if only is not None or (count == 1 and len(points) < CUBIC_TERMS):
            yield from kept(_sphere(points))
        for guess in (_cylinder, _cone):
            for row in kept(guess(points, places, normals)):
                if _is_ruled(row, points, tolerance_mm, straight):
                    yield row
    elif len(points) >= 7 + SPARE:
        for row in kept(_torus(points, places, normals)):
            if _profile_points(row, points, tolerance_mm) >= 4:  # three always lie on one circle
                yield row
    if only is not None:
        yield only


def _spread(*columns: Floats) -> list[Floats]:
    """At most 400 rows of columns, evenly spread: all points are checked against what is fitted to these."""
    count = len(columns[0])
    return [c[np.linspace(0, count - 1, 400).astype(np.int64)] if count > 400 else c for c in columns]


def _farthest(row: Floats, points: Floats) -> float:
    return float(np.abs(signed_distances(row[None], points)[:, 0]).max())


CUBIC_TERMS = (
    20  # Coefficients of a cubic surface: from this many vertices on, cubics through them can contradict the quadric
)


def _quadrics(points: Floats, size: float, tolerance_mm: float) -> tuple[int, Floats | None]:
    """Number of independent quadrics through points, and the one if it is the only one and no cubics contradict it.

    Four cubics contain a quadric (it times x, y, z or 1); if more pass through the points, these do not determine it.
    """
    middle = points.mean(axis=0)
    x, y, z = unit = ((points - middle) / size).T
    squares = (x * x, y * y, z * z)
    rows = np.column_stack([*squares, x * y, x * z, y * z, x, y, z, np.ones(x.size)])
    if x.size < rows.shape[1]:
        return 2, None
    least, weight = tolerance_mm / size, np.sqrt(x.size)
    _, values, vectors = np.linalg.svd(rows / weight, full_matrices=False)
    count = int(np.count_nonzero(values <= least))
    if count != 1:
        return count, None
    own = vectors[-1] / np.concatenate([np.full(6, size * size), np.full(3, size), [1.0]])
    row = form_row(QUADRIC, middle, own)
    if _farthest(row, points) > tolerance_mm:
        return 0, None
    if x.size < CUBIC_TERMS:
        return 1, None
    cubics = np.column_stack([rows, *(s * t for s in squares for t in unit), x * y * z])
    values = np.linalg.svd(cubics / weight, compute_uv=False)
    return 1, row if np.count_nonzero(values <= least) <= 4 else None


# -- first guesses -----------------------------------------------------------------------------------------


def form_row(kind: int, place: Floats, own: Sequence[float] | Floats) -> Floats:
    """A form in the layout of exact_forms, its side to be set."""
    row = np.zeros(SIZE)
    row[KIND], row[PLACE:OWN], row[OWN : OWN + len(own)] = kind, place, own
    return row


def _sphere(points: Floats) -> Floats:
    centre, radius = _ball(points)
    return form_row(SPHERE, centre, [radius])


def _ball(points: Floats) -> tuple[Floats, float]:
    """Centre and radius of the circle through points (n, 2), or of the sphere through points (n, 3)."""
    middle = points.mean(axis=0)
    off = points - middle
    rows = np.column_stack([2.0 * off, np.ones(len(off))])
    centre = np.linalg.lstsq(rows, (off * off).sum(axis=1), rcond=None)[0][:-1]
    return middle + centre, float(np.linalg.norm(off - centre, axis=1).mean())


def _across(axis: Floats) -> Floats:
    """Two unit vectors (2, 3) perpendicular to an axis and to each other."""
    return np.asarray(np.linalg.svd(axis[None])[2][1:])


def _around(points: Floats, axis: Floats) -> tuple[Floats, Floats]:
    """Places (n,) of points, from a place on an axis, along it, and their distances from it."""
    along = points @ axis
    return along, np.linalg.norm(points - along[:, None] * axis, axis=1)


def _cylinder(points: Floats, places: Floats, normals: Floats) -> Floats:
    axis = np.linalg.svd(normals, full_matrices=False)[2][-1]
    frame = _across(axis)
    centre, radius = _ball(points @ frame.T)
    return form_row(CYLINDER, centre @ frame + axis * float((points @ axis).mean()), [*axis, radius])


def _cone(points: Floats, places: Floats, normals: Floats) -> Floats:
    """Axis: the direction with which all normals make the same angle; tip: where all tangent planes meet."""
    axis = np.linalg.svd(normals - normals.mean(axis=0), full_matrices=False)[2][-1]
    tip = np.linalg.lstsq(normals, (normals * places).sum(axis=1), rcond=None)[0]
    along, across = _around(points - tip, axis)
    if along.mean() < 0.0:
        axis, along = -axis, -along
    angle = float(np.median(np.arctan2(across, along)))
    return form_row(CONE, tip, [*axis, np.cos(angle), np.sin(angle)])


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
    along, across = _around((points - middle) / size - foot, axis)
    centre, tube = _ball(np.column_stack([across, along]))
    return form_row(TORUS, middle + size * (foot + centre[1] * axis), [*axis, size * centre[0], size * tube])


# -- what is told ------------------------------------------------------------------------------------------


def _is_ruled(row: Floats, points: Floats, tolerance_mm: float, straight: bool) -> bool:
    """Whether points determine the rulings of a cylinder or cone: by two on each where there are strips, else by three heights."""
    axis = row[OWN : OWN + 3]
    off = points - row[PLACE:OWN]
    flat = off @ _across(axis).T
    reach = float(np.linalg.norm(flat, axis=1).max())
    around = np.sort(np.arctan2(flat[:, 1], flat[:, 0])) * reach
    rulings = _distinct(around, APART * tolerance_mm)
    # One ruling may have its points on both sides of the half turn.
    rulings -= rulings > 1 and around[0] + 2.0 * np.pi * reach - around[-1] <= APART * tolerance_mm
    if rulings < 4:  # three always lie on a cylinder or cone
        return False
    if straight and len(points) >= 2 * rulings:
        return True
    enough = len(points) >= SPARE + UNKNOWNS[int(row[KIND])]
    return enough and _distinct(off @ axis, APART * tolerance_mm) >= 3


def _profile_points(row: Floats, points: Floats, tolerance_mm: float) -> int:
    """Number of distinct points on the profile of a torus, by their angle about its tube."""
    along, across = _around(points - row[PLACE:OWN], row[OWN : OWN + 3])
    angle = np.sort(np.arctan2(along, across - row[OWN + 3]))
    return _distinct(angle * abs(row[OWN + 4]), APART * tolerance_mm)


def _distinct(places: Floats, apart: float) -> int:
    return 1 + int(np.count_nonzero(np.diff(np.sort(places)) > apart))


# -- the form of least squares --------------------------------------------------------------------------------

STEP = 1e-6  # of the difference quotients: a fraction of the points' extent, or rad
UNKNOWNS = {SPHERE: 4, CYLINDER: 5, CONE: 6, TORUS: 7}


def refined(row: Floats, points: Floats, tolerance: float) -> Floats:
    """The form (SIZE,) of least squares from a first guess, in 40 steps; one that is still lost after 8 is given up."""
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
    end = 1e-15  # as far as rounding goes
    for steps in (8, 40):
        found = least_squares(off_at, move, slopes, method="lm", max_nfev=steps, xtol=end, ftol=end, gtol=end)
        move = found.x
        if not np.sqrt(np.mean(found.fun * found.fun)) * size <= 100.0 * tolerance:
            break
    return np.asarray(_moved(row, frame, move[None], size)[0])


def _moved(row: Floats, frame: Floats, moves: Floats, size: float) -> Floats:
    """A form after small moves (n, unknowns): of its place and sizes in units of `size`, of its axis and angles in rad."""
    kind = int(row[KIND])
    found = np.repeat(row[None], len(moves), axis=0)
    if kind == SPHERE:
        found[:, PLACE:OWN] += size * moves[:, :3]
        found[:, OWN] += size * moves[:, 3]
        return found
    axis = row[OWN : OWN + 3]
    turned = axis + moves[:, :2] @ frame
    found[:, OWN : OWN + 3] = turned / np.linalg.norm(turned, axis=1)[:, None]
    found[:, PLACE:OWN] += size * (moves[:, 2:4] @ frame)
    if kind == CYLINDER:
        found[:, OWN + 3] += size * moves[:, 4]
        return found
    found[:, PLACE:OWN] += size * moves[:, 4:5] * axis
    if kind == CONE:
        angle = np.arctan2(row[OWN + 4], row[OWN + 3]) + moves[:, 5]
        found[:, OWN + 3], found[:, OWN + 4] = np.cos(angle), np.sin(angle)
    else:
        found[:, OWN + 3 : OWN + 5] += size * moves[:, 5:7]
    return found
