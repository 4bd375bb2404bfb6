"""Fill the islands of one layer: hatch lines, beads along walls, and beads over what these leave bare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.nearest import segments_of
from ebamcheck.geometry.raster import BareSamples, bare_samples, covered_fraction
from ebamcheck.geometry.regions import valid_polygons
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.scan.filling.hatch import SHORTEST_LINE, Vectors, hatch, joined
from ebamcheck.scan.filling.walls import wall_lines
from ebamcheck.scan.islands import clipping as cells
from ebamcheck.scan.islands.clipping import hatch_directions
from ebamcheck.scan.islands.regions import Regions
from ebamcheck.settings.config import Config

# Share of the spacing by which a hatch line stops before the border of its island: the turn, or the round end of the bead, fills the rest
TRIM = 0.3


@dataclass(frozen=True, eq=False)
class FilledLayer:
    """Islands of one layer and their lines."""

    islands: NDArray[np.object_]  # (I,) polygons, none of which overlap
    kind: NDArray[np.str_]  # (I,)
    lines: Vectors  # sorted by island
    chained: Bools  # (I,) whether the lines of an island follow each other end to start
    covered: float = 1.0  # share of the section that contour beads and lines cover
    widest_gap_mm: float = 0.0  # diameter of the largest circle that they leave bare


def fill_layer(regions: Regions, found: cells.Cells, config: Config, layer: int) -> FilledLayer:
    """Fill the cells of the solids and the walls of a layer, and close the gaps that are left."""
    walls = [*regions.narrow_fills, *regions.bare_walls]
    lines, chained = fill_islands(found, walls, len(regions.narrow_fills), config, layer)
    islands = np.concatenate([found.polygons, cells.column(walls)])
    kind = np.concatenate([found.kind, np.full(len(walls), cells.THIN_WALL)]).astype(np.str_)
    return close_gaps(FilledLayer(islands, kind, lines, chained), regions, config)


def fill_islands(
    found: cells.Cells, walls: Sequence[shapely.Polygon], narrow: int, config: Config, layer: int
) -> tuple[Vectors, Bools]:
    """Lines of all islands, sorted by island, and which islands' lines follow each other.

    The first `narrow` of the walls lie between contour beads, with which their beads meet; the others are bare.
    """
    width, spacing = config.process.bead_width_mm, config.process.hatch_spacing_mm
    turn = config.scan.first_angle_deg + layer * config.scan.layer_angle_deg
    angle = hatch_directions(found, spacing, turn, config.scan.island_angle_deg)
    hatched, _ = hatch(found.polygons, angle, width, spacing)
    count, beads = len(found.polygons), [_trimmed_lines(hatched, TRIM * spacing, 0.5 * width)]
    for number, wall in enumerate(walls, count):
        lines = wall_lines(wall, width, spacing, to_the_end=number < count + narrow)
        if lines:
            start = np.concatenate([line[:-1] for line in lines])
            end = np.concatenate([line[1:] for line in lines])
        else:  # too short or too crooked for a centre line
            straight, _ = hatch(cells.column([wall]), 0.0, width, spacing)
            start, end = straight.start, straight.end
        beads.append(Vectors(np.full(len(start), number, np.int64), start, end))
    chained = np.arange(count + len(walls)) >= count
    columns = zip(*((b.island, b.start, b.end) for b in beads), strict=True)
    return Vectors(*map(np.concatenate, columns)), chained


def _trimmed_lines(lines: Vectors, by_mm: float, shortest_mm: float) -> Vectors:
    """Shorten lines at both ends, but none to under a length, and none that is shorter."""
    way = lines.end - lines.start
    length = np.hypot(way[:, 0], way[:, 1])
    cut_mm = np.clip(0.5 * (length - shortest_mm), 0.0, by_mm)
    share = np.divide(cut_mm, length, out=np.zeros_like(length), where=length > 0.0)[:, None]
    return Vectors(lines.island, lines.start + share * way, lines.end - share * way)


def close_gaps(filled: FilledLayer, regions: Regions, config: Config) -> FilledLayer:
    """Lay gap beads, and measure the coverage."""
    width, section = config.process.bead_width_mm, regions.section
    contour = segments_of(shapely.boundary(regions.contour))
    beads = np.vstack([contour, np.hstack([filled.lines.start, filled.lines.end])])
    bare = bare_samples(section, beads, width)
    spots, asked = bare_spots(section, bare, beads, width), config.scan
    measured = section.area, bare.covered, asked.least_coverage
    chosen, widest_mm = spots_to_close(spots, asked.gap_width * width, *measured)
    if not chosen:
        return replace(filled, covered=bare.covered, widest_gap_mm=widest_mm)
    gaps, island, polygons = gap_beads(chosen, section, filled.islands, width, config.process.hatch_spacing_mm)
    points, of = shapely.get_coordinates(gaps, return_index=True)
    starts = np.flatnonzero(of[:-1] == of[1:])
    lines = joined(filled.lines, Vectors(island[of[starts]], points[starts], points[starts + 1]))
    beads = np.vstack([contour, np.hstack([lines.start, lines.end])])
    return FilledLayer(
        islands=np.concatenate([filled.islands, polygons]),
        kind=np.concatenate([filled.kind, np.full(len(polygons), cells.GAP)]).astype(np.str_),
        lines=lines,
        chained=np.concatenate([filled.chained, np.ones(len(polygons), np.bool_)]),
        covered=covered_fraction(section, beads, width),
        widest_gap_mm=widest_mm,
    )


# Spots under this times the squared bead width are left: a hundredth of a bead's own spot or two
LEAST_SPOT = 0.02
# So are, in sections of small parts, spots under this share of a part of mean area: a tenth of what the gate of the coverage leaves bare
LEAST_SHARE = 0.002
ARC_SEGMENTS = 8  # chords in a quarter of a bead's round end
NO_AREA_MM2 = 1e-6  # pieces smaller than this are rounding


def bare_spots(
    section: BaseGeometry, bare: BareSamples, segments: Floats, bead_width_mm: float
) -> list[shapely.Polygon]:
    """Parts of a section further than half a bead width from every segment (x0, y0, x1, y1), mm, but for those that hold no sample
    or are under :data:`LEAST_SPOT` or :data:`LEAST_SHARE`."""
    parts = np.asarray(valid_polygons(section), object)
    least_mm2 = min(LEAST_SPOT * bead_width_mm**2, LEAST_SHARE * section.area / max(1, parts.size))
    boxes = _boxes(bare, 0.5 * least_mm2)
    if not boxes.size:
        return []
    lines = np.asarray(shapely.linestrings(segments.reshape(-1, 2, 2)), object)
    tree, around = shapely.STRtree(lines), shapely.STRtree(parts)
    spots: list[shapely.Polygon] = []
    for patch in valid_polygons(shapely.union_all(boxes)):
        near = np.sort(tree.query(patch, predicate="dwithin", distance=0.5 * bead_width_mm))
        beads = shapely.buffer(lines[near], 0.5 * bead_width_mm, quad_segs=2 * ARC_SEGMENTS)
        left = shapely.difference(_within(parts, around, patch), shapely.union_all(beads))
        spots += valid_polygons(left)
    return [spot for spot in spots if spot.area >= least_mm2]


def _boxes(bare: BareSamples, least_mm2: float) -> NDArray[np.object_]:
    """Boxes around the patches of bare samples, one sample wider."""
    labels, count = ndimage.label(bare.grid, structure=np.ones((3, 3)))
    if not count:
        return np.zeros(0, object)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    places = zip(ndimage.find_objects(labels), sizes * bare.step_mm**2, strict=True)
    large = [place for place, area_mm2 in places if place is not None and area_mm2 >= least_mm2]
    low = np.array([(x.start - 1, y.start - 1) for y, x in large]).reshape(-1, 2) * bare.step_mm + bare.origin
    high = np.array([(x.stop + 1, y.stop + 1) for y, x in large]).reshape(-1, 2) * bare.step_mm + bare.origin
    return np.asarray(shapely.box(*low.T, *high.T), object)


def spot_widths_mm(spots: Sequence[shapely.Polygon]) -> Floats:
    """Diameter of the largest circle in each spot, (S,)."""
    return np.array([2.0 * shapely.maximum_inscribed_circle(spot).length for spot in spots], np.float64)


def spots_to_close(
    spots: Sequence[shapely.Polygon], width_mm: float, area_mm2: float, covered: float, least: float
) -> tuple[list[shapely.Polygon], float]:
    """Spots that get a bead: those at least `width_mm` wide, then the largest while too little is covered; and the width of the
    widest that stays.

    `area_mm2` is that of the section, `covered` its share that is covered without gap beads, `least` the share that is to be
    covered."""
    widths = spot_widths_mm(spots)
    by_area = np.argsort([-spot.area for spot in spots], kind="stable")
    chosen, left = [], []
    # The samples of the coverage have an error.
    missing_mm2 = (least + 0.002 - covered) * area_mm2
    for k in (*by_area[widths[by_area] >= width_mm], *by_area[widths[by_area] < width_mm]):
        if widths[k] >= width_mm or missing_mm2 > 0.0:
            chosen.append(spots[k])
            missing_mm2 -= spots[k].area
        else:
            left.append(float(widths[k]))
    return chosen, max(left, default=0.0)


def gap_beads(
    spots: Sequence[shapely.Polygon],
    section: BaseGeometry,
    islands: NDArray[np.object_],
    bead_width_mm: float,
    spacing_mm: float,
) -> tuple[NDArray[np.object_], Ints, NDArray[np.object_]]:
    """Lay a bead over each spot, within the section: what lies in an island is driven with it, the rest gets islands that overlap
    no other.

    Centre lines (N,), the island in which each lies (N,): one of those given, or a new one, and the new islands (M,), numbered
    after those given."""
    tree = shapely.STRtree(islands)
    parts = np.asarray(valid_polygons(section), object)
    around = shapely.STRtree(parts)
    shortest_mm = SHORTEST_LINE * bead_width_mm
    held: list[tuple[int, shapely.LineString]] = []
    new: list[shapely.Polygon] = []
    for spot in spots:
        local = shapely.box(*(np.array(spot.bounds) + np.array([-1, -1, 1, 1]) * 2.0 * bead_width_mm))
        region = _within(parts, around, local)
        near = {int(k): islands[k] for k in np.sort(tree.query(local))}
        met = np.flatnonzero(shapely.intersects(local, cells.column(new)))
        near |= {len(islands) + int(k): new[k] for k in met}
        free = shapely.difference(region, shapely.union_all(list(near.values())))
        over = _beads_over(spot, region, free, bead_width_mm, spacing_mm)
        for line in over:
            for k, island in near.items():
                held += [(k, piece) for piece in _pieces(line, island, shortest_mm)]
        beside = [part for line in over for part in _pieces(line, free, shortest_mm)]
        # So near around its bead that two gaps find room side by side.
        for place, lying in _places(beside, free, 0.25 * bead_width_mm):
            held += [(len(islands) + len(new), part) for part in lying]
            new.append(place)
    return (
        cells.column([line for _, line in held]),
        np.array([k for k, _ in held], np.int64),
        cells.column(new),
    )


def _within(parts: NDArray[np.object_], tree: shapely.STRtree, box: shapely.Polygon) -> BaseGeometry:
    """What of the parts of a section, in a tree, lies in a box: at once, a cut costs time with all of them."""
    return shapely.intersection(shapely.MultiPolygon(list(parts[np.sort(tree.query(box))])), box)


def _pieces(line: shapely.LineString, region: BaseGeometry, shortest_mm: float) -> list[shapely.LineString]:
    """Parts of a line in a region that are long enough to be driven, or the most of it."""
    parts = [p for p in shapely.get_parts(shapely.intersection(line, region)) if p.geom_type == "LineString"]
    least_mm = min(shortest_mm, 0.5 * line.length)
    return [p for p in parts if p.length > least_mm]


def _places(
    lines: Sequence[shapely.LineString], free: BaseGeometry, reach_mm: float
) -> list[tuple[shapely.Polygon, list[shapely.LineString]]]:
    """Islands of the gap beads of one spot, and the lines in each: what lies around them and is in no other; lines whose
    surroundings meet share one."""
    around = shapely.union_all(shapely.buffer(cells.column(lines), reach_mm, quad_segs=ARC_SEGMENTS))
    parts = [p for p in valid_polygons(shapely.intersection(around, free)) if p.area > NO_AREA_MM2]
    held: list[list[shapely.LineString]] = [[] for _ in parts]
    for line in lines if parts else ():
        held[int(np.argmax(shapely.length(shapely.intersection(cells.column(parts), line))))].append(line)
    return [(part, inside) for part, inside in zip(parts, held, strict=True) if inside]


def _beads_over(
    spot: shapely.Polygon, region: BaseGeometry, free: BaseGeometry, bead_width_mm: float, spacing_mm: float
) -> list[shapely.LineString]:
    """Lines within a region whose beads cover a spot: as short as they can be, as deep as they can lie."""
    # The rest of half a bead is sagitta of the arcs and tolerance of the machine.
    reach_mm = 0.5 * 0.97 * bead_width_mm
    hull = shapely.get_coordinates(shapely.convex_hull(spot))[:-1]
    # Along the long axis of the spot: the greatest spread of its corners.
    centred = hull - hull.mean(axis=0)
    way = np.linalg.eigh(centred.T @ centred)[1][:, 1]
    way = way if (way[0], way[1]) > (0.0, 0.0) else -way
    # All points from which the whole spot is within reach.
    around = shapely.intersection_all(shapely.buffer(shapely.points(hull), reach_mm, quad_segs=ARC_SEGMENTS))
    for allowed in (free, region):
        here = [p for p in valid_polygons(shapely.intersection(around, allowed)) if p.area > NO_AREA_MM2]
        if here:
            # As much metal as is missing, but no line that is too short to be driven.
            length = max(spot.area / spacing_mm, 2.0 * SHORTEST_LINE * bead_width_mm)
            # The point that lies deepest in the region.
            inner = [p.representative_point() for p in here]
            points = np.vstack([shapely.get_coordinates([*inner, p]) for p in here])
            depth = shapely.distance(shapely.points(points), shapely.boundary(region))
            centre = points[int(np.argmax(depth))]
            line = shapely.LineString([centre - 0.5 * length * way, centre + 0.5 * length * way])
            cut = [p for p in shapely.get_parts(shapely.intersection(line, allowed)) if p.length > 0.0]
            return sorted(cut, key=lambda p: float(p.distance(shapely.Point(centre))))[:1]
    straight = shapely.intersection(_trimmed(hull, way, reach_mm), region)
    left = shapely.difference(spot, shapely.buffer(straight, reach_mm, quad_segs=ARC_SEGMENTS)).area
    pieces = [p for p in shapely.get_parts(straight) if p.length > 0.0]
    # A straight bead may leave 2 % of the spot; else the bead follows the spot's centre line.
    if left <= 0.02 * spot.area and len(pieces) == 1:
        return pieces
    return [shapely.LineString(line) for line in wall_lines(spot, bead_width_mm, spacing_mm)] or pieces


def _trimmed(hull: Floats, way: Floats, reach_mm: float) -> shapely.LineString:
    """Line along a spot's long axis, as short as it can be with every corner within reach of it."""
    middle = 0.5 * (hull.min(axis=0) + hull.max(axis=0))
    along, across = (hull - middle) @ way, (hull - middle) @ np.array([-way[1], way[0]])
    shift = 0.5 * (across.min() + across.max())
    slack = np.sqrt(np.maximum(reach_mm**2 - (across - shift) ** 2, 0.0))
    start, end = float((along + slack).min()), float((along - slack).max())
    middle = middle + shift * np.array([-way[1], way[0]])
    return shapely.LineString([middle + min(start, end) * way, middle + max(start, end) * way])
