"""Checks that a process engineer asks for: directions of travel, places to keep out of, seams."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import DIRECTION_ROUNDING_DEG, limit_check, worst_check
from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.kernels import Floats, Ints
from ebamcheck.nc.control import control
from ebamcheck.nc.motions import ARC, RAPID, STRAIGHT, NCProgram
from ebamcheck.result import Check
from ebamcheck.settings.config import Config

DIRECTIONS = 17  # Places along a curve at which its direction is looked at
KEEP_OUT_STEP_MM = 0.2  # Chords of curves beside a keep-out zone: at a radius of 5 mm they err by 1 um
OUTLINE_STEP_MM = 0.25  # Places along the contours at which an overhang is measured
INNER_STEP_MM = 1.0  # The same along all other beads: they tell whether a roof reaches too far, not how far
FIRST_ASKED = 16  # Places, farthest from the beads below, that are asked first whether they reach out
QUARTER_ROUND = 32  # Chords of a quarter of a circle: a reach of 6 mm errs by 2 um


def process_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check what the settings of the process ask of the path; what they do not limit is measured all the same."""
    checks = [_seams(nc, config), overhang_check(nc, config)]
    if config.process.travel_sectors_deg:
        rows = np.flatnonzero(nc.deposit & (nc.lengths > 0.0))
        away, sectors_deg = np.zeros(rows.size), config.process.travel_sectors_deg
        for t in np.linspace(0.0, 1.0, DIRECTIONS):
            away = np.maximum(away, outside_sectors(directions(nc, rows, t), sectors_deg))
        what = "degrees outside of the allowed directions of travel"
        checks.append(worst_check("travel sectors", nc, rows, away, DIRECTION_ROUNDING_DEG, "deg", what))
    if config.process.keep_out:
        # Depth to which the edge of a bead enters a zone, and length of a rapid within one. Where its axes may arrive one after the other,
        # it may go anywhere in the box around its ends: what counts is the border of what that has in common with the zone.
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
            outline = shapely.make_valid(shapely.Polygon(zone.outline_mm))
            away = np.asarray(shapely.distance(lines[crosses], outline))
            inside = np.asarray(shapely.length(shapely.intersection(lines[crosses], outline)))
            into = np.where(reach[crosses] > 0.0, np.maximum(reach[crosses] - away, 0.0), inside)
            depth[crosses] = np.maximum(depth[crosses], into)
        names = ", ".join(zone.name for zone in config.process.keep_out)
        checks.append(worst_check("keep-out zones", nc, rows, depth, 0.0, "mm", f"within {names}"))
    return checks


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
    """First motion (n,) of each contour that comes back to its start, and the angle of its seam, from 0 to 180 degrees."""
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0) & ~nc.overlap)
    beads = nc.beads.among(rows)
    first, last = beads.first, beads.last
    closed = (nc.end[last, :2] == nc.start[first, :2]).all(axis=1)
    first, last = first[closed], last[closed]
    turn = directions(nc, first, 0.0) - directions(nc, last, 1.0)
    return first, np.abs((turn + 180.0) % 360.0 - 180.0)


@dataclass(frozen=True)
class Laid:
    """Centre lines of the beads of a layer, as lines, sides (m, 4) and places (n, 2), and what its contours enclose."""

    lines: BaseGeometry
    sides: Floats
    places: Floats
    inside: BaseGeometry

    def metal(self, width_mm: float) -> BaseGeometry:
        """Return what beads of a width cover."""
        return self.lines.buffer(0.5 * width_mm, quad_segs=QUARTER_ROUND, join_style="mitre")


def overhang_check(nc: NCProgram, config: Config) -> Check:
    """Angle from the vertical by which the metal of a layer reaches out over that below, where it is most over its limit. It may
    reach out by the width of a bead, since one farther out has nothing under it, and by less where an angle is set. What closes a
    hole, or joins two posts, reaches out from all sides of them: by half of its span."""
    width_mm = config.process.bead_width_mm
    heights = nc.layer_heights
    worst, area, row, by_bead = 0.0, 0.0, -1, False
    high_mm = config.layer_height_mm
    allowed = math.degrees(math.atan2(allowed_reach_mm(high_mm, config), high_mm))
    below: Laid | None = None
    for k, laid in enumerate(_layers(nc)):
        rise = float(heights[k] - heights[k - 1]) if k else 0.0
        # A height that is not known is not above.
        if rise > 0.0 and below is not None and laid.places.size:
            reach = allowed_reach_mm(rise, config)
            away, place, over = _reach(laid, below, reach, width_mm)
            angle = math.degrees(math.atan2(away, rise))
            within = math.degrees(math.atan2(reach, rise))
            area += over
            if row < 0 or angle / within > worst / allowed:
                worst, allowed, by_bead = angle, within, away > width_mm
                rows = np.flatnonzero(nc.deposit & (nc.layer == k))
                row = int(rows[np.nanargmin(np.linalg.norm(nc.end[rows, :2] - place, axis=1))])
        if laid.places.size:
            below = laid
    text = f"layers reach out by up to {worst:.4g} deg from the vertical over the one below"
    if worst > allowed:
        text += f", {area:.6g} mm2 of them " + ("farther than a bead is wide" if by_bead else "unsupported")
    return limit_check("overhang", worst, allowed, "deg", text, nc.where(row) if row >= 0 else "")


