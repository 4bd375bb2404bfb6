"""The post-processors: each writes the same curves in its own language, and the text is read back."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from nc_stack import hatch, make_curves, make_plan, stack
from scipy.interpolate import BSpline

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.program import mark_validated, read_program, write_program
from ebamcheck.program.checking.matching import as_planned
from ebamcheck.program.reading.motions import ARC, POLYNOMIAL, RAPID, SPLINE_SPAN, STRAIGHT
from ebamcheck.settings.config import Config

CONTROLS = ("sinumerik-840d-sl", "linuxcnc", "plain-gcode", "3dthesis", "adamantine", "additivefoam")
TEXT_CONTROLS = CONTROLS[:3]

EXACT = {
    "poly": {"curve_form": "poly"},
    "bspline s=2": {"curve_form": "bspline", "bspline_shift": 2},
    "bspline s=3": {"curve_form": "bspline", "bspline_shift": 3},
    "bspline uniform": {"curve_form": "bspline", "bspline_shift": "uniform"},
    "linuxcnc": {"control": "linuxcnc"},
}
WITHIN = {
    "arcs": {"curve_form": "arcs"},
    "lines": {"curve_form": "lines"},
    "linuxcnc arcs": {"control": "linuxcnc", "curve_form": "arcs"},
    "linuxcnc lines": {"control": "linuxcnc", "curve_form": "lines"},
    "plain arcs": {"control": "plain-gcode"},
    "plain lines": {"control": "plain-gcode", "curve_form": "lines"},
}
TOLERANCE_MM = 0.01
"""Default of machine.line_tolerance_mm."""


def arc_through(centre, radius, first_rad, sweep_rad):
    """Control points of an arc piece: start, the point half-way, end."""
    at = first_rad + sweep_rad * np.array([0.0, 0.5, 1.0])
    return np.asarray(centre) + radius * np.column_stack([np.cos(at), np.sin(at)])


def with_arcs(curves):
    """Make every polyline of three points a circular arc."""
    sizes = np.diff(curves.control_starts)
    return replace(curves, kind=np.where((sizes == 3) & (curves.kind == 0), 2, curves.kind).astype(np.uint8))


def curve_points(curves, piece, count=400):
    """Points of a piece, by SciPy and by trigonometry; not by the code under test."""
    control = curves.control[curves.control_starts[piece] : curves.control_starts[piece + 1]]
    if curves.kind[piece] == 1:
        knots = curves.knots[curves.knot_starts[piece] : curves.knot_starts[piece + 1]]
        return BSpline(knots, control, 3)(np.linspace(0, knots[-1], count))
    if curves.kind[piece] == 0:
        return np.vstack([a + np.linspace(0, 1, count)[:, None] * (b - a) for a, b in pairwise(control)])
    return circle_points(*control, np.linspace(0, 1, count))


def circle_points(a, m, b, t):
    """Arc at shares t of its sweep through three points, by the circumcentre as the solution of two linear equations."""
    centre = np.linalg.solve(2.0 * np.array([m - a, b - a]), [m @ m - a @ a, b @ b - a @ a])
    angle = [np.arctan2(*(p - centre)[::-1]) for p in (a, m, b)]
    half = (angle[1] - angle[0] + np.pi) % (2 * np.pi) - np.pi
    at = angle[0] + 2 * half * t
    return centre + np.hypot(*(a - centre)) * np.column_stack([np.cos(at), np.sin(at)])


def spans_at(curves, t):
    """Every segment, knot span and arc of the curves at the parameters t, (E, t, 2), ring by ring."""
    found = []
    for piece in range(len(curves.kind)):
        control = curves.control[curves.control_starts[piece] : curves.control_starts[piece + 1]]
        if curves.kind[piece] == 1:
            knots = curves.knots[curves.knot_starts[piece] : curves.knot_starts[piece + 1]]
            spline = BSpline(knots, control, 3)
            found += [spline(a + (b - a) * t) for a, b in pairwise(np.unique(knots))]
        elif curves.kind[piece] == 0:
            found += [a + t[:, None] * (b - a) for a, b in pairwise(control)]
        else:
            found.append(circle_points(*control, t))
    return np.stack(found)


def same_parameters(nc, curves):
    """Largest distance of the contour motions from the curves at the same parameters."""
    t = np.linspace(0, 1, 11)
    nc = as_planned(nc, curves, None, Config())
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0))
    wanted = spans_at(curves, t)
    assert rows.size == len(wanted)
    driven = nc.evaluate(np.repeat(rows, t.size), np.tile(t, rows.size)).reshape(wanted.shape)
    return np.linalg.norm(driven - wanted, axis=2).max()


def away(points, polyline):
    """Largest distance of points from a polyline."""
    return shapely.distance(shapely.points(points), shapely.LineString(polyline)).max()


def deviation(nc, curves):
    """Largest distance, both ways, of the driven rings from the curves as shapes."""
    worst = 0.0
    nc = as_planned(nc, curves, None, Config())
    for ring in range(len(curves.closed)):
        first, last = curves.ring_starts[ring : ring + 2]
        rows = np.flatnonzero((nc.ring == ring) & nc.deposit)
        path = [nc.evaluate(np.full(50, row), np.linspace(0, 1, 50)) for row in rows]
        for piece in range(first, last):
            dense = curve_points(curves, piece, 4000)
            worst = max(worst, away(dense[::50], np.vstack(path)))
        whole = np.vstack([curve_points(curves, piece, 4000) for piece in range(first, last)])
        worst = max(worst, away(np.vstack([points[::7] for points in path]), whole))
    return worst


def smooth_curves():
    """A ring of a spline, two arcs and lines; a ring of four arcs; an open spline with double inner knots."""
    first = arc_through((0, 0), 30.0, 0.0, 1.2)
    second = arc_through((0, 0), 30.0, 1.2, 0.9)
    line = np.vstack([second[-1], [-45.0, 10.0], [-45.0, -5.0], [-40.0, -20.0]])
    knots = np.array([0, 0, 0, 0, 20, 20, 45, 45, 80, 80, 80, 80], float)
    spline = np.vstack([line[-1], [-25, -30], [0, -45], [12, -40], [20, -36], [28, -30], [30, -12], first[0]])
    quarter = [arc_through((100, 0), 8.0, -k * np.pi / 2, -np.pi / 2) for k in range(4)]
    for a, b in pairwise([*quarter, quarter[0]]):
        b[0] = a[2]
    path = np.array([(0, 60), (5, 72), (12, 75), (24, 62), (31, 55), (40, 60), (50, 66)], float)
    rings = [
        [(first, None), (second, None), (line, None), (spline, knots)],
        [(arc, None) for arc in quarter],
        [(path, np.array([0, 0, 0, 0, 15, 30, 45, 60, 60, 60, 60], float))],
    ]
    return with_arcs(make_curves([0.8], [rings], [True, True, False]))


def wrote(tmp_path, machine, curves, plan=None, name="program"):
    config = Config().changed(machine=machine)
    plan = plan if plan is not None else make_plan(curves.heights, [])
    return write_program(curves, plan, config, tmp_path / name), config


@pytest.mark.parametrize("form", EXACT)
def test_exact_forms_drive_the_curve(form, tmp_path):
    curves = smooth_curves()
    files, config = wrote(tmp_path, EXACT[form], curves)
    nc = read_program(files.main, config)
    assert same_parameters(nc, curves) < 2e-6


@pytest.mark.parametrize("form", WITHIN)
def test_other_forms_keep_to_their_tolerance(form, tmp_path):
    curves = smooth_curves()
    files, config = wrote(tmp_path, WITHIN[form], curves)
    nc = read_program(files.main, config)
    assert 1e-3 < deviation(nc, curves) < TOLERANCE_MM + 1e-5
    assert POLYNOMIAL not in nc.kind
    assert SPLINE_SPAN not in nc.kind
    assert (ARC in nc.kind) == True  # noqa: E712


# -- arcs ------------------------------------------------------------------------------------------

SWEEPS = (1e-6, 1e-3, 0.3, np.pi / 2, 3.0, np.pi - 1e-3, np.pi - 1e-7)


@pytest.mark.parametrize("control", TEXT_CONTROLS)
@pytest.mark.parametrize("sweep", SWEEPS)
def test_arcs_of_every_quadrant_and_sense(control, sweep, tmp_path):
    arcs = [
        arc_through((5 * k, -3 * k), 0.4 * 3**k, k * np.pi / 4 + 0.1, sense * sweep)
        for k in range(8)
        for sense in (1, -1)
    ]
    curves = make_curves([0.8], [[[(arc, None)] for arc in arcs]], [False] * len(arcs))
    curves = with_arcs(curves)
    files, config = wrote(tmp_path, {"control": control}, curves)
    nc = as_planned(read_program(files.main, config), curves, None, config)
    t = np.linspace(0, 1, 33)
    for ring, arc in enumerate(arcs):
        rows = np.flatnonzero((nc.ring == ring) & nc.deposit)
        if np.abs(arc[2] - arc[0]).max() < 1e-6:
            assert rows.size <= 1  # rounding may leave nothing of an arc of a micrometre
            continue
        assert rows.size == 1
        driven = nc.evaluate(np.repeat(rows, t.size), t)
        assert np.linalg.norm(driven - circle_points(*arc, t), axis=1).max() < 1.1e-5
        centre, turn = nc.arc[rows[0], :2], nc.arc[rows[0], 2]
        if nc.kind[rows[0]] == ARC:
            assert np.sign(turn) == (1 if ring % 2 == 0 else -1)
            # Rounded ends move the sagitta by 1e-6 mm, which is an eighth of chord times sweep.
            chord = np.linalg.norm(arc[2] - arc[0])
            assert abs(turn) == pytest.approx(sweep, abs=1e-9 + 8e-6 / chord)
            radii = np.hypot(*(nc.start[rows[0], :2] - centre)), np.hypot(*(nc.end[rows[0], :2] - centre))
            assert abs(radii[0] - radii[1]) < 2e-6
        else:
            assert np.linalg.norm(arc[1] - (arc[0] + arc[2]) / 2) < 1.1e-5


def test_an_arc_that_rounding_makes_a_point_is_no_full_circle(tmp_path):
    tiny = arc_through((0, 0), 1e-7, 0.0, 3.0)
    curves = with_arcs(make_curves([0.8], [[[(tiny, None)]]], [False]))
    for control in TEXT_CONTROLS:
        files, config = wrote(tmp_path, {"control": control}, curves)
        assert not read_program(files.main, config).deposit.any()


@given(st.integers(0, 2**32 - 1), st.floats(1e-4, 1.0))
@settings(max_examples=12, deadline=None)
def test_arcs_in_place_of_splines_are_within_tolerance_and_tangential(tmp_path_factory, seed, tolerance_mm):
    rng = np.random.default_rng(seed)
    control = np.cumsum(rng.uniform(2, 9, (9, 2)) * [1, 0] + rng.uniform(-6, 6, (9, 2)) * [0, 1], axis=0)
    knots = np.concatenate([np.zeros(4), np.arange(1, 6) * 8.0, np.full(4, 48.0)])
    curves = make_curves([0.8], [[[(control, knots)]]], [False])
    machine = {"curve_form": "arcs", "line_tolerance_mm": tolerance_mm, "decimals": 8}
    files, config = wrote(tmp_path_factory.mktemp("nc"), machine, curves)
    nc = read_program(files.main, config)
    dense = curve_points(curves, 0, 6000)
    rows = np.flatnonzero(nc.deposit)
    path = np.vstack([nc.evaluate(np.full(40, row), np.linspace(0, 1, 40)) for row in rows])
    assert away(path, dense) < tolerance_mm + 1e-5
    kinks = []
    for a, b in pairwise(rows):
        last, first = tangent(nc, a, 1.0), tangent(nc, b, 0.0)
        kinks.append(abs(np.angle(last * np.conj(first))))
    # The centre of an arc is rounded to 1e-8 mm, which turns the ends of one 0.05 mm long by 2e-7; flat ones more.
    assert max(kinks) < 1e-3


def tangent(nc, row, t):
    """Direction of a motion as a complex number."""
    if nc.kind[row] != ARC:
        return complex(*(nc.end[row, :2] - nc.start[row, :2]))
    at = nc.evaluate(np.array([row]), np.array([t]))[0] - nc.arc[row, :2]
    return complex(*at) * 1j * np.sign(nc.arc[row, 2])


# -- splines ---------------------------------------------------------------------------------------


def test_polynomials_and_linuxcnc_drive_the_same_curve(tmp_path):
    curves, plan = stack(seed=5, count=2)
    programs = []
    for name, machine in (("poly", {}), ("ngc", {"control": "linuxcnc"})):
        files, config = wrote(tmp_path, machine, curves, plan, name)
        programs.append(read_program(files.main, config))
    rows = [np.flatnonzero(nc.deposit) for nc in programs]
    assert rows[0].size == rows[1].size
    for t in np.linspace(0, 1, 9):
        a, b = (nc.evaluate(r, np.full(r.size, t)) for nc, r in zip(programs, rows, strict=True))
        assert np.abs(a - b).max() < 1e-5
    assert [nc.layer_heights.tolist() for nc in programs] == [[1.5, 3.0]] * 2
    assert np.array_equal(*(nc.power_w[r] for nc, r in zip(programs, rows, strict=True)))
    assert np.array_equal(*(nc.wire_mm_s[r] for nc, r in zip(programs, rows, strict=True)))
    assert programs[1].beam[rows[1]].all()
    assert programs[1].wire[rows[1]].all()
    pd_a, pd_b = (nc.vectors().drop(columns="row") for nc in programs)
    assert pd_a.equals(pd_b)


def test_g5_without_tangent_goes_on_tangentially(tmp_path):
    path = tmp_path / "A.ngc"
    path.write_text("G17 G21 G90 G94\nG0 X0 Y0 Z1\nG1 F60\nG5 I1 J2 P-1 Q0.5 X4 Y1\nP0 Q-1 X8 Y0\nM2\n")
    nc = read_program(path)
    assert nc.kind.tolist() == [RAPID, POLYNOMIAL, POLYNOMIAL]
    # Bezier points 0,0  1,2  3,1.5  4,1, then 4,1  5,0.5  8,-1  8,0.
    assert nc.evaluate(np.array([1]), np.array([0.5]))[0] == pytest.approx([2.0, 11.5 / 8])
    assert nc.evaluate(np.array([2]), np.array([0.5]))[0] == pytest.approx([51 / 8, (1 + 1.5 - 3) / 8])


def blossom_de_boor(control, knots, degree, u):
    """De Boor's algorithm in fractions."""
    u, k = Fraction(u), degree
    while not knots[k] <= u < knots[k + 1] and k < len(control) - 1:
        k += 1
    points = [control[j + k - degree] for j in range(degree + 1)]
    for r in range(1, degree + 1):
        for j in range(degree, r - 1, -1):
            low, high = knots[j + k - degree], knots[j + 1 + k - r]
            share = (u - low) / (high - low)
            points[j] = [(1 - share) * a + share * b for a, b in zip(points[j - 1], points[j], strict=True)]
    return [float(v) for v in points[degree]]


