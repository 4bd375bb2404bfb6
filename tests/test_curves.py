"""Curves: laws of the fit, and geomdl, SciPy and closed forms as independent oracles."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from fitted_rings import (
    EXACT_MM,
    SQUARE,
    circle,
    one,
    paper_fit,
    path,
    raw,
    same_set,
    splines,
    stack,
    stadium,
    wavy,
)
from geomdl import BSpline as GeomdlBSpline
from scipy.interpolate import BSpline, make_interp_spline

from ebamcheck.curves import LINE, SPLINE, fit_deviation
from ebamcheck.layers.stack import concatenate, from_rings

# -- oracles ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("ring", [wavy(), stadium(), circle(24)], ids=["wavy", "stadium", "circle"])
def test_geomdl_and_scipy_evaluate_the_same_curve(ring: np.ndarray) -> None:
    curves = one(ring)
    for i in splines(curves):
        piece = curves.piece(i)
        at = np.linspace(0, piece.knots[-1], 97)
        ours = curves.evaluate(i, at)
        scipys = BSpline(piece.knots, piece.control, 3)(at)
        assert np.abs(ours - scipys).max() < EXACT_MM
        geomdls = GeomdlBSpline.Curve()
        geomdls.degree = 3
        geomdls.ctrlpts = piece.control.tolist()
        geomdls.knotvector = (piece.knots / piece.knots[-1]).tolist()
        theirs = np.array(geomdls.evaluate_list((at / at[-1]).tolist()))
        assert np.abs(ours - theirs).max() < EXACT_MM


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


def test_the_curve_passes_through_every_point_that_is_kept() -> None:
    curves = one(wavy())
    u = curves.piece(0).knots[3:-3]
    assert same_set(curves.evaluate(0, u[:-1]), wavy())


def test_a_circle_is_met_to_the_fourth_order() -> None:
    errors = []
    for count in (24, 48, 96):
        points = one(circle(count)).sample(0.05).points
        errors.append(np.abs(np.hypot(*points.T) - 20.0).max())
    assert errors[0] < 3e-4
    assert np.all(np.array(errors[:-1]) / errors[1:] > 14.0)  # 16 in the limit


def test_an_arc_between_corners_is_met_to_the_fourth_order() -> None:
    errors = []
    for count in (24, 48, 96):
        half = circle(2 * count, 20.0, 0.0)[: count + 1]
        points = path(half).sample(0.05).points
        errors.append(np.abs(np.hypot(*points.T) - 20.0).max())
    assert errors[0] < 3e-4
    assert np.all(np.array(errors[:-1]) / errors[1:] > 14.0)


def test_an_ellipse_is_met_far_better_than_by_its_polygon() -> None:
    t = np.arange(60) * (2 * np.pi / 60)
    points = one(np.column_stack([30 * np.cos(t), 15 * np.sin(t)])).sample(0.02).points
    off = np.abs(np.hypot(points[:, 0] / 30, points[:, 1] / 15) - 1) * 15
    assert off.max() < 1e-3  # the polygon misses by 0.04 mm


# -- corners, straight runs, tangents --------------------------------------------------------------


def test_a_square_stays_four_lines() -> None:
    curves = one(SQUARE)
    assert curves.kind.tolist() == [LINE] * 4
    assert curves.control[::2].tolist() == [[0, 0], [10, 0], [10, 10], [0, 10]]
    assert curves.block_count() == 4
    assert curves.knots.size == 0


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


def test_a_d_shape_keeps_its_straight_side_and_its_two_corners() -> None:
    half = circle(48, 20.0, -np.pi / 2)[:25]
    curves = one(half)
    assert sorted(curves.kind.tolist()) == [LINE, SPLINE]
    line = curves.piece(int(np.flatnonzero(curves.kind == LINE)[0])).control
    assert same_set(line, half[[0, -1]])
    arc = curves.evaluate(splines(curves)[0], np.linspace(0, curves.knots[-1], 500))
    assert np.abs(np.hypot(*arc.T) - 20).max() < 1e-4


@pytest.mark.parametrize("extra", [0, 7, 200])
def test_a_stadium_has_two_lines_and_two_tangent_arcs(extra: int) -> None:
    curves = one(stadium(extra=extra))
    assert sorted(curves.kind.tolist()) == [LINE, LINE, SPLINE, SPLINE]
    for i in splines(curves):
        control = curves.piece(i).control
        for leg in (control[1] - control[0], control[-1] - control[-2]):
            assert abs(leg[1]) < EXACT_MM * np.hypot(*leg)
    off = np.hypot(
        np.maximum(np.abs(curves.sample(0.1).points[:, 0]) - 20, 0), curves.sample(0.1).points[:, 1]
    )
    assert np.abs(off - 8).max() < 2e-3  # the polygon misses by 0.017 mm


def test_long_chords_of_a_large_circle_are_no_straight_runs() -> None:
    assert one(circle(36, 300.0), largest_bulge_mm=2.0).kind.tolist() == [SPLINE]


def test_a_run_that_leaves_its_chords_too_far_stays_a_polyline() -> None:
    ring = circle(36, 300.0)
    sagitta = 300.0 * (1.0 - np.cos(np.pi / 36))
    assert one(ring, largest_bulge_mm=0.98 * sagitta).kind.tolist() == [LINE]
    curves = one(ring, largest_bulge_mm=1.02 * sagitta)
    assert curves.kind.tolist() == [SPLINE]
    assert fit_deviation(curves, from_rings([1.0], [[ring]]))["bulge_mm"][0] == pytest.approx(
        sagitta, rel=1e-2
    )
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


def test_blocks_and_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    layers = concatenate([stack()] * 90)  # more layers than are fitted at a time
    whole = paper_fit(layers)
    monkeypatch.setenv("EBAMCHECK_THREADS", "1")
    single = paper_fit(layers)
    alone = paper_fit(stack())
    for field in ("control", "knots", "kind", "control_starts", "knot_starts", "ring_starts"):
        assert np.array_equal(getattr(whole, field), getattr(single, field)), field
        assert np.array_equal(getattr(whole.block(356, 360), field), getattr(alone, field)), field
