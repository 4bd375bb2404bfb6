"""The feed profile against closed forms, laws, and the paper's over-accumulation at corners."""

from __future__ import annotations

import math

import numpy as np
import pytest
from nc_stack import make_curves, make_plan
from scipy.integrate import quad
from scipy.interpolate import make_interp_spline

from ebamcheck.errors import SettingsError
from ebamcheck.kinematics import feed_profile, polyline_profile, side_by_side
from ebamcheck.kinematics.limits import DrivenPath
from ebamcheck.kinematics.profile import _profile, fastest, ramp_time, time_to
from ebamcheck.layers.stack import from_rings
from ebamcheck.program import read_program, write_program
from ebamcheck.settings.config import Config

A, J = 300.0, 4000.0


def settings(speed=10.0, a=A, j=J, **more):
    return Config().changed(
        kinematics={"axis_acceleration_mm_s2": (a,) * 3, "axis_jerk_mm_s3": (j,) * 3},
        process={"travel_speed_mm_s": speed},
        **more,
    )


def ramp_length(first, last, a, j):
    return 0.5 * (first + last) * ramp_time(first, last, a, j)


def open_path(points, config):
    """Profile along the straight blocks between points, from rest to rest."""
    points = np.asarray(points, float)
    path = curve(points[:-1], points[1:], speed=config.process.travel_speed_mm_s)
    return _profile(path, config, ())


def curve(start, end, coefficients=None, arc=None, speed=10.0, runs=None):
    """A path of motions from their columns."""
    start, end = np.atleast_2d(start).astype(float), np.atleast_2d(end).astype(float)
    n = len(start)
    lines = np.zeros((n, 2, 4))
    lines[:, :, 0], lines[:, :, 1] = start, end - start
    c = lines if coefficients is None else np.asarray(coefficients, float)
    centre, sweep = np.full((n, 2), np.nan), np.full(n, np.nan)
    if arc is not None:
        centre, sweep = np.asarray(arc[0], float).reshape(n, 2), np.asarray(arc[1], float).reshape(n)
        length = np.linalg.norm(start - centre, axis=1) * np.abs(sweep)
    elif coefficients is None:
        length = np.linalg.norm(end - start, axis=1)
    else:
        length = np.array(
            [
                quad(lambda t: np.hypot(*(k[:, 1] + 2 * k[:, 2] * t + 3 * k[:, 3] * t * t)), 0, 1)[0]  # noqa: B023
                for k in c
            ]
        )
    z = np.zeros((n, 1))
    return DrivenPath(
        row=np.arange(n),
        run=np.zeros(n, np.int64) if runs is None else np.asarray(runs),
        layer=np.zeros(n, np.int64),
        ring=np.zeros(n, np.int64),
        deposit=np.ones(n, bool),
        start=np.hstack([start, z]),
        end=np.hstack([end, z]),
        coefficients=c,
        centre=centre,
        sweep_rad=sweep,
        feed_mm_s=np.full(n, speed),
        length_mm=length,
    )


# -- ramps -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("first", "last"), [(0.0, 5.0), (3.0, 60.0), (2.0, 2.5), (0.0, A * A / J)])
def test_a_ramp_is_what_its_jerk_integrates_to(first, last):
    """Acceleration and speed integrated in small steps from the jerk of the textbook's seven phases."""
    time = ramp_time(first, last, A, J)
    rise = min(A / J, 0.5 * time)
    t = np.linspace(0.0, time, 200001)
    jerk = np.where(t < rise, J, np.where(t > time - rise, -J, 0.0))
    step = t[1]
    acceleration = np.cumsum(jerk) * step
    speed = first + np.cumsum(acceleration) * step
    path = np.cumsum(speed) * step
    assert acceleration.max() <= A * (1 + 1e-3)
    assert speed[-1] == pytest.approx(last, rel=1e-3)
    assert path[-1] == pytest.approx(ramp_length(first, last, A, J), rel=1e-3)
    for k in (20000, 77777, 100000, 180000):
        took, way = time_to(first, last, speed[k], A, J)
        assert took == pytest.approx(t[k], rel=1e-3)
        assert way == pytest.approx(path[k], rel=2e-3, abs=1e-4)


def test_the_fastest_speed_is_inverse_to_length():
    got = fastest(2.0, 0.0, False, 3.0, 100.0, A, J)
    assert ramp_length(2.0, got, A, J) == pytest.approx(3.0, abs=1e-9)
    assert fastest(2.0, 0.0, False, 3.0, 4.0, A, J) == 4.0
    top = fastest(2.0, 6.0, True, 3.0, 100.0, A, J)
    assert ramp_length(2.0, top, A, J) + ramp_length(top, 6.0, A, J) == pytest.approx(3.0, abs=1e-9)


# -- closed forms ------------------------------------------------------------------------------------


