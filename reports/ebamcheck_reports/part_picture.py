"""Picture of the part as a stack of its layers: slabs seen obliquely from above, the lowest painted first."""

from __future__ import annotations

import math

import numpy as np
import shapely

from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck_reports.markup import Markup, element

WIDTH_PX, HEIGHT_PX, MARGIN_PX = 420.0, 380.0, 8.0
# Most slabs drawn; of more layers some are chosen, each drawn as high as all layers up to the next chosen one
MOST_SLABS = 60
# Largest distance of a drawn outline from its contour, and longest piece of it in one shade
REDUCTION_PX, SHADED_EVERY_PX = 0.3, 8.0
# Length of an outline over which its direction is taken for the shade, up to a turn at which its walls meet in an edge. Edges
# of the outline are cut otherwise on every layer: shaded by their own directions, a curved wall comes out in patches.
SHADED_OVER_PX, SHARP_RAD = 10.0, math.radians(35.0)
# Direction of view (turn about the vertical, tilt downwards), and of the light, counter-clockwise from +X of the picture
TURN_RAD, TILT_RAD, LIGHT_RAD = math.radians(28.0), math.radians(32.0), math.radians(155.0)
# So many that none is told from the next one: with a few, their borders are stairs on a curved wall
SHADES = 48
# Walls turned from the light and towards it, and tops: all between white and black, to be seen on either
DARK, BRIGHT, TOP = (58, 84, 110), (166, 192, 214), "#c9d9e6"


def draw(layers: Layers, title: str) -> Markup | None:
    """Draw a stack of layers; None where no layer has a closed contour."""
    chosen = chosen_layers(layers)
    if not chosen.size:
        return None
    heights = layers.heights[chosen]
    # A slab reaches up to the next one.
    half = 0.5 * float(np.median(np.diff(layers.heights))) if len(layers) > 1 else 0.5
    low = heights - half
    high = np.append(low[1:], heights[-1] + half)
    view = _View(layers, float(low[0]), float(high[-1]))
    slabs = zip(chosen.tolist(), low.tolist(), high.tolist(), strict=True)
    body = [part for slab in slabs for part in _slab(layers, *slab, view)]
    width_px, height_px = f"{view.width_px:.0f}", f"{view.height_px:.0f}"
    return element(
        "svg",
        element("title", title),
        element("g", *body, stroke_width=0.6),
        viewBox=f"0 0 {width_px} {height_px}",
        width=width_px,
        height=height_px,
        class_="solid",
        role="img",
    )


def chosen_layers(layers: Layers) -> Ints:
    """Indices of the layers that are drawn, of those with contours: evenly chosen, the last one among them."""
    filled = np.flatnonzero(layers.ring_counts() > 0)
    if len(filled) <= MOST_SLABS:
        return filled
    return filled[np.unique(np.linspace(0, len(filled) - 1, MOST_SLABS).round().astype(np.int64))]


class _View:
    """Map from millimetres to pixels of the picture."""

    def __init__(self, layers: Layers, bottom_mm: float, top_mm: float) -> None:
        sine, cosine = math.sin(TURN_RAD), math.cos(TURN_RAD)
        self._turn = np.array([[cosine, sine], [-sine, cosine]])
        self._flat, self._up = math.sin(TILT_RAD), math.cos(TILT_RAD)
        turned = layers.points @ self._turn
        low, high = turned.min(axis=0), turned.max(axis=0)
        wide = high[0] - low[0]
        tall = (high[1] - low[1]) * self._flat + (top_mm - bottom_mm) * self._up
        room_x, room_y = WIDTH_PX - 2 * MARGIN_PX, HEIGHT_PX - 2 * MARGIN_PX
        self.px_per_mm: float = min(room_x / max(wide, 1e-9), room_y / max(tall, 1e-9))
        self.width_px = wide * self.px_per_mm + 2 * MARGIN_PX
        self.height_px = tall * self.px_per_mm + 2 * MARGIN_PX
        self._left, self._bottom = float(low[0]), float(low[1]) * self._flat + bottom_mm * self._up

    def turned(self, points: Floats) -> Floats:
        """Points (n, 2) after the turn about the vertical; +Y then points away from the viewer."""
        return np.asarray(points @ self._turn)

    def pixels(self, turned: Floats, height_mm: float) -> Floats:
        """Places (n, 2) on the picture of turned points at a height."""
        x = MARGIN_PX + (turned[:, 0] - self._left) * self.px_per_mm
        up = turned[:, 1] * self._flat + height_mm * self._up - self._bottom
        return np.column_stack([x, self.height_px - MARGIN_PX - up * self.px_per_mm])

    def drop_px(self, height_mm: float) -> float:
        """How far down a wall of a height reaches on the picture."""
        return float(height_mm * self._up * self.px_per_mm)


