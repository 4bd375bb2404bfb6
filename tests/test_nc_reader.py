"""The reader: what a control would drive, from the text alone."""

from __future__ import annotations

import numpy as np
import pytest
from geomdl import BSpline
from hypothesis import given, settings
from hypothesis import strategies as st
from nc_stack import clamped_knots, stack
from scipy.integrate import quad

from ebamcheck.checks.state_checks import extremes
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.nc.motions import ARC, POLYNOMIAL, RAPID, SPLINE_SPAN, STRAIGHT
from ebamcheck.program import read_program, write_program
from ebamcheck.settings.config import Config

EXAMPLE = np.array([(0, 0), (5, 10), (15, 15), (28, 12), (34, 4), (40, 0)], float)
EXAMPLE_KNOTS = np.array([0, 0, 0, 0, 2, 5, 9, 9, 9, 9], float)
EXAMPLE_AT = {
    0: (0, 0),
    2: (12.555556, 12.933333),
    4.5: (23.947279, 12.219898),
    5: (25.800454, 11.292517),
    7: (32.439342, 6.125850),
    9: (40, 0),
}
"""Siemens syntax, values worked out by hand: the spline and its three polynomials."""

EXAMPLE_POLY = """G1 X0 Y0 F600
POLY PO[X]=(12.555556,-0.75,0.069444) PO[Y]=(12.933333,-6,0.866667) PL=2
PO[X]=(25.800454,-0.333333,0.009070) PO[Y]=(11.292517,-0.8,0.050340) PL=3
PO[X]=(40,-0.251701,0.061154) PO[Y]=(0,-0.346939,0.037840) PL=4
"""


def bspline_text(control, knots, shift, decimals=9):
    """The blocks as the manual's readers write them: PL_i = U[i + shift] - U[i + shift - 1]."""
    lines = [f"G1 X{control[0][0]:.{decimals}f} Y{control[0][1]:.{decimals}f} F600", "BSPLINE SD=3"]
    for i in range(1, len(control)):
        pl = knots[i + shift] - knots[i + shift - 1]
        lines.append(f"X{control[i][0]:.{decimals}f} Y{control[i][1]:.{decimals}f} PL={pl:.{decimals}f}")
    return "\n".join(lines) + "\nG0 Z50\n"


def read(tmp_path, text, config=None, **given):
    path = tmp_path / "TEST.MPF"
    path.write_text("G17 G71 G90 G94\nG0 X0 Y0 Z1\n" + text + "M30\n")
    return read_program(path, config, **given)


def locate(nc, kind, breaks, u):
    """Position at parameter u of a spline whose spans are the motions of a kind."""
    rows = np.flatnonzero(nc.kind == kind)
    span = min(int(np.searchsorted(breaks, u, side="right")) - 1, rows.size - 1)
    t = (u - breaks[span]) / (breaks[span + 1] - breaks[span])
    return nc.evaluate(rows[span : span + 1], np.array([t]))[0]


def test_worked_example_as_polynomials(tmp_path):
    nc = read(tmp_path, EXAMPLE_POLY)
    for u, point in EXAMPLE_AT.items():
        assert locate(nc, POLYNOMIAL, [0, 2, 5, 9], u) == pytest.approx(point, abs=1e-5)


@pytest.mark.parametrize("shift", [2, 3])
def test_worked_example_as_spline_by_both_conventions(shift, tmp_path):
    nc = read(tmp_path, bspline_text(EXAMPLE, EXAMPLE_KNOTS, shift), bspline_shift=shift)
    for u, point in EXAMPLE_AT.items():
        assert locate(nc, SPLINE_SPAN, [0, 2, 5, 9], u) == pytest.approx(point, abs=1e-6)


def test_a_spline_of_the_other_convention_is_refused_with_its_line(tmp_path):
    for shift in (2, 3):
        text = bspline_text(EXAMPLE, EXAMPLE_KNOTS, shift)
        with pytest.raises(InputError, match=rf"TEST\.MPF:5:1: BSPLINE read by the convention s={5 - shift}"):
            read(tmp_path, text, bspline_shift=5 - shift)