@pytest.mark.parametrize("shift", [2, 3])
def test_quadratic_splines_are_read(shift, tmp_path):
    control = [(0, 0), (5, 10), (15, 15), (28, 12), (34, 4)]
    knots = [0, 0, 0, 2, 5, 9, 9, 9]
    offset = shift - 1
    text = "G17\nG0 X0 Y0 Z1\nG1 F60\nBSPLINE SD=2\n"
    text += "".join(
        f"X{x} Y{y} PL={knots[i + offset] - knots[i + offset - 1]}\n" for i, (x, y) in enumerate(control) if i
    )
    (tmp_path / "A.MPF").write_text(text + "M30\n")
    nc = read_program(tmp_path / "A.MPF", bspline_shift=shift)
    rows = np.flatnonzero(nc.kind == SPLINE_SPAN)
    assert rows.size == 3
    for row, (a, b) in zip(rows, pairwise([0, 2, 5, 9]), strict=True):
        for share in (0.0, 0.25, 0.75):
            driven = nc.evaluate(np.array([row]), np.array([share]))[0]
            wanted = blossom_de_boor(control, knots, 2, a + (b - a) * Fraction(share))
            assert driven == pytest.approx(wanted, abs=1e-12)


def test_even_splines_are_written_without_intervals_and_read_by_the_header(tmp_path):
    control = np.array([(0, 0), (5, 9), (12, -3), (20, 8), (26, 0), (30, 4), (40, 0)], float)
    curves = make_curves([0.8], [[[(control, np.array([0] * 4 + [9, 18, 27] + [36] * 4, float))]]], [False])
    machine = {"curve_form": "bspline", "bspline_shift": "uniform"}
    files, _ = wrote(tmp_path, machine, curves)
    text = (files.folder / "MAIN_L0001.SPF").read_text()
    assert "BSPLINE SD=3" in text
    assert "PL=" not in text
    nc = read_program(files.main)  # the header says that the control chooses the intervals
    assert same_parameters(nc, curves) < 2e-6
    assert (nc.kind[nc.deposit] == SPLINE_SPAN).all()


