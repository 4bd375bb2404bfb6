"""Limits of the checks of text, values and machine, each with a figure planted just inside and just outside."""

from __future__ import annotations

import re

import numpy as np
from limit_cases import HIGH_MM, Subject, cube, downwards, program_of, upwards

from ebamcheck.checks.state_checks import far_away
from ebamcheck.program import Check

MAIN, FIRST = "MAIN.MPF", "MAIN_L0001.SPF"


def letter(code: float) -> Subject:
    def change(lines):
        i = next(i for i, line in enumerate(lines[FIRST]) if line.startswith("; RING"))
        lines[FIRST][i] += chr(int(code))

    return cube().with_text(change)


def long_block(f: float) -> Subject:
    def change(lines):
        lines[FIRST][8] = (lines[FIRST][8] + " ; ").ljust(int(f * 199), "x")

    return cube().with_text(change)


def printed_height(f: float) -> Subject:
    def change(lines):
        i = next(i for i, line in enumerate(lines[FIRST]) if line.startswith("; LAYER: "))
        lines[FIRST][i] = re.sub(r", Z .*", f", Z {HIGH_MM + f * 1e-6:.9f}", lines[FIRST][i])

    return cube().with_text(change).given(heights=cube().known["plan"].heights)


def room_on_the_control(f: float) -> Subject:
    size = sum(len(file.data) - len("NOT ") for file in cube().nc.files)
    return cube().by(machine={"program_limit_mb": 1e-6 * size / f})


def end_at(f: float, axis: int, wanted_mm: float, by_mm: float) -> Subject:
    row = len(cube().nc) - 1
    return cube().with_columns((row, axis), end=wanted_mm + f * by_mm)


def fed(mm_min: float) -> Subject:
    return cube().with_columns(cube().metal[5], feed_mm_min=mm_min)


def beyond(f: float, by_mm: float) -> Subject:
    row = cube().metal[5]
    return cube().with_ends(row, 1000.0 + f * by_mm - cube().nc.end[row, 0], 0)


def told_far(subject: Subject) -> Check:
    """The check of a program of which nothing else is judged, since it leads so far away."""
    near = Check("travel", True, 0.0, 0.0, "mm", "", "everything else is judged, too")
    return far_away(subject.nc, subject.config) or near


def with_window(name: str, figure: float, side: int, f: float) -> Subject:
    """A window with one side at the figure of the program, over or under it by a factor."""
    window = [0.1 * figure, 10.0 * figure]
    window[side] = figure / f
    return cube().by(process={name: tuple(window)})


def windows():
    """Both sides of each window of the process, by the figures of the cube: 60 kV, 120 mA, 10 mm/s."""
    kw, wire_mm2 = 7200.0, np.pi * 0.8**2
    rows = cube().metal
    wire = cube().nc.wire_mm_s[rows]
    over_bead = HIGH_MM / (1.5 * wire_mm2 * (2000.0 / 60.0) / 10.0 / 6.0)
    figures = {
        "voltage_window_kv": (60.0, 60.0),
        "current_window_ma": (120.0, 120.0),
        "line_energy_j_mm": (kw / 10.0, kw / 10.0),
        "travel_window_mm_s": (10.0, 10.0),
        "bead_section_mm2": (wire_mm2 * wire.min() / 10.0, wire_mm2 * wire.max() / 10.0),
        "metal_energy_j_mm3": (kw / (wire_mm2 * wire.max()), kw / (wire_mm2 * wire.min())),
        "layer_over_bead": (over_bead, over_bead),
    }
    for name, (least, greatest) in figures.items():
        yield upwards("process window", f"process.{name}", lambda f, n=name, v=greatest: with_window(n, v, 1, f))
        yield downwards("process window", f"process.{name}", lambda f, n=name, v=least: with_window(n, v, 0, f))


def wire_of(figure: float) -> Subject:
    return cube().with_columns(cube().metal[5], wire_mm_s=figure)


def ramped(**windows) -> Subject:
    """A bead of 100 mm whose beam rises along 20 mm, and falls along as many: in two seconds each."""
    return program_of([[[(0.0, 0.0), (100.0, 0.0)]]], process={"ramp_up_mm": 20.0, "crater_fill_mm": 20.0}).by(
        process=windows
    )


def drawn_back(f: float) -> Subject:
    """A program whose wire is drawn back by 3 mm, and a little more."""
    subject = program_of([[[(0.0, 0.0), (30.0, 0.0)]]], process={"wire_retract_mm": 3.0})
    return subject.with_values("wire_retract_mm", lambda values: values + f * 1e-6)


def off_its_line(f: float) -> Subject:
    """A line in parts, where its power changes, one of which begins beside it."""
    return ramped().with_ends(int(ramped().metal[1]), f * 1e-3, 1)


