"""Every method on every part, in turns, each measurement in a fresh process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.figures import total_s
from benchmarks.methods import Method
from benchmarks.parts import BenchmarkPart
from benchmarks.watch import run_task

Note = Callable[[str], None]
Raw = dict[str, Any]

ENOUGH_S = 60.0
"""A cell whose measured times add up to so much is not repeated: what takes long varies little."""


@dataclass(frozen=True)
class Effort:
    """How often and how long things are measured.

    Parameters
    ----------
    repeats
        Fresh processes a cell.
    rounds
        Rounds in each process.
    limit_s
        A process is ended after so long, and its cell says so.
    scaled_s
        Time for a method that works layer by layer; it cuts as many layers as it takes.
    """

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
) -> list[Raw]:
    """Measure all methods on all parts.

    Parameters
    ----------
    parts
        From small to large, series by series.
    methods
        In the order in which they take turns.
    effort
        How often and how long.
    note
        Told of each measurement.
    keep
        Called with all cells so far whenever a part is done, so that little is lost where the machine stops.

    Returns
    -------
    One cell a part and method: ``part``, ``method``, ``status`` ("done", "over", "failed", "missing"), ``why``,
    ``limit_s`` and ``runs``, the answers of :func:`benchmarks.timing.time_method`.
    """
    cells: list[Raw] = []
    over: dict[tuple[str, str], int] = {}
    for part in parts:
        of_part = [_cell(part, method, over, effort) for method in methods]
        for repeat in range(effort.repeats):
            for cell, method in zip(of_part, methods, strict=True):
                if cell["status"] == "done" and not _enough(cell):
                    note(f"{part.key} ({part.facets:,} facets), {method.name}, turn {repeat + 1}")
                    _add_run(cell, part, method, effort)
        over |= {(part.series, c["method"]): part.facets for c in of_part if c["status"] == "over"}
        cells += of_part
        keep(cells)
    return cells


def _cell(part: BenchmarkPart, method: Method, over: dict[tuple[str, str], int], effort: Effort) -> Raw:
    """An empty cell; one that cannot be measured says why."""
    status, why = "done", ""
    if missing := method.missing():
        status, why = "missing", missing
    elif (part.series, method.name) in over:
        status, why = "over", f"not tried: over the limit at {over[part.series, method.name]:,} facets"
    return {
        "part": part.key, "method": method.name, "status": status, "why": why, "limit_s": effort.limit_s, "runs": [],
    }  # fmt: skip


def _enough(cell: Raw) -> bool:
    return sum(total_s(run) for run in cell["runs"]) > ENOUGH_S


def _add_run(cell: Raw, part: BenchmarkPart, method: Method, effort: Effort) -> None:
    request = {
        "stl": str(part.path),
        "layer_mm": part.layer_mm,
        "method": method.as_dict(),
        "rounds": effort.rounds,
        "scaled_s": effort.scaled_s,
    }
    answer = run_task("time", request, effort.limit_s)
    if answer["status"] == "done":
        cell["runs"].append(answer)
    elif not cell["runs"]:
        cell["status"], cell["why"] = answer["status"], answer["why"]