def test_short_even_splines_stay_even(tmp_path):
    control = np.array([(0, 0), (5, 9), (12, -3), (20, 8), (26, 0)], float)
    curves = make_curves([0.8], [[[(control, np.array([0] * 4 + [9] + [18] * 4, float))]]], [False])
    files, config = wrote(tmp_path, {"curve_form": "bspline", "bspline_shift": "uniform"}, curves)
    nc = read_program(files.main, config)
    rows = np.flatnonzero(nc.deposit)
    assert rows.size == 4  # both spans are halved
    spline = BSpline(np.array([0] * 4 + [9] + [18] * 4, float), control, 3)
    for i, row in enumerate(rows):
        for t in (0.0, 0.3, 1.0):
            driven = nc.evaluate(np.array([row]), np.array([t]))[0]
            assert driven == pytest.approx(spline(4.5 * (i + t)), abs=2e-6)


def test_uneven_splines_for_such_a_control_are_polynomials_or_refused(tmp_path):
    curves = smooth_curves()
    machine = {"curve_form": "bspline", "bspline_shift": "uniform"}
    files, config = wrote(tmp_path, machine, curves)
    assert set(read_program(files.main, config).kind) == {RAPID, STRAIGHT, POLYNOMIAL, SPLINE_SPAN, ARC}
    with pytest.raises(SettingsError, match="uneven knots"):
        wrote(tmp_path, machine | {"poly_licensed": False}, curves)


