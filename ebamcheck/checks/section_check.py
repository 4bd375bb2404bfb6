"""Check of the contour path in a program against the sections that a slicer found."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import (
    COLLINEAR_MM,
    SECTION_TOLERANCE_MM,
    SLIT_MM,
    limit_check,
    smooth_tolerance_mm,
)
from ebamcheck.checks.metal import wanted_region
from ebamcheck.checks.subject import Subject
from ebamcheck.curves import LIFTED
from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.geometry.regions import layer_section, valid_polygons
from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.roles import depth_lines, inside, nearest_layer
from ebamcheck.result import Check
from ebamcheck.threads import run_each

STEP_MM = 0.5  # Distance of the places compared along the path
CORNER_RAD = math.radians(40.0)  # Chords that turn by more meet in a corner of the part


@dataclass(frozen=True)
class Evidence:
    """By how much the contour path may leave the chords of a section: `base_mm` anywhere, for fit, rounding and arcs of an inset,
    to `most_mm`. The path may lie between the chords and the `smooth` sections that they stand for; without these, chords allow
    what a curve through their ends leaves them by."""

    base_mm: float
    most_mm: float
    smooth: Layers | None = None


@dataclass(frozen=True)
class _Worst:
    """Worst place of a layer: motion, deviation and its limit, and where it is, mm."""

    row: int
    value: float
    limit: float
    layer: int
    x: float
    y: float
    # In words, where no deviation is meant: `value` is then the length of a path that is missing, or should not be there.
    what: str = ""


def section_checks(subject: Subject) -> list[Check]:
    """Contours against the sections, by chords and with the curves that these stand for; and all beads within them."""
    nc, smooth, z_of, config = subject.nc, subject.smooth, subject.z_of, subject.config
    offset_mm, most_mm = config.contour_offset_mm, config.curves.section_tolerance_mm
    near_mm = smooth_tolerance_mm(config)
    base_mm = SECTION_TOLERANCE_MM if smooth is None else near_mm
    if config.curves.method not in LIFTED:
        # An interpolating spline goes its own way between points, twice: no place tells how far.
        base_mm = most_mm
    evidence = Evidence(base_mm, most_mm, smooth)
    section = section_check(nc, subject.witness, z_of, offset_mm, most_mm, evidence=evidence)
    checks = [section, outside_check(subject)]
    if smooth is not None:
        checks.append(section_check(nc, smooth, z_of, offset_mm, near_mm, "smooth section"))
    return checks


def section_check(
    nc: NCProgram, layers: Layers, z_of: Floats, offset_mm: float, limit_mm: float, name: str = "section",
    evidence: Evidence | None = None,
) -> Check:  # fmt: skip
    """Compare the centre lines of the contour beads with the sections, layer by layer and both ways. A place on the path lies as
    deep in the section as the inset, within its limit; and the path passes every place of the inset's border, so that no contour is
    missing: within `limit_mm`, or within what insets of outlines that near to each other lie apart. A ring narrower than
    `limit_mm`, and a slit narrower than :data:`SLIT_MM`, which unions leave where shells touch, ask for no contour of their own."""
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0))
    index = nearest_layer(nc.end[rows, 2], z_of)
    known = evidence or Evidence(limit_mm, limit_mm)

    found = run_each(lambda k: _layer(nc, rows[index == k], layers, k, offset_mm, limit_mm, known), range(len(layers)))
    text = f"contour path against the {name} inset by {offset_mm:g} mm"
    if not found:
        return Check(name, True, 0.0, limit_mm, "mm", "", f"{text}: nothing to check")
    worst = max(found, key=lambda w: w.value / w.limit)
    where = nc.where(worst.row) if len(nc) else ""
    at = "" if math.isnan(worst.x) else f", in layer {worst.layer + 1} at ({worst.x:.3f}, {worst.y:.3f})"
    if worst.what:
        text += f": {worst.value:.4g} mm {worst.what}{at}"
    else:
        text += f": at most {worst.value:.6g} mm{at}, where {worst.limit:.4g} mm are allowed"
    place = () if math.isnan(worst.x) else (worst.x, worst.y)
    return limit_check(name, worst.value, worst.limit, "mm", text, where, worst.layer, place)


def _layer(
    nc: NCProgram, rows: Ints, layers: Layers, k: int, offset_mm: float, limit_mm: float, known: Evidence
) -> _Worst:
    """Worst place of a layer, without the slits of its section where these alone make it out of tolerance."""
    polygons = layers.polygons(k)
    worst = _compared(nc, rows, polygons, k, offset_mm, limit_mm, known)
    if worst.value <= worst.limit or not polygons:
        return worst
    grown = shapely.buffer(layer_section(polygons), 0.5 * SLIT_MM, join_style="mitre")
    without = valid_polygons(shapely.buffer(grown, -0.5 * SLIT_MM, join_style="mitre"))
    closed = _compared(nc, rows, without, k, offset_mm, limit_mm, known)
    return min(worst, closed, key=lambda w: w.value / w.limit)


def _compared(
    nc: NCProgram, rows: Ints, polygons: list[shapely.Polygon], k: int, offset_mm: float, limit_mm: float,
    known: Evidence,
) -> _Worst:  # fmt: skip
    """Worst place of a layer; where either has a contour and the other none, its length."""
    sections, lines = _sections(polygons, offset_mm, limit_mm)
    wanted = 0.5 * (lines[:, :2] + lines[:, 2:])
    if not sections and rows.size:
        length = float(np.nansum(nc.lengths[rows]))
        x, y = nc.end[rows[0], :2].tolist()
        return _Worst(int(rows[0]), length, limit_mm, k, x, y, "of contour path, and no section")
    owner, at = nc.samples(rows, STEP_MM)
    # Segments (n, 4) of the sampled path, ring by ring, as far as its places are known.
    ways = [np.zeros((0, 4))]
    for ring in np.unique(nc.ring[rows]):
        begin = rows[nc.ring[rows] == ring][0]
        way = np.vstack([nc.start[begin, :2], at[nc.ring[owner] == ring]])
        way = way[np.isfinite(way).all(axis=1)]
        ways.append(np.hstack([way[:-1], way[1:]]))
    path = np.concatenate(ways)
    if not len(path):
        first = int(np.argmax(nc.layer == min(k, int(nc.layer.max(initial=0))))) if len(nc) else 0
        if not len(wanted):
            return _Worst(first, 0.0, limit_mm, k, math.nan, math.nan)
        asked = np.isfinite(_reach(wanted, sections[0], offset_mm, limit_mm))
        length = float(np.hypot(*(lines[asked, 2:] - lines[asked, :2]).T).sum())
        x, y = wanted[np.argmax(asked)].tolist()
        return _Worst(first, length, limit_mm, k, x, y, "of contour asked for, and no contour path")
    off = np.stack([_depths(at, section) - offset_mm for section in sections])
    off = np.take_along_axis(off, np.abs(off).argmin(axis=0)[None], axis=0)[0]
    allowed = _allowed(at, off, sections[0], k, known)
    missed = distances(np.ascontiguousarray(wanted), path)
    far = np.flatnonzero(missed > limit_mm)
    if far.size:
        missed[far] *= limit_mm / np.maximum(_reach(wanted[far], sections[0], offset_mm, limit_mm), limit_mm)
    worst, farthest = int(np.argmax(np.abs(off) / allowed)), int(np.argmax(missed)) if missed.size else -1
    value = float(abs(off[worst]))
    if farthest < 0 or missed[farthest] / limit_mm <= value / allowed[worst]:
        return _Worst(int(owner[worst]), value, float(allowed[worst]), k, *at[worst])
    nearest = int(np.argmin(np.hypot(*(at - wanted[farthest]).T)))
    return _Worst(int(owner[nearest]), float(missed[farthest]), limit_mm, k, *wanted[farthest])


def _allowed(at: Floats, off: Floats, section: BaseGeometry, k: int, known: Evidence) -> Floats:
    """Limit (n,) of the deviation `off` (n,) of each place: what there is evidence for, and no more than the user's."""
    base = min(known.base_mm, known.most_mm)
    allowed = np.full(len(at), base)
    beyond = np.flatnonzero(np.abs(off) > base)
    if not beyond.size or base == known.most_mm:
        return allowed
    smooth = None if known.smooth is None else known.smooth.section(k)
    if smooth is None or smooth.is_empty:
        # By how much a curve through the ends of the nearest chord may leave it, mm.
        # A circle through three neighbouring points turns at the middle one by the angle between its chords, shared between them by their
        # lengths; with angles a and b to it at its ends, a chord of length l lies under its circle by l (a + b) / 16 to l (a + b) / 8 (arc,
        # tangents), and under any curve that stays between the tangents there by up to twice that. Corners turn no curve.
        rings = [r for p in shapely.get_parts(section) for r in (p.exterior, *p.interiors)]
        sides, bounds = [], []
        for ring in rings:
            points = shapely.get_coordinates(shapely.simplify(ring, COLLINEAR_MM))[:-1]
            way = np.roll(points, -1, axis=0) - points
            length = np.hypot(way[:, 0], way[:, 1])
            before = np.roll(way, 1, axis=0)
            across = before[:, 0] * way[:, 1] - before[:, 1] * way[:, 0]
            turn = np.abs(np.arctan2(across, (before * way).sum(axis=1)))
            turn[turn > CORNER_RAD] = 0.0
            share = turn / np.maximum(length + np.roll(length, 1), np.finfo(float).tiny)
            bounds.append(0.25 * length**2 * (share + np.roll(share, -1)))
            sides.append(np.stack([points, np.roll(points, -1, axis=0)], axis=1))
        lines = np.atleast_1d(np.asarray(shapely.linestrings(np.concatenate(sides)), dtype=np.object_))
        places = np.asarray(shapely.points(at[beyond]))
        _, nearest = shapely.STRtree(lines).query_nearest(places, all_matches=False)
        leaves = np.asarray(np.concatenate(bounds)[nearest], np.float64)
    else:
        # A curve that lies outside of its chords makes places less deep in them, and the other way round.
        lift = _depths(at[beyond], section) - _depths(at[beyond], smooth)
        leaves = np.maximum(lift * np.sign(off[beyond]), 0.0)
    allowed[beyond] = np.minimum(base + leaves, known.most_mm)
    return allowed


