"""The targets: what is measured beyond the ladder, one row each, and the table of what is met."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figures import (
    Note,
    Raw,
    Spread,
    cell_times,
    find,
    machine_text,
    markdown,
    quantity,
    ratio,
    spread,
    spread_text,
    total_s,
)
from benchmarks.first_use import COMMANDS, first_use
from benchmarks.ladder import LITERAL, MANIFOLD_ALONE, PRUSA_STAGE, Effort, Method, series_of, top_of
from benchmarks.orders import planned_layers
from benchmarks.parts import (
    BASE_SIZE,
    DEMO_REFERENCE_MM,
    DEMO_TOLERANCE_MM,
    BenchmarkPart,
    model_file,
    shuffled,
)
from benchmarks.watch import run_task, watch
from ebamcheck.record.run_folder import RunFolder, is_run

FILE_TO_CONTOURS = ("load_s", "prepare_s", "slice_s")
COMMAND_LIMIT_S = 1800.0

Answers = Mapping[str, Sequence[Raw]]
"""Answers of tasks, one a turn, by the task's name."""


@dataclass(frozen=True)
class Figures:
    """The raw figures of one series: its cells, and the answers of its tasks on the part at the top."""

    cells: Sequence[Raw]
    tasks: Answers
    parts: Mapping[str, Raw]
    series: str = ""
    top: int = 0

    def times(self, method: str, steps: Iterable[str] = FILE_TO_CONTOURS) -> Spread | None:
        """Times of a method at the top, from the file to the contours."""
        return cell_times(find(self.cells, f"{self.series}-{self.top}", method), steps)

    def told(self, task: str, value: Callable[[Raw], float]) -> Spread | None:
        """A value of every answer of a task; None where one of them failed."""
        answers = self.tasks.get(task, [])
        if not answers or any(a["status"] != "done" for a in answers):
            return None
        return spread(value(a) for a in answers)

    def why(self, task: str) -> str:
        """Why a task has no figures."""
        answers = self.tasks.get(task, [])
        return next((f"{a['status']}: {a['why']}" for a in answers if a["status"] != "done"), "not measured")


@dataclass(frozen=True)
class Target:
    """One row: the figure must not be greater than its limit; None: it is told, and there is no target."""

    what: str
    limit: float | None
    unit: str
    measure: Callable[[Figures], Spread | None]
    task: str = ""
    """The task that it comes from, to say why there is none."""

    def judged(self, figures: Figures) -> tuple[str, str]:
        """The figure with its spread, and whether it is met or by how much it is missed."""
        found = self.measure(figures)
        if found is None:
            return "-", f"not measured ({figures.why(self.task)})" if self.task else "not measured"
        verdict = "no target"
        if self.limit is not None:
            met = found.median <= self.limit
            verdict = "met" if met else f"**missed**: {found.median / self.limit:.2f} times the target"
        return spread_text(found, self.unit), verdict


def _told(task: str, name: str) -> Callable[[Figures], Spread | None]:
    """A value of a task's answers by its name: that of a list by its median."""
    return lambda figures: figures.told(task, lambda answer: spread(np.ravel(answer[name])).median)


def _memory(figures: Figures) -> Spread | None:
    """Greatest memory of the process over file and layers together."""
    cell = find(figures.cells, f"{figures.series}-{figures.top}", "planecut")
    if cell is None or not cell["runs"]:
        return None
    given = figures.parts[cell["part"]]["bytes"]
    return spread(1e6 * run["peak_mb"] / (given + run["rounds"][-1]["output_bytes"]) for run in cell["runs"])


def _growth(figures: Figures) -> Spread | None:
    """Time over (facets + points) at every size, over that of the base size; the worst of them."""
    costs: dict[int, float] = {}
    for key, part in figures.parts.items():
        cell = find(figures.cells, key, "planecut")
        times = cell_times(cell)
        if part["series"] == figures.series and cell is not None and times is not None:
            costs[part["size"]] = times.median / (part["facets"] + cell["runs"][-1]["rounds"][-1]["points"])
    if BASE_SIZE not in costs or len(costs) < 2:
        return None
    return spread([max(cost / costs[BASE_SIZE] for size, cost in costs.items() if size != BASE_SIZE)])


def _shuffled(figures: Figures) -> Spread | None:
    return ratio(figures.told("shuffled", total_s), figures.told("in order", total_s))


def _layer_s(answer: Raw) -> float:
    """Time a layer, once the first ones have brought everything up."""
    return float(np.mean(answer["layer_s"][1:]))


def _linear(answer: Raw) -> float:
    """Time an island of the upper half of the layers over that of the lower half."""
    seconds, islands = np.asarray(answer["layer_s"]), np.asarray(answer["islands"])
    half = len(seconds) // 2
    lower, upper = (seconds[part].sum() / islands[part].sum() for part in (slice(1, half), slice(half, None)))
    return float(upper / lower)


