"""Schedule of an island: where it can be entered and left, and how long it takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.filling.hatch import Vectors
from ebamcheck.scan.filling.turns import turns_and_jumps_mm
from ebamcheck.settings.config import Config


@dataclass(frozen=True, eq=False)
class IslandSchedule:
    """Columns of the islands of a layer.

    Parameters
    ----------
    entry, leave
        (I, 4, 2) points at which an island may be entered, and where it is then left, mm: the four entry options of
        :func:`ebamcheck.scan.order.entries.in_sequence`; an option that is not open to an island repeats its first.
    beam_s, time_s
        (I,) time with the beam on, lines and turns, and with the jumps between its own lines. An island may be driven
        from either side, with turns at the other ends of its lines: both count by their mean.
    """

    entry: Floats
    leave: Floats
    beam_s: Floats
    time_s: Floats

    def __len__(self) -> int:
        """Return the number of islands."""
        return len(self.time_s)


def island_schedule(lines: Vectors, chained: Bools, config: Config) -> IslandSchedule:
    """Work out how islands are driven.

    Parameters
    ----------
    lines
        Lines sorted by island; an island without any takes no time and lies where its neighbour in number ends.
    chained
        (I,) whether the lines of an island follow each other.
    """
    count = len(chained)
    a, b = lines.start, lines.end
    if not len(a):
        return IslandSchedule(
            np.zeros((count, 4, 2)), np.zeros((count, 4, 2)), np.zeros(count), np.zeros(count)
        )
    first = np.concatenate([[0], np.cumsum(np.bincount(lines.island, minlength=count))])
    entry, leave = island_ends(a, b, first, chained)
    spacing = config.process.hatch_spacing_mm
    turn, jump = turns_and_jumps_mm(lines.island, a, b, spacing)
    other_turn, other_jump = turns_and_jumps_mm(lines.island, b, a, spacing)
    turned = chained[lines.island]
    turn = np.where(turned, turn, 0.5 * (turn + other_turn))
    jump = np.where(turned, jump, 0.5 * (jump + other_jump))
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