def _slab(layers: Layers, layer: int, low_mm: float, high_mm: float, view: _View) -> list[Markup]:
    """Walls that face the viewer, in shades, and the top over them."""
    walls: dict[int, list[str]] = {}
    top = ""
    drop = view.drop_px(high_mm - low_mm)
    for ring in layers.rings_of(layer):
        if not layers.closed[ring]:
            continue
        turned = _reduced(view.turned(layers.ring(ring)), REDUCTION_PX / view.px_per_mm)
        top += "M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in view.pixels(turned, high_mm).tolist()) + "Z"
        line = shapely.LinearRing(turned).segmentize(SHADED_EVERY_PX / view.px_per_mm)
        divided = np.asarray(shapely.get_coordinates(line)[:-1])
        at = view.pixels(divided, high_mm)
        corner = (divided[:, None] == turned[None]).all(axis=2).any(axis=1)
        for shade, run in _facing(divided, SHADED_OVER_PX / view.px_per_mm):
            kept = corner[run]
            kept[[0, -1]] = True
            walls.setdefault(shade, []).append(_wall(at[run[kept]], drop))
    parts = [
        element("path", d="".join(data), fill=_colour(shade), stroke=_colour(shade))
        for shade, data in sorted(walls.items())
    ]
    return [*parts, element("path", d=top, fill=TOP, stroke="#7f98ad", stroke_width=0.3)] if top else parts


def _reduced(points: Floats, tolerance_mm: float) -> Floats:
    """Points of a closed ring that stays within the tolerance; the ring itself where too little would be left."""
    line = shapely.LineString(np.vstack([points, points[:1]])).simplify(tolerance_mm, preserve_topology=False)
    kept = shapely.get_coordinates(line)[:-1]
    return kept if len(kept) >= 3 else points


def _facing(ring: Floats, over_mm: float) -> list[tuple[int, Ints]]:
    """Runs of a ring's points along which it faces the viewer in one shade; the metal lies on the left of a ring."""
    step = np.roll(ring, -1, axis=0) - ring
    length = np.hypot(*step.T)
    middle = np.cumsum(length) - 0.5 * length
    half = 0.5 * min(over_mm, 0.25 * float(length.sum()))
    behind, ahead = (np.minimum(half, away) for away in _to_corners(step, length, middle))
    chord = _places(ring, length, middle + ahead) - _places(ring, length, middle - behind)
    normal = np.column_stack([chord[:, 1], -chord[:, 0]]) / np.maximum(np.hypot(*chord.T), 1e-12)[:, None]
    light = np.array([math.cos(LIGHT_RAD), -math.sin(LIGHT_RAD)])
    lit = np.rint((0.5 + 0.5 * normal @ light) * (SHADES - 1)).astype(np.int64)
    shades = np.where(step[:, 0] > 0.0, lit, -1)
    runs = np.split(np.arange(len(ring)), np.flatnonzero(np.diff(shades)) + 1)
    seen = [run for run in runs if shades[run[0]] >= 0]
    return [(int(shades[run[0]]), np.append(run, (run[-1] + 1) % len(ring))) for run in seen]


def _to_corners(step: Floats, length: Floats, middle: Floats) -> tuple[Floats, Floats]:
    """Length (n,) from the middle of each edge of a closed ring back, and on, to the next sharp corner; endless without any."""
    before = np.roll(step, 1, axis=0)
    turn = np.arctan2(before[:, 0] * step[:, 1] - before[:, 1] * step[:, 0], (before * step).sum(axis=1))
    whole = float(length.sum())
    corners = (np.cumsum(length) - length)[np.abs(turn) > SHARP_RAD]
    if not corners.size:
        return np.full(middle.size, np.inf), np.full(middle.size, np.inf)
    around = np.concatenate([corners[-1:] - whole, corners, corners[:1] + whole])
    after = np.searchsorted(around, middle)
    return middle - around[after - 1], around[after] - middle


def _places(ring: Floats, length: Floats, along: Floats) -> Floats:
    """Points (n, 2) at lengths along a closed ring whose edges have these lengths."""
    ends = np.concatenate([[0.0], np.cumsum(length)])
    closed = np.vstack([ring, ring[:1]])
    return np.column_stack([np.interp(along % ends[-1], ends, closed[:, k]) for k in range(2)])


def _wall(edge: Floats, drop_px: float) -> str:
    """Outline of a wall under its upper edge (n, 2)."""
    steps = np.diff(np.round(edge, 1), axis=0)
    there = "".join(f"l{x:.1f},{y:.1f}" for x, y in steps.tolist())
    back = "".join(f"l{-x:.1f},{-y:.1f}" for x, y in steps[::-1].tolist())
    return f"M{edge[0, 0]:.1f},{edge[0, 1]:.1f}{there}v{drop_px:.1f}{back}Z"


def _colour(shade: int) -> str:
    mixed = (a + (b - a) * shade / (SHADES - 1) for a, b in zip(DARK, BRIGHT, strict=True))
    return "#" + "".join(f"{round(c):02x}" for c in mixed)
