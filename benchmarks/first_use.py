"""``python -m benchmarks.first_use``: what a new install waits for: its kernels, its first slice, its first run.

Each command works in a copy of the sources without a compiled kernel, and once more when they are compiled.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.machine import machine
from benchmarks.parts import model_file
from benchmarks.target_tasks import DEMO_REFERENCE_MM, DEMO_TOLERANCE_MM
from benchmarks.watch import ROOT

SOURCES = ("ebamcheck", "backends", "reference_models", "reports")
COMPILED = ("*.nbi", "*.nbc")


class Took(NamedTuple):
    """What a command took."""

    wall_s: float
    processor_s: float
    """Of it and of all processes that it waited for; what compiles beside it is ended, not waited for."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print a table."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.first_use", description=__doc__)
    options.add_argument("--commands", default="warm,slice,run", help="of these, by comma")
    chosen = options.parse_args(arguments).commands.split(",")
    part, fine = (model_file("blade", tolerance) for tolerance in (DEMO_TOLERANCE_MM, DEMO_REFERENCE_MM))
    here = machine()
    print(f"{here['cpu']}, {here['cores']} cores, load {here['load_at_start'][0]}, commit {here['commit']}\n")
    print("| command | first: wall, s | second: wall, s | first: processor, s | second: processor, s |")
    print("|---|---|---|---|---|")
    with tempfile.TemporaryDirectory(prefix="ebamcheck-first-use-") as folder:
        commands = {
            "warm": ["warm"],
            "slice": ["slice", str(part), "--layer-height", "5", "-o", f"{folder}/out.parquet"],
            "run": ["run", str(part), "--reference", str(fine), "--force", "-o", f"{folder}/run"],
        }
        for name in chosen:
            copy = Path(folder, f"copy-{name}")
            _copy_sources(copy)
            first, second = (_timed(copy, commands[name]) for _ in range(2))
            print(
                f"| `ebamcheck {name}` | {first.wall_s:.1f} | {second.wall_s:.1f} | "
                f"{first.processor_s:.1f} | {second.processor_s:.1f} |",
                flush=True,
            )
    return 0


def _copy_sources(to: Path) -> None:
    """Copy the packages, with their bytecode and without a compiled kernel."""
    for source in SOURCES:
        shutil.copytree(ROOT / source, to / source, ignore=shutil.ignore_patterns(*COMPILED))


def _timed(copy: Path, arguments: list[str]) -> Took:
    paths = [str(copy), *(str(copy / source) for source in SOURCES[1:])]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "ebamcheck", *arguments],
        cwd=copy,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=True,
    )
    wall_s = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Took(wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


if __name__ == "__main__":
    sys.exit(main())
