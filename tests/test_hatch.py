"""Lines in islands and along walls: closed forms, and shapely as oracle."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity

from ebamcheck.geometry.regions import mean_width_mm, split_thin
from ebamcheck.scan.filling.hatch import SHORTEST_LINE, hatch, lines_across, widest_pitch_mm
from ebamcheck.scan.filling.walls import wall_lines

WIDTH, SPACING = 6.0, 4.32


def star(seed, size=40.0, corners=17):
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
    island = star(seed)
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
    island = star(seed)
    moved = affinity.translate(affinity.rotate(island, turn, (0, 0), use_radians=True), 900.0, -300.0)
    one, _ = hatch([island], angle, WIDTH, SPACING)
    two, _ = hatch([moved], angle + turn, WIDTH, SPACING)
    c, s = math.cos(turn), math.sin(turn)
    assert one.start @ np.array([[c, s], [-s, c]]) + [900.0, -300.0] == pytest.approx(two.start, abs=1e-8)


def test_lines_times_pitch_is_the_area_of_a_convex_island():
    triangle = shapely.Polygon([(0, 0), (60, 0), (20, 43.2)])
    vectors, _ = hatch([triangle], 0.0, WIDTH, SPACING)
    assert len(vectors.island) == 10
    assert shapely.length(lines_of(vectors)).sum() * SPACING == pytest.approx(triangle.area)


def test_lines_alternate_in_direction():
    vectors, _ = hatch([shapely.Point(0, 0).buffer(30)], 0.4, WIDTH, SPACING)
    way = vectors.end - vectors.start
    assert (np.sum(way[1:] * way[:-1], axis=1) < 0).all()


def test_digits_are_kept_far_from_the_origin():
    island = affinity.translate(star(5), 2.0**20, -(2.0**20))
    vectors, _ = hatch([island], 0.7, WIDTH, SPACING)
    assert shapely.distance(lines_of(vectors), island).max() == 0.0
    assert island.buffer(1e-8).covers(lines_of(vectors)).all()


def test_an_island_thinner_than_the_spacing_gets_its_centre_line():
    strip = affinity.rotate(shapely.box(0, 0, 50, 2), 35, (0, 0))
    vectors, angles = hatch([strip], math.radians(125), WIDTH, SPACING)
    assert len(vectors.island) == 1
    assert math.remainder(angles[0] - math.radians(35), math.pi) == pytest.approx(0, abs=1e-9)
    assert lines_of(vectors)[0].length == pytest.approx(50.0)
    assert lines_of(vectors)[0].centroid.distance(strip.centroid) == pytest.approx(0.0, abs=1e-9)


def test_every_island_gets_a_line_however_small_and_lines_are_sorted_by_island():
    islands = [shapely.box(k * 10, 0, k * 10 + size, size) for k, size in enumerate([8, 0.2, 3, 1e-3, 6])]
    islands.append(star(2))
    vectors, _ = hatch(islands, np.linspace(0, 3, 6), WIDTH, SPACING)
    assert np.unique(vectors.island).tolist() == list(range(6))
    assert (np.diff(vectors.island) >= 0).all()
    inside = shapely.covers(shapely.buffer(np.array(islands), 1e-9)[vectors.island], lines_of(vectors))
    assert inside.all()


def test_no_island_no_line():
    vectors, angles = hatch([], 0.0, WIDTH, SPACING)
    assert vectors.start.shape == (0, 2)
    assert angles.shape == (0,)


@given(st.floats(1e-3, 1e3), st.floats(0.3, 1.0))
def test_lines_leave_no_gap(depth, spacing):
    widest = widest_pitch_mm(1.0, spacing)
    count = lines_across(depth, spacing, widest)
    assert count >= 1
    assert depth / count <= widest * (1 + 1e-6)
    assert widest <= 1.0
    assert count == 1 or depth / (count - 1) > spacing * 0.999


# -- walls ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [0.3, 2.0, 4.0])
@pytest.mark.parametrize("angle", [0.0, 33.0, 90.0])
def test_a_straight_wall_gets_its_centre_line(width, angle):
    wall = affinity.rotate(shapely.box(0, 0, 80, width), angle, (0, 0))
    axis = affinity.rotate(shapely.LineString([(0, width / 2), (80, width / 2)]), angle, (0, 0))
    lines = shapely.MultiLineString(wall_lines(wall, WIDTH, SPACING))
    assert lines.hausdorff_distance(axis) < 0.1 * width
    assert lines.length == pytest.approx(80.0, rel=2e-3)


def test_a_ring_is_driven_around():
    ring = (
        shapely.Point(0, 0).buffer(60, quad_segs=64).difference(shapely.Point(0, 0).buffer(56, quad_segs=64))
    )
    (line,) = wall_lines(ring, WIDTH, SPACING)
    assert line[0] == pytest.approx(line[-1])
    assert np.hypot(*line.T) == pytest.approx(58.0, abs=0.15)
    assert shapely.LineString(line).length == pytest.approx(2 * math.pi * 58.0, rel=2e-3)


def test_a_wide_wall_gets_lines_side_by_side():
    wall = shapely.box(0, 0, 100, 8)
    lines = wall_lines(wall, WIDTH, SPACING)
    assert len(lines) == 2
    assert sorted(float(np.median(line[:, 1])) for line in lines) == pytest.approx([2.0, 6.0], abs=0.3)
    directions = [np.sign(line[-1, 0] - line[0, 0]) for line in lines]
    assert directions[0] == -directions[1]


@pytest.mark.parametrize(
    "wall",
    [
        shapely.union_all([shapely.box(0, 0, 90, 4), shapely.box(40, 0, 44, 60)]),
        shapely.union_all([shapely.box(0, 0, 90, 4), shapely.box(43, -50, 47, 50)]),
        shapely.Polygon([(0, -3), (120, -1), (120, 1), (0, 3)]),
        shapely.LineString([(0, 0), (60, 0), (80, 50), (30, 70)]).buffer(2.2),
        shapely.LineString([(40 * math.cos(t), 40 * math.sin(t)) for t in np.linspace(0, 5, 90)]).buffer(
            2.0, cap_style="flat"
        ),
    ],
    ids=["T", "cross", "taper", "bent", "arc"],
)
def test_beads_along_a_wall_cover_it_and_stay_inside(wall):
    lines = shapely.MultiLineString(wall_lines(wall, WIDTH, SPACING))
    assert wall.buffer(1e-9).covers(lines)
    assert lines.buffer(WIDTH / 2).intersection(wall).area >= 0.99 * wall.area
    width = mean_width_mm(wall)
    assert lines.length == pytest.approx(wall.area / width, rel=0.12), "about once along the wall, no more"


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


@pytest.mark.parametrize(
    "shape", [shapely.box(0, 0, 30, 20), shapely.Point(0, 0).buffer(15), shapely.box(0, 0, 4, 5)]
)
def test_what_is_no_wall_is_solid(shape):
    solids, thin = split_thin(shape, 8.0, 9.0)
    assert thin == []
    assert sum(p.area for p in solids) == pytest.approx(shape.area)


def test_a_part_that_is_one_wall_is_all_thin():
    ring = shapely.Point(0, 0).buffer(40).difference(shapely.Point(0, 0).buffer(35))
    solids, thin = split_thin(ring, 8.0, 9.0)
    assert solids == []
    assert sum(p.area for p in thin) == pytest.approx(ring.area)
