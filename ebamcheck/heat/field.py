"""Heat in amplitudes (K, N) of modes of a section and of its depth: aged, added to, and read.

Each amplitude decays at its own rate, so that a step of any length is exact. A place enters by the means of the section's
modes over it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ebamcheck.heat.model import HeatModel
from ebamcheck.kernels import Floats, Ints, kernel

LEAST_DECAY = (
    1e-5  # decays under which what a place leaves is the first terms of its series: a difference from 1 would lose more
)
LEAST = -40.0  # exponent under which :func:`falling` gives the power of this one, 4e-18: nothing beside 1


class Modes(NamedTuple):
    """Islands as sources and readings of the modes of a section and of its depth."""

    mean: Floats  # (K, I) means of the section's modes over the islands
    plane_rate: Floats  # (K,) decays of these modes, 1/s
    depth_rate: Floats  # (N,) the same of the depth's
    in_layer: Floats  # (N,) means of the depth's modes over the layer
    source_k_s: Floats  # (I,) beam power on each island while it is scanned, over the heat capacity of a volume

    def late(self, age_s: float) -> Modes:
        """Modes with sources and readings as small as their heat has become at an age."""
        mean = self.mean * np.exp(-self.plane_rate * age_s)[:, None]
        return self._replace(mean=mean, in_layer=self.in_layer * np.exp(-self.depth_rate * age_s))


class Timetable(NamedTuple):
    """When the islands of a layer are scanned: those scanned so far in their order, and the times (I,) by island."""

    order: Ints
    start_s: Floats
    end_s: Floats


@dataclass(eq=False)
class Field:
    """Heat at one moment."""

    state: Floats  # (K, N) amplitudes
    plane_rate: Floats  # as in :class:`Modes`
    depth_rate: Floats
    in_layer: Floats

    @classmethod
    def of(cls, model: HeatModel, state: Floats | None = None) -> Field:
        """Amplitudes of a model's modes; None: those of a cold body."""
        alpha = model.medium.diffusivity_mm2_s
        rates = alpha * model.plane.eigenvalue, alpha * model.depth.wave_number**2
        return cls(model.cold() if state is None else state, *rates, model.in_layer)

    def copy(self) -> Field:
        """The same heat, to be aged by itself."""
        return Field(self.state.copy(), self.plane_rate, self.depth_rate, self.in_layer)

    def age(self, duration_s: float) -> None:
        """Let a time go by without a source."""
        self.add(np.zeros((0, 1)), np.zeros(1), np.array([duration_s]))

    def add(self, shapes: Floats, source_k_s: Floats, time_s: Floats) -> None:
        """Let times (P,) go by, in each of which a place with the means (K, P) takes up a source (P,), K/s."""
        columns = self.plane_rate, self.depth_rate, self.in_layer
        heated(self.state, *columns, np.ascontiguousarray(shapes), 0, source_k_s, time_s)

    def rise_k(self, shape: Floats, in_layer: Floats, after_s: float) -> float:
        """Rise of a place with the means (K,) after a time, where the depth's modes have the means (N,)."""
        across, through = np.exp(-self.plane_rate * after_s), np.exp(-self.depth_rate * after_s)
        return float((shape * across) @ self.state @ (in_layer * through))

    def surface(self) -> Floats:
        """Amplitudes (K,) of the section's modes in the layer."""
        return np.asarray(self.state @ self.in_layer, np.float64)


