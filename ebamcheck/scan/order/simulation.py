"""Simulation of an order on the heat model: how warm each island is when the beam enters it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ebamcheck.heat.field import Field
from ebamcheck.heat.island_heat import IslandHeat, old_at_entries, young_at_entries
from ebamcheck.kernels import Floats, Ints
from ebamcheck.scan.filling.schedule import IslandSchedule
from ebamcheck.scan.order.entries import nearest_options


def entry_temperatures(
    heat: IslandHeat, area_mm2: Floats, order: Ints, start_s: Floats, end_s: Floats
) -> tuple[Floats, Floats]:
    """Simulate an order with times (I,) by island: the mean temperature rise (I,) of each island when the beam enters it, K, and its excess uniformity
    (I,): the spread of the temperature over the layer when the beam leaves it, without its own heat, over the mean temperature.
    """
    mean, share = heat.modes.mean, area_mm2 / area_mm2.sum()
    entry_k, excess = np.zeros(len(start_s)), np.zeros(len(start_s))
    for island, before, after in _steps(heat, order, start_s, end_s):
        entry_k[island] = before.surface() @ mean[:, island]
        before.age(end_s[island] - start_s[island])
        others, average = before.surface() @ mean, share @ (after.surface() @ mean)
        spread = np.sqrt(share @ (others - share @ others) ** 2)
        excess[island] = spread / average if average > 0.0 else 0.0
    return (entry_k if heat.near is None else _entered_k(heat, order, start_s, end_s)), excess


def entered(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats) -> tuple[Floats, Floats]:
    """Entry temperatures (I,) by island alone, K, and the amplitudes (K, N) at the end."""
    entry_k, state = np.zeros(len(start_s)), heat.start_k
    for island, before, after in _steps(heat, order, start_s, end_s):
        entry_k[island] = before.surface() @ heat.modes.mean[:, island]
        state = after.state
    return (entry_k if heat.near is None else _entered_k(heat, order, start_s, end_s)), state


def entry_points(
    heat: IslandHeat, schedule: IslandSchedule, order: Ints, start_s: Floats, end_s: Floats
) -> tuple[Floats, Floats]:
    """Mean temperature rise of each island, and that under the beam, when the beam enters it by the nearest end, (I,) K."""
    options = nearest_options(order, schedule.entry, schedule.leave)
    old_k = old_at_entries(heat, order, start_s, end_s)
    columns = heat.fresh, heat.modes.source_k_s, order, start_s, end_s, options
    means_k, points_k = young_at_entries(*columns, False)
    return old_k + means_k, old_k + points_k[np.arange(len(options)), options]


def _entered_k(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats) -> Floats:
    options = np.zeros(len(start_s), np.int64)
    young = young_at_entries(heat.fresh, heat.modes.source_k_s, order, start_s, end_s, options, False)
    return old_at_entries(heat, order, start_s, end_s) + young[0]


def _steps(
    heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats
) -> Iterator[tuple[int, Field, Field]]:
    """Go through an order: island, the heat when it is entered, and when it is left."""
    modes, clock = heat.modes, 0.0
    field = Field(heat.start_k.copy(), modes.plane_rate, modes.depth_rate, modes.in_layer)
    for island in order.tolist():
        field.age(start_s[island] - clock)
        before = field.copy()
        field.add(modes.mean[:, [island]], modes.source_k_s[[island]], end_s[[island]] - start_s[[island]])
        clock = end_s[island]
        yield island, before, field
