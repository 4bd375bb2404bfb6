"""Check of the wire of every bead by the place that it lies at, from the text and the sections alone.

What a place asks for is local: the area of the section that is nearer to it than to any other place of a bead, one layer high, and
by part what levels the surface that is there. Where beads meet or lie side by side, one may lay what the other leaves: wire is wrong
where the place says so by itself, together with all that lies in its pool, and by the height of the metal over the width of the bead.

What counts is the height that the error comes to, over any length of bead. Every pool levels some of it; along the bead it levels an
error that is not much longer than the bead is wide, and hardly any of a long one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from scipy import ndimage
from scipy.spatial import cKDTree

from ebamcheck.checks.bead_metal import bead_sections_mm2, wanted_region
from ebamcheck.checks.checks import Check
from ebamcheck.checks.deposit import STEP_SHARE, metal_places, pool_of, spread
from ebamcheck.heat.melting import width_limits_mm
from ebamcheck.layers.stack import Layers
from ebamcheck.metal import Surface, Target, target_of
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.kernels import run_each
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config

NAME = "wire of beads"

HIGHEST = 0.35
"""Share of a layer to which wrong wire that comes back in every layer may add up."""

LEVELLED = 0.43
"""Share of the height of a single line that its neighbours take when it levels: a Gaussian of half a bead width
(:data:`~ebamcheck.metal.surface.LEVELLED_BEADS`) leaves 0.57 of a line one spacing wide. What comes back in every layer adds up to
one over this."""

MOST = HIGHEST * LEVELLED
"""Wire that a long bead may lack, or have too much of, over what its place asks for. Webs and fins of 3 to 30 mm on a plate, frames, rings,
tapers and meshes, as they are planned, are all within it."""

HATCH_ROOM = 1.2
"""Factor by which a hatch bead may be further off than a contour: it has one wire, and cannot follow its place."""

TO_LEVEL, MOST_TO_LEVEL = 0.3, 0.2
"""Share of what lies too high or too low that a layer levels at most, and share of its height that this may come to. A place asks
for what a layer needs on the surface that is there, but all layers together have the metal of the part: where sections taper,
what their rims lack heaps up inside of them, and no wire levels it. So what is between the layer's height and this is asked for;
how far the surface may heap up is a check of its own (``surface``)."""

HEAPED = 0.2
"""Share of a layer by which metal may lie too high over the width of a hatch bead that lacks wire: along the lines of a hatch it is
higher than between them, and higher still where islands meet."""

SPANS = tuple(0.5 * 2.0 ** (0.5 * k) for k in range(14))
"""Lengths of contour, in bead widths, that are judged, wherever they begin: up to 45 bead widths, where hardly anything is levelled
along the bead. Between two of them limit and error change by less than a tenth."""

AT_LIMIT = 0.01
"""A bead within this of the least or greatest wire cannot have less, or more."""

LEAST_BEADS = 0.1
"""Length of a bead, in bead widths, under which it has hardly a place of its own."""

LEAST_OWN = 0.3
"""Share of the metal over its width that a bead lays itself, at least: half a spacing between two neighbours."""

IN_CELL = (0.7548776662466927, 0.5698402909980532)
"""Steps, in cells, by which the two points that stand for a cell move from cell to cell: the sequence R2 (Roberts 2018), which fills the
square evenly."""

AT_ONCE = 32
"""Layers whose metal is held at a time; they are compared on all threads."""

SUBCELLS = 20
"""Points across a cell by which the strip is laid on cells: its weights err by less than a thousandth."""


@dataclass(frozen=True, eq=False)
class _Asked:
    """What the places (n,) along all beads lay, and what they ask for, in program order.

    The rows of `laid`, `least` and `most` (3, n) are metal by the nearest area, the same with all that lies in the pool, and the
    metal over the width of the bead; `own` (n,) is what the bead lays itself over one bead width.
    """

    row: Ints
    along_mm: Floats
    laid: Floats
    least: Floats
    most: Floats
    own: Floats
    at_limit: Floats
    """(n,) -1 where the bead has the least wire, 1 where it has the most, else 0."""


@dataclass(frozen=True, eq=False)
class _Judged:
    """Spans of beads (m,): first motion, length, and wire over what their places ask for, less 1."""

    row: Ints
    length_mm: Floats
    off: Floats


def bead_wire_check(nc: NCProgram, config: Config, z_of: Floats, layers: Layers) -> Check:
    """Check that every bead has the wire that its place asks for, over any length of it.

    A contour may change its wire along itself, and is judged over every span of :data:`SPANS`; a hatch bead has one wire, and is
    judged as a whole, and where its wire changes.

    Parameters
    ----------
    z_of
        (L,) Z of each of the `layers` in the program.
    """
    if config.base_mm > 0.0:
        text = "what the lowest layer lies on, and so what its beads have to level, is not in the program"
        return Check(NAME, True, 0.0, MOST, "of the wire", "", text)
    found = _asked(nc, config, z_of, layers)
    if not found.row.size:
        return Check(NAME, True, 0.0, MOST, "of the wire", "", "no bead has a place of its own")
    on_contour = nc.ring[found.row] >= 0
    sums, bead_mm = _Sums(found, on_contour), config.process.bead_width_mm
    bead = nc.beads.group[found.row]
    first = np.flatnonzero(np.diff(bead, prepend=-1))
    stop = np.append(first[1:], bead.size)
    judged = [sums.between(first, stop), _changes(nc, config, found, sums, first, stop)]
    end = np.repeat(stop, stop - first)
    contour = np.flatnonzero(on_contour)
    for span in SPANS:
        last = np.minimum(sums.reached(contour, span * bead_mm), end[contour])
        whole = sums.length(contour, last) >= (span - STEP_SHARE) * bead_mm
        judged.append(sums.between(contour[whole], last[whole]))
    spans = _Judged(
        np.concatenate([j.row for j in judged]),
        np.concatenate([j.length_mm for j in judged]),
        np.concatenate([j.off for j in judged]),
    )
    return _worst(nc, spans, bead_mm, first.size)


def most_off(length_mm: Floats, bead_mm: float) -> Floats:
    """Wire that spans (m,) of a bead may lack, or have too much of, over what their places ask for.

    Examples
    --------
    >>> most_off(np.array([6.0, 18.0, 600.0]), 6.0).round(3).tolist()
    [0.301, 0.167, 0.151]
    """
    return np.asarray(
        MOST * (1.0 + (bead_mm / np.maximum(length_mm, LEAST_BEADS * bead_mm)) ** 2), np.float64
    )


class _Sums:
    """Sums of the columns of places from the first on, so that any span is a difference of two."""

    def __init__(self, found: _Asked, contour: Bools) -> None:
        self._row, self._contour = found.row, contour
        self._along = _summed(found.along_mm)
        self._own = _summed(found.own * found.along_mm)
        self._at_limit = _summed(found.at_limit * found.along_mm)
        self._laid, self._least, self._most = (_summed(c) for c in (found.laid, found.least, found.most))

    def reached(self, first: Ints, length_mm: float) -> Ints:
        """Place behind the last one of spans of a length that begin at places `first` (m,)."""
        return np.asarray(np.searchsorted(self._along, self._along[first] + length_mm), np.int64)

    def length(self, first: Ints, stop: Ints) -> Floats:
        """Length (m,) of spans from one place to before another, mm."""
        return np.asarray(self._along[stop] - self._along[first], np.float64)

    def ways(self, first: Ints, stop: Ints) -> tuple[Floats, Floats]:
        """How far spans are over the most, and over the least, that is asked for, by each of three ways, (3, m) both."""
        length = np.maximum(self.length(first, stop), np.finfo(float).tiny)
        own = np.clip((self._own[stop] - self._own[first]) / length, LEAST_OWN, 1.0)
        laid, least, most = (s[:, stop] - s[:, first] for s in (self._laid, self._least, self._most))
        found = []
        for asked in (most, least):
            base = np.vstack([asked[:2], own * length])
            with np.errstate(divide="ignore", invalid="ignore"):
                # A bead that no area is nearest to, or over nothing, has more than any limit.
                found.append(np.where(base > 0.0, (laid - asked) / base, np.where(laid > 0.0, np.inf, 0.0)))
        return found[0], found[1]

    def between(self, first: Ints, stop: Ints) -> _Judged:
        """Spans from one place to before another, (m,): wrong is what all ways say, and the limits of the wire do not excuse."""
        over, under = self.ways(first, stop)
        length = self.length(first, stop)
        limit = (self._at_limit[stop] - self._at_limit[first]) / np.maximum(length, np.finfo(float).tiny)
        under[2] -= np.where(self._contour[first], 0.0, HEAPED)
        high, low = over.min(axis=0), under.max(axis=0)
        off = np.where((high > 0.0) & (limit > -0.5), high, np.where((low < 0.0) & (limit < 0.5), low, 0.0))
        return _Judged(self._row[first], length, off)


def _summed(column: Floats) -> Floats:
    """Sums of a column (..., n) before each place, and of all, (..., n + 1)."""
    return np.concatenate([np.zeros((*column.shape[:-1], 1)), np.cumsum(column, axis=-1)], axis=-1)


def _changes(nc: NCProgram, config: Config, found: _Asked, sums: _Sums, begin: Ints, end: Ints) -> _Judged:
    """Parts of hatch beads, from place `begin` (B,) to `end`, whose metal is not that of the rest of the bead, and not what their places
    ask for: the lesser of both."""
    mm2 = np.nan_to_num(bead_sections_mm2(nc, config), posinf=0.0)[found.row]
    starts = np.zeros(found.row.size, np.bool_)
    starts[begin] = True
    starts[1:] |= ~np.isclose(mm2[1:], mm2[:-1], rtol=AT_LIMIT, atol=0.0)
    first = np.flatnonzero(starts)
    stop = np.append(first[1:], found.row.size)
    bead = np.searchsorted(begin, first, side="right") - 1
    part = (nc.ring[found.row[first]] < 0) & (np.bincount(bead, minlength=begin.size)[bead] > 1)
    first, stop, bead = first[part], stop[part], bead[part]
    metal, length = _summed(mm2 * found.along_mm), sums.length(first, stop)
    rest = sums.length(begin[bead], end[bead]) - length
    usual = (metal[end[bead]] - metal[begin[bead]] - (metal[stop] - metal[first])) / np.maximum(rest, 1e-9)
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.where(usual > 0.0, (metal[stop] - metal[first]) / length / usual - 1.0, 0.0)
    judged = sums.between(first, stop)
    # Metal heaps up where islands meet, whatever wire a bead has: the change has to be as wrong as the place says.
    off = np.where(
        change * judged.off > 0.0, np.copysign(np.minimum(np.abs(change), np.abs(judged.off)), change), 0.0
    )
    return _Judged(judged.row, judged.length_mm, off)


def _worst(nc: NCProgram, spans: _Judged, bead_mm: float, beads: int) -> Check:
    """The span that is furthest over its limit, or nearest to it, as a check."""
    known = np.where(spans.length_mm >= LEAST_BEADS * bead_mm, np.abs(spans.off), 0.0)
    room = np.where(nc.ring[spans.row] >= 0, 1.0, HATCH_ROOM)
    limit = room * most_off(spans.length_mm, bead_mm)
    k = int(np.argmax(known / limit))
    row, most = int(spans.row[k]), float(limit[k])
    said = f"over {spans.length_mm[k]:.3g} mm a bead has {1.0 + spans.off[k]:.3g} times the wire that its place asks for"
    x_mm, y_mm = (float(v) for v in nc.start[row, :2])
    return Check(
        NAME, bool(known[k] <= most), float(known[k]), most, "of the wire", nc.where(row), f"{beads} beads; {said}",
        int(nc.layer[row]), x_mm, y_mm,
    )  # fmt: skip


# -- what places ask for ------------------------------------------------------------------------------


def _asked(nc: NCProgram, config: Config, z_of: Floats, layers: Layers) -> _Asked:
    """What the places of all beads ask for, layer by layer on the surface that is there."""
    process = config.process
    mm2 = np.nan_to_num(bead_sections_mm2(nc, config), posinf=0.0)
    rows = np.flatnonzero(nc.deposit & nc.wire & np.isfinite(nc.start).all(axis=1))
    sections = [wanted_region(layers.section(k), config) for k in range(len(layers))]
    bounds = np.nan_to_num(shapely.total_bounds(sections))
    surface = Surface(np.asarray(bounds, np.float64), process.bead_width_mm)
    step, bead_mm = surface.step_mm, process.bead_width_mm
    pool, strip = pool_of(bead_mm, step), strip_of(bead_mm, step)
    thickness = np.diff(z_of, prepend=config.base_mm)

    def laid_on(k: int) -> _Laid | None:
        """Lay the metal of a layer on the surface."""
        height, mine = float(thickness[k]), rows[nc.layer[rows] == k]
        target = target_of(sections[k], step, 2.0 * bead_mm)
        if not (target.share.size and mine.size and height > 0.0):
            surface.add(target, target.share, height)
            return None
        places, volume, row = metal_places(nc, mine, mm2, bead_mm * STEP_SHARE)
        laid = ndimage.convolve(spread(target, places, volume / height) / step**2, pool, mode="constant")
        wanted = _wanted(target, surface.over_mm(target) / height)
        surface.add(target, laid * height, height)
        return _Laid(target, height, places, volume, row, laid, wanted)

    def asked_by(layer: _Laid) -> _Asked:
        """Compare the metal of a layer with what its places ask for."""
        target, places, row, height = layer.target, layer.places, layer.row, layer.height_mm
        along = nc.lengths[row] / np.bincount(row, minlength=len(nc))[row]
        by_area = np.vstack([layer.volume / height, _nearest_areas(target, places, layer.wanted)])
        by_pool = np.stack([_around(target, places, column, pool) for column in by_area]) * along
        share = np.maximum(_read(target, target.share, places, strip), LEAST_OWN)
        by_strip = np.stack([_read(target, f, places, strip) for f in (layer.laid, *layer.wanted)])
        width = mm2[row] / height
        least, most = width_limits_mm(config, height)
        limit = 1.0 * (width >= most * (1.0 - AT_LIMIT)) - 1.0 * (width <= least * (1.0 + AT_LIMIT))
        ways = np.stack([by_area, by_pool, by_strip / share * along], axis=1)
        return _Asked(row, along, ways[0], ways[1], ways[2], width / bead_mm, limit)

    nothing, no_ways = np.zeros(0), np.zeros((3, 0))
    found = [_Asked(np.zeros(0, np.int64), nothing, no_ways, no_ways, no_ways, nothing, nothing)]
    for first in range(0, len(layers), AT_ONCE):
        laid = [laid_on(k) for k in range(first, min(first + AT_ONCE, len(layers)))]
        found += run_each(asked_by, [layer for layer in laid if layer is not None])
    return _Asked(
        *(np.concatenate([getattr(f, name) for f in found], axis=-1) for name in _Asked.__dataclass_fields__)
    )


class _Laid(NamedTuple):
    """Metal of a layer on its cells, of the places (n,) along its beads, and what the cells ask for (least, most), layers high."""

    target: Target
    height_mm: float
    places: Floats
    volume: Floats
    row: Ints
    laid: Floats
    wanted: tuple[Floats, Floats]


def _wanted(target: Target, over: Floats) -> tuple[Floats, Floats]:
    """Least and most metal, layers high, that the cells of a layer may ask for on a surface that is so many layers too high."""
    # What levels the surface is moved within the layer, whose metal is that of the part.
    mean = float(np.average(over, weights=target.share))
    level = 1.0 - np.clip(TO_LEVEL * (over - mean), -MOST_TO_LEVEL, MOST_TO_LEVEL)
    return target.share * np.minimum(level, 1.0), target.share * np.maximum(level, 1.0)


def _nearest_areas(target: Target, places: Floats, fields: tuple[Floats, Floats]) -> Floats:
    """Sums of fields over the cells that are nearest to each place, mm2, (2, n)."""
    row, column = np.nonzero(target.share)
    # In the middle of its cell each, the points of a row would all fall to the same side of a line that runs along the grid.
    right = column * IN_CELL[0] + row * IN_CELL[1]
    down = column * IN_CELL[1] + row * IN_CELL[0]
    tree, areas = cKDTree(places), np.zeros((2, len(places)))
    for across in (0.0, 0.5):
        x, y = column + (right + across) % 1.0, row + (down + across) % 1.0
        _, near = tree.query(target.origin + np.column_stack([x, y]) * target.step_mm)
        areas += [0.5 * np.bincount(near, f[row, column], minlength=len(places)) for f in fields]
    return np.asarray(areas * target.step_mm**2, np.float64)


def _around(target: Target, places: Floats, values: Floats, pool: Floats) -> Floats:
    """What places (n,) have with all others in their pools, by the weights of these."""
    return _read(target, spread(target, places, values), places, pool)


def _read(target: Target, field: Floats, places: Floats, weights: Floats) -> Floats:
    """Means of a field (rows, columns) around places (n, 2), by weights over the cells; it is 0 beside the grid."""
    around = ndimage.convolve(field, weights, mode="constant")
    at = (places - target.origin) / target.step_mm
    return np.asarray(
        ndimage.map_coordinates(around, (at - 0.5).T[::-1], order=1, mode="constant"), np.float64
    )


def strip_of(bead_mm: float, step_mm: float) -> Floats:
    """Weights of the cells around a place whose mean along a straight bead is that of the strip under it, one bead wide.

    The inverse Abel transform of a strip: 1 / sqrt(R^2 - r^2) has the same integral along every line across its disc. The sum is 1.

    Examples
    --------
    >>> strip_of(6.0, 1.0).sum(axis=0).round(2).tolist()
    [0.0, 0.08, 0.17, 0.17, 0.17, 0.17, 0.17, 0.08, 0.0]
    """
    radius = 0.5 * bead_mm / step_mm
    reach = int(np.ceil(radius + 0.5))
    cells = 2 * reach + 1
    at = (np.arange(cells * SUBCELLS) + 0.5) / SUBCELLS - 0.5 * cells
    deep = radius**2 - (at[:, None] ** 2 + at**2)
    weight = np.where(deep > 0.0, 1.0 / np.sqrt(np.maximum(deep, 1.0 / SUBCELLS**2)), 0.0)
    weight = weight.reshape(cells, SUBCELLS, cells, SUBCELLS).sum(axis=(1, 3))
    return np.asarray(weight / weight.sum(), np.float64)
