"""Changes of speed with limited acceleration and jerk, in closed form.

A ramp begins and ends without acceleration. Its jerk is that of the axes at once, so that a change of speed d
takes 2 sqrt(d / j), or d / a + a / j where it reaches the acceleration a (d >= a^2 / j); by its symmetry it
covers the mean of both speeds times that time.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats

HALVINGS = 60
"""Bisections of a speed: beyond the precision of its bits."""


@kernel
def ramp_time(change: float, acceleration: float, jerk: float) -> float:
    """Time of a change of speed, s."""
    if change <= 0.0:
        return 0.0
    if change * jerk < acceleration * acceleration:
        return float(2.0 * np.sqrt(change / jerk))
    return change / acceleration + acceleration / jerk


@kernel
def ramp_length(first: float, last: float, acceleration: float, jerk: float) -> float:
    """Path of a change of speed between `first` and `last` mm/s, mm."""
    return 0.5 * (first + last) * ramp_time(abs(last - first), acceleration, jerk)


@kernel
def reach(first: float, length: float, most: float, acceleration: float, jerk: float) -> float:
    """Greatest speed up to `most` that can be had `length` mm after the speed `first`."""
    if first >= most or ramp_length(first, most, acceleration, jerk) <= length:
        return most
    low, high = first, most
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if ramp_length(first, middle, acceleration, jerk) <= length:
            low = middle
        else:
            high = middle
    return low


@kernel
def peak(first: float, last: float, length: float, most: float, acceleration: float, jerk: float) -> float:
    """Greatest speed up to `most` between `first` and `last` that stand `length` mm apart."""
    low, high = max(first, last), most
    if low >= high:
        return low
    up = ramp_length(first, high, acceleration, jerk)
    if up + ramp_length(high, last, acceleration, jerk) <= length:
        return high
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        up = ramp_length(first, middle, acceleration, jerk)
        if up + ramp_length(middle, last, acceleration, jerk) <= length:
            low = middle
        else:
            high = middle
    return low


@kernel
def ramp_at(first: float, last: float, time: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """Speed and path, mm/s and mm, `time` seconds after a ramp from `first` up to `last` has begun."""
    change = last - first
    whole = ramp_time(change, acceleration, jerk)
    if time <= 0.0:
        return first, 0.0
    if time >= whole:
        return last, 0.5 * (first + last) * whole
    bend = min(acceleration / jerk, 0.5 * whole)
    if time > 0.5 * whole:
        # The second half mirrors the first.
        left = whole - time
        gained, path = _from_the_end(left, bend, jerk)
        return last - gained, 0.5 * (first + last) * whole - (last * left - path)
    gained, path = _from_the_end(time, bend, jerk)
    return first + gained, first * time + path


@kernel
def _from_the_end(time: float, bend: float, jerk: float) -> tuple[float, float]:
    """Speed gained and its path, `time` after an end of a ramp whose jerk lasts for `bend` seconds."""
    if time <= bend:
        return 0.5 * jerk * time**2, jerk * time**3 / 6.0
    straight = time - bend
    gained = 0.5 * jerk * bend**2
    path = jerk * bend**3 / 6.0 + gained * straight + 0.5 * jerk * bend * straight**2
    return gained + jerk * bend * straight, path


@kernel
def time_to(first: float, last: float, speed: float, acceleration: float, jerk: float) -> float:
    """Time at which a ramp from `first` up to `last` reaches `speed`, s."""
    change = last - first
    whole = ramp_time(change, acceleration, jerk)
    gained = min(max(speed - first, 0.0), change)
    if gained > 0.5 * change:
        return whole - _time_from_the_end(change - gained, min(acceleration / jerk, 0.5 * whole), jerk)
    return _time_from_the_end(gained, min(acceleration / jerk, 0.5 * whole), jerk)


@kernel
def _time_from_the_end(gained: float, bend: float, jerk: float) -> float:
    at_bend = 0.5 * jerk * bend**2
    if gained <= at_bend:
        return float(np.sqrt(2.0 * gained / jerk))
    return bend + (gained - at_bend) / (jerk * bend)


@kernel
def speeds_along(
    at: Floats, first: float, top: float, last: float, length: float, acceleration: float, jerk: float
) -> Floats:
    """Speed (n,) at places (n,) mm along a stretch that rises to `top`, holds it, and falls."""
    result = np.full(at.size, top)
    up = ramp_length(first, top, acceleration, jerk)
    down = ramp_length(top, last, acceleration, jerk)
    for i in range(at.size):
        if at[i] < up:
            result[i] = _speed_on_ramp(first, top, at[i], acceleration, jerk)
        elif length - at[i] < down:
            result[i] = _speed_on_ramp(last, top, length - at[i], acceleration, jerk)
    return result


@kernel
def _speed_on_ramp(first: float, last: float, path: float, acceleration: float, jerk: float) -> float:
    low, high = 0.0, ramp_time(last - first, acceleration, jerk)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if ramp_at(first, last, middle, acceleration, jerk)[1] < path:
            low = middle
        else:
            high = middle
    return ramp_at(first, last, 0.5 * (low + high), acceleration, jerk)[0]


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
    begin = np.zeros(count)
    end = np.zeros(count)
    for c in range(count):
        if not first[c]:
            begin[c] = min(entry[c], most[c], most[c - 1])
    for c in range(count - 1, -1, -1):
        after = 0.0 if c + 1 == count or first[c + 1] else begin[c + 1]
        begin[c] = min(begin[c], reach(after, length[c], max(begin[c], after), acceleration[c], jerk[c]))
    for c in range(1, count):
        if not first[c]:
            got = reach(
                begin[c - 1], length[c - 1], max(begin[c], begin[c - 1]), acceleration[c - 1], jerk[c - 1]
            )
            begin[c] = min(begin[c], got)
    top = np.zeros(count)
    time = np.zeros(count)
    for c in range(count):
        end[c] = 0.0 if c + 1 == count or first[c + 1] else begin[c + 1]
        top[c] = peak(begin[c], end[c], length[c], most[c], acceleration[c], jerk[c])
        time[c] = ramp_time(top[c] - begin[c], acceleration[c], jerk[c])
        time[c] += ramp_time(top[c] - end[c], acceleration[c], jerk[c])
        ramps = ramp_length(begin[c], top[c], acceleration[c], jerk[c])
        ramps += ramp_length(top[c], end[c], acceleration[c], jerk[c])
        if top[c] > 0.0:
            time[c] += max(length[c] - ramps, 0.0) / top[c]
    return begin, top, end, time
