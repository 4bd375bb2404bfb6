"""Pictures of ``ebamcheck scan``: ranks, temperatures, the orders side by side, and the layer being scanned."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ebamcheck.drawing.animation import layer_animation
from ebamcheck.drawing.islands import field_svg, islands_svg
from ebamcheck.drawing.orders import pareto_svg
from ebamcheck.drawing.scene import Scene, TemperatureScale
from ebamcheck.heat import ContourModes
from ebamcheck.heat.island_heat import IslandHeat
from ebamcheck.numeric.rings import Floats
from ebamcheck.scan.order.simulation import entered, island_history
from ebamcheck.scan.plan.comparing import OrderComparison, OrderResult

COMMON = 0.9
"""Share of the cells whose temperatures the colours of the last field tell apart, at least: the last islands are far
hotter."""


def order_pictures(
    compared: OrderComparison,
    results: Mapping[str, OrderResult],
    figures: Mapping[str, tuple[float, float]],
    what: str,
) -> dict[str, str]:
    """Texts by file name: two maps an order, its last temperatures and its animation.

    All show the same frame with contour beads and path, and all temperatures of all orders have one scale: it ends at
    the hottest entry or at what most of a finished layer is under, whichever is more, and at the boiling point at last.

    Parameters
    ----------
    results
        What is drawn of each order: of one that was planned with several seeds, the first plan.
    figures
        Travel and greatest entry temperature of each order, as the table has them.
    """
    islands, section = compared.laid.islands, compared.laid.regions.section
    scenes = {name: Scene.of(section, result.plan) for name, result in results.items()}
    files = {}
    for name, result in results.items():
        rank = result.rank.astype(np.float64)
        files[f"{name}-rank.svg"] = islands_svg(
            islands, rank, f"{what}: rank, {name}", labels=True, scene=scenes[name]
        )
    if compared.heat is None:
        return files
    plane = compared.heat.model.plane
    if not isinstance(plane, ContourModes):
        return files
    at_end = {name: _at_end(compared.heat, plane, result) for name, result in results.items()}
    hottest = max(float(result.entry_k.max()) for result in results.values())
    warmest = max(float(np.quantile(last_k, COMMON)) for last_k in at_end.values())
    scale = TemperatureScale.of(compared.config, max(hottest, warmest))
    for name, result in results.items():
        title = f"{what}: entry temperature rise, {name}"
        files[f"{name}-entry.svg"] = islands_svg(
            islands, result.entry_k, title, " K", labels=True, scene=scenes[name], temperatures=scale
        )
        title = f"{what}: temperature rise when the layer is done, {name}"
        files[f"{name}-field.svg"] = field_svg(
            plane.grid, at_end[name], section, title, " K", scale.greatest, scenes[name], scale
        )
        order = np.argsort(result.rank)
        history = island_history(compared.heat, order, result.start_s, result.end_s)
        files[f"{name}.html"] = layer_animation(
            islands, order, result.end_s, history, f"{what}, {name}", scale, scenes[name]
        )
    files["pareto.svg"] = pareto_svg(figures, f"{what}: {len(islands)} islands")
    return files


def _at_end(heat: IslandHeat, plane: ContourModes, result: OrderResult) -> Floats:
    """Temperature rise in the cells of the section when an order is done, (M,)."""
    _, state = entered(heat, np.argsort(result.rank), result.start_s, result.end_s)
    return np.asarray(plane.values @ (state @ heat.modes.in_layer), np.float64)
