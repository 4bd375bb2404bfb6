"""Curves through points: laws of the fit, data it must not stumble over, and geomdl, SciPy and closed forms as oracles."""

from __future__ import annotations

from dataclasses import fields
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import shapely
from geomdl import NURBS
from geomdl import BSpline as GeomdlBSpline
from scipy.interpolate import BSpline, make_interp_spline

from benchmarks.curve_parts import heights_of
from ebamcheck.curves import ARC, LINE, SPLINE, Curves, fit, fit_deviation
from ebamcheck.curves.bezier import Arcs, arcs_through
from ebamcheck.curves.fitting import ungated
from ebamcheck.curves.interpolation import BULGE_LIMIT
from ebamcheck.errors import GeometryError, InputError, SettingsError
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.mesh.part import Part
from ebamcheck.plugins.registry import models
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.slicers.slicing import slice_part

paper_fit = partial(fit, method="paper")

EXACT_MM = 1e-9
SQUARE = [(0, 0), (10, 0), (10, 10), (0, 10)]


def circle(count: int, radius: float = 20.0, phase: float = 0.1) -> np.ndarray:
    t = phase + np.arange(count) * (2 * np.pi / count)
    return radius * np.column_stack([np.cos(t), np.sin(t)])


def wavy(count: int = 90) -> np.ndarray:
    t = np.arange(count) * (2 * np.pi / count) + 0.02 * np.sin(7 * np.arange(count))
    r = 30 + 3 * np.sin(5 * t) + 1.0 * np.cos(8 * t)
    return np.column_stack([r * np.cos(t), r * np.sin(t)])


def stadium(arc: int = 24, side: float = 40.0, radius: float = 8.0, extra: int = 0) -> np.ndarray:
    """Two half circles and two straight sides, tangent to each other."""
    t = np.linspace(-np.pi / 2, np.pi / 2, arc + 1)
    cap = radius * np.column_stack([np.cos(t), np.sin(t)])
    shift = np.array([side / 2, 0])
    along = np.linspace(0, 1, extra + 2)[1:-1, None]
    right, left = cap + shift, -cap - shift
    return np.vstack([right, right[-1] + along * (left[0] - right[-1]), left, left[-1] + along * (right[0] - left[-1])])


def one(ring: object, **settings: object) -> Curves:
    return paper_fit(from_rings([1.0], [[ring]]), **settings)


def path(points: object, **settings: object) -> Curves:
    return paper_fit(from_rings([1.0], [[]], [[points]]), **settings)


def raw(ring: np.ndarray, closed: bool = True) -> Layers:
    """A ring as it stands, without the canonical start point."""
    n = np.array([0, len(ring)])
    return Layers(np.zeros(1), np.asarray(ring, float), n, np.array([0, 1]), np.array([closed]))


def splines(curves: Curves) -> list[int]:
    return np.flatnonzero(curves.kind == SPLINE).tolist()


def same_set(a: np.ndarray, b: np.ndarray, tolerance: float = EXACT_MM) -> bool:
    """Whether every point of each set is one of the other."""
    d = np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])
    return bool(d.min(axis=0).max() < tolerance and d.min(axis=1).max() < tolerance)


def stack() -> Layers:
    """Rings with corners, without, with straight runs, holes, an open path and an empty layer."""
    hole = circle(40, 5.0)[::-1]
    half = np.vstack([circle(24, 10.0, 0.0)[:13], [(0.0, 0.0)]])
    return from_rings(
        [0.5, 1.0, 1.5, 2.0],
        [[wavy(), hole], [], [SQUARE, stadium() + 60.0], [half]],
        [[], [], [], [wavy()[:20] + 100.0]],
        part="p" * 8,
        backend="b",
    )


# -- oracles ---------------------------------------------------------------------------------------


def test_scipys_interpolation_gives_the_same_control_points() -> None:
    for ring, boundary in ((wavy(), "periodic"), (wavy()[:30], None)):
        curves = one(ring) if boundary else path(ring)
        piece = curves.piece(0)
        u = piece.knots[3:-3]
        data = curves.evaluate(0, u)
        if boundary is None:
            first, last = 3 * np.diff(piece.control, axis=0)[[0, -1]] / np.diff(u)[[0, -1], None]
            boundary = ([(1, first)], [(1, last)])
        theirs = make_interp_spline(u, data, k=3, bc_type=boundary)
        at = np.linspace(0, u[-1], 301)
        assert np.abs(theirs(at) - curves.evaluate(0, at)).max() < EXACT_MM


