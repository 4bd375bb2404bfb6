"""Turns: lines of one island that follow each other closely are one bead, beam and wire on all the way.

The plan times and heats them by this rule, and the program writes them by it: there is no other one.
"""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.process_window import TURN_SPACINGS

SHARPEST_TURN = -math.cos(math.radians(20.0))
"""Cosine of the angle between a turn and a line beside it from which on the turn goes back on that line: the beam would melt its
track again. Turns between parallel lines reach no more than -cos(26 degrees), those along a border at 60 degrees among them."""

BESIDE_SPACINGS, SHORT_SPACINGS = 0.25, 0.6
"""The middle of a turn is at least this many spacings away from every line of its island, if the turn is longer than the second of
them: nearer it would lay metal on metal. Between parallel lines, two thirds of a spacing apart, it is a third of one away."""

SHORTEST_MM = 0.01
"""A line or turn that is shorter has no direction that counts."""

TINY = 1e-300
"""Least divisor."""


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
        (V,) true where the beam stays on: the turn is short, goes back on neither line, and over no line of its island.

    Examples
    --------
    >>> ends = np.array([[0.0, 0.0], [9.0, 4.0], [0.0, 20.0]]), np.array([[9.0, 0.0], [0.0, 4.0], [9.0, 20.0]])
    >>> follows(np.zeros(3, np.int64), *ends, 4.32).tolist()
    [False, True, False]
    >>> hairpin = np.array([[0.0, 0.0], [13.0, 0.1]]), np.array([[10.0, 0.0], [5.0, 0.5]])
    >>> follows(np.zeros(2, np.int64), *hairpin, 4.32).tolist()
    [False, False]
    """
    same = np.zeros(len(start), np.bool_)
    same[1:] = island[1:] == island[:-1]
    near = gaps_mm(start, end) <= TURN_SPACINGS * spacing_mm
    on = np.asarray(same & near & ~_turns_back(start, end), np.bool_)
    return on & ~_over_lines(on, island, start, end, spacing_mm)


def _turns_back(start: Floats, end: Floats) -> Bools:
    """Whether the turn to each line (V,) goes back on the line before, or that line on the turn."""
    back = np.zeros(len(start), np.bool_)
    way, turn = end - start, start[1:] - end[:-1]
    length, turn_mm = np.hypot(*way.T), np.hypot(*turn.T)
    for beside in (slice(None, -1), slice(1, None)):
        known = np.minimum(length[beside], turn_mm) > SHORTEST_MM
        along = np.einsum("ij,ij->i", way[beside], turn)
        back[1:] |= known & (along < SHARPEST_TURN * length[beside] * turn_mm)
    return back


def _over_lines(on: Bools, island: Ints, start: Floats, end: Floats, spacing_mm: float) -> Bools:
    """Whether the turn to a line (V,), among those that are `on`, leads over a line of its island."""
    over = np.zeros(len(on), np.bool_)
    turn = np.flatnonzero(on[1:]) + 1
    turn = turn[np.hypot(*(start[turn] - end[turn - 1]).T) > SHORT_SPACINGS * spacing_mm]
    if not len(turn):
        return over
    run = np.cumsum(np.diff(island, prepend=island[:1]) != 0)
    size = np.bincount(run)
    count = size[run[turn]]
    first = np.cumsum(count) - count
    line = np.arange(count.sum()) - np.repeat(first - (np.cumsum(size) - size)[run[turn]], count)
    way, away = (
        (end - start)[line],
        np.repeat(0.5 * (end[turn - 1] + start[turn]), count, axis=0) - start[line],
    )
    along = (away * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), TINY)
    aside = np.hypot(*(np.clip(along, 0.0, 1.0)[:, None] * way - away).T)
    over[turn] = np.minimum.reduceat(aside, first) < BESIDE_SPACINGS * spacing_mm
    return over


def turns_and_jumps_mm(island: Ints, start: Floats, end: Floats, spacing_mm: float) -> tuple[Floats, Floats]:
    """Length driven with the beam on, and with it off, from the line before to each line of the same island, (V,) mm."""
    on = follows(island, start, end, spacing_mm)
    inside = np.zeros(len(start), np.bool_)
    inside[1:] = island[1:] == island[:-1]
    gaps = np.where(inside, gaps_mm(start, end), 0.0)
    gaps[gaps <= JOINED_MM] = 0.0
    return np.where(on, gaps, 0.0), np.where(on, 0.0, gaps)


JOINED_MM = 1e-6
"""A line that starts within this of the end of the last one goes on without a jump or a wire start."""
