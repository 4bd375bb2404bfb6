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
        self._frames = [NONE]
        self._positions = [(0.0,) * len(axes)]
        self._at, self._in = 0, 0

    def set_frame(self, frame: Floats) -> bool:
        """Put a frame in force; return whether it is another one."""
        if np.array_equal(frame, self.frame):
            return False
        self.frame, self.changed = frame, True
        known = [i for i, one in enumerate(self._frames) if np.array_equal(one, frame)]
        if not known:
            self._frames.append(frame)
        self._in = known[0] if known else len(self._frames) - 1
        return True

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
        place = was[:, :3] @ start[row] + was[:, 3]
        result[row] = now[:, :3].T @ (place - now[:, 3])
    return result
