"""Time steps of a heat column: conduction along it, by tables over the heat content, and radiation by T^4."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import Floats, kernel

STEPS, FEW_STEPS, SHORT_S = 8, 4, 15.0
"""Time steps of a layer or a wait, growing from short ones because a heated surface follows a square root law of time; and the
fewer steps of a time no longer than SHORT_S, such as that of a bead or a move."""

NEWTON_STEPS, NEWTON_J_MM3 = 60, 1e-6
"""Most iterations of a time step, and the change of the heat content (0.3 mK) at which it has converged."""

STAGE = 1.0 - math.sqrt(0.5)
"""Share of a time step in each of its two implicit stages: second order and L-stable (Alexander, SIAM J. Numer. Anal. 14
(1977) 1006)."""

LARGEST_CHANGE_J_MM3 = 1.0
"""Largest change of the heat content in one iteration, about 300 K: melting and T^4 are too nonlinear for more."""


class Column(NamedTuple):
    """Cells of a heat column, from its base up, with the tables of their material.

    `temperature`, `theta`, `table_step`: tables of temperature, K, and heat potential, W/mm, at equal steps of the heat
    content; that step, J/mm^3; `size`, `area`: (n,) height, mm, and section, mm^2, of the cells; `radiating`: (n,) power
    that a cell radiates over T^4 - Ta^4, W/K^4; `ambient`: temperature of the chamber, K; `cooled`: whether the base is
    held at the temperature of the table; else it is insulated.
    """

    temperature: Floats
    theta: Floats
    table_step: float
    size: Floats
    area: Floats
    radiating: Floats
    ambient: float
    cooled: bool


ColumnFields = tuple[Floats, Floats, float, Floats, Floats, Floats, float, bool]
"""The fields of a :class:`Column` as a plain tuple: numba types a named tuple in Python, which costs 10 us a call."""


class _Step(NamedTuple):
    """Columns (n,) of a time step: values with their derivatives by the heat content, and the tridiagonal equations."""

    volume: Floats
    apart: Floats
    """Length over section from the middle of the cell before to that of each; of the first, from the base."""
    link: Floats
    """Heat flow from the cell before per difference of the potential: 1 / `apart`."""
    flow: Floats
    flow_slope: Floats
    lost: Floats
    lost_slope: Floats
    diagonal: Floats
    upper: Floats
    right: Floats


@kernel
def march(
    content: Floats, fields: ColumnFields, top: int, power: float, duration: float, steps: int
) -> Floats:
    """Age a column; `content` goes from the first to the last state. Returns the heat to the table and radiated, J.

    The cells from `top` up are heated by a power, W. What leaves in a step is counted as the last Newton step has
    it, whose solution balances exactly.
    """
    column = Column(*fields)
    count = len(content)
    half = 0.5 * column.size / column.area
    apart = half.copy()
    apart[1:] = half[:-1] + half[1:]
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
        # A plain division is asked whether it is by nothing, and so done one cell at a time.
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


FIRST_WAIT_S, WAIT_GROWTH = 1.0, 0.5
"""Least step of a wait, and least step over the wait so far: steps grow with the wait."""


@kernel
def bed_temperature_k(content: Floats, fields: ColumnFields, under: int, top: int) -> float:
    """Mean temperature of the warmer one of the uppermost layer and that under it; NaN where a heat content is none, after a time
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


BeadTimes = tuple[Floats, Floats, Floats]
"""Time with the beam off before each bead, s, its own time, s, and the energy that the layer takes up in it, J; (n,) each."""


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
    """Drive beads; `content` and what is `counted` (3,) go from their first to their last state.

    All steps are taken in here: a wait takes dozens of them, and each alone would wait for the interpreter.

    `content`, `fields`: as :func:`march` has them; `under`, `top`: first cell of the layer under the uppermost one, and of that;
    `limit_k`: temperature of what a bead lies on above which it is waited for; endless for no waits; `longest_s`: after a longer
    wait for one bead the rest is left out; `counted`: heat taken up, passed to the table, and radiated, J.

    Returns (n,) temperature of what each bead lies on when the beam comes to it, K, and how long it is waited for, s.
    """
    off_s, time_s, energy_j = beads
    bed_k, waits_s = np.full(len(off_s), np.nan), np.zeros(len(off_s))
    bead, waiting, laying, step_s = 0, False, False, FIRST_WAIT_S
    while bead < len(off_s):
        duration_s = time_s[bead] if laying else step_s if waiting else off_s[bead]
        if duration_s > 0.0:
            power_w = energy_j[bead] / duration_s if laying else 0.0
            gone = march(
                content, fields, top, power_w, duration_s, FEW_STEPS if duration_s <= SHORT_S else STEPS
            )
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
