"""Limits of the checks of the path, each with a figure planted just inside and just outside."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import shapely
from limit_cases import HIGH_MM, Subject, cube, downwards, program_of, upwards

from ebamcheck.layers.stack import from_polygons

PLANNED = ("curves", "plan")


def ends_of(subject: Subject, rows, f: float, by_mm: float, axis: int = 1) -> Subject:
    return subject.with_ends(rows, f * by_mm, axis)


def hatch_row(nth: int = 0) -> int:
    """A line of the hatch in the second layer, by the plan."""
    rows = cube().of_layer(1)
    rows = rows[rows > ring_rows()[-1]]
    return int(rows[cube().nc.lengths[rows] > 10.0][nth])


def ring_rows(layer: int = 1) -> np.ndarray:
    rows = cube().of_layer(layer)
    return rows[cube().nc.ring[rows] >= 0]


def moved_ring(by_mm: float) -> Subject:
    """The contour of a layer beside its place: all of its motions, and the way to it."""
    rows = ring_rows()
    rows = np.arange(rows[0] - 1, rows[-1] + 1)
    return cube().with_ends(rows, by_mm, 0)


def open_ring(f: float) -> Subject:
    return ends_of(cube(), ring_rows()[-1], f, 1e-3, 0)


def higher(f: float) -> Subject:
    """A layer at another height."""
    rows = cube().of_layer(2)
    near = np.arange(rows[0], rows[-1] + 1)
    low = near[np.abs(cube().nc.end[near, 2] - 3 * HIGH_MM) < 0.01]
    changed = cube().with_ends(low, f * 1e-3, 2)
    return changed.with_columns((rows[0], 2), start=changed.nc.end[rows[1], 2])


def overlapped(f: float) -> Subject:
    """Contours that do not run on over their start, by settings that ask for it."""
    return cube().by(process={"overlap_mm": f * 0.1})


LINES = [((0.0, 4.32 * i), (30.0, 4.32 * i)) for i in range(5)]


def to_and_fro(lines) -> list[tuple[float, float]]:
    """One bead along lines, each driven against the one before."""
    return [p for i, (a, b) in enumerate(lines) for p in ((b, a) if i % 2 else (a, b))]


def hatched(change) -> Subject:
    """One bead of lines to and fro, with one of them changed."""
    lines = [list(line) for line in LINES]
    change(lines)
    return program_of([[to_and_fro(lines)]])


def skew(f: float) -> Subject:
    """A line whose far end is out of its direction: 1e-3 of its length, and 2 um, are allowed."""

    def change(lines):
        lines[2][1] = (29.99, 4.32 * 2 + f * (1e-3 * 29.99 + 2e-3))

    return hatched(change)


def uneven(f: float) -> Subject:
    """A last line that lies nearer to the one before: by 1e-3 of its length, and 4 um, it may."""

    def change(lines):
        y = 4.32 * 4 - f * (1e-3 * 30.0 + 4e-3)
        lines[4] = [(0.0, y), (30.0, y)]

    return hatched(change)


def turned_back(f: float) -> Subject:
    """A bead that turns back at a sharp angle: 15 degrees are on its own track."""
    angle = math.radians(15.0 * f)
    bead = [(0.0, 0.0), (30.0, 0.0), (30.0 - 25.0 * math.cos(angle), 25.0 * math.sin(angle))]
    return program_of([[bead]])


def two_lines(apart_mm: float) -> Subject:
    return program_of([[[(0.0, 0.0), (30.0, 0.0)], [(0.0, apart_mm), (30.0, apart_mm)]]], shapely.box(-5, -5, 35, 35))


def bead_turn(f: float) -> Subject:
    """Two lines joined by a turn that is as long as 1.5 spacings, and so much longer."""
    aside = math.sqrt((f * 1.5 * 4.32) ** 2 - 4.32**2)
    return program_of([[to_and_fro([((0.0, 0.0), (30.0, 0.0)), ((0.0, 4.32), (30.0 - aside, 4.32))])]])


def sector(f: float) -> Subject:
    """A bead whose direction is so far out of the only sector, but for 0.01 degrees."""
    angle = math.radians(10.0 + f * 0.01)
    subject = program_of([[[(0.0, 0.0), (100.0 * math.cos(angle), 100.0 * math.sin(angle))]]], machine={"decimals": 6})
    return subject.by(process={"travel_sectors_deg": ((-10.0, 10.0),)})


def clamp(away_mm: float, z_mm=(0.0, 5.0)) -> dict:
    return {"outline_mm": ((0, away_mm), (30, away_mm), (30, away_mm + 20), (0, away_mm + 20)), "z_mm": z_mm}


def one_line(**process) -> Subject:
    return program_of([[[(0.0, 0.0), (30.0, 0.0)]]]).by(process=process)


SQUARE = np.array([(0, 0), (40, 0), (40, 40), (0, 40), (0, 0)], float)


def seams(f: float) -> Subject:
    subject = program_of([[], []], rings=[[SQUARE], [np.add(SQUARE, (4.0, 0.0))]])
    return subject.by(process={"least_seam_distance_mm": 4.0 * f})


def reaching(by_mm: float, **process) -> Subject:
    """A layer that reaches out over the one below."""
    wider = SQUARE + np.where(SQUARE > 20, by_mm, 0.0) * (1, 0)
    return program_of([[], []], rings=[[SQUARE], [wider]]).by(process=process)


def over_a_gap(f: float) -> Subject:
    """A bead over nothing for six millimetres: metal reaches three beyond the ends below, and carries two or three beyond that."""
    gap = 10.0 + f * 6.0
    low = [[(0.0, 0.0), (50.0, 0.0)], [(50.0 + gap, 0.0), (120.0, 0.0)]]
    return program_of([low, [[(0.0, 0.0), (120.0, 0.0)]]], shapely.box(-3, -3, 123, 3))


def on_a_clamp(f: float) -> Subject:
    """A bead of a kilometre's thousandth that lies on a clamp at its end, and otherwise on nothing."""
    lies_mm = f * 10.0
    outline = ((-20.0, -20.0), (lies_mm - 3.5, -20.0), (lies_mm - 3.5, 20.0), (-20.0, 20.0))
    low = [[(0.0, 60.0), (1000.0, 60.0)]]
    subject = program_of([low, [[(0.0, 0.0), (1000.0, 0.0)]]], process={"interpass": "off"})
    return subject.by(
        process={"keep_out": ({"outline_mm": outline, "z_mm": (0.0, 1.5)},)},
        machine={"travel_max_mm": (1500.0, 1000.0, 1500.0)},
    )


