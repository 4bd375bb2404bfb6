"""How much of a part its curves give back, and how many blocks they take: ``python -m benchmarks.curves``.

Parts of every kind (:mod:`benchmarks.curve_parts`) against what they stand for: the normal distance of all rings, of the
contour, of each method, and of what other programs make of the same contour within the same tolerance
(:mod:`benchmarks.curve_peers`). Medians over the parts of a kind, and the worst by name.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.curve_parts import CurvePart, heights_of, parts
from benchmarks.curve_peers import arc_welded, splines
from benchmarks.figures import machine
from ebamcheck.curves import METHODS, Curves, contour_error, fit
from ebamcheck.curves.crossings import crossings
from ebamcheck.curves.gate import polylines
from ebamcheck.json_values import write_json
from ebamcheck.layers.stack import Layers
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.slicers.slicing import slice_part
from ebamcheck_models import LADDER

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


def measure(layers: int, quick: bool) -> list[dict[str, Any]]:
    """One row for each part and method."""
    return [row for part in parts(quick) for row in _rows(part, layers)]


def _rows(case: CurvePart, count: int) -> list[dict[str, Any]]:
    part = case.mesh()
    layers = slice_part(part, heights_of(part, count))
    truth = case.truth(layers.heights)
    common = {
        "part": case.name,
        "kind": case.kind,
        "facets": len(part.faces),
        "points": len(layers.points),
        "rings": layers.closed.size,
    }
    rms, largest = _errors(layers, truth)
    rows = [
        {
            **common,
            "method": "contour",
            "rms_mm": rms,
            "max_mm": largest,
            "blocks": polylines(layers).block_count(),
        }
    ]
    for method in METHODS:
        curves = fit(layers, method, part=part)
        rms, largest = _errors(curves, truth)
        rows.append(
            {
                **common,
                "method": method,
                "rms_mm": rms,
                "max_mm": largest,
                "blocks": curves.block_count(),
                "fallen": 0 if curves.evidence is None else int((curves.evidence.method > 0).sum()),
                "crossing": int(crossings(curves).crossed.sum()),
            }
        )
    for name, peer in PEERS.items():
        made = peer(layers, CurveSettings().tolerance_mm)
        rms, largest = _errors(made.sampled, truth)
        rows.append({**common, "method": name, "rms_mm": rms, "max_mm": largest, "blocks": made.blocks})
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
        found.append(
            {
                "kind": kind,
                "method": method,
                "parts": len(some),
                "median gain": some["gain"].median(),
                "worst gain": some["gain"].min(),
                "worst part": worst,
                "growth": some["growth"].max(),
                "exact_mm": some["exact_mm"].max(),
                "points a block": some["points a block"].median(),
                "fallen rings": some["fallen"].sum() / some["rings"].sum() if method in METHODS else np.nan,
                "crossing rings": some["crossing"].sum() if method in METHODS else np.nan,
            }
        )
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
        f"Made by `{record['command']}`. Normal distance of all rings from the part that the mesh stands for: closed forms by",
        "formula, CAD solids by a tessellation of the same generator with a chord error of 1e-4 mm. Gain: how much smaller",
        "the RMS is than the contour's. Arc welder and splprep see the contour alone, at the same tolerance.",
        "",
        f"| {' | '.join(HEADINGS)} |",
        "|" + "---|" * len(HEADINGS),
    ]
    lines += [
        f"| {row['kind']} | {row['method']} | {row['parts']} | {_percent(row['median gain'])} | "
        f"{_percent(row['worst gain'])} | {row['worst part']} | {_number(row['growth'])} | "
        f"{_number(row['exact_mm'])} | {_number(row['points a block'])} | {_percent(row['fallen rings'])} | "
        f"{_number(row['crossing rings'])} |"
        for row in record["summary"]
    ]
    lines += ["", "| part | facets | method | RMS, mm | largest, mm | blocks |", "|---|---|---|---|---|---|"]
    for row in record["parts"]:
        if row["method"] in ("contour", "bounded"):
            lines.append(
                f"| {row['part']} | {row['facets']:,} | {row['method']} | {row['rms_mm']:.6f} | {row['max_mm']:.6f} | "
                f"{row['blocks']:,} |"
            )
    lines += ["", "| method | layers | contour points | seconds |", "|---|---|---|---|"]
    for row in record["stack"]:
        lines.append(f"| {row['method']} | {row['layers']} | {row['points']:,} | {row['seconds']:.1f} |")
    return "\n".join(lines) + "\n"


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
