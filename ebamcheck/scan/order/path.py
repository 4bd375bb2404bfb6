"""The way from island to island: where each is entered, and how far the gun jumps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.filling.turns import JOINED_MM

NEAREST = -1
"""Entry option of an island that is entered from its corner nearest to where the last one ended."""


@kernel
def in_sequence(
    start: Floats, end: Floats, first: Ints, order: Ints, chained: Bools, options: Ints
) -> tuple[Ints, Bools]:
    """Put the lines of islands in sequence, each island entered by its option, or by the one nearest to where the last ended.

    An island's lines may be driven in either sequence and either direction; those of a `chained` one
    (bent lines along a wall) only forwards, or all backwards.

    Parameters
    ----------
    start, end
        (V, 2) lines, sorted by island.
    first
        (I + 1,) first line of each island.
    order
        (I,) islands in scan order.
    chained
        (I,) whether the lines of an island follow each other end to start.
    options
        (I,) entry option of each island, as in :class:`~ebamcheck.scan.filling.schedule.IslandSchedule`;
        :data:`NEAREST`: the nearest.

    Returns
    -------
    rows
        (V,) lines in scan order.
    turned
        (V,) whether each is driven from its end to its start.
    """
    rows = np.empty(len(start), np.int64)
    turned = np.empty(len(start), np.bool_)
    used = 0
    x, y, known = 0.0, 0.0, False
    for island in order:
        a, b = first[island], first[island + 1]
        if a == b:
            continue
        backwards, flip = False, False
        nearest = np.inf
        for variant in range(4):
            back, turn = variant >= 2, variant == 1 or variant == 2
            if options[island] >= 0:
                if variant == options[island]:
                    backwards, flip = back, turn
                continue
            if not known or (chained[island] and back != turn):
                continue
            row = b - 1 if back else a
            px = end[row, 0] if turn else start[row, 0]
            py = end[row, 1] if turn else start[row, 1]
            distance = np.hypot(px - x, py - y)
            if distance < nearest - JOINED_MM:
                nearest, backwards, flip = distance, back, turn
        for n in range(b - a):
            row = b - 1 - n if backwards else a + n
            rows[used], turned[used] = row, flip
            used += 1
        row = a if backwards else b - 1
        x, y = (start[row, 0], start[row, 1]) if flip else (end[row, 0], end[row, 1])
        known = True
    return rows, turned


def jumps_mm(start: Floats, end: Floats, new_layer: Bools) -> Floats:
    """Jump before each line (V,), mm: 0 for the first of a layer and for lines that go on."""
    jumps = np.zeros(len(start))
    if len(start) > 1:
        jumps[1:] = np.hypot(*(start[1:] - end[:-1]).T)
    jumps[new_layer | (jumps <= JOINED_MM)] = 0.0
    return jumps


# -- Islands that touch: a border just laid is the hottest place of a layer, and no island is begun on it
# without need.


class Touching(NamedTuple):
    """Islands with a common border, from the view of each: first entry (I + 1,), and the other islands (2 P,)."""

    first: Ints
    other: Ints


def touching(neighbours: Ints, count: int) -> Touching:
    """Sort pairs (P, 2) of neighbours by island."""
    one, other = np.concatenate([neighbours, neighbours[:, ::-1]]).astype(np.int64).T
    first = np.concatenate([[0], np.cumsum(np.bincount(one, minlength=count))])
    return Touching(first.astype(np.int64), other[np.lexsort((other, one))])


@kernel
def touch(beside: Touching, one: int, other: int) -> bool:
    """Whether two islands have a common border."""
    for m in range(beside.first[one], beside.first[one + 1]):  # noqa: SIM110 - no generator in a kernel
        if beside.other[m] == other:
            return True
    return False


@kernel
def touch_table(beside: Touching) -> Bools:
    """Whether each two islands (I, I) have a common border."""
    count = len(beside.first) - 1
    table = np.zeros((count, count), np.bool_)
    for one in range(count):
        for m in range(beside.first[one], beside.first[one + 1]):
            table[one, beside.other[m]] = True
    return table


@kernel
def touching_successors(beside: Touching, order: Ints) -> Bools:
    """Whether each island (I,) of an order, by place, touches the one before it while another one was left that does not."""
    count = len(order)
    place = np.empty(count, np.int64)
    for n in range(count):
        place[order[n]] = n
    found = np.zeros(count, np.bool_)
    for n in range(1, count):
        last = order[n - 1]
        if touch(beside, last, order[n]):
            later = 0
            for m in range(beside.first[last], beside.first[last + 1]):
                later += place[beside.other[m]] >= n
            found[n] = later < count - n
    return found
