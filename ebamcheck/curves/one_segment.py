"""One segment: the arc or cubic nearest to a range of a path, and whether it is near enough."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.segments import set_cubic
from ebamcheck.kernels import Floats, kernel

ARC_SHARE = 0.5
"""Share of the tolerance within which an arc must stay: then the path is a circle, and not merely near one."""

ARC_DIRECTION_RAD = 2e-3
"""Largest error of the direction in which an arc ends; the next segment starts in the arc's direction."""

LARGEST_RADIUS_MM = 10_000.0
"""Largest radius of an arc: larger ones are nearly straight, with an ill-determined centre, and are written as cubics."""

LARGEST_SWEEP_RAD = np.deg2rad(170.0)
"""Largest sweep of one arc: below half a turn, an arc given to a control by its radius is unambiguous."""

LARGEST_TURN_RAD = np.deg2rad(120.0)
"""Largest turn of one cubic: beyond it cubics loop."""

NEWTON_STEPS = 2
"""Rounds in which the samples' parameters move to their foot points and the cubic is fitted again."""

SAMPLES_A_SEGMENT = 4
"""Places along each segment of the contour at which the reduced curve is checked."""

CLOSED_LOOP_SHARE = 0.01
"""A range whose ends are nearer to each other than this share of its length is not tried as one segment."""


class Path(NamedTuple):
    """A chain of cubics through points, with samples along it."""

    points: Floats
    """(n + 1, 2) joints."""
    directions: Floats
    """(n + 1, 2) unit directions at the joints."""
    samples: Floats
    """(SAMPLES_A_SEGMENT n + 1, 2) points along the cubics, mm."""
    lengths: Floats
    """(SAMPLES_A_SEGMENT n + 1,) length along the samples from the first, mm."""
    turns: Floats
    """(n + 1,) signed turn from the first joint to each, rad."""


@kernel
def path_of(cubics: Floats) -> Path:
    """Chain of cubics (n, 4, 2), Bezier points, with its samples, lengths and turns."""
    count = len(cubics)
    joints = np.empty((count + 1, 2))
    directions = np.empty((count + 1, 2))
    samples = np.empty((SAMPLES_A_SEGMENT * count + 1, 2))
    lengths = np.zeros(SAMPLES_A_SEGMENT * count + 1)
    turns = np.zeros(count + 1)
    for i in range(count):
        B = cubics[i]
        joints[i] = B[0]
        directions[i] = _unit(B[1] - B[0], B[3] - B[0])
        for j in range(SAMPLES_A_SEGMENT):
            _cubic_at(B, j / SAMPLES_A_SEGMENT, samples[SAMPLES_A_SEGMENT * i + j])
    joints[count] = cubics[count - 1, 3]
    samples[SAMPLES_A_SEGMENT * count] = joints[count]
    directions[count] = _unit(
        cubics[count - 1, 3] - cubics[count - 1, 2], cubics[count - 1, 3] - cubics[count - 1, 0]
    )
    for j in range(1, len(samples)):
        lengths[j] = lengths[j - 1] + length_of(samples[j] - samples[j - 1])
    for i in range(count):
        turns[i + 1] = turns[i] + _angle(directions[i], directions[i + 1])
    return Path(joints, directions, samples, lengths, turns)


@kernel
def fit_arc(path: Path, direction: Floats, i: int, j: int, tolerance: float, B: Floats) -> bool:
    """Arc from joint i in a direction to joint j; whether it fits."""
    p, q = path.points[i], path.points[j]
    x, y = q[0] - p[0], q[1] - p[1]
    chord = np.hypot(x, y)
    half = np.arctan2(direction[0] * y - direction[1] * x, direction[0] * x + direction[1] * y)
    if abs(half) > 0.5 * LARGEST_SWEEP_RAD or chord >= 2.0 * LARGEST_RADIUS_MM * np.sin(abs(half)):
        return False
    if abs(path.turns[j] - path.turns[i] - 2.0 * half) > ARC_DIRECTION_RAD:
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
        if off > ARC_SHARE * tolerance:
            return False
    return True


@kernel
def arc_end(B: Floats) -> Floats:
    """Direction at the end of an arc: its chord turned by what its middle says."""
    chord = _unit(B[3] - B[0], B[3] - B[0])
    along = _unit(B[1] - B[0], chord)
    half = 2.0 * _angle(along, chord)
    c, s = np.cos(half), np.sin(half)
    return np.array([c * chord[0] - s * chord[1], s * chord[0] + c * chord[1]])


@kernel
def own_cubic(path: Path, direction: Floats, i: int, B: Floats) -> None:
    """Cubic over one segment of the path, from the direction in which the last one ended."""
    p, q = path.points[i], path.points[i + 1]
    chord = q - p
    set_cubic(B, p, q, _angle(direction, chord), _angle(chord, path.directions[i + 1]))


@kernel
def fit_cubic(path: Path, direction: Floats, i: int, j: int, tolerance: float, B: Floats) -> bool:
    """Cubic from joint i in a direction to joint j in its own, nearest to the samples; whether it fits."""
    if abs(path.turns[j] - path.turns[i]) > LARGEST_TURN_RAD:
        return False
    first, last = SAMPLES_A_SEGMENT * i, SAMPLES_A_SEGMENT * j
    length = path.lengths[last] - path.lengths[first]
    p, q = path.points[i], path.points[j]
    chord = np.hypot(q[0] - p[0], q[1] - p[1])
    if chord <= CLOSED_LOOP_SHARE * length:
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
    guess = 0.0
    for k in range(first + 1, last):
        guess = (path.lengths[k] - path.lengths[first]) / length
        if _distance(B, path.samples[k], guess) > tolerance:
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
            legs[:] = even
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
        d = 3.0 * (
            s * s * (B[1, axis] - B[0, axis])
            + 2.0 * s * t * (B[2, axis] - B[1, axis])
            + t * t * (B[3, axis] - B[2, axis])
        )
        dot += (at - point[axis]) * d
        square += d * d
    if square == 0.0:
        return t
    return float(min(max(t - dot / square, 0.0), 1.0))


@kernel
def _distance(B: Floats, point: Floats, guess: float) -> float:
    """Distance of a point from the cubic near a parameter: that of a point of it, so never too small."""
    t = _foot(B, point, _foot(B, point, guess))
    s = 1.0 - t
    square = 0.0
    for axis in range(2):
        at = s * s * s * B[0, axis] + 3.0 * s * t * (s * B[1, axis] + t * B[2, axis]) + t * t * t * B[3, axis]
        square += (at - point[axis]) ** 2
    return float(np.sqrt(square))


@kernel
def _cubic_at(B: Floats, t: float, point: Floats) -> None:
    s = 1.0 - t
    for axis in range(2):
        point[axis] = (
            s * s * s * B[0, axis] + 3.0 * s * t * (s * B[1, axis] + t * B[2, axis]) + t * t * t * B[3, axis]
        )


@kernel
def length_of(v: Floats) -> float:
    """Length of a vector (2,)."""
    return float(np.hypot(v[0], v[1]))


@kernel
def _unit(v: Floats, instead: Floats) -> Floats:
    """Unit vector along v, or along another where v has no length."""
    length = np.hypot(v[0], v[1])
    if length == 0.0:
        v, length = instead, max(np.hypot(instead[0], instead[1]), 1e-300)
    return np.asarray(v / length)


@kernel
def _angle(a: Floats, b: Floats) -> float:
    return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1]))
