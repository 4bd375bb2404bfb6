"""Floors of the targets: what a figure cannot be under on this machine, from bytes that must be touched or a part measured alone.

Bytes that must be touched are the file that is read and the layers that are written, or the layers that are compared;
over the copy bandwidth of all cores, which every benchmark measures at its start (``machine``). A command that computes
for longer than it touches memory has as its floor its own processor time over the cores: what the same arithmetic takes
when no core ever waits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from benchmarks import methods
from benchmarks.figures import cell_times, find, layers_cut, total_s
from benchmarks.targets import SLICE, Figures
from ebamcheck.threads import run_blocks

COPY_BYTES, COPIES = 1 << 28, 5
"""Size of the array that is copied, far over any cache, and how often: the fastest copy counts."""

NEW_BYTES = 1 << 30
"""Memory that is touched for the first time, to see how long the system takes to give it."""

LINE_BYTES = 64
"""What the machine reads for a vertex at any place: a line of its cache."""

FILE_BYTES, FACET_BYTES = 50, 24
"""What a binary STL file has for a facet, and the part in memory: its three corners, and half a vertex."""

Floor = Callable[[Figures], float | None]


def copy_bandwidth() -> float:
    """Bytes read and written in a second while an array is copied by all threads."""
    source = np.zeros(COPY_BYTES // 8)
    target = np.ones_like(source)

    def work(start: int, stop: int) -> None:
        target[start:stop] = source[start:stop]

    best_s = np.inf
    for _ in range(COPIES):
        start = time.perf_counter()
        run_blocks(work, len(source))
        best_s = min(best_s, time.perf_counter() - start)
    return 2.0 * COPY_BYTES / best_s


def first_touch() -> float:
    """Bytes in a second of memory that no process has yet, while all threads write to it; a virtual machine asks its host for it."""
    target = np.empty(NEW_BYTES // 8)

    def work(start: int, stop: int) -> None:
        target[start:stop] = 1.0

    start = time.perf_counter()
    run_blocks(work, len(target))
    return NEW_BYTES / (time.perf_counter() - start)


def floor_of(key: str, figures: Figures) -> float | None:
    """Floor of a target in its unit; None where there is none, or what it asks for was not measured."""
    found = FLOORS.get(key)
    return None if found is None else found(figures)


def _touched_s(figures: Figures, count: float | None) -> float | None:
    """Time to touch so many bytes."""
    return count / figures.copy_bytes_s if count is not None and figures.copy_bytes_s else None


def _output_bytes(figures: Figures, method: str) -> float | None:
    cell = find(figures.cells, f"{figures.series}-{figures.top}", method)
    return float(cell["runs"][-1]["rounds"][-1]["output_bytes"]) if cell and cell["runs"] else None


def _file_bytes(figures: Figures) -> float:
    return float(figures.parts[f"{figures.series}-{figures.top}"]["bytes"])


def _cut_s(figures: Figures) -> float | None:
    """File to contours: the file read and the layers written, once."""
    output = _output_bytes(figures, "planecut")
    return None if output is None else _touched_s(figures, _file_bytes(figures) + output)


def _over(method: str, steps: tuple[str, ...] | None = None) -> Floor:
    """The cut at its floor over the time of a peer."""

    def floor(figures: Figures) -> float | None:
        cell = find(figures.cells, f"{figures.series}-{figures.top}", method)
        peer = cell_times(cell) if steps is None else cell_times(cell, steps)
        cut_s = _cut_s(figures)
        return None if peer is None or cut_s is None else cut_s / peer.median

    return floor


def _start_up_s(figures: Figures) -> float | None:
    return _told(figures, "imports", lambda answer: answer["wall_s"])


def _cold_s(figures: Figures) -> float | None:
    """An interpreter with the libraries, the file read and the layers written, to memory that is new to the process."""
    start_s, cut_s, output = _start_up_s(figures), _cut_s(figures), _output_bytes(figures, "planecut")
    if start_s is None or cut_s is None or output is None:
        return None
    return start_s + (output / figures.touch_bytes_s if figures.touch_bytes_s else cut_s)


def _shuffled(figures: Figures) -> float | None:
    """The same work, and once a line of the cache for every corner of every facet where it lies anywhere."""
    in_order = figures.told("in order", total_s)
    extra_s = _touched_s(figures, 3.0 * LINE_BYTES * _facets(figures))
    return None if in_order is None or extra_s is None else 1.0 + extra_s / in_order.median


def _compare_s(figures: Figures) -> float | None:
    """All points of all stacks that are compared, read once."""
    sizes = [_output_bytes(figures, name) for name in ("planecut", "manifold", "embree", "stencil")]
    known = [size for size in sizes if size is not None]
    return _touched_s(figures, sum(known)) if len(known) > 1 else None


def _cross_check_s(figures: Figures) -> float | None:
    """The slowest slicer by itself, and the comparison at its floor."""
    part = f"{figures.series}-{figures.top}"
    times = [cell_times(find(figures.cells, part, name)) for name in ("manifold", "embree", "stencil")]
    slowest, compare_s = max((t.median for t in times if t is not None), default=None), _compare_s(figures)
    return None if slowest is None or compare_s is None else slowest + compare_s


def _facets(figures: Figures) -> float:
    return float(figures.parts[f"{figures.series}-{figures.top}"]["facets"])


def _layers(figures: Figures) -> int | None:
    cells = (find(figures.cells, f"{figures.series}-{figures.top}", name) for name in ("planecut", "stencil"))
    return next((layers_cut(cell)[1] for cell in cells if cell and cell["runs"]), None)


def _points_s(figures: Figures) -> float | None:
    """All points of all layers, read once."""
    return _touched_s(figures, _output_bytes(figures, "planecut"))


def _layer_s(figures: Figures) -> float | None:
    """One layer, written once."""
    points_s, layers = _points_s(figures), _layers(figures)
    return points_s / layers if points_s is not None and layers else None


def _part_s(figures: Figures) -> float | None:
    """The part in memory, read once."""
    return _touched_s(figures, FACET_BYTES * _facets(figures))


def _turned_layer_s(figures: Figures) -> float | None:
    part_s, layer_s = _part_s(figures), _layer_s(figures)
    return None if part_s is None or layer_s is None else part_s + layer_s


def _literal_s(figures: Figures) -> float | None:
    """The facets above a layer, read for every layer: half of all on the average, in parts whose two ends are alike."""
    part_s, layers = _part_s(figures), _layers(figures)
    return None if part_s is None or layers is None else 0.5 * part_s * layers


def _drawn_once_s(figures: Figures) -> float | None:
    """The file read and the layers written, once."""
    output = _output_bytes(figures, "stencil")
    return None if output is None else _touched_s(figures, _file_bytes(figures) + output)


def _bits_s(figures: Figures) -> float | None:
    """All bitmaps, a bit a pixel, touched once."""
    pixels, layers = figures.told("bitmaps", lambda a: float(np.prod(a["side_px"]))), _layers(figures)
    return None if pixels is None or layers is None else _touched_s(figures, layers * pixels.median / 8.0)


def _lattice_px(figures: Figures) -> float | None:
    """The exact section of the part with its vertices on the lattice of rasterisers, on the worst judged layer."""
    return _told(figures, "bitmaps", lambda a: max(a.get("by_lattice", [np.nan])))


def _casts_s(name: str) -> Floor:
    """Embree's own casts of the same rays, on all threads."""
    return lambda figures: _told(figures, "crossings", lambda answer: answer.get(name, np.nan))


