"""How much of a part its curves give back, and how many blocks they take: ``python -m benchmarks.curves``.

Parts of every kind (:mod:`benchmarks.curve_parts`) against what they stand for: the normal distance of all rings, of the
contour, of each method, and of what other programs make of the same contour within the same tolerance
(from the contour alone, parted at corners: they know no mesh, and so keep the error of its chords). Medians over the parts of a kind, and the worst by name.
"""

from __future__ import annotations

import argparse
import json
import math
import time
import warnings
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.interpolate import splev, splprep

from benchmarks.curve_parts import CurvePart, heights_of, parts
from benchmarks.curve_parts_solids import Floats
from benchmarks.figures import machine, markdown
from ebamcheck.curves import METHODS, Curves, contour_error, fit
from ebamcheck.curves.crossings import crossings
from ebamcheck.curves.gate import polylines
from ebamcheck.json_values import write_json
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.slicers.slicing import slice_part
from ebamcheck_models import LADDER

CORNER_RAD = math.radians(40.0)
"""Turn at which a contour is parted, as by `curves.corner_angle_deg`."""

SAMPLES_A_BLOCK = 16
LEAST_ARC_POINTS = 4
HALVINGS = 12


class Yardstick(NamedTuple):
    """What a peer made of a stack."""

    sampled: Layers
    """Polylines along its curves."""
    blocks: int


def arc_welded(layers: Layers, tolerance_mm: float) -> Yardstick:
    """Greedy arcs as ArcWelder makes them: through the first, middle and last point of the longest run that keeps the
    tolerance, at its points and at the middles between them; else lines."""
    return _of_runs(layers, lambda run: _welded(run, tolerance_mm))


def splines(layers: Layers, tolerance_mm: float) -> Yardstick:
    """Smoothing splines of :func:`scipy.interpolate.splprep` with the fewest knots whose points keep the tolerance."""
    return _of_runs(layers, lambda run: _spline(run, tolerance_mm))


def _of_runs(layers: Layers, fit_run: Callable[[Floats], tuple[Floats, int]]) -> Yardstick:
    stack, blocks = [], 0
    for k in range(len(layers)):
        found = []
        for r in layers.rings_of(k):
            parts = [fit_run(run) for run in _runs(layers.ring(r))]
            blocks += sum(count for _, count in parts)
            found.append(np.concatenate([points[:-1] for points, _ in parts]))
        stack.append(found)
    return Yardstick(from_rings(layers.heights, stack), blocks)


def _runs(ring: Floats) -> list[Floats]:
    """A closed ring parted at its corners; without one, at its first point."""
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1))
    corners = np.flatnonzero(np.abs(turn) > CORNER_RAD)
    first = int(corners[0]) if corners.size else 0
    closed = np.concatenate([np.roll(ring, -first, axis=0), ring[first : first + 1]])
    cuts = [0, *(corners[1:] - first).tolist(), len(ring)]
    return [closed[a : b + 1] for a, b in pairwise(cuts)]


def _welded(run: Floats, tolerance_mm: float) -> tuple[Floats, int]:
    points, blocks, i = [run[:1]], 0, 0
    while i < len(run) - 1:
        best, j = None, i + LEAST_ARC_POINTS - 1
        while j < len(run):
            found = _arc(run[i : j + 1], tolerance_mm)
            if found is None:
                break
            best, end = found, j
            j += 1
        if best is None:
            best, end = run[i : i + 2], i + 1
        points.append(best[1:])
        blocks += 1
        i = end
    return np.concatenate(points), blocks


