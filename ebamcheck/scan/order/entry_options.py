"""Entry options of islands: how far the gun jumps from each island to each other one, and by which option it enters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats
from ebamcheck.scan.filling.schedule import IslandSchedule
from ebamcheck.scan.filling.turns import JOINED_MM

Options = NDArray[np.int8]
"""Small, so that a table of them stays near the processor while moves are tried."""


class EntryOptions(NamedTuple):
    """Jumps between islands.

    Parameters
    ----------
    jump_mm
        (I, 4, I) from an island that was entered by one of its options to the nearest option of another one.
    option
        (I, 4, I) which one that is.
    """

    jump_mm: Floats
    option: Options


def entry_options(schedule: IslandSchedule) -> EntryOptions:
    """Tabulate the jumps between all islands of a layer."""
    return EntryOptions(*tabulated(schedule.entry, schedule.leave))


@kernel
def nearest_option(entry: Floats, x: float, y: float) -> tuple[float, int]:
    """Distance to the nearest of the entry options (4, 2) of an island, mm, and which it is: the first of equal ones."""
    nearest, option = np.inf, 0
    for v in range(len(entry)):
        away_x, away_y = entry[v, 0] - x, entry[v, 1] - y
        # No nearer by as much as counts, whatever its square has lost by rounding: the distance itself takes longer.
        if away_x * away_x + away_y * away_y >= nearest * nearest:
            continue
        distance = np.hypot(away_x, away_y)
        if distance < nearest - JOINED_MM:
            nearest, option = distance, v
    return nearest, option


@kernel
def tabulated(entry: Floats, leave: Floats) -> tuple[Floats, Options]:
    """Return the columns of :class:`EntryOptions`."""
    count, options = leave.shape[:2]
    jump = np.empty((count, options, count))
    option = np.empty((count, options, count), np.int8)
    for i in range(count):
        for left_by in range(options):
            x, y = leave[i, left_by]
            for j in range(count):
                jump[i, left_by, j], option[i, left_by, j] = nearest_option(entry[j], x, y)
    return jump, option
