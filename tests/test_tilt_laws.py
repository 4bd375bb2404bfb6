"""Laws of a tilt table and its frames: writer, reader and SciPy turn alike, and what is turned and back is where it was."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nc_stack import stack
from parts import box
from scipy.spatial.transform import Rotation

from ebamcheck.checks.table import mounting_checks
from ebamcheck.errors import SettingsError
from ebamcheck.mesh.part_source import on_table
from ebamcheck.nc.table import NONE, frame_after, table_at
from ebamcheck.nc.words import WordError
from ebamcheck.program import read_program, write_program
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import RotaryAxis
from ebamcheck.writing.table import positions_of, table_motion


def axis(name="A", line=(1, 0, 0), point=(0, 0, 0), **given):
    return RotaryAxis(name=name, axis=line, point_mm=point, **given)


UNIT = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.2)
POINT = st.tuples(*[st.floats(-200, 200)] * 3)
ANGLE = st.floats(-170, 170)


@settings(deadline=None, max_examples=80)
@given(UNIT, UNIT, POINT, POINT, ANGLE, ANGLE, st.sampled_from([1, -1]), st.sampled_from([1, -1]))
def test_writer_reader_and_scipy_turn_a_table_alike(a, b, p, q, first, second, sign, other):
    axes = (axis("A", a, p, sign=sign), axis("C", b, q, sign=other))
    turn, shift = table_motion(axes, (first, second))
    read = table_at(axes, (first, second))
    assert read == pytest.approx(np.column_stack([turn, shift]), abs=1e-9)
    place = np.array([3.0, -7.0, 11.0])
    for line, point, angle_deg, way in ((b, q, second, other), (a, p, first, sign)):
        unit = np.array(line) / np.linalg.norm(line)
        place = Rotation.from_rotvec(unit * np.radians(way * angle_deg)).apply(place - point) + point
    assert turn @ [3.0, -7.0, 11.0] + shift == pytest.approx(place, abs=1e-8)


@settings(deadline=None, max_examples=80)
@given(UNIT, UNIT, ANGLE, ANGLE, st.sampled_from([1, -1]))
def test_positions_turn_the_direction_up_wherever_there_are_any(a, b, first, second, sign):
    """A direction that some positions turn up is found again, by these or others nearer to 0."""
    axes = (axis("A", a, sign=sign), axis("C", b))
    up = table_motion(axes, (first, second))[0].T @ [0.0, 0.0, 1.0]
    sine = np.linalg.norm(np.cross(np.array(a) / np.linalg.norm(a), np.array(b) / np.linalg.norm(b)))
    if sine < 0.05:
        return
    found = positions_of(up, axes)
    assert table_motion(axes, found)[0] @ up == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    # Where a direction lies along an axis, or both ways meet in one, rounding decides which positions are the nearest.
    outer, inner = (np.array(line) / np.linalg.norm(line) for line in (a, b))
    between = table_motion(axes[1:], (second,))[0] @ up
    room = (np.cross(outer, [0.0, 0.0, 1.0]), np.cross(inner, up), np.cross(outer, inner) @ between)
    if min(np.linalg.norm(v) for v in room) > 0.01:
        assert max(map(abs, found)) <= max(abs(first), abs(second)) + 1e-6


def test_positions_of_the_usual_tables():
    trunnion = (axis("A"), axis("C", (0, 0, 1)))
    assert positions_of(np.array([0.0, 0.0, 1.0]), trunnion) == (0.0, 0.0)
    assert positions_of(np.array([0.0, 1.0, 0.0]), trunnion) == pytest.approx((90.0, 0.0))
    a, c = positions_of(np.array([1.0, 0.0, 1.0]), trunnion)
    assert abs(a) == pytest.approx(45.0)
    assert abs(c) == pytest.approx(90.0)
    # An axis that turns the other way, and one that cannot go there but the other way round.
    assert positions_of(np.array([0.0, 1.0, 0.0]), (axis(sign=-1),)) == pytest.approx((-90.0,))
    only = (axis(min_deg=-10.0, max_deg=280.0),)
    assert positions_of(np.array([0.0, -1.0, 0.0]), only) == pytest.approx((270.0,))
    with pytest.raises(SettingsError, match="cannot turn the direction"):
        positions_of(np.array([1.0, 0.0, 0.0]), (axis(),))


@settings(deadline=None, max_examples=12)
@given(UNIT, UNIT, POINT, POINT, st.sampled_from([1, -1]), st.floats(-80, 80), st.floats(-80, 80))
def test_what_is_written_through_a_table_is_read_as_without_it(tmp_path_factory, a, b, p, q, sign, first, second):
    """Turning the part with its direction, and back: the coordinates on the part are those of the program without a table."""
    if np.linalg.norm(np.cross(np.array(a) / np.linalg.norm(a), np.array(b) / np.linalg.norm(b))) < 0.3:
        return
    axes = [{"name": n, "axis": v, "point_mm": c, "sign": s} for n, v, c, s in (("A", a, p, sign), ("C", b, q, 1))]
    wide = {"travel_min_mm": (-9e3,) * 3, "travel_max_mm": (9e3,) * 3}
    plain = Config().changed(machine={"rotary": axes, **wide})
    up = table_motion(plain.machine.rotary, (first, second))[0].T @ [0.0, 0.0, 1.0]
    if up[2] > 1.0 - 1e-9:
        return  # nothing is turned
    part = box((3, 4, 0), (33, 28, 40))
    direction = tuple(up.tolist())
    config = plain.changed(
        part={"on_table": on_table(part, part.along(direction)).model_dump(), "direction": direction}
    )
    folder = tmp_path_factory.mktemp("both")
    curves, plan = stack(count=1)
    known = read_program(write_program(curves, plan, plain, folder / "p").main, plain)
    nc = read_program(write_program(curves, plan, config, folder / "t").main, config)
    beads, same = nc.deposit, known.deposit
    assert nc.end[beads] == pytest.approx(known.end[same], abs=0.0)
    assert nc.machine.table.off_mm.max() < 2e-4
    driven = nc.machine.end[nc.machine.deposit]
    # The axes drive the same bead elsewhere, as long as it is, and level.
    assert np.ptp(driven[:, 2]) < 1e-3
    assert np.linalg.norm(np.diff(driven, axis=0), axis=1) == pytest.approx(
        np.linalg.norm(np.diff(known.end[same], axis=0), axis=1), abs=1e-6
    )


@settings(deadline=None, max_examples=60)
@given(POINT, ANGLE, POINT, st.sampled_from("XYZ"))
def test_frames_follow_one_another_as_scipy_turns_them(first, angle_deg, second, name):
    frame = frame_after(" ".join(["TRANS", *(f"{n}{v:.6f}" for n, v in zip("XYZ", first, strict=True))]), NONE)
    frame = frame_after(f"AROT {name}{angle_deg:.6f}", frame)
    frame = frame_after(f"ATRANS X={second[0]:.6f}", frame)
    own = Rotation.from_euler(name.lower(), angle_deg, degrees=True)
    place = own.apply([1.0 + second[0], 2.0, 3.0]) + first
    assert frame[:, :3] @ [1.0, 2.0, 3.0] + frame[:, 3] == pytest.approx(place, abs=1e-4)
    assert frame_after("ROT RPL=90", frame)[:, 3].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("code", ["ROT X10 Y20", "AROT Q5", "TRANS RPL=5", "TRANS X1 X2", "AROT Z"])
def test_a_frame_that_is_not_read_is_refused(code):
    with pytest.raises(WordError):
        frame_after(code, NONE)


def test_a_mounting_is_that_of_the_mesh():
    part = box((3, 4, 2), (33, 28, 40))
    for direction in ((1, 0, 0), (0, 0, -1), (1, 2, 3)):
        now = part.along(direction)
        known = on_table(part, now)
        lowest = np.array([0.0, 0.0, part.bounds[0, 2]])
        placed = (part.vertices - lowest) @ np.array(known.turn) + known.shift_mm
        assert placed == pytest.approx(now.vertices - [0.0, 0.0, now.bounds[0, 2]], abs=1e-9)
        assert known.low_mm == pytest.approx((3, 4, 0))
        config = Config().changed(part={"on_table": known.model_dump()})
        (check,) = mounting_checks(part, now, config)
        assert check.passed, check.text
        (check,) = mounting_checks(part, part.along((0.001, 0, 1)), config)
        assert check.value > 1.0
        for name in ("low_mm", "high_mm", "shift_mm"):
            moved = {**known.model_dump(), name: tuple(np.add(getattr(known, name), [0.0, 0.0, 0.01]))}
            (check,) = mounting_checks(part, now, Config().changed(part={"on_table": moved}))
            assert check.value == pytest.approx(0.01)
