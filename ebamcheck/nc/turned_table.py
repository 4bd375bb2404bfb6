"""Motions of a program whose table turns: where the axes drive the tool, and where it runs on the part that is turned under it.

By the text alone: the frames in force take the program to the work offset, the positions of the rotary axes tell how the table
stands there, and what is undone of that is the place on the table. How the part lies on the table is told by the settings
(``part.on_table``), which are held against the mesh elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ebamcheck.nc.motions import ARC, RAPID, STRAIGHT, NCProgram
from ebamcheck.nc.preheating import rows_of
from ebamcheck.nc.table import TableColumns
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config
from ebamcheck.settings.tilt import RotaryAxis

SAME_PLACE_MM = 1e-3
"""Motions that table and frame put within this of where they belong are taken as they are programmed: the decimals of a program."""

FLAT = 1e-12
"""How far the third row of a turn about the vertical may be from that of none."""


def on_part(nc: NCProgram, config: Config) -> NCProgram:
    """Return the motions of a program in the coordinates of its part; those of the machine itself apart, in ``machine``.

    A program that neither turns a table nor sets a frame stays as it is.
    """
    columns = nc.table
    if columns is None:
        return nc
    driven = _moved(nc, columns.frames[columns.frame])
    machine = replace(
        nc,
        start=driven.start,
        end=driven.end,
        kind=driven.kind,
        coefficients=driven.coefficients,
        arc=driven.arc,
    )
    apart = _apart(nc, columns)
    part = _moved(nc, part_motions(columns, config))
    off = np.linalg.norm(part.end - nc.end, axis=1)
    off = np.where(np.isnan(nc.end).all(axis=1) | apart, 0.0, np.nan_to_num(off, nan=np.inf))
    # A table and frame that are right move nothing but by their rounding, which would leave no height equal to another.
    full = replace(columns, off_mm=off, apart=apart)
    seen = nc if (off <= SAME_PLACE_MM).all() else part
    laid = rows_of(replace(seen, table=full), ~apart, np.ones(len(nc.events), np.bool_))
    return replace(laid, machine=replace(machine, table=full))


def _apart(nc: NCProgram, columns: TableColumns) -> Bools:
    """Ways of the machine itself: rapids without frame and beam, and turns of the table."""
    idle = (nc.kind == RAPID) & ~nc.beam & ~nc.wire & (columns.frame == 0)
    return np.asarray(idle | (columns.before != columns.after))


def part_motions(columns: TableColumns, config: Config) -> Floats:
    """Turn and shift (B, 3, 4) from the coordinates of the program to those of the part, for each motion."""
    stands = config.part.on_table
    mounted = np.eye(4)[:3]
    if stands is not None:
        # Rows times turn, as a column from the left.
        mounted = np.hstack([np.array(stands.turn).T, np.array(stands.shift_mm)[:, None]])
    tables = np.stack([_undone(table_at(config.machine.rotary, row)) for row in columns.positions_deg])
    on_table = _joined(np.broadcast_to(mounted, tables.shape), tables)
    return _joined(on_table[columns.after], columns.frames[columns.frame])


def table_at(axes: Sequence[RotaryAxis], positions_deg: Sequence[float] | Floats) -> Floats:
    """Turn and shift (3, 4) of the table at positions of its axes, by Rodrigues' formula."""
    found = np.eye(4)
    for axis, position in zip(axes, positions_deg, strict=True):
        line = np.array(axis.axis, np.float64) / np.linalg.norm(axis.axis)
        angle = np.radians(axis.sign * float(position))
        cross = np.cross(np.eye(3), line)
        own = np.eye(4)
        own[:3, :3] = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
        own[:3, 3] = np.array(axis.point_mm) - own[:3, :3] @ np.array(axis.point_mm)
        found = found @ own
    return np.asarray(found[:3], np.float64)


def _undone(motion: Floats) -> Floats:
    turn = motion[:, :3].T
    return np.hstack([turn, -turn @ motion[:, 3:]])


def _joined(outer: Floats, inner: Floats) -> Floats:
    """One motion after another (n, 3, 4)."""
    turn = outer[:, :, :3] @ inner[:, :, :3]
    shift = outer[:, :, :3] @ inner[:, :, 3:] + outer[:, :, 3:]
    return np.concatenate([turn, shift], axis=2)


def _moved(nc: NCProgram, motions: Floats) -> NCProgram:
    """Motions moved, each by its own turn and shift (B, 3, 4). Arcs that are tilted become their chords."""
    turn, shift = motions[:, :, :3], motions[:, :, 3]
    start, end = _places(nc.start, turn, shift), _places(nc.end, turn, shift)
    flat = np.abs(turn[:, 2] - [0.0, 0.0, 1.0]).max(axis=1, initial=0.0) <= FLAT
    coefficients = np.einsum("bij,bjk->bik", turn[:, :2, :2], nc.coefficients)
    rise = np.stack([nc.start[:, 2], nc.end[:, 2] - nc.start[:, 2]], axis=1)
    lift = np.where(turn[:, :2, 2, None] == 0.0, 0.0, turn[:, :2, 2, None] * rise[:, None])
    coefficients[:, :, :2] += lift
    coefficients[:, :, 0] += shift[:, :2]
    arc = nc.arc.copy()
    arc[:, :2] = np.einsum("bij,bj->bi", turn[:, :2, :2], nc.arc[:, :2]) + shift[:, :2]
    chords: Ints = np.flatnonzero(~flat & (nc.kind == ARC))
    kind = nc.kind.copy()
    kind[chords], arc[chords] = STRAIGHT, np.nan
    coefficients[chords] = 0.0
    coefficients[chords, :, 0] = start[chords, :2]
    coefficients[chords, :, 1] = (end - start)[chords, :2]
    return replace(nc, start=start, end=end, kind=kind, coefficients=coefficients, arc=arc)


def _places(places: Floats, turn: Floats, shift: Floats) -> Floats:
    """Places (B, 3) moved; an axis that is not known spoils only those that it goes into."""
    parts = np.where(turn == 0.0, 0.0, turn * places[:, None, :])
    return np.asarray(parts.sum(axis=2) + shift, np.float64)