def _sections(polygons: list[shapely.Polygon], offset_mm: float, narrow_mm: float) -> tuple[list[BaseGeometry], Floats]:
    """The section, with its narrow rings and without, and the lines (n, 4) along which the path must pass."""
    # It may keep the narrow rings or leave them out, and must pass where the border is there either way.
    section = layer_section(polygons)
    lines = depth_lines(section, offset_mm)
    wide = [
        shapely.Polygon(p.exterior, [hole for hole in p.interiors if _width_mm(hole) >= narrow_mm])
        for p in polygons
        if _width_mm(p.exterior) >= narrow_mm
    ]
    if sum(1 + len(p.interiors) for p in polygons) == sum(1 + len(p.interiors) for p in wide):
        return [s for s in (section,) if not s.is_empty], lines
    plain = layer_section(wide)
    both = [s for s in (section, plain) if not s.is_empty]
    either_way = distances(0.5 * (lines[:, :2] + lines[:, 2:]), depth_lines(plain, offset_mm))
    return both, lines[either_way <= narrow_mm]


def _depths(at: Floats, region: BaseGeometry) -> Floats:
    """Distance of points (n, 2) from the border of a region, negative outside."""
    away = distances(np.ascontiguousarray(at), segments_of(region.boundary))
    return np.where(inside(region, at, away), away, -away)


