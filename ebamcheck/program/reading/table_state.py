"""Rotary positions and frames while a program is read: what is in force, and the columns that it comes to."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.program.reading.frames import NONE
from ebamcheck.program.reading.table_columns import TableColumns


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
