"""What commands tell on the terminal: the slicers there are, the progress of a job, and what a run came to."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ebamcheck.commands.warm import warm_kernels
from ebamcheck.installed import BrokenPlugin
from ebamcheck.plugins import registry
from ebamcheck.plugins.strangers import StrangerSlicer
from ebamcheck.plugins.trial import TOLD_ATTRIBUTES, cube
from ebamcheck.printable import printable
from ebamcheck.result import Place, in_words
from ebamcheck.showing.short_text import text_table

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


def backend_record(name: str) -> dict[str, Any]:
    """What `ebamcheck backends` knows of a slicer; bounds are those of a cube of 100 mm under default settings."""
    slicer = registry.slicer(name)
    bounds: tuple[float | None, float | None]
    if isinstance(slicer, StrangerSlicer):
        bounds = slicer.answer.bounds_mm or (None, None)
    else:
        part, settings = cube(), slicer.Settings()
        bounds = slicer.error_bound_mm(part, settings), slicer.height_bound_mm(part, settings)
    told = {key: getattr(slicer, key) for key in TOLD_ATTRIBUTES} | asdict(registry.probe(name))
    return told | {"error_bound_mm": bounds[0], "height_bound_mm": bounds[1]}


def backends_text(records: Sequence[Mapping[str, Any]], left_out: Sequence[BrokenPlugin] = ()) -> str:
    """Table of the slicers, why some are not available, and which plugins were left out."""
    plain = ("name", "available", "exact", "device", "coplanar_rule", "inside_rule")
    columns = [*plain[:4], "plane rule", "inside rule", "bound mm", "versions", "summary"]
    rows = []
    for r in records:
        bound = "" if r["error_bound_mm"] is None else r["error_bound_mm"]
        versions = " ".join(f"{k} {v}" for k, v in r["versions"].items())
        rows.append([*(r[name] for name in plain), bound, versions, r["summary"]])
    missing = [r for r in records if not r["available"]]
    told = [f"{r['name']}: {r['why']}" + (f"\n  {r['hint']}" if r["hint"] else "") for r in missing]
    told += [f"left out: {plugin}" for plugin in left_out]
    told.append("The bound is that of a cube of 100 mm under default settings.")
    return "\n\n".join([text_table(columns, rows), *told])


def run_summary(manifest: Mapping[str, Any]) -> str:
    """What a run came to: slicers, pairs, gates, findings and verdict."""
    from ebamcheck.record.certificate import statement

    slicers = [
        [name, b["status"], b["rings"], b["open_paths"], b["points"], float(b["error_bound_mm"]),
         float(manifest["timings"]["backends"][name]["slice_s"]), b["why"] or b["device"]]
        for name, b in manifest["backends"].items()
    ]  # fmt: skip
    figures = ("max_depth_mm", "limit_mm", "max_hausdorff_mm", "min_iou")
    pairs = [
        [f"{p['a']} / {p['b']}", f"{p['agree']} of {p['gated']}", *(p[figure] for figure in figures)]
        for p in manifest["comparison"]["pairs"]
    ]
    tables = (
        (["slicer", "status", "rings", "open", "points", "bound mm", "seconds", ""], slicers),
        (["pair", "layers agree", "depth mm", "limit mm", "Hausdorff mm", "least IoU"], pairs),
        (
            ["", "gate", ""],
            [["pass" if g["passed"] else "FAIL", g["name"], g["text"]] for g in manifest["gates"]],
        ),
        (
            ["", "finding", ""],
            [[f["severity"], f["code"], in_words(f)] for f in manifest.get("findings", [])],
        ),
    )
    good, bad = ("AGREED", "NOT AGREED") if manifest.get("job") == "check" else ("VALIDATED", "NOT VALIDATED")
    word = good if manifest["exit_code"] == 0 else f"{bad} (exit code {manifest['exit_code']})"
    verdict = "\n".join([word, *statement(manifest).lines()])
    blocks = [worst_line(manifest), *(text_table(*table) for table in tables if table[1]), verdict]
    return "\n\n".join(block for block in blocks if block)


def worst_line(manifest: Mapping[str, Any]) -> str:
    """The worst finding of a run that failed: a part that is none, else slicers that disagree, else faults, else the first shut
    gate."""
    if not manifest["exit_code"]:
        return ""
    shut = {gate["name"]: gate for gate in manifest["gates"] if not gate["passed"]}
    disagreements = manifest["comparison"]["findings"]
    faults = [f for f in manifest.get("findings", []) if f["severity"] == "fault"]
    if "input" in shut:
        return f"WORST: {shut['input']['text']}"
    if "agreement" in shut and disagreements:
        return f"WORST: {_disagreement(max(disagreements, key=lambda f: (_excess(f), -f['layer'])))}"
    if faults and "agreement" not in shut:
        return f"WORST: {in_words(faults[0])}"
    gate = next(iter(shut.values()), None)
    return f"WORST: {gate['name']}: {gate['text']}" if gate else ""


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
    """Shows what is noted of a run, line by line on standard error; bars are for terminals."""

    def stage(self, name: str, total: int) -> None:
        """Begin a stage."""

    def advance(self, steps: int) -> None:
        """Go on within it."""

    def note(self, text: str) -> None:
        """Print a line."""
        print(f"ebamcheck: {printable(text)}", file=sys.stderr)


class TerminalObserver(LineObserver):
    """Shows the stages of a run as bars, and notes above them."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._task: TaskID | None = None

    def stage(self, name: str, total: int) -> None:
        """Fill the bar of the last stage and begin one."""
        self.finish()
        self._task = self._bars.add_task(name, total=max(total, 1))

    def advance(self, steps: int) -> None:
        """Move the bar of the stage."""
        if self._task is not None:
            self._bars.advance(self._task, steps)

    def note(self, text: str) -> None:
        """Print a line above the bars."""
        line = f"ebamcheck: {printable(text)}"
        self._bars.console.print(line, markup=False, highlight=False, soft_wrap=True)

    def finish(self) -> None:
        """Fill the bar of the last stage."""
        if self._task is not None:
            self._bars.update(self._task, completed=self._bars.tasks[self._task].total)


@contextmanager
def watched() -> Iterator[LineObserver]:
    """Show progress while the block runs, which begins with all kernels compiled."""
    warm_kernels()
    # What shows bars takes a tenth of a second to load.
    forced = any(os.environ.get(name) for name in ("FORCE_COLOR", "TTY_COMPATIBLE"))
    if not (sys.stderr.isatty() or forced):
        yield LineObserver()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console, share = Console(stderr=True), TextColumn("{task.percentage:>3.0f} %")
    columns = (TextColumn("{task.description:>20}"), BarColumn(), share, TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        observer = TerminalObserver(bars)
        yield observer
        observer.finish()