def test_a_straight_line_without_jerk_limit_is_a_trapezoid():
    profile = open_path([(0, 0), (50, 0)], settings(10.0, j=1e12))
    assert profile.total_s == pytest.approx(50 / 10 + 10 / A, rel=1e-6)


def test_a_short_line_without_jerk_limit_is_a_triangle():
    profile = open_path([(0, 0), (0, 0.1)], settings(10.0, j=1e12))
    assert profile.total_s == pytest.approx(2 * math.sqrt(0.1 / A), rel=1e-6)
    assert profile.top[0] == pytest.approx(math.sqrt(A * 0.1), rel=1e-6)


@pytest.mark.parametrize("speed", [10.0, 45.0])
def test_a_straight_line_takes_the_time_of_the_s_curve(speed):
    ramp = speed / A + A / J if speed >= A * A / J else 2 * math.sqrt(speed / J)
    profile = open_path([(0, 0), (0, 500)], settings(speed))
    assert profile.total_s == pytest.approx(500 / speed + ramp, rel=1e-12)


def test_a_diagonal_has_the_acceleration_of_both_axes():
    straight, diagonal = (open_path([(0, 0), to], settings(20.0)) for to in ((90, 0), (90, 90)))
    assert diagonal.cells.acceleration_mm_s2[0] == pytest.approx(math.sqrt(2) * straight.cells.acceleration_mm_s2[0])
    config = settings(20.0).changed(kinematics={"axis_speed_mm_s": (200.0, 3.0, 200.0)})
    assert open_path([(0, 0), (90, 90)], config).top[0] == pytest.approx(3.0 * math.sqrt(2))


@pytest.mark.parametrize("radius", [0.1, 0.4, 5.0])
def test_speed_around_a_circle(radius):
    config = settings(10.0, j=1e12)
    sweep = 3.0 * np.pi
    path = curve((radius, 0), (-radius, 0), arc=((0, 0), sweep))
    expected = min(10.0, math.sqrt(config.kinematics.curvature_share * A * radius))
    profile = _profile(path, config, ())
    assert profile.top.max() == pytest.approx(expected, rel=1e-9)
    inner = profile.top[1:-1]
    assert inner == pytest.approx(np.full(inner.size, expected), rel=1e-9)


def test_the_jerk_of_a_circle_limits_its_speed():
    path = curve((0.4, 0), (-0.4, 0), arc=((0, 0), 3 * np.pi))
    profile = _profile(path, settings(10.0, a=1e6), ())
    assert profile.top.max() == pytest.approx((J * 0.4**2) ** (1 / 3), rel=1e-9)


def test_a_parabola_is_slowest_at_its_vertex():
    """y = x^2 / (2 r): curvature 1 / r at the vertex, and (1 + x^2 / r^2)^(-3/2) / r beside it."""
    r, x = 0.2, 8.0
    c = np.zeros((1, 2, 4))
    c[0, 0, :2] = -x, 2 * x
    c[0, 1, :3] = np.array([x * x, -4 * x * x, 4 * x * x]) / (2 * r)
    y = x * x / (2 * r)
    path = curve((-x, y), (x, y), c)
    config = settings(10.0, j=1e12)
    profile = _profile(path, config, ())
    slowest = profile.top.min() if profile.top.size > 2 else 0
    assert slowest <= math.sqrt(0.8 * A * r) * (1 + 1e-9)
    assert profile.top.max() == pytest.approx(10.0)
    assert profile.cells.length_mm.sum() == pytest.approx(path.length_mm[0], rel=1e-9)


def corner_speed(config, degrees, leg=100.0):
    turn = math.radians(degrees)
    profile = open_path([(-leg, 0), (0, 0), (leg * math.cos(turn), leg * math.sin(turn))], config)
    return float(profile.entry[1])


def test_a_square_corner_is_rounded_within_the_smoothing_tolerance():
    config = settings(10.0, j=1e12)
    e = config.machine.smoothing_tolerance_mm
    radius = e * math.cos(math.pi / 4) / (1 - math.cos(math.pi / 4))
    assert corner_speed(config, 90) == pytest.approx(math.sqrt(0.8 * A * radius), rel=1e-9)


def test_a_corner_without_smoothing_takes_the_jump_of_the_axes():
    config = settings(10.0, machine={"smoothing": ("SOFT", "G64")})
    assert corner_speed(config, 90) == pytest.approx(config.kinematics.speed_jump_mm_s)
    assert corner_speed(config, 180) == pytest.approx(config.kinematics.speed_jump_mm_s / 2)
    exact = settings(10.0, machine={"smoothing": ("SOFT", "G60")})
    assert corner_speed(exact, 5) == 0.0
    assert corner_speed(exact, 0) == 10.0


