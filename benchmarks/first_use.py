"""``python -m benchmarks.first_use``: what a new install waits for: its kernels, its first slice, its first run, the demo.

Each command works with an empty cache of kernels, and once more when they are compiled. ``demo`` is ``make demo`` in a copy
of the checkout's files, with all its set-up.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.figures import machine
from benchmarks.parts import DEMO_REFERENCE_MM, DEMO_TOLERANCE_MM, model_file
from benchmarks.watch import ROOT, children_s, user_environment

SOURCES = ("ebamcheck", "backends", "reference_models", "reports")


class Took(NamedTuple):
    """What a command took."""

    wall_s: float
    processor_s: float
    """Of it and of all processes that it waited for."""


COMMANDS = "warm", "slice", "run", "demo"
SHOWN = {"demo": "`make demo`"}
"""What a row is called that is not the command of its name."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print a table."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.first_use", description=__doc__)
    options.add_argument("--commands", default=",".join(COMMANDS), help="of these, by comma")
    chosen = options.parse_args(arguments).commands.split(",")
    here = machine()
    print(f"{here['cpu']}, {here['cores']} cores, load {here['load_at_start'][0]}, commit {here['commit']}\n")
    print("| command | first: wall, s | second: wall, s | first: processor, s | second: processor, s |")
    print("|---|---|---|---|---|")
    for name in chosen:
        first, second = first_use(name)
        print(
            f"| {SHOWN.get(name, f'`ebamcheck {name}`')} | {first.wall_s:.1f} | {second.wall_s:.1f} | "
            f"{first.processor_s:.1f} | {second.processor_s:.1f} |",
            flush=True,
        )
    return 0


def first_use(name: str) -> tuple[Took, Took]:
    """Run one of the commands twice, where nothing is compiled before."""
    with tempfile.TemporaryDirectory(prefix="ebamcheck-first-use-") as folder:
        copy = Path(folder, "copy")
        if name == "demo":
            _copy_checkout(copy)
            make = ["make", "demo"]
            # Set up from nothing, as in a new clone: nothing of this interpreter's environment.
            env = {**user_environment("VIRTUAL_ENV", "PYTHONPATH"), "NUMBA_CACHE_DIR": f"{folder}/kernels"}
            return _timed(copy, make, env), _timed(copy, make, env)
        part, fine = (model_file("blade", tolerance) for tolerance in (DEMO_TOLERANCE_MM, DEMO_REFERENCE_MM))
        for source in SOURCES:
            shutil.copytree(ROOT / source, copy / source)
        arguments = {
            "warm": ["warm"],
            "slice": ["slice", str(part), "--layer-height", "5", "-o", f"{folder}/out.parquet"],
            "run": ["run", str(part), "--reference", str(fine), "--force", "-o", f"{folder}/run"],
        }[name]
        command = [sys.executable, "-m", "ebamcheck", *arguments]
        paths = [str(copy), *(str(copy / source) for source in SOURCES[1:])]
        env = {
            **user_environment(),
            "PYTHONPATH": os.pathsep.join(paths),
            "NUMBA_CACHE_DIR": f"{folder}/kernels",
        }
        return _timed(copy, command, env), _timed(copy, command, env)


def _copy_checkout(to: Path) -> None:
    """Copy what a clone of this checkout has: the files that git keeps, as they are."""
    told = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in filter(None, told.stdout.split("\0")):
        target = to / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, target)


def _timed(copy: Path, command: list[str], env: dict[str, str]) -> Took:
    before_s, start = children_s(), time.perf_counter()
    subprocess.run(command, cwd=copy, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    wall_s = time.perf_counter() - start
    return Took(wall_s, children_s() - before_s)


if __name__ == "__main__":
    sys.exit(main())
