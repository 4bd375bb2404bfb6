"""The fresh process of one measurement: ``python -m benchmarks.worker FOLDER``.

It reads ``request.json`` in the folder, makes the file ``began`` when all kernels are compiled and the clock may start, and writes
``answer.json``.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.errors import BackendFailed
from ebamcheck.kernels import Floats
from ebamcheck.layers.heights import layer_heights
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import registry
from ebamcheck.slicers.slicing import Slicing

Begin = Callable[[], None]
"""Called when everything is warm: what is compiled once has been compiled."""

WARM_MODEL, WARM_TOLERANCE_MM, WARM_LAYER_MM = "cone", 0.2, 0.2
"""A small part on which everything is done once before the clock starts."""

PILOT_LAYERS = 4
"""Layers by which the cost of a layer is judged, where a method is timed on some of them."""

HEIGHTS, DIRECTIONS, SEED = 200, 5, 5
"""Layers and directions that are asked for one at a time, at random."""


def time_method(
    begin: Begin,
    stl: str,
    layer_mm: float,
    method: Mapping[str, Any],
    rounds: int = 3,
    budget_s: float = 8.0,
    scaled_s: float = 20.0,
) -> dict[str, Any]:
    """Time a :class:`~benchmarks.ladder.Method`, given as plain values, on a file with layers of one height.

    At most `rounds` rounds are made, and none is begun once `budget_s` is spent; the first pays for memory that the process has
    not had before. A method that works layer by layer cuts as many layers as it takes `scaled_s`. The answer has ``rounds``
    (``load_s``, ``prepare_s``, ``slice_s``, ``layers``, ``layers_cut``, ``points``, ``output_bytes``), ``resident_mb`` before the
    clock starts, and ``own_peak_mb`` after it.
    """
    with tempfile.TemporaryDirectory() as folder:
        _one_round(method, _warm_file(Path(folder)), WARM_LAYER_MM, scaled_s=0.2)
    gc.collect()
    forget_peak()
    resident_mb = status_mb("VmRSS")
    begin()
    taken: list[dict[str, Any]] = []
    start = time.perf_counter()
    while not taken or (len(taken) < rounds and time.perf_counter() - start < budget_s):
        taken.append(_one_round(method, Path(stl), layer_mm, scaled_s))
        gc.collect()
    return {"rounds": taken, "resident_mb": resident_mb, "own_peak_mb": status_mb("VmHWM")}


def latency(begin: Begin, stl: str) -> dict[str, Any]:
    """Time single layers at random heights, and random directions: what follows a height that was measured in a build.

    The answer has ``at_s`` (one figure a height), ``along_s`` (one a direction), and ``along_at_s``, with a first layer along it.
    """
    part = load(Path(stl))
    draw = np.random.default_rng(SEED)
    low, high = part.bounds[:, 2]
    heights = draw.uniform(low, high, HEIGHTS + 1).tolist()
    directions = draw.normal(size=(DIRECTIONS + 1, 3))
    with Slicing(part) as slicing:

        def turned_s(direction: Floats) -> tuple[float, float]:
            start = time.perf_counter()
            with slicing.along(direction) as turned:
                ready_s = time.perf_counter() - start
                turned.at(float(turned.part.bounds[:, 2].mean()))
                return ready_s, time.perf_counter() - start

        slicing.at(heights.pop())
        turned_s(directions[-1])
        begin()
        at_s = []
        for height in heights:
            start = time.perf_counter()
            slicing.at(height)
            at_s.append(time.perf_counter() - start)
        turns = [turned_s(direction) for direction in directions[:-1]]
    return {"at_s": at_s, "along_s": [a for a, _ in turns], "along_at_s": [b for _, b in turns]}


TASKS: dict[str, Callable[..., dict[str, Any]]] = {"time": time_method, "latency": latency}


def forget_peak() -> None:
    """Have the kernel count the greatest resident memory of this process anew (Linux; elsewhere nothing happens)."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return


