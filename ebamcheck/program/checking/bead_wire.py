"""Check of the wire of every bead by the place that it lies at, from the text and the sections alone.

Where beads meet they share the metal of a layer, so that each takes as much wire as is missing under it. What a bead's place
asks for is the metal of the layer there, over what all beads together lay there, as a mean over the bead's footprint. In a
sound program that is nearly one number for all hatch beads, and another for all contours, whose flanks reach over the rim; a
bead with more or less wire than its neighbours leave it, or that ends short of its place, stands out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy import ndimage

from ebamcheck.layers.stack import Layers
from ebamcheck.metal import Surface, target_of
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.program.checking.bead_metal import bead_sections_mm2, wanted_region
from ebamcheck.program.checking.checks import Check
from ebamcheck.program.checking.deposit import STEP_SHARE, metal_places, pool_of, spread
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.program.reading.roles import beads_of
from ebamcheck.program.toolpath.wire import width_limits_mm
from ebamcheck.scan.islands.regions import layer_section
from ebamcheck.settings.config import Config

NAME = "wire of beads"

LEAST_STRETCH = 0.5
"""Length of a stretch, in bead widths, under which the steps beside it make its place."""

MOST_OF_SHORT, MOST_OF_SPOT = 0.35, 1.0
"""The same of a bead that is shorter than it is wide, or than half of that: its place is that of its ends, which others share."""

LAYER_ROOM = 1.25
"""Factor by which a layer as a whole may ask for more or less: what it lays in all has a check of its own (``metal of layers``),
and near the pole of a sphere beads lie where they fit."""

LEVELLING, MOST_LEVELLED = 0.3, 0.2
"""Share of what lies too high or too low that a layer levels at most, and share of its height that this may come to. A place asks
for what a layer needs on the surface that is there, but all layers together have the metal of the part: where sections taper,
what their rims lack heaps up inside of them, and no wire levels it. So what is between the layer's height and this is asked for;
how far the surface may heap up is a check of its own (``surface``)."""

MOST = MOST_LEVELLED
"""Wire that a bead may lack, over what it has, or have too much of, over what its place asks for: what the layer above levels.
Of the beads of sound programs of a blade, a torus, a cube, five small parts and six that taper none is off by more than 0.142;
on a level surface a bead with 0.7 of its wire lacks 0.23 and more, one of 1.3 has 0.17 and more too much."""

MOST_OF_STRETCH = MOST + 0.15
"""The same of a stretch of a bead at one speed of the wire: along a contour that changes where walls get thin, in steps of 15 %."""

AT_LIMIT = 0.01
"""A bead within this of the least or greatest wire cannot have less, or more."""

LEAST_BEADS = 0.1
"""Length of a bead, in bead widths, under which it has hardly a place of its own."""


@dataclass(frozen=True, eq=False)
class _Asked:
    """What the places of one layer's motions ask for: sums over each bead (B,), by the way of their metal."""

    bead: Ints
    """(n,) bead of each place."""
    along_mm: Floats
    """(n,) length of bead that each place stands for."""
    least: Floats
    """(n,) metal that is asked for at least, over what is laid."""
    most: Floats
    """(n,) the same at most."""
    at_limit: Floats
    """(n,) -1 where the bead has the least wire, 1 where it has the most, else 0."""


def bead_wire_check(nc: NCProgram, config: Config, z_of: Floats, layers: Layers) -> Check:
    """Check that every bead has the wire that its place asks for, as others of its kind have.

    Parameters
    ----------
    z_of
        (L,) Z of each of the `layers` in the program.
    """
    if config.base_mm > 0.0:
        text = "what the lowest layer lies on, and so what its beads have to level, is not in the program"
        return Check(NAME, True, 0.0, MOST, "of the wire", "", text)
    beads = beads_of(nc)
    rows, size = beads.rows, len(nc)
    step = np.ones(rows.size, np.bool_)
    step[1:] = (np.diff(beads.bead) != 0) | (np.diff(nc.wire_mm_s[rows]) != 0.0)
    own = np.full(size, -1, np.int64)
    own[rows] = np.cumsum(step) - 1
    found = _asked(nc, config, z_of, layers, own)
    bead_mm = config.process.bead_width_mm
    stretches = _compared(nc, found, rows[step], LEAST_STRETCH * bead_mm, MOST_OF_STRETCH, 0.0)
    of_bead = replace(found, bead=beads.bead[step][found.bead])
    whole = _compared(nc, of_bead, beads.first, LEAST_BEADS * bead_mm, MOST, bead_mm)
    first, off, judged, most = (np.concatenate(both) for both in zip(whole, stretches, strict=True))
    return _worst(nc, first, off, judged, most)


def _compared(
    nc: NCProgram,
    found: _Asked,
    first: Ints,
    least_mm: float,
    most: float,
    short_mm: float,
) -> tuple[Ints, Floats, Bools, Floats]:
    """What the places of beads, or of stretches of them, ask for over what others of their kind do.

    Parameters
    ----------
    first
        (B,) first motion of each.
    least_mm, short_mm
        Length under which one is not judged, and under which :data:`MOST_OF_SHORT` is its limit.
    most
        Limit of what is lacking, and of what is too much.

    Returns
    -------
    tuple
        First motions, what is asked for over the median of the kind, or 1 where its range holds that, whether it is judged, and its limit, (B,) each.
    """
    count = first.size
    bead, weight = found.bead, found.along_mm
    length = np.bincount(bead, weight, minlength=count)
    with np.errstate(divide="ignore", invalid="ignore"):
        least, greatest, limit = (
            np.bincount(bead, weight * asked, minlength=count) / length
            for asked in (found.least, found.most, found.at_limit)
        )
    contour = nc.ring[first] >= 0
    low, high = np.zeros((2, count))
    for mine in ((length >= least_mm) & contour, (length >= least_mm) & ~contour):
        if mine.any():
            usual = float(np.median(0.5 * (least[mine] + greatest[mine])))
            for off, asked in ((low, least), (high, greatest)):
                # Where most of a kind lie over nothing, their place asks for nothing, and the others for more than any limit.
                off[mine] = asked[mine] / usual if usual > 0.0 else np.where(asked[mine] > 0.0, np.inf, 0.0)
    shared = _of_layers(np.clip(1.0, low, high), nc.layer[first])
    off = np.clip(1.0, low / shared, high / shared)
    excused = ((off > 1.0) & (limit > 0.5)) | ((off < 1.0) & (limit < -0.5))
    allowed = np.where(length < short_mm, MOST_OF_SHORT, most)
    allowed = np.where(length < 0.5 * short_mm, MOST_OF_SPOT, allowed)
    return first, off, (off > 0.0) & ~excused, allowed


