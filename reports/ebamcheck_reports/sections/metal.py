"""Metal: the metal that the program's text deposits, layer by layer, against that of the part, and a picture of one layer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.metal import FIELD_FILE, LayerField, read_field
from ebamcheck.checks.rules import names_of
from ebamcheck.kernels import Floats
from ebamcheck.showing.colours import palette_image, png_address
from ebamcheck.showing.markup import element as plain
from ebamcheck.showing.markup import inline, svg_file, text
from ebamcheck.showing.pictures import region_path
from ebamcheck_reports.charts import Series, line_chart
from ebamcheck_reports.markup import Markup, facts, figure, figure_percent, paragraph, picture, section, table
from ebamcheck_reports.run_data import RunData

QUESTION = (
    "The text of the program is run over a height field: every motion with beam and wire on lays the metal that its wire "
    "speed and feed give, whatever a comment says. Good is as much metal as the part has, where the part is, and flat."
)

CHECKS = (*names_of("deposit"), "mass balance")  # Checks of the program that are about its metal


def render(run: RunData) -> Markup:
    """Build the section; runs of earlier versions have no table of it."""
    if not (run.folder.path / "deposit.csv").is_file():
        none = paragraph("This run did not weigh its metal.", class_="note")
        return section("metal", "Metal", QUESTION, none)
    layers = run.table("deposit.csv")
    solid = layers[layers["wanted_mm3"] > 0.0]
    checks = [check for check in run.checks if check["name"] in CHECKS]
    rows = [(c["name"], "pass" if c["passed"] else "FAIL", c["text"]) for c in checks]
    told = table(("check", "", "found"), rows, class_="onscreen")
    return section("metal", "Metal", QUESTION, _totals(solid), told, *_worst(run, layers), *_charts(solid))


def _totals(solid: pd.DataFrame) -> Markup:
    laid, wanted = float(solid["laid_mm3"].sum()), float(solid["wanted_mm3"].sum())
    ratio = (solid["laid_mm3"] / solid["wanted_mm3"]).to_numpy()
    return facts(
        [
            ("metal over part", figure_percent(laid / max(wanted, 1e-9))),
            ("least layer", figure_percent(ratio.min(initial=np.inf))),
            ("greatest layer", figure_percent(ratio.max(initial=0.0))),
            ("beside the part", figure_percent(float(solid["outside_mm3"].sum()) / max(laid, 1e-9))),
            ("surface too low, at most", figure(float(solid["low_mm"].max()), "mm")),
            ("surface too high, at most", figure(float(solid["high_mm"].max()), "mm")),
        ]
    )


def _worst(run: RunData, layers: pd.DataFrame) -> list[Markup]:
    """Picture of the worst layer with its worst places circled; none for a run of an earlier version."""
    file = run.folder.path / FIELD_FILE
    if not file.is_file():
        return []
    field, layer, thickness_mm = read_field(file)
    found = layers[layers["layer"] == layer + 1].iloc[0]
    name = f"layer {layer + 1}, Z {found['z_mm']:.3f}"
    solid = run.folder.read_layers(run.part_of("program")["witness"]).section(layer)
    limit_mm = run.config.process.largest_unevenness_mm
    svg = draw(field, solid, thickness_mm, limit_mm, name, _places(found, thickness_mm))
    caption = (
        f"The layer that comes nearest to a limit, {name}, as the program's text lays it on those below: its own metal, and the "
        "surface when it is done. Rings mark the places that the checks name."
    )
    return [picture(inline(svg, "paper"), caption, name="metal-worst")]


def _places(found: pd.Series[Any], thickness_mm: float) -> tuple[list[Place], list[Place]]:
    """Worst places of a layer on its metal and on its surface, with their figures."""
    metal = {
        "zone": f"window {found['zone_settled']:.2f} of {thickness_mm:.2f} mm",
        "reach": f"{found['reach_mm']:.2f} mm beside the part",
    }
    surface = {"low": f"{found['low_mm']:.2f} mm too low", "high": f"{found['high_mm']:.2f} mm too high"}

    def placed(names: dict[str, str]) -> list[Place]:
        return [
            (float(found[f"{key}_x_mm"]), float(found[f"{key}_y_mm"]), name)
            for key, name in names.items()
            if np.isfinite(found[f"{key}_x_mm"]) and found.get(f"{key}_mm", 1.0) > 0.0
        ]

    return placed(metal), placed(surface)


def _charts(solid: pd.DataFrame) -> list[Markup]:
    layer = solid["layer"]
    mass = [
        Series("metal over part", layer, solid["laid_mm3"] / solid["wanted_mm3"]),
        Series("height inside", layer, solid["inside"]),
        Series("height at edges", layer, solid["edge"]),
    ]
    surface = [
        Series("too high", layer, solid["high_mm"]),
        Series("too low", layer, -solid["low_mm"]),
        Series("reach beside the part", layer, solid["reach_mm"]),
    ]
    return [
        picture(
            line_chart(mass, "layer", "over that of the part"),
            "Metal of each layer, and its mean height further and nearer than a bead width from the border.",
        ),
        picture(
            line_chart(surface, "layer", "mm"),
            "The surface over and under its height while it is built, and how far metal reaches beside the part.",
        ),
    ]


# -- picture of a layer ----------------------------------------------------------------------------

# Width of the picture, its margin, and the room for the title of a field and for its colour scale
WIDTH_PX, MARGIN_PX, TITLE_PX, SCALE_PX, BAR_PX = 880, 16, 28, 40, 240
RING_PX = 9  # Radius of the ring around a place that is named
# Too low, right, too high: ends and middle of ColorBrewer's RdBu, which colour-blind readers tell apart
BLUE, WHITE, RED = (33, 102, 172), (247, 247, 247), (178, 24, 43)

COLOURS: NDArray[np.uint8] = np.column_stack(
    [np.interp(np.arange(256), [0, 127.5, 255], parts) for parts in zip(BLUE, WHITE, RED, strict=True)]
).astype(np.uint8)
# (256, 3) colours of the cells; the first is the ground, for cells beside the section without metal
COLOURS[0] = 255
# Share of a cell in the section, and height of metal over the layer height, below which the cell is not drawn
BARE = 0.01

Place = tuple[float, float, str]  # X and Y of a place, mm, and its name

Placing = Callable[[Floats], Floats]  # Places (n, 2) on the picture of points in mm


def draw(
    field: LayerField,
    section: BaseGeometry,
    thickness_mm: float,
    limit_mm: float,
    title: str,
    places: tuple[Sequence[Place], Sequence[Place]] = ((), ()),
) -> str:
    """Draw the metal of a layer of a height, and its surface on a scale up to the limit, with the section and places over them."""
    step_mm, cells = field.target.step_mm, np.array(field.laid_mm.shape[::-1], np.float64)
    px_per_mm = (WIDTH_PX - 2 * MARGIN_PX) / (cells[0] * step_mm)
    tall_px = px_per_mm * cells[1] * step_mm
    panel_px = TITLE_PX + tall_px + SCALE_PX
    metal = field.laid_mm / thickness_mm - 1.0
    ends = (f"{limit_mm:g} mm too low", "right", f"{limit_mm:g} mm too high")
    fields = (
        (f"{title}: metal of the layer", metal, 1.0, ("none", "one layer high", "two")),
        (f"{title}: surface when the layer is done", field.over_mm, limit_mm, ends),
    )
    ground = (field.target.share < BARE) & (field.laid_mm < BARE * thickness_mm)
    body = []
    for number, (name, values, most, told) in enumerate(fields):
        top_px = number * panel_px + TITLE_PX

        def placing(points: Floats, top_px: float = top_px) -> Floats:
            x, y = px_per_mm * (points - field.target.origin).T
            return np.column_stack([MARGIN_PX + x, top_px + tall_px - y])

        outline = region_path(section, placing)
        body += [
            text(MARGIN_PX, top_px - 10, name, 14),
            _cells(np.where(ground, np.nan, values), most, top_px, tall_px),
            plain("path", d=outline, fill="none", stroke="#222", stroke_width=1),
            *_rings(places[number], placing),
            *_scale(told, top_px + tall_px + 6.0),
        ]
    return svg_file(WIDTH_PX, int(np.ceil(len(fields) * panel_px)), body)


def _cells(values: Floats, most: float, top_px: float, tall_px: float) -> Markup:
    """Cells (rows, columns) coloured from -most to most; those that are NaN have the colour of the ground."""
    share = np.clip(0.5 + 0.5 * values[::-1] / most, 0.0, 1.0)
    pixels = np.where(np.isnan(share), 0.0, np.rint(1.0 + 254.0 * np.nan_to_num(share)))
    return _image(pixels.astype(np.uint8), top_px, WIDTH_PX - 2 * MARGIN_PX, tall_px)


def _image(pixels: NDArray[np.uint8], top_px: float, width_px: float, height_px: float) -> Markup:
    size = {"width": f"{width_px:g}", "height": f"{height_px:.1f}", "preserveAspectRatio": "none"}
    address = png_address(palette_image(pixels, COLOURS))
    return plain("image", x=MARGIN_PX, y=f"{top_px:.1f}", **size, href=address)


def _rings(places: Sequence[Place], placing: Placing) -> list[Markup]:
    """Circles around places with their names beside them, on the side with more room."""
    halo = {"fill": "#000", "stroke": "#fff", "stroke_width": 3, "paint_order": "stroke"}
    found = []
    for x_mm, y_mm, name in places:
        x, y = placing(np.array([[x_mm, y_mm]]))[0]
        right = x < 0.5 * WIDTH_PX
        at, anchor = (x + RING_PX + 4, "start") if right else (x - RING_PX - 4, "end")
        circle = {"cx": f"{x:.1f}", "cy": f"{y:.1f}", "r": RING_PX}
        found += [
            plain("circle", **circle, fill="none", stroke="#000", stroke_width=2),
            text(at, y + 4, name, 12, **halo, text_anchor=anchor),
        ]
    return found


def _scale(told: tuple[str, str, str], top_px: float) -> list[Markup]:
    """Colours from left to right with their ends and middle named."""
    strip = _image(np.arange(1, 256, dtype=np.uint8)[None], top_px, 2 * BAR_PX, 8)
    bar = {"x": MARGIN_PX, "y": f"{top_px:.1f}", "width": 2 * BAR_PX, "height": 8}
    border = plain("rect", **bar, fill="none", stroke="#888", stroke_width=0.5)
    places = ((0.0, "start"), (0.5, "middle"), (1.0, "end"))
    ends = (
        text(MARGIN_PX + 2 * BAR_PX * share, top_px + 21, words, text_anchor=anchor)
        for (share, anchor), words in zip(places, told, strict=True)
    )
    return [border, plain("g", strip, class_="scale"), *ends]