def test_no_comment_says_how_splines_are_driven(tmp_path):
    """The control takes PL as it always does: a comment that says otherwise would have another curve judged than is driven."""
    for said in ("BSPLINE CONVENTION: s=3", "the BSPLINE is by s=3", "BSPLINE CONVENTION: uniform"):
        text = f"; {said}\n" + bspline_text(EXAMPLE, EXAMPLE_KNOTS, 3)
        with pytest.raises(InputError, match="s=2"):
            read(tmp_path, text)
        assert (read(tmp_path, text, bspline_shift=3).kind == SPLINE_SPAN).sum() == 3
    config = Config(machine={"bspline_shift": 3})
    assert (read(tmp_path, text, config).kind == SPLINE_SPAN).sum() == 3


@pytest.mark.parametrize("block", ["M60", "H3=20", 'MSG("HALF")', "BSPLINE SD=3", "BSPLINE"])
def test_a_spline_is_not_begun_anew_by_what_does_not_end_it(tmp_path, block):
    """Between two splines whose ends are clamped: the control has one spline through both, where G1 does not end the first."""
    once = bspline_text(EXAMPLE, EXAMPLE_KNOTS, 2).removesuffix("G0 Z50\n")
    again = "".join(
        f"X{40 + x} Y{y} PL={pl}\n" for x, y, pl in ((5, 10, 0), (15, 15, 2), (28, 12, 3), (34, 4, 4), (40, 0, 0))
    )
    assert (read(tmp_path, once + "G1\nBSPLINE SD=3\n" + again + "G0 Z50\n").kind == SPLINE_SPAN).sum() == 6
    with pytest.raises(InputError, match=r":1[01]:\d+: .*(none of its spline|in force)"):
        read(tmp_path, once + f"{block}\n" + again + "G0 Z50\n")


@given(st.integers(0, 2**32 - 1), st.integers(4, 20), st.sampled_from([2, 3]))
@settings(max_examples=40, deadline=None)
def test_splines_are_driven_as_geomdl_evaluates_them(tmp_path_factory, seed, controls, shift):
    rng = np.random.default_rng(seed)
    control, knots = rng.normal(size=(controls, 2)) * 60, clamped_knots(rng, controls)
    path = tmp_path_factory.mktemp("nc")
    nc = read(path, bspline_text(control, knots, shift, decimals=11), bspline_shift=shift)
    curve = BSpline.Curve(normalize_kv=False)
    curve.degree, curve.ctrlpts, curve.knotvector = 3, control.tolist(), knots.tolist()
    breaks = np.unique(knots)
    for u in np.linspace(0, breaks[-1], 11):
        driven = locate(nc, SPLINE_SPAN, breaks, u)
        assert driven == pytest.approx(curve.evaluate_single(float(u)), abs=1e-7)


def test_the_length_of_the_parameter_does_not_change_the_curve(tmp_path):
    a = read(tmp_path, "G1 X1 Y2 F600\nPOLY PO[X]=(9,0.5,-0.25) PO[Y]=(3,1,0.125) PL=2\n")
    b = read(tmp_path, "G1 X1 Y2 F600\nPOLY PO[X]=(9,2,-2) PO[Y]=(3,4,1)\n")
    assert np.allclose(a.coefficients[-1], b.coefficients[-1], atol=1e-14)
    assert a.coefficients[-1, 0].sum() == pytest.approx(9)


def test_an_axis_with_an_end_point_alone_moves_linearly(tmp_path):
    nc = read(tmp_path, "G1 X1 Y2 F600\nPOLY PO[X]=(9,2) Y6\nG1 X0\n")
    assert nc.kind.tolist() == [RAPID, STRAIGHT, POLYNOMIAL, STRAIGHT]
    assert nc.evaluate(np.array([2]), np.array([0.5]))[0] == pytest.approx([1 + 6 * 0.5 + 2 * 0.25, 4])
    assert nc.end[-1].tolist() == [0, 6, 1]


