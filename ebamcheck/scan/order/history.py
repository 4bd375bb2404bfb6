"""Temperature of every island over the time in which a layer is scanned, for pictures."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.heat.island_heat import IslandHeat
from ebamcheck.scan.order.simulation import at_surface, decay, field, heat_island


def island_history(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats) -> Floats:
    """Mean temperature rises (I, I) K: a row for the end of each island in scan order, a column an island."""
    mean, plane_rate, depth_rate, in_layer, source = heat.columns
    state = heat.start_k.copy()
    rows = np.empty((len(order), mean.shape[1]))
    clock = 0.0
    for n, island in enumerate(order.tolist()):
        duration = end_s[island] - start_s[island]
        decay(state, plane_rate, depth_rate, start_s[island] - clock + duration)
        own = np.ascontiguousarray(mean[:, island])
        heat_island(state, own, plane_rate, depth_rate, in_layer, source[island], duration)
        rows[n] = field(mean, at_surface(state, plane_rate, depth_rate, in_layer, 0.0))
        clock = float(end_s[island])
    return rows
