"""Islands of metal that touch nothing which stands: no wall, no bead below, and no pool that could bridge to one."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.program.checking.standing import TOUCH_MM
from ebamcheck.program.reading.beads import Beads
from ebamcheck.program.reading.motions import NCProgram

WHOLLY = 0.99
"""Share of a bead's length with nothing under it from which on it has nothing to lie on; the rest is rounding."""

STEP_MM = 0.5
"""Curved beads are looked at as straight parts of at most this length."""


def beads_in_the_air(
    nc: NCProgram, beads: Beads, bare_mm: Floats, below_mm: Floats, width_mm: float
) -> Bools:
    """Find beads (P,) of islands that touch no metal of the layer below, nor anything else that stands.

    The first bead of such an island has nothing under it; the others lie beside it, so that they alone do not show it.

    Parameters
    ----------
    bare_mm
        (B,) length of each motion with nothing under it, of :class:`~ebamcheck.program.checking.standing.Standing`.
    below_mm
        (B,) Z of the layer below that of each motion.
    """
    long = beads.total(np.nan_to_num(nc.lengths[beads.rows]))
    bare = beads.total(bare_mm[beads.rows])
    alone = (long > 0.0) & (bare >= WHOLLY * long)
    layer, top = nc.layer[beads.first], nc.end[beads.first, 2]
    result = np.zeros(len(beads), np.bool_)
    for k in np.unique(layer[alone]).tolist():
        mine = np.flatnonzero(layer == k)
        under = np.flatnonzero(
            (layer != k)
            & (beads.first < beads.first[mine[0]])
            & (top >= below_mm[beads.first[mine[0]]] - TOUCH_MM)
        )
        stands = _metal(nc, beads, under, width_mm)
        for island in shapely.get_parts(_metal(nc, beads, mine, width_mm)):
            # What a first bead lies on may be a clamp, too: an island with a bead that lies on something is none.
            within = mine[shapely.intersects(island, shapely.points(nc.end[beads.first[mine], :2]))]
            if alone[within].any() and not shapely.intersects(island, stands):
                result[within] = True
    return result


def _metal(nc: NCProgram, beads: Beads, which: Ints, width_mm: float) -> BaseGeometry:
    """Ground that beads cover."""
    rows = beads.rows[np.isin(beads.bead, which)]
    if not rows.size:
        return shapely.Polygon()
    row, points = nc.samples(rows, STEP_MM)
    parts = np.split(points, np.flatnonzero(np.diff(row)) + 1)
    starts = nc.start[np.unique(row), :2]
    lines = [np.vstack([start, part]) for start, part in zip(starts, parts, strict=True)]
    known = [shapely.LineString(line) for line in lines if np.isfinite(line).all()]
    return shapely.union_all(shapely.buffer(known, 0.5 * width_mm))
