"""What this code makes of a corpus of parts and settings: ``python -m benchmarks.golden FOLDER [BEFORE]``.

Runs, verifications and single commands write into FOLDER, and their digests into ``FOLDER/golden.json``. With BEFORE, such a file
of other code, the differences are printed, in three strengths: *bytes* of files, *numbers* of tables to nine digits, and *verdicts*
(exit code, gates, checks, findings). A step that only moves code keeps all three; one that sums in another order keeps the last
two."""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from benchmarks.faults.honest import LISTED, SETTINGS
from benchmarks.faults.kinds import SINUMERIK
from benchmarks.faults.subjects import EVERY, TESSELLATION_MM, Subject
from ebamcheck.pipeline import run_job
from ebamcheck.plugins.registry import models
from ebamcheck.program import Check
from ebamcheck.settings.config import Config
from ebamcheck.verification.verify import verify_against_part, verify_run
from ebamcheck_models import write_stl

STRENGTHS = ("bytes", "numbers", "verdicts")

NEW_EACH_TIME = {
    "timings.json",
    "certificate.json",
    "run.json",
    "report.html",
    "fingerprint",
    "settings.toml",
}
"""Files with dates, times or paths: what `run.json` decides is among the verdicts."""

RUNS = (*LISTED, *((part, SINUMERIK, "") for part in ("twelve-sides", "cube-retracting", "cube-preheated")))
"""Part, control and settings of each run, by the names of :mod:`benchmarks.faults`."""

COMMANDS = {
    "inspect": ("inspect", "torus.stl", "--json"),
    "check": ("check", "torus.stl", "-o", "check"),
    "scan": ("scan", "cube.stl", "--height", "2.5", "--orders", "raster,thermal,farthest", "--json"),
    "scan-all": ("scan", "bored.stl", "--all", "-o", "scan"),
    "fit": ("fit", "bored.stl", "-o", "fit.parquet"),
    **{
        f"slice-{name}": ("slice", "two-spheres.stl", "--backend", name, "-o", f"{name}.parquet")
        for name in ("planecut", "manifold", "embree", "stencil")
    },
    **{
        f"slice-{kind}": ("slice", "bored.stl", "--backend", "planecut", "-o", f"bored.{kind}")
        for kind in ("csv", "svg", "dxf", "cli", "vtp")
    },
    "compare": ("compare", "planecut.parquet", "stencil.parquet", "--json"),
}
"""Single commands on parts of the runs, in the folder of these."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the corpus; 1 where it differs from that of other code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.golden", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("before", type=Path, nargs="?", help="golden.json of other code")
    parser.add_argument("--only", default="", help="jobs whose name contains this")
    parser.add_argument("--demo", action="store_true", help="the demo part, too (a few minutes)")
    options = parser.parse_args(arguments)
    found = dict(_jobs(options.folder, options.only, options.demo))
    (options.folder / "golden.json").write_text(json.dumps(found, indent=1, sort_keys=True))
    if options.before is None:
        return 0
    before = {n: d for n, d in json.loads(options.before.read_text()).items() if options.only in n}
    return _told(before, found)


def _jobs(folder: Path, only: str, demo: bool) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and digests of each job."""
    folder.mkdir(parents=True, exist_ok=True)
    for part, control, how in RUNS:
        name = f"{part}-{control}-{how or 'default'}"
        stl = _part(folder, EVERY[part])
        if only in name:
            config = EVERY[part].config(control, **SETTINGS.get(how, {}))
            yield name, _run(stl, folder / name, config)
    if demo and only in "demo":
        stl = folder / "blade.stl"
        write_stl(models()["blade"].tessellate(0.1), stl)
        yield "demo", _run(stl, folder / "demo", Config())
    for name, words in COMMANDS.items():
        if only in name:
            yield name, _command(folder, words)


def _part(folder: Path, subject: Subject) -> Path:
    stl = folder / f"{subject.name}.stl"
    if not stl.is_file():
        write_stl(subject.model.tessellate(TESSELLATION_MM), stl)
    return stl


