"""Islands that touch: a border just laid is the hottest place of a layer, and no island is begun on it without need."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Ints


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