def _arc(points: Floats, tolerance_mm: float) -> Floats | None:
    """Samples of the arc through first, middle and last point, or None where it leaves them."""
    (ax, ay), (bx, by), (cx, cy) = points[0], points[len(points) // 2], points[-1]
    d = 2.0 * (ax * (by - cy) + bx * (cy - ay) + cx * (ay - by))
    if abs(d) < 1e-12:
        return None
    a, b, c = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    x = (a * (by - cy) + b * (cy - ay) + c * (ay - by)) / d
    y = (a * (cx - bx) + b * (ax - cx) + c * (bx - ax)) / d
    radius = math.hypot(ax - x, ay - y)
    near = np.concatenate([points, 0.5 * (points[1:] + points[:-1])]) - (x, y)
    if np.abs(np.hypot(near[:, 0], near[:, 1]) - radius).max() > tolerance_mm:
        return None
    angle = np.unwrap(np.arctan2(points[:, 1] - y, points[:, 0] - x))
    if abs(angle[-1] - angle[0]) > 2.0 * math.pi - 0.1:
        return None
    along = np.linspace(angle[0], angle[-1], max(SAMPLES_A_BLOCK, 4 * len(points)))
    sampled = np.column_stack([x + radius * np.cos(along), y + radius * np.sin(along)])
    sampled[0], sampled[-1] = points[0], points[-1]
    return sampled


def _spline(run: Floats, tolerance_mm: float) -> tuple[Floats, int]:
    if len(run) < 5:
        return run, len(run) - 1
    low, high, best = 0.0, len(run) * tolerance_mm**2, None
    for k in range(HALVINGS):  # of the sum of squares that splprep may leave
        s = high if k == 0 else 0.5 * (low + high)
        with warnings.catch_warnings():  # a sum that it cannot reach is told by the distance below
            warnings.simplefilter("ignore", RuntimeWarning)
            tck, u = splprep(list(run.T), s=s, k=3, quiet=2)[:2]  # type: ignore[call-overload]
        off = np.hypot(*(np.array(splev(u, tck)) - run.T)).max()
        if off <= tolerance_mm:
            low, best = s, tck
            if k == 0:
                break
        else:
            high = s
    if best is None:
        return run, len(run) - 1
    spans = len(np.unique(best[0])) - 1
    sampled = np.array(splev(np.linspace(0.0, 1.0, max(4 * len(run), SAMPLES_A_BLOCK * spans)), best)).T
    sampled[0], sampled[-1] = run[0], run[-1]
    return sampled, spans


LAYERS = 12
FINE_MM = 0.01
"""Mesh of the time of a whole stack."""

STACK = 4488
EXACT_MM = 1e-5
"""Contours nearer than this to their part are exact: what is left is how curves are sampled, and gains mean nothing."""

PEERS = {"arc welder": arc_welded, "splprep": splines}

HEADINGS = (
    *("kind", "method", "parts", "median gain", "worst gain", "worst part", "largest error / contour's"),
    *("where contours are exact, mm", "points a block", "rings fallen back", "rings that cross"),
)

DEFAULT_OUTPUT = Path("reports/curves")

MEANING = (
    "Made by `{}`. Normal distance of all rings from the part that the mesh stands for: closed forms by\n"
    "formula, CAD solids by a tessellation of the same generator with a chord error of 1e-4 mm. Gain: how much smaller\n"
    "the RMS is than the contour's. Arc welder and splprep see the contour alone, at the same tolerance."
)


def measure(layers: int, quick: bool) -> list[dict[str, Any]]:
    """One row for each part and method."""
    return [row for part in parts(quick) for row in _rows(part, layers)]


def _rows(case: CurvePart, count: int) -> list[dict[str, Any]]:
    part = case.mesh()
    layers = slice_part(part, heights_of(part, count))
    truth = case.truth(layers.heights)

    def row(method: str, stack: Layers | Curves, blocks: int, **more: int) -> dict[str, Any]:
        rms, largest = _errors(stack, truth)
        sizes = {"facets": len(part.faces), "points": len(layers.points), "rings": layers.closed.size}
        errors = {"rms_mm": rms, "max_mm": largest, "blocks": blocks}
        return {"part": case.name, "kind": case.kind, **sizes, "method": method, **errors, **more}

    rows = [row("contour", layers, polylines(layers).block_count())]
    for method in METHODS:
        curves = fit(layers, method, part=part)
        fallen = 0 if curves.evidence is None else int((curves.evidence.method > 0).sum())
        crossing = int(crossings(curves).crossed.sum())
        rows.append(row(method, curves, curves.block_count(), fallen=fallen, crossing=crossing))
    for name, peer in PEERS.items():
        made = peer(layers, CurveSettings().tolerance_mm)
        rows.append(row(name, made.sampled, made.blocks))
    return rows


def _errors(stack: Layers | Curves, truth: Layers) -> tuple[float, float]:
    """Root mean square and greatest normal distance over all rings."""
    found = contour_error(stack, truth)
    known = found[found["rings"] > 0]
    square = np.average(known["normal_rms_mm"] ** 2, weights=known["rings"])
    return math.sqrt(float(square)), float(known["normal_max_abs_mm"].max())


def summary(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One row for each kind and method: median and worst gain, worst growth of the largest error, blocks."""
    table = pd.DataFrame(rows)
    contour = table[table["method"] == "contour"].set_index("part")
    own = table[table["method"] != "contour"].copy()
    before, largest = (own["part"].map(contour[c]).to_numpy() for c in ("rms_mm", "max_mm"))
    exact = before < EXACT_MM
    own["gain"] = np.where(exact, np.nan, 1.0 - own["rms_mm"] / np.where(exact, 1.0, before))
    own["growth"] = np.where(exact, np.nan, own["max_mm"] / np.where(exact, 1.0, largest))
    own["exact_mm"] = np.where(exact, own["max_mm"], np.nan)
    own["points a block"] = own["points"] / own["blocks"]
    found = []
    for (kind, method), some in own.groupby(["kind", "method"], sort=False):
        worst = some["part"].iloc[int(np.nanargmin(some["gain"]))] if some["gain"].notna().any() else ""
        fallen, crossing = some["fallen"].sum() / some["rings"].sum(), some["crossing"].sum()
        found.append({
            "kind": kind, "method": method, "parts": len(some), "median gain": some["gain"].median(),
            "worst gain": some["gain"].min(), "worst part": worst, "growth": some["growth"].max(),
            "exact_mm": some["exact_mm"].max(), "points a block": some["points a block"].median(),
            "fallen rings": fallen if method in METHODS else np.nan,
            "crossing rings": crossing if method in METHODS else np.nan,
        })  # fmt: skip
    return pd.DataFrame(found)


def time_stack(count: int) -> list[dict[str, Any]]:
    """Seconds that each method takes for a whole stack, its evidence included; kernels are compiled before."""
    part = LADDER.tessellate(FINE_MM)
    layers = slice_part(part, LADDER.height_mm * (np.arange(count) + 0.5) / count)
    rows = []
    for method in METHODS:
        fit(layers.block(0, 2), method, part=part)
        start = time.perf_counter()
        fit(layers, method, part=part)
        seconds = time.perf_counter() - start
        rows.append({"method": method, "layers": count, "points": len(layers.points), "seconds": seconds})
    return rows


def as_markdown(record: dict[str, Any]) -> str:
    """Tables of a record."""
    kinds = [
        [
            *(
                row["kind"],
                row["method"],
                row["parts"],
                _percent(row["median gain"]),
                _percent(row["worst gain"]),
            ),
            *(
                row["worst part"],
                _number(row["growth"]),
                _number(row["exact_mm"]),
                _number(row["points a block"]),
            ),
            *(_percent(row["fallen rings"]), _number(row["crossing rings"])),
        ]
        for row in record["summary"]
    ]
    parts = [
        [
            row["part"],
            f"{row['facets']:,}",
            row["method"],
            f"{row['rms_mm']:.6f}",
            f"{row['max_mm']:.6f}",
            f"{row['blocks']:,}",
        ]
        for row in record["parts"]
        if row["method"] in ("contour", "bounded")
    ]
    stack = [[row["method"], row["layers"], f"{row['points']:,}", f"{row['seconds']:.1f}"] for row in record["stack"]]
    return "\n\n".join(
        [
            "# Curves",
            MEANING.format(record["command"]),
            markdown(HEADINGS, kinds),
            markdown(["part", "facets", "method", "RMS, mm", "largest, mm", "blocks"], parts),
            markdown(["method", "layers", "contour points", "seconds"], stack) + "\n",
        ]
    )


def _percent(value: float | None) -> str:
    return "" if value is None or math.isnan(value) else f"{100.0 * value:.1f} %"


def _number(value: float | None) -> str:
    return "" if value is None or math.isnan(value) else f"{value:.3g}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and write ``curves.json`` and ``curves.md``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.curves", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_OUTPUT, help="folder of the tables")
    parser.add_argument("--quick", action="store_true", help="one part of each kind, a few layers")
    parser.add_argument("--layers", type=int, default=LAYERS, help="layers of each part")
    parser.add_argument("--stack", type=int, default=STACK, help="layers of the stack that is timed")
    asked = parser.parse_args(arguments)
    rows = measure(2 if asked.quick else asked.layers, asked.quick)
    command = "python -m benchmarks.curves"
    if asked.quick:
        command += " --quick"
    elif asked.layers != LAYERS:
        command += f" --layers {asked.layers}"
    record = {
        "command": command,
        "machine": machine(),
        "summary": summary(rows).to_dict(orient="records"),
        "parts": rows,
        "stack": time_stack(20 if asked.quick else asked.stack),
    }
    asked.output.mkdir(parents=True, exist_ok=True)
    write_json(record, asked.output / "curves.json")
    (asked.output / "curves.md").write_text(as_markdown(json.loads(json.dumps(record, default=float))))


if __name__ == "__main__":
    main()
