"""The measurements that the table of targets needs beyond the ladder, in turns."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.first_use import COMMANDS, first_use
from benchmarks.ladder import Effort, Note
from benchmarks.methods import Method
from benchmarks.parts import DEMO_REFERENCE_MM, DEMO_TOLERANCE_MM, BenchmarkPart, model_file, shuffled
from benchmarks.scan_parts import planned_layers
from benchmarks.watch import run_task, watch
from ebamcheck.record.run_folder import RunFolder, is_run

Raw = dict[str, Any]

UNION_SHARES = [0.05, 0.5]
"""Shares of the height over which shells overlap, to see that the union costs in proportion."""

COMMAND_LIMIT_S = 1800.0


@dataclass(frozen=True)
class Task:
    """One measurement by its name in the raw figures."""

    name: str
    run: Callable[[], Raw]
    repeats: int


def measure_targets(
    part: BenchmarkPart, small: BenchmarkPart, effort: Effort, note: Note
) -> dict[str, list[Raw]]:
    """Measure on the top part of a series what the ladder does not; `small` is for what needs no large part."""
    note("targets: compiling kernels where they are not yet")
    command(["warm"], COMMAND_LIMIT_S)
    return in_turns(_tasks(part, small, effort), f"targets, {part.key}", note)


def measure_gpu(part: BenchmarkPart, effort: Effort, note: Note) -> dict[str, list[Raw]]:
    """Measure the stencil on the top part of a series: bitmaps, and the device's own time of the literal draws."""
    request = {"stl": str(part.path), "layer_mm": part.layer_mm}
    tasks = [
        Task("bitmaps", partial(run_task, "bitmaps", request, COMMAND_LIMIT_S), effort.repeats),
        Task("drawing", partial(run_task, "drawing", request, COMMAND_LIMIT_S), effort.repeats),
    ]
    return in_turns(tasks, f"targets, {part.key}", note)


def measure_job(effort: Effort, note: Note) -> dict[str, list[Raw]]:
    """Time the main job, its planning where layers are many, and what a new install waits for."""
    first = [Task(name, partial(_first_use, name), 1) for name in COMMANDS]
    tasks = [Task("main job", demo_run, effort.repeats), Task("islands", planned_layers, 1), *first]
    return in_turns(tasks, "main job", note)


def _first_use(name: str) -> Raw:
    first, second = first_use(name)
    return {
        "status": "done",
        "why": "",
        "wall_s": first.wall_s,
        "again_s": second.wall_s,
        "processor_s": first.processor_s,
    }


def in_turns(tasks: Sequence[Task], title: str, note: Note) -> dict[str, list[Raw]]:
    """Run tasks in turns, so that a machine that slows down slows all of them."""
    found: dict[str, list[Raw]] = {task.name: [] for task in tasks}
    for turn in range(max(task.repeats for task in tasks)):
        for task in tasks:
            if turn < task.repeats:
                note(f"{title}: {task.name}, turn {turn + 1}")
                found[task.name].append(task.run())
    return found


def _tasks(part: BenchmarkPart, small: BenchmarkPart, effort: Effort) -> list[Task]:
    mixed = shuffled(part)
    stl, layers = {"stl": str(part.path)}, {"stl": str(part.path), "layer_mm": part.layer_mm}
    planecut = {**layers, "method": Method("planecut", backend="planecut").as_dict(), "rounds": effort.rounds}
    unions = {"stl": str(small.path), "layer_mm": small.layer_mm, "shares": UNION_SHARES}

    def task(name: str, request: Raw) -> Callable[[], Raw]:
        return lambda: run_task(name, request, COMMAND_LIMIT_S)

    many, once = effort.repeats, 1
    return [
        Task("cold", lambda: cold_slice(part.path, part.layer_mm), many),
        Task("start-up", lambda: cold_slice(model_file("cube", 1.0), 10.0), many),
        Task("imports", imports, many),
        Task("in order", task("time", planecut), many),
        Task("shuffled", task("time", {**planecut, "stl": str(mixed.path)}), many),
        Task("overlaps", task("overlaps", layers), many),
        Task("unions", task("unions", unions), many),
        Task("latency", task("latency", stl), many),
        Task("bitmaps", task("bitmaps", layers), many),
        Task("crossings", task("crossings", layers), once),
        Task("cross-check", lambda: check_command(part.path, part.layer_mm, COMMAND_LIMIT_S), many),
    ]


