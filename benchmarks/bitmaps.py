"""The stencil's bitmaps at 1024 x 1024: how long they take, and how many pixels differ from literal and exact ones."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmarks.timing import forget_peak, some_of, status_mb
from benchmarks.worker import Begin
from ebamcheck.kernels import Floats
from ebamcheck.layers.heights import layer_heights
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.plugins import registry
from ebamcheck_stencil.crossings import as_image, empty_bitmap, flip, flips_by_layer
from ebamcheck_stencil.draw_once import DrawnOnce
from ebamcheck_stencil.field_of_view import SUBPIXELS, FieldOfView, field_of_view
from ebamcheck_stencil.literal import LiteralSlices

SIDE_PX, MARGIN_PX = 1024, 6
"""Side of the images, and what the field of view leaves free of it around a part."""

JUDGED_LAYERS = 48
"""Layers whose bitmaps are compared: the literal mode draws the part for each of them."""

ROUNDS = 3


def bitmaps(begin: Begin, stl: str, layer_mm: float) -> dict[str, Any]:
    """Time bitmaps and contours of all layers, and compare bitmaps on some.

    Returns
    -------
    ``bitmaps_s`` (draw, and find which pixels change at each layer), ``contours_s`` (from the crossings to canonical
    contours) one figure a round; ``against_literal``, ``against_exact`` pixels that differ, one figure a judged layer;
    ``by_lattice`` those that the exact section differs in when vertices lie on the rasteriser's lattice; ``farthest_px``
    distance of a wrong pixel's centre from the exact contour; ``renderer``, ``side_px``.
    """
    part = load(Path(stl))
    heights = layer_heights(part, layer_mm)
    pixel_mm = float(part.size[:2].max()) / (SIDE_PX - MARGIN_PX)
    view = field_of_view(part, pixel_mm)
    _timed(part, some_of(heights, 8), pixel_mm)
    forget_peak()
    begin()
    rounds = [_timed(part, heights, pixel_mm) for _ in range(ROUNDS)]
    return {
        "bitmaps_s": [round_[0] for round_ in rounds],
        "contours_s": [round_[1] for round_ in rounds],
        "own_peak_mb": status_mb("VmHWM"),
        "renderer": registry.probe("stencil").device,
        "side_px": [view.width_px, view.height_px],
        **_compared(part, some_of(heights, JUDGED_LAYERS), pixel_mm, view),
    }


def _prepared(part: Part, mode: str, pixel_mm: float) -> Any:
    settings = registry.slicer_settings("stencil", {"mode": mode, "pixel_mm": pixel_mm})
    return registry.available_slicer("stencil").prepare(part, settings)


def _timed(part: Part, heights: Floats, pixel_mm: float) -> tuple[float, float]:
    start = time.perf_counter()
    with _prepared(part, "draw-once", pixel_mm) as drawn:
        assert isinstance(drawn, DrawnOnce)
        flips_by_layer(drawn._crossings, heights)
        bitmaps_s = time.perf_counter() - start
        start = time.perf_counter()
        drawn.slice(heights)
        return bitmaps_s, time.perf_counter() - start


def _compared(part: Part, heights: Floats, pixel_mm: float, view: FieldOfView) -> dict[str, Any]:
    """Pixels that differ between the draw-once form, the literal one and the exact section, on each layer."""
    exact, on_lattice = _cut(part, heights), _cut(_on_lattice(part, view), heights)
    with _prepared(part, "draw-once", pixel_mm) as drawn:
        assert isinstance(drawn, DrawnOnce)
        flips = flips_by_layer(drawn._crossings, heights)
    bitmap = empty_bitmap(view)
    against_literal, against_exact, by_lattice, farthest_px = [], [], [], 0.0
    with _prepared(part, "literal", pixel_mm) as literal:
        assert isinstance(literal, LiteralSlices)
        for k, height in enumerate(heights.tolist()):
            flip(bitmap, flips.pixels[flips.starts[k] : flips.starts[k + 1]])
            image, truth = as_image(bitmap, view), exact_image(exact, k, view)
            wrong = image != truth
            against_literal.append(int(np.count_nonzero(image != literal.bitmap(height))))
            against_exact.append(int(np.count_nonzero(wrong)))
            by_lattice.append(int(np.count_nonzero(truth != exact_image(on_lattice, k, view))))
            farthest_px = max(farthest_px, _farthest_mm(wrong, exact, k, view) / pixel_mm)
    return {
        "against_literal": against_literal,
        "against_exact": against_exact,
        "by_lattice": by_lattice,
        "farthest_px": farthest_px,
        "judged_layers": len(heights),
    }


def _cut(part: Part, heights: Floats) -> Layers:
    planecut = registry.available_slicer("planecut")
    with planecut.prepare(part, planecut.Settings()) as prepared:
        return prepared.slice(heights)


def _on_lattice(part: Part, view: FieldOfView) -> Part:
    """The part with every vertex where a rasteriser of 8 subpixel bits has it: the best that any of them can draw."""
    moved = part.vertices.copy()
    moved[:, :2] = view.to_mm(2.0 * view.snapped(part.vertices) / SUBPIXELS - 1.0)
    return from_arrays(moved, part.faces)


def exact_image(layers: Layers, layer: int, view: FieldOfView) -> NDArray[np.bool_]:
    """Which pixel centres (height, width) lie in the section, by the crossings of every contour with every row."""
    centres = view.to_mm(2 * np.column_stack([np.zeros(view.height_px, np.int64), np.arange(view.height_px)]))
    rows_mm = centres[:, 1]
    columns_mm = view.to_mm(
        2 * np.column_stack([np.arange(view.width_px), np.zeros(view.width_px, np.int64)])
    )
    starts, ends = _segments(layers, layer)
    upward = starts[:, 1] < ends[:, 1]
    low, high = np.where(upward[:, None], starts, ends), np.where(upward[:, None], ends, starts)
    first, past = np.searchsorted(rows_mm, low[:, 1]), np.searchsorted(rows_mm, high[:, 1])
    counts = past - first
    segment = np.repeat(np.arange(len(starts)), counts)
    row = np.arange(len(segment)) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(first, counts)
    share = (rows_mm[row] - low[segment, 1]) / (high[segment, 1] - low[segment, 1])
    x = low[segment, 0] + share * (high[segment, 0] - low[segment, 0])
    column = np.searchsorted(columns_mm[:, 0], x)
    changes = np.zeros((view.height_px, view.width_px + 1), np.int64)
    np.add.at(changes, (row, column), np.where(upward[segment], -1, 1))
    return np.asarray(np.cumsum(changes, axis=1)[:, :-1] > 0)


def _segments(layers: Layers, layer: int) -> tuple[Floats, Floats]:
    """Start and end (S, 2) of every segment of the closed contours of a layer."""
    rings = [layers.ring(r) for r in layers.rings_of(layer) if layers.closed[r]]
    if not rings:
        return np.zeros((0, 2)), np.zeros((0, 2))
    return np.concatenate(rings), np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])


def _farthest_mm(wrong: NDArray[np.bool_], layers: Layers, layer: int, view: FieldOfView) -> float:
    """Greatest distance of the centre of a wrong pixel from the exact contour."""
    rows, columns = np.nonzero(wrong)
    if not len(rows):
        return 0.0
    starts, ends = _segments(layers, layer)
    contour = shapely.multilinestrings(np.asarray(shapely.linestrings(np.stack([starts, ends], axis=1))))
    centres = shapely.points(view.to_mm(2 * np.column_stack([columns, rows])))
    return float(shapely.distance(centres, contour).max())
