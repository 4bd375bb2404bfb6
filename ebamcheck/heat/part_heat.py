"""The heat of a part while its layers are laid: the mean of each section by a column, what differs in it by modes.

Over the section, the temperature is that of the column of :mod:`ebamcheck.heat.balance`, which knows the outline of
every layer, channels and data that change with temperature. What differs across the section is carried by the modes of
the layer, which are linear; their mean over the section is taken out wherever heat enters or a temperature is read, so
that nothing is counted twice.
"""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ebamcheck.heat import HeatModel, carried
from ebamcheck.heat.balance import HeatColumn
from ebamcheck.heat.field import Field
from ebamcheck.kernels import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class BeadPower:
    """Power of the beads of one layer along themselves, as columns (n,) of their stretches."""

    bead: Ints  # bead of each, by its number in the sequence
    part: Floats  # share of the bead's length, times the share of the power that ramps leave it
    least: Floats  # share of the full power that it has at least, see :func:`ebamcheck.heat.medium.own_power_shares`

    def mean(self, share: float, beads: int) -> Floats:
        """Mean power of the beads, (B,), over the full one, where the layer has a share of it."""
        along = self.part * np.maximum(self.least, share)
        return np.bincount(self.bead, along, minlength=beads).astype(np.float64)


@dataclass(frozen=True, eq=False)
class Beads:
    """Beads (B,) of one layer in the sequence in which they are laid: contours first, then those of islands."""

    pieces: Floats  # (K, P) means of the modes over pieces of beads, less those over the section; none without islands
    first: Ints  # (B + 1,) first piece of each bead
    move_s: Floats  # time with the beam off before each
    rise_s: Floats  # what a wait there adds to it: the beam waits at the safe height
    time_s: Floats  # (P,) time of each piece
    on: Floats  # (P,) mean power in each piece over the full one
    rings: int  # contours among the beads
    islands: Ints  # (B - rings,) island of each of the others
    inner: Bools  # whether each is a further bead of the island before
    power: BeadPower | None = None  # along the beads; None: that of the layer, less their ramps

    def at_share(self, share: float) -> Beads:
        """The same beads where the layer has a share of the power: `on` is the mean power over the full one."""
        if self.power is None:
            return replace(self, on=share * self.on)
        return replace(self, on=np.repeat(self.power.mean(share, len(self)), np.diff(self.first)))

    def __len__(self) -> int:
        """Return the number of beads."""
        return len(self.move_s)

    @cached_property
    def shapes(self) -> list[Floats]:
        """Means of the modes over each bead, (K,), the same however often the layer is simulated."""
        spans = [slice(*span) for span in itertools.pairwise(self.first.tolist())]
        return [self.pieces[:, at] @ self.time_s[at] / self.time_s[at].sum() for at in spans]


class AgedColumns:
    """A column after times with the beam off, each worked out once: waits are looked for, then waited for."""

    def __init__(self, column: HeatColumn) -> None:
        self._column = column
        self._aged: dict[float, HeatColumn] = {}

    def after(self, time_s: float) -> HeatColumn:
        """The column after a time; not to be changed by who asks, as long as others may."""
        if time_s <= 0.0:
            return self._column
        if time_s not in self._aged:
            self._aged[time_s] = self._column.copy()
            self._aged[time_s].advance(time_s)
        return self._aged[time_s]


@dataclass(eq=False)
class PartHeat:
    """Heat of a part at one moment: the mean over every section by a column, and what differs across it by modes.

    The modes are those of the uppermost layer that has islands; there are none before it. What is laid on it without
    islands, the tip of a dome for instance, heats the column alone, and is read there.
    """

    column: HeatColumn
    model: HeatModel | None = None
    field: Field = dataclasses.field(default_factory=lambda: Field(np.zeros((0, 0)), *3 * (np.zeros(0),)))
    # (N,) mean of the depth's modes over the layer under the uppermost one: the new one begins cold
    reading: Floats = dataclasses.field(default_factory=lambda: np.zeros(0))

    def copy(self) -> PartHeat:
        """The same part, to be aged by itself."""
        return PartHeat(self.column.copy(), self.model, self.field.copy(), self.reading)

    def under(self, model: HeatModel | None) -> PartHeat:
        """The same heat in the modes of the next layer, before that is laid; None: it has none, the old ones stay."""
        if model is None:
            return self.copy()
        state = None if self.model is None else carried(self.model, self.field.state, model)
        thick_mm = min(model.layer_mm, 0.5 * model.depth.depth_mm)
        whole = model.depth.mean_of_layer(2.0 * thick_mm)
        reading = np.asarray(2.0 * whole - model.depth.mean_of_layer(thick_mm), np.float64)
        return PartHeat(self.column.copy(), model, Field.of(model, state), reading)

    def rest(self, duration_s: float, aged: AgedColumns | None = None) -> None:
        """Let a time go by with the beam off; `aged` are columns of this moment, of which it takes the one at the end."""
        if aged is None:
            self.column.advance(duration_s)
        else:
            self.column = aged.after(duration_s)
        self.field.age(duration_s)

    def lay_bead(self, beads: Beads, bead: int, power_w: float) -> None:
        """Lay a bead; `power_w` is what the part takes up."""
        a, b = (int(n) for n in beads.first[bead : bead + 2])
        on_s, whole_s = float(beads.time_s[a:b] @ beads.on[a:b]), float(beads.time_s[a:b].sum())
        self.column.advance(whole_s, power_w * on_s)
        if not len(beads.pieces):
            self.field.age(whole_s)
        elif self.model is not None:
            source = power_w / self.model.medium.heat_capacity_j_mm3k * beads.on[a:b]
            self.field.add(beads.pieces[:, a:b], source, beads.time_s[a:b])

    def bed_k(
        self,
        shape: Floats,
        wait_s: float = 0.0,
        before: tuple[Field, float] | None = None,
        aged: AgedColumns | None = None,
    ) -> float:
        """Temperature that a bead finds after a wait, absolute, K: that of its place, or the mean where that is warmer.

        `before`: field when the bead's own island was begun, and how long ago that was, s: heat that the island has put there itself
        is part of its melt pool, and counts in the mean alone; `aged`: the columns of this moment, where several waits are tried.
        """
        mean_k = (aged or AgedColumns(self.column)).after(wait_s).bed_k
        if self.model is None or not len(shape):
            return mean_k
        across, age_s = before or (self.field, 0.0)
        away = across.rise_k(shape, self.reading, age_s + wait_s)
        return float(mean_k + max(away, 0.0))

    def amplitudes(self) -> Floats:
        """Amplitudes (K, N) of the whole field: what differs, and the column's profile over the whole section."""
        assert self.model is not None
        depth, flat, state = self.model.depth, self.model.plane.integral(), self.field.state
        edges = np.minimum(self.column.edges_mm, depth.depth_mm)
        size, middle = np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
        rise_k = self.column.temperature_k - self.column.config.process.ambient_temperature_k
        mean = np.sinc(0.5 * np.multiply.outer(size, depth.wave_number) / np.pi) * depth.at(depth.depth_mm - middle)
        uneven = state - np.multiply.outer(flat, flat @ state) / (flat @ flat)
        return np.asarray(uneven + np.multiply.outer(flat, (rise_k * size) @ mean), np.float64)


def uneven(shapes: Floats, model: HeatModel) -> Floats:
    """Means of the modes (K, I) over islands, less those over the section."""
    flat = model.plane.integral()
    return np.asarray(shapes - (flat / (flat @ flat))[:, None], np.float64)