@pytest.mark.parametrize("machine", [*EXACT.values(), *WITHIN.values()])
def test_no_form_without_its_licence(machine, tmp_path):
    options = machine | {"poly_licensed": False, "bspline_licensed": False}
    if machine.get("control", "sinumerik") == "sinumerik" and machine["curve_form"] in ("poly", "bspline"):
        with pytest.raises(SettingsError, match=r"does not have|said not to have"):
            wrote(tmp_path, options, smooth_curves())
        return
    if machine.get("curve_form") is None:
        options["curve_form"] = "arcs"
    files, _ = wrote(tmp_path, options, smooth_curves())
    words = {
        word for name in files.names for line in (files.folder / name).read_text().splitlines()
        if not line.startswith(";") for word in line.split()
    }  # fmt: skip
    assert not {"POLY", "BSPLINE"} & words


def test_fast_knots_are_stretched(tmp_path):
    """A spline that runs 100 mm for each mm of its knots would lose its shape to their rounding."""
    curves = smooth_curves()
    slow = replace(curves, knots=curves.knots / 100.0)
    for shift in (2, 3):
        files, config = wrote(tmp_path, {"curve_form": "bspline", "bspline_shift": shift}, slow)
        assert same_parameters(read_program(files.main, config), slow) < 1e-5