@pytest.mark.parametrize(
    ("block", "centre", "sweep"),
    [
        ("G3 X10 Y10 I0 J10", (10 - 10, 10), np.pi / 2),
        ("G2 X10 Y10 I0 J10", (0, 10), -1.5 * np.pi),
        ("G3 X0 Y0 I5 J0", (5, 0), 2 * np.pi),
        ("G2 X10 Y10 CR=10", (10, 0), -np.pi / 2),
        ("G2 X10 Y10 CR=-10", (0, 10), -1.5 * np.pi),
        ("G3 X10 Y10 CR=10", (0, 10), np.pi / 2),
    ],
)
def test_arcs(block, centre, sweep, tmp_path):
    nc = read(tmp_path, f"G1 X0 Y0 F600\n{block}\n")
    assert nc.kind[-1] == ARC
    assert nc.arc[-1] == pytest.approx([*centre, sweep])
    radius = np.hypot(*centre)
    assert nc.lengths[-1] == pytest.approx(radius * abs(sweep))
    t = np.linspace(0, 1, 2001)
    points = nc.evaluate(np.full(t.size, len(nc) - 1), t)
    assert np.hypot(*(points - centre).T) == pytest.approx(np.full(t.size, radius))
    assert points[-1] == pytest.approx(nc.end[-1, :2], abs=1e-9)
    low, high = extremes(nc)
    assert low[-1, :2] == pytest.approx(points.min(axis=0), abs=1e-4)
    assert high[-1, :2] == pytest.approx(points.max(axis=0), abs=1e-4)


def test_an_arc_whose_radii_differ_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"TEST\.MPF:4:1: radius 10 mm at the start of the arc and 11"):
        read(tmp_path, "G1 X0 Y0 F600\nG3 X11 Y10 I0 J10\n")


def test_an_arc_longer_than_its_circle_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"TEST\.MPF:4:1: CR=5: no circle of that radius"):
        read(tmp_path, "G1 X0 Y0 F600\nG2 X10.001 CR=5\n")
    nc = read(tmp_path, "G1 X0 Y0 F600\nG2 X9.999 CR=5\n")
    assert nc.end[-1, 0] == pytest.approx(9.999)


@given(st.lists(st.floats(-50, 50), min_size=6, max_size=6))
@settings(max_examples=60, deadline=None)
def test_extremes_and_lengths_against_dense_sampling_and_quadrature(tmp_path_factory, numbers):
    xe, x2, x3, ye, y2, y3 = (round(n, 4) for n in numbers)
    text = f"G1 X1 Y2 F600\nPOLY PO[X]=({xe},{x2},{x3}) PO[Y]=({ye},{y2},{y3})\n"
    nc = read(tmp_path_factory.mktemp("nc"), text)
    low, high = extremes(nc)
    t = np.linspace(0, 1, 4001)
    points = nc.evaluate(np.full(t.size, 2), t)
    assert low[2, :2] == pytest.approx(points.min(axis=0), abs=1e-4)
    assert high[2, :2] == pytest.approx(points.max(axis=0), abs=1e-4)
    assert (low[2, :2] <= points.min(axis=0) + 1e-9).all()
    c = nc.coefficients[2]
    speed = lambda s: np.hypot(*(c[:, 1] + 2 * c[:, 2] * s + 3 * c[:, 3] * s * s))  # noqa: E731
    expected = quad(speed, 0, 1, limit=500, epsabs=1e-6)[0]
    assert nc.lengths[2] == pytest.approx(expected, rel=1e-2, abs=1e-3)


def test_spelling_of_words_does_not_matter(tmp_path):
    plain = read(tmp_path, "G1 X10 Y-20.5 F600\nG1 X3 Y4\n")
    other = read(tmp_path, "n10 g01x+10.y-20.50 f600 ; to the corner\n\n  N20   X = 3 Y=4.0\n")
    assert np.array_equal(plain.end, other.end)
    assert np.array_equal(plain.feed_mm_min[1:], other.feed_mm_min[1:])
    assert other.numbers[:, 2].tolist() == [10, 20]


