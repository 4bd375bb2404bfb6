"""What makes the exact plane cut fast changes nothing: each short cut against the long way round."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import shapely
from parts import box, join, moved, sphere, tilted, torus, turn_z

import ebamcheck
from ebamcheck.layers.stack import concatenate, from_rings
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import edge_groups
from ebamcheck_planecut import PlaneCut
from ebamcheck_planecut.cut import LONE_LAYERS
from ebamcheck_planecut.overlaps import (
    CLEAN,
    NESTED_WRONG,
    TOUCHING,
    classify_layer,
    kept_rings,
    overlap_search,
)
from ebamcheck_planecut.sorted_mesh import (
    crossed_mesh,
    facets_across,
    height_order,
    raise_plane,
    sorted_mesh,
    vertices_under,
)

COLUMNS = ("heights", "points", "ring_starts", "layer_starts", "closed", "edge", "edge_t", "dropped")

PAGES = Part(  # three pages of a book: an edge with three facets
    np.array([(0, 0, 0), (0, 0, 4), (3, 0, 2), (-1, 2, 1), (-1, -2, 3)], float),
    np.array([(0, 1, 2), (1, 0, 3), (0, 1, 4)], np.int32),
)
LIDLESS = Part(box().vertices, np.delete(box().faces, [4, 5], axis=0))
FLIPPED = Part(
    sphere().vertices,
    np.where(np.arange(len(sphere().faces))[:, None] % 7, sphere().faces, sphere().faces[:, ::-1]),
)
PARTS = {
    "torus": tilted(torus()),
    "box": box(),
    "bodies that touch": join(box((0, 0, 0), (1, 1, 1)), box((1, 1, 0), (2, 2, 1))),
    "shells that cross": join(sphere(), moved(sphere(), turn_z(10.0), (0.4, 0.1, 0.3))),
    "pages": PAGES,
    "open": LIDLESS,
    "flipped": FLIPPED,
}


def prepared(part, **settings):
    return PlaneCut().prepare(part, PlaneCut.Settings(**settings))


def same(a, b):
    for column in COLUMNS:
        x, y = getattr(a, column), getattr(b, column)
        assert x.dtype == y.dtype, column
        assert x.tobytes() == y.tobytes(), column


def planes(part):
    """Heights between vertices, through them, and outside."""
    z = np.unique(part.vertices[:, 2])
    return np.unique(
        np.concatenate([z, (z[1:] + z[:-1]) / 2, [z[0] - 1, z[-1] + 1], np.linspace(z[0], z[-1], 97)])
    )


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("threads", ["1", "3"])
def test_blocks_that_leave_gaps_are_joined_without_them(name, threads, monkeypatch):
    monkeypatch.setenv("EBAMCHECK_THREADS", threads)
    part = PARTS[name]
    heights = planes(part)
    ready = prepared(part)
    one_by_one = concatenate([ready.slice(heights[k : k + 1]) for k in range(heights.size)])
    same(ready.slice(heights), one_by_one)


@pytest.mark.parametrize("faces", [[], [(0, 1, 1), (2, 2, 2)]])
def test_a_part_without_a_facet_that_has_area_gives_empty_layers(faces):
    part = Part(box().vertices, np.array(faces, np.int32).reshape(-1, 3))
    ready = prepared(part)
    for one in (ready, ready.turned(part.along((0, 1, 1)))):
        layers = one.slice(np.linspace(-1, 3, 60))
        assert (len(layers), len(layers.points), layers.closed.size) == (60, 0, 0)


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", PARTS)
def test_a_part_that_is_turned_again_is_cut_as_if_it_were_new(name):
    part = PARTS[name]
    first = prepared(part)
    for direction in ((1, 2, 3), (0, 0, -1), (1, 0, 0)):
        turned = part.along(direction)
        again, anew = first.turned(turned), prepared(turned)
        heights = planes(turned)[::3]
        same(again.slice(heights), anew.slice(heights))
        back = again.turned(part)
        same(back.slice(planes(part)[::5]), first.slice(planes(part)[::5]))


def soup(seed, facets=120, points=40):
    """Facets between points of a coarse lattice: open, flipped, doubled, in each other, many on one edge, some flat."""
    draw = np.random.default_rng(seed)
    return Part(
        draw.integers(-3, 4, (points, 3)).astype(float),
        draw.integers(0, points, (facets, 3)).astype(np.int32),
    )


LONE_PARTS = {
    **PARTS,
    "boxes on each other": join(box(), box((0, 0, 2), (2, 2, 3)), box((1, 1, -1), (3, 3, 2))),
    **{f"soup {seed}": soup(seed) for seed in range(4)},
}
DIRECTIONS = [(0, 0, -1), (1, 0, 0), (1, 1, 0), *np.random.default_rng(8).normal(size=(4, 3)).tolist()]


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("name", LONE_PARTS)
@pytest.mark.parametrize("overlaps", ["unite", "keep"])
def test_a_few_layers_along_a_new_direction_are_those_of_the_whole_sorted_mesh(name, overlaps):
    part = LONE_PARTS[name]
    first = prepared(part, overlaps=overlaps)
    for direction in DIRECTIONS:
        turned = part.along(direction)
        heights = planes(turned)
        heights = heights[np.unique(np.linspace(0, heights.size - 1, 2 * LONE_LAYERS).astype(int))]
        whole = prepared(turned, overlaps=overlaps).slice(heights)
        again = first.turned(turned)
        for k in range(heights.size):
            # A new one each time, and one that has its mesh sorted on the way.
            same(first.turned(turned).slice(heights[k : k + 1]), whole.block(k, k + 1))
            same(again.slice(heights[k : k + 1]), whole.block(k, k + 1))
        same(first.turned(turned).slice(heights[:LONE_LAYERS]), whole.block(0, LONE_LAYERS))


@pytest.mark.parametrize("name", ["torus", "pages", "soup 0"])
@pytest.mark.parametrize("threads", ["1", "3"])
def test_layers_along_a_new_direction_may_be_asked_for_by_many_threads(name, threads, monkeypatch):
    monkeypatch.setenv("EBAMCHECK_THREADS", threads)
    part = LONE_PARTS[name]
    turned = part.along((2, -1, 3))
    heights = planes(turned)[:64]
    whole = prepared(turned).slice(heights)
    again = prepared(part).turned(turned)
    with ThreadPoolExecutor(8) as pool:
        found = pool.map(lambda k: again.slice(heights[k : k + 1]), range(heights.size))
        for k, one in enumerate(found):
            same(one, whole.block(k, k + 1))


@pytest.mark.parametrize("name", LONE_PARTS)
def test_of_a_few_planes_only_the_facets_that_they_cross_are_sorted(name):
    part = LONE_PARTS[name]
    whole = sorted_mesh(part)
    heights = planes(part)
    for few in (heights[:0], heights[5:6], heights[3:12:3]):
        z = whole.vertices[whole.faces, 2]
        crossed = ((z.min(axis=1)[:, None] <= few) & (z.max(axis=1)[:, None] > few)).any(axis=1)
        mesh = crossed_mesh(part, few)
        assert mesh.numbers.tolist() == whole.numbers[crossed].tolist()
        assert mesh.vertices[mesh.faces].tolist() == whole.vertices[whole.faces[crossed]].tolist()
        tops, expected = mesh.vertices[mesh.highest], whole.vertices[whole.highest[crossed]]
        assert tops.tolist() == expected.tolist()


HEIGHTS = {
    "none": [],
    "one": [3.0],
    "all equal": [2.5] * 1000,
    "two levels": [1.0, -1.0] * 700,
    "random": np.random.default_rng(0).normal(size=3000),
    "rounded": np.random.default_rng(1).normal(size=3000).round(1),
    "a crowd and one far off": [*np.random.default_rng(2).random(3000), 1e12],
    "beyond what a difference holds": [*np.random.default_rng(3).random(100), -1.7e308, 1.7e308],
    "denormal": np.random.default_rng(4).integers(0, 50, 500) * 5e-324,
    "zeros of both signs": [0.0, -0.0] * 40,
    "downwards": np.arange(999, -1, -1.0) // 3,
}


@pytest.mark.parametrize("name", HEIGHTS)
def test_vertices_stand_by_height(name):
    z = np.array(HEIGHTS[name], float)
    assert height_order(z).tolist() == np.argsort(z, kind="stable").tolist()


@pytest.mark.parametrize("name", PARTS)
def test_facets_begin_with_their_lowest_vertex_and_run_as_they_did(name):
    part = PARTS[name]
    mesh = sorted_mesh(part)
    assert (mesh.faces[:, :1] < mesh.faces[:, 1:]).all()
    corners = (mesh.begins[:, None] + np.arange(3)) % 3
    given = np.take_along_axis(part.faces[mesh.numbers], corners, axis=1)
    assert mesh.vertices[mesh.faces, 3].tolist() == given.tolist()


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", PARTS)
def test_facets_across_a_plane_are_those_that_begin_under_and_end_over_it(name):
    part = PARTS[name]
    mesh = sorted_mesh(part)
    heights = planes(part)
    rising = np.empty(len(mesh.faces), np.int32)
    alone = np.empty(len(mesh.faces), np.int32)
    z = mesh.vertices[mesh.faces, 2]
    count = before = 0
    for h, under in zip(heights, vertices_under(mesh, heights), strict=True):
        assert under == np.count_nonzero(part.vertices[:, 2] <= h)
        expected = np.flatnonzero((z.min(axis=1) <= h) & (z.max(axis=1) > h)).tolist()
        count = raise_plane(mesh, before, under, rising, count)
        before = under
        assert rising[:count].tolist() == expected
        assert alone[: facets_across(mesh, under, alone)].tolist() == expected


@pytest.mark.parametrize("threads", ["1", "3"])
@pytest.mark.parametrize("points", [3, 50, 60_000])
def test_half_edges_are_grouped_as_a_stable_sort_groups_them(points, threads, monkeypatch):
    """Also at vertices where a crowd of facets meets, and across the borders of blocks."""
    monkeypatch.setenv("EBAMCHECK_THREADS", threads)
    draw = np.random.default_rng(points)
    faces = draw.integers(0, points, (3 * points, 3)).astype(np.int32)
    faces[: 2 * points // 3, 0] = points // 2
    groups = edge_groups(faces, points)
    has_area = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    half_edges = np.flatnonzero(np.repeat(has_area, 3))
    tail, head = faces.ravel()[half_edges], np.roll(faces, -1, axis=1).ravel()[half_edges]
    low, high = np.minimum(tail, head), np.maximum(tail, head)
    order = np.lexsort((high, low))
    assert groups.half_edges.tolist() == half_edges[order].tolist()
    new = (np.diff(low[order], prepend=-1) != 0) | (np.diff(high[order], prepend=-1) != 0)
    assert groups.starts.tolist() == [*np.flatnonzero(new).tolist(), half_edges.size]


# -- the tree of boxes ---------------------------------------------------------------------------------


def crossing(p, q, r, s) -> bool:
    """Whether segments pq and rs share a point; exact for small whole numbers."""

    def side(a, b, c):
        return (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])

    if max(p[0], q[0]) < min(r[0], s[0]) or max(r[0], s[0]) < min(p[0], q[0]):
        return False
    if max(p[1], q[1]) < min(r[1], s[1]) or max(r[1], s[1]) < min(p[1], q[1]):
        return False
    return side(p, q, r) * side(p, q, s) <= 0 and side(r, s, p) * side(r, s, q) <= 0


def meets_anywhere(rings) -> bool:
    """Every segment with every other one that does not follow it."""
    segments = [
        (r, i, ring[i], ring[(i + 1) % len(ring)]) for r, ring in enumerate(rings) for i in range(len(ring))
    ]
    for (r, i, p, q), (s, k, t, u) in itertools.combinations(segments, 2):
        follow = r == s and (k == (i + 1) % len(rings[r]) or i == (k + 1) % len(rings[r]))
        if not follow and crossing(p, q, t, u):
            return True
    return False


def touches(layers) -> bool:
    search = overlap_search(len(layers.points), 0.0)
    rings = layers.closed.size
    return classify_layer(layers.points, layers.ring_starts, layers.closed, 0, rings, search) == TOUCHING


def star(rng, points, centre, scale):
    """A ring that goes around its centre once, on whole numbers."""
    angle = np.sort(rng.random(points)) * 2 * np.pi
    radius = rng.uniform(0.3, 1.0, points) * scale
    return np.rint(np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1) + centre)


def test_the_tree_finds_what_all_pairs_find():
    rng = np.random.default_rng(7)
    found = []
    for _ in range(300):
        rings = [
            star(rng, rng.integers(3, 60), rng.integers(-60, 60, 2), rng.choice([10, 40, 80, 500]))
            for _ in range(rng.integers(1, 4))
        ]
        layers = from_rings([0.0], [rings])
        expected = meets_anywhere([layers.ring(r).tolist() for r in range(layers.closed.size)])
        assert touches(layers) == expected
        found.append(expected)
    assert 60 < sum(found) < 240  # both kinds are there


@pytest.mark.parametrize("points", [3, 7, 8, 9, 16, 17, 200, 1023])
def test_a_smooth_ring_is_clean_until_one_of_its_points_goes_across(points):
    angle = np.arange(points) * 2 * np.pi / points
    ring = 100 * np.stack([np.cos(angle), np.sin(angle)], 1)
    assert not touches(from_rings([0.0], [[ring]]))
    assert not touches(from_rings([0.0], [[ring, ring[::-1] * 0.999]]))
    assert touches(from_rings([0.0], [[ring, ring + np.array([1.0, 0.0])]]))
    if points > 5:
        for k in range(0, points, max(points // 9, 1)):
            dented = ring.copy()
            dented[k] *= -1.01
            assert touches(from_rings([0.0], [[dented]]))


@pytest.mark.parametrize("quarter", range(4))
@pytest.mark.parametrize("points", [1, 5, 40, 333])
def test_two_long_runs_of_one_ring_that_go_the_same_way_may_cross(points, quarter):
    corners = np.array([(0, 0), (90, 60), (30, -20), (70, 90), (-10, 90), (-10, 0)], float)
    apart = np.array([(0, 0), (90, 60), (30, -20), (150, 0), (150, 90), (-10, 90), (-10, 0)], float)
    turn = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), quarter)
    for outline, expected in ((corners, True), (apart, False)):
        steps = (np.arange(points) / points)[None, :, None]
        ring = outline[:, None] + steps * (np.roll(outline, -1, axis=0) - outline)[:, None]
        assert touches(from_rings([0.0], [[ring.reshape(-1, 2) @ turn.T]])) == expected


def test_open_paths_take_no_part():
    square = np.array([(0, 0), (4, 0), (4, 4), (0, 4)], float)
    across = np.array([(-1, 2), (5, 2.5), (2, -3), (2, 9)], float)
    assert not touches(from_rings([0.0], [[square]], [[across]]))
    assert not touches(from_rings([0.0], [[]], [[across]]))


def circles(rng, count):
    """Circles that neither touch nor cross, nested at random, either way around."""
    found: list[shapely.Polygon] = []
    for _ in range(60 * count):
        candidate = shapely.Point(rng.uniform(0, 100, 2)).buffer(rng.choice([2, 5, 12, 40]), quad_segs=5)
        if len(found) < count and all(candidate.boundary.distance(c.boundary) > 0.1 for c in found):
            found.append(candidate)
    return [(shapely.get_coordinates(c)[:-1][:: rng.choice([1, -1])], c) for c in found]


def test_rings_are_kept_where_the_winding_number_passes_between_0_and_1():
    rng = np.random.default_rng(3)
    dropped = 0
    for count in (1, 2, 5, 20, 60) * 4:
        made = circles(rng, count)
        layers = from_rings([0.0], [[ring for ring, _ in made]])
        direction = np.sign(layers.ring_areas).astype(int)
        shapes = [shapely.Polygon(layers.ring(r)) for r in range(layers.closed.size)]
        expected = []
        for r, shape in enumerate(shapes):
            outside = sum(
                int(direction[s]) for s, other in enumerate(shapes) if s != r and other.contains(shape)
            )
            expected.append((outside > 0) != (outside + direction[r] > 0))
        assert kept_rings(layers.points, layers.ring_starts, layers.closed).tolist() == expected
        kind = classify_layer(
            layers.points,
            layers.ring_starts,
            layers.closed,
            0,
            len(shapes),
            overlap_search(len(layers.points), 0.0),
        )
        assert kind == (CLEAN if all(expected) else NESTED_WRONG)
        dropped += expected.count(False)
    assert dropped > 20


def test_kinds_of_layers():
    square = np.array([(0, 0), (4, 0), (4, 4), (0, 4)], float)
    stack = [
        [square],
        [square[::-1]],
        [square, square + 2.0],
        [square, square * 0.25 + 1],
        [square, square[::-1] * 0.25 + 1],
        [],
    ]
    layers = from_rings(np.arange(len(stack)), stack)
    search = overlap_search(len(layers.points), 0.0)
    kinds = [
        classify_layer(layers.points, layers.ring_starts, layers.closed, a, b, search)
        for a, b in itertools.pairwise(layers.layer_starts.tolist())
    ]
    assert kinds == [CLEAN, NESTED_WRONG, TOUCHING, NESTED_WRONG, CLEAN, CLEAN]


def test_a_lattice_of_many_rings_is_ordered_and_clean():
    posts = [box((3 * i, 3 * k, 0), (3 * i + 1 + 0.1 * k, 3 * k + 1, 5)) for i in range(9) for k in range(8)]
    layers = ebamcheck.slice(join(*posts), [1.0, 2.0, 4.5], backend="planecut")
    assert layers.ring_counts().tolist() == [72, 72, 72]
    starts = layers.points[layers.ring_starts[:72]]
    assert starts.tolist() == sorted(starts.tolist())
    assert layers.areas() == pytest.approx([9 * sum(1 + 0.1 * k for k in range(8))] * 3)