def test_rounding_of_corners_and_tangential_transitions_is_written_and_read(tmp_path):
    machine = {"smoothing": ["SOFT", "FFWON", "G645"], "smoothing_tolerance_mm": 0.03}
    files, config = wrote(tmp_path, machine, smooth_curves())
    events = read_program(files.main, config).events
    assert {"SOFT", "FFWON", "G645"} <= set(events.name)
    assert events.value[events.name.index("CTOL")] == 0.03


# -- decimals --------------------------------------------------------------------------------------


def test_decimals_follow_the_tolerances():
    auto = Config().machine
    assert auto.printed_decimals == 6
    assert auto.model_copy(update={"line_tolerance_mm": 1e-5}).printed_decimals == 7
    assert Config().changed(machine={"decimals": 4}).machine.printed_decimals == 4


# -- files -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("control", CONTROLS)
def test_every_post_is_stamped_and_deterministic(control, tmp_path):
    curves, plan = stack(count=2)
    files, _ = wrote(tmp_path, {"control": control}, curves, plan, "one")
    again, _ = wrote(tmp_path, {"control": control}, curves, plan, "two")
    assert files.sha256 == again.sha256
    assert not files.validated
    assert sum(files.blocks.values()) > 10
    before = {name: (files.folder / name).read_bytes() for name in files.names}
    stamped = mark_validated(files)
    for name in files.names:
        after = (files.folder / name).read_bytes()
        assert after != before[name]
        assert after == before[name].replace(b"; NOT VALIDATED", b"; VALIDATED", 1)
    assert mark_validated(stamped, False).sha256 == files.sha256
    wrote(tmp_path, {"control": control}, curves, plan, "one")  # takes the place of its own