@pytest.mark.parametrize(
    ("block", "column", "message"),
    [
        ("G1 X10 Q5 F600", 8, "unknown word 'Q5'"),
        ("N10 G1 X10 @ Y3", 12, "unknown word '@'"),
        ("G1 X1O", 6, "unknown word 'O'"),
        ("N10 G91 G1 X1", 5, "unknown word 'G91'"),
        ("G70", 1, "unknown word 'G70'"),
        ("M3 S100", 1, "unknown word 'M3'"),
        ("GOTOF END_OF", 1, "unknown word 'GOTOF'"),
        ("R1=5", 1, "unknown word 'R1=5'"),
        ("TRANS G54", 1, "TRANS with other words"),
        ("TRAFOOF G54", 1, "TRAFOOF with other words"),
        ("MAIN_L0009", 1, "unknown word 'MAIN_L0009'"),
        ("G1 X1 X2", 7, "X stands twice"),
        ("G1 X1 Y", 7, "unknown word 'Y'"),
        ("G1 PO[X]=(1,2) F5", 1, "PO[] under G1"),
        ("POLY PO[X]=(1,b,3)", 6, "is no single list"),
        ("POLY PO[X]=(1,2,3,4) PO[Y]=(1,2)", 6, "is no single list"),
        ("POLY PO[X]=(1,2,3) PL=0", 1, "PL=0 under POLY"),
        ("G1 X5 PL=2", 1, "PL under G1"),
        ("G1 X5 I2", 1, "I, J or CR under G1"),
        ("BSPLINE X1 Y2", 1, "without PL"),
        ("BSPLINE SD=4", 1, "SD=4: a BSPLINE has degree 2 or 3"),
        ("SD=2", 1, "SD belongs to the block with BSPLINE"),
        ("BSPLINE X1 Y2 PW=0.5 PL=0", 1, "PW=1"),
        ("%_N_OTHER_MPF", 1, "unknown word '%_N_OTHER_MPF'"),
        ("N99999999999999999999 G1 X1 Y2", 1, "block number of 20 digits: 8 at most"),
        ("N100000000 M0", 1, "block number of 9 digits"),
    ],
)
def test_what_is_not_understood_is_refused_with_its_place(block, column, message, tmp_path):
    with pytest.raises(InputError) as caught:
        read(tmp_path, f"G1 F600\n{block}\n")
    assert str(caught.value).startswith(f"TEST.MPF:4:{column}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_axis_before_any_motion_word_is_refused(tmp_path):
    (tmp_path / "A.MPF").write_text("N10 X5\nM30\n")
    with pytest.raises(InputError, match=r"A\.MPF:1:5: an axis before any of G0"):
        read_program(tmp_path / "A.MPF")


def test_blocks_after_the_end_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"TEST\.MPF:4:1: a block after the end of the program by M30 in line 3"):
        read(tmp_path, "M30\n")


def test_calls_run_the_files_beside_and_count_layers(tmp_path):
    (tmp_path / "MAIN.MPF").write_text("G0 X0 Y0 Z1\nM60\nM62\nAA_ONE\nAA_TWO\nAA_ONE\nM30\n")
    (tmp_path / "AA_ONE.SPF").write_text("G1 X1 F60\nAA_INNER\nM17\n")
    (tmp_path / "AA_TWO.SPF").write_text("G1 X2\nRET\n")
    (tmp_path / "AA_INNER.SPF").write_text("G1 Y7\nM17\n")
    nc = read_program(tmp_path)
    assert nc.layer.tolist() == [-1, 0, 0, 1, 2, 2]
    assert nc.layer_files == ("AA_ONE.SPF", "AA_TWO.SPF", "AA_ONE.SPF")
    assert [nc.where(row) for row in range(3)] == ["MAIN.MPF:1", "AA_ONE.SPF:1", "AA_INNER.SPF:1"]


def test_a_program_that_calls_itself_is_refused(tmp_path):
    (tmp_path / "MAIN.MPF").write_text("AA_ONE\nM30\n")
    (tmp_path / "AA_ONE.SPF").write_text("AA_ONE\nM17\n")
    with pytest.raises(InputError, match=r"AA_ONE\.SPF:1:1: AA_ONE is called over 8 levels deep"):
        read_program(tmp_path)


