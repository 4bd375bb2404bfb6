"""Temperatures of 2000 islands against a converged reference: ``python -m benchmarks.island_temperatures``.

The layer is a rectangle, whose modes are known in closed form: the reference takes all of them down to waves of a
fraction of an island, and the depth's down to a fraction of a layer, and integrates them over every island. The model
takes its few hundred, with and without the fresh heat of near islands.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from benchmarks.machine import machine
from benchmarks.scan_orders import markdown
from ebamcheck.config import Config
from ebamcheck.heat import depth_modes
from ebamcheck.heat.rectangle import rectangle_modes
from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.driving import clocked, entered, entered_into
from ebamcheck.scan.island_heat import IslandHeat
from ebamcheck.scan.laying import lay_islands
from ebamcheck.scan.order import LayerIslands, scan_order
from ebamcheck.scan.regions import layer_section

SIDES_MM, HEXAGON_MM, HEIGHT_MM = (400.0, 230.0), 4.0, 10.0

WAVES = (1.0, 0.7, 0.5)
"""Shortest waves of the references, in widths of an island: the finest is the reference, the others show that it
has converged."""

WAVES_A_LAYER = 4.0
"""Waves of the depth in the thickness of a layer."""

BLOCK = 1000
"""Modes at a time."""

ORDERS = ("raster", "farthest", "random", "thermal")

QUADRATURE = np.array([[2.0, 2.0, 8.0], [2.0, 8.0, 2.0], [8.0, 2.0, 2.0]]) / 12.0
"""Barycentric coordinates of the points of equal weight that integrate polynomials of degree 2 over a triangle."""


def sampled(islands: NDArray[np.object_]) -> tuple[Floats, Floats, Ints]:
    """Points (P, 2) and weights (P,) that stand for the mean over islands, and the island of each."""
    triangles, owner = shapely.get_parts(shapely.constrained_delaunay_triangles(islands), return_index=True)
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    halves = np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1, axis=1))], axis=1)
    quarters = halves[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]].reshape(-1, 3, 2)
    points = np.einsum("qb,tbx->tqx", QUADRATURE, quarters).reshape(-1, 2)
    weight = np.repeat(shapely.area(triangles), 12)
    island = np.repeat(owner, 12)
    return points, weight / np.bincount(island, weight)[island], island


def reference(heat: IslandHeat, choices: LayerIslands, order: Ints, wave: float) -> Floats:
    """Entry temperatures (I,) by all modes of a rectangle from (0, 0) down to a wave, in widths of an island."""
    drive, profile = choices.driven, choices.profile
    start_s, end_s, _ = clocked(order, drive.entry, drive.leave, drive.time_s, profile.machine.rapid_mm_s)
    model = heat.model
    loss = model.medium.radiation_w_mm2k / model.medium.conductivity_w_mmk
    waves = int(WAVES_A_LAYER * model.depth.depth_mm / model.layer_mm)
    depth = depth_modes(model.depth.depth_mm, waves, model.depth.cooled, loss)
    width_mm = float(np.sqrt(choices.area_mm2.mean()))
    *_, right, top = choices.section.bounds
    plane = rectangle_modes(right, top, (2.0 * np.pi / (wave * width_mm)) ** 2)
    points, weight, island = sampled(choices.polygons)
    alpha, total = model.medium.diffusivity_mm2_s, np.zeros(len(choices))
    for first in range(0, len(plane.eigenvalue), BLOCK):
        some = slice(first, first + BLOCK)
        block = replace(plane, wave_x=plane.wave_x[some], wave_y=plane.wave_y[some])
        mean = np.zeros((len(choices), len(block.wave_x)))
        np.add.at(mean, island, weight[:, None] * block.at(points))
        total += entered_into(
            np.ascontiguousarray(mean.T),
            alpha * block.eigenvalue,
            alpha * depth.wave_number**2,
            depth.mean_of_layer(model.layer_mm),
            heat.source_k_s,
            order,
            start_s,
            end_s,
            np.zeros((len(block.wave_x), waves)),
        )
    return total


def compared(profile: Config, sides_mm: tuple[float, float], waves: tuple[float, ...]) -> pd.DataFrame:
    """Entry temperatures of several orders on a rectangle, by the model and by references of some waves."""
    section = layer_section(shapely.box(0.0, 0.0, *sides_mm))
    choices = lay_islands(section, profile, 0, HEIGHT_MM).choices(profile, 0)
    heat, drive = choices.heat, choices.driven
    rows = []
    for name in ORDERS:
        order = scan_order(name, choices)
        times = clocked(order, drive.entry, drive.leave, drive.time_s, profile.machine.rapid_mm_s)[:2]
        found = {
            "modes alone": entered(replace(heat, near=None), order, *times)[0],
            "with fresh heat": entered(heat, order, *times)[0],
            **{f"reference, {wave:g} w": reference(heat, choices, order, wave) for wave in waves},
        }
        true = found[f"reference, {waves[-1]:g} w"]
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


def main() -> None:
    """Compare, print, and write a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("reports/scan"))
    options = parser.parse_args()
    profile = Config().changed(scan={"hexagon_side_mm": HEXAGON_MM})
    table = compared(profile, SIDES_MM, WAVES)
    digits = {"mean_k": 0, "max_k": 0, "rms_error_over_rms": 3, "error_of_max": 3}
    for column, places in digits.items():
        table[column] = table[column].map(f"{{:.{places}f}}".format)
    here = machine()
    lines = [
        "# Temperatures of islands against a converged reference\n",
        f"By `python -m benchmarks.island_temperatures` on {here['cores']} cores of {here['cpu']}.\n",
        f"A rectangle of {SIDES_MM[0]:g} x {SIDES_MM[1]:g} mm, hexagons of {HEXAGON_MM:g} mm; mean temperature rises "
        "of the islands when the beam enters them. A reference of `w` has all modes of the rectangle down to waves of "
        "that many widths of an island; errors are against the finest.\n",
        markdown(table),
    ]
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "islands.md").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
