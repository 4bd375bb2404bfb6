"""Tilt table and programmable frame while a program is read: the frames of a text, what is in force, and the columns that it comes
to.

TRANS and ROT begin anew, ATRANS and AROT go on from the frame in force (Siemens NC Programming manual 12/2019, section 2.12). A
turn is counter-clockwise for one who looks against its axis; turns about several axes in one block depend on a machine datum and
are refused. Frames lead to the work offset, positions of the rotary axes to the table: what is undone of that is the place on the
table."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ebamcheck.kernels import Floats, Ints
from ebamcheck.nc.motions import ARC, RAPID, STRAIGHT, NCProgram, TableColumns
from ebamcheck.nc.roles import rows_of
from ebamcheck.nc.words import NUMBER, WordError
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import RotaryAxis

NONE = np.eye(4)[:3]  # No frame: turn and shift (3, 4)
SAME_PLACE_MM = 1e-3  # Motions off by less are taken as programmed: the decimals of a program
FLAT = 1e-12  # How far the third row of a turn about the vertical may be from that of none
_FRAME = re.compile(r"(A?TRANS|A?ROT)\s+(\S.*)")
_PART = re.compile(rf"\s*(?:([XYZ])\s*=?|(RPL)\s*=)\s*({NUMBER})")


class TableState:
    """The frame in force and the positions of the rotary axes `axes`, which begin at 0."""

    def __init__(self, axes: tuple[str, ...]) -> None:
        self.axes = axes
        self.frame = NONE
        self.changed = False
        self.fresh = False  # Whether no motion has come yet since the last frame
        self._frames = [NONE]
        self._positions = [(0.0,) * len(axes)]
        self._at, self._in = 0, 0

    def seen_from(self, frame: Floats, place: Floats) -> Floats:
        """Put a frame in force; return a place (3,) of the frame before as it is in the new one."""
        was = self.frame
        self.set_frame(frame)
        return np.asarray(_seen(was[None], frame[None], place[None])[0])

    def set_frame(self, frame: Floats) -> None:
        """Put a frame in force."""
        if np.array_equal(frame, self.frame):
            return
        self.frame, self.changed, self.fresh = frame, True, True
        known = [i for i, one in enumerate(self._frames) if np.array_equal(one, frame)]
        if not known:
            self._frames.append(frame)
        self._in = known[0] if known else len(self._frames) - 1

    def turn(self, values: Mapping[str, float]) -> None:
        """Turn the axes that `values` name to their positions."""
        before = zip(self.axes, self._positions[self._at], strict=True)
        now = tuple(values.get(axis, was) for axis, was in before)
        if now not in self._positions:
            self._positions.append(now)
        self.changed = self.changed or self._positions.index(now) != self._at
        self._at = self._positions.index(now)

    def kept(self) -> tuple[int, int]:
        """Frame and positions in force, by their numbers, as the state of a motion keeps them."""
        self.changed = False
        return self._in, self._at

    def columns(self, states: Ints) -> TableColumns | None:
        """Columns of the motions from their states (2, B), frame and positions; None where nothing was ever turned or moved."""
        if len(self._frames) == 1 and len(self._positions) == 1:
            return None
        frame, after = states
        before = np.concatenate([[0], after[:-1]])[: len(after)]
        return TableColumns(
            self.axes, np.array(self._positions, np.float64).reshape(len(self._positions), len(self.axes)),
            np.stack(self._frames), before, after, frame, np.zeros(len(after)), np.zeros(len(after), np.bool_),
        )  # fmt: skip


def starts_in_frames(start: Floats, table: TableColumns) -> Floats:
    """Starts (B, 3) of motions, those of the first motions of a frame by where the motion before left the tool."""
    result, rows = start.copy(), np.flatnonzero(table.frame[1:] != table.frame[:-1]) + 1
    was, now = table.frames[table.frame[rows - 1]], table.frames[table.frame[rows]]
    result[rows] = _seen(was, now, start[rows])
    return result


def _seen(was: Floats, now: Floats, places: Floats) -> Floats:
    """Places (n, 3) of some frames (n, 3, 4) as they are in others."""
    driven = _places(places, was[:, :, :3], was[:, :, 3])
    return _places(driven - now[:, :, 3], now[:, :, :3].transpose(0, 2, 1), np.zeros(3))


def frame_after(code: str, frame: Floats) -> Floats | None:
    """Frame (3, 4) that is in force after a block; None where the block sets none, WordError for a frame that is not read."""
    found = _FRAME.fullmatch(code.strip())
    if found is None:
        return None
    word, at, parts = found[1], 0, dict[str, float]()
    while at < len(found[2]):
        part = _PART.match(found[2], at)
        if part is None:
            raise WordError(f"{found[2][at:].split()[0]!r} is no part of a frame", found.start(2) + at)
        name = part[1] or part[2]
        if name in parts:
            raise WordError(f"{name} stands twice in one block", found.start(2) + at)
        parts[name], at = float(part[3]), part.end()
    base = NONE if word in ("TRANS", "ROT") else frame
    if word.endswith("TRANS"):
        if "RPL" in parts:
            raise WordError(f"RPL belongs to ROT and AROT, not to {word}", 0)
        own = np.hstack([np.eye(3), [[parts.get(axis, 0.0)] for axis in "XYZ"]])
    else:
        if len(parts) > 1:
            what = f"{word} about several axes: their order is a datum of the machine, turn one by one"
            raise WordError(what, 0)
        (name, angle), *_ = parts.items()
        axis = "XYZ".index(name) if name != "RPL" else 2
        angle_rad = np.radians(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = np.cos(angle_rad)
        turn[i, j], turn[j, i] = -np.sin(angle_rad), np.sin(angle_rad)
        own = np.hstack([turn, np.zeros((3, 1))])
    return np.asarray(base @ np.vstack([own, [[0.0, 0.0, 0.0, 1.0]]]), np.float64)


def on_part(nc: NCProgram, config: Config) -> NCProgram:
    """Return the motions of a program in the coordinates of its part; those of the machine itself apart, in ``machine``.
    A program that neither turns a table nor sets a frame stays as it is."""
    columns = nc.table
    if columns is None:
        return nc
    # Ways of the machine itself: rapids without frame and beam, and turns of the table.
    idle = (nc.kind == RAPID) & ~nc.beam & ~nc.wire & (columns.frame == 0)
    apart = np.asarray(idle | (columns.before != columns.after))
    part = _moved(nc, part_motions(columns, config))
    off = np.linalg.norm(part.end - nc.end, axis=1)
    off = np.where(np.isnan(nc.end).all(axis=1) | apart, 0.0, np.nan_to_num(off, nan=np.inf))
    # A table and frame that are right move nothing but by their rounding, which would leave no height equal to another.
    full = replace(columns, off_mm=off, apart=apart)
    seen = nc if (off <= SAME_PLACE_MM).all() else part
    laid = rows_of(replace(seen, table=full), ~apart, np.ones(len(nc.events), np.bool_))
    return replace(laid, machine=replace(_moved(nc, columns.frames[columns.frame]), table=full))


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