def lower_bead(f: float) -> Subject:
    """The second of two beads side by side, under the first: the tip goes into that."""
    subject = two_lines(2.5)
    row = int(subject.metal[-1])
    return subject.with_columns((row, 2), start=1.5 - f * 1e-3, end=1.5 - f * 1e-3)


def head(f: float) -> Subject:
    """A clamp higher than the head, which is 20 mm wide to each side: so far away."""
    return one_line(keep_out=(clamp(f * 20.0, (0.0, 40.0)),))


def travelling(z_mm: float, to: tuple[float, float]) -> Subject:
    """A travel at a height, from the end of one bead to another."""
    subject = program_of([[[(0.0, 0.0), (30.0, 0.0)], [to, (to[0] - 50.0, to[1])]]])
    nc = subject.nc
    first, last = (int(row) for row in subject.metal)
    way = np.arange(first + 1, last)
    start, end = nc.start.copy(), nc.end.copy()
    end[way, 2], start[way[1:], 2] = z_mm, z_mm
    end[way[-1], 2] = 1.5
    across = way[np.hypot(*(end - start)[way, :2].T) > 0.0]
    assert across.size == 1
    return replace(subject, nc=replace(nc, start=start, end=end))


def with_chords(f: float) -> Subject:
    """A contour written in lines may leave its curve by `machine.line_tolerance_mm`, and a micrometre."""
    return moved_ring(f * (0.01 + 1e-3)).by(machine={"curve_form": "lines"})


def beside(f: float, by_mm: float, **more) -> Subject:
    return moved_ring(f * by_mm).given(**more)


def out_of_the_part(f: float) -> Subject:
    """A bead whose end lies outside of the part."""
    row = hatch_row()
    far = 30.0 + f * 0.25 - cube().nc.end[row, 0]
    return cube().with_ends(row, far, 0)


def polygon(f: float) -> Subject:
    """A contour along a circle, against chords of it that turn by so many degrees: those over 40 are corners."""
    sides = {True: 11, False: 7}[f < 1.0]
    radius, inset = 0.16 / (1.0 - math.cos(math.pi / sides)), 1.0
    around = np.linspace(0.0, 2.0 * math.pi, 721)
    ring = (radius - inset) * np.column_stack([np.cos(around), np.sin(around)])
    corners = np.linspace(0.0, 2.0 * math.pi, sides, endpoint=False)
    section = shapely.Polygon(radius * np.column_stack([np.cos(corners), np.sin(corners)]))
    return program_of([[]], section, rings=[[ring]]).by(scan={"contour_offset_mm": inset})


# -- ends of beads -------------------------------------------------------------------------------------

ENDS = ("layers", "beads")


def across(x_mm: float, low_mm: float = -20.0, high_mm: float = 20.0) -> list[tuple[float, float]]:
    """A line across the ends of others."""
    return [(x_mm, low_mm), (x_mm, high_mm)]