@pytest.mark.parametrize("control", CONTROLS)
def test_no_post_writes_over_other_files(control, tmp_path):
    (tmp_path / "program").mkdir()
    (tmp_path / "program" / "Path.txt").write_text("Mode of transport\ntrain\n")
    with pytest.raises(SettingsError, match=r"Path\.txt"):
        wrote(tmp_path, {"control": control}, smooth_curves())


def test_an_unknown_control_is_refused_by_name(tmp_path):
    with pytest.raises(SettingsError, match="linuxcnc"):
        wrote(tmp_path, {"control": "heidenhain"}, smooth_curves())


def test_the_text_of_a_linuxcnc_program(tmp_path):
    square = np.array([(0, 0), (10, 0), (10, 10), (0, 0)], float)
    curves = make_curves([0.8], [[[(square, None)]]], [True])
    plan = make_plan([0.8], [(0, hatch(2, 2, 2, 6.0))])
    files, _ = wrote(tmp_path, {"control": "linuxcnc", "decimals": 3}, curves, plan)
    lines = files.main.read_text().splitlines()
    assert files.names == ("MAIN.ngc",)
    assert lines[:2] == ["; MAIN", "; NOT VALIDATED"]
    modes = ["G17 G21 G90 G91.1 G94", "G40 G49 G80", "G92.1", "G54", "G64 P0.05"]
    off = ["M65 P1 ; wire off", "M65 P0 ; beam off"]
    beam = ["M68 E0 Q60 ; accelerating voltage, kV", "M68 E1 Q120 ; beam current, mA"]
    on = [
        "M68 E1 Q120 ; beam current, mA",
        "M64 P0 ; beam on",
        "M68 E2 Q33.333333 ; wire speed, mm/s",
        "M64 P1 ; wire on",
    ]
    assert [line for line in lines[2:] if ": " not in line] == [
        *modes,
        *off,
        *beam,
        *modes,
        "(MSG, LAYER 1 OF 1)",
        *beam,
        "G0 Z21.676",
        "; RING 0",
        "G0 X0.000 Y0.000",
        "G0 Z1.676",
        *on,
        "G1 X10.000 Y0.000 F600",
        "G1 X10.000 Y10.000",
        "G1 X0.000 Y0.000",
        *off,
        "; ISLAND 0",
        "G0 X2.000 Y2.000",
        *on,
        "G1 X8.000 Y2.000 F600",
        "G1 X8.000 Y6.320 ; TURN",
        "G1 X2.000 Y6.320",
        *off,
        "G0 Z21.676",
        *off,
        "M67 E2 Q0 ; wire speed, mm/s",
        "M68 E0 Q0 ; accelerating voltage, kV",
        "M68 E1 Q0 ; beam current, mA",
        "G0 Z21.676",
        "G0 X0.000 Y0.000",
        "M2",
    ]


# -- heat simulators -------------------------------------------------------------------------------


def segments(path, skipped, blank):
    lines = path.read_text().splitlines()
    return np.array([[float(v) for v in line.split(blank)] for line in lines[skipped:]])


def test_paths_of_heat_simulators_are_the_same_path_in_their_own_units(tmp_path):
    curves, plan = smooth_curves(), make_plan([0.8], [(0, hatch(-10, -10, 3, 12.0))])
    files = {c: wrote(tmp_path, {"control": c}, curves, plan, c)[0].main for c in CONTROLS[3:]}
    thesis = segments(files["3dthesis"], 1, "\t")
    adamantine = segments(files["adamantine"], 3, " ")
    foam = segments(files["additivefoam"], 1, " ")
    assert [path.name for path in files.values()] == ["Path.txt", "scan_path.txt", "scanPath"]
    assert files["additivefoam"].parent.name == "constant"
    assert int(files["adamantine"].read_text().splitlines()[1]) == len(adamantine)
    assert thesis[0, 0] == 1  # all three begin with a spot
    assert (thesis[:, 5] > 0).all()
    scale = np.array([1, 1e-3, 1e-3, 1e-3, 1, 1])
    assert np.allclose(thesis * scale, adamantine, rtol=0, atol=1e-12)
    assert np.allclose(adamantine * [1, 1, 1, 1, 7200, 1], foam, rtol=0, atol=1e-12)
    line = thesis[:, 0] == 0
    assert (thesis[line, 4] == 1).all()
    assert (thesis[~line, 4] == 0).all()
    assert (thesis[line, 5] == 0.01).all()  # 10 mm/s in m/s
    assert (~line).sum() == 4  # three contours, and one hatch whose turns are under beam
    whole = np.vstack([curve_points(curves, p, 4000) for p in range(4)])
    ring = thesis[: np.flatnonzero(~line)[1], 1:3]
    assert away(ring, whole) < 1e-4  # the chords of the dense curve
    assert away(whole[::40], ring) < TOLERANCE_MM
    jump = np.linalg.norm(np.diff(thesis[:, 1:4], axis=0), axis=1)[~line[1:]]
    assert thesis[~line, 5][1:] == pytest.approx(jump / 100.0, rel=1e-6)


