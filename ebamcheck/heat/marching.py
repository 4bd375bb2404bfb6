"""The steps of time of a heat column: conduction along it, by tables over the heat content, and radiation by T^4."""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

NEWTON_STEPS, NEWTON_J_MM3 = 60, 1e-6
"""Iterations of a time step at most, and the change of the heat content (0.3 mK) at which it has converged."""

STAGE = 1.0 - math.sqrt(0.5)
"""Share of a time step in each of its two implicit stages, which makes it of second order and damp what is fast
(Alexander, SIAM J. Numer. Anal. 14 (1977) 1006)."""

LARGEST_CHANGE_J_MM3 = 1.0
"""Change of the heat content in one iteration at most, about 300 K: melting and T^4 are bent too much for more."""


@kernel
def looked_up(table: Floats, step: float, content: float) -> tuple[float, float]:
    """Value of a table at a heat content, and its slope there."""
    place = content / step
    node = min(max(int(place), 0), table.size - 2)
    slope = table[node + 1] - table[node]
    return table[node] + slope * (place - node), slope / step


@kernel
def march(
    content: Floats,
    temperature: Floats,
    theta: Floats,
    table_step: float,
    size: Floats,
    area: Floats,
    radiating: Floats,
    ambient: float,
    cooled: bool,
    top: int,
    power: float,
    duration: float,
    steps: int,
) -> Floats:
    """Age a column; `content` goes from the first to the last state. Returns the heat to the table and radiated, J.

    What leaves in a step is counted as the last Newton step has it, whose solution balances exactly.
    """
    count = len(content)
    volume, half = size * area, 0.5 * size / area
    heated = volume[top:].sum()
    gone = np.zeros(2)
    warm, warm_slope = np.empty(count), np.empty(count)
    flow, flow_slope = np.empty(count), np.empty(count)
    lost, lost_slope = np.empty(count), np.empty(count)
    diagonal, upper, right = np.empty(count), np.empty(count), np.empty(count)
    base = 1.0 / half[0] if cooled else 0.0
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
            for i in range(count):
                warm[i], warm_slope[i] = looked_up(temperature, table_step, content[i])
                flow[i], flow_slope[i] = looked_up(theta, table_step, content[i])
                lost[i] = radiating[i] * (warm[i] ** 4 - ambient**4)
                lost_slope[i] = radiating[i] * 4.0 * warm[i] ** 3 * warm_slope[i]
            for i in range(count):
                source = power * volume[i] / heated if i >= top else 0.0
                rest = source - lost[i] - volume[i] * (content[i] - old[i]) / time
                pivot = volume[i] / time + lost_slope[i]
                if i == 0:
                    rest -= base * flow[0]
                    pivot += base * flow_slope[0]
                else:
                    link = 1.0 / (half[i - 1] + half[i])
                    rest -= link * (flow[i] - flow[i - 1])
                    pivot += link * flow_slope[i]
                if i + 1 < count:
                    link = 1.0 / (half[i] + half[i + 1])
                    rest -= link * (flow[i] - flow[i + 1])
                    pivot += link * flow_slope[i]
                    upper[i] = -link * flow_slope[i + 1]
                if i > 0:
                    lower = -flow_slope[i - 1] / (half[i - 1] + half[i])
                    factor = lower / diagonal[i - 1]
                    pivot -= factor * upper[i - 1]
                    rest -= factor * right[i - 1]
                diagonal[i], right[i] = pivot, rest
            largest = 0.0
            for i in range(count - 1, -1, -1):
                if i + 1 < count:
                    right[i] -= upper[i] * right[i + 1]
                right[i] /= diagonal[i]
                largest = max(largest, abs(right[i]))
            last = largest < NEWTON_J_MM3 or turn == NEWTON_STEPS - 1
            # All cells change alike, so that the balance holds along the way; the last step is a whole one.
            share = 1.0 if last else min(1.0, LARGEST_CHANGE_J_MM3 / largest)
            for i in range(count):
                content[i] += share * right[i]
            if last:
                break
        weight = STAGE if stage else 1.0 - STAGE
        gone[0] += weight * whole * base * (flow[0] + flow_slope[0] * right[0])
        for i in range(count):
            gone[1] += weight * whole * (lost[i] + lost_slope[i] * right[i])
    return gone
