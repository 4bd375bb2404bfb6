"""Corners at which closed contours start: by how much the path turns there, from the program's text."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.program.checking.process_checks import directions
from ebamcheck.program.reading.motions import NCProgram


def seam_turns(nc: NCProgram) -> tuple[Ints, Floats]:
    """Turn of the path at the seam of each closed contour.

    Returns
    -------
    row, turn_deg
        (n,) first motion of each contour that comes back to its start, and the angle (n,) from 0 to 180 degrees between the
        directions in which it arrives there and sets out.
    """
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0) & ~nc.overlap)
    track = nc.tracks(rows)
    count = int(track.max(initial=-1)) + 1
    first = rows[np.searchsorted(track, np.arange(count))]
    last = rows[np.searchsorted(track, np.arange(count), side="right") - 1]
    closed = (nc.end[last, :2] == nc.start[first, :2]).all(axis=1)
    first, last = first[closed], last[closed]
    turn = directions(nc, first, 0.0) - directions(nc, last, 1.0)
    return first, np.abs((turn + 180.0) % 360.0 - 180.0)