@pytest.mark.parametrize("control", CONTROLS[3:])
def test_path_tables_are_no_programs(control, tmp_path):
    files, config = wrote(tmp_path, {"control": control}, smooth_curves())
    with pytest.raises(InputError, match=r":1:1: the path table of a heat simulator"):
        read_program(files.main, config)


def test_a_stack_without_layers_is_a_file_that_does_nothing(tmp_path):
    for control in CONTROLS:
        files, config = wrote(tmp_path, {"control": control}, make_curves([], [], []))
        if control in TEXT_CONTROLS:
            assert not read_program(files.main, config).deposit.any()


# -- the reader of G-code --------------------------------------------------------------------------


def read_ngc(tmp_path, text, suffix="ngc"):
    path = tmp_path / f"TEST.{suffix}"
    path.write_text("G17 G21 G90 G94\nG0 X0 Y0 Z1 (start)\nG1 F60\n" + text + "\nM2\n")
    return read_program(path)


@pytest.mark.parametrize(
    ("block", "column", "message"),
    [
        ("G1 X10 U5", 8, "unknown word 'U5'"),
        ("N10 G1 X10 @ Y3", 12, "unknown word '@'"),
        ("G20", 1, "unknown word 'G20'"),
        ("G91 G1 X1", 1, "unknown word 'G91'"),
        ("G5.1 X1 Y2 I1 J1", 1, "unknown word 'G5.1'"),
        ("G5.2 P1 L3", 1, "unknown word 'G5.2'"),
        ("M3 S100", 1, "unknown word 'M3'"),
        ("#1=5", 1, "unknown word '#1=5'"),
        ("o100 call", 1, "unknown word 'O100'"),
        ("G1 X1 X2", 7, "X stands twice"),
        ("G1 X1 Y", 7, "unknown word 'Y'"),
        ("G1 (to X5 X5", 4, "a parenthesis without"),
        ("G1 X5 I2", 1, "I under G1"),
        ("G5 X1 Y2 P1 Q1", 1, "G5 without I and J"),
        ("G5 X1 Y2 I1 P1 Q1", 1, "I and J both or neither"),
        ("G5 X1 Y2 I1 J1 P1", 1, "takes P and Q"),
        ("G5 X1 Y2 Z3 I1 J1 P1 Q1", 1, "Z along G5"),
        ("G3 X11 Y10 I0 J10", 1, "radius 10 mm at the start"),
        ("G80\nX5", 1, "an axis before any of"),
    ],
)
def test_what_is_not_understood_is_refused_with_its_place(block, column, message, tmp_path):
    with pytest.raises(InputError) as caught:
        read_ngc(tmp_path, block)
    line = 4 + block.count("\n")
    assert str(caught.value).startswith(f"TEST.ngc:{line}:{column}: ")
    assert message in str(caught.value)


def test_plain_gcode_has_no_cubics(tmp_path):
    with pytest.raises(InputError, match=r"TEST\.gcode:4:1: unknown word 'G5'"):
        read_ngc(tmp_path, "G5 I1 J2 P3 Q4 X5 Y6", "gcode")


def test_spelling_and_comments_do_not_matter(tmp_path):
    plain = read_ngc(tmp_path, "G1 X10 Y-20.5\nG3 X0 Y-20.5 I-5 J0\nG1 X3")
    other = read_ngc(tmp_path, "n10 g01 x+10. (right) y -20.50\nG03 X0 I-5.0 J0\n\n; done\nN20G1X 3 ; home")
    assert np.array_equal(plain.end, other.end)
    assert np.array_equal(plain.arc, other.arc, equal_nan=True)
    assert plain.dialect == "linuxcnc"


