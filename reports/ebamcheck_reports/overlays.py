"""Pictures of chosen layers: an overlay of the contours of all methods, with the worst place enlarged."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import shapely

from ebamcheck.layers.stack import Layers
from ebamcheck.layers.svg import overlay_svg
from ebamcheck.printable import indexed
from ebamcheck.showing.colours import COLOURS, DASHES
from ebamcheck.showing.markup import inline
from ebamcheck_reports.canvas import HEIGHT_LIMIT, LEAST_EXTENT_MM, Box, Canvas, around, outline
from ebamcheck_reports.markup import Markup, element, join, paragraph, picture
from ebamcheck_reports.run_data import RunData, layer_name

MOST_LAYERS = 8
WIDTH_PX, INSET_PX = 720, 320

INSET_LIMITS = 5.0
"""Half the side of the inset over the depth or the limit, whichever is greater, so that both are visible."""

LARGEST_INSET = 0.15
"""Largest half side of the inset, over the size of the layer: the inset enlarges at least a little even for a tiny layer."""

MOST_BYTES = 300_000
"""Size of a picture above which it is drawn at half its scale, which needs fewer points."""


class Place(NamedTuple):
    """Place at which two methods are farthest apart on a layer, in terms of their limit."""

    x_mm: float
    y_mm: float
    depth_mm: float
    limit_mm: float
    pair: str


def render(run: RunData) -> Markup:
    """Draw the layers that :func:`chosen_layers` selects."""
    if run.part_of("slabs"):
        count = int(run.part_of("slabs")["count"])
        return paragraph(
            f"The part was checked in {count} slabs, and their layers were dropped: there are none to draw."
        )
    chosen = chosen_layers(run)
    if not chosen:
        return Markup("")
    worst = worst_places(run)
    frames = [_frame(run, layer, why, worst.get(layer)) for layer, why in chosen.items()]
    return join(
        [element("h3", "Chosen layers"), element("div", *frames, class_="frames", data_label="layer")]
    )


def chosen_layers(run: RunData) -> dict[int, str]:
    """Layers to draw and why, from the bottom up: first, middle, last, worst and those with findings."""
    filled = run.filled_layers
    if not filled:
        return {}
    chosen = {filled[0]: "first layer"}
    chosen.setdefault(filled[len(filled) // 2], "middle layer")
    chosen.setdefault(filled[-1], "last layer")
    worst = worst_places(run)
    if worst:
        layer = max(worst, key=lambda k: (worst[k].depth_mm / worst[k].limit_mm, -k))
        chosen[layer] = f"{chosen[layer]}, worst agreement" if layer in chosen else "worst agreement"
    for finding in run.disagreements:
        layer = int(finding["layer"]) - 1
        if layer in chosen and "disagreement" not in chosen[layer]:
            chosen[layer] += ", disagreement"
        elif layer not in chosen and len(chosen) < MOST_LAYERS:
            chosen[layer] = "disagreement"
    return dict(sorted(chosen.items()))


def worst_places(run: RunData) -> dict[int, Place]:
    """Worst place of each layer on which a pair was compared."""
    rows = indexed(run.pair_table)
    if not len(rows):
        return {}
    rows = rows[rows["gated"] & (rows["limit_mm"] > 0)]
    ratio = (rows["depth_mm"] / rows["limit_mm"]).fillna(0.0).to_numpy()
    order = np.lexsort((-ratio, rows["layer"].to_numpy()))
    first = rows.iloc[order].drop_duplicates("layer")
    figures = first[["depth_x_mm", "depth_y_mm", "depth_mm", "limit_mm"]].to_numpy(np.float64).tolist()
    names = [f"{a} and {b}" for a, b in zip(first["a"], first["b"], strict=True)]
    places = (
        Place(x, y, depth, limit, pair) for (x, y, depth, limit), pair in zip(figures, names, strict=True)
    )
    return dict(zip(first["layer"].astype(int).tolist(), places, strict=True))


def _frame(run: RunData, layer: int, why: str, worst: Place | None) -> Markup:
    stacks = run.layer(layer)
    height = next(iter(stacks.values())).heights[0]
    name = layer_name(layer, float(height))
    pictures = [_overlay(stacks, name)]
    caption = f"{name} ({why})."
    if worst is not None and np.isfinite([worst.x_mm, worst.y_mm]).all():
        pictures.append(_inset(stacks, worst))
        caption += (
            f" Enlarged: the place where {worst.pair} differ most, ({worst.x_mm:.3f}, {worst.y_mm:.3f}) mm: "
            f"depth {worst.depth_mm:.4g} mm, limit {worst.limit_mm:.4g} mm."
        )
    return picture(element("div", *pictures, class_="beside"), caption, class_="frame", name=name)


def _overlay(stacks: Mapping[str, Layers], title: str) -> Markup:
    """Draw an overlay of several stacks of one layer."""
    box = _box(stacks)
    svg = overlay_svg(stacks, 0, width_px=WIDTH_PX, title=title, box=box)
    if len(svg) > MOST_BYTES:
        svg = overlay_svg(stacks, 0, width_px=WIDTH_PX // 2, title=title, box=box)
    return inline(svg)


def _box(stacks: Mapping[str, Layers]) -> Box:
    """Box of a layer in all stacks, widened so that a narrow one is not drawn taller than the page."""
    bounds = np.array([layers.bounds() for layers in stacks.values()])
    x0, y0 = np.nanmin(bounds[:, :2], axis=0)
    x1, y1 = np.nanmax(bounds[:, 2:], axis=0)
    least = max(LEAST_EXTENT_MM, 0.02 * max(x1 - x0, y1 - y0))
    wider = 0.5 * max(0.0, max(least, (y1 - y0) / HEIGHT_LIMIT) - (x1 - x0))
    taller = 0.5 * max(0.0, least - (y1 - y0))
    return (float(x0 - wider), float(y0 - taller), float(x1 + wider), float(y1 + taller))


def _inset(stacks: Mapping[str, Layers], worst: Place) -> Markup:
    """Enlarge the worst place, in the colours and dashes of the whole picture."""
    reach = worst.depth_mm if np.isfinite(worst.depth_mm) else 0.0
    x0, y0, x1, y1 = _box(stacks)
    half_mm = min(INSET_LIMITS * max(reach, worst.limit_mm), LARGEST_INSET * max(x1 - x0, y1 - y0))
    canvas = Canvas(around(worst.x_mm, worst.y_mm, half_mm), INSET_PX)
    for n, layers in enumerate(stacks.values()):
        colour, dashes = COLOURS[n % len(COLOURS)], DASHES[n % len(DASHES)]
        for r in layers.rings_of(0):
            ring = outline(layers, r)
            if len(ring) > 1:
                width = max(1.0, 4.0 - 0.8 * n)
                canvas.lines(
                    shapely.LineString(ring),
                    stroke=colour,
                    stroke_width=f"{width:g}",
                    stroke_dasharray=dashes or None,
                )
    canvas.circle(worst.x_mm, worst.y_mm, 9.0, "#b3261e")
    return canvas.svg("worst place enlarged")
