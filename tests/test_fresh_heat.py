"""Fresh heat beside the modes: against integrals, closed forms and plain sums."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from islands_of_a_plate import PROFILE, islands_of, times_of
from scipy.integrate import quad
from scipy.special import erf
from scipy.stats import norm
from shapely import affinity

from ebamcheck.heat import Medium
from ebamcheck.heat.balance import HeatColumn, LayerShape
from ebamcheck.heat.field import LEAST, Modes, Timetable, falling, surfaces_at_entries
from ebamcheck.heat.near_field import (
    FAR,
    OPTIONS,
    between_pieces,
    enclosed_share,
    entry_rise,
    exact_depth,
    island_tiles,
    line_pieces,
    of_layer,
)
from ebamcheck.heat.part_heat import AgedColumns, PartHeat
from ebamcheck.scan.order.entries import entry_points
from ebamcheck.settings.config import Config


@pytest.fixture(scope="module")
def choices():
    return islands_of(shapely.box(0, 0, 160, 110))


def test_pieces_hold_all_heat_and_follow_the_way(choices):
    schedule, lines = choices.known_schedule, choices.lines
    pieces = line_pieces((lines.island, lines.start, lines.end), choices.centroid, choices.area_mm2, 4.0)
    starts = pieces.first[:-1]
    assert np.add.reduceat(pieces.share, starts) == pytest.approx(1.0)
    for option in range(OPTIONS):
        # The middle of the heat comes half-way through the island's time.
        assert np.add.reduceat(pieces.share * pieces.passed[option], starts) == pytest.approx(0.5)
        for island in range(len(choices)):
            own = slice(pieces.first[island], pieces.first[island + 1])
            soonest = pieces.place[own][np.argmin(pieces.passed[option, own])]
            latest = pieces.place[own][np.argmax(pieces.passed[option, own])]
            assert np.hypot(*(soonest - schedule.entry[island, option])) <= 2.0 + 1e-9
            assert np.hypot(*(latest - schedule.leave[island, option])) <= 2.0 + 1e-9


def test_tiles_cover_their_islands_with_the_moments_of_their_areas():
    hexagon = shapely.Polygon([(math.cos(t) * 4, math.sin(t) * 4) for t in np.arange(6) * math.pi / 3])
    square = shapely.box(-3, -3, 3, 3)
    with_hole = square.difference(shapely.box(-1, -1, 1, 1))
    # Mean squares of the distance from the centroid: of a regular hexagon 5/12 of its side's, of a square a^2 / 6.
    moments = [5 / 12 * 16, 6.0, (36 * 6.0 - 4 * 4 / 6) / 32]
    for shift in ((0.0, 0.0), (300.0, -70.0)):
        islands = np.array([affinity.translate(p, *shift) for p in (hexagon, square, with_hole)], object)
        tiles = island_tiles(islands)
        away2 = ((tiles.place - shift) ** 2).sum(axis=1) + 2.0 * tiles.variance
        assert np.add.reduceat(tiles.share, tiles.first[:-1]) == pytest.approx(1.0)
        assert np.add.reduceat(tiles.share * away2, tiles.first[:-1]) == pytest.approx(moments)


def slivers(kind, random):
    """Polygons hard to cut: needles, notched strips, and what a shift of a polygon leaves of it."""
    thin = 10.0 ** random.uniform(-9, -1)
    if kind == "needle":
        length = 10.0 ** random.uniform(-1, 2)
        body = shapely.Polygon([(0, 0), (length, thin * random.uniform(-1, 1)), (0.7 * length, thin)])
    elif kind == "strip":
        x = np.sort(random.uniform(0, 10, 40))
        edges = np.c_[x, thin * random.normal(size=40)], np.c_[x[::-1], 0.5 + thin * random.normal(size=40)]
        body = shapely.make_valid(shapely.Polygon(np.concatenate(edges)))
    else:
        whole = shapely.make_valid(shapely.Polygon(random.uniform(0, 10, (7, 2))))
        body = whole.difference(affinity.translate(whole, *(thin * random.normal(size=2))))
    placed = affinity.translate(affinity.rotate(body, random.uniform(0, 360)), *random.uniform(-300, 300, 2))
    parts = shapely.get_parts(placed)
    return [p for p in parts if p.geom_type == "Polygon" and p.is_valid and p.area > 0.0]


@pytest.mark.parametrize("kind", ["needle", "strip", "cut"])
def test_slivers_are_cut_into_tiles_of_their_own_size(kind):
    random = np.random.default_rng(11)
    found = [p for _ in range(60) for p in slivers(kind, random)]
    islands = np.empty(len(found), object)
    islands[:] = found
    assert len(islands) >= 60
    tiles = island_tiles(islands)
    starts, owner = tiles.first[:-1], np.repeat(np.arange(len(islands)), np.diff(tiles.first))
    assert (np.diff(tiles.first) > 0).all()
    assert (tiles.share >= 0.0).all()
    assert (tiles.variance >= 0.0).all()
    assert np.add.reduceat(tiles.share, starts) == pytest.approx(1.0)
    size = shapely.minimum_bounding_radius(islands)
    assert (shapely.distance(shapely.convex_hull(islands)[owner], shapely.points(tiles.place)) < 2e-6).all()
    assert (tiles.variance <= (size[owner] + 2e-6) ** 2).all()
    # Where the corners are many roundings apart, the middle of the tiles is that of the island.
    middle = np.add.reduceat(tiles.share[:, None] * tiles.place, starts)
    away = np.hypot(*(middle - shapely.get_coordinates(shapely.centroid(islands))).T)
    wide = shapely.area(islands) > 1e-3 * shapely.length(islands)
    assert (away[wide] < 2e-2 * size[wide]).all()
    assert (away < 2.0 * size + 2e-6).all()


def layer_in_half_space(age_s):
    """Mean temperature of the layer by heat in it: a slab of 2 h in an endless body, averaged over half of it."""
    h = PROFILE.layer_height_mm
    x = h / np.sqrt(Medium.of(PROFILE).diffusivity_mm2_s * age_s)
    return (erf(x) - (1.0 - np.exp(-(x**2))) / (x * math.sqrt(math.pi))) / h


def test_the_function_of_the_depth_is_that_of_a_half_space(choices):
    age = np.array([0.05, 0.2, 1.0, 4.0])
    known = choices.cold_heat().model
    model = replace(known, medium=replace(known.medium, radiation_w_mm2k=0.0))
    found = of_layer(exact_depth(model), model, age)
    assert found == pytest.approx(layer_in_half_space(age), rel=0.01)
    # The few waves of the plan do not carry it while it is fresh.
    assert of_layer(model.depth, model, age)[0] < 0.7 * found[0]


@pytest.mark.parametrize("variance", [1.0, 9.0])
def test_the_share_in_sight_is_exact_on_borders_in_corners_and_in_walls(variance):
    sigma, wide = math.sqrt(variance), 1000.0
    half = shapely.box(0, -wide, wide, wide)
    points = np.array([[0.001, 0.0], [1.0, 0.0], [2.5, 0.0], [500.0, 0.0]])
    spread = np.full((4, 1), variance)
    # A mean over directions, so rounded by their number.
    assert enclosed_share(half, points, spread)[:, 0] == pytest.approx(norm.cdf(points[:, 0] / sigma), abs=0.01)
    corner = enclosed_share(shapely.box(0, 0, wide, wide), np.array([[1.0, 2.0]]), spread[:1])[0, 0]
    assert corner == pytest.approx(norm.cdf(1.0 / sigma) * norm.cdf(2.0 / sigma), abs=0.02)
    wall = enclosed_share(shapely.box(0, -wide, 3.0, wide), np.array([[1.0, 0.0]]), spread[:1])[0, 0]
    assert wall == pytest.approx(norm.cdf(2.0 / sigma) - norm.cdf(-1.0 / sigma), abs=0.02)


@pytest.mark.parametrize("fallen", [0.0, 0.3])
def test_late_heat_is_that_of_islands_one_by_one(fallen):
    """Amplitudes of modes that fall, hardly fall and do not, heated with pauses, against sums over the islands."""
    plane_rate = np.array([0.0, 1e-9, 1e-6, 3e-4, 0.05, 0.4, 2.0])
    depth_rate, in_layer = np.array([0.0, 2e-6, 0.1, 1.5]), np.array([1.0, 0.9, 0.5, 0.2])
    random = np.random.default_rng(4)
    mean, source = random.normal(size=(7, 5)), random.uniform(50.0, 200.0, 5)
    modes = Modes(mean, plane_rate, depth_rate, in_layer, source)
    start_s = np.array([0.0, 4.0, 8.5, 15.0, 19.0])
    end_s, order, age = start_s + np.array([4.0, 3.0, 5.0, 3.5, 6.0]), np.arange(5), 1.5 + fallen
    begun = random.normal(size=(7, 4))
    surface = surfaces_at_entries(modes.late(age), Timetable(order, start_s, end_s), age, begun, in_layer)
    rate = np.add.outer(plane_rate, depth_rate)
    for island in order:
        now = start_s[island]
        state = begun * np.exp(-rate * now)
        for earlier in range(island):
            oldest, youngest = now - start_s[earlier], max(now - end_s[earlier], age)
            if oldest > youngest:
                span = oldest - youngest
                held = np.where(rate > 0.0, -np.expm1(-rate * span) / np.where(rate > 0.0, rate, 1.0), span)
                state = state + source[earlier] * np.exp(-rate * youngest) * held * np.multiply.outer(
                    mean[:, earlier], in_layer
                )
        assert surface[island] == pytest.approx(state @ in_layer, rel=1e-8)


@pytest.mark.parametrize("since", [0.3, 1.0, 2.0])
def test_the_entry_is_as_hot_as_an_integral_over_the_moving_beam(choices, since):
    heat, schedule, lines = choices.cold_heat(), choices.known_schedule, choices.lines
    near = heat.fresh
    alpha, process = Medium.of(PROFILE).diffusivity_mm2_s, PROFILE.process
    middle = int(np.argmin(np.hypot(*(choices.centroid - [80.0, 55.0]).T)))
    pairs = choices.neighbours
    beside = int(np.setdiff1d(pairs[(pairs == middle).any(axis=1)], [middle])[0])
    time_s = schedule.time_s[beside]
    own = lines.island == beside
    a, b = lines.start[own], lines.end[own]
    edges = np.concatenate([[0.0], np.cumsum(np.hypot(*(b - a).T))])
    edges *= time_s / edges[-1]

    def rise(ago, point, width2):
        """Rate of the rise by the beam some time ago: in the plane a Gaussian, in the depth a half-space."""
        passed = time_s - (ago - since)
        n = min(int(np.searchsorted(edges, passed, side="right")) - 1, len(a) - 1)
        at = a[n] + (passed - edges[n]) / (edges[n + 1] - edges[n]) * (b[n] - a[n])
        variance = width2 + 2.0 * alpha * ago
        in_plane = math.exp(-0.5 * ((at - point) ** 2).sum() / variance) / (2.0 * math.pi * variance)
        return in_plane * float(layer_in_half_space(ago))

    youngest, oldest = since, min(since + time_s, near.horizon_s)
    bead2 = 2.0 * (0.25 * process.bead_width_mm) ** 2 + float(near.pieces.variance.mean())
    hottest = 0.0
    for option in range(OPTIONS):
        found = heat.modes.source_k_s[beside] * entry_rise(near, middle, option, beside, 0, since, time_s)
        knots = since + time_s - edges[1:-1]
        exact, _ = quad(
            rise,
            youngest,
            oldest,
            (schedule.entry[middle, option], bead2),
            points=knots[(knots > youngest) & (knots < oldest)],
            limit=200,
        )
        exact *= heat.modes.source_k_s[beside]
        hottest = max(hottest, exact)
        assert found == pytest.approx(exact, rel=0.1, abs=20.0)
    assert hottest > 100.0


def test_nothing_passes_a_gap():
    apart = islands_of(shapely.union_all([shapely.box(0, 0, 60, 60), shapely.box(60.5, 0, 120.5, 60)]))
    heat = apart.cold_heat()
    near = heat.fresh
    island = np.repeat(np.arange(len(apart)), np.diff(near.first))
    across = (apart.centroid[island, 0] < 60.25) != (apart.centroid[near.other, 0] < 60.25)
    assert across.any()
    assert not near.exact[near.pair[across]].any()
    order = np.lexsort((apart.centroid[:, 1], apart.centroid[:, 0]))
    start, end, _ = times_of(apart, order)
    _, points = entry_points(heat, apart.known_schedule, order, start, end)
    first_beyond = order[np.searchsorted(apart.centroid[order, 0], 60.25)]
    assert abs(points[first_beyond]) < 5.0


# -- what makes the heat of a plan fast leaves it what it is ------------------------------------------------


def test_a_falling_power_of_e_is_that_of_the_library():
    exponents = np.concatenate([-np.geomspace(1e-12, -LEAST, 500), [0.0]])
    found = np.array([falling(float(x)) for x in exponents])
    assert found == pytest.approx(np.exp(exponents), rel=1e-12, abs=1e-15)
    assert falling(-1e300) == falling(-np.inf) == pytest.approx(np.exp(LEAST), rel=1e-9)


def test_heat_between_islands_is_the_plain_sum_over_their_tiles():
    random = np.random.default_rng(1)
    first = np.array([0, 7, 7 + 12, 7 + 12 + 5])
    place, share = random.uniform(0.0, 40.0, (24, 2)), random.uniform(0.1, 1.0, 24)
    variance, spread = random.uniform(0.5, 2.0, 24), np.array([0.0, 3.0, 40.0])
    pairs = np.array([[0, 0], [0, 1], [1, 2]])
    found = between_pieces(first, place, share, variance, pairs, spread)
    for (one, other), row in zip(pairs, found, strict=True):
        a, b = np.arange(first[one], first[one + 1])[:, None], np.arange(first[other], first[other + 1])
        away = ((place[a] - place[b]) ** 2).sum(axis=-1)[..., None]
        wide = (variance[a] + variance[b])[..., None] + spread
        dense = np.where(away > FAR * wide, 0.0, np.exp(-0.5 * away / wide) / (2.0 * np.pi * wide))
        assert row == pytest.approx(((share[a] * share[b])[..., None] * dense).sum(axis=(0, 1)), rel=1e-12)


def test_a_column_after_a_wait_is_worked_out_once_and_is_the_one_waited_for():
    part, plain = (PartHeat(HeatColumn(Config())) for _ in range(2))
    for each in (part, plain):
        each.column.lay(LayerShape(2.0, 900.0, 120.0))
        each.column.advance(20.0, 8e4)
    aged = AgedColumns(part.column)
    assert aged.after(7.5) is aged.after(7.5)
    assert aged.after(0.0) is part.column
    found_k = part.bed_k(np.zeros(0), 7.5, None, aged)
    part.rest(7.5, aged)
    plain.rest(7.5)
    assert part.column.content.tobytes() == plain.column.content.tobytes()
    assert found_k == plain.bed_k(np.zeros(0)) < aged.after(0.0).bed_k
    assert part.column.radiated_j == plain.column.radiated_j
