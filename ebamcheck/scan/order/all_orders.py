"""All orders of a few islands, one after the other: what a search can only approach is known on small layers."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Ints
from ebamcheck.scan.filling.turns import JOINED_MM
from ebamcheck.scan.order.annealing import Layer, new_log, powers_from, timed_from
from ebamcheck.scan.order.touching import touch_table, touching_successors

MOST_LISTED = 8
"""Islands of which all orders are tried: 40320."""


@kernel
def best_of_all(layer: Layer, longest_mm: float) -> Ints:
    """Order islands by trying all orders: fewest touching successors, then least travel too long, then coolest.

    Parameters
    ----------
    longest_mm
        Travel that is allowed.

    Returns
    -------
    Ints
        (I,) the best order; the first of equal ones in the order of the alphabet.
    """
    count = len(layer.time_s)
    order, places = np.arange(count), np.arange(count)
    best, best_touches, best_far, best_total = order.copy(), count, np.inf, np.inf
    log, first, beside = new_log(count), 0, touch_table(layer.beside)
    while first >= 0:
        timed_from(first, order, layer, beside, log)
        total = powers_from(first, first, first, places, order, layer, np.inf, log)
        far, touches = (
            max(0.0, log.travel_mm[-1] - longest_mm),
            int(touching_successors(layer.beside, order).sum()),
        )
        shorter, as_short = far < best_far - JOINED_MM, far <= best_far + JOINED_MM
        as_good = touches == best_touches and (shorter or (as_short and total < best_total))
        if touches < best_touches or as_good:
            best[:], best_touches, best_far, best_total = order, touches, far, total
        first = next_order(order)
    return best


@kernel
def next_order(order: Ints) -> int:
    """Turn an order into the next one of the alphabet; returns the first place that changed, -1 after the last order."""
    place = len(order) - 2
    while place >= 0 and order[place] > order[place + 1]:
        place -= 1
    if place < 0:
        return -1
    later = len(order) - 1
    while order[later] < order[place]:
        later -= 1
    order[place], order[later] = order[later], order[place]
    order[place + 1 :] = order[place + 1 :][::-1].copy()
    return place
