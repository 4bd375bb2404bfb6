"""What commands tell on the terminal: the slicers there are, the progress of a job, and what a run came to."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ebamcheck.backend import Slicer
from ebamcheck.commands.warm import warm_kernels
from ebamcheck.installed import BrokenPlugin
from ebamcheck.plugins import registry
from ebamcheck.plugins.strangers import StrangerSlicer
from ebamcheck.plugins.trial import TOLD_ATTRIBUTES, cube
from ebamcheck.printable import printable
from ebamcheck.result import Place, in_words
from ebamcheck.showing.short_text import text_table

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID


def backend_record(name: str) -> dict[str, Any]:
    """What `ebamcheck backends` knows of a slicer; bounds are those of a cube of 100 mm under default settings."""
    slicer, probe = registry.slicer(name), registry.probe(name)
    error_mm, height_mm = _bounds_of_cube(slicer)
    return {
        **{key: getattr(slicer, key) for key in TOLD_ATTRIBUTES},
        **asdict(probe),
        "error_bound_mm": error_mm,
        "height_bound_mm": height_mm,
    }


def _bounds_of_cube(slicer: Slicer) -> tuple[float | None, float | None]:
    """Bounds of a cube of 100 mm; of a stranger as it has told them."""
    if isinstance(slicer, StrangerSlicer):
        return slicer.answer.bounds_mm or (None, None)
    part, settings = cube(), slicer.Settings()
    return slicer.error_bound_mm(part, settings), slicer.height_bound_mm(part, settings)


def broken_record(plugin: BrokenPlugin) -> dict[str, Any]:
    """What `ebamcheck backends` knows of a plugin that was left out."""
    return {**vars(plugin), "available": False, "broken": True}


def backends_text(records: Sequence[Mapping[str, Any]], left_out: Sequence[BrokenPlugin] = ()) -> str:
    """Table of the slicers, why some are not available, and which plugins were left out."""
    columns = [
        *("name", "available", "exact", "device", "plane rule", "inside rule", "bound mm"),
        "versions",
        "summary",
    ]
    rows = [
        [
            r["name"], r["available"], r["exact"], r["device"], r["coplanar_rule"], r["inside_rule"],
            "" if r["error_bound_mm"] is None else r["error_bound_mm"], " ".join(f"{k} {v}" for k, v in r["versions"].items()), r["summary"],
        ]
        for r in records
    ]  # fmt: skip
    missing = [
        f"{r['name']}: {r['why']}" + (f"\n  {r['hint']}" if r["hint"] else "")
        for r in records
        if not r["available"]
    ]
    bound = "The bound is that of a cube of 100 mm under default settings."
    unusable = [f"left out: {plugin}" for plugin in left_out]
    return "\n\n".join([text_table(columns, rows), *missing, *unusable, bound])


PAIR_FIGURES = ("max_depth_mm", "limit_mm", "max_hausdorff_mm", "min_iou")


def run_summary(manifest: Mapping[str, Any]) -> str:
    """What a run came to: slicers, pairs, gates, findings and verdict."""

    slicers = [
        [name, b["status"], b["rings"], b["open_paths"], b["points"], float(b["error_bound_mm"]),
         float(manifest["timings"]["backends"][name]["slice_s"]), b["why"] or b["device"]]
        for name, b in manifest["backends"].items()
    ]  # fmt: skip
    pairs = [
        [f"{p['a']} / {p['b']}", f"{p['agree']} of {p['gated']}", *(p[figure] for figure in PAIR_FIGURES)]
        for p in manifest["comparison"]["pairs"]
    ]
    passed = [["pass" if g["passed"] else "FAIL", g["name"], g["text"]] for g in manifest["gates"]]
    found = [[f["severity"], f["code"], in_words(f)] for f in manifest.get("findings", [])]
    blocks = [
        worst_line(manifest),
        text_table(["slicer", "status", "rings", "open", "points", "bound mm", "seconds", ""], slicers),
        text_table(["pair", "layers agree", "depth mm", "limit mm", "Hausdorff mm", "least IoU"], pairs)
        if pairs
        else "",
        text_table(["", "gate", ""], passed),
        text_table(["", "finding", ""], found) if found else "",
        _verdict(manifest),
    ]
    return "\n\n".join(block for block in blocks if block)


def _verdict(manifest: Mapping[str, Any]) -> str:
    """The last word on a job, of a program another than of a cross-check alone, and what it means."""
    from ebamcheck.record.certificate import statement

    good, bad = ("AGREED", "NOT AGREED") if manifest.get("job") == "check" else ("VALIDATED", "NOT VALIDATED")
    word = good if manifest["exit_code"] == 0 else f"{bad} (exit code {manifest['exit_code']})"
    return "\n".join([word, *statement(manifest).lines()])


def worst_line(manifest: Mapping[str, Any]) -> str:
    """The worst finding of a run that failed, with cause, size and place; empty for one that passed.

    A part that is none goes first, then slicers that disagree, then faults, then the first gate that is shut.
    """
    if not manifest["exit_code"]:
        return ""
    shut = {gate["name"]: gate for gate in manifest["gates"] if not gate["passed"]}
    disagreements = manifest["comparison"]["findings"]
    faults = [f for f in manifest.get("findings", []) if f["severity"] == "fault"]
    if "input" in shut:
        said = shut["input"]["text"]
    elif "agreement" in shut and disagreements:
        said = _disagreement(max(disagreements, key=lambda f: (_excess(f), -f["layer"])))
    elif faults and "agreement" not in shut:
        said = in_words(faults[0])
    elif shut:
        gate = next(iter(shut.values()))
        said = f"{gate['name']}: {gate['text']}"
    else:
        return ""
    return f"WORST: {said}"


def _excess(finding: Mapping[str, Any]) -> float:
    value, limit = float(finding["value"]), float(finding["limit"])
    return value / limit if limit > 0.0 else math.inf


def _disagreement(f: Mapping[str, Any]) -> str:
    cause = f.get("cause_text") or f["cause"]
    place = Place(layer=f["layer"] - 1, cut_mm=f["height_mm"], z_mm=float(f.get("program_z_mm", math.nan)))
    size = f"{float(f['value']):.4g} over {float(f['limit']):.4g}"
    where = f"({float(f['x_mm']):.3f}, {float(f['y_mm']):.3f}) of {place}"
    remedy = f"; {f['remedy']}" if f.get("remedy") else ""
    return f"{f['backend']} against {f['against']}: {cause}; {f['metric']} {size} at {where}{remedy}"


class LineObserver:
    """Shows what is noted of a run, line by line on standard error."""

    def stage(self, name: str, total: int) -> None:
        """Show nothing: a bar is for terminals."""

    def advance(self, steps: int) -> None:
        """Show nothing."""

    def note(self, text: str) -> None:
        """Print a line."""
        print(f"ebamcheck: {printable(text)}", file=sys.stderr)


class TerminalObserver:
    """Shows the stages of a run on a terminal."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._task: TaskID | None = None

    def stage(self, name: str, total: int) -> None:
        """Finish the bar of the last stage and begin one."""
        self.finish()
        self._task = self._bars.add_task(name, total=max(total, 1))

    def advance(self, steps: int) -> None:
        """Move the bar of the stage."""
        if self._task is not None:
            self._bars.advance(self._task, steps)

    def note(self, text: str) -> None:
        """Print a line above the bars."""
        self._bars.console.print(
            f"ebamcheck: {printable(text)}", markup=False, highlight=False, soft_wrap=True
        )

    def finish(self) -> None:
        """Fill the bar of the last stage."""
        if self._task is not None:
            task = self._bars.tasks[self._task]
            self._bars.update(self._task, completed=task.total)


@contextmanager
def watched() -> Iterator[LineObserver | TerminalObserver]:
    """Show progress while the block runs, which begins with all kernels compiled."""
    warm_kernels()
    if not may_be_terminal():
        yield LineObserver()
        return
    from rich.console import Console

    with _bars(Console(stderr=True)) as bars:
        observer = TerminalObserver(bars)
        yield observer
        observer.finish()


def may_be_terminal() -> bool:
    """Whether bars may be shown: what shows them takes a tenth of a second to load."""
    return sys.stderr.isatty() or any(os.environ.get(name) for name in ("FORCE_COLOR", "TTY_COMPATIBLE"))


def _bars(console: Console) -> Progress:
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description:>20}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=console, disable=not console.is_terminal)
