"""Checks that a process engineer asks for: directions of travel, places to keep out of, seams."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.checks.checks import Check, worst_check
from ebamcheck.checks.overhang import overhang_check
from ebamcheck.checks.tolerances import DIRECTION_ROUNDING_DEG
from ebamcheck.nc.control import control
from ebamcheck.nc.motions import ARC, RAPID, STRAIGHT, NCProgram
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import KeepOut

DIRECTIONS = 17
"""Places along a curve at which its direction is looked at: ends of spans turn by far less than a quarter."""

KEEP_OUT_STEP_MM = 0.2
"""Chords of curves beside a keep-out zone: at a radius of 5 mm they err by 1 um."""


def process_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check what the settings of the process ask of the path; what they do not limit is measured all the same."""
    checks = [_seams(nc, config), overhang_check(nc, config)]
    if config.process.travel_sectors_deg:
        checks.append(_sectors(nc, config))
    if config.process.keep_out:
        checks.append(_keep_out(nc, config))
    return checks


# -- directions --------------------------------------------------------------------------------------


def _sectors(nc: NCProgram, config: Config) -> Check:
    rows = np.flatnonzero(nc.deposit & (nc.lengths > 0.0))
    away = np.zeros(rows.size)
    for t in np.linspace(0.0, 1.0, DIRECTIONS):
        away = np.maximum(away, outside_sectors(directions(nc, rows, t), config.process.travel_sectors_deg))
    what = "degrees outside of the allowed directions of travel"
    return worst_check("travel sectors", nc, rows, away, DIRECTION_ROUNDING_DEG, "deg", what)


def directions(nc: NCProgram, rows: Ints, t: float) -> Floats:
    """Direction of travel (n,) in degrees counter-clockwise from +X."""
    c = nc.coefficients[rows]
    way = c[:, :, 1] + t * (2.0 * c[:, :, 2] + 3.0 * t * c[:, :, 3])
    chord = (nc.end - nc.start)[rows, :2]
    still = ~(np.hypot(way[:, 0], way[:, 1]) > 1e-9 * nc.lengths[rows])
    way[still] = chord[still]
    arcs = np.flatnonzero(nc.kind[rows] == ARC)
    centre, sweep = nc.arc[rows[arcs], :2], nc.arc[rows[arcs], 2]
    spoke = nc.start[rows[arcs], :2] - centre
    angle = np.arctan2(spoke[:, 1], spoke[:, 0]) + t * sweep + np.copysign(0.5 * math.pi, sweep)
    way[arcs] = np.column_stack([np.cos(angle), np.sin(angle)])
    return np.asarray(np.degrees(np.arctan2(way[:, 1], way[:, 0])))


def outside_sectors(direction_deg: Floats, sectors_deg: tuple[tuple[float, float], ...]) -> Floats:
    """Degrees (n,) by which directions (n,) miss the nearest sector; each goes counter-clockwise."""
    least = np.full(direction_deg.size, np.inf)
    for first, last in sectors_deg:
        width = last - first if last - first >= 360.0 else (last - first) % 360.0
        turn = (direction_deg - first) % 360.0
        least = np.minimum(least, np.where(turn <= width, 0.0, np.minimum(turn - width, 360.0 - turn)))
    return least


# -- places ------------------------------------------------------------------------------------------


