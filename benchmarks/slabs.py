"""``python -m benchmarks.slabs``: the cross-check of parts larger than memory, in slabs of z, from one to a hundred million facets.

Each size is measured by a call of its own; the table holds the newest figures of every size that was measured.
"""

from __future__ import annotations

import argparse
import json
import math
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.figures import machine, markdown
from benchmarks.parts import write_even_mesh
from benchmarks.targets import check_command
from benchmarks.watch import ROOT
from ebamcheck.atomic_file import replacing
from ebamcheck.preflight.workload import FACETS_A_SLAB
from ebamcheck_models import LADDER

OUTPUT = ROOT / "reports" / "benchmarks"
NAME = "slabs"
LAYERS = 10_000
BACKENDS = "planecut,manifold"
FEWEST_SLABS = 4
STOP_MB = 16_000.0
"""What is allowed; beyond it the check is ended."""

LIMIT_S = 2 * 3600.0
STAGES = ("read", "slice", "compare", "wait")
MEANING = (
    "One solid in near-equilateral facets, binary STL, read from the disk's cache, cut and compared in slabs of z; the "
    "layers are dropped. Time is that of the whole command, cold interpreter and warm kernels; memory the greatest sum of "
    "the resident memory of all its processes, in which pages that processes share count for each. A slab is compared "
    "while the next one is cut: `compare` overlaps `slice`, and `wait` is what is left of it when that ends."
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make a mesh, check it under a watch, and write the table; 0, or 1 where the check did not come to its end."""
    options = _options(arguments)
    output: Path = options.output
    output.mkdir(parents=True, exist_ok=True)
    file = output / f"{NAME}.json"
    known = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {"rows": []}
    row = measure(options)
    rows = [old for old in known["rows"] if (old["wanted_facets"], old["backends"]) != _key(row)]
    rows = sorted([*rows, row], key=lambda r: (r["facets"], r["backends"]))
    with replacing(file) as temporary:
        temporary.write_text(json.dumps({"rows": rows}, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    with replacing(output / f"{NAME}.md") as temporary:
        temporary.write_text(table(rows), encoding="utf-8")
    print(f"written: {output / f'{NAME}.md'}", file=sys.stderr)
    return 0 if row["status"] == "done" else 1


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """One row: the mesh is written to a temporary folder and goes at the end."""
    slabs = options.slabs or max(FEWEST_SLABS, math.ceil(options.facets / FACETS_A_SLAB))
    layer_mm = LADDER.height_mm / options.layers
    found_machine = machine()
    with tempfile.TemporaryDirectory(prefix="ebamcheck-benchmark-") as folder:
        stl = Path(folder, f"even-{options.facets}.stl")
        _room_for(stl, options.facets)
        start = time.perf_counter()
        facets = write_even_mesh(LADDER, options.facets, stl)
        print(f"slabs: {facets:,} facets made in {time.perf_counter() - start:.0f} s", file=sys.stderr)
        extra = ["--backends", options.backends, "--slabs", str(slabs), "--yes"]
        found = check_command(stl, layer_mm, LIMIT_S, STOP_MB, extra)
    return {
        **found,
        "facets": facets,
        "wanted_facets": options.facets,
        "bytes": 84 + 50 * facets,
        "layers": options.layers,
        "backends": options.backends,
        "slabs": slabs,
        "machine": {k: found_machine[k] for k in ("cpu", "cores", "memory_gb", "load_at_start", "started", "commit")},
        "command": shlex.join(["python", "-m", "benchmarks.slabs", *_given(options)]),
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The table as Markdown."""
    columns = [
        "facets",
        "file",
        "layers",
        "slicers",
        "slabs",
        "result",
        "time",
        "memory of all processes",
        *STAGES,
        "",
    ]
    lines = ["# Parts larger than memory", "", MEANING, "", markdown(columns, map(_cells, rows))]
    lines += ["", "Made by:", ""]
    for row in rows:
        m = row["machine"]
        lines.append(
            f"- {row['facets']:,} facets: `{row['command']}` on {m['started']}: {m['cpu']}, {m['cores']} cores, "
            f"{m['memory_gb']:g} GB, load at the start {m['load_at_start'][0]:g}, commit {m['commit'] or 'none'}"
        )
    return "\n".join(lines) + "\n"


def _cells(row: Mapping[str, Any]) -> list[str]:
    stages = row.get("stages_s", {})
    verdicts = row.get("verdicts", {})
    result = (
        f"{verdicts.get('agree', 0):,} layers agree" if row["status"] == "done" else f"{row['status']}: {row['why']}"
    )
    others = sum(verdicts.values()) - verdicts.get("agree", 0)
    return [
        f"{row['facets']:,}",
        f"{row['bytes'] / 1e9:.2f} GB",
        f"{row['layers']:,}",
        row["backends"].replace(",", ", "),
        str(row["slabs"]),
        result + (f", {others} do not" if others else ""),
        f"{row['wall_s']:.0f} s",
        f"{row['peak_mb'] / 1e3:.2f} GB",
        *[f"{stages[name]:.0f} s" if name in stages else "" for name in STAGES],
        row.get("note", ""),
    ]


def _key(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return row["wanted_facets"], row["backends"]


def _room_for(stl: Path, facets: int) -> None:
    free = shutil.disk_usage(stl.parent).free
    if free < 2 * 50 * facets:
        raise SystemExit(f"{stl.parent}: {free / 1e9:.1f} GB are free, too few for {facets:,} facets: set TMPDIR")


def _given(options: argparse.Namespace) -> list[str]:
    given = ["--facets", str(options.facets), "--backends", options.backends]
    given += ["--layers", str(options.layers)] if options.layers != LAYERS else []
    given += ["--slabs", str(options.slabs)] if options.slabs else []
    return given


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.slabs", description=__doc__)
    parser.add_argument("--facets", type=int, default=1_000_000, help="facets of the part, about")
    parser.add_argument("--layers", type=int, default=LAYERS)
    parser.add_argument("--backends", default=BACKENDS, help=f"slicers, with commas; default: {BACKENDS}")
    parser.add_argument("--slabs", type=int, help=f"default: one for {FACETS_A_SLAB:,} facets, at least {FEWEST_SLABS}")
    parser.add_argument("--output", type=Path, default=OUTPUT, help="folder of the table")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    raise SystemExit(main())