def ending_before(gap_mm: float, starts: bool = False, length_mm: float = 30.0) -> Subject:
    """A bead that ends, or starts, so far before the line across it."""
    bead = [(0.0, 0.0), (length_mm, 0.0)]
    far = length_mm + gap_mm
    return program_of([[bead[::-1] if starts else bead, across(far)]], shapely.box(-3, -23, far + 3, 23))


def before_the_border(gap_mm: float) -> Subject:
    return program_of([[[(0.0, 0.0), (30.0, 0.0)]]], shapely.box(-3, -20, 30 + gap_mm, 20))


def beside_a_line(aside_mm: float) -> Subject:
    """A bead that ends next to another, which runs on: it is 30 degrees aside of the end where it is twice as far away."""
    beads = [[(0.0, 0.0), (30.0, 0.0)], [(0.0, aside_mm), (80.0, aside_mm)]]
    return program_of([beads], shapely.box(-3, -20, 83, aside_mm + 3))


def comb(gap_mm: float) -> Subject:
    """Sixty beads that end before a line across them: three quarters of a spacing, and 0.1 mm since they are only sixty."""
    lines = [[(0.0, 4.32 * i), (20.0, 4.32 * i)] for i in range(60)]
    far, high = 20.0 + gap_mm, 59 * 4.32
    return program_of([[*lines, across(far, 0.0, high)]], shapely.box(-3, -3, far + 3, high + 3))


def spots_aside(angle_deg: float) -> Subject:
    """Thirty beads that end 8 mm before a line across them, and 3 mm from spots so far aside of their direction."""
    ends = [(20.0, 8.64 * i) for i in range(30)]
    lines = [[(0.0, y), (x, y)] for x, y in ends]
    along, aside = 3.0 * math.cos(math.radians(angle_deg)), 3.0 * math.sin(math.radians(angle_deg))
    spots = [[(x + along, y + aside), (x + along, y + aside + 1.0)] for x, y in ends]
    high = 30 * 8.64
    return program_of([[*lines, *spots, across(28.0, -3.0, high)]], shapely.box(-3, -6, 31, high + 3))


def slit(f: float) -> Subject:
    """A contour around two boxes with a slit between them, as sections of bodies that share a face have."""
    ring = [(3, 3), (77, 3), (77, 27), (3, 27), (3, 3)]
    gap_mm = f * 1e-3
    section = shapely.MultiPolygon([shapely.box(0, 0, 40, 30), shapely.box(40 + gap_mm, 0, 80, 30)])
    return program_of([[]], section, rings=[[ring]]).by(scan={"contour_offset_mm": 3.0})


# -- narrow features -----------------------------------------------------------------------------------

NARROW = ("layers", "metal")


def narrow(section: shapely.Geometry, **process) -> Subject:
    """The program of the cube, held against the sections of a part with narrow features."""
    heights = cube().known["plan"].heights
    parts = [shapely.get_parts(section).tolist()] * len(heights)
    return cube().given(layers=from_polygons(heights, parts)).by(process=process)


WIDE = shapely.box(0, 0, 60, 30)


def slotted(width_mm: float, **process) -> Subject:
    return narrow(WIDE - shapely.box(20, 12, 50, 12 + width_mm), least_hole_mm=4.0, **process)


def finned(width_mm: float, **process) -> Subject:
    return narrow(WIDE | shapely.box(20, 30, 20 + width_mm, 60), least_wall_mm=4.0, **process)


def notched(angle_deg: float) -> Subject:
    """A notch between sides that enclose an angle."""
    half = 20.0 * math.tan(math.radians(0.5 * angle_deg))
    return narrow(WIDE - shapely.Polygon([(30 - half, 30), (30, 10), (30 + half, 30)]), least_hole_mm=4.0)


def shallow(depth_mm: float) -> Subject:
    return narrow(WIDE - shapely.box(30, 30 - depth_mm, 32, 40), least_hole_mm=4.0, outside_reach_mm=1.0)


