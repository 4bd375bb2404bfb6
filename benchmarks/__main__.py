"""``python -m benchmarks``: measure, and write raw figures, tables and plots into reports/benchmarks."""

from __future__ import annotations

import argparse
import json
import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import ladder, parts
from benchmarks.figures import machine, renderer
from benchmarks.ladder import QUICK, Effort, measure_ladder
from benchmarks.parts import SERIES, TOP, BenchmarkPart, benchmark_part, sizes_of
from benchmarks.targets import measure_job, measure_targets, targets_text
from benchmarks.watch import ROOT
from ebamcheck.atomic_file import replacing

OUTPUT = ROOT / "reports" / "benchmarks"
QUICK_OUTPUT = Path(__file__).parent / ".quick"
QUICK_SIZES = (1, parts.BASE_SIZE)
QUICK_LAYER_MM = 3.2


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is asked for; 0, or 2 where the options make no sense."""
    options = _options(arguments)
    effort = QUICK if options.quick else Effort(options.repeats, limit_s=options.limit, scaled_s=options.scaled)  # fmt: skip
    output = options.output or (QUICK_OUTPUT if options.quick else OUTPUT)
    output.mkdir(parents=True, exist_ok=True)
    name = f"gpu-{_slug(renderer() or 'none')}" if options.gpu else "benchmark"
    file = output / f"{name}.json"
    if options.render:
        write_reports(json.loads(file.read_text(encoding="utf-8")), file)
        return 0
    chosen, wanted = options.chosen, _parts(options)
    raw: dict[str, Any] = {
        "command": shlex.join(["python", "-m", "benchmarks", *sys.argv[1:]]),
        "machine": machine(),
        "methods": [m.name for m in chosen],
        "parts": {
            p.key: {"series": p.series, "size": p.size, "facets": p.facets, "bytes": p.bytes, "layer_mm": p.layer_mm}
            for p in wanted
        },
        "cells": [],
        "targets": {},
        "job": {},
    }  # fmt: skip

    def keep(cells: Sequence[Any]) -> None:
        raw["cells"] = list(cells)
        write_reports(raw, file)

    measure_ladder(wanted, chosen, effort, _note, keep)
    if not options.no_targets and not options.gpu:
        for series in dict.fromkeys(p.series for p in wanted):
            top = max((p for p in wanted if p.series == series), key=lambda p: p.size)
            raw["targets"][series] = measure_targets(top, effort, _note)
            write_reports(raw, file)
        raw["job"] = measure_job(effort, _note)
    write_reports(raw, file)
    _note(f"written: {output}")
    return 0


def write_reports(raw: dict[str, Any], file: Path) -> None:
    """Write raw figures, and beside them the tables and the plots that follow from them."""
    folder, gpu = file.parent, file.stem.startswith("gpu-")
    _write(file, json.dumps(raw, indent=1) + "\n")
    prefix = f"{file.stem}-" if gpu else ""
    _write(folder / f"{prefix}ladder.md", ladder.ladder_text(raw))
    if gpu or any(raw["targets"].values()) or raw["job"]:
        _write(folder / f"{prefix}targets.md", targets_text(raw, gpu))
    if raw["cells"]:
        _write(folder / f"{prefix}readme_table.md", ladder.readme_text(raw))
    for series in ladder.series_of(raw):
        if ladder.plotted(raw, series) and not gpu:
            with replacing(folder / f"{series}.svg") as temporary:
                ladder.write_chart(raw, series, temporary)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    add = parser.add_argument
    add("--part", choices=(*SERIES, "both"), default="both", help="series of meshes")
    add("--sizes", type=_sizes, help="sizes 1 .. 11, as 1,6,9-11; default: all, and of `even` beside `ladder` the top")  # fmt: skip
    add("--methods", help="names of methods, comma-separated; default: all")
    add("--repeats", type=int, default=3, help="fresh processes a figure (default 3)")
    add("--limit", type=float, default=300.0, help="seconds after which a process is ended")
    add("--scaled", type=float, default=20.0, help="seconds for methods that work layer by layer")
    add("--quick", action="store_true", help="try it out: two small sizes, thick layers, one repeat")
    add("--gpu", action="store_true", help="the stencil backend alone, under its renderer's name")
    add("--no-targets", action="store_true", help="the ladder alone")
    add("--render", action="store_true", help="make tables and plots again from the raw figures")
    add("-o", "--output", type=Path, help="folder (default reports/benchmarks)")
    options = parser.parse_args(arguments)
    if options.repeats < 1 or options.limit <= 0.0 or options.scaled <= 0.0:
        parser.error("--repeats, --limit and --scaled must be positive")
    known = {m.name: m for m in (ladder.GPU_METHODS if options.gpu else ladder.all_methods())}
    names = options.methods.split(",") if options.methods else list(known)
    unknown = [name for name in names if name not in known]
    if unknown:
        parser.error(f"unknown method {unknown[0]!r}: there are {', '.join(known)}")
    options.chosen = [method for name, method in known.items() if name in names]
    return options


def _sizes(text: str) -> tuple[int, ...]:
    try:
        return sizes_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _parts(options: argparse.Namespace) -> list[BenchmarkPart]:
    """Parts from small to large, series by series; made where they are not there yet."""
    found = []
    for series in SERIES if options.part == "both" else (options.part,):
        every = (parts.BASE_SIZE, TOP) if (options.part, series) == ("both", "even") else range(1, TOP + 1)
        for size in options.sizes or (QUICK_SIZES if options.quick else every):
            _note(f"part {series}-{size}")
            thick = {"layer_mm": QUICK_LAYER_MM} if options.quick else {}
            found.append(benchmark_part(series, size, **thick))
    return found


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