def test_what_is_missing_is_named(tmp_path):
    with pytest.raises(InputError, match=r"NO\.MPF: cannot be read"):
        read_program(tmp_path / "NO.MPF")
    with pytest.raises(InputError, match="holds 0 main programs"):
        read_program(tmp_path)


def test_templates_are_state_changes(tmp_path):
    machine = {
        "beam_on": ["G4 F2", "M60"],
        "beam_off": ["H2=0", "M61"],
        "set_beam": ["H1={voltage_kv} H2={current_ma:.1f}"],
        "wire_start": ["M62 S{wire_mm_s}"],
        "wire_stop": ["M63"],
        "layer_begin": ["MSG ({layer})"],
    }
    config = Config().changed(machine=machine)
    text = "H1=60 H2=120.0\nG4  F2\nG1 X1 F60\nM60\nG1 X2\nM62 S33.5\nG1 X3\nM63\nG1 X4\nH2=0\nm61\nMSG (12)\nG1 X5\n"
    nc = read(tmp_path, text, config)
    assert nc.beam[1:].tolist() == [False, True, True, True, False]
    assert nc.wire[1:].tolist() == [False, False, True, False, False]
    assert nc.power_w[1:].tolist() == [7200.0] * 4 + [0.0]  # H2=0 of the template is read as any other H2
    assert nc.wire_mm_s[3:5].tolist() == [33.5, 33.5]
    assert ("layer", 12.0) in list(zip(nc.events.name, nc.events.value, strict=True))


@pytest.mark.parametrize(
    ("machine", "message"),
    [
        ({"beam_on": ["M61"]}, "end with the same block 'M61'"),
        ({"wire_stop": ["; by hand"]}, "machine.wire_stop has no block"),
    ],
)
def test_templates_that_cannot_be_told_apart_are_refused(machine, message, tmp_path):
    with pytest.raises(SettingsError, match=message):
        read(tmp_path, "", Config().changed(machine=machine))


def test_the_sampled_path_of_a_square_is_the_square(tmp_path):
    text = "; RING 0\nM60\nG1 X10 F60\nY8\nX0\nY0\nM61\nG0 X20\n; ISLAND 3\nM60\nG1 X25\nM61\n"
    nc = read(tmp_path, text)
    layers = nc.sample(0.5)
    assert layers.heights.tolist() == [1.0]
    assert layers.areas().tolist() == [80.0]
    assert layers.perimeters().tolist() == [36.0]
    assert layers.open_counts().tolist() == [1]
    assert layers.ring_lengths.sum() == pytest.approx(41)
    assert np.linalg.norm(np.diff(layers.ring(0), axis=0), axis=1).max() <= 0.5 + 1e-12
    assert nc.contours(0.5).open_counts().tolist() == [0]
    assert nc.vectors()[["island", "x0", "x1"]].to_numpy().tolist() == [[0, 20, 25]]


def test_the_sampled_program_is_the_sampled_curve(tmp_path):
    curves, plan = stack(seed=3)
    nc = read_program(write_program(curves, plan, Config(), tmp_path / "program").main)
    driven, fitted = nc.contours(0.25), curves.sample(0.25)
    assert np.array_equal(driven.ring_counts(), fitted.ring_counts())
    # The reader turns contours by their nesting; these curves of chance run either way.
    assert np.abs(driven.areas()) == pytest.approx(np.abs(fitted.areas()), rel=1e-3)
    assert driven.perimeters() == pytest.approx(fitted.perimeters(), rel=1e-3)


def test_a_program_without_calls_has_layers_by_z(tmp_path):
    text = "M60\nG1 X5 F60\nM61\nG0 Z3\nM60\nG1 X0\nG1 Y9\nM61\n"
    nc = read(tmp_path, text)
    assert nc.layer_heights.tolist() == [1.0, 3.0]
    assert nc.layer[nc.deposit].tolist() == [0, 1, 1]


def test_an_empty_program_reads_as_no_motions(tmp_path):
    (tmp_path / "A.MPF").write_text("")
    nc = read_program(tmp_path / "A.MPF")
    assert len(nc) == 0
    assert len(nc.sample(1.0)) == 0
    assert nc.vectors().empty
