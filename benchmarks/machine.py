"""What the figures were measured on: machine, load at the start, versions."""

from __future__ import annotations

import os
import platform
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.floors import copy_bandwidth, first_touch
from benchmarks.watch import ROOT
from ebamcheck import __version__
from ebamcheck.kernels import Floats
from ebamcheck.plugins import registry
from ebamcheck.threads import thread_count

PACKAGES = (
    *("numpy", "numba", "llvmlite", "scipy", "shapely", "pyarrow", "pandas", "pydantic"),
    *("manifold3d", "embreex", "moderngl", "PyOpenGL", "trimesh", "scikit-image"),
)

SORTED, SORTS = 4_000_000, 3
"""Numbers that are sorted to see how fast the processor is today, and how often: the fastest sort counts."""


def machine() -> dict[str, Any]:
    """Everything about this machine that a time depends on."""
    return {
        "cpu": _cpu_model(),
        "cores": thread_count(),
        "sort_s": sorting_s(1),
        "sort_on_all_s": sorting_s(thread_count()),
        "copy_bytes_s": copy_bandwidth(),
        "touch_bytes_s": first_touch(),
        "memory_gb": round(psutil.virtual_memory().total / 1e9, 1),
        "system": f"{platform.system()} {platform.release()}",
        "load_at_start": [round(load, 2) for load in os.getloadavg()],
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "python": platform.python_version(),
        "ebamcheck": __version__,
        "commit": _commit(),
        "packages": {name: found for name in PACKAGES if (found := _version(name))},
        "backends": {name: _backend(name) for name in registry.slicers()},
    }


def sorting_s(threads: int) -> float:
    """Seconds in which a thread sorts :data:`SORTED` random numbers while others do the same: virtual cores may share one."""
    numbers = np.random.default_rng(0).random(SORTED)
    with ThreadPoolExecutor(threads) as pool:
        return min(max(pool.map(_sorted_s, [numbers] * threads)) for _ in range(SORTS))


def _sorted_s(numbers: Floats) -> float:
    start = time.perf_counter()
    np.sort(numbers, kind="stable")
    return time.perf_counter() - start


def renderer() -> str:
    """Name of the OpenGL renderer that the stencil backend draws with; empty where there is none."""
    if "stencil" not in registry.slicers():
        return ""
    found = registry.probe("stencil")
    return found.device if found.available else ""


def _backend(name: str) -> dict[str, Any]:
    slicer, found = registry.slicer(name), registry.probe(name)
    return {
        "available": found.available,
        "why": found.why,
        "device": found.device,
        "versions": dict(found.versions),
        "exact": slicer.exact,
        "summary": slicer.summary,
        "priority": slicer.priority,
    }


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