def without_axes(f: float) -> Subject:
    """So many of the blocks of metal name no Y: from a tenth on it is the form of the program."""

    def change(lines):
        blocks = [(n, i) for n in lines for i, line in enumerate(lines[n]) if re.match(r"N\d+ G1 X\S+ Y", line)]
        for name, i in blocks[: round(f * 0.1 * len(blocks))]:
            lines[name][i] = re.sub(r" Y\S+", "", lines[name][i])

    return cube().with_text(change)


def apart(beads: int, ways: int, axes: str) -> Subject:
    """A program of single beads, with axes left out on the ways to some of them."""
    subject = program_of([[[(0.0, 9.0 * k), (30.0 + k, 9.0 * k)] for k in range(beads)]])

    def change(lines):
        found = [i for i, line in enumerate(lines[FIRST]) if re.match(r"N\d+ G0 X\S+ Y", line)]
        for i in found[1 : ways + 1]:
            lines[FIRST][i] = re.sub(rf" [{axes}]-?[\d.]+", "", lines[FIRST][i])
        if axes == "XY":
            lines[FIRST] = [line for line in lines[FIRST] if not re.fullmatch(r"N\d+ G0", line)]

    return subject.with_text(change)


def late_wire(f: float) -> Subject:
    """The wire of a contour changes later than planned: the middle of what has the wrong one lies so far behind that place."""

    def change(lines):
        i = next(i for i, line in enumerate(lines[FIRST]) if "G1 X27.000000 Y3.000000" in line)
        assert "H3=" in lines[FIRST][i + 1]
        lines[FIRST].insert(i + 1, f"N185 G1 X27.000000 Y{3.0 + 2.0 * f * 0.2:.6f}")

    return cube().with_text(change)


def used_kg() -> float:
    nc = cube().nc
    rows = np.flatnonzero(nc.wire)
    seconds = 60.0 * nc.lengths[rows] / nc.feed_mm_min[rows]
    return float((seconds * nc.wire_mm_s[rows]).sum() * np.pi * 0.8**2 * 1e-9 * cube().config.material.density_kg_m3)


def used_h() -> float:
    nc = cube().nc
    rows = np.flatnonzero(nc.beam)
    return float((60.0 * nc.lengths[rows] / nc.feed_mm_min[rows]).sum() / 3600.0)


def waiting(wait_s: float, layer: int = 1, **process) -> Subject:
    """The cube that waits between its layers, and longer before one of them."""
    pause_s = process.get("layer_pause_s", 0.0)
    subject = cube().by(process=process)
    for k in range(1, 4):
        subject = subject.with_event(int(cube().of_layer(k)[0]) - 2, "layer_pause_s", wait_s if k == layer else pause_s)
    return subject


def waiting_at(z_mm: float) -> Subject:
    """A wait behind the first layer at a height."""
    row = int(cube().of_layer(0)[-1]) + 1
    return cube().with_columns((row, 2), end=z_mm).with_event(row + 1, "layer_pause_s", 1.0)


def in_steps(f: float, name: str, value: float, step: float) -> Subject:
    def off(values):
        changed = values.copy()
        changed[0] = value + f * 1e-6
        return changed

    key = {"current_ma": "current_increment_ma", "voltage_kv": "voltage_increment_kv"}[name]
    return cube().by(machine={key: step}).with_values(name, off)


def along(f: float, feed_mm_s: float, wire_mm_s: float) -> Subject:
    """A motion whose feed follows along the path, with the wire at the limit of its feeder."""
    row = cube().metal[5]
    changed = cube().by(process={"feed_along_path": True})
    return changed.with_columns(row, feed_mm_min=60.0 * feed_mm_s, wire_mm_s=wire_mm_s)


