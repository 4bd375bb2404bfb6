"""The heat of a plan against two others: ``python -m benchmarks.heat_balance``; tables in reports/scan/balance.md.

Each part is planned, its program is written and read back, and the temperatures of its layers when they are done are
set side by side:

- by the plan, which drives every contour and island on column and modes;
- by the balance in one dimension, driven bead by bead by the text's own times, waits and power;
- by the same with each layer heated evenly over its time, waits within it included, with the material's data over
  temperature and with the constant ones of the linear model; and so for the part planned without any measure;
- on blocks, by the referee (explicit finite differences in three dimensions, a moving beam, melting and boiling), which
  shares neither code nor discretisation with the others.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from shapely.geometry.base import BaseGeometry

from benchmarks.machine import machine
from benchmarks.referee import judged, referee
from benchmarks.scan_orders import DEFAULT_OUTPUT, markdown
from benchmarks.whole_program_heat import Balance, Deposits, constant_tables, heat_balance
from ebamcheck.checks.interpass_checks import (
    TextBeads,
    sections_of,
    text_beads,
    text_bed_k,
    text_shapes,
)
from ebamcheck.controls.sinumerik.writing import write_program
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.pipeline.stages import bead_paths
from ebamcheck.plugins.registry import models
from ebamcheck.program import read_program
from ebamcheck.scan import ScanPlan, plan_stack
from ebamcheck.scan.plan.stacking import beam_lines
from ebamcheck.settings.config import Config

BOX = shapely.box(0, 0, 60, 60), 40
"""A block, and its layers."""

REFERENCE = ("prism", "blade", "torus", "nozzle", "impeller", "bracket", "thin-walls", "bulkhead")
"""Reference models, those that are installed."""

MOST_LAYERS = 60
"""Their lowest layers; the demo part is planned as a whole."""

DEMO = "blade"

TARGET = 0.10
"""Rise over ambient by the plan over that by the balance, less 1, at most."""

WIDE = {"travel_min_mm": (-5000.0, -5000.0, 0.0), "travel_max_mm": (5000.0, 5000.0, 5000.0)}

REFEREED = {
    "block 44 x 40": shapely.box(0, 0, 44, 40),
    "tube 44 x 40": shapely.box(0, 0, 44, 40).difference(shapely.Point(20, 20).buffer(6, 32)),
}
"""Sections of blocks that the referee judges, and their layers."""
REFEREED_LAYERS = 6


@dataclass(frozen=True, eq=False)
class Driven:
    """A planned part and what its program says."""

    plan: ScanPlan
    deposits: Deposits
    by_bead_k: Floats
    config: Config

    def balance(self, constant: bool = False) -> Balance:
        """Return the balance of the whole program."""
        return heat_balance(self.deposits, self.config, constant_tables(self.config) if constant else None)


def driven(layers: Layers, config: Config) -> Driven:
    """Plan a part, write its program, and read times, waits and heat of each layer from the text."""
    plan = plan_stack(layers, config)
    with tempfile.TemporaryDirectory() as folder:
        files = write_program(bead_paths(layers, plan, config), plan, config, Path(folder) / "p")
        program = read_program(files.main, config)
    beads = text_beads(program, config)
    shapes = text_shapes(program, config, sections_of(layers))
    _, by_bead_k = text_bed_k(beads, config, shapes)
    return Driven(plan, by_layer(beads, shapes, config), by_bead_k, config)


def by_layer(beads: TextBeads, shapes: list[Any], config: Config) -> Deposits:
    """Sum the beads of a program up to layers; waits within a layer are part of its time."""
    count = len(shapes)

    def total(values: Floats) -> Floats:
        return np.bincount(beads.layer, values, minlength=count).astype(np.float64)

    before = np.where(beads.enters_layer, beads.wait_s, 0.0)
    return Deposits(
        thickness_mm=np.array([shape.thickness_mm for shape in shapes]),
        area_mm2=np.array([shape.area_mm2 for shape in shapes]),
        outer_mm=np.array([shape.outer_mm for shape in shapes]),
        inner_mm=np.array([shape.inner_mm for shape in shapes]),
        hole_mm2=np.array([shape.hole_mm2 for shape in shapes]),
        energy_j=config.material.absorptivity * total(beads.energy_j),
        time_s=total(beads.time_s + beads.move_s + beads.wait_s - before),
        wait_s=total(before),
    )


def stack(section: Any, count: int, config: Config, low_mm: float = 0.0) -> Layers:
    """Cut a model, or repeat a section, at the middles of layers."""
    heights = (np.arange(count) + 0.5) * config.layer_height_mm
    at = (lambda _: [section]) if isinstance(section, BaseGeometry) else (lambda z: section(low_mm + z))
    return from_polygons(heights, [at(float(z)) for z in heights])


def parts() -> dict[str, tuple[Any, int, float]]:
    """Sections, layers and lowest height of every part."""
    config = Config()
    found: dict[str, tuple[Any, int, float]] = {"box 60 x 60": (*BOX, 0.0)}
    for name, model in models(REFERENCE).items():
        low, high = (float(z) for z in model.bounds[:, 2])
        count = int((high - low) / config.layer_height_mm)
        found[name] = model.section, count if name == DEMO else min(count, MOST_LAYERS), low
    return found


def part_row(name: str, section: Any, count: int, low_mm: float) -> dict[str, Any]:
    """Plan a part; how far its temperatures are from those of the balance, and how long it takes to build."""
    config = Config().changed(machine=WIDE)
    layers = stack(section, count, config, low_mm)
    done = driven(layers, config)
    free = driven(layers, config.changed(process={"interpass": "off"}))
    entry_k = float(done.plan.metrics["entry_max_k"].max()) + config.process.ambient_temperature_k
    found = compared(done, done.by_bead_k)
    return {
        "part": name,
        "layers": count,
        "plan over balance by beads": furthest(found),
        "within 10 %": f"{100.0 * np.mean(np.abs(found - 1.0) <= TARGET):.0f} % of layers",
        "over balance by layers": furthest(compared(done, done.balance().end_k)),
        "without measures": furthest(compared(free, free.balance().end_k)),
        "without, constant data": furthest(compared(free, free.balance(constant=True).end_k)),
        "greatest entry, K": f"{entry_k:.0f} (limit {entry_limit_k(config):.0f})",
        "hours, and without measures": f"{hours(done):.1f}, {hours(free):.1f}",
    }


def compared(done: Driven, end_k: Floats) -> Floats:
    """Rise over ambient at the end of each layer that has metal, by the plan over that by another."""
    ambient_k = done.config.process.ambient_temperature_k
    ratio = (done.plan.metrics["leave_k"].to_numpy() - ambient_k) / (end_k - ambient_k)
    return np.asarray(ratio[np.isfinite(ratio)], np.float64)


def furthest(ratio: Floats) -> str:
    """Median of ratios, and the one that is furthest from 1."""
    return f"{np.median(ratio):.3f}, furthest {ratio[np.argmax(np.abs(ratio - 1.0))]:.3f}"


def hours(done: Driven) -> float:
    """Time of the program."""
    return float(done.deposits.time_s.sum() + done.deposits.wait_s.sum()) / 3600.0


def referee_row(name: str, section: BaseGeometry) -> dict[str, Any]:
    """Drive the lowest layers of a block on the referee, each with a new layer of cells on top of those before."""
    config = Config().changed(machine=WIDE, process={"layer_pause_s": 20.0}, material={"emissivity": 0.0})
    layers = stack(section, REFEREED_LAYERS, config)
    done = driven(layers, config)
    end_k, evaporated_j, absorbed_j = refereed(done, section)
    ambient_k = config.process.ambient_temperature_k
    planned = done.plan.metrics["leave_k"].to_numpy() - ambient_k
    ratio, balance = planned / (end_k - ambient_k), (done.balance().end_k - ambient_k) / (end_k - ambient_k)
    return {
        "part": name,
        "layers": REFEREED_LAYERS,
        "plan over referee": " ".join(f"{r:.3f}" for r in ratio),
        "balance over referee": " ".join(f"{r:.3f}" for r in balance),
        "boiled off": f"{100.0 * evaporated_j / absorbed_j:.1f} % of the heat",
    }


def refereed(done: Driven, section: BaseGeometry) -> tuple[Floats, float, float]:
    """Mean temperature of the uppermost cells after each layer, (L,) K; heat boiled off and taken up, J.

    Moves and waits within a layer are spread over its lines, which take up the heat of the layer evenly.
    """
    config, thick_mm = done.config, done.config.layer_height_mm
    whole = np.array([section], object)
    content, end_k, gone, taken = np.zeros(0), [], 0.0, 0.0
    for k in range(len(done.deposits)):
        if k:
            under = referee(section, config, k * thick_mm, thick_mm)
            wait_s, none = float(done.deposits.wait_s[k]), np.zeros(0)
            still = judged(
                under, content, np.zeros((0, 4)), none, none, 0.0, whole, np.array([wait_s]), wait_s
            )
            content = still.content
        model = referee(section, config, (k + 1) * thick_mm, thick_mm)
        grown = model.cold()
        grown[len(grown) - len(content) :] = content.reshape(-1, *grown.shape[1:])
        lines, begin, end = layer_lines(done, k)
        time_s = float(done.deposits.time_s[k])
        begin, end = begin * time_s / end[-1], end * time_s / end[-1]
        power_w = float(done.deposits.energy_j[k] / (end - begin).sum())
        found = judged(model, grown, lines, begin, end, power_w, whole, np.array([time_s]), time_s)
        content = found.content
        gone, taken = gone + found.evaporated_j, taken + found.absorbed_j
        end_k.append(float(found.entry_k[0]) + config.process.ambient_temperature_k)
    return np.array(end_k), gone, taken


def layer_lines(done: Driven, layer: int) -> tuple[Floats, Floats, Floats]:
    """Lines (V, 4) that the beam drives in a layer, contours first, and the times (V,) of their ends."""
    speed = done.config.process.travel_speed_mm_s
    rings = shapely.get_parts(shapely.boundary(done.plan.contours[layer]))
    around = np.vstack([np.hstack([c[:-1], c[1:]]) for c in map(shapely.get_coordinates, rings)])
    stop = np.cumsum(np.hypot(*(around[:, 2:] - around[:, :2]).T)) / speed
    ends, begin_s, end_s = beam_lines(done.plan, done.config)
    of_layer = line_layers(done, len(begin_s), begin_s)
    chosen = of_layer == layer
    begin = np.concatenate([np.concatenate([[0.0], stop[:-1]]), stop[-1] + begin_s[chosen]])
    return np.vstack([around, ends[chosen]]), begin, np.concatenate([stop, stop[-1] + end_s[chosen]])


def line_layers(done: Driven, count: int, begin_s: Floats) -> np.ndarray:
    """Layer of each line: times begin anew with every layer."""
    new = np.diff(begin_s, prepend=np.inf) < 0.0
    assert len(new) == count
    return np.cumsum(new) - 1


def main() -> None:
    """Measure, print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_OUTPUT)
    parser.add_argument("--parts", nargs="*", help="only these parts")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    chosen = {n: p for n, p in parts().items() if options.parts is None or n in options.parts}
    judged_rows = [referee_row(name, section) for name, section in REFEREED.items()]
    rows = [part_row(name, *part) for name, part in chosen.items()]
    text = (
        "# The heat of a plan against a balance and a referee\n\n"
        f"By `python -m benchmarks.heat_balance`, on {machine()['cpu']}. Rise over ambient when each layer is done.\n\n"
        f"{markdown(pd.DataFrame(rows))}\n"
        "The referee is driven without radiation, each layer by its own lines:\n\n"
        f"{markdown(pd.DataFrame(judged_rows))}"
    )
    (options.output / "balance.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
