"""Picture of one layer's partition: islands in the colour of their rank, lines, contour bead and order."""

from __future__ import annotations

import numpy as np
import shapely

from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.scan import ScanPlan
from ebamcheck.showing.colours import ramp
from ebamcheck_reports.canvas import Box, Canvas, outline
from ebamcheck_reports.markup import Markup, legend

WIDTH_PX = 880.0

MOST_NUMBERS = 150
"""Most islands that are numbered: more numbers would cover the picture; colours and path remain."""

MOST_ARROWS = 600
BEAD, LINE, WAY, THIN, SECTION = "#0072b2", "#555555", "#d81b60", "#d55e00", "#000000"
LEGEND = (
    ("first island", ramp(0.0), ""),
    ("last island", ramp(1.0), ""),
    ("way from island to island", WAY, ""),
    ("hatch line (one bead)", LINE, ""),
    ("contour of the part", SECTION, ""),
    ("contour bead: centre line, and its width lightly", BEAD, ""),
    ("border of a thin wall", THIN, "5 3"),
)


def draw(plan: ScanPlan, section: Layers | None, layer: int, bead_width_mm: float, title: str) -> Markup:
    """Draw a layer's islands, lines, contour beads and the order in which they come, and the section to be filled."""
    islands = plan.islands_of(layer)
    outlines = [] if section is None else [outline(section, r) for r in section.rings_of(layer)]
    canvas = Canvas(_box(plan, layer, bead_width_mm, outlines), WIDTH_PX)
    region = plan.contours[layer]
    bead_px = bead_width_mm * canvas.px_per_mm
    canvas.lines(
        region.boundary,
        stroke=BEAD,
        stroke_width=f"{bead_px:.1f}",
        stroke_opacity=0.18,
        stroke_linejoin="round",
    )
    for rank, island in enumerate(islands.tolist()):
        colour = ramp(rank / max(len(islands) - 1, 1))
        thin = plan.island_kind[island] == "thin wall"
        canvas.lines(
            plan.islands[island], fill=colour, fill_opacity=0.55, stroke=THIN if thin else "#fff",
            stroke_width=1.8 if thin else 1.0, stroke_dasharray="5 3" if thin else None,
        )  # fmt: skip
    vectors = plan.vectors_of(layer)
    canvas.segments(
        vectors[["x0", "y0"]].to_numpy(), vectors[["x1", "y1"]].to_numpy(), stroke=LINE, stroke_width=0.7
    )
    canvas.lines(region.boundary, stroke=BEAD, stroke_width=1.6)
    for points in outlines:
        canvas.lines(shapely.LineString(points), stroke=SECTION, stroke_width=1.0)
    centres = plan.island_centroid[islands]
    if len(islands) <= MOST_ARROWS:
        canvas.arrows(centres, WAY)
    if len(islands) <= MOST_NUMBERS:
        for rank, (x, y) in enumerate(centres.tolist()):
            canvas.label(x, y, str(rank + 1))
    return canvas.svg(title)


def key() -> Markup:
    """Explain colours and lines."""
    return legend(LEGEND)


def _box(plan: ScanPlan, layer: int, bead_width_mm: float, outlines: list[Floats]) -> Box:
    """Box of beads and section together."""
    shapes = [plan.contours[layer], *plan.islands[plan.islands_of(layer)]]
    pad = 0.5 * bead_width_mm
    bounds = [np.add(shapely.bounds(s), (-pad, -pad, pad, pad)) for s in shapes if not s.is_empty]
    bounds += [np.concatenate([points.min(axis=0), points.max(axis=0)]) for points in outlines]
    if not bounds:
        return (-0.5, -0.5, 0.5, 0.5)
    low, high = np.min(bounds, axis=0)[:2], np.max(bounds, axis=0)[2:]
    return (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
