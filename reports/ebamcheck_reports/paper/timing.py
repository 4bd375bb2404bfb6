"""Figure 9: time of slicing over the eleven sizes of one part."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ebamcheck.errors import EbamcheckError
from ebamcheck.kernels import Floats
from ebamcheck.layers.heights import layer_heights
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import registry
from ebamcheck_reports.paper import published
from ebamcheck_reports.paper.published import Effort, Note

STENCIL = "stencil"
LITERAL = "stencil, literal"  # The paper's own method: for each layer all facets above it are drawn
STL_HEADER_BYTES, STL_FACET_BYTES = 84, 50  # Binary STL: header and count, and each facet
# Times shorter than this are measured twice and the lesser is kept: other work on the machine easily spoils them
REPEAT_UNDER_S = 2.0


class Method(NamedTuple):
    """One row of the table of times."""

    name: str
    backend: str
    settings: Mapping[str, Any]


def methods() -> list[Method]:
    """Every installed backend, the paper's own method first."""
    found = [Method(name, name, {}) for name in registry.house_slicers()]
    if STENCIL in registry.slicers():
        literal = {"mode": "literal", "pixel_mm": published.PIXEL_MM}
        found = [m if m.backend != STENCIL else Method("stencil, draw-once", STENCIL, {}) for m in found]
        found.insert(0, Method(LITERAL, STENCIL, literal))
    return found


def measure(effort: Effort, note: Note) -> dict[str, Any]:
    """Tessellate the stand-in (the same layers and about the same file sizes) at each tolerance, and time every available
    backend."""
    model = registry.models(["ladder"])["ladder"]
    tried = methods()
    sizes = []
    # One run without the clock, so that no time includes the compilation of a kernel or the start of a driver.
    coarse = model.tessellate(published.TOLERANCES_MM[0])
    for method in tried:
        timed(coarse, layer_heights(coarse, published.LAYER_HEIGHT_MM), method, effort)
    for tolerance_mm in effort.tolerances_mm:
        part = model.tessellate(tolerance_mm)
        heights = layer_heights(part, published.LAYER_HEIGHT_MM)
        note(f"slicing times: tolerance {tolerance_mm:g} mm, {len(part.faces)} facets")
        sizes.append(
            {
                "tolerance_mm": tolerance_mm,
                "facets": len(part.faces),
                "size_mb": (STL_HEADER_BYTES + STL_FACET_BYTES * len(part.faces)) / 2**20,
                "layers": len(heights),
                "times": {m.name: timed(part, heights, m, effort) for m in tried},
            }
        )
    return {
        "model": model.name,
        "summary": model.summary,
        "layer_step": effort.layer_step,
        "devices": {m.name: _device(m) for m in tried},
        "sizes": sizes,
        "paper": {
            "seconds": published.SLICING_S,
            "seconds_in_text": published.SLICING_TEXT_S,
            "facets": published.FACETS,
            "layers": published.LAYERS,
            "device": published.DEVICE,
            "tolerances_mm": list(published.TOLERANCES_MM),
            "sizes_mb": list(published.SIZES_MB),
        },
    }


def layers_cut(heights: Floats, method: Method, effort: Effort) -> Floats:
    """Heights of the layers on which a method is timed."""
    if method.name != LITERAL:
        return heights[effort.layer_step // 2 :: effort.layer_step]
    places = np.linspace(0, len(heights) - 1, min(effort.literal_layers, len(heights)))
    return heights[np.unique(places.astype(np.int64))]


def timed(part: Part, heights: Floats, method: Method, effort: Effort) -> dict[str, Any]:
    """Time one method on one part; a time of fewer layers (``total_s``) is scaled to all of them, preparing apart."""
    chosen = layers_cut(heights, method, effort)
    untimed = {"prepare_s": None, "slice_s": None, "layers": 0, "total_s": None}
    if not registry.probe(method.backend).available:
        return {"status": "unavailable", "why": registry.probe(method.backend).why, **untimed}
    try:
        prepare_s, slice_s = _clocked(part, chosen, method)
        if prepare_s + slice_s < REPEAT_UNDER_S:
            prepare_s, slice_s = min((prepare_s, slice_s), _clocked(part, chosen, method), key=sum)
    except EbamcheckError as error:
        return {"status": "failed", "why": str(error), **untimed}
    return {
        "status": "done",
        "why": "",
        "prepare_s": prepare_s,
        "slice_s": slice_s,
        "layers": len(chosen),
        "total_s": prepare_s + slice_s * (len(heights) / len(chosen)),
    }


def _clocked(part: Part, heights: Floats, method: Method) -> tuple[float, float]:
    """Seconds of preparing and of slicing."""
    settings = registry.slicer_settings(method.backend, method.settings)
    start = time.perf_counter()
    with registry.available_slicer(method.backend).prepare(part, settings) as prepared:
        ready = time.perf_counter()
        prepared.slice(heights)
        return ready - start, time.perf_counter() - ready


def _device(method: Method) -> str:
    found = registry.probe(method.backend)
    return found.device if found.available else found.why
