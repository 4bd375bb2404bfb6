"""Look-ahead: speeds at the borders of cells from which every later one can be reached, and the peaks between."""

from __future__ import annotations

import numpy as np

from ebamcheck.kinematics.ramps import peak, ramp_length, ramp_time, reach
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats


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