TARGETS: tuple[Target, ...] = (
    Target(
        "planecut, file to contours, over PrusaSlicer's slice stage", 0.25, "",
        lambda f: ratio(f.times("planecut"), f.times(PRUSA_STAGE, ("slice_s",))),
    ),
    Target(
        "planecut, file to contours, over manifold3d's construct + slice + to_polygons", 0.125, "",
        lambda f: ratio(f.times("planecut"), f.times(MANIFOLD_ALONE, FILE_TO_CONTOURS[1:])),
    ),
    Target("planecut, file to contours, warm process", 0.4, "s", lambda f: f.times("planecut")),
    Target("planecut, peak memory of the process over input + output", 2.5, "", _memory),
    Target("planecut, whole command, cold", 2.5, "s", _told("cold", "wall_s"), "cold"),
    Target("of which start-up (a cube, one layer)", 0.8, "s", _told("start-up", "wall_s"), "start-up"),
    Target("time per (facets + points) over that of 38 k facets, worst of all sizes", 3.0, "", _growth),
    Target("shuffled facets over facets in order", 1.5, "", _shuffled, "shuffled"),
    Target("one layer at a new height, part loaded", 5e-3, "s", _told("latency", "at_s"), "latency"),
    Target("a new direction, part loaded", 0.150, "s", _told("latency", "along_s"), "latency"),
    Target("a new direction with its first layer", None, "s", _told("latency", "along_at_s"), "latency"),
    Target("stencil literal, the paper's way, 0.1 mm pixels", None, "s", lambda f: f.times(LITERAL, FILE_TO_CONTOURS[1:])),
    Target("embree in-plane, 0.1 mm grid", 15.0, "s", lambda f: f.times("embree", FILE_TO_CONTOURS[1:])),
    Target(
        "backend manifold over manifold3d's own time", 1.10, "",
        lambda f: ratio(f.times("manifold", FILE_TO_CONTOURS[1:]), f.times(MANIFOLD_ALONE, FILE_TO_CONTOURS[1:])),
    ),
    Target(
        "comparison of all pairs of the house's slicers, all layers, all metrics", 40.0, "s",
        lambda f: f.told("cross-check", lambda a: a["stages_s"]["compare"]), "cross-check",
    ),
    Target("the whole cross-check: `ebamcheck check`, file to JSON and CSV", 89.0, "s", _told("cross-check", "wall_s"), "cross-check"),
    Target("its peak memory, all processes", 8000.0, "MB", _told("cross-check", "peak_mb"), "cross-check"),
)  # fmt: skip

GPU = (
    Target("stencil draw-once, 0.1 mm pixels, all layers, file to contours", 1.0, "s", lambda f: f.times("stencil")),
    Target("stencil literal, the paper's way, 0.1 mm pixels, all layers, file to contours", 5.0, "s", lambda f: f.times(LITERAL)),
)  # fmt: skip

JOB = (
    Target("`ebamcheck run` on the demo part", 16.0, "s", _told("main job", "wall_s"), "main job"),
    Target("its processor time", 28.0, "s", _told("main job", "processor_s"), "main job"),
    Target("`ebamcheck verify` of that run", 9.0, "s", _told("verify", "wall_s"), "verify"),
    Target(
        "order and heat of a layer of 277 to 345 islands (1000 layers within 10 minutes: 0.6 s)", 0.6, "s",
        lambda f: f.told("islands", _layer_s), "islands",
    ),
    Target(
        "the same, time an island in the upper half of 100 layers over that in the lower half", 1.1, "",
        lambda f: f.told("islands", _linear), "islands",
    ),
    Target("`ebamcheck warm` of a new install", 90.0, "s", _told("warm", "wall_s"), "warm"),
    Target("first `ebamcheck slice` of a new install", 15.0, "s", _told("slice", "wall_s"), "slice"),
    Target("first `ebamcheck run` of a new install, demo part, nothing compiled", None, "s", _told("run", "wall_s"), "run"),
    Target("`make demo` in a new clone, with all its set-up", 120.0, "s", _told("demo", "wall_s"), "demo"),
)  # fmt: skip


def targets_text(raw: Raw, gpu: bool = False) -> str:
    """Table of all targets on each series, and of those of the main job; those of the stencil on a GPU by themselves."""
    series = [s for s in series_of(raw) if gpu or raw["targets"].get(s)]
    figures = [Figures(raw["cells"], raw["targets"].get(s, {}), raw["parts"], s, top_of(raw, s)) for s in series]
    columns = ["what", "target"]
    for of in figures:
        columns += [f"`{of.series}`, {of.parts[f'{of.series}-{of.top}']['facets']:,} facets", ""]
    text = ["# Targets", "", f"Made by `{raw['command']}` on {machine_text(raw['machine'])}", ""]
    if figures:
        text += [markdown(columns, [_row(target, figures) for target in (GPU if gpu else TARGETS)]), ""]
    if raw.get("job"):
        rows = [_row(target, [Figures([], raw["job"], {})]) for target in JOB]
        text += [markdown(["what", "target", "measured", ""], rows), ""]
    return "\n".join(text)


