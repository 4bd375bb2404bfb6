"""Every method on every part, in turns, each measurement in a fresh process; the table of it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from benchmarks.figures import (
    Note,
    Raw,
    Spread,
    cell_times,
    find,
    is_scaled,
    layers_cut,
    machine_text,
    markdown,
    quantity,
    spread,
    spread_text,
    total_s,
)
from benchmarks.parts import BenchmarkPart
from benchmarks.watch import run_task
from ebamcheck.plugins import registry
from ebamcheck.showing.colours import COLOURS
from ebamcheck_reports.paper import published

PAPERS_PIXEL_MM = 0.1
LITERAL = "stencil literal"
MANIFOLD_ALONE, PRUSA_STAGE = "manifold3d alone", "PrusaSlicer's slice stage"

BY_LAYER = ("trimesh",)
"""Backends that do the whole work again for each layer, and so may be timed on some of the layers."""

ENOUGH_S = 60.0
"""A cell whose measured times add up to so much is not repeated: what takes long varies little."""

MEANING = (
    "Times are medians over fresh processes with warm kernels, from the file to contours: read, prepare, cut all layers. "
    "`~` marks a time of some layers scaled to all of them (the method works layer by layer), `>` a process that was "
    "ended at the limit. `manifold3d alone` cuts the mesh that our reader has read; "
    f"`{PRUSA_STAGE}` is the time between two lines of its log, without reading and repairing. "
    "Peak memory is that of the whole tree of processes, the interpreter that drives them included."
)


@dataclass(frozen=True)
class Method:
    """One way of slicing: a backend of the registry with its settings, or one of two programs measured by themselves.

    Of a method `by_layer` nothing is shared between layers: the time of some of them, evenly spread, may be scaled to all.
    """

    name: str
    kind: Literal["backend", "manifold3d", "prusa-stage"] = "backend"
    backend: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    by_layer: bool = False

    def missing(self) -> str:
        """Why this machine cannot run it; empty where it can."""
        if self.kind == "prusa-stage":
            return "" if shutil.which("prusa-slicer") else "the program prusa-slicer is not installed"
        found = registry.probe("manifold" if self.kind == "manifold3d" else self.backend)
        return "" if found.available else found.why


LITERAL_METHOD = Method(
    LITERAL, backend="stencil", settings={"mode": "literal", "pixel_mm": PAPERS_PIXEL_MM}, by_layer=True
)
"""The paper's own method: all facets above a layer are drawn for it."""

GPU_METHODS = (Method("stencil", backend="stencil"), LITERAL_METHOD)


def all_methods() -> list[Method]:
    """Return the methods in the order in which they take turns: house slicers, witnesses, programs by themselves."""
    ranked = sorted(registry.slicers().values(), key=lambda s: (-s.priority, s.name))
    found: list[Method] = []
    for slicer in ranked:
        found.append(Method(slicer.name, backend=slicer.name, by_layer=slicer.name in BY_LAYER))
        found += [LITERAL_METHOD] if slicer.name == "stencil" else []
    return [*found, Method(MANIFOLD_ALONE, "manifold3d"), Method(PRUSA_STAGE, "prusa-stage")]


@dataclass(frozen=True)
class Effort:
    """How much is measured: fresh processes a cell, rounds in each, seconds until one is ended, seconds for some layers."""

    repeats: int = 3
    rounds: int = 3
    limit_s: float = 300.0
    scaled_s: float = 20.0


QUICK = Effort(repeats=1, rounds=2, limit_s=60.0, scaled_s=2.0)


def measure_ladder(
    parts: Sequence[BenchmarkPart],
    methods: Sequence[Method],
    effort: Effort,
    note: Note,
    keep: Callable[[Sequence[Raw]], None],
) -> list[dict[str, Any]]:
    """Measure all methods on all parts, from small to large; `keep` takes all cells so far whenever a part is done.

    A cell is a part and a method: ``part``, ``method``, ``status`` ("done", "over", "failed", "missing"), ``why``, ``limit_s`` and
    ``runs``, the answers of :func:`benchmarks.worker.time_method`. What ran over the limit is not tried on a larger part.
    """
    cells: list[dict[str, Any]] = []
    over: dict[tuple[str, str], int] = {}
    for part in parts:
        of_part = [_cell(part, method, over, effort) for method in methods]
        for repeat in range(effort.repeats):
            for cell, method in zip(of_part, methods, strict=True):
                if cell["status"] == "done" and sum(total_s(run) for run in cell["runs"]) <= ENOUGH_S:
                    note(f"{part.key} ({part.facets:,} facets), {method.name}, turn {repeat + 1}")
                    _add_run(cell, part, method, effort)
        over |= {(part.series, c["method"]): part.facets for c in of_part if c["status"] == "over"}
        cells += of_part
        keep(cells)
    return cells