def test_sharper_corners_are_slower_and_those_of_the_papers_140_degrees_are_not_slow():
    config = Config()
    speeds = [corner_speed(config, 180 - inner) for inner in (160, 140, 120, 85, 45, 20)]
    assert speeds == sorted(speeds, reverse=True)
    share = np.array(speeds) / config.process.travel_speed_mm_s
    assert share[0] == share[1] == 1.0
    assert share[4] < 0.6


def test_a_short_block_leaves_no_room_for_rounding():
    config = Config()
    assert corner_speed(config, 60, leg=0.05) < corner_speed(config, 60, leg=5.0)


# -- laws --------------------------------------------------------------------------------------------


def zigzag(seed, count=60):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(0, rng.choice([0.05, 1.0, 8.0], count)[:, None], (count, 2)), axis=0)


@pytest.mark.parametrize("seed", range(8))
def test_driven_backwards_it_takes_the_same_time(seed):
    points = zigzag(seed)
    there, back = (open_path(p, Config()) for p in (points, points[::-1]))
    assert there.total_s == pytest.approx(back.total_s, rel=1e-12)
    assert there.top == pytest.approx(back.top[::-1], rel=1e-9)
    assert there.dips["excess_mm3"].sum() == pytest.approx(back.dips["excess_mm3"].sum(), rel=1e-9)