def test_knots_are_the_papers_centripetal_clamped_ones() -> None:
    ring = wavy()
    curves = path(ring[:30])
    piece = curves.piece(0)
    data = from_rings([0.0], [[]], [[ring[:30]]]).points
    chords = np.hypot(*np.diff(data, axis=0).T)
    u = np.concatenate([[0], np.cumsum(np.sqrt(chords))])
    expected = np.concatenate([[0] * 3, u / u[-1], [1] * 3])  # equations 6 and 7
    assert np.abs(piece.knots / piece.knots[-1] - expected).max() < 1e-14
    assert len(piece.control) == len(data) + 2  # n + 3 for n + 1 points
    assert piece.knots[-1] == pytest.approx(chords.sum())


def test_a_circle_is_met_to_the_fourth_order() -> None:
    errors = []
    for count in (24, 48, 96):
        points = one(circle(count)).sample(0.05).points
        errors.append(np.abs(np.hypot(*points.T) - 20.0).max())
    assert errors[0] < 3e-4
    assert np.all(np.array(errors[:-1]) / errors[1:] > 14.0)  # 16 in the limit


# -- corners, straight runs, tangents --------------------------------------------------------------


def test_points_along_the_sides_of_a_square_go() -> None:
    t = np.arange(0, 40, 0.37)
    dense = np.array([np.interp(t, [0, 10, 20, 30, 40], c) for c in ([0, 10, 10, 0, 0], [0, 0, 10, 10, 0])]).T
    corners = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
    at = np.searchsorted(t, [10, 20, 30])
    ring = np.insert(dense[t > 0], at - 1, corners[1:], axis=0)
    for shift in range(0, len(ring), 9):  # wherever the ring starts, also inside a side
        curves = paper_fit(raw(np.roll(np.vstack([corners[:1], ring]), shift, axis=0)))
        assert curves.kind.tolist() == [LINE] * 4
        assert same_set(curves.control, np.array(corners))


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("step_mm", [0.05, 0.5, 3.0, 30.0])
@pytest.mark.parametrize(("angle", "corner"), [(139.0, True), (141.0, False), (60.0, True), (170.0, False)])
def test_the_corner_angle_decides_at_any_density(step_mm: float, angle: float, corner: bool) -> None:
    # The path comes in on an arc, so that a smooth split leaves something to be tangent to the leg.
    t = np.arange(-99, 1)[:, None] * (np.pi / 200)
    arc = 50.0 * np.hstack([np.sin(t), 1 - np.cos(t)])
    turn = np.deg2rad(180 - angle)
    leg = np.outer(np.arange(step_mm, 30 + 1e-9, step_mm), [np.cos(turn), np.sin(turn)])
    ring = np.vstack([arc, leg])
    curves = path(ring)
    i = int(np.argmin(np.hypot(*curves.control[curves.control_starts[1:] - 1].T)))
    before, after = curves.piece(i).control, curves.piece(i + 1).control
    assert np.hypot(*before[-1]) < EXACT_MM
    a, b = before[-1] - before[-2], after[1] - after[0]
    bend = abs(np.rad2deg(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)))
    if corner:
        assert bend == pytest.approx(180 - angle, abs=1.0)
    else:
        assert bend < 1e-6


@pytest.mark.parametrize("extra", [0, 7, 200])
def test_a_stadium_has_two_lines_and_two_tangent_arcs(extra: int) -> None:
    curves = one(stadium(extra=extra))
    assert sorted(curves.kind.tolist()) == [LINE, LINE, SPLINE, SPLINE]
    for i in splines(curves):
        control = curves.piece(i).control
        for leg in (control[1] - control[0], control[-1] - control[-2]):
            assert abs(leg[1]) < EXACT_MM * np.hypot(*leg)
    off = np.hypot(np.maximum(np.abs(curves.sample(0.1).points[:, 0]) - 20, 0), curves.sample(0.1).points[:, 1])
    assert np.abs(off - 8).max() < 2e-3  # the polygon misses by 0.017 mm


