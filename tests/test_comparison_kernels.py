"""Measures of one pair of layers, against shapely, closed forms and laws."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from ebamcheck.comparison.depth import Deepest, search
from ebamcheck.comparison.hausdorff import directed
from ebamcheck.comparison.measure import Figures, linked_within, measure
from ebamcheck.comparison.outline import outline, winding
from ebamcheck.comparison.sweep import overlap
from ebamcheck.geometry.nearest import nearest_segment
from ebamcheck.layers.stack import Layers, from_polygons, from_rings

SQUARE = np.array([(0, 0), (10, 0), (10, 10), (0, 10)], float)


def layer(*rings):
    return from_rings([0.0], [rings])


def figures(a: Layers, b: Layers, limit=1e-3, exact_a=False, exact_b=False, origin=(0.0, 0.0)) -> Figures:
    return Figures(*measure(outline(a, 0, origin), outline(b, 0, origin), limit, exact_a, exact_b))


def rings_of(o):
    """Segments of the closed rings of an outline."""
    return o.segments[: o.paths[o.rings]]


def circle(radius, points=720, centre=(0.0, 0.0), phase=0.0):
    angle = np.linspace(0, 2 * np.pi, points, endpoint=False) + phase
    return np.stack([centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)], axis=1)


def star(rng, centre=(0.0, 0.0)):
    points = rng.integers(5, 60)
    angle = np.sort(rng.uniform(0, 2 * np.pi, points))
    radius = 10 * (1 + 0.4 * rng.uniform(-1, 1, points))
    return np.stack([centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)], axis=1)


def random_pair(seed):
    """Two overlapping star-shaped rings; every third pair on a coarse lattice, so that edges coincide."""
    rng = np.random.default_rng(seed)
    a, b = star(rng), star(rng, rng.normal(size=2) * 0.7)
    if seed % 3 == 0:
        a, b = np.round(a), np.round(b)
    regions = [p for ring in (a, b) for p in [shapely.make_valid(shapely.Polygon(ring))]]
    layers = [from_polygons([0.0], [[region]]) for region in regions]
    return layers[0], layers[1], *(shapely.union_all(x.polygons(0)) for x in layers)


def inscribed_radius(region):
    polygons = [p for p in shapely.get_parts(region) if p.geom_type == "Polygon" and not p.is_empty]
    return max((shapely.maximum_inscribed_circle(p, 1e-5).length for p in polygons), default=0.0)


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("seed", range(60))
def test_areas_distances_and_depth_are_those_of_shapely(seed):
    a, b, region_a, region_b = random_pair(seed)
    found = figures(a, b)
    difference = shapely.symmetric_difference(region_a, region_b)
    assert found.sound
    assert found.area_a == pytest.approx(region_a.area, abs=1e-11)
    assert found.area_b == pytest.approx(region_b.area, abs=1e-11)
    assert found.symmetric_difference == pytest.approx(difference.area, abs=1e-11)
    hausdorff = max(found.hausdorff_ab, found.hausdorff_ba)
    dense = shapely.hausdorff_distance(region_a.boundary, region_b.boundary, densify=0.01)
    assert dense - 1e-9 <= hausdorff <= dense + 0.12
    assert found.depth == pytest.approx(inscribed_radius(difference), abs=3e-5)


@pytest.mark.in_turn(3, 1)
@pytest.mark.parametrize("seed", range(0, 40, 2))
def test_depth_from_an_exact_outline_is_the_greatest_distance_over_the_difference(seed):
    a, b, region_a, region_b = random_pair(seed)
    difference = shapely.symmetric_difference(region_a, region_b)
    grid = np.arange(-16, 16, 0.15)
    points = shapely.points(*(g.ravel() for g in np.meshgrid(grid, grid)))
    shapely.prepare(difference)
    inside = points[shapely.contains(difference, points)]
    rim = shapely.points(shapely.get_coordinates(shapely.segmentize(difference.boundary, 0.05)))
    sampled = shapely.distance(np.concatenate([inside, rim]), region_a.boundary).max()
    found = figures(a, b, exact_a=True)
    assert sampled - 2e-5 <= found.depth <= sampled + 0.11
    place = shapely.Point(found.depth_x, found.depth_y)
    assert place.distance(region_a.boundary) == pytest.approx(found.depth, abs=2e-5)
    assert place.distance(difference) <= 1e-5
    mirrored = figures(b, a, exact_b=True)
    assert mirrored.depth == pytest.approx(found.depth, abs=2e-5)


def test_a_missing_lobe_is_deep_although_the_contours_of_the_other_are_all_near():
    # The second outline ends inside the thin neck: it lies on the first everywhere, yet a lobe is gone.
    left, right = shapely.box(0, 0, 10, 10), shapely.box(20, 0, 30, 10)
    whole = from_polygons([0.0], [[shapely.union_all([left, right, shapely.box(9, 4.99, 21, 5.01)])]])
    lost = from_polygons([0.0], [[left.union(shapely.box(9, 4.99, 15, 5.01))]])
    found = figures(whole, lost, exact_a=True)
    assert found.hausdorff_ba <= 0.011
    assert found.depth == pytest.approx(5.0, abs=1e-2)
    assert found.depth_x == pytest.approx(25.0, abs=0.1)


def test_a_broken_band_along_the_contour_does_not_hide_a_missing_disc():
    # An open C along the circle: same number of rings, all contours near each other, and no disc.
    disc = shapely.Point(0, 0).buffer(10, quad_segs=64)
    c_shape = disc.difference(disc.buffer(-0.02)).difference(shapely.box(0, -0.001, 20, 0.001))
    found = figures(from_polygons([0.0], [[disc]]), from_polygons([0.0], [[c_shape]]), exact_a=True)
    assert max(found.hausdorff_ab, found.hausdorff_ba) < 0.03
    assert found.depth == pytest.approx(10.0, abs=0.02)


@pytest.mark.parametrize("exact", [False, True])
def test_one_empty_layer_is_as_deep_as_the_other_is_thick(exact):
    empty = from_rings([0.0], [[]])
    for pair in ((layer(SQUARE), empty), (empty, layer(SQUARE))):
        found = figures(*pair, exact_a=exact)
        assert found.depth == pytest.approx(5.0, abs=1e-4)
        assert np.isinf([found.hausdorff_ab, found.hausdorff_ba, found.p95_ab, found.p95_ba]).all()
        assert found.symmetric_difference == 100.0
    nothing = figures(empty, empty)
    assert (nothing.hausdorff_ab, nothing.depth, nothing.symmetric_difference) == (0.0, 0.0, 0.0)


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("seed", range(12))
def test_measures_are_symmetric_and_do_not_depend_on_the_frame(seed):
    a, b, _, _ = random_pair(seed)
    base = figures(a, b)
    swapped = figures(b, a)
    assert swapped.symmetric_difference == pytest.approx(base.symmetric_difference, abs=1e-11)
    assert (swapped.hausdorff_ab, swapped.hausdorff_ba) == (base.hausdorff_ba, base.hausdorff_ab)
    assert swapped.p95_ab == base.p95_ba
    assert swapped.depth == pytest.approx(base.depth, abs=2e-5)
    angle = 0.7 + seed
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for scale, matrix in ((1.0, turn), (1.0, np.diag([-1.0, 1.0])), (0.01, np.eye(2)), (1500.0, turn)):
        moved = [
            from_rings(
                [0.0],
                [[(r @ matrix.T * scale)[:: int(np.sign(np.linalg.det(matrix)))] for r in map(x.ring, x.rings_of(0))]],
            )
            for x in (a, b)
        ]
        found = figures(*moved, limit=1e-3 * scale)
        assert found.symmetric_difference == pytest.approx(base.symmetric_difference * scale**2, rel=1e-9, abs=1e-11)
        assert found.hausdorff_ab == pytest.approx(base.hausdorff_ab * scale, rel=1e-6, abs=2e-7 + 1e-9 * scale)
        assert found.p95_ab == pytest.approx(base.p95_ab * scale, rel=0.01)
        assert found.depth == pytest.approx(base.depth * scale, abs=2e-6 + 2e-5 * scale)


def test_open_paths_count_for_distances_and_bound_no_area():
    path = from_rings([0.0], [[]], [[[(0, 0), (10, 0), (10, 10)]]])
    found = figures(path, path)
    assert (found.area_a, found.depth, found.hausdorff_ab) == (0.0, 0.0, 0.0)
    with_path = from_rings([0.0], [[SQUARE]], [[[(20, 5), (30, 5)]]])
    found = figures(with_path, layer(SQUARE))
    assert found.hausdorff_ab == 20.0
    assert found.depth == 0.0


def lattice_rings(rng):
    """Rings of integer points that run over themselves and each other: every degenerate case at once."""
    return [rng.integers(0, 6, (rng.integers(3, 30), 2)).astype(float) for _ in range(rng.integers(1, 7))]


@pytest.mark.in_turn(3, 2)
@pytest.mark.parametrize("seed", range(60))
def test_the_deepest_place_of_overlapping_rings_lies_in_the_difference(seed):
    # Rounding puts coincident edges in one order or the other; what lies between them is no place.
    rng = np.random.default_rng(seed)
    a, b = layer(*lattice_rings(rng)), layer(*lattice_rings(rng))
    found = figures(a, b, limit=1e-3, exact_a=True)
    o, p = outline(a, 0, (0.0, 0.0)), outline(b, 0, (0.0, 0.0))
    around = np.array([found.depth_x, found.depth_y]) + rng.normal(size=(2000, 2)) * 1e-4
    assert any((winding(rings_of(o), x, y) > 0) != (winding(rings_of(p), x, y) > 0) for x, y in around)
    measured = o if len(o.segments) else p
    square, _ = nearest_segment(measured.tree, found.depth_x, found.depth_y, -1)
    assert np.sqrt(square) == pytest.approx(found.depth, abs=1e-9)


@pytest.mark.in_turn(3, 1)
@pytest.mark.parametrize("seed", range(20))
def test_areas_of_overlapping_rings_are_those_by_winding_number(seed):
    rng = np.random.default_rng(seed)
    a, b = layer(*lattice_rings(rng)), layer(*lattice_rings(rng))
    outlines = [outline(x, 0, (0.0, 0.0)) for x in (a, b)]
    # Lines of all segments cut the plane into cells of one winding number each: cells by shapely, numbers by ours.
    lines = [shapely.linestrings(s.reshape(2, 2)) for o in outlines for s in o.segments]
    cells = shapely.get_parts(shapely.polygonize([shapely.union_all(lines)]))
    inside = [
        np.array([winding(rings_of(o), p.x, p.y) > 0 for p in shapely.point_on_surface(cells)], bool) for o in outlines
    ]
    found = figures(a, b)
    size = shapely.area(cells)
    assert found.area_a == pytest.approx(size[inside[0]].sum(), abs=1e-10)
    assert found.area_b == pytest.approx(size[inside[1]].sum(), abs=1e-10)
    assert found.symmetric_difference == pytest.approx(size[inside[0] != inside[1]].sum(), abs=1e-10)


def linked(a, b, reach):
    o, p = outline(a, 0, (0.0, 0.0)), outline(b, 0, (0.0, 0.0))
    far = directed(p, o)
    return far.most_mm <= reach and linked_within(o, p, far.near, reach)


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("seed", range(40))
def test_links_never_promise_less_than_the_depth_found_by_search(seed):
    rng = np.random.default_rng(seed)
    a = layer(star(rng), *([star(rng, (9.0, 0.0)) * 0.5] if seed % 2 else []))
    noise = 10.0 ** rng.uniform(-6, 0)
    b = from_rings([0.0], [[a.ring(r) + rng.normal(size=a.ring(r).shape) * noise for r in a.rings_of(0)]])
    o, p = outline(a, 0, (0.0, 0.0)), outline(b, 0, (0.0, 0.0))
    nothing = Deepest(0.0, np.nan, np.nan)
    found = search(o, p, True, False, overlap(o, p, True).difference, nothing, 1e-6)
    for reach in (0.5, 0.9, 0.99) * np.array(found.depth_mm):
        assert not linked(a, b, reach)


def test_links_need_every_ring_once_and_the_same_way_around():
    ring, hole = circle(9.0), circle(4.0, 360)[::-1]
    near = [ring + 1e-4, hole - 1e-4]
    assert linked(layer(ring, hole), layer(*near), 2e-4)
    assert not linked(layer(ring, hole), layer(*near), 1e-5)
    assert not linked(layer(ring, hole), layer(ring), 100.0)
    assert not linked(layer(ring), layer(ring, hole), 100.0)
    # Two rings near one: each would have to be the partner of the other's.
    assert not linked(layer(circle(9.0), circle(4.0)), layer(circle(8.9), circle(8.8)), 100.0)


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("seed", range(20))
def test_the_percentile_is_that_of_dense_samples(seed):
    a, b, region_a, region_b = random_pair(seed)
    rings = shapely.get_parts(region_a.boundary)
    places = np.concatenate(
        [shapely.line_interpolate_point(ring, np.arange(0.0, ring.length, 0.005)) for ring in rings]
    )
    dense = np.percentile(shapely.distance(places, region_b.boundary), 95)
    assert figures(a, b).p95_ab == pytest.approx(dense, abs=0.02)
