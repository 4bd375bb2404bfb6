"""Pictures of a planned layer as self-contained SVG: its islands coloured by rank or by entry temperature."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.drawing.scene import Scene, TemperatureScale
from ebamcheck.heat.modes import SectionGrid
from ebamcheck.numeric.rings import Floats
from ebamcheck.showing.colours import SCALE, ramp
from ebamcheck.showing.image import palette_image, png_address
from ebamcheck.showing.markup import Markup, element, svg_file, text

WIDTH_PX, MARGIN_PX, TITLE_PX, SCALE_PX, FOOT_PX = 800, 16, 28, 44, 20
"""Width of a picture, its margin, the room for the title and for the colour scale, and for what stands over the scale."""

BAR_PX, LONG_BAR_PX, LABEL_PX = 240.0, 560.0, 40.0
"""Length of a scale, of one of temperatures, and half the room of a label of its greatest one."""

TALLEST_PX, LEAST_EXTENT_MM = 1200, 1e-6
"""Greatest height of what is shown, and extent under which it counts as a point."""

FIELD_PX = 3
"""Width of a pixel of a field; viewers smooth between them."""

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
    scene: Scene | None = None,
    temperatures: TemperatureScale | None = None,
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
    scene
        Draw the section, contour beads and path over it, in the frame of the section.
    temperatures
        The values are rises, and these are the ends and the marks of the scale.
    """
    if temperatures is not None:
        least, greatest = 0.0, temperatures.greatest
    low = float(values.min(initial=0.0)) if least is None else least
    high = float(values.max(initial=1.0)) if greatest is None else greatest
    bounds = shapely.total_bounds(islands) if scene is None else np.asarray(scene.section.bounds)
    view = _View.of(bounds if np.isfinite(bounds).all() and len(bounds) else np.array([0.0, 0.0, 1.0, 1.0]))
    body, texts = [], []
    for island, value in zip(islands, values.tolist(), strict=True):
        share = (value - low) / (high - low) if high > low else 0.0
        path = ring_path(island, view.place)
        body.append(
            element("path", d=path, fill=ramp(share), fill_rule="evenodd", stroke="#fff", stroke_width=0.7)
        )
        if labels and len(islands) <= LABELLED:
            ((x, y),) = view.place(shapely.get_coordinates(shapely.point_on_surface(island)))
            told = str(round(value)) if temperatures is None else temperatures.told(value)
            texts.append(_label(x, y + 3.5, told, share < 0.6, scene is not None))
    if scene is not None:
        body.append(overlay(scene, view.place))
    return view.picture(title, body + texts, low, high, unit, temperatures)


def _label(x_px: float, y_px: float, words: str, on_dark: bool, with_halo: bool) -> Markup:
    """Words about a place that are read on their colour, and over lines by a halo."""
    ink, ground = ("#fff", "#222") if on_dark else ("#222", "#fff")
    halo: dict[str, Any] = {}
    if with_halo:
        halo = {"stroke": ground, "stroke_width": 2, "stroke_opacity": 0.6, "paint_order": "stroke"}
    return text(x_px, y_px, words, 10, text_anchor="middle", fill=ink, **halo)


def overlay(scene: Scene, place: Callable[[Floats], Floats]) -> Markup:
    """Paths of the section's outline, the contour beads, the lines and the ways between islands, by class."""
    outline, contour = (
        "".join(ring_path(part, place) for part in shapely.get_parts(region))
        for region in (scene.section, scene.contour)
    )
    lines, jumps = (_strokes(columns, place) for columns in (scene.lines, scene.jumps))
    return element(
        "g",
        element("path", class_="outline", d=outline, stroke="#222", stroke_width=0.7),
        element("path", class_="contour", d=contour, stroke="#8a939c", stroke_width=1.2),
        element("path", class_="lines", d=lines, stroke="#fff", stroke_opacity=0.45, stroke_width=0.8),
        element("path", class_="jumps", d=jumps, stroke="#d1242f", stroke_opacity=0.6, stroke_width=0.8),
        fill="none",
    )


def _strokes(segments: Floats, place: Callable[[Floats], Floats]) -> str:
    """Path of separate segments (n, 4)."""
    ends = np.hstack([place(segments[:, :2]), place(segments[:, 2:])])
    return "".join(f"M{a:.1f},{b:.1f}L{c:.1f},{d:.1f}" for a, b, c, d in ends.tolist())


def field_svg(
    grid: SectionGrid,
    values: Floats,
    section: BaseGeometry,
    title: str,
    unit: str,
    greatest: float,
    scene: Scene | None = None,
    temperatures: TemperatureScale | None = None,
) -> str:
    """Draw a field given by its values (M,) in the cells of a section, coloured from 0 to the greatest value and more.

    `scene` and `temperatures` as for :func:`islands_svg`.
    """
    view = _View.of(np.asarray(section.bounds))
    step_mm = FIELD_PX / view.scale
    columns, rows = (max(1, math.ceil(extent / step_mm)) for extent in (view.high - view.low).tolist())
    x = view.low[0] + step_mm * (np.arange(columns) + 0.5)
    y = view.high[1] - step_mm * (np.arange(rows) + 0.5)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    inside = shapely.contains_xy(shapely.buffer(section, 1.5 * step_mm), points)
    share = np.zeros(len(points))
    share[inside] = grid.interpolation(points[inside]) @ values / greatest if greatest > 0.0 else 0.0
    pixels = np.rint(255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8).reshape(len(y), len(x))
    outline = "".join(ring_path(part, view.place) for part in shapely.get_parts(section))
    left, top = view.place(view.low[None])[0, 0], view.place(view.high[None])[0, 1]
    image = element(
        "image",
        x=f"{left:.1f}",
        y=f"{top:.1f}",
        width=len(x) * FIELD_PX,
        height=len(y) * FIELD_PX,
        preserveAspectRatio="none",
        href=png_address(palette_image(pixels, SCALE)),
    )
    body = [
        element("clipPath", element("path", d=outline, clip_rule="evenodd"), id="section"),
        element("g", image, clip_path="url(#section)"),
        element("path", d=outline, fill="none", stroke="#222", stroke_width=0.7),
    ]
    if scene is not None:
        body.append(overlay(scene, view.place))
    return view.picture(title, body, 0.0, greatest, unit, temperatures)