def test_a_run_that_leaves_its_chords_too_far_stays_a_polyline() -> None:
    ring = circle(36, 300.0)
    sagitta = 300.0 * (1.0 - np.cos(np.pi / 36))
    assert one(ring, largest_bulge_mm=0.98 * sagitta).kind.tolist() == [LINE]
    curves = one(ring, largest_bulge_mm=1.02 * sagitta)
    assert curves.kind.tolist() == [SPLINE]
    assert fit_deviation(curves, from_rings([1.0], [[ring]]))["bulge_mm"][0] == pytest.approx(sagitta, rel=1e-2)
    polyline = one(ring, largest_bulge_mm=0.1)
    assert sorted(polyline.piece(0).control[:-1].tolist()) == sorted(ring.tolist())


def test_no_curve_leaves_its_contour_by_more_than_the_largest_bulge() -> None:
    rng = np.random.default_rng(7)
    theta = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    rings = [
        (20 + sum(rng.normal(0, 1.0 / k**2) * np.cos(k * theta + k) for k in range(2, 7)))[:, None]
        * np.column_stack([np.cos(theta), np.sin(theta)])
        for _ in range(50)
    ]
    layers = from_rings(np.arange(50.0), [[ring] for ring in rings])
    curves = paper_fit(layers, largest_bulge_mm=0.07)
    assert set(curves.kind.tolist()) == {LINE, SPLINE}
    assert fit_deviation(curves, layers)["bulge_mm"].max() <= 0.07 + 1e-9


@pytest.mark.parametrize("ring", [circle(24), wavy()], ids=["circle", "wavy"])
def test_a_ring_without_a_corner_closes_without_a_kink(ring: np.ndarray) -> None:
    curves = one(ring)
    spans = curves.bezier_spans()
    first, last = spans.points[0], spans.points[-1]
    h, g = spans.interval_mm[0], spans.interval_mm[-1]
    assert np.array_equal(first[0], last[3])
    assert np.abs((first[1] - first[0]) / h - (last[3] - last[2]) / g).max() < 1e-12
    bend = (first[2] - 2 * first[1] + first[0]) / h**2 - (last[3] - 2 * last[2] + last[1]) / g**2
    assert np.abs(bend).max() < 1e-11


def test_pieces_join_bit_for_bit_and_rings_close() -> None:
    curves = paper_fit(stack())
    for ring in range(curves.closed.size):
        pieces = [curves.piece(i).control for i in curves.pieces_of(ring)]
        for a, b in pairwise(pieces):
            assert np.array_equal(a[-1], b[0])
        assert np.array_equal(pieces[-1][-1], pieces[0][0]) == bool(curves.closed[ring])


# -- laws ------------------------------------------------------------------------------------------


@pytest.mark.in_turn(4)
@pytest.mark.parametrize("ring", [wavy(), stadium(), SQUARE], ids=["wavy", "stadium", "square"])
@pytest.mark.parametrize("change", ["turn", "shift", "mirror", "reverse", "roll"])
def test_turning_the_data_turns_the_curve(ring: object, change: str) -> None:
    ring = np.asarray(ring, float)
    c, s = np.cos(0.7), np.sin(0.7)
    moves = {
        "turn": lambda p: p @ np.array([[c, s], [-s, c]]),
        "shift": lambda p: p + np.array([123.0, -45.0]),
        "mirror": lambda p: p * [-1.0, 1.0],
        "reverse": lambda p: p[::-1],
        "roll": lambda p: np.roll(p, 11, axis=0),
    }
    move = moves[change]
    a, b = paper_fit(raw(ring)), paper_fit(raw(move(ring)))
    assert sorted(a.kind.tolist()) == sorted(b.kind.tolist())
    ends = move(a.bezier_spans().points[:, 0])
    inner = move(np.concatenate(list(a.bezier_spans().points[:, 1:3].transpose(1, 0, 2))))
    theirs = b.bezier_spans().points
    assert same_set(ends, theirs[:, 0])
    assert same_set(inner, theirs[:, 1:3].reshape(-1, 2))


