"""Time steps of the referee: conduction between cells, the moving beam, radiation, evaporation and the base."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints

SPREAD = 3.0
"""Radius of the beam in standard deviations; heat beyond it is neglected."""


@kernel
def at_content(table: Floats, step: float, content: float) -> float:
    """Value of a table at a heat content."""
    place = max(content / step, 0.0)
    node = min(int(place), table.size - 2)
    return float(table[node] + (table[node + 1] - table[node]) * (place - node))


class Body(NamedTuple):
    """The part of a :class:`~ebamcheck.heat.referee.Referee` that the kernels read."""

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
    :meth:`ebamcheck.heat.referee.Referee.reading`."""

    order: Ints
    entered: Floats
    first: Ints
    cells: Ints
    weights: Floats


@kernel
def heated_by_beam(
    content: Floats, body: Body, beam: Beam, readings: Readings, times: Floats
) -> tuple[Floats, Floats]:
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
def heat_along(
    content: Floats, body: Body, beam: Beam, line: int, begin: float, end: float, balance: Floats
) -> int:
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
