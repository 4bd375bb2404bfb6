"""Memory of ``ebamcheck live --opcua`` over thousands of layers: ``python -m benchmarks.live_memory --layers 4000``.

A thin column is built on a played control on loopback, both as commands, and the resident memory of the server is read as layers
go by. The build ends when it has that many layers.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ebamcheck.mesh.stl import write_triangles

RADIUS_MM, CORNERS, LAYER_MM = 16.0, 48, 1.6755
"""Radius and corners of the column, and about the height of a layer by default. A box would leave its corners bare, layer by
layer."""

EVERY = 10
"""Memory is read after so many layers."""

START = "from ebamcheck.commands.main import main; import sys; sys.argv[0] = 'ebamcheck'; main()"


@dataclass(frozen=True)
class Seen:
    """Resident memory of the server when a layer was released."""

    layer: int
    megabytes: float


def column(height_mm: float) -> np.ndarray:
    """Triangles (n, 3, 3) of a round column on the plate."""
    angle = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    low = np.column_stack([RADIUS_MM * np.cos(angle), RADIUS_MM * np.sin(angle), np.zeros(CORNERS)])
    high, after = low + np.array([0.0, 0.0, height_mm]), np.roll(np.arange(CORNERS), -1)
    foot, top = np.zeros((CORNERS, 3)), np.tile([0.0, 0.0, height_mm], (CORNERS, 1))
    sides = [
        (low, low[after], high[after]),
        (low, high[after], high),
        (foot, low[after], low),
        (top, high, high[after]),
    ]
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def command(*arguments: object) -> list[str]:
    """Command line of this version."""
    return [sys.executable, "-c", START, *map(str, arguments)]


def made_run(folder: Path, layers: int) -> Path:
    """Run a column of so many layers."""
    height_mm = LAYER_MM * layers
    write_triangles(column(height_mm), folder / "column.stl")
    top = max(1500.0, height_mm + 100.0)
    (folder / "column.toml").write_text(
        f"[process]\nsurface_tolerance_mm = 100.0\n[machine]\ntravel_max_mm = [1000.0, 1000.0, {top}]\n"
    )
    run = folder / "column.run"
    done = subprocess.run(
        command("run", folder / "column.stl", "-o", run, "--backends", "planecut,manifold", "-c", folder / "column.toml", "--yes"),
        capture_output=True,
        text=True,
        check=False,
    )  # fmt: skip
    if done.returncode:
        shut = [line for line in done.stdout.splitlines() if line.startswith(("FAIL", "fault"))]
        raise SystemExit(f"the run of the column ends with exit code {done.returncode}: {shut} {done.stderr}")
    return run


def followed(run: Path, folder: Path, url: str) -> Iterator[Seen]:
    """Build a run on a played control, and tell the server's memory as layers are released."""
    desk = folder / "desk"
    machine = subprocess.Popen(
        command("machine", run, "--opcua", "--url", url, "--speed", 1e6, "-o", desk),
        stdout=subprocess.PIPE,
        text=True,
    )
    assert machine.stdout is not None
    server = None
    try:
        for line in machine.stdout:
            if line.startswith("layer"):
                break
        server = subprocess.Popen(
            command("live", run, "--opcua", "-c", desk / "opcua.toml", "-o", folder / "column.live"),
            stdout=subprocess.PIPE,
            text=True,
        )
        assert server.stdout is not None
        for line in server.stdout:
            answer = json.loads(line)
            if answer["answer"] == "released" and int(answer["layer"]) % EVERY == 0:
                pages = int(Path(f"/proc/{server.pid}/statm").read_text().split()[1])
                yield Seen(int(answer["layer"]), pages * 4096 / 1e6)
            if answer["answer"] == "built":
                break
    finally:
        for process in (server, machine):
            if process is not None:
                process.kill()
                process.communicate()


def growth_kb(seen: list[Seen]) -> float:
    """Growth of the memory a layer, kB, by a straight line through its second half."""
    late = seen[len(seen) // 2 :]
    slope = np.polyfit([s.layer for s in late], [s.megabytes for s in late], 1)[0]
    return float(1000.0 * slope)


def main() -> None:
    """Measure, and write a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--layers", type=int, default=4000)
    parser.add_argument("--url", default="opc.tcp://127.0.0.1:48499")
    parser.add_argument("-o", "--output", type=Path, default=Path("live-memory.csv"))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="live-memory-") as place:
        run = made_run(Path(place), given.layers)
        seen = []
        for now in followed(run, Path(place), given.url):
            seen.append(now)
            print(f"{now.layer:6d} {now.megabytes:9.1f} MB", flush=True)
    with given.output.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["layer", "megabytes"])
        writer.writerows([s.layer, round(s.megabytes, 3)] for s in seen)
    print(f"{seen[-1].layer} layers; {growth_kb(seen):+.2f} kB a layer over the second half")


if __name__ == "__main__":
    main()
