"""Picture of the metal that a program's text deposits in one layer: its height, and the surface after the layer."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.metal import LayerField
from ebamcheck.kernels import Floats
from ebamcheck.showing.colours import palette_image, png_address
from ebamcheck.showing.markup import Markup, element, svg_file, text
from ebamcheck.showing.pictures import region_path

WIDTH_PX, MARGIN_PX, TITLE_PX, SCALE_PX, BAR_PX = 880, 16, 28, 40, 240
"""Width of the picture, its margin, and the room for the title of a field and for its colour scale."""

BLUE, WHITE, RED = (33, 102, 172), (247, 247, 247), (178, 24, 43)
"""Too low, right, too high: ends and middle of ColorBrewer's RdBu, which colour-blind readers tell apart."""

COLOURS: NDArray[np.uint8] = np.array(
    [
        [np.interp(n, [0, 127.5, 255], [a, b, c]) for a, b, c in zip(BLUE, WHITE, RED, strict=True)]
        for n in range(256)
    ],
    np.uint8,
)
COLOURS[0] = 255
"""(256, 3) colours of the cells; the first is the ground, for cells beside the section without metal."""

RING_PX = 9
"""Radius of the ring around a place that is named."""

BARE = 0.01
"""Share of a cell in the section, and height of metal over the layer height, below which the cell is not drawn."""


Place = tuple[float, float, str]
"""X and Y of a place, mm, and its name."""


def draw(
    field: LayerField,
    section: BaseGeometry,
    thickness_mm: float,
    limit_mm: float,
    title: str,
    places: tuple[Sequence[Place], Sequence[Place]] = ((), ()),
) -> str:
    """Draw one layer.

    Parameters
    ----------
    field
        What :func:`ebamcheck.checks.metal.deposit` keeps of the layer.
    section
        The section that is drawn over it.
    thickness_mm
        Height of the layer.
    limit_mm
        How far the surface may lie off its height: the end of its scale.
    places
        Places that are ringed and named on the metal, and on the surface.
    """
    step_mm, cells = field.target.step_mm, np.array(field.laid_mm.shape[::-1], np.float64)
    px_per_mm = (WIDTH_PX - 2 * MARGIN_PX) / (cells[0] * step_mm)
    low = field.target.origin
    tall_px = px_per_mm * cells[1] * step_mm
    panel_px = TITLE_PX + tall_px + SCALE_PX
    fields = (
        (f"{title}: metal of the layer", field.laid_mm / thickness_mm - 1.0, 1.0, ("none", "one layer high", "two")),
        (
            f"{title}: surface when the layer is done",
            field.over_mm,
            limit_mm,
            (f"{limit_mm:g} mm too low", "right", f"{limit_mm:g} mm too high"),
        ),
    )  # fmt: skip
    ground = (field.target.share < BARE) & (field.laid_mm < BARE * thickness_mm)
    body = []
    for number, (name, values, most, told) in enumerate(fields):
        top_px = number * panel_px + TITLE_PX

        def place(points: Floats, top_px: float = top_px) -> Floats:
            x, y = px_per_mm * (points - low).T
            return np.column_stack([MARGIN_PX + x, top_px + tall_px - y])

        body += [
            text(MARGIN_PX, top_px - 10, name, 14),
            _cells(np.where(ground, np.nan, values), most, top_px, tall_px),
            _outline(section, place),
            *_rings(places[number], place),
            *_scale(told, top_px + tall_px + 6.0),
        ]
    height_px = int(np.ceil(len(fields) * panel_px))
    return svg_file(WIDTH_PX, height_px, body)


def _cells(values: Floats, most: float, top_px: float, tall_px: float) -> Markup:
    """Cells (rows, columns) coloured from -most to most; those that are NaN have the colour of the ground."""
    share = np.clip(0.5 + 0.5 * values[::-1] / most, 0.0, 1.0)
    pixels = np.where(np.isnan(share), 0.0, np.rint(1.0 + 254.0 * np.nan_to_num(share)))
    return _image(pixels.astype(np.uint8), top_px, WIDTH_PX - 2 * MARGIN_PX, tall_px)


def _image(pixels: NDArray[np.uint8], top_px: float, width_px: float, height_px: float) -> Markup:
    address = png_address(palette_image(pixels, COLOURS))
    return element(
        "image",
        x=MARGIN_PX,
        y=f"{top_px:.1f}",
        width=f"{width_px:g}",
        height=f"{height_px:.1f}",
        preserveAspectRatio="none",
        href=address,
    )


def _outline(section: BaseGeometry, place: Callable[[Floats], Floats]) -> Markup:
    data = region_path(section, place)
    return element("path", d=data, fill="none", stroke="#222", stroke_width=1)


def _rings(places: Sequence[Place], place: Callable[[Floats], Floats]) -> list[Markup]:
    """Circles around places with their names beside them, on the side with more room."""
    found = []
    for x_mm, y_mm, name in places:
        x, y = place(np.array([[x_mm, y_mm]]))[0]
        right = x < 0.5 * WIDTH_PX
        at, anchor = (x + RING_PX + 4, "start") if right else (x - RING_PX - 4, "end")
        found += [
            element(
                "circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=RING_PX, fill="none", stroke="#000", stroke_width=2
            ),
            text(
                *(at, y + 4, name, 12),
                fill="#000",
                stroke="#fff",
                stroke_width=3,
                paint_order="stroke",
                text_anchor=anchor,
            ),
        ]
    return found


def _scale(told: tuple[str, str, str], top_px: float) -> list[Markup]:
    """Colours from left to right with their ends and middle named."""
    strip = _image(np.arange(1, 256, dtype=np.uint8)[None], top_px, 2 * BAR_PX, 8)
    places = ((0.0, "start"), (0.5, "middle"), (1.0, "end"))
    border = element(
        "rect",
        x=MARGIN_PX,
        y=f"{top_px:.1f}",
        width=2 * BAR_PX,
        height=8,
        fill="none",
        stroke="#888",
        stroke_width=0.5,
    )
    ends = (
        text(MARGIN_PX + 2 * BAR_PX * share, top_px + 21, words, text_anchor=anchor)
        for (share, anchor), words in zip(places, told, strict=True)
    )
    return [border, element("g", strip, class_="scale"), *ends]