CASES = (
    upwards("contours close", "checks.PATH_TOLERANCE_MM", open_ring, *PLANNED),
    upwards("contour path", "checks.PATH_TOLERANCE_MM", lambda f: moved_ring(f * 1e-3), *PLANNED),
    upwards("contour path", "checks.PATH_TOLERANCE_MM machine.line_tolerance_mm", with_chords, *PLANNED),
    upwards("hatch path", "checks.PATH_TOLERANCE_MM", lambda f: ends_of(cube(), hatch_row(), f, 1e-3), *PLANNED),
    upwards("hatch vectors", "checks.PATH_TOLERANCE_MM", lambda f: ends_of(cube(), hatch_row(), f, 1e-3), *PLANNED),
    upwards("layer heights", "checks.PLACE_MM", higher, *PLANNED),
    upwards("contour rings", "checks.PLACE_MM", higher, *PLANNED),
    upwards("islands", "checks.PLACE_MM", higher, *PLANNED),
    upwards("section", "checks.SECTION_TOLERANCE_MM", lambda f: beside(f, 0.05), *PLANNED, "layers"),
    upwards("section", "curves.section_tolerance_mm", lambda f: beside(f, 0.25).by(curves={"method": "chord"}), *PLANNED, "layers"),
    upwards(
        "section", "section_check.CORNER_RAD checks.COLLINEAR_MM", polygon, "layers"
    ),
    upwards("section", "checks.SLIT_MM", slit, "layers"),
    upwards(
        "smooth section", "checks.SECTION_TOLERANCE_MM curves.tolerance_mm curves.near_point_mm curves.collinear_mm",
        lambda f: beside(f, 0.05 + 2.0 * 0.02 + 0.001 + 0.001, smooth=cube().known["layers"]), *PLANNED, "layers", "smooth",
    ),
    upwards("beads inside", "curves.section_tolerance_mm", out_of_the_part, *PLANNED, "layers"),
    upwards("overlap of contours", "inputs.SHORTEST_BLOCK_MM process.overlap_mm", overlapped, *PLANNED),
    upwards("hatch lines", "bead_checks.PARALLEL checks.TWO_PLACES_MM", skew, "heights", "beads"),
    upwards("hatch lines", "bead_checks.PARALLEL checks.TWO_PLACES_MM", uneven, "heights", "beads"),
    downwards("hatch lines", "bead_checks.LEAST_TURN", turned_back, "heights", "beads"),
    upwards("hatch spacing", "bead_checks.SPACING_SHARE", lambda f: two_lines(f * 1.5 * 4.32), "layers", "beads"),
    downwards("lines laid once", "checks.SAME_LINE_MM", lambda f: two_lines(f * 0.01), "layers", "beads"),
    upwards("turns", "process_window.TURN_SPACINGS", bead_turn),
    upwards("travel sectors", "checks.DIRECTION_ROUNDING_DEG process.travel_sectors_deg", sector),
    downwards("keep-out zones", "process.keep_out process.bead_width_mm", lambda f: one_line(keep_out=(clamp(f * 3.0),))),
    upwards("seams", "process.least_seam_distance_mm", seams),
    upwards("overhang", "process.bead_width_mm", lambda f: reaching(f * 6.0)),
    upwards("overhang", "process.largest_overhang_deg", lambda f: reaching(1.5 * math.tan(math.radians(f * 45.0)), largest_overhang_deg=45.0)),
    upwards("support", "process.bead_width_mm", over_a_gap, "layers"),
    downwards("support", "clearance.WHOLLY", on_a_clamp),
    upwards("collision", "checks.PLACE_MM", lower_bead),
    downwards("collision", "machine.head_radius_mm machine.head_above_tip_mm", head),
    upwards("clearance", "checks.PLACE_MM machine.clearance_mm", lambda f: travelling(1.5 + 5.0 - f * 1e-3, (0.0, 2.0))),
    upwards("clearance", "clearance.HOP_SPACINGS", lambda f: travelling(1.5, (30.0, f * 2.0 * 4.32))),
    upwards("ends of beads", "bead_end_checks.SINGLE_BEADS", lambda f: ending_before(f * 1.5 * 6.0), *ENDS),
    upwards("ends of beads", "bead_end_checks.SINGLE_BEADS", lambda f: ending_before(f * 1.5 * 6.0, starts=True), *ENDS),
    upwards("ends of beads", "bead_end_checks.BORDER_BEADS", lambda f: before_the_border(f * 0.8 * 6.0), *ENDS),
    upwards("ends of beads", "bead_end_checks.LEAST_BEADS", lambda f: ending_before(12.0, length_mm=f * 0.5 * 6.0), *ENDS),
    upwards("ends of beads", "bead_end_checks.STRAIGHT", lambda f: beside_a_line(f * 0.5 * 1.5 * 6.0), *ENDS),
    upwards("ends of beads", "bead_end_checks.MEAN_SPACINGS", lambda f: comb(f * (0.75 * 4.32 + 0.096)), *ENDS),
    upwards("ends of beads", "bead_end_checks.AHEAD", lambda f: spots_aside(f * 60.0), *ENDS),
    downwards("narrow features", "process.least_hole_mm", lambda f: slotted(f * 4.0), *NARROW),
    downwards("narrow features", "process.least_wall_mm", lambda f: finned(f * 4.0), *NARROW),
    downwards("narrow features", "process.machining_allowance_mm", lambda f: slotted(4.0 + f * 2.0, machining_allowance_mm=1.0), *NARROW),
    downwards("narrow features", "narrow_features.FACING", lambda f: notched(f * 40.0), *NARROW),
    upwards("narrow features", "process.outside_reach_mm", lambda f: shallow(f * 1.0), *NARROW),
)  # fmt: skip
