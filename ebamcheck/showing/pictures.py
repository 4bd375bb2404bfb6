"""Pictures of a planned layer and of a part, as SVG that needs nothing else: islands, fields, scan orders, regions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.kernels import Floats, Ints
from ebamcheck.showing.colours import SCALE, palette_image, png_address, ramp
from ebamcheck.showing.markup import Markup, element, svg_file, text

# Width of a picture, its margin, the room for the title and for the colour scale, and for what stands over the scale
WIDTH_PX, MARGIN_PX, TITLE_PX, SCALE_PX, FOOT_PX = 800, 16, 28, 44, 20
# Length of a scale, of one of temperatures, and half the room of a label of its greatest one
BAR_PX, LONG_BAR_PX, LABEL_PX = 240.0, 560.0, 40.0
TALLEST_PX, LEAST_EXTENT_MM = 1200, 1e-6  # of what is shown
FIELD_PX = 3  # width of a pixel of a field; viewers smooth between them
LABELLED = 400  # islands on a picture up to which each carries its number


def islands_svg(
    islands: NDArray[np.object_],
    values: Floats,
    title: str,
    unit: str = "",
    scene: Scene | None = None,
    temperatures: TemperatureScale | None = None,
) -> str:
    """Draw islands (I,), polygons, coloured by finite values (I,), each with its number where they are not too many. A scene puts
    section, contour beads and path over it, in the frame of the section; `temperatures` are the ends and marks of the scale of
    values that are rises."""
    low, high = float(values.min(initial=0.0)), float(values.max(initial=1.0))
    if temperatures is not None:
        low, high = 0.0, temperatures.greatest
    bounds = shapely.total_bounds(islands) if scene is None else np.asarray(scene.section.bounds)
    view = _View.of(bounds if np.isfinite(bounds).all() and len(bounds) else np.array([0.0, 0.0, 1.0, 1.0]))
    body, texts = [], []
    for island, value in zip(islands, values.tolist(), strict=True):
        share = (value - low) / (high - low) if high > low else 0.0
        filled = {"d": region_path(island, view.place), "fill": ramp(share), "fill_rule": "evenodd"}
        body.append(element("path", **filled, stroke="#fff", stroke_width=0.7))
        if len(islands) <= LABELLED:
            ((x, y),) = view.place(shapely.get_coordinates(shapely.point_on_surface(island)))
            told = str(round(value)) if temperatures is None else temperatures.told(value)
            texts.append(_label(x, y + 3.5, told, share < 0.6, scene is not None))
    if scene is not None:
        body.append(overlay(scene, view.place))
    return view.picture(title, body + texts, low, high, unit, temperatures)


def _label(x_px: float, y_px: float, words: str, on_dark: bool, with_halo: bool) -> Markup:
    ink, ground = ("#fff", "#222") if on_dark else ("#222", "#fff")
    halo: dict[str, Any] = {}
    if with_halo:
        halo = {"stroke": ground, "stroke_width": 2, "stroke_opacity": 0.6, "paint_order": "stroke"}
    return text(x_px, y_px, words, 10, text_anchor="middle", fill=ink, **halo)


def overlay(scene: Scene, place: Callable[[Floats], Floats]) -> Markup:
    """Paths of the section's outline, the contour beads, the lines and the ways between islands, by class."""
    outline, contour = (region_path(region, place) for region in (scene.section, scene.contour))
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
    ends = np.hstack([place(segments[:, :2]), place(segments[:, 2:])])
    return "".join(f"M{a:.1f},{b:.1f}L{c:.1f},{d:.1f}" for a, b, c, d in ends.tolist())