def cold_slice(stl: Path, layer_mm: float) -> Raw:
    """Time ``ebamcheck slice`` from the start of the process to its end, with a file of layers written."""
    with tempfile.TemporaryDirectory(prefix="ebamcheck-benchmark-") as folder:
        arguments = [
            "slice",
            str(stl),
            "--layer-height",
            f"{layer_mm:g}",
            "-o",
            str(Path(folder, "out.parquet")),
        ]
        return command(arguments, COMMAND_LIMIT_S)


def imports() -> Raw:
    """Time an interpreter that imports the libraries that every slice needs, and nothing of ours: the floor of a start."""
    code = "import numba, numpy, pyarrow.parquet, pydantic, shapely, typer"
    return _watched([sys.executable, "-c", code], COMMAND_LIMIT_S)


def check_command(
    stl: Path,
    layer_mm: float,
    limit_s: float,
    memory_mb: float = float("inf"),
    extra: Sequence[str] = (),
) -> Raw:
    """Run the whole cross-check, ``ebamcheck check``, under a watch; its stages are told by its own record."""
    with tempfile.TemporaryDirectory(prefix="ebamcheck-benchmark-") as folder:
        target = Path(folder, "run")
        arguments = ["check", str(stl), "--layer-height", f"{layer_mm:.9g}", "-o", str(target), *extra]
        # Exit code 1 is a result like any other: the slicers did not agree everywhere.
        found = command(arguments, limit_s, memory_mb, fine=(0, 1))
        if is_run(target):
            told = RunFolder(target).manifest()
            found |= {
                "stages_s": told["timings"]["stages_s"],
                "backends": {name: b["status"] for name, b in told["backends"].items()},
                "verdicts": told["comparison"]["verdicts"],
                "output_bytes": sum(f.stat().st_size for f in target.rglob("*") if f.is_file()),
            }
            lost = [f"{name} {status}" for name, status in found["backends"].items() if status != "done"]
            if lost and found["status"] == "done":
                # With a slicer less there is less to do: that time would be worth nothing.
                found |= {"status": "failed", "why": f"not all slicers came to an end: {', '.join(lost)}"}
    return found


def demo_run() -> Raw:
    """Time ``ebamcheck run`` on the demo part, with its reference."""
    blade, reference = model_file("blade", DEMO_TOLERANCE_MM), model_file("blade", DEMO_REFERENCE_MM)
    with tempfile.TemporaryDirectory(prefix="ebamcheck-benchmark-") as folder:
        arguments = ["run", str(blade), "--reference", str(reference), "-o", str(Path(folder, "run"))]
        return command(arguments, COMMAND_LIMIT_S)


def command(
    arguments: Sequence[str], limit_s: float, memory_mb: float = float("inf"), fine: Sequence[int] = (0,)
) -> Raw:
    """Run ``ebamcheck`` with these arguments in a process of its own."""
    # The installed script, as a user starts it.
    return _watched([str(Path(sys.executable).with_name("ebamcheck")), *arguments], limit_s, memory_mb, fine)


def _watched(
    arguments: Sequence[str], limit_s: float, memory_mb: float = float("inf"), fine: Sequence[int] = (0,)
) -> Raw:
    """Run a process under limits."""
    watched = watch(list(arguments), limit_s, memory_mb)
    status = "done" if watched.code in fine and not watched.ended else watched.ended or "failed"
    return {
        "status": {"time": "over", "memory": "over"}.get(status, status),
        "why": f"ended by its limit of {watched.ended}" if watched.ended else watched.last_words if status != "done" else "",
        "code": watched.code,
        "wall_s": watched.wall_s,
        "processor_s": watched.processor_s,
        "peak_mb": watched.peak_mb,
    }  # fmt: skip
