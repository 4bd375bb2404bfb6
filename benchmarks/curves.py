"""How much of a part its curves give back, and how many blocks they take: ``python -m benchmarks.curves``.

The ladder's part at its tolerances against its closed form, as a regular mesh and as one of irregular triangles, some
of whose vertices lie off the surface; each method on the same contours. The paper gives 34.2 % for one part.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.spatial import Delaunay

from benchmarks.machine import machine
from ebamcheck.curves import METHODS, contour_error, error_reduction, fit
from ebamcheck.layers import Layers, from_polygons
from ebamcheck.part import Part, from_arrays
from ebamcheck.settings.curves import CurveSettings
from ebamcheck.slicing import slice_part
from ebamcheck.store import write_json
from ebamcheck_models import LADDER

COARSE_MM = (1.0, 0.8, 0.4, 0.2, 0.1)
FINE_MM = 0.01
"""Mesh of the count of blocks, and of the time of a whole stack."""

LAYERS = 20
STACK = 4488
TRUTH_MM = 1e-5
"""Chord error of the closed form's rings."""

IRREGULAR = {"irregular": 0.0, "irregular, 0.05 mm off": 0.05}
"""Irregular meshes, and how far their vertices lie off the surface (standard deviation, mm)."""

POINTS = 4000
AS_WRITTEN = CurveSettings(largest_bulge_mm=1e9)
"""The interpolating fits as the paper has them, however far they leave their chords; by default such runs stay polylines."""

FIGURES = ("polar_rms", "polar_max", "normal_rms", "normal_max")

DEFAULT_OUTPUT = Path("reports/curves")


def irregular_mesh(points: int, noise_mm: float, seed: int = 1) -> Part:
    """Outer and inner wall of the ladder, by Delaunay's triangles over random places."""
    rng = np.random.default_rng(seed)
    around, tall = 2.0 * np.pi * LADDER.radius_mm, LADDER.height_mm
    vertices, faces, first = [], [], 0
    for side in (1.0, -1.0):
        rim = np.arange(64) / 64
        u = np.concatenate([rng.random(points), rim, rim])
        z = np.concatenate(
            [15.0 + rng.random(points) * (tall - 30.0), np.full(64, 5.0), np.full(64, tall - 5.0)]
        )
        wide = np.concatenate([u - 1.0, u, u + 1.0])
        flat = np.column_stack([wide * around, np.tile(z, 3)])
        triangles = Delaunay(flat).simplices
        middle = wide[triangles].mean(axis=1)
        triangles = triangles[(middle >= 0.0) & (middle < 1.0)]
        a, b, c = (flat[triangles[:, k]] for k in range(3))
        turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        triangles[turn < 0.0] = triangles[turn < 0.0][:, ::-1]
        vertices.append(LADDER.wall_point(u, z, np.ones_like(u), side).T)
        faces.append(np.tile(np.arange(u.size), 3)[triangles][:, :: int(side)] + first)
        first += u.size
    corners = np.concatenate(vertices)
    return from_arrays(corners + noise_mm * rng.normal(size=corners.shape), np.concatenate(faces))


def measure(layers: int) -> list[dict[str, Any]]:
    """One row for each mesh and method."""
    heights = LADDER.height_mm * (np.arange(layers) + 0.5) / layers
    sections = [LADDER.section(z, TRUTH_MM) for z in heights]
    walls = [[shapely.Polygon(p.exterior, p.interiors[:1]) for p in section] for section in sections]
    truth, of_walls = from_polygons(heights, sections), from_polygons(heights, walls)
    rows = []
    for mesh_mm in (*COARSE_MM, FINE_MM):
        rows += _rows(f"{mesh_mm:g} mm", LADDER.tessellate(mesh_mm), truth)
    for name, noise_mm in IRREGULAR.items():
        rows += _rows(name, irregular_mesh(POINTS, noise_mm), of_walls)
    return rows


def _rows(name: str, part: Part, truth: Layers) -> list[dict[str, Any]]:
    layers = slice_part(part, truth.heights)
    before = contour_error(layers, truth)
    rows = []
    for method in METHODS:
        curves = fit(layers, method, AS_WRITTEN, part=part)
        gain = error_reduction(before, contour_error(curves, truth))
        rows.append(
            {
                "mesh": name,
                "facets": len(part.faces),
                "contour_rms_mm": float(np.sqrt((before["polar_rms_mm"] ** 2).mean())),
                "method": method,
                "points": len(layers.points),
                "blocks": curves.block_count(),
                **{figure: float(gain[figure]) for figure in FIGURES},
            }
        )
    return rows


def time_stack(count: int) -> list[dict[str, Any]]:
    """Seconds that each method takes for a whole stack; kernels are compiled before."""
    part = LADDER.tessellate(FINE_MM)
    layers = slice_part(part, LADDER.height_mm * (np.arange(count) + 0.5) / count)
    rows = []
    for method in METHODS:
        fit(layers.block(0, 2), method, part=part)
        start = time.perf_counter()
        fit(layers, method, part=part)
        rows.append(
            {
                "method": method,
                "layers": count,
                "points": len(layers.points),
                "seconds": time.perf_counter() - start,
            }
        )
    return rows


def as_markdown(record: dict[str, Any]) -> str:
    """Tables of a record."""
    lines = [
        "# Curves",
        "",
        "Made by `python -m benchmarks.curves`. How much smaller the error against the closed form is than that of the",
        "contour, over all layers; polar: outer contours about the centre of their box (paper, 5.2); normal: all rings,",
        "channels of 2.2 mm included. Blocks: contour points for each NC block.",
        "",
        "| mesh | facets | contour RMS, mm | method | polar RMS | polar max | normal RMS | points a block |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['mesh']} | {row['facets']:,} | {row['contour_rms_mm']:.4f} | {row['method']} | "
        + " | ".join(f"{100.0 * row[f]:.1f} %" for f in ("polar_rms", "polar_max", "normal_rms"))
        + f" | {row['points'] / row['blocks']:.1f} |"
        for row in record["gains"]
    ]
    lines += ["", "| method | layers | contour points | seconds |", "|---|---|---|---|"]
    for row in record["stack"]:
        lines.append(f"| {row['method']} | {row['layers']} | {row['points']:,} | {row['seconds']:.1f} |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and write ``curves.json`` and ``curves.md``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.curves", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_OUTPUT, help="folder of the tables")
    parser.add_argument("--quick", action="store_true", help="a few layers only")
    asked = parser.parse_args(arguments)
    record = {
        "machine": machine(),
        "gains": measure(4 if asked.quick else LAYERS),
        "stack": time_stack(40 if asked.quick else STACK),
    }
    asked.output.mkdir(parents=True, exist_ok=True)
    write_json(record, asked.output / "curves.json")
    (asked.output / "curves.md").write_text(as_markdown(json.loads(json.dumps(record))))


if __name__ == "__main__":
    main()
