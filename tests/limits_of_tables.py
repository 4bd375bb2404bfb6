"""Limits of the checks of a tilt table, each with a figure planted just inside and just outside."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from limit_cases import Case, Subject, cube, upwards

from ebamcheck.checks.table import tilt_checks
from ebamcheck.nc.motions import TableColumns
from ebamcheck.program import Check

AXIS = {
    "name": "C",
    "axis": (0.0, 0.0, 1.0),
    "point_mm": (0.0, 0.0, 0.0),
    "min_deg": -110.0,
    "max_deg": 110.0,
}
HIGHEST_MM = 8.0
"""Top of all that the table carries; about an upright axis it stays as high."""


@cache
def on_table() -> Subject:
    """The cube on a table that is turned by a right angle behind the program's first rise, and back at its end."""
    stands = {
        "direction": (0.0, 0.0, 1.0), "turn": np.eye(3).tolist(), "shift_mm": (0.0, 0.0, 0.0), "built_mm": 3.0,
        "low_mm": (0.0, 0.0, 0.0), "high_mm": (30.0, 30.0, HIGHEST_MM),
    }  # fmt: skip
    subject = cube().by(machine={"rotary": (AXIS,)}, part={"on_table": stands})
    nc, size = subject.nc, len(subject.nc)
    after = np.ones(size, np.int64)
    after[-1] = 0
    frame = after.copy()
    before = np.concatenate([[0], after[:-1]])
    frames = np.stack([np.eye(3, 4)] * 2)
    table = TableColumns(
        ("C",),
        np.array([[0.0], [90.0]]),
        frames,
        before,
        after,
        frame,
        np.zeros(size),
        np.zeros(size, np.bool_),
    )
    return replace(subject, nc=replace(nc, machine=replace(nc, table=table)))


def with_table(**columns: np.ndarray) -> Subject:
    full = on_table().nc.machine
    return replace(on_table(), nc=replace(on_table().nc, machine=replace(full, table=replace(full.table, **columns))))


def turned_to(f: float) -> Subject:
    return with_table(positions_deg=np.array([[0.0], [110.0 + f * 1e-6]]))


def put_aside(f: float) -> Subject:
    off = np.zeros(len(on_table().nc))
    off[7] = f * 1e-3
    return with_table(off_mm=off)


def turned_at(f: float) -> Subject:
    """A turn of the table at so little over the clearance of 5 mm above all that it carries."""
    subject = with_table(apart=np.arange(len(on_table().nc)) == 3)
    full = subject.nc.machine
    start, end = full.start.copy(), full.end.copy()
    start[3, 2] = end[3, 2] = HIGHEST_MM + 5.0 - f * 2e-3
    return replace(subject, nc=replace(subject.nc, machine=replace(full, start=start, end=end)))


def judge(name: str):
    def made(subject: Subject) -> Check:
        return {check.name: check for check in tilt_checks(subject.nc, subject.config)}[name]

    return made


CASES: tuple[Case, ...] = (
    upwards("table limits", "table.LIMIT_DEG machine.rotary", turned_to, judge=judge("table limits")),
    upwards("frame", "table.SAME_PLACE_MM", put_aside, judge=judge("frame")),
    upwards("table height", "table.PLACE_MM machine.clearance_mm", turned_at, judge=judge("table height")),
)
