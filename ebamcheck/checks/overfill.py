"""Metal laid twice: whether a layer lays more metal at a place than it takes, from the text alone.

Wire and feed of each motion give its metal. It is spread over the width of a bead and looked at in the spot of a bead, a
square of its width; where beads overlap they get less wire, so that every spot has about the metal of the layer. A bead
more, or one laid again, brings a spot 0.7 times that, where beads lie 0.7 widths apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from scipy import ndimage

from ebamcheck.checks.bead_metal import bead_sections_mm2
from ebamcheck.checks.checks import Check
from ebamcheck.geometry.regions import eroded
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.beads import Beads
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.kernels import run_each
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.settings.config import Config

NAME = "metal laid once"

MOST_METAL = 1.5
"""Metal of a spot over that of the layer: half a bead more than all."""

STRETCH_BEADS = 3.0
"""Bead widths of the stretch of a bead over which the metal is averaged: more than what ends, turns and borders of islands pile
up in one place."""

CELLS = 6
"""Cells across a bead."""


@dataclass(frozen=True)
class _Spot:
    """The fullest spot of a layer: its metal over that of the layer, where it is, and the motion that brings it."""

    metal: float
    layer: int
    x: float
    y: float
    row: int


def overfill_check(nc: NCProgram, z_of: Floats, config: Config, layers: Layers) -> Check:
    """Most metal that a layer lays in the spot of a bead, over that of the layer.

    Spots count where the section is at least two bead widths wide: contours around less than that lie in each other, and the
    feeder cannot give as little wire as they would need; the metal of such layers is judged as a whole.

    Parameters
    ----------
    z_of
        (L,) Z of each of the `layers`.
    """
    beads = nc.beads
    mm2 = np.nan_to_num(bead_sections_mm2(nc, config), posinf=0.0)
    known = np.isfinite(nc.start[beads.rows]).all(axis=1) & nc.deposit[beads.rows] & nc.wire[beads.rows]
    rows = beads.rows[known]
    thickness = np.diff(z_of, prepend=config.base_mm)

    def fullest(k: int) -> _Spot | None:
        mine = rows[nc.layer[rows] == k]
        if not (mine.size and thickness[k] > 0.0):
            return None
        return _fullest(nc, beads, mine, mm2, k, float(thickness[k]), layers, config)

    found = [spot for spot in run_each(fullest, range(z_of.size)) if spot is not None]
    if not found:
        return Check(NAME, True, 0.0, MOST_METAL, "of the layer", "", "no layer lays metal")
    worst = max(found, key=lambda spot: spot.metal)
    text = (
        f"a spot gets {worst.metal:.3g} times the metal of its layer: layer {worst.layer + 1}, "
        f"at ({worst.x:.1f}, {worst.y:.1f})"
    )
    return Check(
        NAME, worst.metal <= MOST_METAL, worst.metal, MOST_METAL, "of the layer", nc.where(worst.row), text,
        worst.layer, worst.x, worst.y,
    )  # fmt: skip


def _fullest(
    nc: NCProgram,
    beads: Beads,
    rows: Ints,
    mm2: Floats,
    k: int,
    thickness_mm: float,
    layers: Layers,
    config: Config,
) -> _Spot:
    bead_mm = config.process.bead_width_mm
    cell = bead_mm / CELLS
    row, at = nc.samples(rows, cell)
    pieces = np.bincount(row, minlength=1)[row]
    volume = mm2[row] * np.nan_to_num(nc.lengths[row]) / pieces
    origin = at.min(axis=0) - 2.0 * bead_mm
    columns, count = (np.ceil((at.max(axis=0) + 2.0 * bead_mm - origin) / cell).astype(np.int64) + 1).tolist()
    place = (at - origin) / cell
    i, j = np.floor(place).astype(np.int64).T
    field = np.bincount(j * columns + i, volume, minlength=count * columns).reshape(count, columns)
    # Once for the width of the bead, and once for the spot.
    for _ in range(2):
        field = ndimage.uniform_filter(field, CELLS, mode="constant")
    metal = field / (cell**2 * thickness_mm)
    wide = shapely.buffer(eroded(layers.section(k), bead_mm), bead_mm)
    shapely.prepare(wide)
    excess = np.where(shapely.intersects_xy(wide, at[:, 0], at[:, 1]), metal[j, i] - 1.0, 0.0)
    along = np.nan_to_num(nc.lengths[row]) / pieces
    mean = _along(beads, row, excess, along, STRETCH_BEADS * bead_mm)
    # Of a bead laid twice the later one is named.
    worst = mean.size - 1 - int(np.argmax(mean[::-1] + 0.0))
    return _Spot(1.0 + float(mean[worst]), k, float(at[worst, 0]), float(at[worst, 1]), int(row[worst]))


def _along(beads: Beads, row: Ints, excess: Floats, along_mm: Floats, stretch_mm: float) -> Floats:
    """Mean excess (n,) of the stretch of a bead that ends at each place; what a short bead lacks of a stretch has none."""
    bead = beads.group[row]
    ends = np.cumsum(along_mm)
    sums = np.concatenate([[0.0], np.cumsum(excess * along_mm)])
    begins = np.searchsorted(bead, bead)
    first = np.maximum(np.searchsorted(ends, ends - stretch_mm, side="right"), begins)
    return np.asarray((sums[1:] - sums[first]) / stretch_mm)