def field_svg(
    values_at: Callable[[Floats], Floats],
    section: BaseGeometry,
    title: str,
    unit: str,
    greatest: float,
    scene: Scene | None = None,
    temperatures: TemperatureScale | None = None,
) -> str:
    """Draw a field over a section, given by its values (n,) at points (n, 2), coloured from 0 to the greatest value; rest as for
    :func:`islands_svg`."""
    view = _View.of(np.asarray(section.bounds))
    step_mm = FIELD_PX / view.scale
    columns, rows = (max(1, math.ceil(extent / step_mm)) for extent in (view.high - view.low).tolist())
    x = view.low[0] + step_mm * (np.arange(columns) + 0.5)
    y = view.high[1] - step_mm * (np.arange(rows) + 0.5)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    inside = shapely.contains_xy(shapely.buffer(section, 1.5 * step_mm), points)
    share = np.zeros(len(points))
    share[inside] = values_at(points[inside]) / greatest if greatest > 0.0 else 0.0
    pixels = np.rint(255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8).reshape(len(y), len(x))
    outline = region_path(section, view.place)
    left, top = view.place(view.low[None])[0, 0], view.place(view.high[None])[0, 1]
    box = {"x": f"{left:.1f}", "y": f"{top:.1f}", "width": len(x) * FIELD_PX, "height": len(y) * FIELD_PX}
    address = png_address(palette_image(pixels, SCALE))
    image = element("image", **box, preserveAspectRatio="none", href=address)
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
        x, y = points.T
        right, down = self.scale * (x - self.low[0]), self.scale * (self.high[1] - y)
        return np.column_stack([MARGIN_PX + right, TITLE_PX + down])

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
        if temperatures is not None:
            bar = _temperature_bar(temperatures, unit, top_px)
        else:
            ends = ((0.0, "start", f"{low:.0f}{unit}"), (BAR_PX, "end", f"{high:.0f}{unit}"))
            bar = _gradient(BAR_PX, top_px) + [_scale_text(*end, top_px + 24.0) for end in ends]
        return svg_file(WIDTH_PX, height_px, [text(MARGIN_PX, 18, title, 14), *body, *bar])


def region_path(region: BaseGeometry, place: Callable[[Floats], Floats]) -> str:
    """Path of the rings of polygons, whose points are put on the picture by `place`."""
    rings = [shapely.get_coordinates(ring)[:-1] for ring in shapely.get_rings(shapely.get_parts(region))]
    return "".join("M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in place(ring)) + "Z" for ring in rings)


def _temperature_bar(scale: TemperatureScale, unit: str, top_px: float) -> list[Markup]:
    """Colours from 0 to the greatest rise, in their last one on to the boiling point, with the marks over it."""
    marks = {"solidus": scale.solidus, "boiling": scale.boiling}
    per_k = LONG_BAR_PX / max(scale.greatest, *marks.values())
    hottest = scale.greatest * per_k
    box = {"x": MARGIN_PX, "y": f"{top_px:.1f}", "width": LONG_BAR_PX, "height": 10}
    bar = [element("rect", **box, fill=ramp(1.0), fill_opacity=0.35), *_gradient(hottest, top_px)]
    low, high = f"0{unit}", f"{scale.greatest:.0f}{unit} and more"
    ends = [(0.0, "start", low), (hottest, "end", high)]
    if hottest <= 3 * LABEL_PX:  # no room under the colours
        ends = [(0.0, "start", f"0 to {high}")]
    bar += [_scale_text(*end, top_px + 24.0) for end in ends]
    for name, rise in marks.items():
        x = MARGIN_PX + rise * per_k
        bar += [
            element("path", class_="mark", d=f"M{x:.1f},{top_px - 3:.1f}v16", stroke="#222", stroke_width=1),
            _scale_text(rise * per_k, "middle", f"{name} {rise:.0f}{unit}", top_px - 6.0),
        ]
    return bar


def _gradient(width_px: float, top_px: float) -> list[Markup]:
    steps = 40
    width = width_px / steps
    box = {"y": f"{top_px:.1f}", "width": f"{width + 0.5:.1f}", "height": 10}
    places = [f"{MARGIN_PX + n * width:.1f}" for n in range(steps)]
    return [element("rect", x=x, **box, fill=ramp(n / (steps - 1))) for n, x in enumerate(places)]


def _scale_text(x_px: float, anchor: str, words: str, y_px: float) -> Markup:
    """Words under or over the scale, at a distance from its beginning."""
    return text(MARGIN_PX + x_px, y_px, words, text_anchor=anchor)


@dataclass(frozen=True, eq=False)
class Scene:
    """One layer as it is drawn: its solid region, whose bounds every picture shows; the region whose border is the centre line of
    the contour beads; and lines of the islands (V, 4) and ways between islands (J, 4), x0, y0, x1, y1, mm."""

    section: BaseGeometry
    contour: BaseGeometry
    lines: Floats
    jumps: Floats

    @classmethod
    def of(cls, section: BaseGeometry, contour: BaseGeometry, vectors: pd.DataFrame) -> Scene:
        """Scene of a layer whose hatch has these vectors, in scan order."""
        lines = vectors[["x0", "y0", "x1", "y1"]].to_numpy(np.float64).reshape(-1, 4)
        island = vectors["island"].to_numpy()
        next_island = np.flatnonzero(island[1:] != island[:-1])
        jumps = np.hstack([lines[next_island, 2:], lines[next_island + 1, :2]])
        return cls(section, contour, lines, jumps)


@dataclass(frozen=True)
class TemperatureScale:
    """Scale of all temperature rises of a layer, K: from 0 to `greatest`, with marks; no rise over the boiling point is one that
    the model can tell."""

    greatest: float
    solidus: float
    boiling: float

    @classmethod
    def of(cls, hottest: float, solidus: float, boiling: float) -> TemperatureScale:
        """Scale up to the hottest rise, or to the boiling point where that is less."""
        return cls(min(max(hottest, 1.0), boiling), solidus, boiling)

    def told(self, rise_k: float) -> str:
        """Return a rise as it is printed: whole kelvins, none under 0, none over the boiling point."""
        return f"over {self.boiling:.0f}" if rise_k > self.boiling else f"{max(rise_k, 0.0):.0f}"


CHART_PX, CHART_HIGH_PX, LEFT_PX, RIGHT_PX, TOP_PX, BASE_PX = 760, 460, 70, 110, 40, 52
BEST, OTHER = "#1b4f82", "#9aa5b1"  # orders that none beats in both figures, and others
CHART_LABEL_PX = 13.0  # least distance of two labels one over the other
TICKS = 5  # steps of each axis


def _round_step(most: float) -> float:
    """Least of 1, 1.5, 2, 3, 4, 5, 6, 8 times a power of ten whose steps reach a value."""
    wanted = max(most, 1.0) * 1.02 / TICKS
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(m * power for m in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0) if m * power >= wanted)


