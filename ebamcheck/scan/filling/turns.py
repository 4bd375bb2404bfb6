"""Turns: lines of one island that follow each other closely are one bead, beam and wire on all the way.

The plan times and heats them by this rule, and the program writes them by it: there is no other one.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.order.path import JOINED_MM

TURN_SPACINGS = 1.5
"""Lines of one island whose ends are at most this many bead spacings apart are joined with the beam on: the turn is
part of the melt pool. 1.5, because a border at 60 degrees makes the turn 1.15 spacings long."""


def gaps_mm(start: Floats, end: Floats) -> Floats:
    """Distance from the end of each line before to its start, (V,) mm; infinite for the first."""
    gaps = np.full(len(start), np.inf)
    if len(start) > 1:
        gaps[1:] = np.hypot(*(start[1:] - end[:-1]).T)
    return gaps


def follows(island: Ints, start: Floats, end: Floats, spacing_mm: float) -> Bools:
    """Which lines go on where the one before ended, by a turn or without one.

    Parameters
    ----------
    island
        (V,) island of each line, in the order in which they are driven.
    start, end
        (V, 2) mm.
    spacing_mm
        Distance between parallel beads.

    Returns
    -------
    array
        (V,) true where the beam stays on.

    Examples
    --------
    >>> ends = np.array([[0.0, 0.0], [9.0, 4.0], [0.0, 20.0]]), np.array([[9.0, 0.0], [0.0, 4.0], [9.0, 20.0]])
    >>> follows(np.zeros(3, np.int64), *ends, 4.32).tolist()
    [False, True, False]
    """
    same = np.zeros(len(start), np.bool_)
    same[1:] = island[1:] == island[:-1]
    return np.asarray(same & (gaps_mm(start, end) <= TURN_SPACINGS * spacing_mm), np.bool_)


def turns_and_jumps_mm(island: Ints, start: Floats, end: Floats, spacing_mm: float) -> tuple[Floats, Floats]:
    """Length driven with the beam on, and with it off, from the line before to each line of the same island, (V,) mm."""
    on = follows(island, start, end, spacing_mm)
    inside = np.zeros(len(start), np.bool_)
    inside[1:] = island[1:] == island[:-1]
    gaps = np.where(inside, gaps_mm(start, end), 0.0)
    gaps[gaps <= JOINED_MM] = 0.0
    return np.where(on, gaps, 0.0), np.where(on, 0.0, gaps)
