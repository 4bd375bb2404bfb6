"""Where the feed falls under the one programmed: the wire runs on, and the bead grows (paper, Figure 6)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ebamcheck.kinematics.ramps import ramp_at, ramp_length, ramp_time, time_to
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints

START, DIP, END = range(3)
"""Sorts of slow stretches: from the start of a run, within it, and to its end. A run that is slow throughout is
counted as a dip: its start and end alone do not explain it."""


@kernel
def slow_stretches(cells: Floats, slow: Floats, first: Bools) -> tuple[Ints, Ints, Floats, Floats, Floats]:
    """Stretches of each run along which the speed is under a threshold.

    Parameters
    ----------
    cells
        (C, 6) length, entry, peak and exit speed, acceleration, jerk of each cell.
    slow
        (C,) threshold of each cell, mm/s.
    first
        (C,) true where a run begins.

    Returns
    -------
    sort, cell, time, length, least
        (D,) each: :data:`START`, :data:`DIP` or :data:`END`, cell of the least speed, s, mm, mm/s.
    """
    count = len(cells)
    sort, where = np.zeros(2 * count + 1, np.int64), np.zeros(2 * count + 1, np.int64)
    time, length, least = np.zeros(2 * count + 1), np.zeros(2 * count + 1), np.zeros(2 * count + 1)
    found, under = 0, False
    for c in range(count):
        if first[c]:
            under = False
        last = c + 1 == count or first[c + 1]
        begin, top, end, a, j = cells[c, 1], cells[c, 2], cells[c, 3], cells[c, 4], cells[c, 5]
        whole = top < slow[c]
        if begin < slow[c] or whole:
            if whole:
                took, path = _whole(cells[c])
            else:
                took = time_to(begin, top, slow[c], a, j)
                path = ramp_at(begin, top, took, a, j)[1]
            if not under:
                sort[found], where[found], least[found] = (START if first[c] else DIP), c, begin
                time[found], length[found] = 0.0, 0.0
                found += 1
            time[found - 1] += took
            length[found - 1] += path
            if begin < least[found - 1]:
                least[found - 1], where[found - 1] = begin, c
            under = whole
        else:
            under = False
        if whole:
            if end < least[found - 1]:
                least[found - 1], where[found - 1] = end, c
            if last:
                sort[found - 1] = DIP if sort[found - 1] == START else END
        elif end < slow[c]:
            took = time_to(end, top, slow[c], a, j)
            sort[found], where[found], least[found] = (END if last else DIP), c, end
            time[found], length[found] = took, ramp_at(end, top, took, a, j)[1]
            found += 1
            under = True
    return sort[:found], where[:found], time[:found], length[:found], least[:found]


@kernel
def _whole(cell: Floats) -> tuple[float, float]:
    """Time and length of a cell."""
    length, begin, top, end, a, j = cell
    ramps = ramp_length(begin, top, a, j) + ramp_length(top, end, a, j)
    took = ramp_time(top - begin, a, j) + ramp_time(top - end, a, j)
    return took + (max(length - ramps, 0.0) / top if top > 0.0 else 0.0), length


def dip_table(
    stretches: tuple[Ints, Ints, Floats, Floats, Floats], feed_mm_s: Floats, bead_mm2: float
) -> pd.DataFrame:
    """Slow stretches as a table; `feed_mm_s` (C,) is that of each cell, `bead_mm2` the bead's section at it.

    The wire runs at its own speed v_set A / A_wire, so that a stretch of length l that takes the time t gets
    A (v_set t - l) of metal too much, and at the speed v the bead has v_set / v of its section.
    """
    sort, cell, time, length, least = stretches
    feed = feed_mm_s[cell]
    with np.errstate(divide="ignore"):
        growth = feed / least
    return pd.DataFrame(
        {
            "sort": np.array(["start", "dip", "end"])[sort],
            "cell": cell,
            "time_s": time,
            "length_mm": length,
            "least_mm_s": least,
            "feed_mm_s": feed,
            "excess_mm3": np.maximum(bead_mm2 * (feed * time - length), 0.0),
            "metal_per_mm": growth,
        }
    )
