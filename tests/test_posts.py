"""The post-processors: each writes the same curves in its own language, and the text is read back."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nc_stack import hatch, make_curves, make_plan, stack
from planned_roles import as_planned
from posted_curves import (
    CONTROLS,
    EXACT,
    TEXT_CONTROLS,
    TOLERANCE_MM,
    WITHIN,
    arc_through,
    away,
    circle_points,
    curve_points,
    deviation,
    same_parameters,
    smooth_curves,
    with_arcs,
    wrote,
)
from scipy.interpolate import BSpline

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.nc.motions import ARC, POLYNOMIAL, RAPID, SPLINE_SPAN, STRAIGHT
from ebamcheck.program import mark_validated, read_program
from ebamcheck.settings.config import Config


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


def test_even_splines_are_written_without_intervals_and_read_by_the_profile(tmp_path):
    control = np.array([(0, 0), (5, 9), (12, -3), (20, 8), (26, 0), (30, 4), (40, 0)], float)
    curves = make_curves([0.8], [[[(control, np.array([0] * 4 + [9, 18, 27] + [36] * 4, float))]]], [False])
    machine = {"curve_form": "bspline", "bspline_shift": "uniform"}
    files, config = wrote(tmp_path, machine, curves)
    text = (files.folder / "MAIN_L0001.SPF").read_text()
    assert "BSPLINE SD=3" in text
    assert "PL=" not in text
    nc = read_program(files.main, config)
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


def test_a_part_without_a_spline_is_written_where_splines_are_asked_for(tmp_path):
    square = np.array([(0, 0), (9, 0), (9, 9), (0, 9), (0, 0)], float)
    curves = make_curves([1.0], [[[(square, None)]]], [True])
    files, config = wrote(tmp_path, {"curve_form": "bspline"}, curves)
    assert set(read_program(files.main, config).kind) <= {RAPID, STRAIGHT}


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


# -- files -----------------------------------------------------------------------------------------------


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


# -- heat simulator --------------------------------------------------------------------------------


def test_the_path_of_a_heat_simulator_is_that_of_the_beads(tmp_path):
    curves, plan = smooth_curves(), make_plan([0.8], [(0, hatch(-10, -10, 3, 12.0))])
    path = wrote(tmp_path, {"control": "3dthesis"}, curves, plan, "3dthesis")[0].main
    assert path.name == "Path.txt"
    thesis = np.loadtxt(path, skiprows=1)
    assert thesis[0, 0] == 1  # it begins with a spot
    assert (thesis[:, 5] > 0).all()
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