def pareto_svg(figures: Mapping[str, tuple[float, float]], title: str) -> str:
    """Draw orders by travel (mm, to the right) and greatest entry temperature (K, upwards)."""
    step_x = _round_step(max((x for x, _ in figures.values()), default=1.0))
    step_y = _round_step(max((y for _, y in figures.values()), default=1.0))
    most_x, most_y = TICKS * step_x, TICKS * step_y
    wide, tall = CHART_PX - LEFT_PX - RIGHT_PX, CHART_HIGH_PX - TOP_PX - BASE_PX

    def place(x: float, y: float) -> tuple[float, float]:
        return LEFT_PX + wide * x / most_x, TOP_PX + tall * (1.0 - y / most_y)

    body = [text(LEFT_PX, 22, title, 14)]
    base = TOP_PX + tall
    for n in range(TICKS + 1):
        x, y = place(step_x * n, step_y * n)
        grid = f"M{x:.1f},{TOP_PX}V{base}M{LEFT_PX},{y:.1f}H{LEFT_PX + wide}"
        body += [
            element("path", d=grid, stroke="#e3e7eb", fill="none"),
            text(x, base + 16, f"{step_x * n:g}", text_anchor="middle"),
            text(LEFT_PX - 8, y + 4, f"{step_y * n:g}", text_anchor="end"),
        ]
    best = frontier(figures)
    front = " ".join("{:.1f},{:.1f}".format(*place(*figures[name])) for name in best)
    body.append(element("polyline", points=front, fill="none", stroke=BEST, stroke_dasharray="4 4"))
    last_y = -CHART_LABEL_PX
    for name, (x, y) in sorted(figures.items(), key=lambda item: -item[1][1]):
        px, py = place(x, y)
        colour = BEST if name in best else OTHER
        last_y = max(py + 4.0, last_y + CHART_LABEL_PX)
        body += [
            element("circle", cx=f"{px:.1f}", cy=f"{py:.1f}", r=5, fill=colour),
            text(px + 9, last_y, name, 12, fill=colour),
        ]
    body += [
        text(LEFT_PX + wide / 2, CHART_HIGH_PX - 12, "travel between islands, mm", 12, text_anchor="middle"),
        text(
            *(0, 0, "greatest entry temperature rise, K", 12),
            text_anchor="middle",
            transform=f"translate(18,{TOP_PX + tall / 2:.0f}) rotate(-90)",
        ),
    ]
    return svg_file(CHART_PX, CHART_HIGH_PX, body)