@dataclass(frozen=True)
class _View:
    """Where a picture shows what: a box from `low` to `high` (2,) mm, at `scale` px/mm."""

    low: Floats
    high: Floats
    scale: float

    @classmethod
    def of(cls, bounds: Floats) -> _View:
        """Show a box (4,) as large as the picture can."""
        low, high = bounds[:2], bounds[2:]
        wide, tall = np.maximum(high - low, LEAST_EXTENT_MM).tolist()
        return cls(low, high, min((WIDTH_PX - 2 * MARGIN_PX) / wide, TALLEST_PX / tall))

    def place(self, points: Floats) -> Floats:
        """Places of points (n, 2) on the picture, px."""
        return np.column_stack(
            [
                MARGIN_PX + self.scale * (points[:, 0] - self.low[0]),
                TITLE_PX + self.scale * (self.high[1] - points[:, 1]),
            ]
        )

    def picture(
        self,
        title: str,
        body: list[Markup],
        low: float,
        high: float,
        unit: str,
        temperatures: TemperatureScale | None = None,
    ) -> str:
        """Return the picture of a body with its title over it and a colour scale under it."""
        extent = float(self.high[1] - self.low[1])
        height_px = math.ceil(TITLE_PX + self.scale * extent + FOOT_PX + SCALE_PX)
        top_px = float(height_px - SCALE_PX)
        if temperatures is None:
            bar = _scale_bar(low, high, unit, top_px)
        else:
            bar = _temperature_bar(temperatures, unit, top_px)
        return svg_file(WIDTH_PX, height_px, [text(MARGIN_PX, 18, title, 14), *body, *bar])


def ring_path(island: shapely.Polygon, place: Callable[[Floats], Floats]) -> str:
    """Path of the rings of an island, whose points are put on the picture by `place`."""
    rings = [shapely.get_coordinates(ring)[:-1] for ring in (island.exterior, *island.interiors)]
    return "".join("M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in place(ring)) + "Z" for ring in rings)


def _scale_bar(low: float, high: float, unit: str, top_px: float) -> list[Markup]:
    """Colours from left to right, with their ends named."""
    ends = ((0.0, "start", f"{low:.0f}{unit}"), (BAR_PX, "end", f"{high:.0f}{unit}"))
    return _gradient(BAR_PX, top_px) + [_scale_text(*end, top_px + 24.0) for end in ends]


def _temperature_bar(scale: TemperatureScale, unit: str, top_px: float) -> list[Markup]:
    """Colours from 0 to the greatest rise, in their last one on to the boiling point, with the marks over it."""
    per_k = LONG_BAR_PX / max(scale.greatest, *(rise for _, rise in scale.marks))
    hottest = scale.greatest * per_k
    beyond = element(
        "rect",
        x=MARGIN_PX,
        y=f"{top_px:.1f}",
        width=LONG_BAR_PX,
        height=10,
        fill=ramp(1.0),
        fill_opacity=0.35,
    )
    bar = [beyond, *_gradient(hottest, top_px)]
    low, high = f"0{unit}", f"{scale.greatest:.0f}{unit} and more"
    if hottest > 3 * LABEL_PX:
        bar += [
            _scale_text(0.0, "start", low, top_px + 24.0),
            _scale_text(hottest, "end", high, top_px + 24.0),
        ]
    else:  # no room under the colours
        bar.append(_scale_text(0.0, "start", f"0 to {high}", top_px + 24.0))
    for name, rise in scale.marks:
        x = MARGIN_PX + rise * per_k
        bar += [
            element("path", class_="mark", d=f"M{x:.1f},{top_px - 3:.1f}v16", stroke="#222", stroke_width=1),
            _scale_text(rise * per_k, "middle", f"{name} {rise:.0f}{unit}", top_px - 6.0),
        ]
    return bar


def _gradient(width_px: float, top_px: float) -> list[Markup]:
    steps = 40
    width = width_px / steps
    return [
        element(
            "rect",
            x=f"{MARGIN_PX + n * width:.1f}",
            y=f"{top_px:.1f}",
            width=f"{width + 0.5:.1f}",
            height=10,
            fill=ramp(n / (steps - 1)),
        )
        for n in range(steps)
    ]


def _scale_text(x_px: float, anchor: str, words: str, y_px: float) -> Markup:
    """Words under or over the scale, at a distance from its beginning."""
    return text(MARGIN_PX + x_px, y_px, words, text_anchor=anchor)