def _reach(places: Floats, section: BaseGeometry, offset_mm: float, limit_mm: float) -> Floats:
    """How far (n,) the insets of outlines within `limit_mm` of a section's may lie from places on its own inset."""
    # Such an inset holds what is deeper by the limit, and nothing that is shallower by it: its border passes between both. Where nothing
    # is that deep, it may be gone.
    inwards = distances(places, depth_lines(section, offset_mm + limit_mm))
    if offset_mm <= limit_mm:
        return np.maximum(inwards, limit_mm)
    return np.maximum(inwards, distances(places, depth_lines(section, offset_mm - limit_mm)))


def _width_mm(ring: shapely.LinearRing) -> float:
    """Mean width of a long ring: twice its area over its perimeter."""
    return float(2.0 * shapely.Polygon(ring).area / ring.length) if ring.length > 0.0 else 0.0


def outside_check(subject: Subject) -> Check:
    """Check all metal, whatever its role: no place of a bead's centre line leaves the part and its allowance by more than contours
    may."""
    nc, layers, config = subject.nc, subject.witness, subject.config
    limit_mm = config.curves.section_tolerance_mm
    known = np.isfinite(nc.start).all(axis=1) & np.isfinite(nc.end).all(axis=1)
    rows = np.flatnonzero((nc.beam | nc.wire) & known)
    layer = nearest_layer(nc.end[rows, 2], subject.z_of)

    def farthest(k: int) -> tuple[float, int, int, float, float] | None:
        owner, at = nc.samples(rows[layer == k], STEP_MM)
        region = wanted_region(layers.section(k), config)
        if region.is_empty:
            return (math.inf, int(owner[0]), k, *at[0]) if owner.size else None
        shapely.prepare(region)
        out = np.flatnonzero(~shapely.intersects_xy(region, at[:, 0], at[:, 1]))
        if not out.size:
            return None
        away = np.asarray(shapely.distance(shapely.points(at[out]), region))
        first = int(np.argmax(away > limit_mm)) if (away > limit_mm).any() else int(np.argmax(away))
        return float(away.max()), int(owner[out[first]]), k, *at[out[first]]

    every = [place for place in run_each(farthest, range(len(layers))) if place is not None]
    if not every:
        good = "every bead lies within the part and its allowance"
        return Check("beads inside", True, 0.0, limit_mm, "mm", "", good)
    wrong = [place for place in every if place[0] > limit_mm]
    away, row, k, x, y = min(wrong, key=lambda place: place[1]) if wrong else max(every)
    how = f"{away:.4g} mm outside of the part" if math.isfinite(away) else "where the part has no section"
    text = f"a bead runs {how}, in layer {k + 1} at ({x:.3f}, {y:.3f})"
    value = max(place[0] for place in every)
    return limit_check("beads inside", value, limit_mm, "mm", text, nc.where(row), k, (x, y))