def test_scaling_the_data_and_the_tolerances_scales_the_curve() -> None:
    tolerances = {
        "near_point_mm": 0.001,
        "collinear_mm": 0.001,
        "straight_run_mm": 5.0,
        "largest_bulge_mm": 0.2,
    }
    for ring in (wavy(), stadium(arc=300)):
        a = one(ring, **tolerances)
        b = one(ring * 8.0, **{name: value * 8.0 for name, value in tolerances.items()})
        assert np.abs(b.control - 8.0 * a.control).max() < EXACT_MM
        assert np.abs(b.knots - 8.0 * a.knots).max() < EXACT_MM


# -- data that a fit must not stumble over ------------------------------------------------------------------


def test_uneven_points_never_make_the_curve_leave_its_chords_far() -> None:
    rng = np.random.default_rng(5)
    paths = []
    for _ in range(400):
        turns = np.deg2rad(rng.uniform(-39.9, 39.9, 30))
        chords = 10.0 ** rng.uniform(-3, 2, 30)
        heading = np.cumsum(turns)
        paths.append(np.cumsum(chords[:, None] * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0))
    # The interpolation by itself: paths that cross themselves, as these do, are polylines of a whole fit.
    settings = CurveSettings(near_point_mm=0, collinear_mm=0, largest_bulge_mm=1e6)
    spans = ungated("paper", from_rings([0.0], [[]], [paths]), settings, None).bezier_spans()
    B = spans.points[spans.kind == SPLINE]
    chord = B[:, 3] - B[:, 0]
    length = np.hypot(*chord.T)
    assert len(B) > 5000
    for t in np.linspace(0, 1, 33)[1:-1]:
        at = (1 - t) ** 3 * B[:, 0] + 3 * (1 - t) ** 2 * t * B[:, 1] + 3 * (1 - t) * t**2 * B[:, 2] + t**3 * B[:, 3]
        f = np.clip(((at - B[:, 0]) * chord).sum(axis=1) / length**2, 0, 1)
        off = np.hypot(*(at - B[:, 0] - f[:, None] * chord).T)
        assert (off / length).max() < BULGE_LIMIT


@pytest.mark.in_turn(3)
@pytest.mark.parametrize(
    "ring",
    [
        [(0, 0), (1, 0), (0, 1)],
        [(0, 0), (10, 0), (10, 1e-9)],
        [(0, 0), (1e-5, 0), (1e-5, 1e-5), (0, 1e-5)],
        [(0, 0), (10, 0), (20, 1e-7), (10, 2e-7)],
        [(0, 0), (10, 0), (4, 1e-6), (12, 2e-6), (0, 5)],
        1e-4 * circle(50, 1.0),
        1e6 + circle(50, 1.0),
        np.repeat(circle(30), 3, axis=0) + np.tile([[0.0], [1e-10], [-1e-10]], (30, 1)),
    ],
    ids=["triangle", "sliver", "tiny", "flat", "spike", "tiny circle", "far", "triples"],
)
@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("angle", [140.0, 1.0, 179.0])
def test_degenerate_rings_give_finite_curves_that_end_where_they_should(
    ring: object, closed: bool, angle: float
) -> None:
    ring = np.asarray(ring, float)
    layers = raw(ring, closed)
    curves = paper_fit(layers, corner_angle_deg=angle)
    assert curves.closed.size == 1
    assert curves.kind.size >= 1
    assert np.isfinite(curves.control).all()
    assert np.isfinite(curves.lengths()).all()
    if not closed:
        assert np.array_equal(curves.control[0], ring[0])
        assert np.array_equal(curves.control[-1], ring[-1])
    if angle < 179:
        return
    low, high = ring.min(axis=0), ring.max(axis=0)
    room = 0.6 * np.hypot(*(high - low)) + 1e-12
    assert np.all(curves.control >= low - room)
    assert np.all(curves.control <= high + room)


