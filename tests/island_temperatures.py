"""Temperatures of islands against a converged reference.

The layer is a rectangle, whose modes are known in closed form: the reference takes all of them down to waves of a
fraction of an island, and the depth's down to a fraction of a layer, and integrates them over every island. The model
takes its few hundred, with and without the fresh heat of near islands.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import shapely
from closed_form_heat import rectangle_modes
from numpy.typing import NDArray

from ebamcheck.geometry.regions import layer_section
from ebamcheck.heat import depth_modes
from ebamcheck.heat.field import Modes, Timetable, surfaces_at_entries
from ebamcheck.heat.island_heat import IslandHeat
from ebamcheck.kernels import Floats, Ints
from ebamcheck.scan.order.entries import clocked, entered
from ebamcheck.scan.order.orders import LayerIslands, scan_order
from ebamcheck.scan.plan.laying import lay_islands
from ebamcheck.settings.config import Config

SIDES_MM, HEXAGON_MM, HEIGHT_MM = (400.0, 230.0), 4.0, 10.0

WAVES = (1.4, 1.0, 0.7)
"""Shortest waves of the references, in widths of an island: the finest is the reference, the others show that it
has converged."""

WAVES_A_LAYER = 4.0
"""Waves of the depth in the thickness of a layer."""

BLOCK = 1000
"""Modes at a time."""

ORDERS = ("raster", "farthest", "random", "thermal")

QUADRATURE = np.array([[1.0, 1.0, 4.0], [1.0, 4.0, 1.0], [4.0, 1.0, 1.0]]) / 6.0
"""Barycentric coordinates of the points of equal weight that integrate polynomials of degree 2 over a triangle."""

Driven = tuple[Ints, Floats, Floats]
"""An order, and begin and end of each island."""


def sampled(islands: NDArray[np.object_]) -> tuple[Floats, Floats, Ints]:
    """Points (P, 2) and weights (P,) that stand for the mean over islands, and the island of each."""
    triangles, owner = shapely.get_parts(shapely.constrained_delaunay_triangles(islands), return_index=True)
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    points = np.einsum("qb,tbx->tqx", QUADRATURE, corners).reshape(-1, 2)
    weight, island = np.repeat(shapely.area(triangles), 3), np.repeat(owner, 3)
    return points, weight / np.bincount(island, weight)[island], island


def references(
    heat: IslandHeat, choices: LayerIslands, driven: Sequence[Driven], waves: Sequence[float]
) -> list[list[Floats]]:
    """Entry temperatures (I,) of orders by all modes of a rectangle from (0, 0) down to some waves.

    Waves are in widths of an island, falling; the result has a list for each, with the temperatures of each order.
    """
    model, count = heat.model, len(choices)
    loss = model.medium.radiation_w_mm2k / model.medium.conductivity_w_mmk
    deep = int(WAVES_A_LAYER * model.depth.depth_mm / model.layer_mm)
    depth = depth_modes(model.depth.depth_mm, deep, model.depth.cooled, loss)
    width_mm = float(np.sqrt(choices.area_mm2.mean()))
    largest = [(2.0 * np.pi / (wave * width_mm)) ** 2 for wave in waves]
    *_, right, top = choices.section.bounds
    plane = rectangle_modes(right, top, largest[-1])
    points, weight, island = sampled(choices.polygons)
    alpha, totals = model.medium.diffusivity_mm2_s, [np.zeros(count) for _ in driven]
    found = []
    edges = [0, *np.searchsorted(plane.eigenvalue, largest, side="right").tolist()]
    for low, high in itertools.pairwise(edges):
        for first in range(low, high, BLOCK):
            some = slice(first, min(first + BLOCK, high))
            block = replace(plane, wave_x=plane.wave_x[some], wave_y=plane.wave_y[some])
            mean = np.zeros((count, len(block.wave_x)))
            np.add.at(mean, island, weight[:, None] * block.at(points))
            modes = Modes(
                np.ascontiguousarray(mean.T),
                alpha * block.eigenvalue,
                alpha * depth.wave_number**2,
                depth.mean_of_layer(model.layer_mm),
                heat.modes.source_k_s,
            )
            for total, (order, start_s, end_s) in zip(totals, driven, strict=True):
                cold = np.zeros((len(block.wave_x), deep))
                timetable = Timetable(order, start_s, end_s)
                surface = surfaces_at_entries(modes, timetable, 0.0, cold, modes.in_layer)
                total += np.einsum("ki,ik->i", modes.mean, surface)
        found.append([total.copy() for total in totals])
    return found


def compared(config: Config, sides_mm: tuple[float, float], waves: tuple[float, ...]) -> pd.DataFrame:
    """Entry temperatures of several orders on a rectangle, by the model and by references of some waves."""
    section = layer_section(shapely.box(0.0, 0.0, *sides_mm))
    choices = lay_islands(section, config, 0, HEIGHT_MM).choices(config, 0)
    heat, schedule, rapid = choices.cold_heat(), choices.known_schedule, config.machine.rapid_mm_s
    orders = [scan_order(name, choices, heat) for name in ORDERS]
    driven = [(order, *clocked(schedule, order, rapid)[:2]) for order in orders]
    converging = references(heat, choices, driven, waves)
    rows = []
    for n, (name, times) in enumerate(zip(ORDERS, driven, strict=True)):
        found = {
            "modes alone": entered(replace(heat, near=None), *times)[0],
            "with fresh heat": entered(heat, *times)[0],
            **{f"reference, {wave:g} w": of[n] for wave, of in zip(waves, converging, strict=True)},
        }
        true = converging[-1][n]
        for model, entry_k in found.items():
            rows.append(
                {
                    "order": name,
                    "model": model,
                    "islands": len(choices),
                    "mean_k": entry_k.mean(),
                    "max_k": entry_k.max(),
                    "rms_error_over_rms": np.sqrt(np.mean((entry_k - true) ** 2) / np.mean(true**2)),
                    "error_of_max": entry_k.max() / true.max() - 1.0,
                }
            )
    return pd.DataFrame(rows)
