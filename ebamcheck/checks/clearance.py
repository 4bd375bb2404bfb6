"""Checks of the tool's path: it clears what stands, the wire does not plunge, and every bead is supported."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import Check
from ebamcheck.checks.standing import Standing, run_over
from ebamcheck.checks.tolerances import PLACE_MM
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.beads import Beads
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config

HOP_SPACINGS = 2.0
"""Bead spacings of a hop: to the line after the next one, over beads that were laid in the same plane just before."""

PLACES = 32
"""Places on each motion without support that are looked at."""

WHOLLY = 0.99
"""Share of a bead's length with nothing under it from which on it has nothing to lie on; the rest is rounding."""

STEP_MM = 0.5
"""Curved beads are looked at as straight parts of at most this length."""


def clearance_checks(
    nc: NCProgram, z_of: Floats, config: Config, layers: Layers | None = None
) -> list[Check]:
    """Run a program over what stands, and check what it meets.

    Parameters
    ----------
    z_of
        (L,) Z of each layer; of none where they are not known: then those of the program count.
    layers
        (L,) sections of the part: where it has metal under a bead, metal has to stand.
    """
    beads = nc.beads
    below = _below(nc, z_of, config.base_mm)
    found = run_over(nc, beads, below, config, HOP_SPACINGS * config.process.hatch_spacing_mm)
    in_air = beads_in_the_air(nc, beads, found.bare_mm, below, config.process.bead_width_mm)
    support = _in_the_air(nc, beads, in_air) or _support(nc, beads, found, config, layers)
    return [_collision(nc, found), _clearance(nc, found, config), support]


def _below(nc: NCProgram, z_of: Floats, base_mm: float) -> Floats:
    """Z (B,) of the layer below that of each motion; what stands for the first one, and 0 outside of layers."""
    tops = z_of if z_of.size else nc.layer_heights
    under = np.concatenate([[base_mm], tops])
    return np.nan_to_num(np.where(nc.layer >= 0, under[np.minimum(nc.layer, tops.size)], 0.0))


def _collision(nc: NCProgram, found: Standing) -> Check:
    """Depth to which tip or head go into what stands, or a travel goes under the beads around it; the first place."""
    depth = np.stack([found.into_mm, found.head_mm, found.under_mm])
    rows = np.flatnonzero(depth.max(axis=0) > 0.0)
    if not rows.size:
        return Check(
            "collision", True, 0.0, 0.0, "mm", "", "tip and head stay clear of plate, clamps and beads"
        )
    row = int(rows[0])
    which = int(np.argmax(depth[:, row]))
    worst = float(depth[which, row])
    what = (
        f"the tip goes {worst:.4g} mm into what stands",
        f"the head goes {worst:.4g} mm into what stands",
        f"the tip goes {worst:.4g} mm under the beads before and after it",
    )[which]
    return Check("collision", False, float(depth.max()), 0.0, "mm", nc.where(row), f"{what}{_more(rows)}")


def _clearance(nc: NCProgram, found: Standing, config: Config) -> Check:
    """What travel lacks of the clearance, where it is longer than a hop or leaves a place that is not known."""
    limit = config.machine.clearance_mm
    rows = np.flatnonzero((found.short_mm > 0.0) | (found.lost > 0.0))
    if not rows.size:
        text = f"travel keeps {limit:g} mm over all that stands, hops keep to the height of the beads"
        return Check("clearance", True, 0.0, 0.0, "mm", "", text)
    row = int(rows[0])
    what = f"travel lacks {found.short_mm[row]:.4g} mm of the clearance of {limit:g} mm"
    if found.lost[row] > 0.0:
        what = (
            "travel from a place or height that no block has given, lower than what stands and the clearance"
        )
    worst = float(np.where(found.lost > 0.0, np.inf, found.short_mm).max())
    return Check("clearance", False, worst, 0.0, "mm", nc.where(row), f"{what}{_more(rows)}")


