"""Pictures of ``ebamcheck scan``: ranks, temperatures, the orders side by side, and the layer being scanned."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ebamcheck.heat import ContourModes
from ebamcheck.rings import Floats
from ebamcheck.scan.animation import layer_animation
from ebamcheck.scan.comparing import OrderComparison, OrderResult
from ebamcheck.scan.driving import entered
from ebamcheck.scan.history import island_history
from ebamcheck.scan.island_heat import IslandHeat
from ebamcheck.scan.pareto_svg import pareto_svg
from ebamcheck.scan.scan_svg import field_svg, islands_svg

COMMON = 0.9
"""Share of the cells whose temperatures the colours of the last field tell apart: the last islands are far hotter."""


def order_pictures(
    compared: OrderComparison, results: Mapping[str, OrderResult], what: str
) -> dict[str, str]:
    """Texts by file name: two maps an order, its last temperatures and its animation.

    Scales of temperature are the same for all orders; those of entries end at the hottest of them, what the beam is
    on is hotter yet.
    """
    islands = compared.laid.islands
    files = {}
    for name, result in results.items():
        rank = result.rank.astype(np.float64)
        files[f"{name}-rank.svg"] = islands_svg(islands, rank, f"{what}: rank, {name}", labels=True)
    if compared.heat is None:
        return files
    hottest = max(float(result.entry_k.max()) for result in results.values())
    plane = compared.heat.model.plane
    if not isinstance(plane, ContourModes):
        return files
    at_end = {name: _at_end(compared.heat, plane, result) for name, result in results.items()}
    warmest = max(float(np.quantile(last_k, COMMON)) for last_k in at_end.values())
    for name, result in results.items():
        title = f"{what}: entry temperature rise, {name}"
        files[f"{name}-entry.svg"] = islands_svg(
            islands, result.entry_k, title, " K", 0.0, hottest, labels=True
        )
        title = f"{what}: temperature rise when the layer is done, {name} (hottest {1 - COMMON:.0%} in one colour)"
        section = compared.laid.regions.section
        files[f"{name}-field.svg"] = field_svg(plane.grid, at_end[name], section, title, " K", warmest)
        order = np.argsort(result.rank)
        history = island_history(compared.heat, order, result.start_s, result.end_s)
        files[f"{name}.html"] = layer_animation(
            islands, order, result.end_s, history, f"{what}, {name}", hottest
        )
    figures = {name: (result.travel_mm, float(result.entry_k.max())) for name, result in results.items()}
    files["pareto.svg"] = pareto_svg(figures, f"{what}: {len(islands)} islands")
    return files


def _at_end(heat: IslandHeat, plane: ContourModes, result: OrderResult) -> Floats:
    """Temperature rise in the cells of the section when an order is done, (M,)."""
    _, state = entered(heat, np.argsort(result.rank), result.start_s, result.end_s)
    return np.asarray(plane.values @ (state @ heat.in_layer), np.float64)
