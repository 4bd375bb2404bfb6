"""The reader of G-code: what it takes, what it refuses with its place, and an outside tokeniser beside it."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from nc_stack import stack
from posted_curves import TEXT_CONTROLS, smooth_curves, wrote

from ebamcheck.errors import InputError
from ebamcheck.program import read_program

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
