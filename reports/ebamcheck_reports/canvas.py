"""Canvas: draws a piece of a layer to scale, from millimetres to inline SVG."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck_reports.markup import Markup, element

Box = tuple[float, float, float, float]

MARGIN_PX = 12.0
FOOT_PX = 26.0  # Room for the scale bar
HEIGHT_LIMIT = 1.1  # Ratio of height to width beyond which a tall layer is drawn at a smaller scale
REDUCTION_PX = 0.2  # Largest distance of a drawn line from its points
LEAST_EXTENT_MM = 1e-6


@dataclass
class Canvas:
    """A drawing of a box of a layer, with y up and one scale for both axes."""

    box: Box
    width_px: float = 760.0
    body: list[Markup] = field(default_factory=list)

    @classmethod
    def of(cls, points: Floats, width_px: float) -> Canvas:
        """A drawing of the box about points (n, 2)."""
        return cls((*points.min(axis=0).tolist(), *points.max(axis=0).tolist()), width_px)

    def __post_init__(self) -> None:
        x0, y0, x1, y1 = self.box
        least = max(LEAST_EXTENT_MM, 0.02 * max(x1 - x0, y1 - y0))
        dx, dy = max(0.0, least - (x1 - x0)) / 2, max(0.0, least - (y1 - y0)) / 2
        self.box = (x0 - dx, y0 - dy, x1 + dx, y1 + dy)
        room = self.width_px - 2 * MARGIN_PX
        width_mm, height_mm = self.box[2] - self.box[0], self.box[3] - self.box[1]
        self.px_per_mm = min(room / width_mm, HEIGHT_LIMIT * room / height_mm)
        self.left_px = MARGIN_PX + 0.5 * (room - width_mm * self.px_per_mm)
        self.height_px = math.ceil(2 * MARGIN_PX + height_mm * self.px_per_mm + FOOT_PX)

    def pixels(self, points: Floats) -> Floats:
        """Places on the picture, (..., 2)."""
        x = self.left_px + (points[..., 0] - self.box[0]) * self.px_per_mm
        y = MARGIN_PX + (self.box[3] - points[..., 1]) * self.px_per_mm
        return np.stack([x, y], axis=-1)

    def lines(self, geometry: BaseGeometry, **style: Any) -> None:
        """Draw lines, or the borders of a region, clipped to the box; regions are filled if `fill` is given."""
        if geometry.is_empty:
            return
        reduced = geometry.simplify(REDUCTION_PX / self.px_per_mm, preserve_topology=False)
        inside = shapely.clip_by_rect(reduced, *self._wider_box())
        data = "".join(self._data(part) for part in shapely.get_parts(inside))
        self._path(data, style)

    def segments(self, start: Floats, end: Floats, **style: Any) -> None:
        """Draw separate straight lines, (n, 2) to (n, 2)."""
        a, b = self.pixels(start), self.pixels(end)
        rows = np.concatenate([a, b], axis=1).tolist()
        self._path("".join(f"M{p:.1f},{q:.1f}L{r:.1f},{s:.1f}" for p, q, r, s in rows), style)

    def beziers(self, points: Floats, **style: Any) -> None:
        """Draw consecutive cubic Bezier spans (n, 4, 2); those outside the box are left out."""
        low, high = points.min(axis=1), points.max(axis=1)
        x0, y0, x1, y1 = self._wider_box()
        seen = (low[:, 0] <= x1) & (high[:, 0] >= x0) & (low[:, 1] <= y1) & (high[:, 1] >= y0)
        pieces: list[str] = []
        at = (math.nan, math.nan)
        for (ax, ay), (bx, by), (cx, cy), (dx, dy) in self.pixels(points[seen]).tolist():
            if (ax, ay) != at:
                pieces.append(f"M{ax:.2f},{ay:.2f}")
            pieces.append(f"C{bx:.2f},{by:.2f} {cx:.2f},{cy:.2f} {dx:.2f},{dy:.2f}")
            at = (dx, dy)
        self._path("".join(pieces), style)

    def dots(self, points: Floats, size_px: float, colour: str) -> None:
        """Mark places by dots."""
        x0, y0, x1, y1 = self._wider_box()
        seen = (points[:, 0] >= x0) & (points[:, 0] <= x1) & (points[:, 1] >= y0) & (points[:, 1] <= y1)
        data = "".join(f"M{x:.1f},{y:.1f}h0" for x, y in self.pixels(points[seen]).tolist())
        self._path(data, {"stroke": colour, "stroke_width": size_px, "stroke_linecap": "round"})

    def circle(self, x_mm: float, y_mm: float, radius_px: float, colour: str) -> None:
        """Draw a circle around a place."""
        x, y = self.pixels(np.array([x_mm, y_mm])).tolist()
        place = {"cx": f"{x:.1f}", "cy": f"{y:.1f}", "r": radius_px}
        self.body.append(element("circle", **place, fill="none", stroke=colour, stroke_width=2))

    def arrows(self, places: Floats, colour: str) -> None:
        """Draw a path from place to place, with an arrow head in the middle of each leg."""
        if len(places) < 2:
            return
        at = self.pixels(places)
        leg = np.diff(at, axis=0)
        length = np.hypot(*leg.T)
        leg /= np.where(length > 0, length, 1.0)[:, None]
        middle = 0.5 * (at[:-1] + at[1:]) + 4.0 * leg
        across = np.column_stack([-leg[:, 1], leg[:, 0]])
        left, right = middle - 7.0 * leg + 3.5 * across, middle - 7.0 * leg - 3.5 * across
        way = "M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in at.tolist())
        self._path(way, {"stroke": colour, "stroke_width": 1.2})
        heads = np.concatenate([left, middle, right], axis=1)[length > 14.0].tolist()
        data = "".join(f"M{a:.1f},{b:.1f}L{c:.1f},{d:.1f}L{e:.1f},{f:.1f}Z" for a, b, c, d, e, f in heads)
        self._path(data, {"fill": colour})

    def label(self, x_mm: float, y_mm: float, text: str, size_px: float = 11.0) -> None:
        """Write a text centred on a place, readable on any colour."""
        x, y = self.pixels(np.array([x_mm, y_mm])).tolist()
        halo = {"stroke": "#fff", "stroke_width": 3, "paint_order": "stroke", "stroke_linejoin": "round"}
        place = {
            "x": f"{x:.1f}",
            "y": f"{y + 0.36 * size_px:.1f}",
            "font_size": size_px,
            "text_anchor": "middle",
        }
        self.body.append(element("text", text, **place, fill="#111", **halo))

    def svg(self, title: str) -> Markup:
        """Return the picture, with a scale bar."""
        size = {"width": f"{self.width_px:g}", "height": self.height_px}
        body = [element("title", title), element("rect", **size, fill="#fff"), *self.body, *self._scale_bar()]
        return element("svg", *body, viewBox=f"0 0 {self.width_px:g} {self.height_px}", **size, role="img")

    def _wider_box(self) -> Box:
        """Box with the margins of the picture and a little more, so that cut ends do not show."""
        x0, y0, x1, y1 = self.box
        wider = (MARGIN_PX + FOOT_PX + self.left_px) / self.px_per_mm
        return (x0 - wider, y0 - wider, x1 + wider, y1 + wider)

    def _data(self, part: BaseGeometry) -> str:
        if isinstance(part, shapely.Polygon):
            return "".join(self._data(ring) for ring in (part.exterior, *part.interiors))
        coordinates = shapely.get_coordinates(part)
        if len(coordinates) < 2:
            return ""
        closed = len(coordinates) > 3 and bool((coordinates[0] == coordinates[-1]).all())
        at = self.pixels(coordinates[:-1] if closed else coordinates)
        pairs = " ".join(f"{x:.2f},{y:.2f}" for x, y in at.tolist())
        return f"M{pairs}Z" if closed else f"M{pairs}"

    def _path(self, data: str, style: dict[str, Any]) -> None:
        if data:
            self.body.append(element("path", d=data, **{"fill": "none", **style}))

    def _scale_bar(self) -> list[Markup]:
        """A bar of 1, 2 or 5 times a power of ten millimetres."""
        target_mm = 0.2 * (self.width_px - 2 * MARGIN_PX) / self.px_per_mm
        power = 10.0 ** math.floor(math.log10(target_mm))
        length_mm = next(s * power for s in (5.0, 2.0, 1.0) if s * power <= target_mm * (1 + 1e-9))
        x0, x1, y = MARGIN_PX, MARGIN_PX + length_mm * self.px_per_mm, self.height_px - 12.0
        back = element("rect", x=0, y=self.height_px - FOOT_PX + 2, width=f"{self.width_px:g}", height=FOOT_PX - 2, fill="#fff")  # fmt: skip
        data = f"M{x0:.1f},{y - 4:.1f}v8M{x0:.1f},{y:.1f}H{x1:.1f}M{x1:.1f},{y - 4:.1f}v8"
        bar = element("path", d=data, fill="none", stroke="#333", stroke_width=1.5)
        name = element("text", f"{length_mm:g} mm", x=f"{x1 + 6:.1f}", y=f"{y + 4:.1f}", font_size=12)
        return [back, bar, name]


def outline(layers: Layers, ring: int) -> Floats:
    """Points of a ring, its first one again at the end, or of an open path, (n, 2) mm."""
    points = layers.ring(ring)
    return np.concatenate([points, points[:1]]) if layers.closed[ring] else points


def outlines(layers: Layers | None, layer: int) -> list[Floats]:
    """Rings and paths of a layer that have a length; none without layers."""
    found = [] if layers is None else [outline(layers, ring) for ring in layers.rings_of(layer)]
    return [points for points in found if len(points) > 1]


def around(x_mm: float, y_mm: float, half_mm: float) -> Box:
    """A square box about a place."""
    return (x_mm - half_mm, y_mm - half_mm, x_mm + half_mm, y_mm + half_mm)
