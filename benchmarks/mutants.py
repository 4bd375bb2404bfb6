"""Whether the tests notice a wrong change of the code: ``python -m benchmarks.mutants [--room NAME]``; reports/benchmarks/mutants.md.

Each row of ``benchmarks/mutations/ROOM.toml`` is one wrong change (a comparison turned, a limit times ten, a sign, a term dropped)
with the tests that stand at the room's door. A row is tried in a copy of the tree: it is found where one of those tests fails.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.figures import machine, machine_text, markdown
from benchmarks.watch import ROOT

ROWS = Path(__file__).with_name("mutations")
REPORT = ROOT / "reports" / "benchmarks" / "mutants.md"

LONGEST_S = 600.0
"""A wrong change may never end; one that takes so long is found."""


@dataclass(frozen=True)
class Mutant:
    """One wrong change: `old` stands once in `file`, `new` takes its place, and the `tests` of the room should fail."""

    room: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def planted(self, text: str) -> str:
        """Text of the file with the wrong change.

        Raises
        ------
        ValueError
            Where `old` doesn't stand there exactly once: the code has moved on, and the row has to follow.
        """
        if text.count(self.old) != 1:
            raise ValueError(f"{self.room}: {self.file} holds {text.count(self.old)} times {self.old!r}, not once")
        return text.replace(self.old, self.new)


def mutants(rooms: Iterable[str] = ()) -> list[Mutant]:
    """Rows of all rooms, or of those named."""
    wanted = set(rooms)
    return [
        Mutant(path.stem, row["file"], row["old"], row["new"], tuple(row["tests"]))
        for path in sorted(ROWS.glob("*.toml"))
        if not wanted or path.stem in wanted
        for row in tomllib.loads(path.read_text(encoding="utf-8"))["mutant"]
    ]


def sampled(rows: Sequence[Mutant], per_room: int, seed: int) -> list[Mutant]:
    """At most so many rows of each room, drawn by a seed; 0 for all."""
    order = random.Random(seed).sample(range(len(rows)), len(rows))
    ranks: dict[str, int] = {}
    kept = []
    for row in order:
        ranks[rows[row].room] = ranks.get(rows[row].room, 0) + 1
        if not per_room or ranks[rows[row].room] <= per_room:
            kept.append(row)
    return [rows[row] for row in sorted(kept)]


def copied_tree(folder: Path) -> None:
    """Copy the tracked files of the project, as they are now, into a folder."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in listed.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


def failures(tree: Path, tests: Sequence[str]) -> tuple[int, int, float]:
    """Tests that fail in a tree, all that ran, and the seconds that it took; a run that never ends counts as one failure."""
    places = [tree, *(tree / name for name in ("backends", "reference_models", "reports"))]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, places)),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "--tb=no",
        "-p",
        "no:cacheprovider",
        "-m",
        "not slow and not long",
        *tests,
    ]
    begin = time.perf_counter()
    try:
        ended = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        return 1, 1, LONGEST_S
    counts = {word: int(count) for count, word in re.findall(r"(\d+) (passed|failed|error)", ended.stdout)}
    failed = counts.get("failed", 0) + counts.get("error", 0)
    if ended.returncode not in (0, 1) and not failed:
        failed = 1  # the change keeps the tests from being collected
    return failed, failed + counts.get("passed", 0), time.perf_counter() - begin


def tried(rows: Sequence[Mutant]) -> pd.DataFrame:
    """Try each row; one line a row with the tests that found it.

    Raises
    ------
    SystemExit
        Where tests fail on the code as it is: then no row could be judged.
    """
    with tempfile.TemporaryDirectory(prefix="mutants-") as name:
        tree = Path(name) / "tree"
        copied_tree(tree)
        sound, ran, seconds = failures(tree, sorted({test for row in rows for test in row.tests}))
        if sound or not ran:
            raise SystemExit(f"{sound} of {ran} tests fail without any change: mend them first")
        print(f"the code as it is: {ran} tests pass in {seconds:.0f} s", flush=True)
        lines: list[dict[str, Any]] = []
        for row in rows:
            path = tree / row.file
            text = path.read_text(encoding="utf-8")
            path.write_text(row.planted(text), encoding="utf-8")
            failed, ran, seconds = failures(tree, row.tests)
            path.write_text(text, encoding="utf-8")
            lines.append({"room": row.room, "file": row.file, "change": f"{row.old.strip()} -> {row.new.strip()}",
                          "found": failed > 0, "by": failed, "of": ran, "s": round(seconds)})  # fmt: skip
            print(
                f"{row.room}: {lines[-1]['change'][:90]!r}: {failed} of {ran} tests fail ({seconds:.0f} s)",
                flush=True,
            )
    return pd.DataFrame(lines)


def report(table: pd.DataFrame, written: int) -> str:
    """Markdown page: a line a room, then the rows that no test found."""
    rooms = (
        table.groupby("room").agg(tried=("found", "size"), found=("found", "sum"), by=("by", "median")).reset_index()
    )
    missed = table.loc[~table["found"], ["room", "file", "change"]]
    text = f"# Wrong changes of the code, and whether tests find them\n\n{machine_text(machine())}\n\n"
    text += f"{len(table)} of {written} changes were tried; {int(table['found'].sum())} were found.\n\n"
    text += markdown(["room", "tried", "found", "tests that found one, median"], rooms.to_numpy().tolist()) + "\n"
    return text + (
        "\n## Not found\n\n" + markdown(list(missed.columns), missed.to_numpy().tolist()) + "\n" if len(missed) else ""
    )


def main(argv: list[str] | None = None) -> int:
    """Try the sampled rows and print the page; 0 where every wrong change is found."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutants", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--room", action="append", default=[], help="rows of this room alone; may be given again")
    parser.add_argument(
        "--each",
        type=int,
        default=2,
        metavar="N",
        help="rows of each room, drawn by the seed; 0 for all (default: 2)",
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, default=None, metavar="FILE", help="write the page here")
    options = parser.parse_args(argv)
    rows = mutants(options.room)
    table = tried(sampled(rows, options.each, options.seed))
    page = report(table, len(rows))
    print(page)
    if options.output:
        options.output.write_text(page, encoding="utf-8")
    return 0 if table["found"].all() else 1


if __name__ == "__main__":
    sys.exit(main())
