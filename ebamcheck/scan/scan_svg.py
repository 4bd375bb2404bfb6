"""Pictures of a planned layer as self-contained SVG: its islands coloured by rank or by entry temperature."""

from __future__ import annotations

import math
from collections.abc import Callable
from xml.sax.saxutils import escape

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.heat.section_grid import SectionGrid
from ebamcheck.rings import Floats

WIDTH_PX, MARGIN_PX, TITLE_PX, SCALE_PX = 800, 16, 28, 44
"""Width of a picture, its margin, and the room for the title and for the colour scale."""

VIRIDIS = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))
"""Five colours of the map `viridis` (Smith and van der Walt, CC0), which is even to the eye."""

LABELLED = 400
"""Islands on a picture up to which each carries its number."""


def islands_svg(
    islands: NDArray[np.object_],
    values: Floats,
    title: str,
    unit: str = "",
    least: float | None = None,
    greatest: float | None = None,
    labels: bool = False,
    border: bool = True,
    mask: BaseGeometry | None = None,
) -> str:
    """Draw islands coloured by a value.

    Parameters
    ----------
    islands
        (I,) polygons.
    values
        (I,) finite.
    least, greatest
        Ends of the colour scale, so that pictures can be compared; those of the values if None.
    labels
        Write each value into its island, as a whole number.
    border
        Draw a white line around each island.
    mask
        What is covered in white in the end.
    """
    low = float(values.min(initial=0.0)) if least is None else least
    high = float(values.max(initial=1.0)) if greatest is None else greatest
    x0, y0, x1, y1 = shapely.total_bounds(islands) if len(islands) else (0.0, 0.0, 1.0, 1.0)
    scale = (WIDTH_PX - 2 * MARGIN_PX) / max(x1 - x0, 1e-6)
    height_px = math.ceil(TITLE_PX + scale * (y1 - y0) + SCALE_PX + MARGIN_PX)

    def place(points: Floats) -> Floats:
        return np.column_stack(
            [MARGIN_PX + scale * (points[:, 0] - x0), TITLE_PX + scale * (y1 - points[:, 1])]
        )

    line = ' stroke="#fff" stroke-width="0.7"' if border else ' shape-rendering="crispEdges"'
    body = []
    for island, value in zip(islands, values.tolist(), strict=True):
        path = ring_path(island, place)
        share = (value - low) / (high - low) if high > low else 0.0
        body.append(f'<path d="{path}" fill="{_colour(share)}" fill-rule="evenodd"{line}/>')
        if labels and len(islands) <= LABELLED:
            ((x, y),) = place(shapely.get_coordinates(shapely.point_on_surface(island)))
            ink = "#fff" if share < 0.6 else "#222"
            body.append(
                f'<text x="{x:.1f}" y="{y + 3.5:.1f}" font-size="10" text-anchor="middle" fill="{ink}">{round(value)}</text>'
            )
    body += [
        f'<path d="{ring_path(cover, place)}" fill="#fff" fill-rule="evenodd"/>'
        for cover in shapely.get_parts(mask)
        if mask is not None
    ]
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH_PX}" height="{height_px}" '
        f'viewBox="0 0 {WIDTH_PX} {height_px}" font-family="Helvetica, Arial, sans-serif">'
    )
    title_line = f'<text x="{MARGIN_PX}" y="18" font-size="14" fill="#222">{escape(title)}</text>'
    ground = f'<rect width="{WIDTH_PX}" height="{height_px}" fill="#ffffff"/>'
    return "\n".join(
        [head, ground, title_line, *body, *_scale_bar(low, high, unit, height_px - SCALE_PX), "</svg>", ""]
    )


def field_svg(
    grid: SectionGrid, values: Floats, section: BaseGeometry, title: str, unit: str, greatest: float
) -> str:
    """Draw a field on the cells of a section, (M,), coloured from 0 to the greatest value and more."""
    row, column = np.nonzero(grid.number >= 0)
    low = grid.origin + np.column_stack([column, row]) * grid.step
    boxes: NDArray[np.object_] = np.array(shapely.box(*low.T, *(low + grid.step).T), object)
    # What the cells cover beside the section is covered in white.
    around = shapely.box(*shapely.total_bounds(boxes)).buffer(1.0, join_style="mitre")
    return islands_svg(
        boxes, values, title, unit, 0.0, greatest, border=False, mask=around.difference(section)
    )


def ring_path(island: shapely.Polygon, place: Callable[[Floats], Floats]) -> str:
    """Path of the rings of an island, whose points are put on the picture by `place`."""
    rings = [shapely.get_coordinates(ring)[:-1] for ring in (island.exterior, *island.interiors)]
    return "".join("M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in place(ring)) + "Z" for ring in rings)


def _colour(share: float) -> str:
    """Colour of a share between 0 and 1."""
    at = min(max(share, 0.0), 1.0) * (len(VIRIDIS) - 1)
    step = min(int(at), len(VIRIDIS) - 2)
    mixed = (round(a + (at - step) * (b - a)) for a, b in zip(VIRIDIS[step], VIRIDIS[step + 1], strict=True))
    return "#" + "".join(f"{part:02x}" for part in mixed)


def _scale_bar(low: float, high: float, unit: str, top_px: float) -> list[str]:
    """Colours from left to right, with their ends named."""
    steps, width = 40, 240 / 40
    bar = [
        f'<rect x="{MARGIN_PX + n * width:.1f}" y="{top_px:.1f}" width="{width + 0.5:.1f}" height="10" '
        f'fill="{_colour(n / (steps - 1))}"/>'
        for n in range(steps)
    ]
    ends = ((MARGIN_PX, "start", low), (MARGIN_PX + 240, "end", high))
    return bar + [
        f'<text x="{x}" y="{top_px + 24:.1f}" font-size="11" text-anchor="{anchor}" fill="#222">{value:.0f}{escape(unit)}</text>'
        for x, anchor, value in ends
    ]