def _of_layers(off: Floats, layer: Ints) -> Floats:
    """What the layer of each bead asks for as a whole, (B,): what all of its beads ask for at least; 1 where some ask for more and some for less."""
    result = np.ones(off.size)
    known = np.flatnonzero(off > 0.0)
    if known.size:
        number = layer[known] - layer[known].min()
        least, most = np.full(number.max() + 1, np.inf), np.zeros(number.max() + 1)
        np.minimum.at(least, number, off[known])
        np.maximum.at(most, number, off[known])
        shared = np.where(least > 1.0, least, np.where(most < 1.0, most, 1.0))
        result[known] = np.clip(shared, 1.0 / LAYER_ROOM, LAYER_ROOM)[number]
    return result


def _worst(nc: NCProgram, first: Ints, off: Floats, judged: Bools, most: Floats) -> Check:
    """The bead that is furthest over its limit `most` (B,), or nearest to it, as a check; `first` (B,) is the first motion of each."""
    if not judged.any():
        return Check(NAME, True, 0.0, MOST, "of the wire", "", "no bead has a place of its own")
    far = np.where(judged, np.maximum(off, 1.0 / np.where(off > 0.0, off, 1.0)) - 1.0, 0.0)
    k = int(np.argmax(far / most))
    row = int(first[k])
    said = f"a bead has {1.0 / off[k]:.3g} times the wire that its place asks for"
    text = f"{int(judged.sum())} beads and stretches of beads; {said}, compared with the others"
    x_mm, y_mm = (float(v) for v in nc.start[row, :2])
    return Check(
        NAME, bool(far[k] <= most[k]), float(far[k]), float(most[k]), "of the wire", nc.where(row), text,
        int(nc.layer[row]), x_mm, y_mm,
    )  # fmt: skip


def _asked(nc: NCProgram, config: Config, z_of: Floats, layers: Layers, own: Ints) -> _Asked:
    """What the places of all motions ask for, layer by layer on the surface that is there; `own` is the bead of each motion."""
    process = config.process
    mm2 = np.nan_to_num(bead_sections_mm2(nc, config), posinf=0.0)
    rows = np.flatnonzero(nc.deposit & nc.wire & np.isfinite(nc.start).all(axis=1) & (own >= 0))
    sections = [wanted_region(layer_section(layers.polygons(k)), config) for k in range(len(layers))]
    bounds = np.nan_to_num(shapely.total_bounds(sections))
    surface = Surface(np.asarray(bounds, np.float64), process.bead_width_mm)
    step, pool = surface.step_mm, pool_of(process.bead_width_mm, surface.step_mm)
    thickness = np.diff(z_of, prepend=config.base_mm)
    found = [_Asked(np.zeros(0, np.int64), *np.zeros((4, 0)))]
    for k, section in enumerate(sections):
        height = float(thickness[k])
        mine = rows[nc.layer[rows] == k]
        target = target_of(section, step, 2.0 * process.bead_width_mm)
        if not (target.share.size and mine.size and height > 0.0):
            surface.add(target, target.share, height)
            continue
        places, volume, row = metal_places(nc, mine, mm2, process.bead_width_mm * STEP_SHARE)
        laid = ndimage.convolve(spread(target, places, volume) / step**2, pool, mode="constant")
        levelled = LEVELLING * surface.over_mm(target) / height
        surface.add(target, laid, height)
        even = np.divide(target.share * height, laid, out=np.zeros_like(laid), where=laid > 1e-9 * height)
        level = even * (1.0 - np.clip(levelled, -MOST_LEVELLED, MOST_LEVELLED))
        along = nc.lengths[row] / np.bincount(row, minlength=len(nc))[row]
        least_asked, most_asked = (
            _read(ndimage.convolve(over, pool, mode="constant"), (places - target.origin) / step)
            for over in (np.minimum(even, level), np.maximum(even, level))
        )
        least, most = width_limits_mm(config, height)
        width = mm2[row] / height
        limit = 1.0 * (width >= most * (1.0 - AT_LIMIT)) - 1.0 * (width <= least * (1.0 + AT_LIMIT))
        found.append(_Asked(own[row], along, least_asked, most_asked, limit))
    return _Asked(
        np.concatenate([a.bead for a in found]),
        np.concatenate([a.along_mm for a in found]),
        np.concatenate([a.least for a in found]),
        np.concatenate([a.most for a in found]),
        np.concatenate([a.at_limit for a in found]),
    )


def _read(field: Floats, at: Floats) -> Floats:
    """Values (n,) of a field (rows, columns) at places `at` (n, 2), in cells; 0 beside it."""
    return np.asarray(
        ndimage.map_coordinates(field, (at - 0.5).T[::-1], order=1, mode="constant"), np.float64
    )