def _more(rows: Ints) -> str:
    return f" (and {rows.size - 1} more)" if rows.size > 1 else ""


def _in_the_air(nc: NCProgram, beads: Beads, in_air: Bools) -> Check | None:
    """Length of the beads of islands that touch nothing which stands, whatever the part is there; None where there are none."""
    if not in_air.any():
        return None
    rows = beads.rows[in_air[beads.bead]]
    value = float(np.nan_to_num(nc.lengths[rows]).sum())
    row, layers = int(rows[0]), np.unique(nc.layer[rows])
    more = f", on {layers.size} layers" if layers.size > 1 else ""
    text = f"{value:.4g} mm of beads begin in the air{more}: nothing stands under them, nor beside them"
    return Check("support", False, value, 0.0, "mm", nc.where(row), text)


def _support(nc: NCProgram, beads: Beads, found: Standing, config: Config, layers: Layers | None) -> Check:
    """Length of a bead over nothing, where the part has metal below it; over one bead width a pool bridges."""
    limit = config.process.bead_width_mm
    bare = np.flatnonzero(found.bare_mm > 0.0)
    hangs = float(found.bare_mm.sum())
    missing = np.zeros(len(nc))
    if layers is not None and bare.size:
        missing[bare] = found.bare_mm[bare] * _over_metal(nc, bare, found, layers)
        hangs -= float(missing.sum())
    of_bead = beads.total(missing[beads.rows])
    over = np.flatnonzero(of_bead > limit)
    value = float(of_bead.max(initial=0.0))
    text = f"{hangs:.4g} mm of beads overhang with the part"
    if not over.size:
        return Check("support", True, value, limit, "mm", "", f"beads lie on metal; {text}")
    mine = beads.rows[beads.bead == over[0]]
    row = int(mine[np.argmax(missing[mine] > 0.0)])
    what = f"{of_bead[over[0]]:.4g} mm of a bead lie on nothing where the part has metal{_more(over)}"
    return Check("support", False, value, limit, "mm", nc.where(row), f"{what}; {text}")


def _over_metal(nc: NCProgram, rows: Ints, found: Standing, layers: Layers) -> Floats:
    """Share (n,) of what hangs of each motion that lies over the section of the layer below."""
    share = np.zeros(rows.size)
    t = (np.arange(PLACES) + 0.5) / PLACES
    for k in np.unique(nc.layer[rows]).tolist():
        mine = np.flatnonzero(nc.layer[rows] == k)
        section = layers.section(k - 1) if 0 < k <= len(layers) else shapely.Polygon()
        if section.is_empty:
            continue
        row = np.repeat(rows[mine], PLACES)
        along = found.bare_from[row] + np.tile(t, mine.size) * (found.bare_to - found.bare_from)[row]
        at = nc.evaluate(row, along)
        shapely.prepare(section)
        inside = shapely.intersects_xy(section, at[:, 0], at[:, 1])
        share[mine] = inside.reshape(-1, PLACES).mean(axis=1)
    return share


# -- islands in the air ----------------------------------------------------------------------------


def beads_in_the_air(
    nc: NCProgram, beads: Beads, bare_mm: Floats, below_mm: Floats, width_mm: float
) -> Bools:
    """Find beads (P,) of islands that touch no metal of the layer below, nor anything else that stands.

    The first bead of such an island has nothing under it; the others lie beside it, so that they alone do not show it.

    Parameters
    ----------
    bare_mm
        (B,) length of each motion with nothing under it, of :class:`~ebamcheck.checks.standing.Standing`.
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
            & (top >= below_mm[beads.first[mine[0]]] - PLACE_MM)
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
    index, points = nc.lines(rows, STEP_MM)
    lines = np.split(points, np.flatnonzero(np.diff(index)) + 1)
    known = [shapely.LineString(line) for line in lines if np.isfinite(line).all()]
    return shapely.union_all(shapely.buffer(known, 0.5 * width_mm))