def allowed_reach_mm(rise_mm: float, config: Config) -> float:
    """How far a layer may reach out over the one below: by the angle that is set, and never farther than a bead is wide."""
    limit_deg, width_mm = config.process.largest_overhang_deg, config.process.bead_width_mm
    return width_mm if limit_deg is None else min(rise_mm * math.tan(math.radians(limit_deg)), width_mm)


def _layers(nc: NCProgram) -> Iterator[Laid]:
    """Yield what each layer lays: only one and the one below are asked for at once."""
    contours = nc.contours(OUTLINE_STEP_MM)
    known = np.isfinite(nc.start[:, :2]).all(axis=1) & np.isfinite(nc.end[:, :2]).all(axis=1)
    rows = np.flatnonzero(nc.deposit & (nc.layer >= 0) & known & (nc.lengths > 0.0) & (nc.ring < 0))
    for k in range(len(contours)):
        here = nc.layer[rows] == k
        # Contours as a whole, so that metal has corners where they have; all other beads by motion.
        points = [(contours.ring(r), contours.closed[r]) for r in contours.rings_of(k)]
        rings = [shapely.LineString(np.vstack([at, at[:1]]) if closed else at) for at, closed in points]
        index, at = nc.lines(rows[here], INNER_STEP_MM)
        paths = np.asarray(shapely.linestrings(at, indices=index), object)
        lines = shapely.MultiLineString([*(ring for ring in rings if shapely.is_valid(ring)), *paths])
        places = np.ascontiguousarray(shapely.get_coordinates(lines))
        yield Laid(lines, segments_of(lines), places, contours.section(k))


def _reach(laid: Laid, below: Laid, allowed_mm: float, width_mm: float) -> tuple[float, Floats, float]:
    """Distance of the farthest metal from that below, its place (2,), and the area (mm2) that is farther than allowed."""
    # Centre lines reach out as far as the metal beside them, or farther: of a bridge's span half a bead stands on either side. So metal
    # is made of them only where they reach too far.
    away = distances(laid.places, below.sides)
    k = _first_outside(laid.places, np.argsort(-away, kind="stable"), below.inside)
    # Contours tell what they enclose but where a bead runs round between two of them: what is far from all beads is not over them.
    if (k < 0 or away[k] <= allowed_mm) and away.max() <= max(allowed_mm, 0.5 * width_mm):
        return (float(away[k]), laid.places[k], 0.0) if k >= 0 else (0.0, laid.places[0], 0.0)
    metal, under = laid.metal(width_mm), below.metal(width_mm)
    over = metal.difference(under.buffer(allowed_mm, quad_segs=QUARTER_ROUND))
    # The middle of what is too far is the farthest where metal stands all around it.
    parts = [part for part in shapely.get_parts(over) if part.area > 0.0]
    middles = [shapely.get_coordinates(shapely.maximum_inscribed_circle(part))[:1] for part in parts]
    places = np.ascontiguousarray(np.vstack([shapely.get_coordinates(metal), laid.places, *middles]))
    away = distances(places, segments_of(under.boundary))
    k = _first_outside(places, np.argsort(-away, kind="stable"), under)
    return (float(away[k]), places[k], float(over.area)) if k >= 0 else (0.0, places[0], 0.0)


def _first_outside(places: Floats, order: Ints, region: BaseGeometry) -> int:
    """Return the first of places (n, 2), in their order, that lies outside of a region; -1 where none does."""
    shapely.prepare(region)
    tried = 0
    # Whether a place lies within takes long: a few are asked first.
    while tried < len(order):
        some = order[tried : 2 * tried + FIRST_ASKED]
        outer = some[~np.asarray(shapely.intersects_xy(region, places[some, 0], places[some, 1]))]
        if outer.size:
            return int(outer[0])
        tried += len(some)
    return -1
