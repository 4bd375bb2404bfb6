"""The ways from each island to each other one: how far the gun jumps, and by which way the island is entered."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.filling.schedule import IslandSchedule
from ebamcheck.scan.filling.turns import JOINED_MM


class EntryOptions(NamedTuple):
    """Jumps between islands.

    Parameters
    ----------
    jump_mm
        (I, 4, I) from an island that was entered by one of its ways to the nearest way into another one.
    way
        (I, 4, I) which one that is.
    """

    jump_mm: Floats
    way: Ints


def entry_options(schedule: IslandSchedule) -> EntryOptions:
    """Tabulate the jumps between all islands of a layer."""
    return EntryOptions(*tabulated(schedule.entry, schedule.leave))


@kernel
def nearest_way(entry: Floats, x: float, y: float) -> tuple[float, int]:
    """Distance to the nearest of the ways (4, 2) into an island, mm, and which it is: the first of equal ones."""
    nearest, way = np.inf, 0
    for v in range(len(entry)):
        distance = np.hypot(entry[v, 0] - x, entry[v, 1] - y)
        if distance < nearest - JOINED_MM:
            nearest, way = distance, v
    return nearest, way


@kernel
def tabulated(entry: Floats, leave: Floats) -> tuple[Floats, Ints]:
    """Return the columns of :class:`EntryOptions`."""
    count, ways = leave.shape[:2]
    jump = np.empty((count, ways, count))
    way = np.empty((count, ways, count), np.int64)
    for i in range(count):
        for left_by in range(ways):
            x, y = leave[i, left_by]
            for j in range(count):
                jump[i, left_by, j], way[i, left_by, j] = nearest_way(entry[j], x, y)
    return jump, way