@pytest.mark.parametrize(("points", "pieces"), [(0, 0), (1, 0), (2, 1)])
def test_rings_of_too_few_points_are_lines_or_nothing(points: int, pieces: int) -> None:
    ring = np.array([(0.0, 0.0), (3.0, 4.0)])[:points]
    for closed in (True, False):
        curves = paper_fit(raw(ring, closed))
        assert curves.kind.tolist() == [LINE] * pieces
        assert curves.lengths().sum() == (0 if points < 2 else (10 if closed else 5))
        assert fit_deviation(curves, raw(ring, closed))["points_mm"].max() == 0


def test_a_spike_is_kept() -> None:
    spike = [(0, 0), (10, 0), (10, 10), (5, 10), (5, 18), (5, 10.0005), (0, 10)]
    curves = one(spike)
    assert np.hypot(*(curves.control - [5, 18]).T).min() == 0


def test_cleaning_does_not_drift_along_a_slow_bend() -> None:
    fine = circle(40_000, 100.0)
    layers = from_rings([0.0], [[fine]])
    curves = paper_fit(layers)
    assert curves.block_count() < 1000
    assert fit_deviation(curves, layers)["points_mm"].max() < 0.0011
    assert np.abs(np.hypot(*curves.sample(0.1).points.T) - 100).max() < 0.0011


def test_inner_points_of_the_flats_of_a_cylinder_do_not_make_it_straight() -> None:
    """The section of a cylinder's mesh has a point on each chord, where it cuts a facet's diagonal."""
    corners = circle(36)
    inner = corners + 0.3 * (np.roll(corners, -1, axis=0) - corners)
    curves = one(np.stack([corners, inner], axis=1).reshape(-1, 2))
    assert curves.kind.tolist() == [SPLINE]
    assert curves.block_count() == 36
    assert np.abs(np.hypot(*curves.sample(0.1).points.T) - 20).max() < 1e-4


# -- arcs and splines of fitted curves, evaluated by our own code and by two others, and read from their file --


MODELS = models()


def sliced(part: Part, count: int) -> Layers:
    return slice_part(part, heights_of(part, count))


def arc_of(curves: Curves, i: int) -> Arcs:
    """The one arc of a piece."""
    arcs = arcs_through(curves.piece(i).control[None])
    return Arcs(*(column[0] for column in arcs))


def test_a_circle_is_written_as_arcs_of_its_radius() -> None:
    part = MODELS["cylinder"].tessellate(0.05)
    layers = sliced(part, 4)
    curves = fit(layers, part=part)
    assert set(curves.kind) == {ARC}
    assert curves.block_count() <= 3 * 4
    truth_mm = np.hypot(*layers.points.T).max()
    for i in range(curves.kind.size):
        arc = arc_of(curves, i)
        assert arc.radius == pytest.approx(truth_mm, abs=0.003)
        assert abs(np.degrees(arc.sweep)) <= 171.0


def test_geomdl_and_scipy_evaluate_every_piece_alike() -> None:
    part = MODELS["ladder"].tessellate(0.4)
    lifted = (fit(sliced(part, 2), method, part=part) for method in ("surface", "bounded"))
    for curves in (*lifted, *map(one, (wavy(), stadium(), circle(24)))):
        for i in range(curves.kind.size):
            piece = curves.piece(i)
            if piece.kind == SPLINE:
                at = np.linspace(0.0, piece.knots[-1], 17)
                ours = curves.evaluate(i, at)
                assert np.abs(ours - BSpline(piece.knots, piece.control, 3)(at)).max() < 1e-9
                other = GeomdlBSpline.Curve()
                other.degree = 3
                other.ctrlpts = piece.control.tolist()
                other.knotvector = (piece.knots / piece.knots[-1]).tolist()
                theirs = np.array(other.evaluate_list((at / piece.knots[-1]).tolist()))
                assert np.abs(ours - theirs).max() < 1e-9
            elif piece.kind == ARC:
                assert_is_rational_quadratic(curves, i)


