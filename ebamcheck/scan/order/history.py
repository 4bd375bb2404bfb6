"""Temperature of every island over the time in which a layer is scanned, for pictures."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.heat.amplitudes import at_surface, decay, field, heat_island
from ebamcheck.scan.heat.island_heat import IslandHeat


def island_history(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats) -> Floats:
    """Mean temperature rises (I, I) K: a row for the end of each island in scan order, a column an island."""
    modes = heat.modes
    state = heat.start_k.copy()
    rows = np.empty((len(order), len(modes.source_k_s)))
    clock = 0.0
    for n, island in enumerate(order.tolist()):
        duration = end_s[island] - start_s[island]
        decay(state, modes, start_s[island] - clock + duration)
        heat_island(state, modes, island, duration)
        rows[n] = field(modes, at_surface(state, modes))
        clock = float(end_s[island])
    return rows