def _cell(part: BenchmarkPart, method: Method, over: Mapping[tuple[str, str], int], effort: Effort) -> dict[str, Any]:
    """An empty cell; one that cannot be measured says why."""
    status, why = "done", ""
    if missing := method.missing():
        status, why = "missing", missing
    elif (part.series, method.name) in over:
        status, why = "over", f"not tried: over the limit at {over[part.series, method.name]:,} facets"
    return {
        "part": part.key, "method": method.name, "status": status, "why": why, "limit_s": effort.limit_s, "runs": [],
    }  # fmt: skip


def _add_run(cell: dict[str, Any], part: BenchmarkPart, method: Method, effort: Effort) -> None:
    request = {
        "stl": str(part.path),
        "layer_mm": part.layer_mm,
        "method": asdict(method),
        "rounds": effort.rounds,
        "scaled_s": effort.scaled_s,
    }
    answer = run_task("time", request, effort.limit_s)
    if answer["status"] == "done":
        cell["runs"].append(answer)
    elif not cell["runs"]:
        cell["status"], cell["why"] = answer["status"], answer["why"]


# -- tables -------------------------------------------------------------------------------------------------


def time_text(cell: Raw | None) -> str:
    """Write what became of a cell in a few characters."""
    if cell is None:
        return ""
    times = cell_times(cell)
    if times is not None:
        return ("~" if is_scaled(cell) else "") + quantity(times.median, "s")
    words = {"over": f"> {quantity(cell['limit_s'], 's')}", "missing": "not here", "failed": "failed", "done": "-"}  # fmt: skip
    return words[cell["status"]]


def ladder_text(raw: Raw) -> str:
    """Table of all methods and sizes of each series, and of the largest size in full."""
    lines = ["# Slicing times over the size of a part", "", f"Made by `{raw['command']}` on {machine_text(raw['machine'])}"]  # fmt: skip
    lines += ["", f"{MEANING} In brackets: the least and the greatest.", ""]
    for series in series_of(raw):
        parts = {key: part for key, part in raw["parts"].items() if part["series"] == series}
        names = _measured_methods(raw, parts)
        rows = [
            [f"{part['facets']:,}", *(time_text(find(raw["cells"], key, name)) for name in names)]
            for key, part in parts.items()
        ]
        top = list(parts)[-1]
        lines += [f"## Series `{series}`", "", markdown(["facets", *names], rows), ""]
        lines += [f"At {parts[top]['facets']:,} facets:", "", _top_table(raw, top, names), ""]
    failed = {(c["method"], c["status"], c["why"]) for c in raw["cells"] if c["status"] in ("missing", "failed")}  # fmt: skip
    lines += [f"- {method}, {status}: {why}" for method, status, why in sorted(failed)]
    return "\n".join(lines) + "\n"


def readme_text(raw: Raw) -> str:
    """The lines for the README: every method at the top of each series, with peak memory."""
    tops = {series: f"{series}-{top_of(raw, series)}" for series in series_of(raw)}
    columns = ["method"]
    for series, key in tops.items():
        columns += [f"`{series}`, {raw['parts'][key]['facets']:,} facets", "peak memory"]
    rows = []
    for name in _measured_methods(raw, dict.fromkeys(tops.values())):
        row = [name]
        for key in tops.values():
            cell = find(raw["cells"], key, name)
            memory = spread(run["peak_mb"] for run in cell["runs"]) if cell and cell["runs"] else None
            row += [time_text(cell), quantity(memory.median, "MB") if memory else ""]
        rows.append(row)
    machine = raw["machine"]
    where = f"{machine['cpu']}, {machine['cores']} cores, OpenGL by {machine['renderer'] or 'nothing'}. {MEANING}"
    return f"{markdown(columns, rows)}\n\n{where}\n"


