"""Large layers and whole parts planned by heat: ``python -m benchmarks.scan_parts``; tables in reports/scan/parts.md.

Times of a layer of more than 2000 islands and of a part of 100 layers of about 300 islands, each of which begins with
the heat that those under it have left; and what planning with that heat gains over planning each layer from cold.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely

from benchmarks.machine import machine
from benchmarks.scan_orders import DEFAULT_OUTPUT, MODELS, markdown
from ebamcheck.geometry.regions import layer_section
from ebamcheck.kernels import Ints
from ebamcheck.layers.stack import from_polygons
from ebamcheck.plugins.registry import models
from ebamcheck.scan import LayerIslands, ScanPlan, plan_stack
from ebamcheck.scan.order.orders import chosen_options, scan_order
from ebamcheck.scan.plan.laying import lay_islands
from ebamcheck.scan.plan.whole_part import scan_part
from ebamcheck.settings.config import Config

LARGE = shapely.box(0, 0, 400, 230), 4.0
"""A layer of more than 2000 islands: its outline and the side of its hexagons, mm."""

PART, LAYERS, SIDE_MM = "bulkhead", 100, 9.5
"""A reference model, its layers, and the side of hexagons of which about 300 lie in a layer."""

CARRIED, MOST_LAYERS = ("prism", "blade", "torus", "nozzle"), 40
"""Reference models on which planning with the heat below is compared with planning from cold, and their lowest layers."""

BUILD_LAYERS = 24
"""Lowest layers of each part of which the build time is compared."""

BUILD_ORDERS = (
    ("thermal", "thermal", {}),
    ("thermal without moves", "thermal", {"annealing_steps": 0}),
    *((name, name, {}) for name in ("raster", "stride", "nearest", "farthest", "least-heat")),
)

SETUP_S, PLAN_S, PART_S = 20.0, 1.0, 300.0
"""Targets: heat model and plan of the large layer, and the whole part."""


def layer_rows() -> list[dict[str, Any]]:
    """Set-up of the heat model of the large layer, and its order and entries; the first turn brings the compiled code up."""
    section, side_mm = LARGE
    config = Config().changed(scan={"hexagon_side_mm": side_mm})
    laid = lay_islands(layer_section(section), config, 0, 30.0)
    for _ in range(2):
        islands = laid.choices(config, config.scan.seed)
        began = time.perf_counter()
        heat = islands.cold_heat()
        ready = time.perf_counter()
        chosen_options("thermal", islands, scan_order("thermal", islands, heat), heat)
        done = time.perf_counter()
    what = f"a layer of {len(islands)} islands, {len(heat.modes.plane_rate)} modes"
    return [row(f"{what}: set-up", ready - began, SETUP_S), row(f"{what}: plan", done - ready, PLAN_S)]


def planned_layers() -> dict[str, Any]:
    """Order and heat of all layers of a part: seconds and islands of each, from below."""
    model = models((PART,))[PART]
    low, high = model.bounds[:, 2]
    height_mm = (high - low) / LAYERS
    heights = height_mm * (np.arange(LAYERS) + 0.5)
    config = Config().changed(scan={"hexagon_side_mm": SIDE_MM}, layers={"layer_height_mm": float(height_mm)})
    sections = [layer_section(model.section(float(low + z))) for z in heights.tolist()]
    seconds, islands, used_s, began = [], [], time.process_time(), time.perf_counter()
    for layer in scan_part(sections, heights, config, "thermal", config.scan.seed):
        seconds.append(time.perf_counter() - began)
        islands.append(int(layer["islands"]))
        began += seconds[-1]
    used_s = time.process_time() - used_s
    return {"status": "done", "why": "", "layer_s": seconds, "islands": islands, "processor_s": used_s}


def part_rows() -> list[dict[str, Any]]:
    """Order and heat of all layers of a part."""
    found = planned_layers()
    fewest, most = min(found["islands"]), max(found["islands"])
    what = f"{PART}, {LAYERS} layers of {fewest} to {most} islands"
    return [row(f"{what}: order and heat", sum(found["layer_s"]), PART_S)]


def carry_rows() -> list[dict[str, Any]]:
    """Hottest entries of layers planned with the heat below, over those of plans from cold, driven on the same heat."""
    rows = []
    for name, model in models(CARRIED).items():
        low, high = model.bounds[:, 2]
        config = Config()
        heights = np.arange(0.5 * config.layer_height_mm, high - low, config.layer_height_mm)[:MOST_LAYERS]
        stack = from_polygons(heights, [model.section(float(low + z)) for z in heights.tolist()])
        sections = [stack.section(k) for k in range(len(stack))]
        cold = plan_stack(stack, config.changed(scan={"carry_heat": False}))

        def from_cold(islands: LayerIslands, cold: ScanPlan = cold) -> Ints:
            return cold.islands_of(islands.layer) - np.searchsorted(cold.island_layer, islands.layer)

        hottest = []
        for order in ("thermal", from_cold):
            found = scan_part(sections, heights, config, order, config.scan.seed)
            hottest.append(np.array([layer["entry_max_k"] for layer in found]))
        ratio = hottest[0] / hottest[1]
        low_share, middle, high_share = np.nanquantile(ratio, [0.1, 0.5, 0.9])
        rows.append(
            {
                "part": name,
                "layers": len(stack),
                "hottest entry, with heat below over from cold": f"{middle:.2f}",
                "10 % to 90 %": f"{low_share:.2f} to {high_share:.2f}",
            }
        )
    return rows


def build_table() -> pd.DataFrame:
    """Build time of the lowest layers of ten parts by several orders, and by `thermal` without its moves; travel, and processor time."""
    rows = []
    for name, model in models(MODELS).items():
        low, high = model.bounds[:, 2]
        step_mm = Config().layer_height_mm
        heights = np.arange(0.5 * step_mm, high - low, step_mm)[:BUILD_LAYERS]
        sections = [layer_section(model.section(float(low + z))) for z in heights.tolist()]
        for what, order, scan in BUILD_ORDERS:
            began = time.process_time()
            found = pd.DataFrame(scan_part(sections, heights, Config().changed(scan=scan), order, 0))
            row = {
                "part": name,
                "order": what,
                "build, s": found["time_s"].sum() + found["wait_s"].sum(),
                "hottest entry, K": found["entry_max_k"].mean(),
                "travel, m": 1e-3 * found["travel_mm"].sum(),
                "processor, s": time.process_time() - began,
            }
            rows.append(row)
    return pd.DataFrame(rows).round(1)


def row(what: str, seconds: float, most: float) -> dict[str, Any]:
    """Row of the table."""
    result = "met" if seconds <= most else "missed"
    return {"what": what, "s": f"{seconds:.2f}", "target, s": f"<= {most:g}", "result": result}


def main() -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_OUTPUT)
    parser.add_argument("--builds", action="store_true", help="print the build times of ten parts instead")
    options = parser.parse_args()
    if options.builds:
        print(markdown(build_table()))
        return
    options.output.mkdir(parents=True, exist_ok=True)
    rows, here = [*layer_rows(), *part_rows()], machine()
    threads = os.environ.get("EBAMCHECK_THREADS", str(here["cores"]))
    text = (
        "# Large layers and whole parts planned by heat\n\n"
        f"By `python -m benchmarks.scan_parts`, {threads} threads on {here['cpu']}.\n\n"
        f"{markdown(pd.DataFrame(rows))}\n{markdown(pd.DataFrame(carry_rows()))}"
    )
    (options.output / "parts.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
