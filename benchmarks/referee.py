"""The referee: a second model of a layer's heat, against which plans are judged, by explicit finite differences of the heat
content.

It shares nothing with the modes that plan: whole cells instead of cut ones, a moving beam instead of heated islands, data that
depend on temperature, heat of fusion, evaporation, and radiation by T^4. It is slower and coarser in space; it shows the error of
what the linear model neglects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.errors import GeometryError
from ebamcheck.geometry.raster import islands_in_cells, oriented_rings
from ebamcheck.heat.medium import BEAM_SHARE, STEFAN_BOLTZMANN_W_M2K4, EnthalpyTables, enthalpy_tables
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.scan.plan.columns import ScanPlan
from ebamcheck.scan.plan.comparing import OrderResult
from ebamcheck.scan.plan.laying import LaidLayer
from ebamcheck.scan.plan.stacking import scheduled, simulate_order
from ebamcheck.settings.config import Config


def beam_lines(plan: ScanPlan, config: Config) -> tuple[Floats, Floats, Floats]:
    """Lines, and turns before those that they lead to, as the beam heats them: (n, 4) x0, y0, x1, y1, mm; begin and end (n,), s
    from 0 in every layer."""
    driven = scheduled(plan, config)
    lines, turn_mm = driven[["x0", "y0", "x1", "y1"]].to_numpy(), driven["turn_mm"].to_numpy()
    begin_s, end_s = driven["begin_s"].to_numpy(), driven["end_s"].to_numpy()
    turn = np.flatnonzero(turn_mm > 0.0)
    turn_s = turn_mm[turn] / config.process.travel_speed_mm_s
    ends = np.vstack([lines, np.hstack([lines[turn - 1, 2:], lines[turn, :2]])])
    begin = np.concatenate([begin_s, begin_s[turn] - turn_s])
    end = np.concatenate([end_s, begin_s[turn]])
    # A turn is driven before the line that it leads to.
    order = np.argsort(np.concatenate([np.arange(len(lines)), turn - 0.5]), kind="stable")
    return ends[order], begin[order], end[order]


SPREAD = 3.0
"""Radius of the beam in standard deviations; heat beyond it is neglected."""


@kernel
def at_content(table: Floats, step: float, content: float) -> float:
    """Value of a table at a heat content."""
    place = max(content / step, 0.0)
    node = min(int(place), table.size - 2)
    return float(table[node] + (table[node + 1] - table[node]) * (place - node))


class Body(NamedTuple):
    """The part of a :class:`~benchmarks.referee.Referee` that the kernels read."""

    temperature: Floats
    theta: Floats
    table_step: float
    solid: Bools
    cell: Floats
    cooled: bool
    radiation: float
    ambient: float
    boiling: float


class Beam(NamedTuple):
    """Lines (V, 6) x0, y0, x1, y1, and the times at which the beam is there; power, W; standard deviation, mm."""

    lines: Floats
    power: float
    sigma: float


class Readings(NamedTuple):
    """Islands in the order in which they are entered, and when; first entry, cells and weights as of
    :meth:`benchmarks.referee.Referee.reading`."""

    order: Ints
    entered: Floats
    first: Ints
    cells: Ints
    weights: Floats


@kernel
def heated_by_beam(content: Floats, body: Body, beam: Beam, readings: Readings, times: Floats) -> tuple[Floats, Floats]:
    """March in time; `content` goes from the first to the last state.

    Returns the temperature rise of the islands, and absorbed, to the base, radiated, evaporated (J), hottest (K).
    """
    potential = np.zeros(content.shape)
    entry_k, balance = np.zeros(len(readings.entered)), np.zeros(5)
    line, read = 0, 0
    for step in range(len(times)):
        now = times[step]
        while read < len(readings.order) and readings.entered[readings.order[read]] <= now:
            island = readings.order[read]
            entry_k[island] = _read(content, body, readings, island)
            read += 1
        if step == len(times) - 1:
            break
        step_s = times[step + 1] - now
        _set_potential(content, body, potential)
        # Radiation and the base see the temperatures at the beginning of the step, as conduction does.
        _lose(content, body, potential, step_s, balance)
        conduct(content, potential, body.solid, step_s / body.cell**2)
        line = heat_along(content, body, beam, line, now, now + step_s, balance)
    return entry_k, balance


@kernel
def _read(content: Floats, body: Body, readings: Readings, island: int) -> float:
    """Mean temperature rise of the cells of an island."""
    columns, rise = body.solid.shape[1], 0.0
    for m in range(readings.first[island], readings.first[island + 1]):
        row, column = readings.cells[m] // columns, readings.cells[m] % columns
        warm = at_content(body.temperature, body.table_step, content[0, row, column])
        rise += readings.weights[m] * (warm - body.ambient)
    return rise


@kernel
def _set_potential(content: Floats, body: Body, potential: Floats) -> None:
    layers, rows, columns = content.shape
    for z in range(layers):
        for row in range(rows):
            for column in range(columns):
                if body.solid[row, column]:
                    here = at_content(body.theta, body.table_step, content[z, row, column])
                    potential[z, row, column] = here


@kernel
def _lose(content: Floats, body: Body, potential: Floats, step_s: float, balance: Floats) -> None:
    """Take away what evaporates, radiates from the surface, and passes the base in a step."""
    layers, rows, columns = content.shape
    face, depth = body.cell[0] * body.cell[1], body.cell[2]
    volume = body.cell[0] * body.cell[1] * body.cell[2]
    for row in range(rows):
        for column in range(columns):
            if not body.solid[row, column]:
                continue
            surplus = content[0, row, column] - body.boiling
            if surplus > 0.0:
                content[0, row, column] = body.boiling
                balance[3] += surplus * volume
            warm = at_content(body.temperature, body.table_step, content[0, row, column])
            balance[4] = max(balance[4], warm)
            lost = body.radiation * (warm**4 - body.ambient**4) * face * step_s
            content[0, row, column] -= lost / volume
            balance[2] += lost
            if body.cooled:
                # The base lies half a cell under the last centre.
                passed = 2.0 * potential[layers - 1, row, column] / depth * face * step_s
                content[layers - 1, row, column] -= passed / volume
                balance[1] += passed


@kernel
def conduct(content: Floats, potential: Floats, solid: Bools, over: Floats) -> None:
    """Let heat pass every face between two cells of metal."""
    layers, rows, columns = content.shape
    for z in range(layers):
        for row in range(rows):
            for column in range(columns):
                if not solid[row, column]:
                    continue
                here = potential[z, row, column]
                if column + 1 < columns and solid[row, column + 1]:
                    passed = over[0] * (here - potential[z, row, column + 1])
                    content[z, row, column] -= passed
                    content[z, row, column + 1] += passed
                if row + 1 < rows and solid[row + 1, column]:
                    passed = over[1] * (here - potential[z, row + 1, column])
                    content[z, row, column] -= passed
                    content[z, row + 1, column] += passed
                if z + 1 < layers:
                    passed = over[2] * (here - potential[z + 1, row, column])
                    content[z, row, column] -= passed
                    content[z + 1, row, column] += passed


@kernel
def heat_along(content: Floats, body: Body, beam: Beam, line: int, begin: float, end: float, balance: Floats) -> int:
    """Add what the beam brings from one time to another; returns the line that it is on."""
    lines, cell = beam.lines, body.cell
    volume = cell[0] * cell[1] * cell[2]
    while line < len(lines):
        starts, ends = lines[line, 4], lines[line, 5]
        low, high = max(starts, begin), min(ends, end)
        if high > low:
            share = (0.5 * (low + high) - starts) / (ends - starts)
            x = lines[line, 0] + share * (lines[line, 2] - lines[line, 0])
            y = lines[line, 1] + share * (lines[line, 3] - lines[line, 1])
            heat = beam.power * (high - low) / volume
            reach = beam.sigma / cell[:2]
            balance[0] += volume * spread(content, body.solid, x / cell[0], y / cell[1], reach, heat)
        if ends > end:
            break
        line += 1
    return line


@kernel
def spread(content: Floats, solid: Bools, x: float, y: float, reach: Floats, heat: float) -> float:
    """Add heat to the surface as a Gaussian around a place; all of it where no cell is in reach to the nearest.

    `reach` (2,) is its standard deviation in cells, as `x` and `y` are. Returns what was added, which is all of it.
    """
    rows, columns = solid.shape
    far_x, far_y = SPREAD * reach[0] + 1.0, SPREAD * reach[1] + 1.0
    total = 0.0
    for turn in range(2):
        for r in range(max(int(y - far_y), 0), min(int(y + far_y) + 1, rows)):
            for c in range(max(int(x - far_x), 0), min(int(x + far_x) + 1, columns)):
                if not solid[r, c]:
                    continue
                away = ((c + 0.5 - x) / reach[0]) ** 2 + ((r + 0.5 - y) / reach[1]) ** 2
                weight = np.exp(-0.5 * away)
                if turn == 0:
                    total += weight
                else:
                    content[0, r, c] += heat * weight / total
        if total <= 0.0:
            break
    if total > 0.0:
        return heat
    nearest, best_row, best_column = np.inf, 0, 0
    for r in range(rows):
        for c in range(columns):
            away = (c + 0.5 - x) ** 2 + (r + 0.5 - y) ** 2
            if solid[r, c] and away < nearest:
                nearest, best_row, best_column = away, r, c
    content[0, best_row, best_column] += heat
    return heat


STABLE = 0.9
"""Time step over the longest stable one."""


@dataclass(frozen=True, eq=False)
class Referee:
    """A section extruded to its base, in box-shaped cells, from the surface (index 0) down to the base."""

    origin: Floats  # (2,) lower left corner, mm
    cell_mm: Floats  # (3,) width, depth and height of a cell
    solid: Bools  # (rows, columns) whether a vertical column of cells is metal
    layers: int
    cooled: bool  # whether the base is held at the ambient temperature; else it is insulated
    tables: EnthalpyTables
    radiation_w_mm2k4: float  # heat flux that the surface radiates, over T^4 - Ta^4
    ambient_k: float  # of the chamber, and at the beginning
    sigma_mm: float  # standard deviation of the beam's heat
    boiling_j_mm3: float  # heat content at the boiling point: any excess leaves the surface as vapour

    @property
    def longest_step_s(self) -> float:
        """Longest time step: :data:`STABLE` times the longest stable one."""
        rate = 2.0 * self.tables.greatest_diffusivity_mm2_s * float((1.0 / self.cell_mm**2).sum())
        return STABLE / rate

    @property
    def body(self) -> Body:
        """The body in the form that the kernels of the time steps read."""
        tables = self.tables
        return Body(
            tables.temperature_k, tables.theta_w_mm, tables.step_j_mm3, self.solid, self.cell_mm, self.cooled,
            self.radiation_w_mm2k4, self.ambient_k, self.boiling_j_mm3,
        )  # fmt: skip

    def cold(self) -> Floats:
        """Heat content (layers, rows, columns) of a body at the ambient temperature, J/mm^3."""
        return np.zeros((self.layers, *self.solid.shape))

    def stored_j(self, content: Floats) -> float:
        """Heat in the body above that at ambient temperature."""
        return float(content[:, self.solid].sum() * self.cell_mm.prod())

    def reading(self, islands: NDArray[np.object_]) -> tuple[Ints, Ints, Floats]:
        """Cells of the surface that make up islands: first entry of each island (I + 1,), cells, weights."""
        points, (rings, first_ring) = oriented_rings(islands, self.origin, self.cell_mm[:2])
        owner, cell, share = islands_in_cells(points, rings, first_ring, self.solid.shape)
        kept = (share > 0.0) & self.solid.ravel()[cell]
        owner, cell, share = owner[kept], cell[kept], share[kept]
        total = np.bincount(owner, share, len(islands))
        first = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(islands)))])
        return first.astype(np.int64), cell, share / total[owner]


@dataclass(frozen=True, eq=False)
class Verdict:
    """Temperatures and energy balance of a simulation by the referee."""

    entry_k: Floats  # (I,) mean rise above ambient of each island when the beam enters it; NaN for one without cells
    content: Floats  # heat content at the end, (layers, rows, columns) J/mm^3
    absorbed_j: float
    to_base_j: float
    radiated_j: float
    evaporated_j: float
    hottest_k: float  # greatest temperature reached


def referee(section: BaseGeometry, config: Config, height_mm: float, cell_mm: float) -> Referee:
    """Lay cells of about the given width over a section; an error if no cell lies in it."""
    x0, y0, x1, y1 = section.bounds
    columns, rows = max(1, round((x1 - x0) / cell_mm)), max(1, round((y1 - y0) / cell_mm))
    depth_mm = max(height_mm, 0.0) + config.process.base_plate_mm
    layers = max(2, round(depth_mm / cell_mm))
    cell = np.array([(x1 - x0) / columns, (y1 - y0) / rows, depth_mm / layers])
    x, y = np.meshgrid(x0 + np.arange(columns) * cell[0], y0 + np.arange(rows) * cell[1])
    boxes = shapely.box(x, y, x + cell[0], y + cell[1])
    solid = shapely.area(shapely.intersection(boxes, section)) >= 0.5 * cell[0] * cell[1]
    if not solid.any():
        raise GeometryError(f"the section has no room for a cell of {cell_mm:g} mm: give smaller cells")
    tables = enthalpy_tables(config)
    return Referee(
        origin=np.array([x0, y0]),
        cell_mm=cell,
        solid=np.asarray(solid, np.bool_),
        layers=layers,
        cooled=config.process.base == "cooled",
        tables=tables,
        radiation_w_mm2k4=1e-6 * config.material.emissivity * STEFAN_BOLTZMANN_W_M2K4,
        ambient_k=config.process.ambient_temperature_k,
        sigma_mm=BEAM_SHARE * config.process.bead_width_mm,
        boiling_j_mm3=float(tables.heat_content(config.material.boiling_k)),
    )


def judged(
    model: Referee, content: Floats, lines: Floats, begin_s: Floats, end_s: Floats, power_w: float,
    islands: NDArray[np.object_], entered_s: Floats, until_s: float,
) -> Verdict:  # fmt: skip
    """Move a beam along lines, and read the temperature of islands when the beam enters them.

    `content` is that at the beginning; lines (V, 4) x0, y0, x1, y1 in the sequence in which they are driven, mm, with the times (V,)
    at their ends; islands (I,) with the times (I,) at which they are read; the power is what is absorbed.
    """
    first, cells, weights = model.reading(islands)
    readings = np.argsort(entered_s, kind="stable")
    times_s = time_steps(until_s, model.longest_step_s, entered_s)
    state = content.copy()
    path = np.column_stack([lines - np.tile(model.origin, 2), begin_s, end_s])
    read = Readings(readings.astype(np.int64), np.asarray(entered_s, np.float64), first, cells, weights)
    entry_k, balance = heated_by_beam(state, model.body, Beam(path, power_w, model.sigma_mm), read, times_s)
    entry_k[np.diff(first) == 0] = np.nan
    return Verdict(entry_k, state, *balance.tolist())


def time_steps(until_s: float, longest_s: float, entered_s: Floats) -> Floats:
    """Times (n + 1,) of the steps, from 0 to the end: equally spaced ones, and those at which islands are read.

    An island is read exactly when it is entered: half a step later it would hold heat from its own pass of the beam.
    """
    steps = max(1, math.ceil(until_s / longest_s))
    even = np.linspace(0.0, until_s, steps + 1)
    return np.union1d(even, np.clip(entered_s, 0.0, until_s))


def second_opinion(model: Referee, result: OrderResult, config: Config) -> dict[str, float]:
    """Simulate a compared order on the referee of its layer as well.

    Greatest rise at entry of an island (mean) and of the spot where the beam enters it, K; Kendall's rank correlation of the islands'
    rises, linear model against referee, NaN where fewer than two islands are warmed before they are entered.
    """
    # Half a second to load, for those who compare orders.
    from scipy.stats import kendalltau

    islands_k, spots_k = refereed_entries(model, result.plan, config)
    warmed = (result.rank > 0) & np.isfinite(islands_k)
    enough = int(warmed.sum()) > 1
    tau = float(kendalltau(result.entry_k[warmed], islands_k[warmed]).statistic) if enough else math.nan
    return {
        "referee_max_k": float(np.nanmax(islands_k)),
        "referee_point_max_k": float(np.nanmax(spots_k)),
        "referee_tau": tau,
    }


def referee_of(laid: LaidLayer, config: Config, cells_per_island: float = 4.0) -> Referee:
    """Set up the referee of a layer that has islands."""
    section = laid.regions.section
    width_mm = math.sqrt(section.area / len(laid.islands))
    return referee(section, config, laid.height_mm, width_mm / cells_per_island)


def refereed_entries(model: Referee, plan: ScanPlan, config: Config) -> tuple[Floats, Floats]:
    """Temperature rise of each island, and of a spot as wide as a bead where the beam enters it, (I,) K; NaN without lines."""
    first = plan.vectors.drop_duplicates("island")
    island = first["island"].to_numpy()
    spots = shapely.buffer(shapely.points(first[["x0", "y0"]].to_numpy(np.float64)), 0.5 * config.process.bead_width_mm)
    starts = simulate_order(plan, config).sort_values("island")["start_s"].fillna(0.0)
    entered_s, count = starts.to_numpy(np.float64), len(plan.islands)
    read = np.concatenate([plan.islands, spots])
    ends, begin_s, end_s = beam_lines(plan, config)
    power_w, until_s = (
        config.process.power_w * config.material.absorptivity,
        float(end_s[-1]) if len(end_s) else 0.0,
    )
    times_s = np.concatenate([entered_s, entered_s[island]])
    entry_k = judged(model, model.cold(), ends, begin_s, end_s, power_w, read, times_s, until_s).entry_k
    point_k = np.full(count, np.nan)
    point_k[island] = entry_k[count:]
    return entry_k[:count], point_k
