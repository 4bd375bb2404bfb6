"""Pictures of layers as self-contained SVG, reduced to what a screen shows: one layer, an overlay, or a sheet of layers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers, from_paths
from ebamcheck.showing.colours import COLOURS, DASHES
from ebamcheck.showing.columns import index_of
from ebamcheck.showing.markup import NAMESPACE, Markup, element, svg_file, text

REDUCTION_PX = 0.2  # largest distance of a drawn line from its points: well below what a screen shows
MARGIN_PX = 16
TITLE_PX = 28  # room above the drawing for its title
FOOT_PX = 30  # room under the drawing for the scale bar
SMALLEST_EXTENT_MM = 1e-6  # a layer of one point is drawn as if it were this large
HEIGHT = "data-height-mm"  # attribute of the group of a layer in a file for exchange

SOLID = "#9fc3e8"
RING = "#1b4f82"
OPEN = "#d1242f"
Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class _View:
    """Map from millimetres to pixels of a picture."""

    box: Box
    px_per_mm: float
    left_px: float
    top_px: float

    @property
    def width_px(self) -> float:
        return (self.box[2] - self.box[0]) * self.px_per_mm

    @property
    def height_px(self) -> float:
        return (self.box[3] - self.box[1]) * self.px_per_mm

    def path(self, points: Floats, closed: bool) -> str:
        """SVG path data of a ring or an open path, reduced, y up."""
        reduced = _reduced(points, closed, REDUCTION_PX / self.px_per_mm)
        x = self.left_px + (reduced[:, 0] - self.box[0]) * self.px_per_mm
        y = self.top_px + (self.box[3] - reduced[:, 1]) * self.px_per_mm
        pairs = " ".join(f"{a:.2f},{b:.2f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
        return f"M{pairs}Z" if closed else f"M{pairs}"


def layer_svg(
    layers: Layers, layer: int, *, width_px: int = 800, box: Box | None = None, title: str | None = None
) -> str:
    """Draw one layer as an SVG document: solid region, rings, open paths, scale bar and counts.

    A negative `layer` counts from the top. `box` is what is shown (xmin, ymin, xmax, ymax, mm; None: the layer itself), `title` the
    text above it (None: layer, height and counts)."""
    k = index_of(layer, len(layers))
    view = _view(box or _layer_box([(layers, k)]), width_px, MARGIN_PX, TITLE_PX)
    return _document(_region(layers, k, view), view, width_px, _title(layers, k) if title is None else title)


def overlay_svg(
    stacks: Mapping[str, Layers], layer: int, *, width_px: int = 800, box: Box | None = None, title: str | None = None
) -> str:  # fmt: skip
    """Draw one layer of several slicers as in :func:`layer_svg`, each with its own colour and dash, and a legend."""
    if not stacks:
        raise SettingsError("no stacks to draw over each other: give at least one")
    chosen = [(layers, index_of(layer, len(layers))) for layers in stacks.values()]
    view = _view(box or _layer_box(chosen), width_px, MARGIN_PX, TITLE_PX + 18)
    body: list[Markup] = []
    for n, (name, (layers, k)) in enumerate(zip(stacks, chosen, strict=True)):
        colour, dash = COLOURS[n % len(COLOURS)], DASHES[n % len(DASHES)]
        lines = _outlines(layers, k, view, colour, dash, n)
        body.append(element("g", *lines, class_="slicer", data_name=name))
    body += _legend(list(stacks))
    first, k = chosen[0]
    heading = f"layer {k + 1}, z = {first.heights[k]:.3f} mm" if title is None else title
    return _document(body, view, width_px, heading)


def sheet_svg(layers: Layers, *, width_px: int = 1200, columns: int = 4, most: int = 16, exact: bool = False) -> str:
    """Draw up to `most` layers side by side at one scale; `exact` holds all contours with every digit, the others hidden."""
    if not len(layers):
        raise SettingsError("no layers to draw: the stack is empty")
    count = min(most, len(layers))
    chosen = np.unique(np.linspace(0, len(layers) - 1, count).round().astype(int)).tolist()
    columns = min(columns, len(chosen))
    cell_px = width_px / columns
    box = _widened(layers.bounds())
    first = _view(box, cell_px, MARGIN_PX / 2, TITLE_PX)
    row_px = first.height_px + TITLE_PX + MARGIN_PX
    body: list[Markup] = []
    places = {k: n for n, k in enumerate(chosen)}
    for k in range(len(layers)):
        n = places.get(k, 0)
        left, top = (n % columns) * cell_px, TITLE_PX + (n // columns) * row_px
        view = _View(box, first.px_per_mm, left + first.left_px, top + TITLE_PX)
        if k in places:
            body.append(text(left + MARGIN_PX / 2, top + 18, _title(layers, k)))
        if exact:
            body.append(_exact(layers, k, view, k in places))
        elif k in places:
            body += _region(layers, k, view)
    rows = math.ceil(len(chosen) / columns)
    bottom = _View(box, first.px_per_mm, MARGIN_PX, TITLE_PX + rows * row_px - first.height_px)
    title = f"{len(chosen)} of {len(layers)} layers" + (f", {layers.backend}" if layers.backend else "")
    return _document(body, bottom, width_px, title)


def write_stack(layers: Layers, path: str | Path) -> None:
    """Write all contours as one SVG, a sheet of layers to look at."""
    with replacing(path) as temporary:
        temporary.write_text(sheet_svg(layers, exact=True), encoding="utf-8")


def read_stack(path: str | Path) -> Layers:
    """Read the contours of an SVG that :func:`write_stack` wrote, every number bit for bit."""
    try:
        root = ElementTree.parse(path).getroot()
        groups = [group for group in root.iter(f"{{{NAMESPACE}}}g") if group.get(HEIGHT)]
        if not groups:
            raise ValueError(f"it has no group with {HEIGHT}")
        heights = [float(group.get(HEIGHT, "")) for group in groups]
        lines = [[line for path in group for line in path.get("d", "").split("M")[1:]] for group in groups]
        layers = [[(_points(line), line.endswith("Z")) for line in layer] for layer in lines]
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"{path}: is no SVG with contours at heights, as `slice -o` writes it: {error}") from None
    return from_paths(heights, layers)


def _exact(layers: Layers, k: int, view: _View, shown: bool) -> Markup:
    """Group of a layer whose paths are in millimetres."""
    scale, x0, y1 = view.px_per_mm, view.box[0], view.box[3]
    style = {"stroke_width": 1, "vector_effect": "non-scaling-stroke", "stroke_linejoin": "round"}
    paths = [
        element("path", class_=kind, d="".join(data), fill=fill, fill_rule="nonzero", stroke=stroke, **style)
        for kind, end, fill, stroke in (("region", "Z", SOLID, RING), ("open", "", "none", OPEN))
        if (data := [_data(layers.ring(r), end) for r in layers.rings_of(k) if layers.closed[r] == bool(end)])
    ]
    place = f"matrix({scale!r} 0 0 {-scale!r} {view.left_px - x0 * scale!r} {view.top_px + y1 * scale!r})"
    height = {HEIGHT: repr(float(layers.heights[k]))}
    return element("g", *paths, transform=place, display=None if shown else "none", **height)


def _points(data: str) -> Floats:
    return np.array(data.rstrip("Z").replace(",", " ").split(), np.float64)


def _data(points: Floats, end: str) -> str:
    """Path data of a ring or an open path with every digit, mm."""
    return "M" + " ".join(f"{x!r},{y!r}" for x, y in points.tolist()) + end


def _region(layers: Layers, k: int, view: _View) -> list[Markup]:
    # Outer rings and holes have opposite directions, so the nonzero rule fills the solid, and overlapping
    # shells stay solid where even-odd would leave a hole.
    closed = [layers.ring(r) for r in layers.rings_of(k) if layers.closed[r]]
    lines = [layers.ring(r) for r in layers.rings_of(k) if not layers.closed[r]]
    style = {"fill": SOLID, "fill_rule": "nonzero", "stroke": RING, "stroke_width": 1}
    data = "".join(view.path(ring, True) for ring in closed)
    parts = [element("path", class_="region", d=data, stroke_linejoin="round", **style)] if data else []
    return parts + [_path(view.path(line, False), OPEN, 2, class_="open") for line in lines]


def _outlines(layers: Layers, k: int, view: _View, colour: str, dash: str, rank: int) -> list[Markup]:
    """Rings and open paths of a layer as lines; those of later stacks are thinner, so that none is hidden."""
    width = max(1.0, 4.0 - 0.8 * rank)
    return [
        _path(view.path(layers.ring(r), bool(layers.closed[r])), colour, width, stroke_dasharray=dash or None)
        for r in layers.rings_of(k)
    ]


def _scale_bar(view: _View) -> list[Markup]:
    """A bar of 1, 2 or 5 times a power of ten millimetres, about a fifth of the drawing."""
    target_mm = max(view.width_px, 60.0) / view.px_per_mm / 5.0
    power = 10.0 ** math.floor(math.log10(target_mm))
    length_mm = next(step * power for step in (5.0, 2.0, 1.0) if step * power <= target_mm * (1 + 1e-9))
    x0, y = view.left_px, view.top_px + view.height_px + 18
    x1 = x0 + length_mm * view.px_per_mm
    bar = f"M{x0:.2f},{y - 4:.2f}v8M{x0:.2f},{y:.2f}H{x1:.2f}M{x1:.2f},{y - 4:.2f}v8"
    return [_path(bar, "#333", 1.5, class_="scale"), text(x1 + 6, y + 4, f"{length_mm:g} mm", 12)]


def _legend(names: Sequence[str]) -> list[Markup]:
    parts: list[Markup] = []
    x = float(MARGIN_PX)
    for n, name in enumerate(names):
        colour, dash = COLOURS[n % len(COLOURS)], DASHES[n % len(DASHES)]
        parts.append(_path(f"M{x:.1f},36h26", colour, 3, stroke_dasharray=dash or None))
        parts.append(text(x + 31, 40, name, 12))
        x += 31 + 8 * len(name) + 18
    return parts


def _path(data: str, colour: str, width_px: float, **style: Any) -> Markup:
    return element("path", d=data, fill="none", stroke=colour, stroke_width=f"{width_px:g}", **style)


def _document(body: list[Markup], view: _View, width_px: int, title: str) -> str:
    height_px = math.ceil(view.top_px + view.height_px + FOOT_PX)
    return svg_file(width_px, height_px, [text(MARGIN_PX, 20, title, 14), *body, *_scale_bar(view)], title)


def _title(layers: Layers, k: int) -> str:
    block = layers.block(k, k + 1)
    counts = (block.outer_counts(), block.hole_counts(), block.open_counts())
    outer, holes, lines = (count.item() for count in counts)
    told = f"layer {k + 1}, z = {layers.heights[k]:.3f} mm: {outer} outer, {holes} holes"
    return told + (f", {lines} open" if lines else "")


def _layer_box(chosen: Sequence[tuple[Layers, int]]) -> Box:
    boxes = np.array([layers.block(k, k + 1).bounds() for layers, k in chosen])
    boxes = boxes[~np.isnan(boxes[:, 0])]
    if not len(boxes):
        return _widened((math.nan,) * 4)
    (x0, y0), (x1, y1) = boxes[:, :2].min(axis=0).tolist(), boxes[:, 2:].max(axis=0).tolist()
    return _widened((x0, y0, x1, y1))


def _widened(box: Box) -> Box:
    if math.isnan(box[0]):
        return (-0.5, -0.5, 0.5, 0.5)
    x0, y0, x1, y1 = box
    least = max(SMALLEST_EXTENT_MM, 0.02 * max(x1 - x0, y1 - y0))
    dx, dy = max(0.0, least - (x1 - x0)) / 2, max(0.0, least - (y1 - y0)) / 2
    return (x0 - dx, y0 - dy, x1 + dx, y1 + dy)


def _view(box: Box, width_px: float, margin_px: float, top_px: float) -> _View:
    drawing_px = width_px - 2 * margin_px
    if drawing_px <= 0:
        raise SettingsError(f"a picture {width_px} pixels wide has no room for a drawing: give at least 100")
    width_mm, height_mm = box[2] - box[0], box[3] - box[1]
    if not (width_mm > 0 and height_mm > 0 and math.isfinite(width_mm + height_mm)):
        raise SettingsError(f"box {box} has no extent: give xmin, ymin, xmax, ymax in mm")
    # A tall, narrow layer is drawn at a smaller scale.
    scale = min(drawing_px / width_mm, 4.0 * drawing_px / height_mm)
    left_px = margin_px + 0.5 * (drawing_px - width_mm * scale)
    return _View(box, scale, left_px, top_px)


def _reduced(points: Floats, closed: bool, tolerance_mm: float) -> Floats:
    """Points of a line that stays within the tolerance of all of them (Douglas and Peucker 1973)."""
    import shapely

    if len(points) < 4:
        return points

    def simplified(line: Floats) -> Floats:
        if len(line) < 3:
            return line
        simple = shapely.LineString(line).simplify(tolerance_mm, preserve_topology=False)
        return np.asarray(shapely.get_coordinates(simple))

    if not closed:
        return simplified(points)
    # A closed ring is cut at its first point and the one farthest from it, so that both stay.
    far = int(np.argmax(np.hypot(*(points - points[0]).T)))
    halves = (points[: far + 1], np.concatenate([points[far:], points[:1]]))
    return np.concatenate([simplified(half)[:-1] for half in halves])
