"""Heat of islands older than a horizon, by the few modes of their section that are left by then."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.heat.near_field import falling

LEAST_DECAY = 1e-5
"""Decays under which what an island leaves is the first terms of its series: a difference from 1 would lose more."""


class AgedModes(NamedTuple):
    """Modes as :class:`~ebamcheck.scan.heat.aged_heat.Modes`, whose sources are as small as their heat has become at an age.

    Amplitudes are (N, K) here: those of all modes of the section lie side by side, which the processor takes several of at once.

    Parameters
    ----------
    mean
        (I, K) means over the islands.
    plane_rate, depth_rate, source_k_s
        As there.
    in_layer
        (N,) means of the depth's modes over the layer.
    held_s
        (N, K) amplitude that heating by 1 K/s comes to in the end; 0 for what never falls.
    across
        (K,) room for what is left of the section's modes after a time.
    """

    mean: Floats
    plane_rate: Floats
    depth_rate: Floats
    source_k_s: Floats
    in_layer: Floats
    held_s: Floats
    across: Floats


@kernel
def entered_with_aged(modes: Modes, timetable: Timetable, age: float, start: Floats) -> Floats:
    """Entry temperature of each island (I,) by what the layer begins with and by heat of at least an age, s.

    Heat comes to the modes late by that age, and as small as it has become by then. `start` are amplitudes (K, N).
    """
    aged, state = late_modes(modes, age), by_depth(start)
    mean = np.ascontiguousarray(modes.mean.T)
    entry_k, surface = np.zeros(len(mean)), np.empty(len(modes.plane_rate))
    clock, place = 0.0, 0
    for island in timetable.order:
        until = timetable.start_s[island]
        place = with_late_heat(state, aged, timetable, age, clock, until, place)
        clock = until
        read_surface(state, modes.in_layer, surface)
        for k in range(len(surface)):
            entry_k[island] += mean[island, k] * surface[k]
    return entry_k


@kernel
def by_depth(state: Floats) -> Floats:
    """Amplitudes (K, N) as (N, K)."""
    return np.ascontiguousarray(state.T)


@kernel
def late_modes(modes: Modes, age: float) -> AgedModes:
    """Modes whose sources are as small as their heat has become at an age."""
    fallen = modes.mean * np.exp(-modes.plane_rate * age).reshape(-1, 1)
    in_layer = modes.in_layer * np.exp(-modes.depth_rate * age)
    held = np.zeros((len(modes.depth_rate), len(modes.plane_rate)))
    for n in range(held.shape[0]):
        for k in range(held.shape[1]):
            rate = modes.plane_rate[k] + modes.depth_rate[n]
            held[n, k] = in_layer[n] / rate if rate > 0.0 else 0.0
    return AgedModes(
        np.ascontiguousarray(fallen.T), modes.plane_rate, modes.depth_rate, modes.source_k_s, in_layer, held,
        np.empty(len(modes.plane_rate)),
    )  # fmt: skip


@kernel
def read_surface(state: Floats, in_layer: Floats, surface: Floats) -> None:
    """Set the amplitudes (K,) of the section's modes in the layer by those of all modes (N, K)."""
    surface[:] = 0.0
    for n in range(len(state)):
        for k in range(len(surface)):
            surface[k] += state[n, k] * in_layer[n]


@kernel
def aged_state(state: Floats, aged: AgedModes, island: int, heating: float, time: float) -> None:
    """Age amplitudes (N, K) while an island heats them by so many K/s; not at all by 0."""
    across, plane_rate = aged.across, aged.plane_rate
    for k in range(len(across)):
        across[k] = falling(-plane_rate[k] * time)
    for n in range(len(state)):
        through = np.exp(-aged.depth_rate[n] * time)
        if heating == 0.0:
            for k in range(len(across)):
                state[n, k] *= across[k] * through
        else:
            _heated(state[n], across, through, aged, n, island, heating, time)


