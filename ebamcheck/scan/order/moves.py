"""Moves of islands in an order, and what they do to its travel and to islands that touch, without simulating it anew.

A move leaves most of an order as it is: a few runs of islands follow each other as before, forward or turned around.
Within a run that goes forward nothing changes once an island of it is entered by the same option as before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.order.entry_options import Options

EXCHANGE, SHIFT, TURN = 0, 1, 2
"""Kinds of moves: two places exchange their islands, one goes to the other, or all between them are turned around."""

ROUNDING = 1e-9
"""Share of the travel by which a sum over runs may miss the sum over all jumps: far more than rounding does."""


class _Reached(NamedTuple):
    """Where the gun is: the island that was scanned last (-1: none), the option by which it was entered, and the travel."""

    island: int
    option: int | np.int64
    travel_mm: float


@kernel
def move(order: Ints, a: int, b: int, kind: int, result: Ints) -> None:
    """Exchange two places, move one to the other, or turn around all between them."""
    result[:] = order
    if kind == EXCHANGE:
        result[a], result[b] = order[b], order[a]
    elif kind == SHIFT:
        step = 1 if b > a else -1
        for place in range(a, b, step):
            result[place] = order[place + step]
        result[b] = order[a]
    else:
        low, high = min(a, b), max(a, b)
        for n in range(high - low + 1):
            result[low + n] = order[high - n]


@kernel
def more_touches(order: Ints, a: int, b: int, kind: int, beside: Bools) -> int:
    """How many more islands touch the one before them once an order is moved; `beside` (I, I) tells which touch."""
    low, high = min(a, b), max(a, b)
    before, first, last, after = low - 1, low, high, high + 1
    if kind == TURN or (kind == EXCHANGE and high == low + 1):
        gained = _touch(order, before, last, beside) + _touch(order, first, after, beside)
        return gained - _touch(order, before, first, beside) - _touch(order, last, after, beside)
    lost = _touch(order, before, first, beside) + _touch(order, last, after, beside)
    if kind == SHIFT and a < b:
        lost += _touch(order, first, first + 1, beside)
        gained = _touch(order, before, first + 1, beside) + _touch(order, last, first, beside)
        return gained + _touch(order, first, after, beside) - lost
    lost += _touch(order, last - 1, last, beside)
    if kind == SHIFT:
        gained = _touch(order, before, last, beside) + _touch(order, last, first, beside)
        return gained + _touch(order, last - 1, after, beside) - lost
    lost += _touch(order, first, first + 1, beside)
    gained = _touch(order, before, last, beside) + _touch(order, last, first + 1, beside)
    return gained + _touch(order, last - 1, first, beside) + _touch(order, first, after, beside) - lost


@kernel
def _touch(order: Ints, one: int, other: int, beside: Bools) -> int:
    """Whether the islands at two places touch, as a number; none does beyond the ends."""
    if one < 0 or other >= len(order):
        return 0
    return int(beside[order[one], order[other]])


@kernel
def least_travel_mm(
    order: Ints, by: Ints, travel_mm: Floats, a: int, b: int, kind: int, jump_mm: Floats, option: Options
) -> float:
    """Travel of an order once it is moved, less what rounding may have added: the sum over all jumps is no less.

    Parameters
    ----------
    order, by, travel_mm
        An order, and by place (I,) the option by which each island is entered and the travel so far.
    jump_mm, option
        Columns of :class:`~ebamcheck.scan.order.entry_options.EntryOptions`. All come one by one: taking columns out of
        tuples, each counted as one more in use, would take longer than the moves themselves.
    """
    low, high, stop = min(a, b), max(a, b), len(order)
    at = _Reached(-1, 0, 0.0)
    if low > 0:
        at = _Reached(order[low - 1], by[low - 1], travel_mm[low - 1])
    if kind == EXCHANGE:
        at = _forward(at, high, high + 1, order, by, travel_mm, jump_mm, option)
        at = _forward(at, low + 1, high, order, by, travel_mm, jump_mm, option)
        at = _forward(at, low, low + 1, order, by, travel_mm, jump_mm, option)
    elif kind == SHIFT and a < b:
        at = _forward(at, low + 1, high + 1, order, by, travel_mm, jump_mm, option)
        at = _forward(at, low, low + 1, order, by, travel_mm, jump_mm, option)
    elif kind == SHIFT:
        at = _forward(at, high, high + 1, order, by, travel_mm, jump_mm, option)
        at = _forward(at, low, high, order, by, travel_mm, jump_mm, option)
    else:
        for place in range(high, low - 1, -1):
            at = _jumped(at, order[place], jump_mm, option)
    at = _forward(at, high + 1, stop, order, by, travel_mm, jump_mm, option)
    return float(at.travel_mm - ROUNDING * (at.travel_mm + travel_mm[stop - 1]))


@kernel
def _jumped(at: _Reached, island: int, jump_mm: Floats, option: Options) -> _Reached:
    """Jump to an island; the first of an order is entered by its first option, and costs nothing."""
    if at.island < 0:
        return _Reached(island, 0, 0.0)
    by = np.int64(option[at.island, at.option, island])
    return _Reached(island, by, at.travel_mm + jump_mm[at.island, at.option, island])


@kernel
def _forward(
    at: _Reached,
    start: int,
    stop: int,
    order: Ints,
    by: Ints,
    travel_mm: Floats,
    jump_mm: Floats,
    option: Options,
) -> _Reached:
    """Go through the places of a run; from where an island is entered as before, all the rest is as before."""
    for place in range(start, stop):
        at = _jumped(at, order[place], jump_mm, option)
        if at.option == by[place]:
            rest_mm = travel_mm[stop - 1] - travel_mm[place]
            return _Reached(order[stop - 1], by[stop - 1], at.travel_mm + rest_mm)
    return at
