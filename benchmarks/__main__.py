"""``python -m benchmarks``: measure, and write raw figures, tables and a plot."""

from __future__ import annotations

import argparse
import json
import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import methods, parts, plot, tables
from benchmarks.ladder import QUICK, Effort, measure_ladder
from benchmarks.machine import machine, renderer
from benchmarks.parts import SERIES, TOP, BenchmarkPart, benchmark_part, sizes_of
from benchmarks.scale import measure_scale
from benchmarks.target_tasks import measure_gpu, measure_job, measure_targets
from benchmarks.watch import ROOT
from ebamcheck.atomic_file import replacing

OUTPUT = ROOT / "reports" / "benchmarks"
QUICK_OUTPUT = Path(__file__).parent / ".quick"
FORMAT = 1
QUICK_SIZES = (1, parts.BASE_SIZE)
QUICK_LAYER_MM = 3.2


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is asked for; 0, or 2 where the options make no sense."""
    options = _options(arguments)
    effort = (
        QUICK if options.quick else Effort(options.repeats, limit_s=options.limit, scaled_s=options.scaled)
    )
    output = options.output or (QUICK_OUTPUT if options.quick else OUTPUT)
    output.mkdir(parents=True, exist_ok=True)
    name = f"gpu-{_slug(renderer() or 'none')}" if options.gpu else "benchmark"
    file = output / f"{name}.json"
    if options.render:
        write_reports(json.loads(file.read_text(encoding="utf-8")), file)
        return 0
    if options.scale:
        raw = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else _empty(options)
        raw["scale"] = measure_scale(options.quick, options.check_options, _note)
        write_reports(raw, file)
        return 0
    chosen = _chosen(options)
    wanted = _parts(options)
    raw = {**_empty(options), "methods": [m.name for m in chosen]}
    raw["parts"] = {
        p.key: {
            "series": p.series,
            "size": p.size,
            "facets": p.facets,
            "bytes": p.bytes,
            "layer_mm": p.layer_mm,
        }
        for p in wanted
    }
    _keep_scale(raw, file)

    def keep(cells: Sequence[dict[str, Any]]) -> None:
        raw["cells"] = list(cells)
        write_reports(raw, file)

    measure_ladder(wanted, chosen, effort, _note, keep)
    if not options.no_targets:
        for series in dict.fromkeys(p.series for p in wanted):
            top = max((p for p in wanted if p.series == series), key=lambda p: p.size)
            raw["targets"][series] = _targets(top, effort, options.gpu)
            write_reports(raw, file)
        raw["job"] = {} if options.gpu else measure_job(effort, _note)
    write_reports(raw, file)
    _note(f"written: {output}")
    return 0


def _targets(top: BenchmarkPart, effort: Effort, gpu: bool) -> dict[str, list[dict[str, Any]]]:
    """Measure what the ladder does not, on the top part of a series."""
    if gpu:
        return measure_gpu(top, effort, _note)
    small = benchmark_part("even", min(parts.BASE_SIZE, top.size), top.layer_mm)
    return measure_targets(top, small, effort, _note)


def write_reports(raw: dict[str, Any], file: Path) -> None:
    """Write raw figures, and beside them the tables and the plots that follow from them."""
    folder, gpu = file.parent, file.stem.startswith("gpu-")
    _write(file, json.dumps(raw, indent=1) + "\n")
    prefix = f"{file.stem}-" if gpu else ""
    if raw["parts"]:
        _write(folder / f"{prefix}ladder.md", tables.ladder_text(raw))
    if any(raw["targets"].values()) or raw["scale"] or raw.get("job"):
        _write(folder / f"{prefix}targets.md", tables.targets_text(raw, gpu))
    if raw["cells"]:
        _write(folder / f"{prefix}readme_table.md", tables.readme_text(raw))
    for series in dict.fromkeys(part["series"] for part in raw["parts"].values()):
        lines = plot.lines_of(raw, series)
        if lines:
            layer_mm = next(part["layer_mm"] for part in raw["parts"].values() if part["series"] == series)
            title = f"Time of slicing {'on ' + raw['renderer'] if gpu else 'by every method'}, part {series}"
            where = f"{raw['machine']['cpu']}, {raw['machine']['cores']} cores; layers of {layer_mm:g} mm."
            _write(folder / f"{prefix}{series}.svg", plot.time_chart(lines, title, where))


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--part", choices=(*SERIES, "both"), default="both", help="series of meshes")
    parser.add_argument(
        "--sizes",
        type=_sizes,
        help="sizes 1 .. 11, as 1,6,9-11; default: all, and of `even` beside `ladder` the top",
    )
    parser.add_argument("--methods", help="names of methods, comma-separated; default: all")
    parser.add_argument("--repeats", type=int, default=3, help="fresh processes a figure (default 3)")
    parser.add_argument("--limit", type=float, default=300.0, help="seconds after which a process is ended")
    parser.add_argument(
        "--scaled", type=float, default=20.0, help="seconds for methods that work layer by layer"
    )
    parser.add_argument(
        "--quick", action="store_true", help="try it out: two small sizes, thick layers, one repeat"
    )
    parser.add_argument(
        "--gpu", action="store_true", help="the stencil backend alone, under its renderer's name"
    )
    parser.add_argument("--scale", action="store_true", help="ten million facets, ten thousand layers, alone")
    parser.add_argument("--no-targets", action="store_true", help="the ladder alone")
    parser.add_argument(
        "--render", action="store_true", help="make tables and plots again from the raw figures"
    )
    parser.add_argument("-o", "--output", type=Path, help="folder (default reports/benchmarks)")
    parser.add_argument(
        "check_options", nargs="*", help="with --scale, after --: further options of `ebamcheck check`"
    )
    options = parser.parse_args(arguments)
    if options.repeats < 1 or options.limit <= 0.0 or options.scaled <= 0.0:
        parser.error("--repeats, --limit and --scaled must be positive")
    if options.methods:
        known = {m.name: m for m in _all(options)}
        unknown = [name for name in options.methods.split(",") if name not in known]
        if unknown:
            parser.error(f"unknown method {unknown[0]!r}: there are {', '.join(known)}")
    return options


def _all(options: argparse.Namespace) -> list[methods.Method]:
    return methods.gpu_methods() if options.gpu else methods.all_methods()


def _chosen(options: argparse.Namespace) -> list[methods.Method]:
    """The methods asked for, in the order in which they take turns."""
    wanted = options.methods.split(",") if options.methods else None
    return [m for m in _all(options) if wanted is None or m.name in wanted]


def _sizes(text: str) -> tuple[int, ...]:
    try:
        return sizes_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _parts(options: argparse.Namespace) -> list[BenchmarkPart]:
    """Parts from small to large, series by series; made where they are not there yet."""
    series = SERIES if options.part == "both" else (options.part,)
    found = []
    for one in series:
        sizes = options.sizes or (QUICK_SIZES if options.quick else _default_sizes(one, options.part))
        for size in sizes:
            _note(f"part {one}-{size}")
            found.append(benchmark_part(one, size, **({"layer_mm": QUICK_LAYER_MM} if options.quick else {})))
    return found


def _default_sizes(series: str, asked: str) -> tuple[int, ...]:
    return (parts.BASE_SIZE, TOP) if asked == "both" and series == "even" else tuple(range(1, TOP + 1))


def _empty(options: argparse.Namespace) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "command": shlex.join(["python", "-m", "benchmarks", *sys.argv[1:]]),
        "quick": options.quick,
        "machine": machine(),
        "renderer": renderer(),
        "methods": [],
        "parts": {},
        "cells": [],
        "targets": {},
        "job": {},
        "scale": [],
    }


def _keep_scale(raw: dict[str, Any], file: Path) -> None:
    """Take over what another command has measured."""
    if file.is_file():
        raw["scale"] = json.loads(file.read_text(encoding="utf-8")).get("scale", [])


def _slug(text: str) -> str:
    """Part of a file's name."""
    return re.sub(r"[^a-z0-9]+", "-", text.partition("(")[0].lower()).strip("-")


def _write(path: Path, text: str) -> None:
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _note(text: str) -> None:
    print(f"benchmarks: {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
