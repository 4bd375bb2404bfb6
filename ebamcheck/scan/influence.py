"""What each island leaves in each other one, over the time since: the heat model of a layer as one table.

An order is tried thousands of times when it is improved; with the table, the temperature at which an island is
entered is a sum over the islands before it, whatever the number of modes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import kernel
from ebamcheck.rings import Floats
from ebamcheck.scan.island_heat import IslandHeat
from ebamcheck.scan.near_field import NearField, fresh_rise
from ebamcheck.scan.pieces import WAYS

NODES = 96
"""Times of the table. Their spacing grows with the time, as heat changes ever more slowly: node n lies at n^2."""

FRESH_NODES = 12
"""Times of the table of fresh heat, until its horizon."""

MOST_ISLANDS = 500
"""Beyond, the table is too large: 500 islands take 96 MB."""

Table = NDArray[np.float32]


class FreshTable(NamedTuple):
    """What fresh heat adds to the rises of islands that are near each other.

    Parameters
    ----------
    horizon_s
        Time after which it is nothing; node n of N lies at horizon (n / (N - 1))^2.
    slot
        (I, I) row of the next tables for an island and the source, or -1.
    mean_k
        (P, N) to the mean of the island.
    entry_k
        (P, 4, 4, N) to the temperature of its entry, by its way and that of the source.
    """

    horizon_s: float
    slot: NDArray[np.int32]
    mean_k: Table
    entry_k: Table


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
    fresh
        What the modes lack.
    """

    rise_k: Table
    nodes_per_root_s: float
    fresh: FreshTable


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
    since = spacing * np.arange(NODES) ** 2
    rate = np.add.outer(heat.plane_rate, heat.depth_rate)
    across = np.exp(-np.multiply.outer(heat.plane_rate, since))
    through = np.exp(-np.multiply.outer(heat.depth_rate, since))
    count, mean = len(time_s), np.asarray(heat.mean, np.float32)
    rise = np.empty((count, count + 1, NODES), np.float32)
    still = rate <= 0.0
    per_s = 1.0 / np.where(still, 1.0, rate)
    for j, (time, source) in enumerate(zip(time_s.tolist(), heat.source_k_s.tolist(), strict=True)):
        held = np.where(still, time, -np.expm1(-rate * time) * per_s)
        of_mode = heat.mean[:, j, None] * across * (((source * heat.in_layer**2) * held) @ through)
        rise[:, j] = mean.T @ of_mode.astype(np.float32)
    rise[:, count] = heat.mean.T @ (across * ((heat.start_k * heat.in_layer) @ through))
    per_root = spacing**-0.5 if spacing > 0.0 else 0.0
    slot = np.full((count, count), -1, np.int32)
    near = heat.fresh
    slot[np.repeat(np.arange(count), np.diff(near.first)), near.other] = np.arange(len(near.other))
    mean_k, entry_k = fresh_table(near, heat.source_k_s, time_s)
    return Influence(rise, per_root, FreshTable(near.horizon_s, slot, mean_k, entry_k))


@kernel
def fresh_table(near: NearField, source: Floats, time: Floats) -> tuple[Table, Table]:
    """Return the last two columns of :class:`FreshTable`."""
    rows = len(near.other)
    mean = np.zeros((rows, FRESH_NODES), np.float32)
    entry = np.zeros((rows, WAYS, WAYS, FRESH_NODES), np.float32)
    for i in range(len(near.first) - 1):
        for p in range(near.first[i], near.first[i + 1]):
            j, pair = near.other[p], near.pair[p]
            if i == j:
                continue
            for n in range(FRESH_NODES):
                since = near.horizon_s * (n / (FRESH_NODES - 1)) ** 2
                for way in range(WAYS):
                    for left_by in range(WAYS):
                        fresh = fresh_rise(near, pair, i, way, j, left_by, since, time[j])
                        mean[p, n] = source[j] * fresh[0]
                        entry[p, way, left_by, n] = source[j] * fresh[1]
    return mean, entry


@kernel
def looked_up(rise: Table, nodes: float, island: int, source: int, since: float) -> float:
    """Rise of an island by a source a time after its end, linear between nodes in the root of the time."""
    place = nodes * np.sqrt(max(since, 0.0))
    node = min(int(place), rise.shape[2] - 2)
    share = min(place - node, 1.0)
    low, high = rise[island, source, node], rise[island, source, node + 1]
    return float(low + (high - low) * share)
