"""Circular arcs as posts write them: centre and sense from start, middle and end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ebamcheck.numeric.rings import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class Circles:
    """Circles of arcs, as columns."""

    centre: Floats  # (n, 2) mm; of no use where the arc is straight
    counter_clockwise: Bools  # (n,) sense of travel
    sagitta_mm: Floats  # (n,) height of the arc over its chord
    sweep_rad: Floats  # (n,) angle travelled, positive


def circles(start: Floats, middle: Floats, end: Floats) -> Circles:
    """Circle of each arc (n,) by its start, the point half-way along it, and its end, each (n, 2) mm.

    The centre is taken on the perpendicular bisector of start and end, so that both radii are equal even
    where start and end were rounded and the middle was not.
    """
    chord = end - start
    half = 0.5 * np.hypot(chord[:, 0], chord[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = np.column_stack([-chord[:, 1], chord[:, 0]]) / (2.0 * half)[:, None]
        height = ((middle - 0.5 * (start + end)) * normal).sum(axis=1)
        centre = 0.5 * (start + end) + normal * ((height**2 - half**2) / (2.0 * height))[:, None]
    sweep = 4.0 * np.arctan2(np.abs(height), half)
    return Circles(centre, height < 0.0, np.abs(height), sweep)


def arc_chords(start: Floats, middle: Floats, end: Floats, tolerance_mm: float) -> tuple[Ints, Floats]:
    """Points along arcs whose chords keep to `tolerance_mm`; the first point of an arc is not given.

    The chord of a sweep s leaves a circle of radius r by ``r (1 - cos(s / 2))``. Returns the first point of each arc, (n + 1,), and the
    points (N, 2), mm.
    """
    found = circles(start, middle, end)
    spoke = start - found.centre
    radius = np.hypot(spoke[:, 0], spoke[:, 1])
    straight = ~(found.sagitta_mm > tolerance_mm)
    with np.errstate(divide="ignore", invalid="ignore"):
        step = 2.0 * np.arccos(np.clip(1.0 - tolerance_mm / radius, 0.0, 1.0))
        parts = np.where(straight, 1.0, np.ceil(found.sweep_rad / step)).astype(np.int64)
    starts = np.concatenate([[0], np.cumsum(parts)]).astype(np.int64)
    arc = np.repeat(np.arange(parts.size), parts)
    share = (np.arange(starts[-1]) - starts[:-1][arc] + 1) / parts[arc]
    turn = share * np.where(found.counter_clockwise, found.sweep_rad, -found.sweep_rad)[arc]
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = spoke[arc, 0], spoke[arc, 1]
    points = found.centre[arc] + np.column_stack([cos * x - sin * y, sin * x + cos * y])
    points[starts[1:] - 1] = end
    return starts, points
