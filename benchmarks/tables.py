"""The tables, in Markdown: the ladder, the targets, and the few lines that the README shows."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import methods
from benchmarks.figures import cell_times, find, first_times, is_scaled, layers_cut, peak_mb
from benchmarks.machine import SORTED
from benchmarks.spread import megabytes, quantity, seconds, spread_text
from benchmarks.target_rows import evaluate, job_results, scale_results
from benchmarks.targets import Figures, Result

Raw = Mapping[str, Any]
REMARKS = Path(__file__).with_name("remarks.toml")

MEANING = (
    "Times are medians over fresh processes with warm kernels, from the file to contours: read, prepare, cut all layers. "
    "`~` marks a time of some layers scaled to all of them (the method works layer by layer), `>` a process that was "
    "ended at the limit. `manifold3d alone` cuts the mesh that our reader has read; "
    f"`{methods.PRUSA_STAGE}` is the time between two lines of its log, without reading and repairing. "
    "Peak memory is that of the whole tree of processes, the interpreter that drives them included."
)


def markdown_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Build a table of Markdown; a bar in a text is escaped.

    Examples
    --------
    >>> print(markdown_table(["a", "b"], [["1", "x|y"]]))
    | a | b |
    |---|---|
    | 1 | x\\|y |
    """
    lines = [list(columns), ["---"] * len(columns), *(list(row) for row in rows)]
    text = ["|".join(["", *(_cell(c) for c in line), ""]) for line in lines]
    return "\n".join(text).replace("| --- ", "|---")


def time_text(cell: Raw | None) -> str:
    """Write what became of a cell in a few characters."""
    if cell is None:
        return ""
    times = cell_times(cell)
    if times is None:
        words = {
            "over": f"> {seconds(cell['limit_s'])}",
            "missing": "not here",
            "failed": "failed",
            "done": "-",
        }
        return words[cell["status"]]
    return f"~{seconds(times.median)}" if is_scaled(cell) else seconds(times.median)


def ladder_text(raw: Raw) -> str:
    """Table of all methods and sizes of each series, and of the largest size in full."""
    lines = [
        "# Slicing times over the size of a part",
        "",
        *_head(raw),
        "",
        f"{MEANING} In brackets: the least and the greatest.",
        "",
    ]
    for series in _series(raw):
        parts = {key: part for key, part in raw["parts"].items() if part["series"] == series}
        names = _measured_methods(raw, parts)
        rows = [
            [f"{part['facets']:,}", *(time_text(find(raw["cells"], key, name)) for name in names)]
            for key, part in parts.items()
        ]
        top = list(parts)[-1]
        lines += [f"## Series `{series}`", "", markdown_table(["facets", *names], rows), ""]
        lines += [f"At {parts[top]['facets']:,} facets:", "", _top_table(raw, top, names), ""]
    lines += _failures(raw)
    return "\n".join(lines)


def targets_text(raw: Raw, gpu: bool = False) -> str:
    """Table of all targets on each series; those of the stencil on a GPU by themselves."""
    remarks = tomllib.loads(REMARKS.read_text(encoding="utf-8"))
    results = {
        series: evaluate(_figures(raw, series), gpu) for series in _series(raw) if raw["targets"].get(series)
    }
    cores = raw["machine"]["cores"]
    columns = ["what", "target"]
    for series in results:
        facets = raw["parts"][f"{series}-{_top(raw, series)}"]["facets"]
        columns += [f"`{series}`, {facets:,} facets", "", "floor"]
    text = ["# Targets", "", *_head(raw), ""]
    if results:
        rows = [_target_row(list(row), remarks) for row in zip(*results.values(), strict=True)]
        text += [markdown_table([*columns, "remark"], rows), ""]
    alone = job_results(raw["job"], cores) if raw.get("job") else []
    alone += scale_results(raw["scale"], cores) if raw.get("scale") else []
    if alone:
        text += [
            markdown_table(
                ["what", "target", "measured", "", "floor", "remark"],
                [_target_row([r], remarks) for r in alone],
            ),
            "",
        ]
    text += [
        f"Scale: `{answer['command']}`, {answer['facets']:,} facets, {answer['wanted_layers']:,} layers.\n"
        for answer in raw.get("scale", [])
    ]
    return "\n".join(text)


def readme_text(raw: Raw) -> str:
    """The lines for the README: every method at the top of each series."""
    lines = []
    series = _series(raw)
    tops = {s: f"{s}-{_top(raw, s)}" for s in series}
    names = _measured_methods(raw, {key: raw["parts"][key] for key in tops.values()})
    columns = ["method"]
    for s in series:
        columns += [f"`{s}`, {raw['parts'][tops[s]]['facets']:,} facets", "peak memory"]
    rows = []
    for name in names:
        row = [name]
        for s in series:
            cell = find(raw["cells"], tops[s], name)
            memory = peak_mb(cell)
            row += [time_text(cell), megabytes(memory.median) if memory else ""]
        rows.append(row)
    machine = raw["machine"]
    lines.append(markdown_table(columns, rows))
    lines.append("")
    lines.append(
        f"{machine['cpu']}, {machine['cores']} cores, OpenGL by {raw['renderer'] or 'nothing'}. {MEANING}"
    )
    return "\n".join(lines) + "\n"


