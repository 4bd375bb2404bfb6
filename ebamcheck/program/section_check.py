"""Check of the contour path in a program against the sections that a slicer found."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.kernels import run_blocks
from ebamcheck.layers import Layers
from ebamcheck.program.checks import Check, worst_check
from ebamcheck.program.motions import NCProgram
from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.regions import inset, layer_section

STEP_MM = 0.5
"""Distance of the places compared along the path."""


def section_check(
    nc: NCProgram,
    layers: Layers,
    z_of: Floats,
    offset_mm: float,
    limit_mm: float | Floats,
    name: str = "section",
) -> Check:
    """Compare the centre lines of the contour beads with the sections, layer by layer and both ways.

    A place on the path lies as deep in the section as the inset, within `limit_mm`: the depth moves no farther than
    the outline does, where the inset itself, at a sharp corner or in a neck, moves farther. And the path passes every
    place of the inset's border, so that no contour is missing: within `limit_mm`, or where outlines that near to
    each other have insets that lie farther apart, within that.
    A ring of the section narrower than `limit_mm` asks for no contour of its own: it is within the limit of
    not being there, and unions leave slits of no width where shells touch, which an inset would widen to
    holes. A path around one is not faulted either.

    Parameters
    ----------
    z_of
        (L,) Z of each of the `layers` in the program.
    limit_mm
        One for all layers, or (L,) one for each. The check is held against the least of them, and what a layer may have
        beyond that is taken from what is found there.
    """
    limits = np.broadcast_to(np.asarray(limit_mm, dtype=np.float64), len(layers))
    least_mm = float(limits.min()) if len(layers) else float(np.min(limit_mm))
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0))
    between = 0.5 * (z_of[1:] + z_of[:-1])
    index = np.searchsorted(between, nc.end[rows, 2])

    def work(start: int, stop: int) -> list[tuple[int, float]]:
        return [
            _layer(nc, rows[index == k], layers, k, offset_mm, float(limits[k])) for k in range(start, stop)
        ]

    found = [layer for block in run_blocks(work, len(layers)) for layer in block] if len(layers) else []
    worst = np.array([row for row, _ in found], dtype=np.int64)
    text = f"contour path against the {name} inset by {offset_mm:g} mm"
    away = [max(away - (limits[k] - least_mm), 0.0) for k, (_, away) in enumerate(found)]
    if len(layers) and limits.max() > least_mm:
        text += f", up to {limits.max() - least_mm:.4f} mm less where the curves leave it with evidence"
    return worst_check(name, nc, worst, away, least_mm, "mm", text)


def _layer(
    nc: NCProgram, rows: Ints, layers: Layers, k: int, offset_mm: float, limit_mm: float
) -> tuple[int, float]:
    """Worst motion of a layer and its deviation, mm; infinite where one has a contour and the other none."""
    sections, wanted = _sections(layers.polygons(k), offset_mm, limit_mm)
    if not rows.size:
        first = int(np.argmax(nc.layer == min(k, int(nc.layer.max(initial=0)))))
        return first, 0.0 if not len(wanted) else float("inf")
    if not sections:
        return int(rows[0]), float("inf")
    owner, at = nc.samples(rows, STEP_MM)
    away = np.min([np.abs(_depths(at, section) - offset_mm) for section in sections], axis=0)
    missed = _distances(wanted, _path(nc, rows, owner, at))
    far = np.flatnonzero(missed > limit_mm)
    if far.size:
        missed[far] *= limit_mm / np.maximum(_reach(wanted[far], sections[0], offset_mm, limit_mm), limit_mm)
    worst, farthest = int(np.argmax(away)), int(np.argmax(missed)) if missed.size else -1
    if farthest < 0 or missed[farthest] <= away[worst]:
        return int(owner[worst]), float(away[worst])
    nearest = int(np.argmin(np.hypot(*(at - wanted[farthest]).T)))
    return int(owner[nearest]), float(missed[farthest])


def _sections(
    polygons: list[shapely.Polygon], offset_mm: float, narrow_mm: float
) -> tuple[list[BaseGeometry], Floats]:
    """The section, with its narrow rings and without, and the places (n, 2) where the path must pass.

    It may keep the narrow rings or leave them out, and must pass where the border is there either way.
    """
    section = layer_section(polygons)
    places = shapely.get_coordinates(shapely.segmentize(inset(section, offset_mm).boundary, STEP_MM))
    wide = [_without_narrow_holes(p, narrow_mm) for p in polygons if _width_mm(p.exterior) >= narrow_mm]
    if len(wide) == len(polygons) and all(
        len(p.interiors) == len(q.interiors) for p, q in zip(polygons, wide, strict=True)
    ):
        return [s for s in (section,) if not s.is_empty], places
    plain = layer_section(wide)
    both = [s for s in (section, plain) if not s.is_empty]
    border = inset(plain, offset_mm).boundary
    if border.is_empty or not len(places):
        return both, places[:0]
    return both, places[_distances(places, border) <= narrow_mm]


def _depths(at: Floats, region: BaseGeometry) -> Floats:
    """Distance of points (n, 2) from the border of a region, negative outside."""
    shapely.prepare(region)
    away = _distances(at, region.boundary)
    return np.where(shapely.intersects_xy(region, at[:, 0], at[:, 1]), away, -away)


def _reach(places: Floats, section: BaseGeometry, offset_mm: float, limit_mm: float) -> Floats:
    """How far (n,) the insets of outlines within `limit_mm` of a section's may lie from places on its own inset.

    Such an inset holds what is deeper by the limit, and nothing that is shallower by it: its border passes between
    both. Where nothing is that deep, it may be gone.
    """
    points = shapely.points(places)
    deeper, shallower = (inset(section, offset_mm + d) for d in (limit_mm, -limit_mm))
    inwards = np.asarray(shapely.distance(points, deeper))
    outwards = np.asarray(shapely.distance(points, shallower.boundary))
    return np.maximum(np.where(np.isnan(inwards), np.inf, inwards), outwards)


def _without_narrow_holes(polygon: shapely.Polygon, narrow_mm: float) -> shapely.Polygon:
    return shapely.Polygon(polygon.exterior, [h for h in polygon.interiors if _width_mm(h) >= narrow_mm])


def _width_mm(ring: shapely.LinearRing) -> float:
    """Mean width of a long ring: twice its area over its perimeter."""
    return float(2.0 * shapely.Polygon(ring).area / ring.length) if ring.length > 0.0 else 0.0


def _distances(at: Floats, lines: BaseGeometry) -> Floats:
    """Distance of points (n, 2) from lines, by a search tree of their segments."""
    segments = _segments(lines)
    tree = shapely.STRtree(segments)
    _, away = tree.query_nearest(np.asarray(shapely.points(at)), return_distance=True, all_matches=False)
    return np.asarray(away, dtype=np.float64)


def _segments(lines: BaseGeometry) -> NDArray[np.object_]:
    points, line = shapely.get_coordinates(shapely.get_parts(lines), return_index=True)
    joined = np.flatnonzero(line[1:] == line[:-1])
    pairs = np.stack([points[joined], points[joined + 1]], axis=1)
    return np.atleast_1d(np.asarray(shapely.linestrings(pairs), dtype=np.object_))


def _path(nc: NCProgram, rows: Ints, owner: Ints, at: Floats) -> BaseGeometry:
    """Sampled path, one polyline for each ring."""
    lines = []
    for ring in np.unique(nc.ring[rows]):
        first = rows[nc.ring[rows] == ring][0]
        lines.append(shapely.LineString(np.vstack([nc.start[first, :2], at[nc.ring[owner] == ring]])))
    return shapely.MultiLineString(lines)