def _row(target: Target, figures: Sequence[Figures]) -> list[str]:
    limit = "-" if target.limit is None else f"at most {quantity(target.limit, target.unit)}"
    return [target.what, limit, *(text for of in figures for text in target.judged(of))]


# -- measuring ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    """One measurement by its name in the raw figures."""

    name: str
    run: Callable[[], Raw]
    repeats: int


def measure_targets(part: BenchmarkPart, effort: Effort, note: Note) -> dict[str, list[Raw]]:
    """Measure on the top part of a series what the ladder does not."""
    note("targets: compiling kernels where they are not yet")
    command(["warm"])
    planecut = {"layer_mm": part.layer_mm, "method": asdict(Method("planecut", backend="planecut")), "rounds": effort.rounds}  # fmt: skip

    def timed(of: BenchmarkPart) -> Callable[[], Raw]:
        return partial(run_task, "time", {"stl": str(of.path), **planecut}, COMMAND_LIMIT_S)

    tasks: dict[str, Callable[[], Raw]] = {
        "cold": partial(cold_slice, part.path, part.layer_mm),
        "start-up": partial(cold_slice, model_file("cube", 1.0), 10.0),
        "in order": timed(part),
        "shuffled": timed(shuffled(part)),
        "latency": partial(run_task, "latency", {"stl": str(part.path)}, COMMAND_LIMIT_S),
        "cross-check": partial(check_command, part.path, part.layer_mm, COMMAND_LIMIT_S),
    }
    return in_turns([Task(name, run, effort.repeats) for name, run in tasks.items()], f"targets, {part.key}", note)  # fmt: skip


def measure_job(effort: Effort, note: Note) -> dict[str, list[Raw]]:
    """Time the main job, its planning where layers are many, and what a new install waits for."""
    with tempfile.TemporaryDirectory(prefix="ebamcheck-benchmark-") as folder:
        run = str(Path(folder, "run"))
        blade, fine = (model_file("blade", mm) for mm in (DEMO_TOLERANCE_MM, DEMO_REFERENCE_MM))
        demo = partial(command, ["run", str(blade), "--reference", str(fine), "--force", "-o", run])
        first = [Task(name, partial(_first_use, name), 1) for name in COMMANDS]
        tasks = [
            Task("main job", demo, effort.repeats),
            Task("verify", partial(command, ["verify", run]), effort.repeats),
            Task("islands", planned_layers, 1),
        ]
        return in_turns([*tasks, *first], "main job", note)


def _first_use(name: str) -> Raw:
    first, second = first_use(name)
    return {"status": "done", "why": "", "wall_s": first.wall_s, "again_s": second.wall_s, "processor_s": first.processor_s}  # fmt: skip


def in_turns(tasks: Sequence[Task], title: str, note: Note) -> dict[str, list[Raw]]:
    """Run tasks in turns, so that a machine that slows down slows all of them."""
    found: dict[str, list[Raw]] = {task.name: [] for task in tasks}
    for turn in range(max(task.repeats for task in tasks)):
        for task in tasks:
            if turn < task.repeats:
                note(f"{title}: {task.name}, turn {turn + 1}")
                found[task.name].append(task.run())
    return found


def cold_slice(stl: Path, layer_mm: float) -> Raw:
    """Time ``ebamcheck slice`` from the start of the process to its end, with a file of layers written."""
    with tempfile.TemporaryDirectory(prefix="ebamcheck-benchmark-") as folder:
        out = str(Path(folder, "out.parquet"))
        return command(["slice", str(stl), "--layer-height", f"{layer_mm:g}", "-o", out])


def check_command(
    stl: Path, layer_mm: float, limit_s: float, memory_mb: float = float("inf"), extra: Sequence[str] = ()
) -> dict[str, Any]:
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
            }
            lost = [f"{name} {status}" for name, status in found["backends"].items() if status != "done"]
            if lost and found["status"] == "done":
                # With a slicer less there is less to do: that time would be worth nothing.
                found |= {"status": "failed", "why": f"not all slicers came to an end: {', '.join(lost)}"}
    return found


def command(
    arguments: Sequence[str],
    limit_s: float = COMMAND_LIMIT_S,
    memory_mb: float = float("inf"),
    fine: Sequence[int] = (0,),
) -> dict[str, Any]:
    """Run ``ebamcheck`` with these arguments in a process of its own, as a user starts it, under limits."""
    watched = watch([str(Path(sys.executable).with_name("ebamcheck")), *arguments], limit_s, memory_mb)
    done = watched.code in fine and not watched.ended
    why = f"ended by its limit of {watched.ended}" if watched.ended else "" if done else watched.last_words
    return {
        "status": "done" if done else "over" if watched.ended else "failed",
        "why": why,
        "code": watched.code,
        "wall_s": watched.wall_s,
        "processor_s": watched.processor_s,
        "peak_mb": watched.peak_mb,
    }
