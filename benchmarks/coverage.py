"""Coverage of many sections by their beads: ``python -m benchmarks.coverage``; its table in reports/scan.

Planned with the default settings, measured again by exact buffers: every reference model at several heights and
indices of the layer, random sections with holes and thin walls, and, where EBAMCHECK_CORPUS names a folder of meshes,
sections of these.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from shapely.geometry.base import BaseGeometry

from benchmarks.machine import machine
from benchmarks.scan_orders import markdown
from ebamcheck.errors import EbamcheckError
from ebamcheck.geometry.regions import layer_section
from ebamcheck.mesh.files import load
from ebamcheck.plugins.registry import models
from ebamcheck.scan.plan.stacking import plan_scan
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part

SHARES = (0.03, 0.13, 0.31, 0.53, 0.77, 0.93)
"""Heights of the layers, as shares of the height of a part: none of them at a step."""

LAYERS = (0, 1, 5, 23)
"""Indices of the layer, by which lattice and hatch turn; each section of a mesh has one of them."""

RANDOM_SECTIONS = 300
ARC_SEGMENTS = 32
"""Chords in a quarter of a bead's round end: they take 0.04 % of it."""

OUTSIDE = 1e-9
"""Distance from a section, over its greatest coordinate, that is rounding."""

QUANTILES = {"least": 0.0, "1 %": 0.01, "median": 0.5}

ORDER = "raster"
"""Coverage is the same in every order; this one takes the least time."""

CORPUS, CORPUS_FOLDERS = "EBAMCHECK_CORPUS", ("good", "nasty")
DEFAULT_OUTPUT = Path("reports/scan")


def of_models() -> Iterator[tuple[BaseGeometry, int]]:
    """Sections of the reference models by their closed forms, each at every index of the layer."""
    for model in models().values():
        low, high = model.bounds[:, 2]
        for share in SHARES:
            section = layer_section(model.section(float(low + share * (high - low))))
            yield from ((section, layer) for layer in LAYERS)


def of_chance() -> Iterator[tuple[BaseGeometry, int]]:
    """Discs and bent walls of any width less holes and slots, from 15 to 150 mm across."""
    for seed in range(RANDOM_SECTIONS):
        rng = np.random.default_rng(seed)
        size = rng.uniform(8.0, 75.0)
        metal = [disc(rng, size, 0.1, 0.5) for _ in range(rng.integers(0, 6))]
        metal += [bent_wall(rng, size, 0.3, 16.0) for _ in range(rng.integers(1, 6))]
        holes = [disc(rng, size, 0.01, 0.25) for _ in range(rng.integers(0, 12))]
        holes += [bent_wall(rng, size, 0.05, 3.0) for _ in range(rng.integers(0, 3))]
        section = shapely.difference(shapely.union_all(metal), shapely.union_all(holes))
        yield layer_section(section), LAYERS[seed % len(LAYERS)]


def disc(rng: np.random.Generator, size: float, least: float, most: float) -> shapely.Polygon:
    """Disc with a radius of a random share of the size, mm."""
    return shapely.buffer(shapely.Point(rng.uniform(-size, size, 2)), size * rng.uniform(least, most))


def bent_wall(rng: np.random.Generator, size: float, thinnest: float, thickest: float) -> shapely.Polygon:
    """Wall along a line of two to four random points, mm."""
    line = shapely.LineString(rng.uniform(-size, size, (rng.integers(2, 5), 2)))
    return shapely.buffer(line, 0.5 * rng.uniform(thinnest, thickest), cap_style="flat", join_style="mitre")


def of_meshes(folder: Path) -> Iterator[tuple[BaseGeometry, int]]:
    """Sections of the corpus's sound and unsound meshes, those that can be read and sliced."""
    for file in sorted(path for kind in CORPUS_FOLDERS for path in (folder / kind).glob("*.stl")):
        try:
            part = load(file)
            low, high = part.bounds[:, 2]
            layers = slice_part(part, low + np.array(SHARES) * (high - low))
            sections = [layers.section(k) for k in range(len(layers))]
        except EbamcheckError:
            continue
        yield from ((section, LAYERS[k % len(LAYERS)]) for k, section in enumerate(sections))


def measured(section: BaseGeometry, layer: int, config: Config) -> dict[str, Any]:
    """Islands of a section's plan, share of its area that is covered, and lines that leave it."""
    plan = plan_scan(section, config, order=ORDER, layer=layer)
    ends = plan.vectors[["x0", "y0", "x1", "y1"]].to_numpy()
    lines = np.asarray(shapely.linestrings(ends.reshape(-1, 2, 2)), object)
    centres = [*lines, *shapely.get_parts(shapely.boundary(plan.contours))]
    beads = shapely.buffer(centres, 0.5 * config.process.bead_width_mm, quad_segs=ARC_SEGMENTS)
    region = shapely.buffer(section, OUTSIDE * max(1.0, float(np.abs(section.bounds).max())))
    shapely.prepare(region)
    return {
        "islands": len(plan.islands),
        "coverage": 1.0 - shapely.difference(section, shapely.union_all(beads)).area / section.area,
        "outside": int(np.count_nonzero(~shapely.covers(region, lines))),
    }


def row(group: str, sections: Iterator[tuple[BaseGeometry, int]], config: Config) -> dict[str, Any]:
    """Row of the table of a group of sections."""
    found = pd.DataFrame([measured(s, layer, config) for s, layer in sections if s.area > 0.0])
    covered = found["coverage"]
    return {
        "group": group,
        "sections": len(found),
        "islands": int(found["islands"].sum()),
        **{name: f"{covered.quantile(share):.4f}" for name, share in QUANTILES.items()},
        f"below {config.scan.least_coverage:.0%}": int((covered < config.scan.least_coverage).sum()),
        "vectors outside": int(found["outside"].sum()),
    }


def main() -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_OUTPUT)
    options = parser.parse_args()
    began, config = time.perf_counter(), Config()
    groups = {"reference models": of_models(), "random sections": of_chance()}
    if folder := os.environ.get(CORPUS):
        groups["meshes from the field"] = of_meshes(Path(folder))
    table = pd.DataFrame([row(group, sections, config) for group, sections in groups.items()])
    seconds, here = time.perf_counter() - began, machine()
    by = f"By `python -m benchmarks.coverage`, {seconds:.0f} s on {here['cores']} cores of {here['cpu']}."
    options.output.mkdir(parents=True, exist_ok=True)
    text = f"# Coverage by beads\n\n{by}\n\n{markdown(table)}"
    (options.output / "coverage.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