def frontier(figures: Mapping[str, tuple[float, float]]) -> list[str]:
    """Orders that no other one beats in both figures, by rising travel."""
    found: list[str] = []
    for name, (_, y) in sorted(figures.items(), key=lambda item: item[1]):
        if not found or y < figures[found[-1]][1]:
            found.append(name)
    return found


# Colours that colour-blind readers tell apart (Okabe, Ito 2008)
KIND_COLOURS = {
    "plane": (86, 180, 233),
    "cylinder": (230, 159, 0),
    "cone": (240, 228, 66),
    "ruled": (213, 94, 0),
    "sphere": (204, 121, 167),
    "torus": (0, 114, 178),
    "quadric": (153, 153, 153),
    "freeform": (0, 158, 115),
}
# Rows to the right, up, and towards the eye
VIEW = np.array([[0.8, 0.6, 0.0], [-0.36, 0.48, 0.8], [0.48, -0.64, 0.6]])
PART_PX, PART_MARGIN_PX, KEY_PX = 720.0, 10.0, 20.0
LEAST_LIGHT = 0.55
MOST_DRAWN = 200_000  # more facets than pixels: a part beyond is drawn without those too small to see


def regions_svg(triangles: Floats, regions: Sequence[tuple[str, Ints]], title: str) -> str:
    """Draw the facets (F, 3, 3) of regions, each of a kind and with its facets, from the front right above, with a key of the kinds
    that there are."""
    region = np.concatenate([np.full(len(facets), k) for k, (_, facets) in enumerate(regions)])
    corners = triangles[np.concatenate([facets for _, facets in regions])] @ VIEW.T
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1)
    seen = np.flatnonzero(normals[:, 2] > 0.0)
    seen = seen[np.argsort(-size[seen], kind="stable")[:MOST_DRAWN]]
    seen = seen[np.argsort(corners[seen, :, 2].mean(axis=1), kind="stable")]
    low, high = corners[..., :2].min(axis=(0, 1)), corners[..., :2].max(axis=(0, 1))
    scale = (PART_PX - 2.0 * PART_MARGIN_PX) / max(float((high - low).max()), 1e-9)
    kinds = [kind for kind, _ in regions]
    names = [kind for kind in KIND_COLOURS if kind in kinds]
    height = float(scale * (high - low)[1]) + 2.0 * PART_MARGIN_PX + KEY_PX * (len(names) + 1)
    body = []
    for i in seen:
        x = PART_MARGIN_PX + scale * (corners[i, :, 0] - low[0])
        y = PART_MARGIN_PX + scale * (high[1] - corners[i, :, 1])
        light = LEAST_LIGHT + (1.0 - LEAST_LIGHT) * normals[i, 2] / size[i]
        red, green, blue = (round(light * c) for c in KIND_COLOURS[kinds[region[i]]])
        points = " ".join(f"{u:.2f},{v:.2f}" for u, v in zip(x, y, strict=True))
        colour = f"#{red:02x}{green:02x}{blue:02x}"
        body.append(element("polygon", points=points, fill=colour, stroke=colour, stroke_width=0.4))
    for row, name in enumerate(names):
        y = height - KEY_PX * (len(names) - row)
        colour = "rgb({},{},{})".format(*KIND_COLOURS[name])
        body += [
            element("rect", x=f"{PART_MARGIN_PX:g}", y=f"{y - 11:.1f}", width=14, height=12, fill=colour),
            text(PART_MARGIN_PX + 20, y, f"{name} ({kinds.count(name)})", 13),
        ]
    return svg_file(PART_PX, math.ceil(height), body, title)
