"""Heat of islands older than a horizon, by the few modes of their section that are left by then."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

LEAST_DECAY = 1e-9
"""Amplitudes that fall by less than this while an island is scanned do not fall."""


@kernel
def entered_with_aged(
    mean: Floats,
    plane_rate: Floats,
    depth_rate: Floats,
    in_layer: Floats,
    source: Floats,
    order: Ints,
    start: Floats,
    end: Floats,
    age: float,
    state: Floats,
) -> Floats:
    """Entry temperature of each island (I,) by what the layer begins with and by heat of at least an age, s.

    Heat comes to the modes late by that age, and as small as it has become by then. `state` (K, N) is used up.
    """
    fallen = by_island(mean * np.exp(-plane_rate * age).reshape(-1, 1))
    in_layer_late = in_layer * np.exp(-depth_rate * age)
    entry_k = np.zeros(mean.shape[1])
    clock, place = 0.0, 0
    for island in order:
        place = with_late_heat(
            state, fallen, plane_rate, depth_rate, in_layer_late, source, order, start, end, age, clock,
            start[island], place,
        )  # fmt: skip
        clock = start[island]
        for k in range(mean.shape[0]):
            for n in range(len(depth_rate)):
                entry_k[island] += mean[k, island] * in_layer[n] * state[k, n]
    return entry_k


@kernel
def by_island(mean: Floats) -> Floats:
    """Return means (K, I) with those of each island side by side in memory."""
    return np.ascontiguousarray(mean.T).T


@kernel
def with_late_heat(
    state: Floats,
    mean: Floats,
    plane_rate: Floats,
    depth_rate: Floats,
    in_layer: Floats,
    source: Floats,
    order: Ints,
    start: Floats,
    end: Floats,
    late: float,
    clock: float,
    until: float,
    place: int,
) -> int:
    """Age amplitudes (K, N) from a time until another, with islands that heat late; the place in the order reached."""
    while clock < until:
        begins, ends, heating = until, until, 0.0
        if place < len(order):
            begins, ends = start[order[place]] + late, end[order[place]] + late
        island = order[min(place, len(order) - 1)]
        if begins > clock:
            time = min(begins, until) - clock
        else:
            time = min(ends, until) - clock
            heating = source[island]
        age_state(state, mean[:, island], plane_rate, depth_rate, in_layer, heating, time)
        # The very end of a stretch, not a sum that may miss it by rounding.
        if begins > clock:
            clock = min(begins, until)
        else:
            clock = min(ends, until)
            if ends <= until:
                place += 1
    return place


@kernel
def age_state(
    state: Floats,
    mean: Floats,
    plane_rate: Floats,
    depth_rate: Floats,
    in_layer: Floats,
    heating: float,
    time: float,
) -> None:
    """Age amplitudes (K, N) while an island with mode means (K,) heats them."""
    through = np.exp(-depth_rate * time)
    for k in range(state.shape[0]):
        across, gain = np.exp(-plane_rate[k] * time), heating * mean[k]
        if heating == 0.0:
            for n in range(state.shape[1]):
                state[k, n] *= across * through[n]
            continue
        for n in range(state.shape[1]):
            rate, fall = plane_rate[k] + depth_rate[n], across * through[n]
            held = time if rate * time < LEAST_DECAY else (1.0 - fall) / rate
            state[k, n] = state[k, n] * fall + gain * held * in_layer[n]