@pytest.mark.parametrize("scale", [0.1, 7.0])
def test_lengths_and_limits_scaled_alike_leave_the_time(scale):
    points = zigzag(3)
    base = settings(10.0)
    axes = base.kinematics
    scaled = base.changed(
        process={"travel_speed_mm_s": 10.0 * scale},
        machine={"smoothing_tolerance_mm": base.machine.smoothing_tolerance_mm * scale},
        kinematics={
            name: tuple(v * scale for v in getattr(axes, name))
            for name in ("axis_speed_mm_s", "axis_acceleration_mm_s2", "axis_jerk_mm_s3")
        }
        | {"speed_jump_mm_s": axes.speed_jump_mm_s * scale},
    )
    assert open_path(points * scale, scaled).total_s == pytest.approx(open_path(points, base).total_s, rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_turned_by_a_right_angle_and_mirrored_it_is_the_same(seed):
    points = zigzag(seed)
    expected = open_path(points, Config()).total_s
    assert open_path(points[:, ::-1], Config()).total_s == pytest.approx(expected, rel=1e-12)
    assert open_path(points * (-1, 1), Config()).total_s == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_more_room_is_never_slower_and_the_feed_never_beaten(seed):
    points = zigzag(seed)
    slow = open_path(points, settings(10.0, a=200.0, j=2000.0))
    fast = open_path(points, settings(10.0, a=400.0, j=4000.0))
    assert fast.total_s <= slow.total_s
    assert (fast.top <= 10.0).all()
    assert fast.total_s >= fast.cells.length_mm.sum() / 10.0


@pytest.mark.parametrize("seed", range(6))
def test_ramps_meet_and_keep_within_their_cells(seed):
    profile = open_path(zigzag(seed), Config())
    cells = profile.cells
    assert (profile.exit[:-1] == profile.entry[1:]).all()
    assert profile.entry[0] == profile.exit[-1] == 0.0
    for c in range(len(profile.top)):
        a, j = cells.acceleration_mm_s2[c], cells.jerk_mm_s3[c]
        used = ramp_length(profile.entry[c], profile.top[c], a, j) + ramp_length(profile.exit[c], profile.top[c], a, j)
        assert used <= cells.length_mm[c] * (1 + 1e-9) + 1e-12
        assert max(profile.entry[c], profile.exit[c]) <= profile.top[c] * (1 + 1e-12)


def sampled(profile, c: int, count: int):
    """Places along a cell, mm, and the speeds there: it rises to the top, holds it, and falls."""
    cells, top = profile.cells, profile.top[c]
    at = np.linspace(0.0, cells.length_mm[c], count)
    speed = np.full(count, top)
    for end, place in ((profile.exit[c], at[-1] - at), (profile.entry[c], at)):
        speeds = np.linspace(end, top, 257)
        limits = cells.acceleration_mm_s2[c], cells.jerk_mm_s3[c]
        paths = [time_to(end, top, reached, *limits)[1] for reached in speeds]
        speed = np.where(place < paths[-1], np.interp(place, paths, speeds), speed)
    return at, speed


def test_slow_stretches_are_those_of_the_sampled_speed():
    profile = open_path(zigzag(1, 40), Config())
    before = np.cumsum(profile.cells.length_mm) - profile.cells.length_mm
    found = [sampled(profile, c, 4001) for c in range(profile.top.size)]
    place = np.concatenate([start + at for start, (at, _) in zip(before, found, strict=True)])
    speed = np.concatenate([speeds for _, speeds in found])
    slow = speed < 0.95 * 10.0
    step = np.diff(place)
    length = step[slow[:-1] & slow[1:]].sum()
    assert profile.slow["length_mm"].sum() == pytest.approx(length, rel=2e-2)
    assert profile.slow["time_s"].sum() == pytest.approx(
        (step / np.maximum(0.5 * (speed[1:] + speed[:-1]), 1e-9))[slow[:-1] & slow[1:]].sum(), rel=5e-2
    )


def test_metal_too_much_at_one_corner():
    """From the definition: the wire gives v_set A, the path takes v A."""
    config = settings(10.0)
    profile = open_path([(-50, 0), (0, 0), (0, 50)], config)
    dips = profile.dips
    assert len(dips) == 1
    corner = float(profile.entry[1])
    assert dips.least_mm_s[0] == pytest.approx(corner)
    area = 2 / 3 * config.process.bead_width_mm * config.layer_height_mm
    half, path = time_to(corner, 10.0, 9.5, A, J)
    assert dips.excess_mm3[0] == pytest.approx(area * (10.0 * 2 * half - 2 * path), rel=1e-9)
    assert dips.metal_per_mm[0] == pytest.approx(10.0 / corner)
    assert set(profile.slow["sort"]) == {"start", "dip", "end"}


# -- programs ----------------------------------------------------------------------------------------


def smooth_ring(count):
    """An oval as one closed spline through `count` points, and the points."""
    angle = np.linspace(0, 2 * np.pi, count + 1)
    points = np.column_stack([40 * np.cos(angle), 25 * np.sin(angle)])
    points[-1] = points[0]
    length = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    natural = make_interp_spline(length, points, k=3, bc_type="periodic")
    slope = natural(0.0, nu=1)
    spline = make_interp_spline(length, points, k=3, bc_type=([(1, slope)], [(1, slope)]))
    return spline, points[:-1]


@pytest.mark.parametrize("form", ["poly", "bspline", "arcs"])
def test_no_dips_on_a_smooth_ring(form, tmp_path):
    spline, _ = smooth_ring(48)
    curves = make_curves([1.0], [[[(spline.c, spline.t)]]], [True])
    config = Config().changed(machine={"curve_form": form})
    files = write_program(curves, make_plan([1.0], []), config, tmp_path / form)
    nc = read_program(files.main, config)
    profile = feed_profile(nc, config)
    assert len(profile.dips) == 0
    assert sorted(profile.slow["sort"]) == ["end", "start"]
    assert profile.slow["where"].str.startswith("MAIN_L0001.SPF:").all()
    table = profile.layer_table()
    assert table.least_share[0] == 1.0
    assert table.deposit_s[0] > table.constant_feed_s[0]


def test_a_coarse_polyline_dips_where_the_spline_does_not(tmp_path):
    spline, points = smooth_ring(5)
    curves = make_curves([1.0], [[[(spline.c, spline.t)]]], [True])
    config = Config()
    files = write_program(curves, make_plan([1.0], []), config, tmp_path / "p")
    table = side_by_side(read_program(files.main, config), from_rings([1.0], [[points]]), config)
    assert table.dips["program"] == 0
    assert table.dips["polyline"] >= 2
    assert table.excess_mm3["polyline"] > 0.0
    assert table.least_share["polyline"] < 0.95


def test_a_dip_is_named_by_its_line(tmp_path):
    square = np.array([(0, 0), (0, 30), (30, 30), (30, 0), (0, 0)], float)
    curves = make_curves([1.0], [[[(square, None)]]], [True])
    config = Config()
    files = write_program(curves, make_plan([1.0], []), config, tmp_path / "p")
    dips = feed_profile(read_program(files.main, config), config).dips
    text = (files.folder / "MAIN_L0001.SPF").read_text().split("\n")
    assert len(dips) == 3
    assert [text[int(w.split(":")[1]) - 1].split(" ", 1)[1][:3] for w in dips["where"]] == ["G1 "] * 3 or all(
        "X" in text[int(w.split(":")[1]) - 1] for w in dips["where"]
    )


def test_a_motion_without_a_feed_is_refused(tmp_path):
    square = np.array([(0, 0), (0, 30), (30, 30), (0, 0)], float)
    config = Config()
    files = write_program(
        make_curves([1.0], [[[(square, None)]]], [True]), make_plan([1.0], []), config, tmp_path / "p"
    )
    path = files.folder / "MAIN_L0001.SPF"
    path.write_text(path.read_text().replace(" F600", " F0"))
    with pytest.raises(SettingsError, match=r"MAIN_L0001\.SPF:\d+: a motion without a feed"):
        feed_profile(read_program(files.main, config), config)


def test_no_motion_takes_no_time(tmp_path):
    layers = from_rings([1.0], [[]])
    profile = polyline_profile(layers, Config())
    assert profile.total_s == 0.0
    assert len(profile.slow) == 0
    assert len(profile.layer_table()) == 0