def _keep_out(nc: NCProgram, config: Config) -> Check:
    """Depth to which the edge of a bead enters a zone, and length of a rapid within one.

    Where the axes of a rapid may arrive one after the other, it may go anywhere in the box around its ends: what counts is the border
    of what that has in common with the zone.
    """
    rows = np.flatnonzero(np.isfinite(nc.start).all(axis=1) & np.isfinite(nc.end).all(axis=1))
    lines = motion_lines(nc, rows)
    if control(nc.dialect).rapids_apart:
        apart = (nc.kind[rows] == RAPID) & (nc.start[rows, :2] != nc.end[rows, :2]).all(axis=1)
        ends = np.hstack([nc.start[rows[apart], :2], nc.end[rows[apart], :2]])
        lines[apart] = shapely.box(*ends.T)
    # Half a bead melts on either side of its line; a rapid has no width.
    reach = np.where(nc.kind[rows] == RAPID, 0.0, 0.5 * config.process.bead_width_mm)
    depth = np.zeros(rows.size)
    for zone in config.process.keep_out:
        low = np.minimum(nc.start[rows, 2], nc.end[rows, 2])
        high = np.maximum(nc.start[rows, 2], nc.end[rows, 2])
        crosses = np.flatnonzero((low < zone.z_mm[1]) & (high > zone.z_mm[0]))
        depth[crosses] = np.maximum(depth[crosses], _depths(zone, lines[crosses], reach[crosses]))
    names = ", ".join(zone.name for zone in config.process.keep_out)
    return worst_check("keep-out zones", nc, rows, depth, 0.0, "mm", f"within {names}")


def _depths(zone: KeepOut, lines: NDArray[np.object_], reach: Floats) -> Floats:
    outline = shapely.make_valid(shapely.Polygon(zone.outline_mm))
    away = np.asarray(shapely.distance(lines, outline))
    inside = np.asarray(shapely.length(shapely.intersection(lines, outline)))
    return np.asarray(np.where(reach > 0.0, np.maximum(reach - away, 0.0), inside))


def motion_lines(nc: NCProgram, rows: Ints) -> NDArray[np.object_]:
    """Polylines (n,) along motions; curves by chords of :data:`KEEP_OUT_STEP_MM`."""
    straight = (nc.kind[rows] == STRAIGHT) | (nc.kind[rows] == RAPID)
    result = np.empty(rows.size, dtype=np.object_)
    flat = rows[straight]
    result[straight] = shapely.linestrings(np.stack([nc.start[flat, :2], nc.end[flat, :2]], axis=1))
    curved = np.flatnonzero(~straight)
    if curved.size:
        index, points = nc.lines(rows[curved], KEEP_OUT_STEP_MM)
        result[curved] = shapely.linestrings(points, indices=index)
    return result


# -- seams -------------------------------------------------------------------------------------------


def _seams(nc: NCProgram, config: Config) -> Check:
    """Distance of each contour's start from the nearest one in the layer below."""
    least = config.process.least_seam_distance_mm
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0) & (nc.layer >= 0))
    starts = nc.beads.among(rows).first
    layer, at = nc.layer[starts], nc.start[starts, :2]
    worst, where = math.inf, ""
    for k in np.unique(layer).tolist():
        above, below = np.flatnonzero(layer == k), np.flatnonzero(layer == k - 1)
        if below.size:
            away = np.linalg.norm(at[above][:, None] - at[below][None], axis=2).min(axis=1)
            if away.min() < worst:
                worst, where = float(away.min()), nc.where(int(starts[above[np.argmin(away)]]))
    if not where:
        return Check("seams", True, 0.0, least, "mm", "", "no contour starts over another layer's")
    text = f"starts of contours at least {worst:.6g} mm from those of the layer below"
    return Check("seams", worst >= least, worst, least, "mm", where, text)


def seam_turns(nc: NCProgram) -> tuple[Ints, Floats]:
    """Turn of the path at the seam of each closed contour.

    Returns
    -------
    row, turn_deg
        (n,) first motion of each contour that comes back to its start, and the angle (n,) from 0 to 180 degrees between the
        directions in which it arrives there and sets out.
    """
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0) & ~nc.overlap)
    beads = nc.beads.among(rows)
    first, last = beads.first, beads.last
    closed = (nc.end[last, :2] == nc.start[first, :2]).all(axis=1)
    first, last = first[closed], last[closed]
    turn = directions(nc, first, 0.0) - directions(nc, last, 1.0)
    return first, np.abs((turn + 180.0) % 360.0 - 180.0)