@pytest.mark.parametrize("control", TEXT_CONTROLS)
def test_other_line_ends_read_the_same(control, tmp_path):
    curves, plan = stack(count=1)
    files, config = wrote(tmp_path, {"control": control}, curves, plan)
    before = read_program(files.main, config)
    for name in files.names:
        path = files.folder / name
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    after = read_program(files.main, config)
    assert np.array_equal(before.end, after.end, equal_nan=True)
    assert np.array_equal(before.coefficients, after.coefficients, equal_nan=True)
    assert np.array_equal(before.turn, after.turn)


@pytest.mark.parametrize("control", TEXT_CONTROLS)
def test_a_cut_off_file_has_no_end(control, tmp_path):
    files, config = wrote(tmp_path, {"control": control}, *stack(count=1))
    whole = read_program(files.main, config)
    assert all(file.end_line == file.line_count for file in whole.files)
    last = files.folder / files.names[-1]
    last.write_bytes(last.read_bytes()[:-20])
    cut = read_program(files.main, config)
    assert cut.files[-1].end_line == 0


@pytest.mark.parametrize("control", TEXT_CONTROLS)
def test_another_encoding_is_refused(control, tmp_path):
    files, config = wrote(tmp_path, {"control": control}, smooth_curves())
    last = files.folder / files.names[-1]
    text = last.read_text()
    last.write_text(text, encoding="utf-16")
    with pytest.raises(InputError, match=rf"{last.name}:1:1: unknown word"):
        read_program(last, config)
    last.write_text(text.replace("G0 Z", "G0 \u00a0Z", 1), encoding="utf-8")
    with pytest.raises(InputError, match=rf"{last.name}:\d+:\d+: unknown word"):
        read_program(files.main, config)


@pytest.mark.parametrize("control", TEXT_CONTROLS)
def test_one_unknown_word_in_the_middle_is_found(control, tmp_path):
    files, config = wrote(tmp_path, {"control": control}, *stack(count=1))
    last = files.folder / files.names[-1]
    lines = last.read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if i > 30 and ";" not in line)
    lines[at] += " W3"
    last.write_text("\n".join(lines) + "\n")
    with pytest.raises(
        InputError, match=rf"{last.name}:{at + 1}:{lines[at].index('W3') + 1}: unknown word 'W3'"
    ):
        read_program(files.main, config)


# -- an outside witness ----------------------------------------------------------------------------


@pytest.mark.skipif(
    importlib.util.find_spec("nc_gcode_interpreter") is None, reason="nc-gcode-interpreter is not installed"
)
@pytest.mark.parametrize("shift", [2, 3])
def test_an_outside_tokeniser_reads_the_same_control_points(shift, tmp_path):
    from nc_gcode_interpreter import nc_to_dataframe

    curves = smooth_curves()
    files, _ = wrote(tmp_path, {"curve_form": "bspline", "bspline_shift": shift, "beam_on": ["M60"]}, curves)
    # It knows neither the header nor assignments of H.
    lines = (files.folder / "MAIN_L0001.SPF").read_text().splitlines()
    text = "\n".join(line for line in lines if line[0] not in "%;" and " H" not in line)
    table, _ = nc_to_dataframe(text, extra_axes=["PL", "PW", "SD"], disable_forward_fill=True)
    spline = table.filter(table["PL"].is_not_null())
    found = np.column_stack([spline[name].to_numpy() for name in ("X", "Y", "PL")])
    first = 0
    for piece in np.flatnonzero(curves.kind == 1):
        control = curves.control[curves.control_starts[piece] : curves.control_starts[piece + 1]][1:]
        knots = curves.knots[curves.knot_starts[piece] : curves.knot_starts[piece + 1]]
        i = np.arange(1, len(control) + 1)
        block = found[first : first + i.size]
        first += i.size
        assert block[:, :2] == pytest.approx(control, abs=1e-6)
        # Knots may be stretched, all of a spline by the same factor, which leaves the curve as it is.
        interval = knots[i + shift] - knots[i + shift - 1]
        assert block[:, 2] / block[:, 2].sum() == pytest.approx(interval / interval.sum(), abs=1e-6)
    assert first == len(found)