@kernel
def _heated(
    state: Floats,
    across: Floats,
    through: float,
    aged: AgedModes,
    n: int,
    island: int,
    heating: float,
    time: float,
) -> None:
    """Age amplitudes (K,) of one mode of the depth, of which `across` times `through` is left, while an island heats them."""
    plane_rate, held, mean = aged.plane_rate, aged.held_s[n], aged.mean[island]
    depth_rate, short = aged.depth_rate[n], aged.in_layer[n] * time
    for k in range(len(state)):
        fall, decays = across[k] * through, (plane_rate[k] + depth_rate) * time
        left = short * (1.0 - 0.5 * decays) if decays < LEAST_DECAY else (1.0 - fall) * held[k]
        state[k] = state[k] * fall + heating * mean[k] * left


@kernel
def with_late_heat(
    state: Floats, aged: AgedModes, timetable: Timetable, age: float, clock: float, until: float, place: int
) -> int:
    """Age amplitudes (N, K) from a time until another, with islands that heat late; the place in the order reached."""
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
        aged_state(state, aged, island, heating, time)
        # The very end of a stretch, not a sum that may miss it by rounding.
        if begins > clock:
            clock = min(begins, until)
        else:
            clock = min(ends, until)
            if ends <= until:
                place += 1
    return place


# -- Amplitudes of the modes of section and depth while islands are scanned: how they fall, and what is
# added to them.


LEAST_FALL = 1e-9
"""Amplitudes that fall by less than this while an island is scanned do not fall."""


class Modes(NamedTuple):
    """Islands as sources and readings of K modes of the section times N of the depth.

    Parameters
    ----------
    mean
        (K, I) means of the section's modes over the islands.
    plane_rate, depth_rate
        (K,) and (N,), whose sums are the decays of the amplitudes, 1/s.
    in_layer
        (N,) means of the depth's modes over the layer.
    source_k_s
        (I,) beam power on the island over the heat capacity of a volume, while it is scanned.
    """

    mean: Floats
    plane_rate: Floats
    depth_rate: Floats
    in_layer: Floats
    source_k_s: Floats


class Timetable(NamedTuple):
    """When the islands of a layer are scanned.

    Parameters
    ----------
    order
        (I,) islands in scan order; fewer where only these were scanned so far.
    start_s, end_s
        (I,) times by island.
    """

    order: Ints
    start_s: Floats
    end_s: Floats


@kernel
def decay(state: Floats, modes: Modes, time: float) -> None:
    """Let all amplitudes (K, N) fall for a time."""
    through = np.exp(-modes.depth_rate * time)
    for k in range(state.shape[0]):
        across = np.exp(-modes.plane_rate[k] * time)
        for n in range(state.shape[1]):
            state[k, n] *= across * through[n]


@kernel
def heat_island(state: Floats, modes: Modes, island: int, time: float) -> None:
    """Add what an island leaves at the end of the time in which it is heated."""
    source = modes.source_k_s[island]
    through = np.exp(-modes.depth_rate * time)
    for k in range(state.shape[0]):
        across = np.exp(-modes.plane_rate[k] * time)
        for n in range(state.shape[1]):
            rate = modes.plane_rate[k] + modes.depth_rate[n]
            held = time if rate * time < LEAST_FALL else (1.0 - across * through[n]) / rate
            state[k, n] += source * held * modes.mean[k, island] * modes.in_layer[n]


@kernel
def at_surface(state: Floats, modes: Modes) -> Floats:
    """Amplitudes (K,) of the section's modes in the layer."""
    result = np.empty(state.shape[0])
    for k in range(state.shape[0]):
        total = 0.0
        for n in range(state.shape[1]):
            total += state[k, n] * modes.in_layer[n]
        result[k] = total
    return result


@kernel
def field(modes: Modes, amplitudes: Floats) -> Floats:
    """Temperature rise of all islands, (I,), by the amplitudes (K,) of the section's modes."""
    result = np.zeros(modes.mean.shape[1])
    for k in range(modes.mean.shape[0]):
        for j in range(modes.mean.shape[1]):
            result[j] += amplitudes[k] * modes.mean[k, j]
    return result
