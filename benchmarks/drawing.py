"""The literal mode's draws by the graphics device's own clock: what its slicing cannot be faster than."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.methods import PAPERS_PIXEL_MM
from benchmarks.worker import Begin
from ebamcheck.layers.heights import layer_heights
from ebamcheck.mesh.files import load
from ebamcheck.plugins import registry
from ebamcheck_stencil.literal import LiteralSlices


def drawing(begin: Begin, stl: str, layer_mm: float) -> dict[str, Any]:
    """Draw all layers, and wait for nothing but the device.

    Returns
    -------
    ``device_s`` seconds that the device was at it: drawing, packing, copying bitmaps; ``renderer``.
    """
    part = load(Path(stl))
    heights = layer_heights(part, layer_mm)
    settings = registry.slicer_settings("stencil", {"mode": "literal", "pixel_mm": PAPERS_PIXEL_MM})
    with registry.available_slicer("stencil").prepare(part, settings) as literal:
        assert isinstance(literal, LiteralSlices)
        literal.slice(heights[:: max(1, len(heights) // 64)])
        begin()
        device_s = 0.0
        for first in range(0, len(heights), literal._at_once):
            with literal._context:
                query = literal._context.query(time=True)
                with query:
                    literal._submit(heights[first : first + literal._at_once], literal._drawings[0])
                device_s += 1e-9 * query.elapsed
    return {"device_s": device_s, "renderer": registry.probe("stencil").device}
