"""Schedule of an island: where it can be entered and left, and how long it takes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.scan.filling.hatch import Vectors
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import TURN_SPACINGS


@dataclass(frozen=True, eq=False)
class IslandSchedule:
    """Columns of the islands of a layer. An island may be driven from either side, with turns at the other ends of its lines: both
    count by their mean."""

    # (I, 4, 2) points at which an island may be entered, and where it is then left, mm: the four entry options of
    # :func:`ebamcheck.scan.order.entries.in_sequence`; an option that is not open to an island repeats its first
    entry: Floats
    leave: Floats
    beam_s: Floats  # (I,) time with the beam on, lines and turns
    time_s: Floats  # (I,) the same with the jumps between its own lines

    def __len__(self) -> int:
        """Return the number of islands."""
        return len(self.time_s)


def island_schedule(lines: Vectors, chained: Bools, config: Config) -> IslandSchedule:
    """How islands are driven, by their lines, sorted by island, and whether (I,) these follow each other.

    An island without any line takes no time and lies where its neighbour in number ends.
    """
    count = len(chained)
    a, b = lines.start, lines.end
    if not len(a):
        places, times = np.zeros((count, 4, 2)), np.zeros(count)
        return IslandSchedule(places, places, times, times)
    first = np.concatenate([[0], np.cumsum(np.bincount(lines.island, minlength=count))])
    entry, leave = island_ends(a, b, first, chained)
    spacing = config.process.hatch_spacing_mm
    forwards = turns_and_jumps_mm(lines.island, a, b, spacing)
    backwards = turns_and_jumps_mm(lines.island, b, a, spacing)
    turn, jump = (
        np.where(chained[lines.island], one, 0.5 * (one + other))
        for one, other in zip(forwards, backwards, strict=True)
    )
    beam_s = np.bincount(lines.island, np.hypot(*(b - a).T) + turn, count) / config.process.travel_speed_mm_s
    inner_s = np.bincount(lines.island, jump, count) / config.machine.rapid_mm_s
    return IslandSchedule(entry, leave, beam_s, np.asarray(beam_s + inner_s, np.float64))


def island_ends(start: Floats, end: Floats, first: Ints, chained: Bools) -> tuple[Floats, Floats]:
    """Points at which islands are entered and left by each option, (I, 4, 2) both, by the first line (I + 1,) of each."""
    a, b = np.minimum(first[:-1], len(start) - 1), np.maximum(first[1:] - 1, 0)
    entry = np.stack([start[a], end[a], end[b], start[b]], axis=1)
    leave = np.stack([end[b], start[b], start[a], end[a]], axis=1)
    for option in (1, 3):
        entry[chained, option], leave[chained, option] = entry[chained, 0], leave[chained, 0]
    return entry, leave


# Cosine of the angle between a turn and a line beside it from which on the beam would melt its track again; parallel lines reach -cos(26 degrees)
SHARPEST_TURN = -math.cos(math.radians(20.0))
JOINED_MM = 1e-6  # a line that starts within this of the end of the last one goes on without a jump or a wire start


def gaps_mm(start: Floats, end: Floats) -> Floats:
    """Distance from the end of each line before to its start, (V,) mm; infinite for the first."""
    gaps = np.full(len(start), np.inf)
    if len(start) > 1:
        gaps[1:] = np.hypot(*(start[1:] - end[:-1]).T)
    return gaps


def follows(island: Ints, start: Floats, end: Floats, spacing_mm: float) -> Bools:
    """Which lines (V,), in the order in which they are driven, go on where the one before ended: the beam stays on.

    The turn is short, goes back on neither line, and over no line of its island; `spacing_mm` is the distance between parallel
    beads.

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
        known = np.minimum(length[beside], turn_mm) > 0.01  # a shorter one has no direction that counts
        along = np.einsum("ij,ij->i", way[beside], turn)
        back[1:] |= known & (along < SHARPEST_TURN * length[beside] * turn_mm)
    return back


def _over_lines(on: Bools, island: Ints, start: Floats, end: Floats, spacing_mm: float) -> Bools:
    """Whether the turn to a line (V,), among those that are `on`, leads over a line of its island.

    A turn longer than 0.6 spacings keeps its middle a quarter of one away from every line of its island: nearer it lays metal on metal.
    """
    over = np.zeros(len(on), np.bool_)
    turn = np.flatnonzero(on[1:]) + 1
    turn = turn[np.hypot(*(start[turn] - end[turn - 1]).T) > 0.6 * spacing_mm]
    if not len(turn):
        return over
    run = np.cumsum(np.diff(island, prepend=island[:1]) != 0)
    size = np.bincount(run)
    count = size[run[turn]]
    which, number = each_of(count)
    line = number + (np.cumsum(size) - size)[run[turn]][which]
    way, middle = (end - start)[line], 0.5 * (end[turn - 1] + start[turn])
    away = middle[which] - start[line]
    along = (away * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), np.finfo(float).tiny)
    aside = np.hypot(*(np.clip(along, 0.0, 1.0)[:, None] * way - away).T)
    over[turn] = np.minimum.reduceat(aside, np.cumsum(count) - count) < 0.25 * spacing_mm
    return over


def turns_and_jumps_mm(island: Ints, start: Floats, end: Floats, spacing_mm: float) -> tuple[Floats, Floats]:
    """Length driven with the beam on, and with it off, from the line before to each line of the same island, (V,) mm."""
    on = follows(island, start, end, spacing_mm)
    inside = np.zeros(len(start), np.bool_)
    inside[1:] = island[1:] == island[:-1]
    gaps = np.where(inside, gaps_mm(start, end), 0.0)
    gaps[gaps <= JOINED_MM] = 0.0
    return np.where(on, gaps, 0.0), np.where(on, 0.0, gaps)
