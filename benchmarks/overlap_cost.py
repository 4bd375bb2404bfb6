"""What planecut pays for overlapping shells: to find that there are none, and to unite those that there are."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from benchmarks.parts import with_bar
from benchmarks.timing import forget_peak, status_mb
from benchmarks.worker import Begin
from ebamcheck.layers.heights import layer_heights
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import registry

BACKEND = "planecut"
ROUNDS = 3


def clean_part(begin: Begin, stl: str, layer_mm: float) -> dict[str, Any]:
    """Time all layers of a part without overlaps with the test for overlaps and without it, in turns.

    Returns
    -------
    ``with_s``, ``without_s``: one figure a round; the test costs the difference of their least.
    """
    part = load(Path(stl))
    _cut_s(part, layer_mm * 50.0, "unite")
    forget_peak()
    begin()
    with_s, without_s = [], []
    for _ in range(ROUNDS):
        without_s.append(_cut_s(part, layer_mm, "keep"))
        with_s.append(_cut_s(part, layer_mm, "unite"))
    return {"with_s": with_s, "without_s": without_s, "own_peak_mb": status_mb("VmHWM")}


def unions(begin: Begin, stl: str, layer_mm: float, shares: list[float]) -> dict[str, Any]:
    """Time parts whose shells overlap over a share of the height.

    Returns
    -------
    ``shares`` and, for each, ``layers`` with an overlap and ``union_s``, the time that the union costs: the least
    with it less the least without it.
    """
    clean = load(Path(stl))
    parts = [with_bar(clean, share) for share in shares]
    _cut_s(parts[0], layer_mm * 50.0, "unite")
    begin()
    layers, union_s = [], []
    for part, share in zip(parts, shares, strict=True):
        united, kept = (
            min(_cut_s(part, layer_mm, overlaps) for _ in range(ROUNDS)) for overlaps in ("unite", "keep")
        )
        union_s.append(united - kept)
        layers.append(round(share * float(clean.size[2]) / layer_mm))
    return {"shares": shares, "layers": layers, "union_s": union_s}


def _cut_s(part: Part, layer_mm: float, overlaps: str) -> float:
    """Seconds to cut all layers of a part that is ready."""
    heights = layer_heights(part, layer_mm)
    settings = registry.slicer_settings(BACKEND, {"overlaps": overlaps})
    with registry.available_slicer(BACKEND).prepare(part, settings) as prepared:
        start = time.perf_counter()
        prepared.slice(heights)
        return time.perf_counter() - start
