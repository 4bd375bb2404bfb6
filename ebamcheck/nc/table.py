"""Tilt table and programmable frame while a program is read: the frames of a text, what is in force, and the columns that it comes to.

Frames are taken as a SINUMERIK takes them: TRANS and ROT begin anew, ATRANS and AROT go on from the frame in force. Source: Siemens NC
Programming manual 12/2019, section 2.12. A turn about one axis, or by RPL in the plane G17, is counter-clockwise for one who looks
against the axis. Turns about several axes in one block depend on a machine datum and are refused.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ebamcheck.nc.words import NUMBER, WordError
from ebamcheck.numeric.rings import Bools, Floats, Ints

AXIS_EVENT = "table axis "
"""Begin of the event of a rotary axis that is commanded, behind which its name stands; its value is the position."""

NONE = np.eye(4)[:3]
"""No frame: turn and shift (3, 4)."""

_FRAME = re.compile(r"(A?TRANS|A?ROT)\s+(\S.*)")
_PART = re.compile(rf"\s*(?:([XYZ])\s*=?|(RPL)\s*=)\s*({NUMBER})")


@dataclass(frozen=True, eq=False)
class TableColumns:
    """Rotary positions and frames in force, one row for each motion (B,).

    Parameters
    ----------
    axes
        Names of the rotary axes (A,).
    positions_deg
        (P, A) every set of positions that the table stands at, the first all 0.
    frames
        (F, 3, 4) every frame that is in force, turn and shift, the first none: a place p of the program lies at turn @ p + shift.
    before, after
        (B,) positions of the table before and after the motion, by their row.
    frame
        (B,) frame during the motion, by its row.
    off_mm
        (B,) how far table and frame put the end of the motion from where it belongs on the part, mm.
    apart
        (B,) ways of the machine itself, with neither frame nor beam, and turns of the table: they are none of a layer.
    """

    axes: tuple[str, ...]
    positions_deg: Floats
    frames: Floats
    before: Ints
    after: Ints
    frame: Ints
    off_mm: Floats
    apart: Bools

    def rows(self, kept: Bools) -> TableColumns:
        """Some of the motions."""
        columns = (getattr(self, name)[kept] for name in ("before", "after", "frame", "off_mm", "apart"))
        return TableColumns(self.axes, self.positions_deg, self.frames, *columns)


class TableState:
    """The frame in force and the positions of the rotary axes `axes`, which begin at 0."""

    def __init__(self, axes: tuple[str, ...]) -> None:
        self.axes = axes
        self.frame = NONE
        self.changed = False
        self.fresh = False
        """Whether no motion has come yet since the last frame."""
        self._frames = [NONE]
        self._positions = [(0.0,) * len(axes)]
        self._at, self._in = 0, 0

    def seen_from(self, frame: Floats, place: Floats) -> Floats:
        """Put a frame in force; return a place (3,) of the frame before as it is in the new one."""
        was = self.frame
        self.set_frame(frame)
        return _seen(was, frame, place)

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
        now = tuple(
            values.get(axis, was) for axis, was in zip(self.axes, self._positions[self._at], strict=True)
        )
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
            self.axes,
            np.array(self._positions, np.float64).reshape(len(self._positions), len(self.axes)),
            np.stack(self._frames),
            before,
            after,
            frame,
            np.zeros(len(after)),
            np.zeros(len(after), np.bool_),
        )


def starts_in_frames(start: Floats, table: TableColumns) -> Floats:
    """Starts (B, 3) of motions, those of the first motions of a frame by where the motion before left the tool."""
    result = start.copy()
    for row in (np.flatnonzero(table.frame[1:] != table.frame[:-1]) + 1).tolist():
        was, now = table.frames[table.frame[row - 1]], table.frames[table.frame[row]]
        result[row] = _seen(was, now, start[row])
    return result


def _seen(was: Floats, now: Floats, place: Floats) -> Floats:
    """A place (3,) of one frame as it is in another; an axis that is not known spoils only those that it goes into."""
    driven = _times(was[:, :3], place) + was[:, 3]
    return _times(now[:, :3].T, driven - now[:, 3])


def _times(turn: Floats, place: Floats) -> Floats:
    return np.asarray(np.where(turn == 0.0, 0.0, turn * place).sum(axis=1), np.float64)


# -- frames -----------------------------------------------------------------------------------------


def frame_after(code: str, frame: Floats) -> Floats | None:
    """Frame (3, 4) that is in force after a block; None where the block sets none.

    Raises
    ------
    WordError
        For a frame that is not read.

    Examples
    --------
    >>> frame_after("TRANS X10 Z5", NONE)[:, 3].tolist()
    [10.0, 0.0, 5.0]
    >>> (frame_after("AROT Z90", NONE)[:, 0] + 0.0).round(6).tolist()
    [0.0, 1.0, 0.0]
    """
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
            raise WordError(
                f"{word} about several axes: their order is a datum of the machine, turn one by one", 0
            )
        (name, angle), *_ = parts.items()
        own = np.hstack(
            [_about("XYZ".index(name) if name != "RPL" else 2, np.radians(angle)), np.zeros((3, 1))]
        )
    return np.asarray(base @ np.vstack([own, [[0.0, 0.0, 0.0, 1.0]]]), np.float64)


def _about(axis: int, angle_rad: float) -> Floats:
    """Turn (3, 3) about X, Y or Z."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = np.cos(angle_rad)
    turn[i, j], turn[j, i] = -np.sin(angle_rad), np.sin(angle_rad)
    return turn
