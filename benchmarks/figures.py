"""Figures: medians with their spread, how they are written, and the machine that they were taken on."""

from __future__ import annotations

import math
import os
import platform
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import Any

import psutil

from benchmarks.watch import ROOT
from ebamcheck import __version__
from ebamcheck.plugins import registry
from ebamcheck.threads import thread_count

Raw = Mapping[str, Any]
Note = Callable[[str], None]
STEPS = ("load_s", "prepare_s", "slice_s")
"""Reading the file; what the method needs of the part; cutting all layers."""

PACKAGES = (
    *("numpy", "numba", "llvmlite", "scipy", "shapely", "pyarrow", "pandas", "pydantic"),
    *("manifold3d", "embreex", "moderngl", "PyOpenGL", "trimesh", "scikit-image"),
)


@dataclass(frozen=True)
class Spread:
    """Repeated figures: their median, the least and the greatest, and how many there are."""

    median: float
    least: float
    greatest: float
    count: int = 1


def spread(values: Iterable[float]) -> Spread:
    """Return the median and the spread of at least one figure.

    >>> spread([3.0, 1.0, 2.0, 10.0, 2.0])
    Spread(median=2.0, least=1.0, greatest=10.0, count=5)
    """
    given = [float(v) for v in values]
    if not given:
        raise ValueError("no figures: give at least one")
    return Spread(median(given), min(given), max(given), len(given))


def ratio(a: Spread | None, b: Spread | None) -> Spread | None:
    """Ratio of two medians, with the least and greatest that the spreads allow."""
    if a is None or b is None or b.least <= 0.0:
        return None
    return Spread(a.median / b.median, a.least / b.greatest, a.greatest / b.least, min(a.count, b.count))


def quantity(value: float, unit: str) -> str:
    """Write a figure in its unit: ``"s"``, ``"MB"``, ``"mm"``, or ``""`` for a ratio or a count.

    >>> [quantity(v, "s") for v in (0.0042, 0.31415, 1.5512, 247.4)], quantity(8192.0, "MB")
    (['4.20 ms', '314 ms', '1.55 s', '247 s'], '8.19 GB')
    """
    if unit == "s":
        return f"{_digits(1e3 * value)} ms" if value < 1.0 else f"{_digits(value)} s"
    if unit == "MB":
        return f"{value:.0f} MB" if value < 1000.0 else f"{_digits(value / 1000.0)} GB"
    return f"{value:.3g} {unit}".rstrip()


def spread_text(figures: Spread, unit: str = "s") -> str:
    """Write a median, with the least and greatest where there are several.

    >>> spread_text(spread([0.31, 0.30, 0.35]))
    '310 ms (300 ms .. 350 ms, n = 3)'
    """
    middle = quantity(figures.median, unit)
    if figures.count == 1:
        return middle
    return f"{middle} ({quantity(figures.least, unit)} .. {quantity(figures.greatest, unit)}, n = {figures.count})"


def _digits(value: float) -> str:
    """Three digits, and all of them before the point."""
    if value <= 0.0 or not math.isfinite(value):
        return f"{value:.3g}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(value) + 1e-12))}f}"


def markdown(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Build a table of Markdown; a bar in a text is escaped.

    >>> print(markdown(["a", "b"], [["1", "x|y"]]))
    | a | b |
    |---|---|
    | 1 | x\\|y |
    """
    lines = [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
    for row in rows:
        cells = [str(cell).replace("|", "\\|") for cell in row]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


# -- a cell: the runs of one method on one part -------------------------------------------------------------


def total_s(run: Raw, steps: Iterable[str] = STEPS) -> float:
    """Time of a process: the median of its rounds but the first, which pays for memory that is new to it.

    The slicing time of some layers is scaled to all of them.
    """
    steps = tuple(steps)

    def round_s(taken: Raw) -> float:
        scale = taken["layers"] / taken["layers_cut"] if taken["layers_cut"] else 1.0
        return sum(float(taken[step]) * (scale if step == "slice_s" else 1.0) for step in steps)

    return median(round_s(taken) for taken in run["rounds"][1:] or run["rounds"])


def cell_times(cell: Raw | None, steps: Iterable[str] = STEPS) -> Spread | None:
    """Times of a cell, one figure a process; None where it was not measured."""
    if cell is None or not cell["runs"]:
        return None
    steps = tuple(steps)
    return spread(total_s(run, steps) for run in cell["runs"])


def layers_cut(cell: Raw) -> tuple[int, int]:
    """Layers that were cut in the last round, and layers that there are."""
    last = cell["runs"][-1]["rounds"][-1]
    return last["layers_cut"], last["layers"]


def is_scaled(cell: Raw) -> bool:
    """Whether the time of some layers stands for all."""
    return bool(cell["runs"]) and layers_cut(cell)[0] < layers_cut(cell)[1]


def find(cells: Sequence[Raw], part: str, method: str) -> Raw | None:
    """Return the cell of a part and a method."""
    return next((c for c in cells if c["part"] == part and c["method"] == method), None)


# -- the machine --------------------------------------------------------------------------------------------


def machine() -> dict[str, Any]:
    """Everything about this machine that a time depends on."""
    return {
        "cpu": _cpu_model(),
        "cores": thread_count(),
        "memory_gb": round(psutil.virtual_memory().total / 1e9, 1),
        "system": f"{platform.system()} {platform.release()}",
        "load_at_start": [round(load, 2) for load in os.getloadavg()],
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "python": platform.python_version(),
        "ebamcheck": __version__,
        "commit": _commit(),
        "packages": {name: found for name in PACKAGES if (found := _version(name))},
        "renderer": renderer(),
    }


def machine_text(machine: Raw) -> str:
    """Say what figures were taken on, in one sentence."""
    packages = ", ".join(f"{name} {found}" for name, found in machine["packages"].items())
    return (
        f"{machine['started']}: {machine['cpu']}, {machine['cores']} cores, {machine['memory_gb']:g} GB, load at the start "
        f"{machine['load_at_start'][0]:g}; OpenGL by {machine['renderer'] or 'nothing'}; ebamcheck {machine['ebamcheck']} "
        f"({machine['commit'] or 'no commit'}), Python {machine['python']}, {packages}."
    )


def renderer() -> str:
    """Name of the OpenGL renderer that the stencil backend draws with; empty where there is none."""
    if "stencil" not in registry.slicers():
        return ""
    found = registry.probe("stencil")
    return found.device if found.available else ""


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")


def _commit() -> str:
    """The commit that was measured, with a mark where files had been changed; empty outside a repository."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=10", "--exclude=*"]
    try:
        found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=30, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return found.stdout.strip()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
