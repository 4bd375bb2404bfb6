"""Circular arcs given by three points: start, the point half-way along, and end."""

from __future__ import annotations

import math
from typing import NamedTuple

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

LARGEST_SPAN_RAD = math.radians(5.0)
"""Largest sweep of one cubic span of an arc: the span leaves the circle by less than 1e-11 of the radius."""


class Arc(NamedTuple):
    """Circle and sweep of an arc."""

    x: float
    """Centre, mm."""
    y: float
    radius: float
    """mm."""
    start: float
    """Direction from the centre to the start, rad."""
    sweep: float
    """Signed angle from start to end, rad; positive counter-clockwise, under a full turn."""


@kernel
def arc_through(C: Floats) -> Arc:
    """Arc through start, middle and end (3, 2); its middle need not lie half-way. Radius infinite where it is straight."""
    ax, ay = C[0, 0] - C[1, 0], C[0, 1] - C[1, 1]
    bx, by = C[2, 0] - C[1, 0], C[2, 1] - C[1, 1]
    twice = 2.0 * (ax * by - ay * bx)
    if twice == 0.0:
        return Arc(math.inf, math.inf, math.inf, 0.0, 0.0)
    a2, b2 = ax * ax + ay * ay, bx * bx + by * by
    ux, uy = (by * a2 - ay * b2) / twice, (ax * b2 - bx * a2) / twice
    x, y = C[1, 0] + ux, C[1, 1] + uy
    start = math.atan2(C[0, 1] - y, C[0, 0] - x)
    end = math.atan2(C[2, 1] - y, C[2, 0] - x)
    sweep = end - start
    if twice < 0.0:  # the middle lies to the right of the chord: counter-clockwise
        sweep += 2.0 * math.pi if sweep <= 0.0 else 0.0
    else:
        sweep -= 2.0 * math.pi if sweep >= 0.0 else 0.0
    return Arc(x, y, math.hypot(ux, uy), start, sweep)


@kernel
def arc_point(arc: Arc, share: float) -> tuple[float, float]:
    """Point at a share 0 .. 1 of the sweep."""
    angle = arc.start + share * arc.sweep
    return arc.x + arc.radius * math.cos(angle), arc.y + arc.radius * math.sin(angle)


@kernel
def arc_span_count(C: Floats) -> int:
    """Cubic spans that stand for an arc."""
    return max(1, math.ceil(abs(arc_through(C).sweep) / LARGEST_SPAN_RAD - 1e-9))


@kernel
def arc_spans(C: Floats, B: Floats, h: Floats) -> None:
    """Write the Bezier points (n, 4, 2) and lengths (n,) of the spans of an arc; the ends are those given, bit for bit."""
    arc = arc_through(C)
    n = len(B)
    if math.isinf(arc.radius):
        for i in range(n):
            for k in range(4):
                B[i, k] = C[0] + (C[2] - C[0]) * ((i + k / 3.0) / n)
            h[i] = math.hypot(C[2, 0] - C[0, 0], C[2, 1] - C[0, 1]) / n
        B[n - 1, 3] = C[2]
        return
    step = arc.sweep / n
    leg = 4.0 / 3.0 * math.tan(0.25 * step) * arc.radius
    for i in range(n):
        a, b = arc.start + i * step, arc.start + (i + 1) * step
        px, py = arc_point(arc, i / n)
        qx, qy = arc_point(arc, (i + 1) / n)
        B[i, 0, 0], B[i, 0, 1] = px, py
        B[i, 1, 0], B[i, 1, 1] = px - leg * math.sin(a), py + leg * math.cos(a)
        B[i, 2, 0], B[i, 2, 1] = qx + leg * math.sin(b), qy - leg * math.cos(b)
        B[i, 3, 0], B[i, 3, 1] = qx, qy
        h[i] = abs(step) * arc.radius
    B[0, 0] = C[0]
    B[n - 1, 3] = C[2]
    for i in range(1, n):
        B[i, 0] = B[i - 1, 3]