def assert_is_rational_quadratic(curves: Curves, i: int) -> None:
    """The arc is geomdl's rational quadratic through the same ends, with the corner of the tangents between."""
    arc = arc_of(curves, i)
    start, end = curves.piece(i).control[[0, 2]]
    middle = arc.start + 0.5 * arc.sweep
    weight = np.cos(0.5 * arc.sweep)
    tip = arc.centre + arc.radius / weight * np.array([np.cos(middle), np.sin(middle)])
    curve = NURBS.Curve()
    curve.degree = 2
    curve.ctrlptsw = [[*start, 1.0], [*(weight * tip), weight], [*end, 1.0]]
    curve.knotvector = [0, 0, 0, 1, 1, 1]
    points = np.array(curve.evaluate_list(np.linspace(0.0, 1.0, 9).tolist()))
    assert np.abs(np.hypot(*(points - arc.centre).T) - arc.radius).max() < 1e-9
    half = curves.evaluate(i, [0.5 * abs(arc.sweep) * arc.radius])
    assert np.abs(half - points[4]).max() < 1e-9


def test_bezier_spans_of_an_arc_stay_on_it() -> None:
    part = MODELS["cylinder"].tessellate(0.05)
    curves = fit(sliced(part, 1), part=part)
    spans = curves.bezier_spans()
    t = np.linspace(0.0, 1.0, 7)[:, None, None]
    s = 1.0 - t
    B = spans.points
    points = s**3 * B[:, 0] + 3 * s * s * t * B[:, 1] + 3 * s * t * t * B[:, 2] + t**3 * B[:, 3]
    arcs = [arc_of(curves, i) for i in range(curves.kind.size)]
    for k, i in enumerate(spans.piece):
        off = np.hypot(*(points[:, k] - arcs[i].centre).T) - arcs[i].radius
        assert np.abs(off).max() < 1e-9
    assert curves.lengths().sum() == pytest.approx(sum(abs(a.sweep) * a.radius for a in arcs), rel=1e-9)


# -- sampling and measures -------------------------------------------------------------------------


def test_samples_lie_on_the_curve_no_farther_apart_than_the_step() -> None:
    curves = paper_fit(stack())
    for step in (0.05, 0.7, 1000.0):
        sampled = curves.sample(step)
        assert isinstance(sampled, Layers)
        assert len(sampled) == 4
        for r in range(sampled.closed.size):
            ring = sampled.ring(r)
            closing = [ring[:1]] if sampled.closed[r] else []
            assert np.hypot(*np.diff(np.vstack([ring, *closing]), axis=0).T).max() <= step + EXACT_MM
    assert np.abs(np.hypot(*one(circle(48)).sample(0.01).points.T) - 20).max() < 2e-5


def test_sample_tolerance_bounds_the_chord_error() -> None:
    curves = one(wavy())
    fine = curves.sample(0.005)
    for tolerance in (0.1, 0.001):
        coarse = curves.sample_tolerance(tolerance)
        line = shapely.LinearRing(coarse.points)
        assert shapely.distance(shapely.points(fine.points), line).max() < tolerance
    assert len(one(SQUARE).sample_tolerance(1e-6).points) == 4


def test_lengths_are_those_of_circle_and_square() -> None:
    assert one(circle(200)).lengths().sum() == pytest.approx(2 * np.pi * 20, rel=1e-8)
    assert one(SQUARE).lengths().tolist() == [10, 10, 10, 10]


def test_bezier_spans_are_the_curve() -> None:
    curves = paper_fit(stack())
    spans = curves.bezier_spans()
    assert len(spans) == curves.block_count()
    for i in range(curves.kind.size):
        mine = spans.points[spans.piece == i]
        h = spans.interval_mm[spans.piece == i]
        assert np.array_equal(mine[1:, 0], mine[:-1, 3])
        starts = np.concatenate([[0], np.cumsum(h)])
        for t in (0.0, 0.3, 1.0):
            at = np.stack([(1 - t) ** 3, 3 * (1 - t) ** 2 * t, 3 * (1 - t) * t**2, t**3]) @ mine
            assert np.abs(at - curves.evaluate(i, starts[:-1] + t * h)).max() < EXACT_MM
    assert np.array_equal(curves.ring_layer[spans.ring], spans.layer)