CASES = (
    upwards("encoding", "text_checks.LAST_PRINTABLE", letter, inside=0x7E, outside=0x7F),
    upwards("encoding", "text_checks.FIRST_PRINTABLE", letter, inside=0x20, outside=0x1F),
    upwards("block length", "text_checks.BLOCK_LIMIT", long_block),
    upwards("header", "checks.PRINTED", printed_height, "heights"),
    upwards("size on the control", "machine.program_limit_mb", room_on_the_control),
    upwards(
        "smoothing", "checks.VALUE_SHARE machine.smoothing_tolerance_mm",
        lambda f: cube().with_values("CTOL", lambda v: 0.05 * (1.0 + f * 1e-3) + 0.0 * v),
    ),
    upwards("safe end", "checks.PLACE_MM machine.safe_height_mm", lambda f: end_at(f, 2, 4.0 * HIGH_MM + 20.0, -1e-3)),
    upwards("safe end", "checks.PLACE_MM machine.park_mm", lambda f: end_at(f, 0, 0.0, 2e-3)),
    upwards("feed", "machine.feed_max_mm_s", lambda f: fed(60.0 * 50.0 * f)),
    downwards("feed", "machine.feed_min_mm_s", lambda f: fed(60.0 * 1.0 * f)),
    upwards("spline blocks", "state_checks.LEAST_SPLINE_BLOCKS", lambda n: cube().with_event(9, "BSPLINE", n), inside=6, outside=5),
    upwards("travel", "checks.LIMIT_ROUNDING_MM machine.travel_max_mm", lambda f: beyond(f, 1e-9)),
    upwards("travel", "machine.travel_min_mm", lambda f: beyond(f, 2000.0), judge=told_far),
    upwards("power", "checks.VALUE_SHARE", lambda f: cube().with_columns(cube().metal[5], power_w=7200.0 * (1.0 + f * 1e-3))),
    upwards("power", "checks.VALUE_SHARE", lambda f: cube().with_columns(cube().metal[5], power_w=7200.0 * (1.0 - f * 1e-3)), "curves", "plan"),
    upwards("mass balance", "checks.WIRE_TOLERANCE", lambda f: wire_of(cube().nc.wire_mm_s[cube().metal[5]] * (1.0 + f * 0.01)), "curves", "plan"),
    upwards("mass balance", "checks.WIRE_TOLERANCE process.wire_speed_max_mm_s",
            lambda f: wire_of(1.6 * 4.32 * HIGH_MM * 10.0 / (np.pi * 0.8**2) * (1.0 + f * 0.01))),
    upwards("mass balance", "checks.WIRE_TOLERANCE process.wire_speed_min_mm_s", lambda f: wire_of(1000.0 / 60.0 / (1.0 + f * 0.01))),
    upwards("process window", "checks.WINDOW_SHARE process.wire_speed_max_mm_s", lambda f: wire_of(100.0 * (1.0 + f * 1e-5))),
    upwards("process window", "checks.WINDOW_SHARE process.wire_speed_min_mm_s", lambda f: wire_of(1000.0 / 60.0 * (1.0 - f * 1e-5))),
    *windows(),
    upwards("process values", "checks.VALUE_SHARE process.voltage_kv", lambda f: cube().with_values("voltage_kv", lambda v: v * (1.0 + f * 1e-3))),
    upwards("process values", "checks.VALUE_SHARE process.current_ma", lambda f: cube().with_values("current_ma", lambda v: v * (1.0 + f * 1e-3))),
    upwards("process values", "checks.VALUE_SHARE process.travel_speed_mm_s", lambda f: fed(600.0 * (1.0 + f * 1e-3))),
    upwards("process values", "checks.VALUE_SHARE process.feed_along_path", lambda f: along(f, 9.0, 100.0 * (1.0 - f * 1e-3))),
    upwards("process values", "process.travel_window_mm_s", lambda f: along(f, 48.0 * f, 1000.0 / 60.0)),
    upwards("increments", "checks.PRINTED machine.current_increment_ma", lambda f: in_steps(f, "current_ma", 120.0, 0.5)),
    upwards("increments", "checks.PRINTED machine.voltage_increment_kv", lambda f: in_steps(f, "voltage_kv", 60.0, 0.5)),
    upwards("ramps in time", "bead_end_checks.ROUNDING_MM process.ramp_up_window_s", lambda f: ramped(ramp_up_window_s=(0.5, 2.0 - f * 0.01))),
    upwards("ramps in time", "bead_end_checks.ROUNDING_MM process.ramp_up_window_s", lambda f: ramped(ramp_up_window_s=(2.0 + f * 0.01, 9.0))),
    upwards("ramps in time", "process.crater_fill_window_s", lambda f: ramped(crater_fill_window_s=(0.5, 2.0 - f * 0.01))),
    upwards("wire retract", "checks.PRINTED process.wire_retract_mm", drawn_back),
    upwards("parts of hatch lines", "checks.PLACE_MM", off_its_line, "curves", "plan"),
    downwards("words of motions", "text_checks.MOST_WHOLE", without_axes),
    upwards("words of motions", "text_checks.FEW", lambda n: apart(12, n, "XY"), inside=3, outside=2),
    upwards("words of motions", "text_checks.LEAST_WHOLE", lambda n: apart(n, 2, "Y"), inside=7, outside=10),
    upwards("mass balance", "checks.WIRE_PLACE_MM", late_wire, "curves", "plan"),
    upwards("wire on the spool", "machine.spool_kg", lambda f: cube().by(machine={"spool_kg": used_kg() / f})),
    upwards("life of the cathode", "machine.cathode_h", lambda f: cube().by(machine={"cathode_h": used_h() / f})),
    upwards("layer pause", "checks.PRINTED", lambda f: waiting(f * 1e-6), "curves", "plan"),
    upwards("layer pause", "checks.PRINTED", lambda f: waiting(f * 1e-6)),
    upwards("layer pause", "checks.PRINTED process.layer_pause_s", lambda f: waiting(9.0 - f * 1e-6, layer_pause_s=9.0)),
    upwards("layer pause", "process.longest_wait_s", lambda f: waiting(f * 14400.0, interpass="both")),
    upwards("waits over the part", "checks.TWO_PLACES_MM machine.clearance_mm", lambda f: waiting_at(HIGH_MM + 5.0 - f * 2e-3)),
)  # fmt: skip
