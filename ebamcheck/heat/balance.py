"""One-dimensional heat balance of a whole program: a column of layers that grows on the base plate.

Each layer has an area, an outer and an inner perimeter. Heat is conducted along z, by the tables of the material
(conductivity, heat capacity, heat of fusion); the temperature is uniform over a section. Heat leaves by radiation (T^4):

- the top, the outer sides and the ledges between layers of different outlines radiate to the chamber;
- the walls of a channel radiate into each other, and lose heat only through its open top. A wall at the depth z under
  the opening sees it with the view factor (X^2 + 1/2) / sqrt(X^2 + 1) - X, X = z/D, of a ring on the wall of a cylinder
  (Howell, Catalog of Radiation Heat Transfer Configuration Factors, ring on a cylinder to its end), with the hydraulic
  diameter D = 4 area/perimeter of the channel. Reflections make the opening blacker than its walls: it radiates with
  the emissivity 1 / (1 + (1/eps - 1) a/A) of a grey cavity with walls and floor of area A behind an opening of area a
  (Siegel and Howell, Thermal Radiation Heat Transfer). A deep channel of uniform temperature thus loses as much as a black
  disc in its opening; exchange between walls along the channel is neglected. A channel that is closed above loses nothing.

A layer is deposited as metal at chamber temperature, all at once when the layer begins, and absorbs the beam's
heat evenly over the layer's time. The plate is as wide as the lowest layer; it does not radiate, and loses heat only to
a cooled table under it. Time steps are implicit (two stages, second order, Newton), so any step is stable, and the heat
put in equals that stored, passed to the table and radiated, to rounding.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.heat.medium import STEFAN_BOLTZMANN_W_M2K4, EnthalpyTables, enthalpy_tables
from ebamcheck.kernels import Floats, Ints, kernel
from ebamcheck.settings.config import Config

LARGEST_CELL_MM = (
    2.5  # largest height of a cell of the column: heat spreads over 20 times as far during a layer of one minute
)
# Largest height of a joined cell of layers below, over its depth under the surface: the temperature field below a heated surface
# is the smoother the deeper it is
GROWTH = 0.05
JOINED_FROM_MM = 10.0  # depth from which cells are joined
NO_TIME: Floats = np.zeros(1)


@dataclass(frozen=True)
class LayerShape:
    """One layer for the balance: thickness, area of metal, outer and inner perimeter, and area of its holes."""

    thickness_mm: float
    area_mm2: float
    outer_mm: float
    inner_mm: float = 0.0
    hole_mm2: float = 0.0

    @classmethod
    def of(cls, section: BaseGeometry, thickness_mm: float) -> LayerShape:
        """Return the shape of a layer from its section; lines and points in the section are ignored."""
        parts = [part for part in shapely.get_parts(section) if part.geom_type == "Polygon"]
        holes = [shapely.Polygon(ring) for part in parts for ring in part.interiors]
        return cls(
            thickness_mm=thickness_mm,
            area_mm2=float(sum(part.area for part in parts)),
            outer_mm=float(sum(part.exterior.length for part in parts)),
            inner_mm=float(sum(hole.exterior.length for hole in holes)),
            hole_mm2=float(sum(hole.area for hole in holes)),
        )


@dataclass(eq=False)
class HeatColumn:
    """The column at one moment of a program; it grows by :meth:`lay`, and time passes by :meth:`advance`."""

    config: Config  # plate, base, chamber and material
    tables: EnthalpyTables | None = None  # of the material; None: of that of the settings
    absorbed_j: float = 0.0
    base_j: float = 0.0
    radiated_j: float = 0.0
    # (n,) heat content of the cells above that at ambient temperature, from the base up, J/mm^3
    content: Floats = field(default_factory=lambda: np.zeros(0))
    # The same of the base plate before the first layer, if it was preheated; empty: it is cold
    warm_plate: Floats = field(default_factory=lambda: np.zeros(0))
    _cells: Floats = field(default_factory=lambda: np.zeros((5, 0)))  # height of each, then as in :class:`LayerShape`
    _top: int = 0  # first cell of the uppermost layer
    _under: int = 0  # first cell of the layer under it
    _fields: ColumnFields | None = None  # the cells in the form that kernels read; None before there are any

    @cached_property
    def material(self) -> EnthalpyTables:
        """Tables of the material."""
        return enthalpy_tables(self.config) if self.tables is None else self.tables

    @property
    def edges_mm(self) -> Floats:
        """(n + 1,) borders of the cells, as heights above the base."""
        return np.concatenate([[0.0], np.cumsum(self._cells[0])])

    @property
    def temperature_k(self) -> Floats:
        """(n,) absolute temperatures of the cells."""
        return self.material.temperature(self.content)

    @property
    def surface_k(self) -> float:
        """Mean temperature of the uppermost layer, K; ambient before there is any."""
        if not len(self.content):
            return self._bare_k
        size = self._cells[0, self._top :]
        return float(self.material.temperature(self.content[self._top :]) @ size / size.sum())

    @property
    def _bare_k(self) -> float:
        """Temperature of the bare base plate, before the first layer, K."""
        if not len(self.warm_plate):
            return self.config.process.ambient_temperature_k
        return float(self.material.temperature(self.warm_plate[-1]))

    @property
    def bed_k(self) -> float:
        """Temperature of the metal on which the next bead is laid, K: the warmer of the uppermost layer and the one under it."""
        if self._fields is None:
            return self._bare_k
        return float(bed_temperature_k(self.content, self._fields, self._under, self._top))

    @property
    def mean_rise_k(self) -> float:
        """Mean temperature of the column above ambient, K."""
        if not len(self.content):
            return 0.0
        rise_k = self.temperature_k - self.config.process.ambient_temperature_k
        return float(np.average(rise_k, weights=self._cells[0] * self._cells[1]))

    @property
    def stored_j(self) -> float:
        """Heat in the column above that at ambient temperature."""
        return float((self.content * self._cells[0] * self._cells[1]).sum())

    def copy(self) -> HeatColumn:
        """Return an independent copy of the column."""
        other = copy(self)
        other.content = self.content.copy()
        return other

    def lay(self, shape: LayerShape) -> None:
        """Lay a cold layer on top; the first layer also adds the plate under it."""
        if not len(self.content):
            self._stack(LayerShape(self.config.process.base_plate_mm, shape.area_mm2, 0.0))
            if len(self.warm_plate):
                self.content[:] = self.warm_plate
        self._under, self._top = self._top, len(self.content)
        self._stack(shape)
        self._join(joined_cells(self._cells[0], self._cells[1], self._cells[4], self._under))
        self._update_fields()

    def lay_plate(self, area_mm2: float) -> None:
        """Make this the column of a bare base plate, whose uppermost cell takes up the heat; no layer may follow."""
        self._stack(LayerShape(self.config.process.base_plate_mm, area_mm2, 0.0))
        self._under = self._top = len(self.content) - 1
        self._update_fields()

    def _update_fields(self) -> None:
        """Compute the radiating surface of each cell, and the fields for the kernels."""
        size, area, outer, inner, hole = self._cells
        surface_mm2 = radiating_mm2(size, area, outer, inner, hole, self.config.material.emissivity)
        process, material = self.config.process, self.material
        self._fields = (
            material.temperature_k,
            material.theta_w_mm,
            material.step_j_mm3,
            size,
            area,
            1e-6 * STEFAN_BOLTZMANN_W_M2K4 * surface_mm2,
            process.ambient_temperature_k,
            process.base == "cooled",
        )

    def _stack(self, shape: LayerShape) -> None:
        count = max(1, math.ceil(shape.thickness_mm / LARGEST_CELL_MM))
        cell = [shape.thickness_mm / count, shape.area_mm2, shape.outer_mm, shape.inner_mm, shape.hole_mm2]
        self._cells = np.ascontiguousarray(np.column_stack([self._cells, np.tile(np.array(cell)[:, None], count)]))
        self.content = np.concatenate([self.content, np.zeros(count)])

    def _join(self, owner: Ints) -> None:
        """Join the cells that have the same owner (n,); volumes, surfaces and heat are kept."""
        if owner[-1] + 1 == len(owner):
            return
        size = np.bincount(owner, self._cells[0])
        volume = self._cells[0] * self._cells[1]
        self.content = np.bincount(owner, self.content * volume) / np.bincount(owner, volume)
        sides = [np.bincount(owner, row * self._cells[0]) / size for row in self._cells[1:]]
        self._cells = np.ascontiguousarray([size, *sides])
        self._top, self._under = int(owner[self._top]), int(owner[self._under])

    def advance(self, duration_s: float, energy_j: float = 0.0) -> None:
        """Let time pass while the uppermost layer takes up heat."""
        if duration_s > 0.0 and self._fields is not None:
            self.drive((NO_TIME, np.array([duration_s]), np.array([energy_j], np.float64)))

    def wait_until(self, bed_k: float, longest_s: float) -> float:
        """Let time pass, in growing steps, until the metal under the next bead is no warmer than `bed_k`; returns the wait, s.

        The wait ends after the step that exceeds `longest_s`.
        """
        return float(self.drive((NO_TIME, NO_TIME, NO_TIME), bed_k, longest_s)[1][0])

    def drive(self, beads: BeadTimes, limit_k: float = math.inf, longest_s: float = math.inf) -> tuple[Floats, Floats]:
        """Heat the uppermost layer bead by bead: :meth:`advance` over the time before each bead, then over its own.

        The wait before a bead ends once the metal under it is no warmer than `limit_k`, the interpass temperature; after a wait longer
        than `longest_s` the beads that are left are left out. Returns the temperature (n,) of the metal under each bead when the beam
        arrives, K, and the wait before it (n,), s.
        """
        if self._fields is None:
            bed_k = np.full(len(beads[0]), self._bare_k)
            return bed_k, np.where(bed_k > limit_k, math.inf, 0.0)
        counted = np.array([self.absorbed_j, self.base_j, self.radiated_j])
        result = driven(self.content, self._fields, self._under, self._top, beads, limit_k, longest_s, counted)
        self.absorbed_j, self.base_j, self.radiated_j = counted.tolist()
        return result


def radiating_mm2(size: Floats, area: Floats, outer: Floats, inner: Floats, hole: Floats, emissivity: float) -> Floats:
    """Surface (n,) of each cell by which it radiates to the chamber, times its emissivity, mm^2."""
    whole = area + hole
    ledge = np.maximum(whole - np.append(whole[1:], hole[-1:]), 0.0)
    ledge[1:] += np.where(outer[:-1] > 0.0, np.maximum(whole[1:] - whole[:-1], 0.0), 0.0)
    result = emissivity * (outer * size + ledge)
    closed = np.flatnonzero(hole <= 0.0)
    bottom = closed[-1] + 1 if len(closed) else 0
    if bottom < len(size) and emissivity > 0.0:
        open_mm, wall, width = size[bottom:], inner[bottom:], hole[bottom:]
        # The floor is as wide as the channel at its bottom.
        black = 1.0 / (1.0 + (1.0 / emissivity - 1.0) * width[-1] / (wall @ open_mm + width[0]))
        below_mm = np.cumsum(open_mm[::-1])[::-1] - 0.5 * open_mm
        along = below_mm * wall / (4.0 * width)
        seen = (along**2 + 0.5) / np.sqrt(along**2 + 1.0) - along
        result[bottom:] += black * seen * wall * open_mm
    return result


def joined_cells(size: Floats, area: Floats, hole: Floats, under: int) -> Ints:
    """Owner (n,) of each cell after neighbours that are thin for their depth are joined; from `under` on none is.

    Cells beside a step of the outline, or where a channel begins or ends, stay.
    """
    whole, count = area + hole, len(size)
    steps = np.ones(count, np.bool_)
    steps[1:-1] = np.abs(whole[1:-1] - whole[2:]) > GROWTH * area[1:-1]
    steps[1:-1] |= (hole[1:-1] > 0.0) != (hole[2:] > 0.0)
    begins, below, joined = np.zeros(count, np.bool_), 0.0, 0.0
    for i, (mm, step) in reversed(list(enumerate(zip(size.tolist(), steps.tolist(), strict=True)))):
        begins[i] = step or i >= under - 1 or below < JOINED_FROM_MM or joined + mm > GROWTH * below
        joined, below = mm if begins[i] else joined + mm, below + mm
    owner = np.cumsum(begins[::-1])[::-1]
    return np.asarray(owner[0] - owner, np.int64)


# Time steps of a layer or a wait, growing from short ones because a heated surface follows a square root law of time; and the
# fewer steps of a time no longer than SHORT_S, such as that of a bead or a move
STEPS, FEW_STEPS, SHORT_S = 8, 4, 15.0
# Most iterations of a time step, and the change of the heat content (0.3 mK) at which it has converged
NEWTON_STEPS, NEWTON_J_MM3 = 60, 1e-6
# Share of a time step in each of its two implicit stages: second order and L-stable (Alexander, SIAM J. Numer. Anal. 14 (1977)
# 1006).
STAGE = 1.0 - math.sqrt(0.5)
# Largest change of the heat content in one iteration, about 300 K: melting and T^4 are too nonlinear for more
LARGEST_CHANGE_J_MM3 = 1.0


class Column(NamedTuple):
    """Cells of a heat column, from its base up, with the tables of their material at equal steps of the heat content."""

    temperature: Floats  # K
    theta: Floats  # heat potential, W/mm
    table_step: float  # J/mm^3
    size: Floats  # (n,) height of the cells, mm
    area: Floats  # (n,) section, mm^2
    radiating: Floats  # (n,) power that a cell radiates over T^4 - Ta^4, W/K^4
    ambient: float  # temperature of the chamber, K
    cooled: bool  # whether the base is held at the temperature of the table; else it is insulated


# The fields of a :class:`Column` as a plain tuple: numba types a named tuple in Python, which costs 10 us a call
ColumnFields = tuple[Floats, Floats, float, Floats, Floats, Floats, float, bool]


class _Step(NamedTuple):
    """Columns (n,) of a time step: values with their derivatives by the heat content, and the tridiagonal equations."""

    volume: Floats
    apart: Floats  # length over section from the middle of the cell before to that of each; of the first, from the base
    link: Floats  # heat flow from the cell before per difference of the potential: 1 / `apart`
    flow: Floats
    flow_slope: Floats
    lost: Floats
    lost_slope: Floats
    diagonal: Floats
    upper: Floats
    right: Floats


@kernel
def march(content: Floats, fields: ColumnFields, top: int, power: float, duration: float, steps: int) -> Floats:
    """Age a column; `content` goes from the first to the last state. Returns the heat to the table and radiated, J.

    The cells from `top` up are heated by a power, W. What leaves in a step is counted as the last Newton step has
    it, whose solution balances exactly.
    """
    column = Column(*fields)
    count = len(content)
    half = 0.5 * column.size / column.area
    apart = half.copy()
    for i in range(1, count):
        apart[i] = half[i - 1] + half[i]
    work = _Step(
        column.size * column.area, apart, 1.0 / apart, np.empty(count), np.empty(count), np.empty(count),
        np.empty(count), np.empty(count), np.empty(count), np.empty(count),
    )  # fmt: skip
    source = np.zeros(count)
    heated = work.volume[top:].sum()
    for i in range(top, count):
        source[i] = power * work.volume[i] / heated
    gone = np.zeros(2)
    base = work.link[0] if column.cooled else 0.0
    before = 0.0
    for solve in range(2 * steps):
        step, stage = solve // 2 + 1, solve % 2
        if stage == 0:
            now = duration * (step / steps) ** 2
            whole, before = now - before, now
            old = content.copy()
            time = STAGE * whole
        else:
            # What the first stage changes, over its share of the step, goes on for the rest of it.
            old += (content - old) * ((1.0 - STAGE) / STAGE)
        for turn in range(NEWTON_STEPS):
            largest = _newton_step(content, old, source, base, time, column, work)
            last = largest < NEWTON_J_MM3 or turn == NEWTON_STEPS - 1
            # All cells change alike, so that the balance holds along the way; the last step is a whole one.
            share = 1.0 if last else min(1.0, LARGEST_CHANGE_J_MM3 / largest)
            for i in range(count):
                content[i] += share * work.right[i]
            if last:
                break
        weight = STAGE if stage else 1.0 - STAGE
        gone[0] += weight * whole * base * (work.flow[0] + work.flow_slope[0] * work.right[0])
        for i in range(count):
            gone[1] += weight * whole * (work.lost[i] + work.lost_slope[i] * work.right[i])
    return gone


@kernel
def _newton_step(
    content: Floats, old: Floats, source: Floats, base: float, time: float, column: Column, work: _Step
) -> float:
    """Set and solve the equations of a Newton step; returns the largest change, J/mm^3."""
    ambient, step, temperature, theta = column.ambient, column.table_step, column.temperature, column.theta
    count, apart, link, flow, flow_slope = len(content), work.apart, work.link, work.flow, work.flow_slope
    # Heat potential and radiation of each cell, with their slopes, by the tables at its heat content.
    for i in range(count):
        place = content[i] / step
        node = min(max(int(place), 0), temperature.size - 2)
        slope = temperature[node + 1] - temperature[node]
        warm = temperature[node] + slope * (place - node)
        rise = theta[node + 1] - theta[node]
        flow[i], flow_slope[i] = theta[node] + rise * (place - node), rise / step
        work.lost[i] = column.radiating[i] * (warm**4 - ambient**4)
        work.lost_slope[i] = column.radiating[i] * 4.0 * warm**3 * (slope / step)
    for i in range(count):
        stored = work.volume[i] * (content[i] - old[i]) / time
        rest = source[i] - work.lost[i] - stored
        pivot = work.volume[i] / time + work.lost_slope[i]
        if i == 0:
            rest -= base * flow[0]
            pivot += base * flow_slope[0]
        else:
            rest -= link[i] * (flow[i] - flow[i - 1])
            pivot += link[i] * flow_slope[i]
        if i + 1 < count:
            rest -= link[i + 1] * (flow[i] - flow[i + 1])
            pivot += link[i + 1] * flow_slope[i]
            work.upper[i] = -link[i + 1] * flow_slope[i + 1]
        if i > 0:
            # What lies under the diagonal is eliminated.
            lower = -flow_slope[i - 1] / apart[i]
            factor = lower / work.diagonal[i - 1]
            pivot -= factor * work.upper[i - 1]
            rest -= factor * work.right[i - 1]
        work.diagonal[i], work.right[i] = pivot, rest
    largest = 0.0
    for i in range(count - 1, -1, -1):
        if i + 1 < count:
            work.right[i] -= work.upper[i] * work.right[i + 1]
        work.right[i] = work.right[i] / work.diagonal[i]
        largest = max(largest, abs(work.right[i]))
    return largest


# Least step of a wait, and least step over the wait so far: steps grow with the wait
FIRST_WAIT_S, WAIT_GROWTH = 1.0, 0.5


@kernel
def bed_temperature_k(content: Floats, fields: ColumnFields, under: int, top: int) -> float:
    """Mean temperature of the warmer one of the uppermost layer and that under it; NaN where a heat content is NaN, after a time
    without end for instance."""
    table, step, size, warmest = fields[0], fields[2], fields[3], 0.0
    for start, stop in ((top, len(content)), (under, top)):
        total_k, whole_mm = 0.0, 0.0
        for i in range(start, stop):
            if np.isnan(content[i]):
                return np.nan
            place = min(max(content[i] / step, 0.0), table.size - 1.0)
            node = min(int(place), table.size - 2)
            total_k += ((table[node + 1] - table[node]) * (place - node) + table[node]) * size[i]
            whole_mm += size[i]
        mean_k = total_k / whole_mm
        if mean_k > warmest:
            warmest = mean_k
    return warmest


# Time with the beam off before each bead, s, its own time, s, and the energy that the layer takes up in it, J; (n,) each
BeadTimes = tuple[Floats, Floats, Floats]


@kernel
def driven(
    content: Floats,
    fields: ColumnFields,
    under: int,
    top: int,
    beads: BeadTimes,
    limit_k: float,
    longest_s: float,
    counted: Floats,
) -> tuple[Floats, Floats]:
    """Drive beads as :meth:`HeatColumn.drive` says; `content` and `counted` (3,), the heat taken up, passed to the table, and
    radiated, J, go from their first to their last state.

    All steps are taken in here: a wait takes dozens of them, and each alone would wait for the interpreter.
    """
    off_s, time_s, energy_j = beads
    bed_k, waits_s = np.full(len(off_s), np.nan), np.zeros(len(off_s))
    bead, waiting, laying, step_s = 0, False, False, FIRST_WAIT_S
    while bead < len(off_s):
        duration_s = time_s[bead] if laying else step_s if waiting else off_s[bead]
        if duration_s > 0.0:
            power_w = energy_j[bead] / duration_s if laying else 0.0
            steps = FEW_STEPS if duration_s <= SHORT_S else STEPS
            gone = march(content, fields, top, power_w, duration_s, steps)
            counted[0] += energy_j[bead] if laying else 0.0
            counted[1] += gone[0]
            counted[2] += gone[1]
        if laying:
            bead, laying = bead + 1, False
            continue
        now_k = bed_temperature_k(content, fields, under, top)
        if waiting:
            waits_s[bead] += step_s
            step_s = max(FIRST_WAIT_S, WAIT_GROWTH * waits_s[bead])
            if waits_s[bead] > longest_s:
                break
        else:
            bed_k[bead], step_s = now_k, FIRST_WAIT_S
        waiting = now_k > limit_k
        laying = not waiting
    return bed_k, waits_s
