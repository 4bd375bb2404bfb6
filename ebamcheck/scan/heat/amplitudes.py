"""Amplitudes of the modes of section and depth while islands are scanned: how they fall, and what is added to them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

LEAST_DECAY = 1e-9
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
            held = time if rate * time < LEAST_DECAY else (1.0 - across * through[n]) / rate
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
