"""Changes of speed with limited acceleration and jerk, in closed form.

A ramp begins and ends without acceleration. Its jerk is that of the axes at once, so that a change of speed d
takes 2 sqrt(d / j), or d / a + a / j where it reaches the acceleration a (d >= a^2 / j); by its symmetry it
covers the mean of both speeds times that time.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.kernels import Bools, Floats, kernel

HALVINGS = 60
"""Bisections of a speed: beyond the precision of its bits."""


@kernel
def ramp_time(first: float, last: float, acceleration: float, jerk: float) -> float:
    """Time of a change of speed, s."""
    change = abs(last - first)
    if change * jerk < acceleration * acceleration:
        return float(2.0 * np.sqrt(change / jerk))
    return change / acceleration + acceleration / jerk if change > 0.0 else 0.0


@kernel
def fastest(
    first: float, last: float, falls: bool, length: float, most: float, acceleration: float, jerk: float
) -> float:
    """Greatest speed up to `most` within `length` mm after the speed `first`; and before the speed `last`, if it `falls` to it."""
    low, high, speed = max(first, last) if falls else first, most, most
    if low >= high:
        return low if falls else most
    for turn in range(HALVINGS + 1):
        way = 0.5 * (first + speed) * ramp_time(first, speed, acceleration, jerk)
        if falls:
            way += 0.5 * (speed + last) * ramp_time(speed, last, acceleration, jerk)
        if way <= length:
            if turn == 0:
                return most
            low = speed
        else:
            high = speed
        speed = 0.5 * (low + high)
    return low


@kernel
def time_to(first: float, last: float, speed: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """Time in which a ramp from `first` up to `last` reaches a speed, s, and the path until then, mm."""
    change, whole = last - first, ramp_time(first, last, acceleration, jerk)
    gained = min(max(speed - first, 0.0), change)
    if change <= 0.0:
        return 0.0, 0.0
    # The second half mirrors the first.
    late = gained > 0.5 * change
    rest = change - gained if late else gained
    bend = min(acceleration / jerk, 0.5 * whole)
    at_bend = 0.5 * jerk * bend**2
    if rest <= at_bend:
        time = float(np.sqrt(2.0 * rest / jerk))
        path = jerk * time**3 / 6.0
    else:
        straight = (rest - at_bend) / (jerk * bend)
        time = bend + straight
        path = jerk * bend**3 / 6.0 + at_bend * straight + 0.5 * jerk * bend * straight**2
    if late:
        return whole - time, 0.5 * (first + last) * whole - (last * time - path)
    return time, first * time + path


def speeds_along(
    at: Floats, first: float, top: float, last: float, length: float, acceleration: float, jerk: float
) -> Floats:
    """Speed (n,) at places (n,) mm along a stretch that rises to `top`, holds it, and falls."""
    result = np.full(at.size, top)
    for from_speed, place in ((last, length - at), (first, at)):
        speeds = np.linspace(from_speed, top, 257)
        paths = [time_to(from_speed, top, speed, acceleration, jerk)[1] for speed in speeds.tolist()]
        result = np.where(place < paths[-1], np.interp(place, paths, speeds), result)
    return result


# -- Look-ahead: speeds at the borders of cells from which every later one can be reached, and the peaks
# between.


@kernel
def look_ahead(
    length: Floats, most: Floats, acceleration: Floats, jerk: Floats, entry: Floats, first: Bools
) -> tuple[Floats, Floats, Floats, Floats]:
    """Entry, peak and exit speed of each cell, and its time, all (C,).

    The speeds are the greatest that keep every limit and ramp without acceleration at the borders of cells: a
    pass backwards lowers each to what can still be braked from, a pass forwards to what can be reached. As
    braking is reaching in reverse, a path driven backwards takes the same time.
    """
    count = length.size
    begin, end, top, time = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    for c in range(count):
        if not first[c]:
            begin[c] = min(entry[c], most[c], most[c - 1])
    for c in range(count - 1, -1, -1):
        after = 0.0 if c + 1 == count or first[c + 1] else begin[c + 1]
        highest = max(begin[c], after)
        begin[c] = min(begin[c], fastest(after, 0.0, False, length[c], highest, acceleration[c], jerk[c]))
    for c in range(1, count):
        if not first[c]:
            last, highest = begin[c - 1], max(begin[c], begin[c - 1])
            got = fastest(last, 0.0, False, length[c - 1], highest, acceleration[c - 1], jerk[c - 1])
            begin[c] = min(begin[c], got)
    for c in range(count):
        a, j = acceleration[c], jerk[c]
        end[c] = 0.0 if c + 1 == count or first[c + 1] else begin[c + 1]
        top[c] = fastest(begin[c], end[c], True, length[c], most[c], a, j)
        up, down = ramp_time(begin[c], top[c], a, j), ramp_time(top[c], end[c], a, j)
        time[c] = up + down
        if top[c] > 0.0:
            ramps = 0.5 * (begin[c] + top[c]) * up + 0.5 * (top[c] + end[c]) * down
            time[c] += max(length[c] - ramps, 0.0) / top[c]
    return begin, top, end, time