def test_fit_deviation_of_an_interpolating_fit_is_rounding() -> None:
    layers = stack()
    table = fit_deviation(paper_fit(layers), layers)
    assert table["kept_points_mm"].max() < 1e-12
    assert table["points_mm"].max() < 0.0011
    assert table["bulge_mm"].iloc[0] > 0.01
    assert table["blocks"].sum() == paper_fit(layers).block_count()
    assert table["bulge_mm"].iloc[1] == 0  # an empty layer


def test_fit_deviation_sees_a_curve_that_moved() -> None:
    layers = from_rings([0.0], [[circle(60)]])
    curves = paper_fit(layers)
    curves.control[:, 0] += 0.25
    table = fit_deviation(curves, layers)
    assert table["points_mm"][0] == pytest.approx(0.25, abs=2e-3)
    assert table["bulge_mm"][0] == pytest.approx(0.25, abs=0.03)


# -- files, settings, errors -----------------------------------------------------------------------


def test_parquet_brings_back_every_bit(tmp_path: Path) -> None:
    part = models()["prism"].tessellate(0.1)
    arcs = fit(slice_part(part, [20.0, 40.0]), part=part)
    assert {LINE, ARC} <= set(arcs.kind)
    for curves in (arcs, *map(paper_fit, (stack(), from_rings([], []), from_rings([1.0, 2.0], [[], []])))):
        curves.to_parquet(tmp_path / "c.parquet")
        back = Curves.from_parquet(tmp_path / "c.parquet")
        # The file holds curves; what speaks for them stands in the record of a run.
        for field in (f for f in fields(Curves) if f.name != "evidence"):
            ours, theirs = getattr(curves, field.name), getattr(back, field.name)
            if isinstance(ours, np.ndarray):
                assert ours.dtype == theirs.dtype, field.name
                assert np.array_equal(ours, theirs), field.name
            else:
                assert ours == theirs, field.name
        assert back.block_count() == curves.block_count()
    assert [p.name for p in tmp_path.iterdir()] == ["c.parquet"]


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    path_ = tmp_path / "c.parquet"
    paper_fit(stack()).to_parquet(path_)
    table = pq.read_table(path_)
    with pytest.raises(InputError, match="cannot be read"):
        Curves.from_parquet(tmp_path / "none.parquet")
    (tmp_path / "cut.parquet").write_bytes(path_.read_bytes()[:-100])
    with pytest.raises(InputError, match="cannot be read"):
        Curves.from_parquet(tmp_path / "cut.parquet")
    damaged = {
        "version": table.replace_schema_metadata({}),
        "missing": table.drop_columns(["knot"]),
        "same rings": table.set_column(
            table.schema.get_field_index("ring_pieces"),
            "ring_pieces",
            table["ring_pieces"].take([2, 1, 0, 3]),
        ),
        "should be": table.set_column(0, "height_mm", pa.array(["a"] * 4)),
        "not finite": table.set_column(0, "height_mm", pa.array([np.nan] * 4)),
    }
    for said, wrong in damaged.items():
        pq.write_table(wrong, tmp_path / "w.parquet")
        with pytest.raises(InputError, match=said):
            Curves.from_parquet(tmp_path / "w.parquet")


def test_wrong_requests_say_what_is_wrong() -> None:
    layers = from_rings([0.0], [[SQUARE]])
    with pytest.raises(SettingsError, match="'magic' is unknown: choose one of bounded, surface, chord, paper"):
        paper_fit(layers, method="magic")
    with pytest.raises(SettingsError, match="corner_angle_deg"):
        paper_fit(layers, corner_angle_deg=200)
    with pytest.raises(SettingsError, match="corner_angel"):
        paper_fit(layers, corner_angel=100)
    for step in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(SettingsError, match="positive"):
            paper_fit(layers).sample(step)
        with pytest.raises(SettingsError, match="positive"):
            paper_fit(layers).sample_tolerance(step)
    with pytest.raises(SettingsError, match="larger step"):
        paper_fit(layers).sample(1e-9)
    with pytest.raises(SettingsError, match="not fitted to these"):
        fit_deviation(paper_fit(layers), stack())
    bad = raw(np.array([(0.0, 0.0), (1.0, np.nan), (1.0, 1.0)]))
    with pytest.raises(GeometryError, match="layer 1"):
        paper_fit(bad)