def status_mb(field: str) -> float:
    """Memory of this process as Linux counts it, MB: ``VmRSS`` now, ``VmHWM`` at most; 0 elsewhere."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) * 1024 / 1e6 for line in lines if line.startswith(f"{field}:")), 0.0)


def _one_round(method: Mapping[str, Any], stl: Path, layer_mm: float, scaled_s: float) -> dict[str, Any]:
    if method["kind"] == "prusa-stage":
        return prusa_stage(stl, layer_mm)
    start = time.perf_counter()
    part = load(stl)
    load_s = time.perf_counter() - start
    heights = layer_heights(part, layer_mm)
    if method["kind"] == "manifold3d":
        return {"load_s": load_s, **manifold_alone(part, heights)}
    return {"load_s": load_s, **_sliced(method, part, heights, scaled_s)}


def _sliced(method: Mapping[str, Any], part: Part, heights: Floats, scaled_s: float) -> dict[str, Any]:
    """Prepare a part and cut it; where the method works layer by layer, as many layers as there is time for."""
    settings = registry.slicer_settings(method["backend"], method["settings"])
    start = time.perf_counter()
    with registry.available_slicer(method["backend"]).prepare(part, settings) as prepared:
        prepare_s = time.perf_counter() - start
        chosen = heights
        if method["by_layer"]:
            pilot = time.perf_counter()
            prepared.slice(some_of(heights, PILOT_LAYERS))
            each_s = (time.perf_counter() - pilot) / PILOT_LAYERS
            chosen = some_of(heights, max(PILOT_LAYERS, int(scaled_s / each_s)))
        start = time.perf_counter()
        layers = prepared.slice(chosen)
        slice_s = time.perf_counter() - start
    columns = (
        layers.heights,
        layers.points,
        layers.ring_starts,
        layers.layer_starts,
        layers.closed,
        layers.edge,
        layers.edge_t,
    )
    return {
        "prepare_s": prepare_s, "slice_s": slice_s, "layers": len(heights), "layers_cut": len(chosen),
        "points": len(layers.points), "output_bytes": sum(column.nbytes for column in columns if column is not None),
    }  # fmt: skip


def some_of(heights: Floats, count: int) -> Floats:
    """At most `count` heights, evenly spread."""
    places = np.linspace(0, len(heights) - 1, min(count, len(heights)) + 2)[1:-1]
    chosen: Floats = heights if count >= len(heights) else heights[np.unique(places.round().astype(np.int64))]
    return chosen


def _warm_file(folder: Path) -> Path:
    from ebamcheck_models import MODELS, write_stl

    path = folder / "warm.stl"
    write_stl(MODELS[WARM_MODEL].tessellate(WARM_TOLERANCE_MM), path)
    return path


# -- two programs measured by themselves: manifold3d without its backend, and PrusaSlicer's slice stage ------


STAGE_BEGINS = "slice_mesh to polygons"
STAGE_ENDS = "Slicing volumes - removing top empty layers"
"""Lines of PrusaSlicer's log (level 4) between which it makes polygons of all layers from the mesh it has read and
repaired. What follows (perimeters, G-code) is no slicing in our sense: the process is ended there."""

_TIME = re.compile(r"^\[(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+)\]")

BED_MM, HIGHEST_MM = 2000, 1200
"""The largest bed and the tallest printer that PrusaSlicer believes in."""


def manifold_alone(part: Part, heights: Floats) -> dict[str, Any]:
    """Time construct, slice and to_polygons of manifold3d on the vertices and facets of a part."""
    from manifold3d import Error, Manifold, Mesh64

    start = time.perf_counter()
    solid = Manifold(Mesh64(part.vertices, part.faces.astype(np.uint64)))
    if solid.status() != Error.NoError:
        raise BackendFailed(f"manifold3d refuses the part: {solid.status()}")
    ready = time.perf_counter()
    rings = points = 0
    for height in heights.tolist():
        found = solid.slice(height).to_polygons()
        rings += len(found)
        points += sum(len(ring) for ring in found)
    return {
        "prepare_s": ready - start, "slice_s": time.perf_counter() - ready, "layers": len(heights),
        "layers_cut": len(heights), "points": points, "rings": rings, "output_bytes": 16 * points,
    }  # fmt: skip


def prusa_stage(stl: Path, layer_mm: float) -> dict[str, Any]:
    """Time PrusaSlicer's slice stage by the stamps of its own log."""
    with tempfile.TemporaryDirectory(prefix="ebamcheck-prusa-") as folder:
        command = [
            "prusa-slicer", "--export-gcode", "--loglevel", "4", "--output", str(Path(folder, "out.gcode")),
            "--bed-shape", f"0x0,{BED_MM}x0,{BED_MM}x{BED_MM},0x{BED_MM}", "--max-print-height", str(HIGHEST_MM),
            "--dont-arrange", "--center", f"{BED_MM // 2},{BED_MM // 2}",
            "--layer-height", f"{layer_mm:g}", "--first-layer-height", f"{layer_mm:g}",
            "--nozzle-diameter", f"{max(0.4, 2.0 * layer_mm):g}",
            "--slice-closing-radius", "0", "--resolution", "0", "--slicing-mode", "regular",
            "--perimeters", "1", "--fill-density", "0", "--skirts", "0",
            "--top-solid-layers", "0", "--bottom-solid-layers", "0", str(stl),
        ]  # fmt: skip
        process = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, errors="replace", start_new_session=True,
        )  # fmt: skip
        try:
            assert process.stdout is not None
            stage_s = stage_seconds(process.stdout)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if process.stdout is not None:
                process.stdout.close()
    return {"load_s": 0.0, "prepare_s": 0.0, "slice_s": stage_s, "layers": 0, "layers_cut": 0}


def stage_seconds(log: Iterable[str]) -> float:
    """Seconds between the two lines of a log that begin and end the slice stage; an error if the log ends before that."""
    began: datetime | None = None
    line = ""
    for line in log:
        stamp = _TIME.match(line)
        if stamp is None:
            continue
        if began is None and STAGE_BEGINS in line:
            began = datetime.fromisoformat(stamp[1])
        elif began is not None and STAGE_ENDS in line:
            return (datetime.fromisoformat(stamp[1]) - began).total_seconds()
    raise BackendFailed(f"PrusaSlicer ended without a slice stage: {line.strip()[:200]}")


def main(folder: Path) -> None:
    """Do what the request in the folder says."""
    request: dict[str, Any] = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    answer = TASKS[request.pop("task")](begin=(folder / "began").touch, **request)
    (folder / "answer.json").write_text(json.dumps(answer), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