def _processor_s(task: str) -> Floor:
    """Processor time of a task over the cores."""

    def floor(figures: Figures) -> float | None:
        used_s = _told(figures, task, lambda answer: answer.get("processor_s", np.nan))
        return None if used_s is None or figures.cores is None else used_s / figures.cores

    return floor


def _planned_layer_s(figures: Figures) -> float | None:
    """Processor time of a layer of many islands over the cores."""
    used_s = _processor_s("islands")(figures)
    layers = _told(figures, "islands", lambda answer: len(answer["layer_s"]))
    return None if used_s is None or layers is None else used_s / layers


def _told(figures: Figures, task: str, value: Callable[[Mapping[str, Any]], float]) -> float | None:
    """Median of a value of a task; None where figures of an earlier version do not hold it."""
    found = figures.told(task, value)
    return None if found is None or np.isnan(found.median) else found.median


def _part_mb(figures: Figures) -> float | None:
    """The file, in memory once."""
    return _told(figures, "scale", lambda answer: 1e-6 * FILE_BYTES * answer["facets"])


def _one(figures: Figures) -> float | None:
    """Proportion, or the library's own time."""
    return 1.0


FLOORS: Mapping[str, Floor] = {
    "planecut-prusa": _over(methods.PRUSA_STAGE, ("slice_s",)),
    "planecut-manifold": _over(methods.MANIFOLD_ALONE, SLICE),
    "planecut-seconds": _cut_s,
    "planecut-memory": _one,
    "planecut-memory-gained": _one,
    "union-proportion": _one,
    "overlap-test": _points_s,
    "cold": _cold_s,
    "start-up": _start_up_s,
    "growth": _one,
    "shuffled": _shuffled,
    "layer": _layer_s,
    "direction": _part_s,
    "direction-layer": _turned_layer_s,
    "bitmaps": _bits_s,
    "bitmap-contours": _bits_s,
    "pixels-literal": _lattice_px,
    "pixels-exact": _lattice_px,
    "literal": _literal_s,
    "gpu-once": _drawn_once_s,
    "gpu-literal": lambda figures: _told(figures, "drawing", lambda answer: answer["device_s"]),
    "manifold": _one,
    "embree": _casts_s("casts_s"),
    "compare": _compare_s,
    "cross-check": _cross_check_s,
    "demo": _processor_s("main job"),
    "islands": _planned_layer_s,
    "islands-linear": _one,
    "warm": _processor_s("warm"),
    "first-slice": _processor_s("slice"),
    "first-run": _processor_s("run"),
    "make-demo": _processor_s("demo"),
    "scale-memory": _part_mb,
    "scale-time": _processor_s("scale"),
}
"""By the target's key; a row that is not here counts no bytes, and its remark says what it costs."""
