"""One measurement of one method on one part, in a process whose kernels are warm."""

from __future__ import annotations

import gc
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import yardsticks
from benchmarks.methods import Method
from benchmarks.worker import Begin
from ebamcheck.kernels import Floats
from ebamcheck.layers.heights import layer_heights
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import registry

WARM_MODEL, WARM_TOLERANCE_MM, WARM_LAYER_MM = "cone", 0.2, 0.2
"""A small part on which everything is done once before the clock starts."""

PILOT_LAYERS = 4
"""Layers by which the cost of a layer is judged, where a method is timed on some of them."""

Round = dict[str, Any]


def time_method(
    begin: Begin,
    stl: str,
    layer_mm: float,
    method: Mapping[str, Any],
    rounds: int = 3,
    budget_s: float = 8.0,
    scaled_s: float = 20.0,
) -> dict[str, Any]:
    """Time a method on a file.

    Parameters
    ----------
    begin
        Starts the clock of the limit.
    stl, layer_mm
        File, and height of its uniform layers.
    method
        A :class:`~benchmarks.methods.Method` as plain values.
    rounds
        Greatest number of rounds in this process. The first pays for memory that the process has not had before;
        the later ones are those of a warm process.
    budget_s
        No further round is begun once so much time is spent.
    scaled_s
        Time for a method that works layer by layer: it cuts as many layers as it takes, spread over the height.

    Returns
    -------
    ``rounds`` (``load_s``, ``prepare_s``, ``slice_s``, ``layers``, ``layers_cut``, ``points``, ``rings``,
    ``output_bytes``), ``resident_mb`` before the clock starts, ``own_peak_mb`` of this process after it.
    """
    chosen = Method(**method)
    with tempfile.TemporaryDirectory() as folder:
        _one_round(chosen, _warm_file(Path(folder)), WARM_LAYER_MM, scaled_s=0.2)
    gc.collect()
    forget_peak()
    resident_mb = status_mb("VmRSS")
    begin()
    taken: list[Round] = []
    start = time.perf_counter()
    while not taken or (len(taken) < rounds and time.perf_counter() - start < budget_s):
        taken.append(_one_round(chosen, Path(stl), layer_mm, scaled_s))
        gc.collect()
    return {"rounds": taken, "resident_mb": resident_mb, "own_peak_mb": status_mb("VmHWM")}


def output_bytes(layers: Layers) -> int:
    """Bytes of the columns of a stack."""
    columns = (
        *(layers.heights, layers.points, layers.ring_starts, layers.layer_starts, layers.closed),
        *(layers.edge, layers.edge_t),
    )
    return sum(column.nbytes for column in columns if column is not None)


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


def _one_round(method: Method, stl: Path, layer_mm: float, scaled_s: float) -> Round:
    if method.kind == "prusa-stage":
        return yardsticks.prusa_stage(stl, layer_mm)
    start = time.perf_counter()
    part = load(stl)
    load_s = time.perf_counter() - start
    heights = layer_heights(part, layer_mm)
    if method.kind == "manifold3d":
        return {"load_s": load_s, **yardsticks.manifold_alone(part, heights)}
    return {"load_s": load_s, **_sliced(method, part, heights, scaled_s)}


def _sliced(method: Method, part: Part, heights: Floats, scaled_s: float) -> Round:
    """Prepare a part and cut it; where the method works layer by layer, as many layers as there is time for."""
    settings = registry.slicer_settings(method.backend, method.settings)
    start = time.perf_counter()
    with registry.available_slicer(method.backend).prepare(part, settings) as prepared:
        prepare_s = time.perf_counter() - start
        chosen = heights
        if method.by_layer:
            pilot = time.perf_counter()
            prepared.slice(some_of(heights, PILOT_LAYERS))
            each_s = (time.perf_counter() - pilot) / PILOT_LAYERS
            chosen = some_of(heights, max(PILOT_LAYERS, int(scaled_s / each_s)))
        start = time.perf_counter()
        layers = prepared.slice(chosen)
        slice_s = time.perf_counter() - start
    return {
        "prepare_s": prepare_s,
        "slice_s": slice_s,
        "layers": len(heights),
        "layers_cut": len(chosen),
        "points": len(layers.points),
        "rings": int(layers.ring_counts().sum()),
        "output_bytes": output_bytes(layers),
    }


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
