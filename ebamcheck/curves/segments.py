"""Segments: one for each segment of a contour, reduced to the fewest within a tolerance, and joined to the pieces of curves.

A reduced line, arc or cubic goes as far as it can, from a point and direction of the contour to another point and its direction,
so the pieces join without a kink. A circle stays a circle: an arc is taken if it fits within half of the tolerance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.columns_file import starts_of
from ebamcheck.curves.bezier import places_along
from ebamcheck.curves.columns import Curves, of_layers
from ebamcheck.curves.oriented_contours import OrientedContours
from ebamcheck.curves.runs import ARC, LINE, SPLINE, angles, around
from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.layers.stack import Layers
from ebamcheck.threads import run_blocks


class Segments(NamedTuple):
    """Segments of rings, as columns."""

    points: Floats
    """(n, 4, 2) Bezier points of a cubic, mm. A line has its ends in the first and last place; an arc also its middle in the
    second."""
    kind: NDArray[np.uint8]  # (n,) LINE, SPLINE (a cubic) or ARC
    corner: Bools  # (n,) whether there is a corner before the segment
    ring_starts: Ints  # (R + 1,) first segment of each ring


def smooth_segments(contours: OrientedContours, closed: Bools) -> Segments:
    """One cubic or line for each segment of the contours.

    The inner legs of a cubic are as long as those of a circle's that turns as much (Stone, DeRose 1989).
    """
    ring, following, _ = around(contours.starts)
    at = np.arange(ring.size)
    i = np.flatnonzero((following > at) | (closed[ring] & (following != at)))
    j = following[i]
    p, q, start, end = contours.points[i], contours.points[j], contours.after[i], contours.before[j]
    x, y = (q - p).T
    half = 0.5 * (np.abs(start) + np.abs(end))
    leg = 2.0 / (3.0 * (1.0 + np.cos(np.minimum(half, 0.5 * np.pi))))
    B = np.stack([p, p, q, q], axis=1)
    curved = ~contours.straight[i]
    for k, angle, side in ((1, start, 1.0), (2, end, -1.0)):
        c, s = np.cos(angle) * leg, side * np.sin(angle) * leg
        B[curved, k] += side * np.column_stack([c * x + s * y, c * y - s * x])[curved]
    kind = np.where(curved, np.uint8(SPLINE), np.uint8(LINE))
    return Segments(B, kind, contours.corner[i], starts_of(np.bincount(ring[i], minlength=closed.size)))


def curves_of(segments: Segments, layers: Layers) -> Curves:
    """Join segments of layers into pieces: lines into polylines, cubics without a corner into splines, arcs each its own.

    A spline of cubics has double inner knots, whose intervals make it continuously differentiable.
    """
    B, kind = segments.points, segments.kind
    count = len(kind)
    begins = np.zeros(count + 1, np.bool_)
    begins[segments.ring_starts] = True
    begins = begins[:-1]
    curved = kind == SPLINE
    begins[1:] |= (kind[1:] != kind[:-1]) | (kind[1:] == ARC) | (curved[1:] & segments.corner[1:])
    legs = np.hypot(*np.moveaxis(B[:, [1, 3]] - B[:, [0, 2]], 2, 0))
    begins[1:] |= curved[1:] & ((legs[1:, 0] == 0.0) | (legs[:-1] == 0.0).any(axis=1))
    # Each knot interval is to that before as the legs that meet between them. So, over the length of a first leg, it grows by
    # the logarithms of first over last legs; where it has grown fourfold, either way, the next spline begins.
    growth = np.log(np.where(legs > 0.0, legs, 1.0)) @ np.array([1.0, -1.0]) * curved
    grown = np.cumsum(growth) - growth
    while True:
        start = np.maximum.accumulate(np.where(begins, np.arange(count), 0))
        uneven = np.flatnonzero(curved & (np.abs(grown - grown[start]) >= np.log(4.0)))
        if not uneven.size:
            break
        begins[uneven[np.unique(start[uneven], return_index=True)[1]]] = True
    first = np.flatnonzero(begins)
    sizes = np.diff(first, append=count)
    last, of_piece = first + sizes - 1, kind[first]
    piece, place = each_of(sizes)
    splines = of_piece == SPLINE
    control_starts = starts_of(np.where(splines, 2 * sizes + 2, np.where(of_piece == ARC, 3, sizes + 1)))
    knot_starts = starts_of(np.where(splines, 2 * sizes + 6, 0))
    control, knots = np.empty((int(control_starts[-1]), 2)), np.empty(int(knot_starts[-1]))
    control[control_starts[:-1]], control[control_starts[1:] - 1] = B[first, 0], B[last, 3]
    at = control_starts[piece]
    inner, arcs = np.flatnonzero((kind == LINE) & (place < sizes[piece] - 1)), np.flatnonzero(kind == ARC)
    control[at[inner] + place[inner] + 1], control[at[arcs] + 1] = B[inner, 3], B[arcs, 1]
    k = np.flatnonzero(curved)
    for step in (1, 2):
        control[at[k] + 2 * place[k] + step] = B[k, step]
    own = np.where(begins | (legs[start, 0] == 0.0), 1.0, legs[start, 0])
    relative = np.where(begins, 1.0, legs[:, 0] / own * np.exp(grown - grown[start]))
    chord = np.hypot(*(B[:, 3] - B[:, 0]).T)
    total, wanted = (np.bincount(piece, column, minlength=first.size) for column in (relative, chord))
    interval = np.where(curved, relative * (wanted / np.where(total > 0.0, total, 1.0))[piece], 0.0)
    along = np.cumsum(interval)
    along -= (along - interval)[first][piece]
    at = knot_starts[piece]
    for step in (4, 5):
        knots[at[k] + 2 * place[k] + step] = along[k]
    head, tail = knot_starts[:-1][splines], knot_starts[1:][splines]
    for step in range(4):
        knots[head + step] = 0.0
    for step in (1, 2):
        knots[tail - step] = along[last[splines]]
    ring_starts = np.searchsorted(first, segments.ring_starts).astype(np.int64)
    return of_layers(layers, ring_starts, of_piece, (control_starts, control), (knot_starts, knots))


# -- reduction -------------------------------------------------------------------------------------------

LARGEST_SWEEP_RAD = np.deg2rad(170.0)
"""Largest sweep of one arc: below half a turn, an arc given to a control by its radius is unambiguous."""

NEWTON_STEPS = 2  # Rounds in which samples move to their foot points and the cubic is fitted again
SAMPLES_A_SEGMENT = 4  # Places along each segment of the contour at which the reduced curve is checked


class Path(NamedTuple):
    """Chains of cubics, joint by joint, with samples along them; a chain has one joint more than it has cubics."""

    points: Floats  # (n, 2) joints
    directions: Floats  # (n, 2) unit directions at the joints
    turns: Floats  # (n,) signed turn from a first joint to each, rad
    samples: Floats  # (SAMPLES_A_SEGMENT n, 2) points from each joint on along the cubic after it, mm
    lengths: Floats  # (SAMPLES_A_SEGMENT n,) length along the samples from a first one, mm


def reduced_segments(segments: Segments, tolerance_mm: float) -> Segments:
    """Lines, arcs and cubics, as few as the tolerance allows, in place of lines and cubics."""
    B, kind, corner, _ = segments
    curved = np.flatnonzero(kind == SPLINE)
    begins = np.zeros(len(kind) + 1, np.bool_)
    begins[segments.ring_starts] = True
    begins = begins[:-1] | corner
    begins[1:] |= kind[:-1] == LINE
    first = np.flatnonzero(begins[curved])
    sizes = np.diff(first, append=curved.size)
    chord = B[curved, 3] - B[curved, 0]
    turns = [np.abs(angles(leg, chord)) for leg in (B[curved, 1] - B[curved, 0], B[curved, 3] - B[curved, 2])]
    bulge = np.maximum.reduceat(0.25 * np.hypot(*chord.T) * np.maximum(*turns), first)
    # At most a tenth of a ring's greatest bulge is given away, lest what lifting gained be lost again; but at least half of the
    # least distance of contour points.
    allowed = np.minimum(tolerance_mm, np.maximum(0.1 * bulge, 0.0005))
    joints = starts_of(sizes + 1)
    path = _path_along(B[curved], first, sizes, joints)
    found, arc = np.empty((int(joints[-1]), 4, 2)), np.zeros(int(joints[-1]), np.bool_)
    counts = np.zeros(first.size, np.int64)

    def work(start: int, stop: int) -> None:
        _reduce(path, joints, allowed, start, stop, found, arc, counts)

    run_blocks(work, first.size, 16)
    sizes = np.where(kind == LINE, 1, 0)
    sizes[curved[first]] = counts
    source, place = each_of(sizes)
    # The row of a line, or the first of what a chain became, in both together.
    from_row = np.arange(len(kind))
    from_row[curved[first]] = len(kind) + joints[:-1]
    row = from_row[source] + place
    arcs = np.concatenate([np.zeros(len(kind), np.bool_), arc])[row]
    new_kind = np.where(kind[source] == LINE, LINE, np.where(arcs, ARC, SPLINE)).astype(np.uint8)
    points, ring_starts = np.concatenate([B, found])[row], starts_of(sizes)[segments.ring_starts]
    return Segments(points, new_kind, corner[source] & (place == 0), ring_starts)


def _path_along(B: Floats, first: Ints, sizes: Ints, joints: Ints) -> Path:
    """Path along chains of cubics (n, 4, 2) that begin at the rows `first` and at the joints `joints`."""
    count = int(joints[-1])
    at = np.arange(len(B)) + each_of(sizes)[0]
    last, end = first + sizes - 1, joints[1:] - 1
    points, directions = np.empty((count, 2)), np.empty((count, 2))
    points[at], points[end] = B[:, 0], B[last, 3]
    chord = B[:, 3] - B[:, 0]
    directions[at] = _units(B[:, 1] - B[:, 0], chord)
    directions[end] = _units(B[last, 3] - B[last, 2], chord[last])
    samples = np.repeat(points[:, None], SAMPLES_A_SEGMENT, axis=1)
    for j, along in enumerate(places_along(B, SAMPLES_A_SEGMENT)):
        samples[at, j] = along
    samples = samples.reshape(-1, 2)
    steps = np.hypot(*np.diff(samples, axis=0, prepend=samples[:1]).T)
    turns = angles(np.roll(directions, 1, axis=0), directions)
    return Path(points, directions, np.cumsum(turns), samples, np.cumsum(steps))


def _units(vectors: Floats, instead: Floats) -> Floats:
    """Unit vectors (n, 2), or those along others where they have no length."""
    lost = (vectors[:, 0] == 0.0) & (vectors[:, 1] == 0.0)
    vectors = np.where(lost[:, None], instead, vectors)
    return np.asarray(vectors / np.maximum(np.hypot(*vectors.T), 1e-300)[:, None])


@kernel
def _reduce(
    path: Path, joints: Ints, allowed: Floats, first: int, last: int, found: Floats, arc: Bools, counts: Ints
) -> None:
    """Write the fewest segments along each chain, each as long as can be, from its first joint on, and how many there are."""
    direction, reached = np.empty(2), np.empty(2, np.int64)
    for c in range(first, last):
        i, end, n = joints[c], joints[c + 1] - 1, joints[c]
        direction[0], direction[1] = path.directions[i, 0], path.directions[i, 1]
        guess = 1
        while i < end:
            B = found[n]
            for as_arc in range(2):
                reached[as_arc] = _farthest(path, direction, i, end, guess, allowed[c], as_arc, B)
                guess = max(reached[as_arc] - i, 1)
            turn = abs(path.turns[reached[1]] - path.turns[i])
            arc[n] = reached[1] - i > 1 and (reached[1] >= reached[0] or turn > 0.9 * LARGEST_SWEEP_RAD)
            j = reached[1] if arc[n] else reached[0]
            x, y = path.points[j, 0] - path.points[i, 0], path.points[j, 1] - path.points[i, 1]
            if arc[n]:
                _fit_arc(path, direction, i, j, allowed[c], B)
                u, v = B[1, 0] - B[0, 0], B[1, 1] - B[0, 1]
                half = 2.0 * np.arctan2(u * y - v * x, u * x + v * y)
                c_, s, chord = np.cos(half), np.sin(half), np.hypot(x, y)
                direction[0], direction[1] = (c_ * x - s * y) / chord, (s * x + c_ * y) / chord
            else:
                back = path.directions[j]
                if not _fit_cubic(path, direction, i, j, allowed[c], B):
                    # A single segment is what it is, from the direction in which the last one ended.
                    u, v = direction
                    before = np.arctan2(u * y - v * x, u * x + v * y)
                    after = np.arctan2(x * back[1] - y * back[0], x * back[0] + y * back[1])
                    half = min(0.5 * (abs(before) + abs(after)), 0.5 * np.pi)
                    leg = 2.0 / (3.0 * (1.0 + np.cos(half)))
                    for axis in range(2):
                        B[0, axis], B[3, axis] = path.points[i, axis], path.points[j, axis]
                    c_, s = np.cos(before) * leg, np.sin(before) * leg
                    B[1, 0], B[1, 1] = B[0, 0] + c_ * x + s * y, B[0, 1] + c_ * y - s * x
                    c_, s = np.cos(after) * leg, np.sin(after) * leg
                    B[2, 0], B[2, 1] = B[3, 0] - c_ * x + s * y, B[3, 1] - c_ * y - s * x
                direction[0], direction[1] = back[0], back[1]
            n += 1
            guess = j - i
            i = j
        counts[c] = n - joints[c]


@kernel
def _farthest(
    path: Path, direction: Floats, i: int, end: int, guess: int, tolerance: float, as_arc: int, B: Floats
) -> int:
    """Farthest joint that one segment from joint i reaches within the tolerance; i + 1 at least."""
    low, step = 1, guess
    high = end - i + 1
    while low < high - 1:  # from the guess outward, then by halves
        size = min(low + step, high - 1) if step > 0 else (low + high) // 2
        if as_arc == 1:
            fits = _fit_arc(path, direction, i, i + size, tolerance, B)
        else:
            fits = _fit_cubic(path, direction, i, i + size, tolerance, B)
        if fits:
            low = size
            step *= 2
        else:
            high = size
            step = 0
    return i + low


@kernel
def _fit_arc(path: Path, direction: Floats, i: int, j: int, tolerance: float, B: Floats) -> bool:
    """Arc from joint i in a direction to joint j; whether it fits."""
    p, q = path.points[i], path.points[j]
    x, y = q[0] - p[0], q[1] - p[1]
    chord = np.hypot(x, y)
    half = np.arctan2(direction[0] * y - direction[1] * x, direction[0] * x + direction[1] * y)
    # Arcs with a radius of over 10 m are nearly straight, with an ill-determined centre: they are written as cubics.
    if abs(half) > 0.5 * LARGEST_SWEEP_RAD or chord >= 2.0 * 10_000.0 * np.sin(abs(half)):
        return False
    # The next segment starts in the arc's direction.
    if abs(path.turns[j] - path.turns[i] - 2.0 * half) > 2e-3:
        return False
    rise = 0.5 * chord * np.tan(0.5 * half)
    B[0], B[3] = p, q
    B[1, 0] = 0.5 * (p[0] + q[0]) + rise * y / chord
    B[1, 1] = 0.5 * (p[1] + q[1]) - rise * x / chord
    B[2] = B[1]
    radius = 0.5 * chord / np.sin(half)
    cx, cy = p[0] - radius * direction[1], p[1] + radius * direction[0]
    for k in range(SAMPLES_A_SEGMENT * i, SAMPLES_A_SEGMENT * j):
        off = abs(np.hypot(path.samples[k, 0] - cx, path.samples[k, 1] - cy) - abs(radius))
        if off > 0.5 * tolerance:  # then the path is a circle, and not merely near one
            return False
    return True


@kernel
def _fit_cubic(path: Path, direction: Floats, i: int, j: int, tolerance: float, B: Floats) -> bool:
    """Cubic from joint i in a direction to joint j in its own, nearest to the samples; whether it fits."""
    if abs(path.turns[j] - path.turns[i]) > np.deg2rad(120.0):  # beyond that cubics loop
        return False
    first, last = SAMPLES_A_SEGMENT * i, SAMPLES_A_SEGMENT * j
    length = path.lengths[last] - path.lengths[first]
    p, q = path.points[i], path.points[j]
    chord = np.hypot(q[0] - p[0], q[1] - p[1])
    if chord <= 0.01 * length:  # nearly a closed loop
        return False
    back = path.directions[j]
    B[0], B[3] = p, q
    stride = max(1, (last - first) // 24)  # two legs follow from a few places; all are checked
    count = (last - first) // stride
    t = np.empty(count)
    for k in range(count):
        t[k] = (path.lengths[first + k * stride] - path.lengths[first]) / length
    for step in range(NEWTON_STEPS + 1):
        _set_legs(path.samples, first, stride, t, direction, back, length, B)
        if step < NEWTON_STEPS:
            for k in range(count):
                t[k] = _foot(B, path.samples[first + k * stride], t[k])
    for k in range(first + 1, last):
        point = path.samples[k]
        u = (path.lengths[k] - path.lengths[first]) / length
        u = _foot(B, point, _foot(B, point, u))
        s = 1.0 - u
        square = 0.0
        for axis in range(2):
            inner = 3.0 * s * u * (s * B[1, axis] + u * B[2, axis])
            off = s * s * s * B[0, axis] + inner + u * u * u * B[3, axis] - point[axis]
            square += off * off
        if np.sqrt(square) > tolerance:
            return False
    return True


@kernel
def _set_legs(
    samples: Floats,
    first: int,
    stride: int,
    t: Floats,
    direction: Floats,
    back: Floats,
    length: float,
    B: Floats,
) -> None:
    """Legs of a cubic with given ends and directions by least squares (Schneider 1990); those of a circle where they fail."""
    c00 = c01 = c11 = r0 = r1 = 0.0
    for k in range(t.size):
        u = t[k]
        s = 1.0 - u
        b1, b2 = 3.0 * s * s * u, 3.0 * s * u * u
        start, end = s * s * (s + 3.0 * u), u * u * (u + 3.0 * s)
        for axis in range(2):
            a0, a1 = b1 * direction[axis], -b2 * back[axis]
            rest = samples[first + k * stride, axis] - start * B[0, axis] - end * B[3, axis]
            c00 += a0 * a0
            c01 += a0 * a1
            c11 += a1 * a1
            r0 += a0 * rest
            r1 += a1 * rest
    determinant = c00 * c11 - c01 * c01
    even = length / 3.0
    legs = np.array([even, even])
    if determinant > 1e-9 * c00 * c11:
        legs[0] = (r0 * c11 - r1 * c01) / determinant
        legs[1] = (r1 * c00 - r0 * c01) / determinant
        if not (0.25 * even < legs[0] < 3.0 * even and 0.25 * even < legs[1] < 3.0 * even):
            legs[0] = legs[1] = even
    for axis in range(2):
        B[1, axis] = B[0, axis] + legs[0] * direction[axis]
        B[2, axis] = B[3, axis] - legs[1] * back[axis]


@kernel
def _foot(B: Floats, point: Floats, t: float) -> float:
    """Move a parameter towards the foot of a point by a step of Gauss and Newton."""
    s = 1.0 - t
    dot = square = 0.0
    for axis in range(2):
        at = s * s * s * B[0, axis] + 3.0 * s * t * (s * B[1, axis] + t * B[2, axis]) + t * t * t * B[3, axis]
        d = s * s * (B[1, axis] - B[0, axis]) + 2.0 * s * t * (B[2, axis] - B[1, axis])
        d = 3.0 * (d + t * t * (B[3, axis] - B[2, axis]))
        dot += (at - point[axis]) * d
        square += d * d
    if square == 0.0:
        return t
    return float(min(max(t - dot / square, 0.0), 1.0))
