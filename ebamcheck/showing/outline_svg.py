"""A small picture of rings for a notebook, as inline SVG; :mod:`ebamcheck.layers.svg` draws the pictures for files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ebamcheck.numeric.rings import Floats
from ebamcheck.showing.markup import NAMESPACE, Markup, element

WIDTH_PX, HEIGHT_PX, MARGIN_PX = 360, 300, 8
MOST_POINTS = 20_000
"""Of more points every second, third … is drawn: a notebook keeps its pictures."""

STYLE = {
    "fill": "#9fc3e8",
    "fill_opacity": 0.6,
    "fill_rule": "nonzero",
    "stroke": "#2a78b8",
    "stroke_width": 1,
}
OPEN_STYLE = {"fill": "none", "stroke": "#d55e00", "stroke_width": 2}


def outline_svg(closed: Sequence[Floats], open_paths: Sequence[Floats] = ()) -> str:
    """Draw closed rings (n, 2), filled where they wind around, and open paths; nothing without points."""
    every = [ring for ring in (*closed, *open_paths) if len(ring)]
    if not every:
        return ""
    points = np.concatenate(every)
    low, wide = points.min(axis=0), np.ptp(points, axis=0)
    scale = min(
        (room - 2 * MARGIN_PX) / max(float(extent), 1e-9)
        for room, extent in zip((WIDTH_PX, HEIGHT_PX), np.maximum(wide, 1e-3 * max(wide.max(), 1e-9)), strict=True)
    )  # fmt: skip
    step = -(-len(points) // MOST_POINTS)

    def path(rings: Sequence[Floats], end: str, style: Mapping[str, Any]) -> Markup:
        data = ""
        for ring in rings:
            at = (ring[:: step if len(ring) > 4 * step else 1] - low) * (scale, -scale)
            at += (MARGIN_PX, MARGIN_PX + wide[1] * scale)
            data += "M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in at.tolist()) + end
        return element("path", d=data, **style) if data else Markup("")

    width, height = (round(float(e) * scale) + 2 * MARGIN_PX for e in wide)
    drawn = (path(closed, "Z", STYLE), path(open_paths, "", OPEN_STYLE))
    return str(element("svg", *drawn, xmlns=NAMESPACE, width=width, height=height))
