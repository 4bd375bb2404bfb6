"""Times of planning by heat: ``python -m benchmarks.scan_speed``; table in reports/scan/speed.md.

A layer of more than 2000 islands, and a whole part of 100 layers of about 300 islands, each of which begins with the
heat that those under it have left.
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
from benchmarks.scan_orders import DEFAULT_OUTPUT, markdown
from ebamcheck.config import Config
from ebamcheck.model import models
from ebamcheck.scan.laying import lay_islands
from ebamcheck.scan.order import scan_order
from ebamcheck.scan.regions import layer_section
from ebamcheck.scan.whole_part import scan_part

LARGE = shapely.box(0, 0, 400, 230), 4.0
"""A layer of more than 2000 islands: its outline and the side of its hexagons, mm."""

PART, LAYERS, SIDE_MM = "bulkhead", 100, 9.5
"""A reference model, its layers, and the side of hexagons of which about 300 lie in a layer."""

SETUP_S, PLAN_S, PART_S = 20.0, 1.0, 300.0
"""Targets: heat model and plan of the large layer, and the whole part."""


def layer_rows() -> list[dict[str, Any]]:
    """Set-up of the heat model and planning of the large layer; the first turn brings the compiled code up."""
    section, side_mm = LARGE
    profile = Config().changed(scan={"hexagon_side_mm": side_mm})
    laid = lay_islands(layer_section(section), profile, 0, 30.0)
    for _ in range(2):
        islands = laid.choices(profile, profile.scan.seed)
        began = time.perf_counter()
        modes = islands.heat.mean.shape[0]
        ready = time.perf_counter()
        scan_order("thermal", islands)
        done = time.perf_counter()
    what = f"a layer of {len(islands)} islands, {modes} modes"
    return [row(f"{what}: set-up", ready - began, SETUP_S), row(f"{what}: plan", done - ready, PLAN_S)]


def part_rows() -> list[dict[str, Any]]:
    """Order and heat of all layers of a part."""
    model = models((PART,))[PART]
    low, high = model.bounds[:, 2]
    height_mm = (high - low) / LAYERS
    heights = height_mm * (np.arange(LAYERS) + 0.5)
    profile = Config().changed(
        scan={"hexagon_side_mm": SIDE_MM}, layers={"layer_height_mm": float(height_mm)}
    )
    sections = [layer_section(model.section(float(low + z))) for z in heights.tolist()]
    began = time.perf_counter()
    found = pd.DataFrame(scan_part(sections, heights, profile, "thermal", profile.scan.seed))
    seconds = time.perf_counter() - began
    what = f"{PART}, {LAYERS} layers of {found['islands'].min()} to {found['islands'].max()} islands"
    return [row(f"{what}: order and heat", seconds, PART_S)]


def row(what: str, seconds: float, most: float) -> dict[str, Any]:
    """Row of the table."""
    result = "met" if seconds <= most else "missed"
    return {"what": what, "s": f"{seconds:.2f}", "target, s": f"<= {most:g}", "result": result}


def main() -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_OUTPUT)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    rows, here = [*layer_rows(), *part_rows()], machine()
    threads = os.environ.get("EBAMCHECK_THREADS", str(here["cores"]))
    text = (
        "# Times of planning by heat\n\n"
        f"By `python -m benchmarks.scan_speed`, {threads} threads on {here['cpu']}.\n\n"
        f"{markdown(pd.DataFrame(rows))}"
    )
    (options.output / "speed.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