def _top_table(raw: Raw, part: str, names: Sequence[str]) -> str:
    rows = []
    for name in names:
        cell = find(raw["cells"], part, name)
        times = cell_times(cell)
        if cell is None or times is None:
            continue
        steps = [cell_times(cell, (step,)) for step in ("load_s", "prepare_s", "slice_s")]
        points = cell["runs"][-1]["rounds"][-1].get("points")
        cut, there = layers_cut(cell)
        rows.append(
            [
                name,
                ("~" if is_scaled(cell) else "") + spread_text(times),
                *(quantity(step.median, "s") if step else "" for step in steps),
                quantity(spread(run["peak_mb"] for run in cell["runs"]).median, "MB"),
                f"{points:,}" if points else "",
                f"{cut} of {there}" if cut < there else "all",
            ]
        )
    return markdown(["method", "time", "read", "prepare", "slice", "peak memory", "points", "layers"], rows)


def _measured_methods(raw: Raw, parts: Mapping[str, Any]) -> list[str]:
    """Methods that have a figure or ran over the limit on one of the parts."""
    shown = {c["method"] for c in raw["cells"] if c["part"] in parts and c["status"] in ("done", "over")}
    return [name for name in raw["methods"] if name in shown]


def series_of(raw: Raw) -> list[str]:
    """Names of the series of parts that were measured."""
    return list(dict.fromkeys(part["series"] for part in raw["parts"].values()))


def top_of(raw: Raw, series: str) -> int:
    """Largest size of a series that was measured."""
    return max(int(part["size"]) for part in raw["parts"].values() if part["series"] == series)


# -- chart --------------------------------------------------------------------------------------------------


MARKS = {"measured": ("o", "full", ""), "scaled": ("o", "none", "~"), "over": ("^", "full", "> ")}
"""Marker, its filling, and the sign before the figure: what is estimated or was cut short looks so."""


def plotted(raw: Raw, series: str) -> dict[str, list[tuple[int, Spread, str]]]:
    """Facets, time and kind of all cells of a series that have a figure or ran over the limit, by method."""
    found: dict[str, list[tuple[int, Spread, str]]] = {}
    for name in raw["methods"]:
        for key, part in raw["parts"].items():
            cell = find(raw["cells"], key, name) if part["series"] == series else None
            if cell is None:
                continue
            if (times := cell_times(cell)) is not None:
                found.setdefault(name, []).append((part["facets"], times, "scaled" if is_scaled(cell) else "measured"))
            elif cell["status"] == "over" and not cell["why"].startswith("not tried"):
                found.setdefault(name, []).append((part["facets"], spread([cell["limit_s"]]), "over"))
    return found


def write_chart(raw: Raw, series: str, path: Path) -> None:
    """Draw times over facets, both logarithmic, with the paper's own figure, as an SVG whose words are text."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "ebamcheck"}):
        figure = Figure(figsize=(10.8, 6.2), layout="constrained")
        axes = figure.add_subplot(xscale="log", yscale="log", xlabel="facets", ylabel="seconds")
        for rank, (name, points) in enumerate(plotted(raw, series).items()):
            colour, dash = COLOURS[rank % len(COLOURS)], ("-", "--", ":")[rank // len(COLOURS) % 3]
            label = f"{name}: {MARKS[points[-1][2]][2]}{quantity(points[-1][1].median, 's')}"
            axes.plot([f for f, _, _ in points], [s.median for _, s, _ in points], dash, color=colour, label=label)
            for facets, times, kind in points:
                marker, filling, _ = MARKS[kind]
                axes.plot(facets, times.median, marker=marker, fillstyle=filling, color=colour)
                axes.vlines(facets, times.least, times.greatest, color=colour)
        words = f"paper: {published.SLICING_S:g} s, {published.FACETS:,} facets, {published.LAYERS} layers;\n"
        words += f"another part, {published.DEVICE.partition(',')[0]}"
        axes.plot(published.FACETS, published.SLICING_S, "*", color="#b3261e", markersize=14, label=words)
        layer_mm = next(p["layer_mm"] for p in raw["parts"].values() if p["series"] == series)
        machine = raw["machine"]
        where = f"{machine['cpu']}, {machine['cores']} cores; layers of {layer_mm:g} mm."
        title = f"Time of slicing by every method, part {series}\n{where} Hollow: scaled from some layers. Arrow: ended at the limit."
        figure.suptitle(title, x=0.01, horizontalalignment="left", fontsize="medium")
        axes.grid(visible=True, which="major", color="#e4e4e4")
        figure.legend(loc="outside right upper", frameon=False)
        figure.savefig(path, format="svg", metadata={"Date": None})
