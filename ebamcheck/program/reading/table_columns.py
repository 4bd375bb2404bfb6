"""What a tilt table and the programmable frame do during each motion of a program, as columns."""

from __future__ import annotations

from dataclasses import dataclass

from ebamcheck.numeric.rings import Bools, Floats, Ints

AXIS_EVENT = "table axis "
"""Begin of the event of a rotary axis that is commanded, behind which its name stands; its value is the position."""


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
