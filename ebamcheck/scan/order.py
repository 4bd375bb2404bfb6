"""Orders in which the islands of a layer are scanned, by name.

The paper's sentence (section 4.2) takes next the island whose distance "to all processed centroids is
the smallest". That has three readings, all of them here:

=============== ==============================================================================
``nearest-any`` distance to the nearest processed centroid (min-min); ``nearest`` is this one
``nearest-last`` distance to the centroid processed last
``nearest-sum`` sum of the distances to all processed centroids
=============== ==============================================================================

Whichever is taken, it contradicts the paper's aim (its conclusion: "increase the molding time interval
of adjacent regions"), since the nearest island is a neighbour that is still hot. ``farthest`` does the
opposite; ``raster`` is what a machine does without a strategy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import kernel
from ebamcheck.rings import Floats, Ints

LAST, ANY, SUM, FARTHEST = 0, 1, 2, 3
"""Rules of :func:`greedy`."""

TIE_MM = 1e-6
"""Distances closer than this are equal: a lattice is full of ties, which rounding must not decide."""


@dataclass(frozen=True, eq=False)
class LayerIslands:
    """What an order may know of the islands of one layer.

    Parameters
    ----------
    centroid
        (I, 2) mm.
    area_mm2
        (I,).
    neighbours
        (P, 2) pairs of islands with a common border.
    layer
        Index of the layer.
    seed
        Seed of the run; :meth:`random` mixes the layer into it.
    """

    centroid: Floats
    area_mm2: Floats
    neighbours: Ints
    layer: int = 0
    seed: int = 0

    def __len__(self) -> int:
        """Return the number of islands."""
        return len(self.centroid)

    def random(self) -> np.random.Generator:
        """Random numbers of this layer, the same whenever it is planned."""
        return np.random.default_rng((self.seed, self.layer))


Order = Callable[[LayerIslands], Ints]
"""An order: from the islands of a layer, a permutation (I,) of their indices."""


def scan_order(name: str, islands: LayerIslands) -> Ints:
    """Order the islands of a layer, (I,) indices.

    Raises
    ------
    SettingsError
        If there is no order of that name.
    """
    if name not in ORDERS:
        raise SettingsError(f"scan.order {name!r} is unknown: choose one of {', '.join(ORDERS)}")
    if not len(islands):
        return np.zeros(0, np.int64)
    return ORDERS[name](islands)


def _seeded_start(islands: LayerIslands) -> int:
    """Index of the first island: random, as in the paper, but seeded."""
    return int(islands.random().integers(len(islands)))


def nearest_any(islands: LayerIslands) -> Ints:
    """Next the island nearest to any processed one."""
    return greedy(islands.centroid, _seeded_start(islands), ANY)


def nearest_last(islands: LayerIslands) -> Ints:
    """Next the island nearest to the one processed last."""
    return greedy(islands.centroid, _seeded_start(islands), LAST)


def nearest_sum(islands: LayerIslands) -> Ints:
    """Next the island with the least sum of distances to all processed ones."""
    return greedy(islands.centroid, _seeded_start(islands), SUM)


def farthest(islands: LayerIslands) -> Ints:
    """Next the island farthest from its nearest processed one (max-min)."""
    return greedy(islands.centroid, _seeded_start(islands), FARTHEST)


def raster(islands: LayerIslands) -> Ints:
    """Row by row from below, alternating in direction; a row is as high as an average island is wide."""
    pitch = float(np.sqrt(islands.area_mm2.mean()))
    y = islands.centroid[:, 1] - islands.centroid[:, 1].min()
    row = np.floor(y / pitch + 0.5) if pitch > 0 else np.zeros(len(islands))
    x = np.where(row % 2 == 0, islands.centroid[:, 0], -islands.centroid[:, 0])
    return np.lexsort((np.arange(len(islands)), x, row)).astype(np.int64)


@kernel
def greedy(centroid: Floats, first: int, rule: int) -> Ints:
    """Take islands one by one by their distance to those taken; among equal ones, the first."""
    count = len(centroid)
    order = np.empty(count, np.int64)
    taken = np.zeros(count, np.bool_)
    score = np.zeros(count) if rule == SUM else np.full(count, np.inf)
    current = first
    for n in range(count):
        order[n] = current
        taken[current] = True
        x, y = centroid[current, 0], centroid[current, 1]
        following = -1
        for i in range(count):
            if taken[i]:
                continue
            distance = np.hypot(centroid[i, 0] - x, centroid[i, 1] - y)
            if rule == LAST:
                score[i] = distance
            elif rule == SUM:
                score[i] += distance
            else:
                score[i] = min(score[i], distance)
            better = following < 0 or (
                score[i] > score[following] + TIE_MM
                if rule == FARTHEST
                else score[i] < score[following] - TIE_MM
            )
            if better:
                following = i
        current = following
    return order


ORDERS: Mapping[str, Order] = {
    "nearest": nearest_any,
    "nearest-any": nearest_any,
    "nearest-last": nearest_last,
    "nearest-sum": nearest_sum,
    "farthest": farthest,
    "raster": raster,
}
"""Orders by name."""