def _run(stl: Path, run: Path, config: Config) -> dict[str, Any]:
    """Digests of a run, of what its verification says, and of what its text says by itself."""
    print(run.name, file=sys.stderr, flush=True)
    shutil.rmtree(run, ignore_errors=True)
    run_job(stl, run, config)
    record = json.loads((run / "run.json").read_text())
    program = record.get("program") or {}
    verdicts = {
        "exit_code": record["exit_code"],
        "gates": {gate["name"]: [gate["passed"], gate["text"]] for gate in record["gates"]},
        "checks": [[check["name"], check["passed"], check["text"]] for check in program.get("checks", [])],
        "findings": sorted([f["severity"], f["code"], f["place"], f["text"]] for f in record["findings"]),
        "validated": program.get("validated"),
        "verify": _lines(verify_run(run, stl)),
        "text": _lines(verify_against_part(run / "program", stl, config)) if program else [],
    }
    digests = _files(run, [path for path in sorted(run.rglob("*")) if path.is_file()])
    return {**digests, "verdicts": verdicts}


def _lines(checks: Sequence[Check]) -> list[str]:
    return [f"{'pass' if check.passed else 'FAIL'} {check.value:.9g} {check.in_words()}" for check in checks]


def _files(root: Path, paths: Sequence[Path]) -> dict[str, Any]:
    """Digests of files, and of the columns of those that are tables."""
    digests: dict[str, dict[str, str]] = {"bytes": {}, "numbers": {}}
    for path in paths:
        if path.name in NEW_EACH_TIME:
            continue
        name = path.relative_to(root).as_posix()
        digests["bytes"][name] = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        if path.suffix in (".parquet", ".csv"):
            digests["numbers"][name] = _digits(path)
    return digests


def _digits(path: Path) -> str:
    """Digest of a table's values, those that are numbers to nine digits."""
    table = pq.read_table(path).to_pandas() if path.suffix == ".parquet" else pd.read_csv(path)
    digest = hashlib.sha256()
    for name, column in table.items():
        digest.update(f"{name}".encode())
        for value in column:
            digest.update(_rounded(value).encode())
    return digest.hexdigest()[:16]


def _rounded(value: Any) -> str:
    if isinstance(value, str) or value is None:
        return str(value)
    rows = np.asarray(value)
    if rows.dtype == object and rows.ndim:
        return " ".join(map(_rounded, rows))
    rows = np.atleast_1d(rows)
    return " ".join(np.char.mod("%.9g", rows.astype(np.float64))) if rows.dtype.kind in "fiub" else str(value)


def _command(folder: Path, words: Sequence[str]) -> dict[str, Any]:
    """Digests of what a command prints, and of the files that it makes."""
    print(" ".join(words), file=sys.stderr, flush=True)
    if "-o" in words:
        target = folder / words[words.index("-o") + 1]
        shutil.rmtree(target, ignore_errors=True)
        target.unlink(missing_ok=True)
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    start = "import sys; from ebamcheck.commands.main import main; main()"
    done = subprocess.run([sys.executable, "-c", start, *words], cwd=folder, capture_output=True, text=True)
    made = [path for path in sorted(folder.iterdir()) if before.get(path) != path.stat().st_mtime_ns]
    files = [file for path in made for file in ([path] if path.is_file() else sorted(path.rglob("*")))]
    return {
        **_files(folder, [file for file in files if file.is_file()]),
        "verdicts": {"exit_code": done.returncode, "said": done.stdout if "--json" in words else ""},
    }


def _told(before: dict[str, Any], found: dict[str, Any]) -> int:
    """Print what differs; 1 where something does."""
    differ = 0
    for name in sorted(set(before) | set(found)):
        if name not in before or name not in found:
            print(f"{name}: only {'before' if name in before else 'now'}")
            differ = 1
            continue
        for strength in STRENGTHS:
            one, other = before[name][strength], found[name][strength]
            keys = sorted(key for key in {*one, *other} if one.get(key) != other.get(key))
            if keys:
                differ = 1
                print(f"{name}: {strength} differ: {', '.join(keys[:8])}")
    print(f"{len(found)} jobs, {'with differences' if differ else 'the same'}")
    return differ


if __name__ == "__main__":
    sys.exit(main())
