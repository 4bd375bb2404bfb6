"""Checks of a tilt table: where and when it turns, what the frame makes of the program, and that both are taken back.

From the text alone, with the rotary axes of the profile, and the part on its table as the settings tell it. What table and frame do
to the path goes into every other check, since the motions are followed to the part (:mod:`ebamcheck.nc.turned_table`).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ebamcheck.checks.checks import Check, count_check, event_faults, row_faults, worst_check
from ebamcheck.nc.motions import RAPID, NCProgram
from ebamcheck.nc.table import AXIS_EVENT
from ebamcheck.nc.tilt_rules import carried_corners
from ebamcheck.nc.timeline import Kind
from ebamcheck.nc.turned_table import SAME_PLACE_MM, table_at
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config

NAMES = ("table limits", "table turns", "table height", "frame", "frame taken back")

STEP_DEG = 1.0
"""Steps in which a turn of the table is followed: at 500 mm from its line they lie 9 mm apart, and 0.02 mm over the chord."""

PLACE_MM = 2e-3
"""Heights are rounded to the decimals of a program, at their coarsest."""

LIMIT_DEG = 1e-6
"""Rounding of a position."""


def tilt_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check what table and frame do; nothing for a program without either, of a part that is not turned."""
    full = nc.machine
    if full is None or full.table is None:
        if config.part.on_table is None:
            return []
        what = "the part is to be turned (part.on_table), and the program turns no table and sets no frame"
        return [Check("frame", False, 1.0, 0.0, "faults", nc.beginning, what)]
    kept = np.flatnonzero(~full.table.apart)
    return [
        _limits(full, config),
        count_check(NAMES[1], [*_turns(full), *_left_as_they_were(full)], "one axis at a time, beam and wire commanded off"),
        _height(full, config),
        worst_check(
            NAMES[3], full, kept, full.table.off_mm[kept], SAME_PLACE_MM, "mm", "table and frame put the path beside its place on the part"
        ),
        count_check(NAMES[4], list(_taken_back(full)), "no frame and the table at 0 after each layer, and beside it"),
    ]  # fmt: skip


def _limits(full: NCProgram, config: Config) -> Check:
    """Positions of the rotary axes against their limits."""
    table = full.table
    assert table is not None
    axes = config.machine.rotary
    low, high = np.array([a.min_deg for a in axes]), np.array([a.max_deg for a in axes])
    over = np.maximum(low - table.positions_deg, table.positions_deg - high)[table.after]
    worst = over.max(axis=1, initial=-np.inf)
    found = worst_check(NAMES[0], full, np.arange(len(full)), worst, LIMIT_DEG, "deg", "beyond the limits")
    axis = axes[int(np.argmax(over[int(np.argmax(worst))]))].name if len(full) else ""
    room = -found.value if found.passed else found.value
    text = f"{room:g} deg of {axis} {'left' if found.passed else 'beyond its limits'}"
    return Check(found.name, found.passed, found.value, 0.0, "deg", found.where, text)


def _turns(full: NCProgram) -> Iterator[tuple[str, str]]:
    """Turns under beam or wire, at feed, of several axes at once, or while the tool moves."""
    table = full.table
    assert table is not None
    rows = np.flatnonzero(table.before != table.after)
    for row in rows.tolist():
        where = full.where(row)
        if full.beam[row] or full.wire[row]:
            yield where, f"the table turns with the {'beam' if full.beam[row] else 'wire'} on"
        if full.kind[row] != RAPID:
            yield where, "the table turns at feed in place of a rapid"
        moved = table.positions_deg[table.after[row]] != table.positions_deg[table.before[row]]
        if moved.sum() > 1:
            names = " and ".join(np.array(table.axes)[moved])
            yield where, f"{names} turn in one block: the way between is not known"
        if not np.array_equal(full.start[row], full.end[row], equal_nan=True):
            yield where, "X, Y or Z move while the table turns"
        before = full.events.chosen((full.events.file == full.file[row]) & (full.events.row <= row))
        for on, off, what in (
            (Kind.BEAM_ON, Kind.BEAM_OFF, "beam"),
            (Kind.WIRE_START, Kind.WIRE_STOP, "wire"),
        ):
            if not before.since(before.kind == off, before.kind == on)[-1]:
                yield where, f"the table turns before the {what} is commanded off in the same subprogram"


def _left_as_they_were(full: NCProgram) -> Iterator[tuple[str, str]]:
    """Files with a frame in which an axis of the table is not commanded before it: it stands where the layer below left it, or a break."""
    table = full.table
    assert table is not None
    for file in np.unique(full.file[table.frame != 0]).tolist():
        row = int(np.flatnonzero((full.file == file) & (table.frame != 0))[0])
        known = full.events.chosen((full.events.file == file) & (full.events.row <= row)).name
        for axis in table.axes:
            if AXIS_EVENT + axis not in known:
                yield (
                    full.where(row),
                    f"{axis} is not commanded before the frame: the table may stand otherwise there",
                )


