"""Limits of the checks of coverage, gaps and metal, each with a figure planted just inside and just outside."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import shapely
from limit_cases import HIGH_MM, Subject, cube, downwards, program_of, upwards

from ebamcheck.layers.stack import from_polygons

METAL = ("layers", "metal")
SPOT_MM3 = 36.0 * HIGH_MM
LAYER_MM3 = 900.0 * HIGH_MM
WIRE_MM2 = math.pi * 0.8**2


def laid_mm3(subject: Subject, layer: int | None = None) -> float:
    """Metal by wire, feed and length."""
    rows = subject.metal if layer is None else subject.of_layer(layer)
    nc = subject.nc
    return float((60.0 * nc.lengths[rows] / nc.feed_mm_min[rows] * nc.wire_mm_s[rows]).sum() * WIRE_MM2)


def with_metal(times: float, layer: int | None = None) -> Subject:
    """So many times the wire, of all or of one layer."""
    rows = cube().metal if layer is None else cube().of_layer(layer)
    return cube().with_columns(rows, wire_mm_s=times * cube().nc.wire_mm_s[rows])


def with_mass(mm3: float, layer: int | None = None) -> Subject:
    """So much metal in all, or in one layer."""
    return with_metal(mm3 / laid_mm3(cube(), layer), layer)


def sections_of(*polygons) -> Subject:
    """The cube against other sections; the last one is that of all further layers."""
    heights = cube().known["plan"].heights
    each = [polygons[min(k, len(polygons) - 1)] for k in range(len(heights))]
    return cube().given(layers=from_polygons(heights, [[polygon] for polygon in each]))


BOX = shapely.box(0, 0, 30, 30)


def bare(f: float) -> Subject:
    """One layer of which so much is bare: two per cent are allowed. Corners of 3 mm are bare in any case."""
    corners = (4.0 - math.pi) * 9.0
    longer = (f * 0.02 * 900.0 - corners) / (30.0 - f * 0.02 * 30.0)
    return sections_of(BOX, shapely.box(0, 0, 30.0 + longer, 30), BOX)


def gap(mm: float, gap_width: float) -> Subject:
    """Two beads apart by so much more than they are wide."""
    beads = [[(0.0, 0.0), (60.0, 0.0)], [(0.0, 6.0 + mm), (60.0, 6.0 + mm)]]
    subject = program_of([beads], shapely.box(-3.0, -3.0, 63.0, 9.0 + mm))
    return subject.by(scan={"gap_width": gap_width})


@cache
def figure(plant, name: str) -> float:
    """Figure of a check, by which a setting is then laid to either side of it."""
    return plant().checks(*METAL)[name].value


def thick_layer() -> Subject:
    return with_metal(1.25, 1)


def aside(mm: float, layers=range(4)) -> Subject:
    """Sections beside the beads: metal is outside, and reaches out."""
    moved = shapely.box(0, 0, 30.0 - mm, 30)
    return sections_of(*[moved if k in layers else BOX for k in range(4)])


def all_aside() -> Subject:
    return aside(2.0)


def one_aside() -> Subject:
    return aside(4.0, (1,))


def outside_of_one(f: float) -> Subject:
    """One layer with metal outside: three times the share of the whole is allowed."""
    return one_aside().by(process={"outside_share": figure(one_aside, "metal outside") / 3.0 / f})


def covered_hole(twelfths: float) -> Subject:
    """A slot of 12 cells beside the cube of which so many are under its metal, which ends with it."""
    left = 30.0 - twelfths
    section = shapely.box(0, 0, 60, 30) - shapely.box(left, 4, left + 12.0, 26)
    return sections_of(section)


@cache
def block() -> Subject:
    """A plate of 60 mm with too much metal, wide enough to have an inside."""
    lines = [((0.0, 4.32 * i), (60.0, 4.32 * i)) for i in range(14)]
    bead = [p for i, (a, b) in enumerate(lines) for p in ((b, a) if i % 2 else (a, b))]
    return program_of([[bead]], shapely.box(-3, -3, 63, 4.32 * 13 + 3))


def inside(f: float) -> Subject:
    """The mean height inside against its tolerance."""
    return block().by(process={"inside_tolerance": figure(block, "height inside") / f})


def zone(name: str, setting: str, f: float, plant) -> Subject:
    return plant().by(process={setting: figure(plant, name) / f})


def in_half_lines(f: float, name: str, width_mm: float) -> Subject:
    """One layer with too much metal: besides the tolerance of all of them, half a line over the width of the zone is allowed."""
    off = figure(thick_layer, name)
    tolerance = off / f - 0.5 * 4.32 / width_mm
    return thick_layer().by(process={"edge_tolerance": tolerance, "inside_tolerance": tolerance})


def small_zone(f: float) -> Subject:
    """Sections whose inside has so many times 25 squared bead widths, with too much metal: of smaller ones no mean is judged."""
    side = 12.0 + 30.0 * math.sqrt(f)
    rows = block().metal
    thick = block().with_columns(rows, wire_mm_s=1.5 * block().nc.wire_mm_s[rows])
    heights = block().known["heights"]
    return thick.given(layers=from_polygons(heights, [[shapely.box(0, 0, side, side)]]))


def uneven_by(f: float, times: float, off_mm: float) -> Subject:
    """A layer with too much or too little wire, whose surface comes to lie so far off."""
    return with_metal(times, 1).by(process={"surface_tolerance_mm": off_mm / f})


def twice(f: float) -> Subject:
    """Metal of all spots so much: half a bead more than all is allowed."""
    return with_metal(f * 1.5 / figure(cube, "metal laid once"))


def pile(f: float) -> Subject:
    """Three times the metal over a length of a bead, of which 18 mm are looked at: half of it more is allowed as a mean.

    Spread over the spots beside it, and over the tracks of cells, as much is found as of a quarter less.
    """
    length = f * 7.4
    bead = [(0.0, 0.0), (50.0, 0.0), (50.0 + length, 0.0), (120.0, 0.0)]
    subject = program_of([[bead]], shapely.box(-20, -20, 140, 20))
    wire = 6.0 * 1.5 * 10.0 / WIRE_MM2
    rows = subject.metal
    assert rows.size == 3
    return subject.with_columns(rows, wire_mm_s=wire * np.array([1.0, 3.0, 1.0]))


# -- wire of single beads --------------------------------------------------------------------------------

BEADS = ("layers", "beads")
LONG = 0.35 * 0.43
"""Wire that a very long contour may lack; a hatch bead may lack 1.2 times as much, and one of L mm (6 mm / L)^2 times that more."""


def most_off(length_mm: float, room: float = 1.0) -> float:
    return room * LONG * (1.0 + (6.0 / length_mm) ** 2)


def laid(layers, section, rings=None, width_mm: float = 4.0) -> Subject:
    """A program whose beads all have the wire that is so wide."""
    subject = program_of(layers, section, rings)
    return subject.with_columns(subject.metal, wire_mm_s=width_mm * 1.5 * 10.0 / WIRE_MM2)


@cache
def lined(
    lines: int = 12, length_mm: float = 90.0, layers: int = 1, apart_mm: float = 4.0, share: float = 1.0
) -> Subject:
    """Lines whose wire fills that share of what lies between them: whole millimetres, so that each has the same cells."""
    beads = [[(0.0, apart_mm * i), (length_mm, apart_mm * i)] for i in range(lines)]
    section = shapely.box(0.0, -0.5 * apart_mm, length_mm, apart_mm * (lines - 0.5))
    return laid([beads] * layers, section, width_mm=share * apart_mm)


def of_a_line(times: float) -> Subject:
    """One line in the middle with so many times its wire."""
    row = lined().metal[6]
    return lined().with_columns(row, wire_mm_s=times * lined().nc.wire_mm_s[row])


@cache
def two_contours() -> Subject:
    """A plate of two contours of 320 and 288 mm, and lines."""
    outer, inner = (np.array([(a, a), (b, a), (b, b), (a, b), (a, a)]) for a, b in ((0.0, 80.0), (4.0, 76.0)))
    beads = [[(6.0, 8.0 + 4.0 * i), (74.0, 8.0 + 4.0 * i)] for i in range(17)]
    return laid([beads], shapely.box(-2, -2, 82, 82), [[outer, inner]])


def thin_contour(f: float) -> Subject:
    """The inner contour lacks wire; least of it is excused along its sides."""
    subject = two_contours()
    rows = np.flatnonzero(subject.nc.deposit & (subject.nc.ring == 1))
    return subject.with_columns(rows, wire_mm_s=(1.0 - f * most_off(68.0)) * subject.nc.wire_mm_s[rows])


def at_least_wire(f: float) -> Subject:
    """A line with far too much wire, which is so much over the least that the machine feeds."""
    subject = of_a_line(1.3)
    wire = subject.nc.wire_mm_s[subject.metal[6]]
    return subject.by(process={"wire_speed_min_mm_s": wire / (1.0 + f * 0.01)})


def heaped(f: float) -> Subject:
    """Lines 9 mm apart, whose metal is 1.442 times as high along them: they lack wire, and metal is too high over their width."""
    share = (1.0 + f * 0.2 - most_off(60.0, 1.2)) / 1.4424
    assert share < 1.0 - most_off(60.0, 1.2)
    return lined(8, 60.0, 1, 9.0, share)


def on_a_heap(layers: int, asked: float, length_mm: float = 40.0) -> Subject:
    """Lines with so much less wire than allowed without a heap, on layers of which one half is 0.15 too high and the other too low."""
    subject = lined(30, length_mm, layers)
    wire = subject.nc.wire_mm_s.copy()
    for k in range(layers - 1):
        rows = subject.of_layer(k)
        wire[rows[:15]] *= 1.15
        wire[rows[15:]] *= 0.85
    wire[subject.of_layer(layers - 1)[:11]] *= (1.0 - asked) * (1.0 - most_off(length_mm, 1.2))
    return subject.with_columns(subject.metal, wire_mm_s=wire[subject.metal])


CASES = (
    upwards("coverage", "scan.least_coverage", bare, "layers", "beads"),
    upwards("gaps", "bead_checks.GAP_MARGIN scan.gap_width", lambda f: gap(f * (0.2 + 0.05) * 6.0, 0.2), "layers", "beads"),
    upwards("gaps", "bead_checks.WIDEST_GAP", lambda f: gap(f * 0.95 * (2.0 * 4.32 - 6.0), 0.9), "layers", "beads"),
    upwards("gaps", "bead_checks.LEAST_GAP_LIMIT", lambda f: gap(f * 0.15 * 6.0, 0.001), "layers", "beads"),
    upwards("metal", "process.mass_tolerance", lambda f: with_mass(4.0 * LAYER_MM3 * (1.0 + f * 0.02)), *METAL),
    upwards("metal", "process.mass_tolerance", lambda f: with_mass(4.0 * LAYER_MM3 * (1.0 - f * 0.02)), *METAL),
    upwards("metal of layers", "process.mass_tolerance", lambda f: with_mass(LAYER_MM3 * (1.0 + f * 0.02) + SPOT_MM3, 1), *METAL),
    upwards("metal of layers", "metal_rules.LEAST_SPOTS", lambda f: with_mass(LAYER_MM3 * (1.0 + 0.02) + f * SPOT_MM3, 1), *METAL),
    upwards("metal of layers", "metal_rules.LEAST_SPOTS", lambda f: with_mass(LAYER_MM3 * (1.0 - 0.02) - f * SPOT_MM3, 1), *METAL),
    upwards("metal outside", "process.outside_share", lambda f: zone("metal outside", "outside_share", f, all_aside), *METAL),
    upwards("metal outside", "metal_rules.LAYER_OUTSIDE", outside_of_one, *METAL),
    upwards("reach of metal", "process.outside_reach_mm", lambda f: zone("reach of metal", "outside_reach_mm", f, all_aside), *METAL),
    upwards("holes", "metal.CLOSED", covered_hole, *METAL, inside=5.0, outside=7.0),
    upwards("height at edges", "process.edge_tolerance", lambda f: zone("height at edges", "edge_tolerance", f, block), *METAL),
    upwards("height inside", "metal_rules.LEAST_ZONE", small_zone, *METAL),
    upwards("height inside", "process.inside_tolerance", lambda f: inside(f), *METAL),
    upwards("height of layers", "metal.HALF_LINE process.edge_tolerance", lambda f: in_half_lines(f, "height of layers", 18.0), *METAL),
    upwards("height of zones", "metal.HALF_LINE metal.WINDOW_BEADS", lambda f: in_half_lines(f, "height of zones", 19.0), *METAL),
    upwards("surface", "process.surface_tolerance_mm", lambda f: uneven_by(f, 1.25, 1.13), *METAL),
    upwards("surface", "process.surface_tolerance_mm", lambda f: uneven_by(f, 0.5, 1.43), *METAL),
    upwards("metal laid once", "metal_rules.MOST_METAL", twice, "layers"),
    upwards("metal laid once", "metal_rules.STRETCH_BEADS", pile, "layers"),
    upwards("wire of beads", "metal_rules.HIGHEST metal_rules.LEVELLED", thin_contour, *BEADS),
    upwards("wire of beads", "metal_rules.HATCH_ROOM", lambda f: of_a_line(1.0 - f * most_off(90.0, 1.2)), *BEADS),
    upwards("wire of beads", "metal.AT_LIMIT process.wire_speed_min_mm_s", at_least_wire, *BEADS),
    downwards("wire of beads", "metal_rules.HEAPED", heaped, *BEADS),
    upwards("wire of beads", "metal.TO_LEVEL", lambda f: on_a_heap(5, f * 0.118), *BEADS),
    upwards("wire of beads", "metal.MOST_TO_LEVEL", lambda f: on_a_heap(12, f * 0.193), *BEADS),
)  # fmt: skip
