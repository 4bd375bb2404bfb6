"""``python -m benchmarks.faults``: plant all faults, have them verified, and write the tables."""

from __future__ import annotations

import argparse
import re
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.faults import quick, tables
from benchmarks.faults.finished import Workshop, code_digest, plant_digest
from benchmarks.faults.honest import honest_runs, known_alarms
from benchmarks.faults.kinds import NotHereError
from benchmarks.faults.planting import Fault, Planter, faults
from benchmarks.faults.results import Ledger, Result
from benchmarks.faults.settings_faults import SettingFault, judged_setting, setting_faults
from benchmarks.faults.subjects import CONTROLS
from benchmarks.watch import ROOT
from ebamcheck.atomic_file import replacing

OUTPUT = ROOT / "reports" / "faults"
WORK = Path(__file__).parent / ".work"
SEED = 13
NOTED_EVERY = 20


def main(arguments: Sequence[str] | None = None) -> int:
    """Plant what is asked for; 0, or 2 where the options make no sense."""
    options = _options(arguments)
    workshop = Workshop(options.work)
    workshop.forget_outdated()
    if options.quick:
        return _quick(workshop, options)
    digest = f"{code_digest()}-{plant_digest()}-{options.seed}"
    ledger = Ledger(options.work / "results.jsonl", digest)
    controls = (options.control,) if options.control else CONTROLS
    if options.render:
        known = Ledger(options.work / "results.jsonl", "")
        write(list(known), known_alarms(options.work), options.seed, options.output or OUTPUT)
        return 0
    results = planted(workshop, ledger, options, controls)
    honest = None
    if options.honest or not (options.kind or options.control):
        honest = list(honest_runs(workshop, options.work, code_digest()))
        _note(f"{sum(bool(said) for _, said in honest)} of {len(honest)} honest runs raise an alarm")
    if options.output is not None:
        write(results, honest, options.seed, options.output)
        _note(f"written: {options.output}")
    for result in results if options.output is None else ():
        print(_line(result))
    return 0


def planted(
    workshop: Workshop, ledger: Ledger, options: argparse.Namespace, controls: tuple[str, ...]
) -> list[Result]:
    """Judge every fault that is not in the ledger yet; all results in order. Tables are written now and then."""
    planter = Planter(workshop, options.seed)
    begin = time.monotonic()
    results = []
    every: list[Fault | SettingFault] = [
        *faults(options.kind, controls),
        *setting_faults(options.kind, controls),
    ]
    for fault in every:
        if fault.name not in ledger or options.keep is not None:
            try:
                if isinstance(fault, Fault):
                    found = planter.judged(fault, workshop.folder)
                else:
                    found = judged_setting(fault, workshop, workshop.folder)
            except NotHereError:
                continue
            ledger.add(found)
            if options.keep is not None:
                _keep(workshop.folder, options.keep / re.sub(r"[^A-Za-z0-9]+", "-", fault.name))
        results.append(ledger[fault.name])
        if len(results) % NOTED_EVERY == 0:
            _note(f"{len(results)} faults, {time.monotonic() - begin:.0f} s")
            if options.output is not None:
                write(results, None, options.seed, options.output)
    return results


def _keep(work: Path, folder: Path) -> None:
    """Keep the run with the fault in it, and the bare text."""
    shutil.rmtree(folder, ignore_errors=True)
    for name in ("run", "spoiled", "alone"):
        if (work / name).is_dir():
            shutil.move(work / name, folder / name)


def write(
    results: Sequence[Result], honest: Sequence[tuple[str, str]] | None, seed: int, folder: Path
) -> None:
    """Write table and rows."""
    folder.mkdir(parents=True, exist_ok=True)
    planned = sum(1 for _ in faults()) + sum(1 for _ in setting_faults())
    texts = {
        "faults.md": tables.as_markdown(results, honest, seed, planned),
        "faults.csv": tables.as_csv(results),
    }
    for name, text in texts.items():
        with replacing(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")


def _quick(workshop: Workshop, options: argparse.Namespace) -> int:
    """Print the quick faults; 1 where one is missed that is not on the list."""
    missed = []
    for result in quick.quick_results(workshop, options.seed):
        print(_line(result), flush=True)
        missed += quick.misses(result)
    if options.shorten:
        quick.shorten(missed)
    known = quick.known_misses()
    for line in missed:
        print(f"missed: {line}{'' if line in known else ', which is not on the list'}")
    return int(any(line not in known for line in missed))


def _line(result: Result) -> str:
    marks = "".join(
        ("r" if result.run_found else ".", "t" if result.text_found else "u" if result.unseen else ".")
    )
    lines = "".join(("R" if result.run_right else ".", "T" if result.text_right else "."))
    return f"{marks}{lines} {result.name} [{result.part} {result.where}] {result.what}\n      {' || '.join(result.notes)}"


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults", description=__doc__)
    parser.add_argument("--kind", default="", help="kinds whose name contains this; printed, not written")
    parser.add_argument("--control", choices=CONTROLS, help="faults for one control alone")
    parser.add_argument("--quick", action="store_true", help="a few dozen faults on one part, printed")
    parser.add_argument(
        "--shorten", action="store_true", help="with --quick: take what is found off the list of the missed"
    )
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the places (default 13)")
    parser.add_argument(
        "--honest", action="store_true", help="honest runs, too, where --kind or --control is given"
    )
    parser.add_argument(
        "--render", action="store_true", help="tables of what was measured last, and nothing new"
    )
    parser.add_argument(
        "--work", type=Path, default=WORK, help="folder of finished runs and results, kept between runs"
    )
    parser.add_argument(
        "--keep", type=Path, help="folder for the runs and texts with the faults in them, to look at"
    )
    parser.add_argument("-o", "--output", type=Path, help="folder of the tables (default reports/faults)")
    options = parser.parse_args(arguments)
    if options.output is None and not (options.kind or options.control):
        options.output = OUTPUT
    return options


def _note(text: str) -> None:
    print(f"faults: {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
