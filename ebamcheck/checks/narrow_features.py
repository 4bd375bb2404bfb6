"""Features of the part that are narrower than a bead, found in its sections alone: openings that the melt bridges, and walls.

An opening is what a section lacks and its closing by a disc has; a wall is what the section has and its opening lacks (Serra 1982,
chapter 2). Corners are no features, but where their sides nearly face one another."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.geometry.regions import (
    ARC_SEGMENTS,
    equivalent_rectangles_mm,
    inset,
    mean_width_mm,
    split_thin,
    valid_polygons,
)
from ebamcheck.heat.medium import least_power_share
from ebamcheck.kernels import Floats, Ints
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import least_hole_mm, least_wall_mm, line_energy_j_mm, wire_speed_mm_s
from ebamcheck.threads import run_each

FACING = math.cos(math.radians(40.0))  # Sides face one another under it: a gusset's corner of 45 does not
NO_WIDTH_MM = 1e-5  # Openings narrower than this are the rounding of coordinates
STEPS = 4  # Places on a side over the length of the least width
ON_SIDE = np.array([0.02, 0.5, 0.98])  # Near its ends, where notches are deepest, and in its middle
LONG = 2.0  # Length over width from which on a hole is called a slot
TAPERS = 1.25  # Greatest width over the least from which on both are told
LYING = 2.0  # Height over width up to which something that ends over and under is taken to lie on its side
Kind = Literal["hole", "slot", "gap", "notch", "wall"]
CRUMB = 0.25  # Thin pieces under this times the squared bead width are corners that a round bead never fills


class Place(NamedTuple):
    """A narrow feature in one layer: its widths from side to side and its length, mm, and a point in its narrowest place."""

    kind: Kind
    narrowest_mm: float
    widest_mm: float
    length_mm: float
    x_mm: float
    y_mm: float
    region: BaseGeometry


@dataclass(frozen=True)
class NarrowFeature:
    """A feature over all layers that it goes through, from the `first` to the `last`; length and place are those where it is
    narrowest. It is narrow under `least_mm`: the width that a setting allows (`is_set`), or that of the bead, with what is allowed
    for machining."""

    kind: Kind
    least_mm: float
    is_set: bool
    narrowest_mm: float
    widest_mm: float
    length_mm: float
    layer: int
    x_mm: float
    y_mm: float
    first: int
    last: int

    @property
    def is_wall(self) -> bool:
        """Whether it is metal and not an opening."""
        return self.kind == "wall"

    @property
    def than(self) -> str:
        """What it is narrower than, in words."""
        if self.is_set:
            setting = "process.least_wall_mm" if self.is_wall else "process.least_hole_mm"
            return f"{setting} allows ({self.least_mm:.3g} mm)"
        return f"{'beads can lay' if self.is_wall else 'a bead'} ({self.least_mm:.3g} mm)"

    def in_words(self) -> str:
        """Kind and size.

        >>> NarrowFeature("slot", 6.0, False, 1.0, 1.0, 20.0, 0, 1.0, 2.0, 0, 5).in_words()
        'a slot 1 mm wide and 20 mm long on 6 layers'
        """
        width = f"{self.narrowest_mm:.2g}"
        if self.widest_mm > TAPERS * self.narrowest_mm:
            width += f" to {self.widest_mm:.2g}"
        long = f" and {self.length_mm:.3g} mm long" if self.length_mm > LONG * self.widest_mm else ""
        layers = self.last - self.first + 1
        counted = f"{layers} layers" if layers > 1 else "one layer"
        return f"a {self.kind} {width} mm {'thick' if self.is_wall else 'wide'}{long} on {counted}"


def narrow_features(sections: Sequence[BaseGeometry], config: Config) -> list[NarrowFeature]:
    """Find openings and walls narrower than the least that is set or, where none is, than beads can build; the narrowest first."""
    process = config.process
    beads = config.changed(process={"least_hole_mm": None, "least_wall_mm": None})
    allowance_mm = 2.0 * process.machining_allowance_mm
    found: list[NarrowFeature] = []
    for walls, set_mm, bead_mm in (
        (False, process.least_hole_mm, least_hole_mm(beads)),
        (True, process.least_wall_mm, least_wall_mm(beads)),
    ):
        machined_mm = -allowance_mm if walls else allowance_mm
        if set_mm is not None:
            found += _features(sections, walls, set_mm + machined_mm, True, config)
        if set_mm is None or set_mm < bead_mm:
            others = _features(sections, walls, bead_mm + machined_mm, False, config)
            found += [one for one in others if set_mm is None or one.narrowest_mm >= set_mm + machined_mm]
    # An allowance for machining takes its double from every opening of the part's sections, and adds it to every wall.
    return sorted(found, key=lambda one: (not one.is_set, one.narrowest_mm / one.least_mm))


def _features(
    sections: Sequence[BaseGeometry], walls: bool, least_mm: float, is_set: bool, config: Config
) -> Iterator[NarrowFeature]:
    """Features of one kind that are narrower than a width; layers that are alike are looked at once."""
    if least_mm <= 0.0:
        return
    new = [k == 0 or not shapely.equals_exact(sections[k], sections[k - 1]) for k in range(len(sections))]
    looked_at = [section for section, is_new in zip(sections, new, strict=True) if is_new]
    shallow_mm, high_mm = config.process.outside_reach_mm, config.layer_height_mm
    found = run_each(lambda section: narrow_places(section, walls, least_mm, shallow_mm), looked_at)
    places = [found[k] for k in np.cumsum(new) - 1]
    for group in _through_layers(places, least_mm):
        if not _lies(group, places, sections, walls, least_mm, high_mm):
            layer, at = min(group, key=lambda one: one[1].narrowest_mm)
            widest_mm, layers = max(place.widest_mm for _, place in group), [k for k, _ in group]
            yield NarrowFeature(
                at.kind, least_mm, is_set, at.narrowest_mm, widest_mm, at.length_mm,
                layer, at.x_mm, at.y_mm, min(layers), max(layers),
            )  # fmt: skip


def _lies(
    group: list[tuple[int, Place]], places: list[list[Place]], sections: Sequence[BaseGeometry], walls: bool, least_mm: float,
    high_mm: float,
) -> bool:  # fmt: skip
    """Whether narrow places are floor or roof of something that lies on its side, as a bore does, and that a ball of the least
    width fills."""
    layer, place = min(group, key=lambda one: one[1].narrowest_mm)
    point, radius = place.region.representative_point(), 0.5 * least_mm
    others = np.flatnonzero(shapely.intersects(np.asarray(sections, object), point) != walls)
    low, high = others[others < layer], others[others > layer]
    if not (low.size and high.size):
        return False
    within = range(int(low[-1]) + 1, int(high[0]))
    narrow = {k: [p.narrowest_mm for p in places[k] if p.region.distance(point) <= radius] for k in within}
    if wide := [k for k in within if not narrow[k]]:
        away = [(high_mm * min(abs(k - w) for w in wide), 0.5 * p.narrowest_mm) for k, p in group]
        return all(up <= radius <= math.hypot(half, up + high_mm) for up, half in away)
    # The widest place of a bore lies within half a layer of a cut.
    widest_mm = max(max(widths) for widths in narrow.values())
    return len(within) * high_mm <= LYING * widest_mm and math.hypot(widest_mm, high_mm) >= least_mm


def narrow_places(section: BaseGeometry, walls: bool, least_mm: float, shallow_mm: float) -> list[Place]:
    """Find the walls of a section, or its openings, that are narrower than `least_mm`; notches and tips to `shallow_mm` are uneven
    sides."""
    parts = np.asarray([shapely.orient_polygons(p) for p in valid_polygons(section)], object)
    if not parts.size:
        return []
    # Opening of the section by a disc of the least width for walls, else its closing.
    whole, radius = shapely.MultiPolygon(list(parts)), 0.5 * least_mm
    filled: BaseGeometry = (
        shapely.buffer(inset(whole, radius), radius, quad_segs=ARC_SEGMENTS)
        if walls
        else inset(shapely.buffer(whole, radius, quad_segs=ARC_SEGMENTS), radius)
    )
    shapely.prepare(filled)
    # Of some rings nothing is left: outer ones of parts without a core, or those of holes that are closed.
    rings, part_of = shapely.get_rings(parts, return_index=True)
    gone = walls & ~shapely.intersects(filled, parts)[part_of]
    hole = np.diff(part_of, prepend=-1) == 0
    lost = gone | (hole & (not walls) & shapely.contains(filled, shapely.polygons(rings)))
    # Places on the sides, no more than a step apart, and the direction out of the metal there.
    fine = shapely.segmentize(rings, max(least_mm / STEPS, shallow_mm))
    points, ring = shapely.get_coordinates(fine, return_index=True)
    along = np.diff(points, axis=0)
    length = np.hypot(along[:, 0], along[:, 1])
    side = np.flatnonzero((ring[1:] == ring[:-1]) & (length > 0.0))
    out = np.column_stack([along[side, 1], -along[side, 0]]) / length[side, None]
    out = np.repeat(out, ON_SIDE.size, axis=0)
    at = (points[side, None] + ON_SIDE[:, None] * along[side, None]).reshape(-1, 2)
    owner = np.repeat(ring[side].astype(np.int64), ON_SIDE.size)
    deep = (distances(at, segments_of(filled.boundary)) > shallow_mm) | lost[owner]
    one, other = (whole, filled) if walls else (filled, whole)
    pieces = valid_polygons(shapely.difference(one, other)) if deep.any() else []
    if not pieces:
        return []
    ahead = out[deep] * (-1.0 if walls else 1.0)
    middle, width_mm, start, end = _across(at[deep], ahead, owner[deep], rings, walls, least_mm)
    tree, near, found = shapely.STRtree(pieces), np.zeros(0, np.int64), []
    if len(middle):
        near = tree.query_nearest(shapely.points(middle), all_matches=False)[1]
    closed = set(tree.query(shapely.get_point(rings[lost], 0), "intersects")[1].tolist())
    for k in sorted({*near.tolist(), *closed}):
        mine = np.flatnonzero(near == k)
        kind: Kind = "wall" if walls else "hole" if k in closed else "notch"
        place = _place(pieces[k], kind, middle[mine], width_mm[mine])
        if not walls and mine.size:
            n = mine[width_mm[mine].argmin()]
            a, b = part_of[[start[n], end[n]]]
            place = _between(place, parts[a], parts[b]) if a != b else place
        if place.narrowest_mm >= NO_WIDTH_MM:
            found.append(place)
    return found


def _across(
    at: Floats, ahead: Floats, owner: Ints, rings: np.ndarray, walls: bool, least_mm: float
) -> tuple[Floats, Floats, Ints, Ints]:
    """Ways from places (m, 2) on sides to the nearest side straight `ahead`, if that faces it.
    Their middle (n, 2) and length (n,), mm, and the rings at both ends."""
    points, ring = shapely.get_coordinates(rings, return_index=True)
    joined = np.flatnonzero(ring[1:] == ring[:-1])
    ends = np.stack([points[joined], points[joined + 1]], axis=1)
    ways = shapely.linestrings(np.stack([at, at + 1.001 * least_mm * ahead], axis=1))
    tree = shapely.STRtree(np.asarray(shapely.linestrings(ends), object))
    way, side = tree.query(ways, predicate="intersects")
    a, run = ends[side, 0], ends[side, 1] - ends[side, 0]
    turned = ahead[way, 0] * run[:, 1] - ahead[way, 1] * run[:, 0]
    size = np.hypot(run[:, 0], run[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        length = ((a - at[way])[:, 0] * run[:, 1] - (a - at[way])[:, 1] * run[:, 0]) / turned
    kept = np.flatnonzero(np.isfinite(length) & (length > NO_WIDTH_MM) & (size > 0.0))
    order = kept[np.lexsort((length[kept], way[kept]))]
    order = order[np.flatnonzero(np.diff(way[order], prepend=-1))]
    # A side runs with the metal on its left: over an opening it is met from its right, in a wall from its left.
    faces = np.abs(turned[order]) >= FACING * size[order]
    faces &= (turned[order] < 0.0) != walls
    order = order[faces]
    begin = way[order]
    middle = at[begin] + 0.5 * length[order, None] * ahead[begin]
    return middle, length[order], owner[begin], ring[joined][side[order]].astype(np.int64)


def _place(piece: shapely.Polygon, kind: Kind, middle: Floats, width_mm: Floats) -> Place:
    """Measure a piece by the ways across it; where no sides face one another, such as in a triangle, by its mean width."""
    (mean_mm,), (length_mm,) = equivalent_rectangles_mm([piece])
    if kind == "hole" and width_mm.size and length_mm > LONG * width_mm.max():
        kind = "slot"
    if not width_mm.size:
        inner = piece.representative_point()
        middle, width_mm = np.array([[inner.x, inner.y]]), np.array([mean_mm])
    at = int(width_mm.argmin())
    x_mm, y_mm = middle[at].tolist()
    return Place(kind, float(width_mm[at]), float(width_mm.max()), float(length_mm), x_mm, y_mm, piece)


def _between(place: Place, one: shapely.Polygon, other: shapely.Polygon) -> Place:
    """Narrow place between two parts of a section: a gap, whose narrowest is where they are nearest, if that is in it."""
    place = place._replace(kind="gap")
    nearest = shapely.shortest_line(one, other)
    middle = shapely.centroid(nearest)
    if nearest.length >= place.narrowest_mm or shapely.distance(place.region, middle) > place.widest_mm:
        return place
    return place._replace(narrowest_mm=nearest.length, x_mm=middle.x, y_mm=middle.y)


def _through_layers(places: list[list[Place]], least_mm: float) -> list[list[tuple[int, Place]]]:
    """Places of consecutive layers that lie over each other, within half of the least width, as one."""
    flat = [(k, place) for k, found in enumerate(places) for place in found]
    first = np.cumsum([0, *(len(found) for found in places)])
    pairs: list[tuple[int, int]] = []
    for k in np.flatnonzero(np.diff(first) > 0)[1:].tolist():
        if not places[k - 1]:
            continue
        tree = shapely.STRtree([place.region for place in places[k - 1]])
        here, below = tree.query([place.region for place in places[k]], "dwithin", 0.5 * least_mm)
        pairs += zip((first[k] + here).tolist(), (first[k - 1] + below).tolist(), strict=True)
    one, other = np.array(pairs, np.int64).reshape(-1, 2).T
    links = coo_array((np.ones(one.size), (one, other)), shape=(len(flat), len(flat)))
    count, group = connected_components(links, directed=False) if flat else (0, np.zeros(0, np.int64))
    return [[flat[i] for i in np.flatnonzero(group == g).tolist()] for g in range(count)]


@dataclass(frozen=True)
class NarrowBead:
    """Width, wire, power and current of a bead as wide as a wall, at the travel speed that is set, and the least width of each
    limit by its name."""

    width_mm: float
    wire_mm_s: float
    power_w: float
    current_ma: float
    layer_mm: float
    limits_mm: dict[str, float]

    @property
    def least_mm(self) -> float:
        """Least width within the process window."""
        return max(self.limits_mm.values())

    @property
    def can_be_laid(self) -> bool:
        """Whether the process window allows it."""
        return self.width_mm >= self.least_mm

    def __str__(self) -> str:
        if self.can_be_laid:
            return (
                f"a bead of {self.width_mm:.1f} mm is within the process window ({self.wire_mm_s:.1f} mm/s of wire, "
                f"{self.power_w:.0f} W): set process.bead_width_mm {self.width_mm:.1f}, process.current_ma {self.current_ma:.1f} "
                f"and layers.layer_height_mm {self.layer_mm:.4g}"
            )
        name = max(self.limits_mm, key=lambda key: self.limits_mm[key])
        return f"no bead of this wire, travel speed and layer height is narrower than {self.least_mm:.1f} mm, by {name}"


def thinnest_wall(section: BaseGeometry, bead_width_mm: float) -> tuple[float, float, float] | None:
    """Width of the thinnest piece of a section that no bead fits into, and a point in it, mm; None where beads fit but in
    corners."""
    _, thin = split_thin(section, bead_width_mm, CRUMB * bead_width_mm**2)
    alone = [part for part in valid_polygons(section) if mean_width_mm(part) < bead_width_mm]
    if not (found := [*thin, *alone]):
        return None
    wall = min(found, key=mean_width_mm)
    point: shapely.Point = wall.representative_point()
    return mean_width_mm(wall), point.x, point.y


def narrow_bead(wall_mm: float, thickness_mm: float, config: Config) -> NarrowBead:
    """Bead as wide as a wall."""
    process = config.process
    bead_mm = process.bead_width_mm
    per_mm = wire_speed_mm_s(config, 1.0, thickness_mm)
    energy = line_energy_j_mm(config)
    # Power for the wire goes with the width, power for the pool with its square: under this width the wire wins.
    melting_mm = bead_mm**2 * least_power_share(config, thickness_mm) / process.hatch_spacing_mm
    share = (wall_mm / bead_mm) ** 2
    limits = {
        "process.wire_speed_min_mm_s": process.wire_speed_min_mm_s / per_mm,
        "process.line_energy_j_mm": bead_mm * (process.line_energy_j_mm[0] / energy) ** 0.5,
        "the power that melts the wire (process.melting_efficiency, process.dilution)": melting_mm,
    }
    power_w, current_ma = process.power_w * share, process.current_ma * share
    return NarrowBead(wall_mm, per_mm * wall_mm, power_w, current_ma, thickness_mm, limits)