# -- height ------------------------------------------------------------------------------------------


def _height(full: NCProgram, config: Config) -> Check:
    """What the tip lacks of the clearance over all that the table carries: while it turns, and on ways beside a layer."""
    table = full.table
    assert table is not None
    if config.part.on_table is None:
        return Check(NAMES[2], True, 0.0, 0.0, "mm", "", "no part is said to stand on the table")
    corners = carried_corners(config)
    swept = dict[tuple[int, int], float]()
    highest = max(
        _swept(corners, full, a, b, swept, config) for a, b in zip(table.before.tolist(), table.after.tolist(), strict=True)
    ) if len(full) else 0.0  # fmt: skip
    least = highest + config.machine.clearance_mm
    # The first way of a program rises from a height that nobody knows; the first one in a frame crosses what the turned table carries.
    enters = (
        np.append(False, (table.frame[1:] != table.frame[:-1]) & (table.frame[1:] != 0))
        if len(full)
        else table.apart
    )
    rows = np.flatnonzero(table.apart | (enters & (full.kind == RAPID)))
    start, end = full.start[rows, 2], full.end[rows, 2]
    level = (full.start[rows, :2] == full.end[rows, :2]).all(axis=1) | np.isnan(full.end[rows, :2]).all(
        axis=1
    )
    low = np.where(level & ~(table.before != table.after)[rows], end, np.fmin(start, end))
    # One that moves aside on its way up from there may meet anything.
    aside = np.isnan(start) & ~level
    low = np.where(np.isnan(end) | aside, -np.inf, low)
    short = least - low
    found = worst_check(NAMES[2], full, rows, short, PLACE_MM, "mm", "")
    text = f"the table turns, and the tool is on its way, {-found.value:.4g} mm and more over the least height of Z {least:.6g} mm"
    if not found.passed:
        at = int(np.argmax(np.nan_to_num(short, nan=np.inf)))
        row = int(rows[at])
        what = (
            "the table turns"
            if table.before[row] != table.after[row]
            else "the tool moves aside from a height that is not known"
            if aside[at]
            else "the tool is on its way"
        )
        z = np.fmin(full.start[row, 2], full.end[row, 2])
        text = f"{what} at Z {z:g} mm: all that the table carries comes to Z {highest:.6g} mm as it turns, {config.machine.clearance_mm:g} mm are to be kept"
    return Check(NAMES[2], found.passed, found.value, 0.0, "mm", found.where, text)


def _swept(
    corners: Floats, full: NCProgram, a: int, b: int, known: dict[tuple[int, int], float], config: Config
) -> float:
    """Highest Z of corners on the table while it turns from the positions `a` to `b`, step by step."""
    if (a, b) not in known:
        table = full.table
        assert table is not None
        start, end = table.positions_deg[a], table.positions_deg[b]
        steps = max(int(np.ceil(np.abs(end - start).max(initial=0.0) / STEP_DEG)), 1)
        highest = -np.inf
        for k in range(steps + 1):
            at = table_at(config.machine.rotary, start + (end - start) * (k / steps))
            highest = max(highest, float((corners @ at[2, :3] + at[2, 3]).max()))
        known[a, b] = highest
    return known[a, b]


# -- taken back --------------------------------------------------------------------------------------


def _taken_back(full: NCProgram) -> Iterator[tuple[str, str]]:
    """Files that end with a frame in force or the table turned, and motions of the main program with either."""
    table = full.table
    assert table is not None
    turned = (table.positions_deg[table.after] != 0.0).any(axis=1)
    framed = table.frame != 0
    for file in np.unique(full.file).tolist():
        row = int(np.flatnonzero(full.file == file)[-1])
        if framed[row]:
            yield full.where(row), "the subprogram ends with its frame in force"
        if turned[row]:
            yield full.where(row), "the subprogram ends with the table turned"
    yield from row_faults(
        full, (framed | turned) & (full.file == 0), "the main program moves with a frame or the table turned"
    )
    lacks = full.events.kind == Kind.FRAME_LACKS
    yield from event_faults(
        full, (lacks, "the first motion after a frame is to give X, Y and Z, and gives no {said}")
    )
    beads = full.beam & ~framed & turned
    yield from row_faults(full, beads, "a bead without a frame, on a table that is turned")
    changes = np.flatnonzero(np.diff(table.frame) != 0) + 1
    lit = changes[full.beam[changes] | full.beam[changes - 1]]
    yield from row_faults(full, lit, "the frame changes under the beam")
