"""Check `overhang`: how far the metal of each layer reaches out over that of the layer below, beside it and between it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import Check
from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.settings.config import Config

OUTLINE_STEP_MM = 0.25
"""Places along the contours at which an overhang is measured."""

INNER_STEP_MM = 1.0
"""The same along all other beads: of a roof over a hole they tell whether it reaches too far, not how far."""

FIRST_ASKED = 16
"""Places of a layer that are asked first whether they reach out over the one below, those farthest from its beads."""

QUARTER_ROUND = 32
"""Chords of a quarter of a circle: a reach of 6 mm errs by 2 um."""


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
    """Angle from the vertical by which the metal of a layer reaches out over that below, where it is most over its limit.

    A layer may reach out by the width of a bead, since one farther out has nothing under it, and by less where an angle
    is set: an angle is for slopes, and none lets metal begin on nothing. What closes a hole, or joins two posts, reaches out
    from all sides of them: by half of its span.
    """
    width_mm = config.process.bead_width_mm
    heights = nc.layer_heights
    worst, area, row, by_bead = 0.0, 0.0, -1, False
    allowed = math.degrees(
        math.atan2(allowed_reach_mm(config.layer_height_mm, config), config.layer_height_mm)
    )
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
                row = _nearest_row(nc, k, place)
        if laid.places.size:
            below = laid
    text = f"layers reach out by up to {worst:.4g} deg from the vertical over the one below"
    if worst > allowed:
        text += f", {area:.6g} mm2 of them " + ("farther than a bead is wide" if by_bead else "unsupported")
    return Check("overhang", worst <= allowed, worst, allowed, "deg", nc.where(row) if row >= 0 else "", text)


def allowed_reach_mm(rise_mm: float, config: Config) -> float:
    """How far a layer may reach out over the one below: by the angle that is set, and never farther than a bead is wide.

    Examples
    --------
    >>> round(allowed_reach_mm(2.0, Config().changed(process={"largest_overhang_deg": 45.0})), 6)
    2.0
    >>> allowed_reach_mm(2.0, Config().changed(process={"largest_overhang_deg": 89.0}))
    6.0
    """
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
        rings = [_ring(contours.ring(r), closed=bool(contours.closed[r])) for r in contours.rings_of(k)]
        rings = [ring for ring in rings if shapely.is_valid(ring)]
        lines = shapely.MultiLineString([*rings, *_paths(nc, rows[here])])
        places = np.ascontiguousarray(shapely.get_coordinates(lines))
        yield Laid(lines, segments_of(lines), places, contours.section(k))


def _ring(points: Floats, *, closed: bool) -> shapely.LineString:
    return shapely.LineString(np.vstack([points, points[:1]]) if closed else points)


def _paths(nc: NCProgram, rows: Ints) -> np.ndarray[tuple[int], np.dtype[np.object_]]:
    """Return the path of each motion as a line, with its start."""
    line, points = nc.lines(rows, INNER_STEP_MM)
    return np.asarray(shapely.linestrings(points, indices=line), dtype=np.object_)


def _reach(laid: Laid, below: Laid, allowed_mm: float, width_mm: float) -> tuple[float, Floats, float]:
    """Distance of the farthest metal from that below, its place (2,), and the area (mm2) that is farther than allowed.

    Centre lines reach out as far as the metal beside them, or farther: of a bridge's span half a bead stands on either side.
    So metal is made of them only where they reach too far.
    """
    away = distances(laid.places, below.sides)
    k = _first_outside(laid.places, np.argsort(-away, kind="stable"), below.inside)
    # Contours tell what they enclose but where a bead runs round between two of them: what is far from all beads is not over them.
    if (k < 0 or away[k] <= allowed_mm) and away.max() <= max(allowed_mm, 0.5 * width_mm):
        return (float(away[k]), laid.places[k], 0.0) if k >= 0 else (0.0, laid.places[0], 0.0)
    metal, under = laid.metal(width_mm), below.metal(width_mm)
    over = metal.difference(under.buffer(allowed_mm, quad_segs=QUARTER_ROUND))
    # The middle of what is too far is the farthest where metal stands all around it.
    middles = [
        shapely.get_coordinates(shapely.maximum_inscribed_circle(part))[:1]
        for part in shapely.get_parts(over)
        if part.area > 0.0
    ]
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


def _nearest_row(nc: NCProgram, layer: int, place: Floats) -> int:
    rows = np.flatnonzero(nc.deposit & (nc.layer == layer))
    return int(rows[np.nanargmin(np.linalg.norm(nc.end[rows, :2] - place, axis=1))])
