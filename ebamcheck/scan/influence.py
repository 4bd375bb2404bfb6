"""What each island leaves in each other one, over the time since: the heat model of a layer as one table.

An order is tried thousands of times when it is improved; with the table, the temperature at which an island is
entered is a sum over the islands before it, whatever the number of modes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import kernel
from ebamcheck.rings import Floats
from ebamcheck.scan.island_heat import IslandHeat

NODES = 96
"""Times of the table. Their spacing grows with the time, as heat changes ever more slowly: node n lies at n^2."""

MOST_ISLANDS = 500
"""Beyond, the table is too large: 500 islands take 96 MB."""

Table = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Influence:
    """Temperature rises by islands and times.

    Parameters
    ----------
    rise_k
        (I, I + 1, Q) mean rise of an island by another one that was scanned from cold, a time after its end;
        the last column is what the layer's first temperature leaves, a time after the beginning.
    nodes_per_root_s
        A time t lies at node nodes_per_root_s sqrt(t).
    """

    rise_k: Table
    nodes_per_root_s: float


def influence(heat: IslandHeat, time_s: Floats, longest_s: float) -> Influence:
    """Tabulate the heat model of a layer.

    Parameters
    ----------
    time_s
        (I,) time in which each island is scanned.
    longest_s
        Longest time between two islands.
    """
    spacing = longest_s / (NODES - 1) ** 2
    rate = np.add.outer(heat.plane_rate, heat.depth_rate)
    fall = np.exp(-rate[:, :, None] * (spacing * np.arange(NODES) ** 2))
    count = len(time_s)
    rise = np.empty((count, count + 1, NODES), np.float32)
    still = rate <= 0.0
    per_s = 1.0 / np.where(still, 1.0, rate)
    for j, (time, source) in enumerate(zip(time_s.tolist(), heat.source_k_s.tolist(), strict=True)):
        held = np.where(still, time, -np.expm1(-rate * time) * per_s)
        of_mode = ((source * heat.in_layer**2) * held)[:, None, :] @ fall
        rise[:, j] = (heat.mean * heat.mean[:, j : j + 1]).T @ of_mode[:, 0]
    rise[:, count] = heat.mean.T @ ((heat.start_k * heat.in_layer)[:, None, :] @ fall)[:, 0]
    return Influence(rise, spacing**-0.5 if spacing > 0.0 else 0.0)


@kernel
def looked_up(rise: Table, nodes: float, island: int, source: int, since: float) -> float:
    """Rise of an island by a source a time after its end, linear between nodes in the root of the time."""
    place = nodes * np.sqrt(max(since, 0.0))
    node = min(int(place), rise.shape[2] - 2)
    share = min(place - node, 1.0)
    low, high = rise[island, source, node], rise[island, source, node + 1]
    return float(low + (high - low) * share)
