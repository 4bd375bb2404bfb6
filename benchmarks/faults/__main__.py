"""``python -m benchmarks.faults``: plant all faults, have them verified, and write the tables."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Collection, Iterator, Sequence
from functools import partial
from pathlib import Path

from benchmarks.faults import tables
from benchmarks.faults.honest import honest_runs
from benchmarks.faults.planting import Planter, Result, Results, faults
from benchmarks.faults.subjects import CONTROLS, Workshop, code_digest, plant_digest
from benchmarks.watch import ROOT
from ebamcheck.atomic_file import replacing

OUTPUT = ROOT / "reports" / "faults"
WORK = Path(__file__).parent / ".work"
SEED = 13
NOTED_EVERY = 20

PART = "prism"
"""Part of the quick faults: it has long ways, and is verified soon; where a fault needs bores or arcs, another part serves."""

QUICK = dict(
    line.split(" | ") for line in Path(__file__).with_name("quick.txt").read_text(encoding="utf-8").splitlines()
)
"""Some faults of every group by name, each for one control, and the checks that must find it by run or text."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Plant what is asked for; 1 where a quick fault is missed, 2 where the options make no sense."""
    options = _options(arguments)
    workshop = Workshop(options.work)
    workshop.forget_outdated()
    if options.quick:
        missed = []
        for result in quick_results(workshop, options.seed):
            print(_line(result), flush=True)
            missed += [result.name] if result.run_missed or result.text_missed else []
        for name in missed:
            print(f"missed: {name}")
        return int(bool(missed))
    folder = options.work / "results" / f"{code_digest()}-{plant_digest()}-{options.seed}"
    controls = (options.control,) if options.control else CONTROLS
    some = options.kind or options.control
    results = planted(workshop, Results(folder), options, controls)
    if some and options.output is None:
        print("\n".join(map(_line, results)))
        return 0
    honest = None if some else list(honest_runs(workshop, folder))
    output = options.output or OUTPUT
    write(results, honest, options.seed, output)
    _note(f"written: {output}")
    return 0


def planted(workshop: Workshop, known: Results, options: argparse.Namespace, controls: Sequence[str]) -> list[Result]:
    """Results of all faults in order; those that are known are not judged again."""
    planter = Planter(workshop, options.seed)
    begin = time.monotonic()
    results = []
    for fault in faults(options.kind, controls):
        result = known.of(fault.name, partial(planter.judged, fault, workshop.folder))
        results += [result] if result else []
        if len(results) % NOTED_EVERY == 0:
            _note(f"{len(results)} faults, {time.monotonic() - begin:.0f} s")
    return results


def quick_results(workshop: Workshop, seed: int, names: Collection[str] = QUICK) -> Iterator[Result]:
    """Judge the quick faults, or some of them."""
    planter = Planter(workshop, seed, (PART,))
    for fault in faults():
        if fault.name in names:
            yield planter.judged(fault, workshop.folder)


def write(results: Sequence[Result], honest: Sequence[tuple[str, str]] | None, seed: int, folder: Path) -> None:
    """Write table and rows."""
    folder.mkdir(parents=True, exist_ok=True)
    planned = sum(1 for _ in faults())
    texts = {
        "faults.md": tables.as_markdown(results, honest, seed, planned),
        "faults.csv": tables.as_csv(results),
    }
    for name, text in texts.items():
        with replacing(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")


def _line(result: Result) -> str:
    """One line of what found a fault, small letters for run and text, capitals where the line is right; another of what was said."""
    run = ("r" if result.run_found else ".", "R" if result.run_by else ".")
    text = ("t" if result.text_found else "u" if result.unseen else ".", "T" if result.text_by else ".")
    marks = run[0] + text[0] + run[1] + text[1]
    return f"{marks} {result.name} [{result.part} {result.where}] {result.what}\n      {' || '.join(result.notes)}"


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults", description=__doc__)
    parser.add_argument("--kind", default="", help="kinds whose name contains this; printed, not written")
    parser.add_argument("--control", choices=CONTROLS, help="faults for one control alone")
    parser.add_argument("--quick", action="store_true", help="a few dozen faults on one part, printed")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the places (default 13)")
    parser.add_argument(
        "--work", type=Path, default=WORK, help="folder of finished runs and results, kept between runs"
    )
    parser.add_argument("-o", "--output", type=Path, help="folder of the tables (default reports/faults)")
    return parser.parse_args(arguments)


def _note(text: str) -> None:
    print(f"faults: {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
