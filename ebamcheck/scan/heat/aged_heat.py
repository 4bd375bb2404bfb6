"""Heat of islands older than a horizon, by the few modes of their section that are left by then."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats
from ebamcheck.scan.heat.amplitudes import Modes, Timetable, age_state


@kernel
def entered_with_aged(modes: Modes, timetable: Timetable, age: float, state: Floats) -> Floats:
    """Entry temperature of each island (I,) by what the layer begins with and by heat of at least an age, s.

    Heat comes to the modes late by that age, and as small as it has become by then. `state` (K, N) is used up.
    """
    aged = late_modes(modes, age)
    entry_k = np.zeros(modes.mean.shape[1])
    clock, place = 0.0, 0
    for island in timetable.order:
        start = timetable.start_s[island]
        place = with_late_heat(state, aged, timetable, age, clock, start, place)
        clock = start
        for k in range(modes.mean.shape[0]):
            for n in range(len(modes.depth_rate)):
                entry_k[island] += modes.mean[k, island] * modes.in_layer[n] * state[k, n]
    return entry_k


@kernel
def late_modes(modes: Modes, age: float) -> Modes:
    """Modes whose sources are as small as their heat has become at an age; means of an island lie side by side in memory."""
    fallen = modes.mean * np.exp(-modes.plane_rate * age).reshape(-1, 1)
    in_layer = modes.in_layer * np.exp(-modes.depth_rate * age)
    by_island = np.ascontiguousarray(fallen.T).T
    return Modes(by_island, modes.plane_rate, modes.depth_rate, in_layer, modes.source_k_s)


@kernel
def with_late_heat(
    state: Floats, aged: Modes, timetable: Timetable, age: float, clock: float, until: float, place: int
) -> int:
    """Age amplitudes (K, N) from a time until another, with islands that heat late; the place in the order reached."""
    order = timetable.order
    while clock < until:
        begins, ends, heating = until, until, 0.0
        island = order[min(place, len(order) - 1)]
        if place < len(order):
            begins, ends = timetable.start_s[island] + age, timetable.end_s[island] + age
        if begins > clock:
            time = min(begins, until) - clock
        else:
            time = min(ends, until) - clock
            heating = aged.source_k_s[island]
        age_state(state, aged, island, heating, time)
        # The very end of a stretch, not a sum that may miss it by rounding.
        if begins > clock:
            clock = min(begins, until)
        else:
            clock = min(ends, until)
            if ends <= until:
                place += 1
    return place
