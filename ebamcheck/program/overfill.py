"""Metal that one layer lays in one place, from the text: nothing is laid twice, whatever a comment calls it.

Wire and feed of each motion give its metal; it is summed over the spot of a bead, a square of its width. Where beads
overlap or lie near each other they get less wire, so that every spot has about the metal of the layer; a bead more, or one laid again,
brings a spot that of another bead.
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.config import Config
from ebamcheck.kernels import kernel
from ebamcheck.layers import Layers
from ebamcheck.program.checks import Check
from ebamcheck.program.motions import NCProgram
from ebamcheck.program.roles import Beads, beads_of
from ebamcheck.program.standing import CELLS_PER_BEAD, MOST_CELLS, Columns, columns_of, place_on
from ebamcheck.program.templates import wire_mm2
from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.regions import layer_section

NAME = "metal laid once"

MOST_METAL = 1.6
"""Metal of a spot over that of the layer: half a bead more than all, and what round ends and turns add to a spot."""


def overfill_check(nc: NCProgram, z_of: Floats, config: Config, layers: Layers) -> Check:
    """Most metal that a layer lays in the spot of a bead, over that of the layer.

    Spots count where the section is at least two bead widths wide: contours around less than that lie in each other, and the
    feeder cannot give as little wire as they would need; the metal of such layers is judged as a whole.

    Parameters
    ----------
    z_of
        (L,) Z of each of the `layers`.
    """
    beads = beads_of(nc)
    with np.errstate(divide="ignore", invalid="ignore"):
        mm2 = np.nan_to_num(nc.wire_mm_s * wire_mm2(config) / (nc.feed_mm_min / 60.0), posinf=0.0)
    rows = beads.rows[nc.deposit[beads.rows] & nc.wire[beads.rows] & np.isfinite(nc.start[beads.rows]).all(axis=1)]
    order = rows[np.argsort(nc.layer[rows], kind="stable")]
    edges = np.searchsorted(nc.layer[order], np.arange(z_of.size + 1))
    thickness = np.diff(z_of, prepend=0.0)
    spots = _Spots(nc, order, mm2, config)
    worst, place, layer = 0.0, (math.nan, math.nan), -1
    for k in np.flatnonzero((np.diff(edges) > 0) & (thickness > 0.0)).tolist():
        usual, over = spots.over(order[edges[k] : edges[k + 1]], MOST_METAL * float(thickness[k]))
        if len(over):
            wide = _wide(layers.polygons(k), config.process.bead_width_mm)
            over = over[shapely.intersects_xy(wide, over[:, 1], over[:, 2])]
        most, x, y = over[np.argmax(over[:, 0])] if len(over) else usual
        if most / thickness[k] > worst:
            worst, place, layer = float(most / thickness[k]), (float(x), float(y)), k
    if layer < 0:
        return Check(NAME, True, 0.0, MOST_METAL, "of the layer", "", "no layer lays metal")
    at = f"layer {layer + 1}, at ({place[0]:.1f}, {place[1]:.1f})"
    text = f"a spot gets {worst:.3g} times the metal of its layer: {at}"
    mine = order[edges[layer] : edges[layer + 1]]
    row = int(mine[0])
    if worst > MOST_METAL:
        row = spots.bead_in(mine, beads, MOST_METAL * float(thickness[layer]), place)
    return Check(NAME, worst <= MOST_METAL, worst, MOST_METAL, "of the layer", nc.where(row), text, layer, *place)


def _wide(polygons: list[shapely.Polygon], bead_mm: float) -> BaseGeometry:
    """Where a section is at least two bead widths wide."""
    wide = shapely.buffer(shapely.buffer(layer_section(polygons), -bead_mm), bead_mm)
    shapely.prepare(wide)
    return wide


class _Spots:
    """A grid in which the metal of one layer after the other is summed."""

    def __init__(self, nc: NCProgram, rows: Ints, mm2: Floats, config: Config) -> None:
        self._path, self._rows, self._mm2 = columns_of(nc), rows, mm2
        bead_mm = config.process.bead_width_mm
        points = np.concatenate([nc.start[rows, :2], nc.end[rows, :2], np.zeros((1, 2)) + np.nan])
        low, high = (np.nan_to_num(f(points, axis=0)) for f in (np.fmin.reduce, np.fmax.reduce))
        margin = 2.0 * bead_mm + float(self._path.length[rows].max(initial=0.0)) * 0.5
        size = high - low + 2.0 * margin
        self._cell = max(bead_mm / CELLS_PER_BEAD, math.sqrt(float(size.prod()) / MOST_CELLS))
        self._origin = low - margin
        columns, count = (np.ceil(size / self._cell).astype(np.int64) + 1).tolist()
        self._volume = np.zeros((count, columns))
        self._across = max(1, round(bead_mm / self._cell))

    def over(self, rows: Ints, limit_mm: float) -> tuple[Floats, Floats]:
        """Metal of spots of a layer as a height in mm, x and y of its middle: the most up to a limit, and (n, 3) all over it."""
        self._volume[:] = 0.0
        box = _sum_up(self._path, rows, self._mm2, self._volume, self._origin, self._cell)
        area = (self._across * self._cell) ** 2
        found, count = _spots_over(self._volume, box, self._across, limit_mm * area)
        found = found[: count + 1]
        found[:, 0] /= area
        found[:, 1:] = self._origin + (found[:, 1:] + 0.5 * self._across) * self._cell
        return found[0], found[1:]

    def bead_in(self, rows: Ints, beads: Beads, limit_mm: float, place: tuple[float, float]) -> int:
        """First motion in the spot of the bead that lies in too much metal for most of its length; the last one of several."""
        bead = np.searchsorted(beads.first, rows, side="right") - 1
        self._volume[:] = 0.0
        _sum_up(self._path, rows, self._mm2, self._volume, self._origin, self._cell)
        limit = limit_mm * (self._across * self._cell) ** 2
        too_much = _in_too_much(self._path, rows, self._volume, self._origin, self._cell, self._across, limit)
        length = np.bincount(bead, self._path.length[rows])
        share = np.bincount(bead, too_much) / np.maximum(length, self._cell)
        middle = 0.5 * (self._path.start + self._path.end)[rows, :2]
        near = np.hypot(*(middle - np.array(place)).T)
        if not too_much.any():
            return int(rows[np.argmin(near)])
        best = share.size - 1 - int(np.argmax(share[::-1]))
        mine = np.flatnonzero((bead == best) & (too_much > 0.0))
        return int(rows[mine[0]])


@kernel
def _sum_up(
    path: Columns, rows: Ints, mm2: Floats, volume: Floats, origin: Floats, cell: float
) -> tuple[int, int, int, int]:
    """Add the metal of motions to the cells around them; columns and rows from and to which there is any."""
    low_i, low_j, high_i, high_j = volume.shape[1], volume.shape[0], 0, 0
    for m in rows:
        parts = max(1, int(math.ceil(2.0 * path.length[m] / cell)))
        share = mm2[m] * path.length[m] / parts
        for p in range(parts):
            x, y = place_on(path, m, (p + 0.5) / parts)
            if not (math.isfinite(x) and math.isfinite(y)):
                continue
            u, v = (x - origin[0]) / cell - 0.5, (y - origin[1]) / cell - 0.5
            i, j = int(math.floor(u)), int(math.floor(v))
            if i < 0 or j < 0 or i + 1 >= volume.shape[1] or j + 1 >= volume.shape[0]:
                continue
            a, b = u - i, v - j
            volume[j, i] += share * (1.0 - a) * (1.0 - b)
            volume[j, i + 1] += share * a * (1.0 - b)
            volume[j + 1, i] += share * (1.0 - a) * b
            volume[j + 1, i + 1] += share * a * b
            low_i, low_j = min(low_i, i), min(low_j, j)
            high_i, high_j = max(high_i, i + 2), max(high_j, j + 2)
    return low_i, low_j, high_i, high_j


@kernel
def _spots_over(
    volume: Floats, box: tuple[int, int, int, int], across: int, limit: float
) -> tuple[Floats, int]:
    """Metal, first column and first row of squares of cells: of the fullest up to a limit, and of all over it; their count."""
    low_i, low_j, high_i, high_j = box
    width, height = max(high_i - low_i, 0), max(high_j - low_j, 0)
    found = np.zeros((width * height + 1, 3))
    count = 0
    sums = np.zeros(volume.shape[1])
    for j in range(low_j, high_j):
        for i in range(low_i, high_i):
            sums[i] += volume[j, i]
            if j - across >= low_j:
                sums[i] -= volume[j - across, i]
        total = 0.0
        for i in range(low_i, high_i):
            total += sums[i]
            if i - across >= low_i:
                total -= sums[i - across]
            at = 0
            if total > limit:
                count += 1
                at = count
            elif total <= found[0, 0]:
                continue
            found[at, 0], found[at, 1], found[at, 2] = total, i - across + 1, j - across + 1
    return found, count


@kernel
def _in_too_much(
    path: Columns, rows: Ints, volume: Floats, origin: Floats, cell: float, across: int, limit: float
) -> Floats:
    """Length (n,) of each motion around which the square of cells holds more metal than the limit."""
    result = np.zeros(rows.size)
    for r in range(rows.size):
        m = rows[r]
        parts = max(1, int(math.ceil(path.length[m] / cell)))
        for p in range(parts):
            x, y = place_on(path, m, (p + 0.5) / parts)
            if not (math.isfinite(x) and math.isfinite(y)):
                continue
            i, j = int((x - origin[0]) / cell - 0.5 * across + 0.5), int((y - origin[1]) / cell - 0.5 * across + 0.5)
            total = 0.0
            for v in range(max(j, 0), min(j + across, volume.shape[0])):
                for u in range(max(i, 0), min(i + across, volume.shape[1])):
                    total += volume[v, u]
            if total > limit:
                result[r] += path.length[m] / parts
    return result