def _target_row(results: Sequence[Result], remarks: Mapping[str, str]) -> list[str]:
    target = results[0].target
    limit = "-" if target.limit is None else f"at most {quantity(target.limit, target.unit)}"
    cells = [text for result in results for text in (result.text, result.verdict, result.floor_text)]
    return [target.what, limit, *cells, remarks.get(target.key, "")]


def _top_table(raw: Raw, part: str, names: Sequence[str]) -> str:
    rows = []
    for name in names:
        cell = find(raw["cells"], part, name)
        times, memory = cell_times(cell), peak_mb(cell)
        if cell is None or times is None or memory is None:
            continue
        steps = [cell_times(cell, (step,)) for step in ("load_s", "prepare_s", "slice_s")]
        first, points = first_times(cell), cell["runs"][-1]["rounds"][-1].get("points")
        cut, there = layers_cut(cell)
        rows.append(
            [
                name,
                ("~" if is_scaled(cell) else "") + spread_text(times),
                seconds(first.median) if first else "",
                *(seconds(step.median) if step else "" for step in steps),
                megabytes(memory.median),
                f"{points:,}" if points else "",
                f"{cut} of {there}" if cut < there else "all",
            ]
        )
    columns = ["method", "time", "first round", "read", "prepare", "slice", "peak memory", "points", "layers"]
    return markdown_table(columns, rows)


def _failures(raw: Raw) -> list[str]:
    """What could not be measured, and why."""
    whys = {
        (c["method"], c["status"], c["why"]) for c in raw["cells"] if c["status"] in ("missing", "failed")
    }
    return [f"- {method}, {status}: {why}" for method, status, why in sorted(whys)] + ([""] if whys else [])


def _head(raw: Raw) -> list[str]:
    machine = raw["machine"]
    packages = ", ".join(f"{name} {found}" for name, found in machine["packages"].items())
    programs = ", ".join(
        f"{name}: {', '.join(f'{k} {v}' for k, v in b['versions'].items())}"
        for name, b in machine["backends"].items()
        if b["available"] and b["priority"] < 0 and b["versions"]
    )
    quick = "**A quick trial of the benchmark itself: its figures mean nothing.** " if raw["quick"] else ""
    return [
        f"{quick}Made by `{raw['command']}` on {machine['started']}: {machine['cpu']}, {machine['cores']} cores, "
        f"{machine['memory_gb']:g} GB, {_speeds(machine)}load at the start {machine['load_at_start'][0]:g}; OpenGL renderer "
        f"{raw['renderer'] or 'none'}; ebamcheck {machine['ebamcheck']} ({machine['commit'] or 'no commit'}), "
        f"Python {machine['python']}, {packages}" + (f"; {programs}" if programs else "") + ".",
    ]


def _speeds(machine: Mapping[str, Any]) -> str:
    """Speed of processor and memory, where they were measured: times of two runs compare over the one, floors are bytes over the other."""
    copies, new = machine.get("copy_bytes_s"), machine.get("touch_bytes_s")
    alone_s, all_s = machine.get("sort_s"), machine.get("sort_on_all_s")
    text = f"copies {1e-9 * copies:.1f} GB/s (read and written), " if copies else ""
    text += f"new memory {1e-9 * new:.1f} GB/s, " if new else ""
    if alone_s and all_s:
        text += f"a core sorts {SORTED // 1_000_000} million numbers in {1e3 * alone_s:.0f} ms, {1e3 * all_s:.0f} ms while all do, "
    return text


def _measured_methods(raw: Raw, parts: Mapping[str, Raw]) -> list[str]:
    """Methods that have a figure or ran over the limit on one of the parts."""
    shown = {c["method"] for c in raw["cells"] if c["part"] in parts and c["status"] in ("done", "over")}
    return [name for name in raw["methods"] if name in shown]


def _series(raw: Raw) -> list[str]:
    return list(dict.fromkeys(part["series"] for part in raw["parts"].values()))


def _top(raw: Raw, series: str) -> int:
    return max(int(part["size"]) for part in raw["parts"].values() if part["series"] == series)


def _figures(raw: Raw, series: str) -> Figures:
    return Figures(
        raw["cells"],
        raw["targets"].get(series, {}),
        raw["parts"],
        series,
        _top(raw, series),
        raw["machine"].get("copy_bytes_s"),
        raw["machine"].get("touch_bytes_s"),
        raw["machine"]["cores"],
    )


def _cell(text: str) -> str:
    escaped = text.replace("|", "\\|")
    return f" {escaped} "