@kernel
def falling(exponent: float) -> float:
    """Return e to an exponent of at most 0, to 1e-14 of 1.

    The library's function takes one value at a time and 8 ns. The series of a 64th of the exponent, squared six times, is the same
    to rounding, has no branch, and takes 1 ns in a loop over a column.

    >>> round(falling(-1.0), 12)
    0.367879441171
    """
    part = max(exponent, LEAST) / 64.0
    power = 1.0 + part * (1.0 / 11.0)
    power = 1.0 + part * (1.0 / 10.0) * power
    power = 1.0 + part * (1.0 / 9.0) * power
    power = 1.0 + part * (1.0 / 8.0) * power
    power = 1.0 + part * (1.0 / 7.0) * power
    power = 1.0 + part * (1.0 / 6.0) * power
    power = 1.0 + part * (1.0 / 5.0) * power
    power = 1.0 + part * (1.0 / 4.0) * power
    power = 1.0 + part * (1.0 / 3.0) * power
    power = 1.0 + part * (1.0 / 2.0) * power
    power = 1.0 + part * power
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    return power * power


@kernel
def heated(
    state: Floats,
    plane_rate: Floats,
    depth_rate: Floats,
    in_layer: Floats,
    shapes: Floats,
    first: int,
    source: Floats,
    time: Floats,
) -> None:
    """Let times (P,) go by, each with its source (P,), K/s, on the places of `shapes` (K, .) from the first on."""
    across, through = np.empty(len(plane_rate)), np.empty(len(depth_rate))
    for p in range(len(time)):
        duration, power = time[p], source[p]
        for n in range(len(depth_rate)):
            through[n] = falling(-depth_rate[n] * duration)
        for k in range(len(plane_rate)):
            across[k] = falling(-plane_rate[k] * duration)
        for k in range(len(plane_rate)):
            plane, left = plane_rate[k], across[k]
            strength = 0.0 if power == 0.0 else power * shapes[k, first + p]
            if strength == 0.0:
                for n in range(len(depth_rate)):
                    state[k, n] *= left * through[n]
                continue
            for n in range(len(depth_rate)):
                rate, fall = plane + depth_rate[n], left * through[n]
                decays = rate * duration
                held = (1.0 - fall) / rate
                if decays < LEAST_DECAY:
                    held = duration * (1.0 - 0.5 * decays)
                state[k, n] = state[k, n] * fall + strength * held * in_layer[n]


@kernel
def late_heat(
    state: Floats, late: Modes, timetable: Timetable, age: float, clock: float, until: float, place: int
) -> int:
    """Age amplitudes from a time until another, heated by islands as late as an age; the place in the order reached."""
    order, source, time = timetable.order, np.zeros(1), np.zeros(1)
    while clock < until:
        begins, ends, source[0] = until, until, 0.0
        island = order[min(place, len(order) - 1)]
        if place < len(order):
            begins, ends = timetable.start_s[island] + age, timetable.end_s[island] + age
        # The very end of a stretch, not a sum that may miss it by rounding.
        stop = min(begins, until)
        if begins <= clock:
            stop, source[0] = min(ends, until), late.source_k_s[island]
            place += ends <= until
        time[0] = stop - clock
        heated(state, late.plane_rate, late.depth_rate, late.in_layer, late.mean, island, source, time)
        clock = stop
    return place


@kernel
def surfaces_at_entries(late: Modes, timetable: Timetable, age: float, start: Floats, in_layer: Floats) -> Floats:
    """Amplitudes (I, K) of the section's modes in the layer when each island is entered, by the heat with which the layer begins,
    `start` (K, N), and by heat of at least an age, which comes to the `late` modes late by it, and as small as it has become."""
    state, surface = start.copy(), np.zeros((len(timetable.start_s), len(start)))
    clock, place = 0.0, 0
    for island in timetable.order:
        until = timetable.start_s[island]
        place = late_heat(state, late, timetable, age, clock, until, place)
        clock = until
        read_surface(state, in_layer, surface[island])
    return surface


@kernel
def read_surface(state: Floats, in_layer: Floats, surface: Floats) -> None:
    """Set the amplitudes (K,) of the section's modes in the layer by those of all modes."""
    for k in range(len(surface)):
        total = 0.0
        for n in range(len(in_layer)):
            total += state[k, n] * in_layer[n]
        surface[k] = total
