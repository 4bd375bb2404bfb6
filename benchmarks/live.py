"""How soon a layer is published on its measured height: ``python -m benchmarks.live RUN --part PART``; tables in reports/live.

A whole build against the beads of :mod:`ebamcheck.testing.played_control.program`, in one process: each time is from the line with
the height to the answer, with every gate and everything on disk. The processor's time stands beside it, since others may work on
the machine, too."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.figures import machine, markdown
from ebamcheck.commands.machine import TABLE
from ebamcheck.live.building import BetweenLayers, Building, answer_to
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.relaying import FinishedRun, finished_run
from ebamcheck.testing.played_control.program import Growth

LATENCIES, SUMMARY, TEXT = "latency.csv", "latency-by-islands.csv", "latency.md"

ISLANDS = (0, 15, 50, 100, 300, 10**9)
"""Borders of the groups by islands: more than one, up to the next."""

TARGETS_S = {50: 0.2, 300: 0.5}
"""Latency that is aimed at for layers of up to so many islands."""

TIMES = ("median_s", "p99_s", "processor_median_s", "processor_p99_s")
STAGES = ("slice", "compare", "fit", "plan", "write", "verify")


def built(found: FinishedRun, growth: Growth, most: int | None) -> pd.DataFrame:
    """Build a part and time every answer; one row a layer that was published on a measured height."""
    rows: list[dict[str, Any]] = []
    with (
        tempfile.TemporaryDirectory(prefix="benchmark-live-") as folder,
        LayerMaker(found.part, found.config, found.primary) as maker,
    ):
        building = Building(maker, Path(folder) / "build")
        try:
            between = BetweenLayers(building)
            answer = answer_to(building, b'{"event": "start"}')
            while answer["answer"] == "published" and (most is None or len(rows) < most):
                layer, thickness_mm = int(answer["layer"]), float(answer["thickness_mm"])
                height_mm = answer["base_mm"] + growth.grown_mm(layer - 1, thickness_mm)
                line = json.dumps({"event": "height", "done": layer, "height_mm": height_mm}).encode()
                wall, processor = time.perf_counter(), time.process_time()
                answer = answer_to(building, line)
                seconds = time.perf_counter() - wall
                spent = time.process_time() - processor
                between(answer)
                if answer["answer"] == "published":
                    stages = {name: answer["seconds"].get(name, 0.0) for name in STAGES}
                    rows.append({"layer": layer + 1, "islands": answer["islands"], "tries": answer["tries"],
                                 "wall_s": seconds, "processor_s": spent, **stages})  # fmt: skip
                elif answer["answer"] != "done":
                    raise SystemExit(f"the build stopped at layer {layer + 1}: {answer}")
        finally:
            building.close()
    return pd.DataFrame(rows)


def on_control(run: Path, part: Path | None, growth: Growth) -> pd.DataFrame:
    """Build a part on a played control with an OPC UA server, both as commands; one row a layer with the wait of its program."""
    with tempfile.TemporaryDirectory(prefix="benchmark-live-") as folder:
        words: list[object] = ["machine", run, "-o", folder, "--speed", 1e6, "--drift", growth.drift, "--noise", growth.noise, "--seed", growth.seed]  # fmt: skip
        words += ["--part", part] if part else []
        command = [str(Path(sys.executable).with_name("ebamcheck")), *map(str, words)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return pd.read_csv(Path(folder, TABLE))


def by_islands(table: pd.DataFrame) -> pd.DataFrame:
    """Median and 99th percentile of the times of layers with about as many islands.

    >>> rows = pd.DataFrame({"islands": [10, 12, 40], "wall_s": [1.0, 3.0, 5.0], "processor_s": [1.0, 1.0, 2.0]})
    >>> by_islands(rows)[["islands", "layers", "median_s"]].values.tolist()
    [['1 to 15', 2, 2.0], ['16 to 50', 1, 5.0], ['all', 3, 3.0]]
    """
    groups = [
        (f"{low + 1} to {high}" if high < ISLANDS[-1] else f"over {low}", table[(table["islands"] > low) & (table["islands"] <= high)])
        for low, high in itertools.pairwise(ISLANDS)
    ]  # fmt: skip
    rows = [
        {
            "islands": name,
            "layers": len(of),
            "median_s": float(of["wall_s"].median()),
            "p99_s": float(np.quantile(of["wall_s"], 0.99)),
            "processor_median_s": float(of["processor_s"].median()),
            "processor_p99_s": float(np.quantile(of["processor_s"], 0.99)),
        }
        for name, of in [*groups, ("all", table)]
        if len(of)
    ]
    return pd.DataFrame(rows)


def text(table: pd.DataFrame, what: str) -> str:
    """The report in Markdown."""
    head = [
        "islands",
        "layers",
        "median, s",
        "99th percentile, s",
        "processor, median, s",
        "99th percentile, s",
    ]
    rows = [
        [str(row["islands"]), str(row["layers"]), *(f"{row[name]:.3f}" for name in TIMES)]
        for row in by_islands(table).to_dict("records")
    ]
    aims = " and ".join(f"{aim:g} s for up to {n} islands" for n, aim in TARGETS_S.items())
    return (
        f"# Latency of a live build\n\n{what}\n\n{markdown(head, rows)}\n\nAimed at in a running server are {aims}. "
        "Times are from the line with the height to the answer, when the layer has passed every gate and lies on disk.\n"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Build, print, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="a finished run folder")
    parser.add_argument("--part", type=Path, default=None)
    parser.add_argument("--layers", type=int, default=None, help="stop after so many layers")
    parser.add_argument("--drift", type=float, default=0.1)
    parser.add_argument("--noise", type=float, default=0.05)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--opcua",
        action="store_true",
        help="by a played control with an OPC UA server instead: print the waits of its program",
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("reports/live"))
    given = parser.parse_args(arguments)
    growth = Growth(given.drift, given.noise, given.seed)
    if given.opcua:
        waits = on_control(given.run, given.part, growth)["wait_s"].to_numpy()[1:]
        low, high = np.quantile(waits, [0.5, 0.99])
        print(
            f"{len(waits)} layers over OPC UA: median {low:.2f} s, 99th percentile {high:.2f} s, most {waits.max():.2f} s"
        )
        return
    found = finished_run(given.run, given.part)
    table = built(found, growth, given.layers)
    here, load = machine(), os.getloadavg()[0]
    command = f"python -m benchmarks.live {given.run.name} --drift {given.drift:g} --noise {given.noise:g} --seed {given.seed}"
    command += f" --layers {given.layers}" if given.layers else ""
    what = (
        f"Part `{found.part.name}`, {len(found.part.faces)} facets, built by `{command}`. "
        f"Machine: {here['cpu']}, {here['cores']} cores; {load:.1f} processes ran on it in the last minute."
    )
    given.output.mkdir(parents=True, exist_ok=True)
    table.assign(hexagons="planned").round(4).to_csv(given.output / LATENCIES, index=False)
    by_islands(table).assign(hexagons="planned").round(4).to_csv(given.output / SUMMARY, index=False)
    report = text(table, what)
    (given.output / TEXT).write_text(report, encoding="utf-8")
    print(report)


if __name__ == "__main__":
    main()
