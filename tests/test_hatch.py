"""Lines in islands, beads along walls and in gaps: closed forms, laws, and shapely as oracle."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from section_zoo import ZOO, star
from shapely import affinity

from ebamcheck.geometry.raster import bare_samples
from ebamcheck.geometry.regions import split_thin
from ebamcheck.scan.filling.fill import LEAST_SPOT, bare_spots, gap_beads, spot_widths_mm, spots_to_close
from ebamcheck.scan.filling.hatch import SHORTEST_LINE, hatch, lines_across, widest_pitch_mm
from ebamcheck.scan.filling.walls import LEAST_APART, LEAST_BEAD, TAPER, TAPER_SHARE, wall_lines
from ebamcheck.scan.islands.regions import layer_regions
from ebamcheck.settings.config import Config

PROFILE = Config()
WIDTH, SPACING = PROFILE.process.bead_width_mm, PROFILE.process.hatch_spacing_mm


def crooked(seed, size=40.0, corners=17):
    """A crooked polygon with a hole."""
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * math.pi, corners))
    radius = rng.uniform(0.4, 1.0, corners) * size
    outline = shapely.Polygon(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]))
    hole = shapely.Point(0, 0).buffer(0.12 * size, quad_segs=4)
    shape = shapely.make_valid(outline).difference(hole)
    return max(shapely.get_parts(shape), key=lambda p: p.area)


def lines_of(vectors):
    return shapely.linestrings(np.stack([vectors.start, vectors.end], axis=1))


def test_lines_of_a_box():
    vectors, angles = hatch([shapely.box(10, 20, 40, 41.6)], 0.0, WIDTH, SPACING)
    assert angles.tolist() == [0.0]
    assert vectors.start[:, 1] == pytest.approx(20 + SPACING * (np.arange(5) + 0.5))
    assert vectors.start[:, 1] == pytest.approx(vectors.end[:, 1])
    assert vectors.start[:, 0] == pytest.approx([10, 40, 10, 40, 10])
    assert vectors.end[:, 0] == pytest.approx([40, 10, 40, 10, 40])


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2, 2.5, math.pi / 2])
@pytest.mark.parametrize("seed", range(8))
def test_lines_are_those_of_shapely(seed, angle):
    island = crooked(seed)
    (vectors, _) = hatch([island], angle, WIDTH, SPACING)
    flat = affinity.rotate(island, -angle, origin=(0, 0), use_radians=True)
    x0, y0, x1, y1 = flat.bounds
    count = lines_across(y1 - y0, SPACING, widest_pitch_mm(WIDTH, SPACING))
    expected = []
    for n in range(count):
        y = y0 + (y1 - y0) * (n + 0.5) / count
        cut = flat.intersection(shapely.LineString([(x0 - 1, y), (x1 + 1, y)]))
        expected += [part.length for part in shapely.get_parts(cut)]
    expected = [length for length in expected if length > SHORTEST_LINE * WIDTH]
    lengths = shapely.length(lines_of(vectors))
    assert np.sort(lengths) == pytest.approx(np.sort(expected), abs=1e-9)
    assert island.buffer(1e-9).covers(lines_of(vectors)).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 1000), st.floats(0, math.pi), st.floats(0, 2 * math.pi))
def test_hatch_turns_with_the_island(seed, angle, turn):
    island = crooked(seed)
    moved = affinity.translate(affinity.rotate(island, turn, (0, 0), use_radians=True), 900.0, -300.0)
    one, _ = hatch([island], angle, WIDTH, SPACING)
    two, _ = hatch([moved], angle + turn, WIDTH, SPACING)
    c, s = math.cos(turn), math.sin(turn)
    assert one.start @ np.array([[c, s], [-s, c]]) + [900.0, -300.0] == pytest.approx(two.start, abs=1e-8)


def test_an_island_thinner_than_the_spacing_gets_its_centre_line():
    strip = affinity.rotate(shapely.box(0, 0, 50, 2), 35, (0, 0))
    vectors, angles = hatch([strip], math.radians(125), WIDTH, SPACING)
    assert len(vectors.island) == 1
    assert math.remainder(angles[0] - math.radians(35), math.pi) == pytest.approx(0, abs=1e-9)
    assert lines_of(vectors)[0].length == pytest.approx(50.0)
    assert lines_of(vectors)[0].centroid.distance(strip.centroid) == pytest.approx(0.0, abs=1e-9)


def test_every_island_gets_a_line_however_small_and_lines_are_sorted_by_island():
    islands = [shapely.box(k * 10, 0, k * 10 + size, size) for k, size in enumerate([8, 0.2, 3, 1e-3, 6])]
    islands.append(crooked(2))
    vectors, _ = hatch(islands, np.linspace(0, 3, 6), WIDTH, SPACING)
    assert np.unique(vectors.island).tolist() == list(range(6))
    assert (np.diff(vectors.island) >= 0).all()
    inside = shapely.covers(shapely.buffer(np.array(islands), 1e-9)[vectors.island], lines_of(vectors))
    assert inside.all()


@given(st.floats(1e-3, 1e3), st.floats(0.3, 1.0))
def test_lines_leave_no_gap(depth, spacing):
    widest = widest_pitch_mm(1.0, spacing)
    count = lines_across(depth, spacing, widest)
    assert count >= 1
    assert depth / count <= widest * (1 + 1e-6)
    assert widest <= 1.0
    assert count == 1 or depth / (count - 1) > spacing * 0.999


# -- thin against solid --------------------------------------------------------------------------------


def test_opening_finds_the_three_walls_of_a_part_and_leaves_its_corners():
    solid = shapely.box(0, 0, 60, 40)
    walls = [shapely.box(60, 5, 110, 9), shapely.box(60, 25, 100, 31), shapely.box(20, 40, 23, 90)]
    part = shapely.union_all([solid, *walls])
    solids, thin = split_thin(part, 8.0, 9.0)
    assert len(thin) == 3
    assert sorted(p.area for p in thin) == pytest.approx(sorted(w.area for w in walls), rel=0.03)
    assert sum(p.area for p in (*solids, *thin)) == pytest.approx(part.area, rel=1e-9)
    # The core reaches into the root of a wall by the round of its opening.
    assert shapely.union_all(solids).symmetric_difference(solid).area < 0.01 * solid.area


@pytest.mark.parametrize("shape", [shapely.box(0, 0, 30, 20), shapely.Point(0, 0).buffer(15), shapely.box(0, 0, 4, 5)])
def test_what_is_no_wall_is_solid(shape):
    solids, thin = split_thin(shape, 8.0, 9.0)
    assert thin == []
    assert sum(p.area for p in solids) == pytest.approx(shape.area)


def test_a_part_that_is_one_wall_is_all_thin():
    ring = shapely.Point(0, 0).buffer(40).difference(shapely.Point(0, 0).buffer(35))
    solids, thin = split_thin(ring, 8.0, 9.0)
    assert solids == []
    assert sum(p.area for p in thin) == pytest.approx(ring.area)


# -- beads along walls that change their width, end in a point, or fork -------------------------------------


def wedge(length, thick):
    """Symmetric wedge along +x with its tip at the origin."""
    return shapely.Polygon([(0.0, 0.0), (length, -0.5 * thick), (length, 0.5 * thick)])


def ring(radius, thick):
    return shapely.Point(0, 0).buffer(radius, 64).difference(shapely.Point(0, 0).buffer(radius - thick, 64))


def lens(thick):
    discs = [shapely.Point(0, y).buffer(100 + 0.5 * thick, 64) for y in (-100, 100)]
    return discs[0].intersection(discs[1])


SHAPES = {
    **{f"wedge {thick}": wedge(120, thick) for thick in (0.3, 4, 9, 14)},
    "wedge with its back to another": wedge(60, 8).union(affinity.scale(wedge(60, 8), -1, 1, origin=(60, 0))),
    "bow": wedge(50, 8).union(affinity.scale(wedge(50, 8), -1, 1, origin=(0, 0))).buffer(0.4),
    "lens": lens(9.0),
    **{f"star of {n}": star(n, 1.2 * n**0.5, 45) for n in (3, 4, 5, 6)},
    **{f"ring {thick}": ring(40, thick) for thick in (0.02, 1, 5.9, 6, 6.2, 11)},
    "hair": shapely.box(0, 0, 100, 0.01),
    "hair to a point": wedge(100, 0.02),
    "crescent": shapely.Point(0, 0).buffer(50, 64).difference(shapely.Point(8, 0).buffer(50, 64)),
}
WALLS = [
    *((name, part) for name, shape in SHAPES.items() for part in shapely.get_parts(shape)),
    *((name, shape) for name, shape in ZOO.items() if name[0] in "LTUc" and "bead" in name),
]
for zoo_name, section in ZOO.items():
    regions = layer_regions(section, PROFILE)
    parts = [*regions.narrow_fills, *regions.bare_walls]
    WALLS += [(f"{zoo_name}, wall {n}", part) for n, part in enumerate(parts[:6])]


def beads_of(wall):
    return [shapely.LineString(line) for line in wall_lines(wall, WIDTH, SPACING)]


def check_laws(wall):
    lines = beads_of(wall)
    assert all(wall.buffer(1e-9).covers(line) for line in lines)
    for a, b in itertools.combinations(lines, 2):
        assert a.distance(b) >= LEAST_APART * SPACING * (1.0 - 1e-3)
    if len(lines) > 1:
        assert min(line.length for line in lines) >= LEAST_BEAD * WIDTH
    return lines


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("wall", [wall for _, wall in WALLS], ids=[name for name, _ in WALLS])
def test_beads_lie_in_the_wall_apart_and_are_no_stubs(wall):
    lines = check_laws(wall)
    turned = [line.length for line in beads_of(affinity.rotate(wall, 33.0, origin=(0, 0)))]
    assert sum(turned) == pytest.approx(sum(line.length for line in lines), rel=0.05, abs=WIDTH)


@example(0.0, [1.0, 1.0, 13.0])  # a leg narrower than the taper of the rest
@example(0.5, [13.0, 1.0, 1.0, 1.0, 13.0, 1.0])
@settings(deadline=None, max_examples=30)
@given(st.floats(0.0, 2 * math.pi), st.lists(st.floats(1.0, 14.0), min_size=2, max_size=6))
def test_walls_of_any_course_of_width_are_filled(turn, widths):
    x = 30.0 * np.arange(len(widths))
    half = 0.5 * np.array(widths)
    outline = [*zip(x, -half, strict=True), *zip(x[::-1], half[::-1], strict=True)]
    wall = affinity.rotate(shapely.Polygon(outline), turn, origin=(0, 0), use_radians=True)
    lines = check_laws(wall)
    beads = shapely.union_all(shapely.buffer(lines, 0.5 * WIDTH))
    # A side bead that would be shorter than LEAST_RUN is none: the gap there is closed as others are.
    assert wall.intersection(beads).area > 0.9 * wall.area


@pytest.mark.parametrize("thick", [4.0, 6.0, 9.0, 20.0])
def test_a_wedge_ends_in_one_bead_where_it_is_narrower_than_its_taper(thick):
    lines = beads_of(wedge(120.0, thick))
    starts = sorted(line.bounds[0] for line in lines)
    least = min(TAPER * WIDTH, TAPER_SHARE * thick)
    sine = 0.5 * thick / math.hypot(120.0, 0.5 * thick)
    assert starts[0] == pytest.approx(least / (2.0 * sine), abs=0.25 * WIDTH)
    # A second bead begins where one alone does not reach both sides.
    assert (len(starts) == 1) == (thick <= WIDTH)
    if len(starts) > 1:
        assert starts[1] > 0.95 * WIDTH / (2.0 * sine)


@pytest.mark.parametrize(("corners", "through"), [(3, 1), (4, 2), (5, 2), (6, 3)])
def test_a_star_has_a_bead_an_arm_at_most(corners, through):
    lines = beads_of(star(corners, 1.2 * corners**0.5, 45))
    assert corners - through <= len(lines) <= corners


def across(lines, place):
    cut = shapely.LineString([(place, -50), (place, 50)])
    return sum(line.intersects(cut) for line in lines)


def test_a_wall_that_tapers_has_as_many_beads_as_it_is_wide():
    lines = beads_of(ZOO["tapered wall"])
    assert [across(lines, x) for x in (5.0, 70.0, 120.0, 140.0)] == [4, 2, 1, 1]
    assert sum(line.length for line in lines) * SPACING == pytest.approx(ZOO["tapered wall"].area, rel=0.06)
    assert len(lines) == 4, "one of them goes on to the end"


@pytest.mark.parametrize("thick", [2.0, 4.2, 5.9, 6.0])
def test_walls_up_to_a_bead_have_one(thick):
    assert len(beads_of(shapely.box(0, 0, 100, thick))) == 1
    assert len(beads_of(ring(50, thick))) == 1
    (through, foot) = sorted(beads_of(ZOO["T of 0.7 beads"]), key=lambda line: -line.length)
    assert through.length == pytest.approx(100.0, abs=1.0)
    assert through.distance(foot) == pytest.approx(LEAST_APART * SPACING, rel=0.01)


def test_the_longest_line_of_a_wall_stays_however_short():
    for size in (0.3, 1.0, 2.5):
        (line,) = beads_of(shapely.box(0, 0, size, 0.2 * size))
        assert 0.0 < line.length < LEAST_BEAD * WIDTH


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("thick", [3.0, 5.5, 7.5])
def test_beads_of_walls_with_uneven_points_bend_one_way(seed, thick):
    rng = np.random.default_rng(seed)

    def side(radius, count):
        angle = np.radians([0.0, *np.sort(rng.uniform(1.0, 149.0, count)), 150.0])
        return radius * np.column_stack([np.cos(angle), np.sin(angle)])

    outer, inner = side(40.0 + thick, 90), side(40.0, 61)
    for line in beads_of(shapely.Polygon([*outer, *inner[::-1]])):
        way = np.diff(shapely.get_coordinates(line), axis=0)
        away = shapely.distance(shapely.points(shapely.get_coordinates(line)), shapely.MultiPoint([*outer[[0, -1]]]))
        bend = way[:-1, 0] * way[1:, 1] - way[:-1, 1] * way[1:, 0]
        bend /= np.hypot(*way[:-1].T) * np.hypot(*way[1:].T)
        middle = bend[away[1:-1] > 1.5 * thick]
        assert len(middle) > 3 or line.length < 3.0 * thick
        assert abs(np.sign(middle).sum()) == len(middle)


def bend(radius, angle_deg, thick, leg=25.0):
    """A wall of even width around a bend of its middle."""
    turn = np.radians(np.linspace(0.0, angle_deg, 12))
    arc = radius * np.column_stack([np.sin(turn), 1.0 - np.cos(turn)])
    way = np.array([np.cos(turn[-1]), np.sin(turn[-1])])
    middle = shapely.LineString(np.vstack([[-leg, 0.0], arc, arc[-1] + leg * way]))
    return middle.buffer(0.5 * thick, cap_style="flat", quad_segs=6)


# -- spots ---------------------------------------------------------------------------------------------


def corner_spots(section, segments):
    return bare_spots(section, bare_samples(section, segments, WIDTH), segments, WIDTH)


@pytest.mark.parametrize("turn", [0.0, 20.0, 45.0])
def test_spots_of_a_square_contour_are_its_four_corners(turn):
    square = affinity.rotate(shapely.box(0, 0, 10, 10), turn)
    ring = shapely.get_coordinates(affinity.rotate(shapely.box(3, 3, 7, 7), turn))
    spots = corner_spots(square, np.hstack([ring[:-1], ring[1:]]))
    assert len(spots) == 4
    tip = (1.0 - math.pi / 4) * 3.0**2
    assert [spot.area for spot in spots] == pytest.approx([tip] * 4, rel=0.02)
    # The circle that touches both sides and the bead's end: (R + r) / R = sqrt 2 of its depth, doubled.
    across = 2.0 * 3.0 * (math.sqrt(2) - 1) / (math.sqrt(2) + 1)
    assert spot_widths_mm(spots) == pytest.approx(across, abs=0.02)


def test_spots_are_those_of_shapely():
    rng = np.random.default_rng(3)
    section = shapely.union_all([ZOO["gear"]])
    segments = rng.uniform(-90, 90, (150, 4))
    beads = shapely.union_all(shapely.buffer(shapely.linestrings(segments.reshape(-1, 2, 2)), WIDTH / 2))
    exact = [p for p in shapely.get_parts(section.difference(beads)) if p.area > LEAST_SPOT * WIDTH**2]
    found = corner_spots(section, segments)
    assert sum(p.area for p in found) == pytest.approx(sum(p.area for p in exact), rel=0.01)


def test_wide_spots_are_closed_and_narrow_ones_only_while_coverage_is_missing():
    spots = [shapely.box(10 * k, 0, 10 * k + size, size) for k, size in enumerate([1.0, 2.0, 0.5])]
    chosen, left = spots_to_close(spots, 1.5, 1000.0, 0.99, 0.98)
    assert (chosen, left) == ([spots[1]], pytest.approx(1.0, abs=1e-3))
    chosen, left = spots_to_close(spots, 1.5, 100.0, 0.94, 0.98)
    assert (chosen, left) == ([spots[1], spots[0]], pytest.approx(0.5, abs=1e-3))
    assert spots_to_close([], 1.5, 100.0, 0.5, 0.98) == ([], 0.0)


@pytest.mark.parametrize(
    "spot",
    [
        shapely.Polygon([(0, 0), (2, 0), (0, 2)]),
        shapely.box(20, 20, 50, 21.5),
        shapely.LineString([(20, 20), (40, 20), (40, 40)]).buffer(0.8, cap_style="flat"),
        shapely.MultiLineString([[(12, 45), (44, 45)], [(28, 45), (28, 58)]]).buffer(0.8, cap_style="flat"),
        shapely.Point(30, 30).buffer(1.4),
    ],
    ids=["tip", "slit", "bent slit", "fork", "round"],
)
def test_a_gap_bead_covers_its_spot_within_the_section_and_beside_the_islands(spot):
    section = shapely.box(0, 0, 60, 60)
    islands = np.array([shapely.box(5, 25, 55, 35)], object)
    beads, island, polygons = gap_beads([spot], section, islands, WIDTH, SPACING)
    lines = shapely.union_all(beads)
    assert spot.difference(lines.buffer(WIDTH / 2)).area <= 0.02 * spot.area
    assert section.covers(lines)
    homes = np.concatenate([islands, polygons])[island]
    assert shapely.covers(shapely.buffer(homes, 1e-9), beads).all()
    together = shapely.union_all([*islands, *polygons])
    assert together.area == pytest.approx(shapely.area([*islands, *polygons]).sum(), rel=1e-9)
