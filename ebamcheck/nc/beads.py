"""Beads of a program: metal that is laid in one go, as columns that every check of beads reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ebamcheck.numeric.rings import Floats, Ints


@dataclass(frozen=True, eq=False)
class Beads:
    """Beads of a program, or of some of its motions, in the order in which they are laid.

    A bead ends where beam or wire are switched on, at a travel, and where the height or the layer changes.
    """

    rows: Ints  # (n,) motions
    bead: Ints  # (n,) bead of each, from 0 without gaps
    first: Ints  # (P,) first and last motion of each bead
    last: Ints
    # (B,) numbers that rise from one bead to another, of all motions of the program, also of those that lay nothing.
    group: Ints

    @classmethod
    def of(cls, rows: Ints, group: Ints) -> Beads:
        """Beads of motions `rows` (n,), rising: rows in a row whose `group` (B,) is one are one bead."""
        begins = np.append(True, (np.diff(rows) > 1) | (np.diff(group[rows]) != 0))[: rows.size]
        at = np.flatnonzero(begins)
        last = np.append(at[1:], rows.size)[: at.size] - 1
        return cls(rows, np.cumsum(begins) - 1, rows[at], rows[last], group)

    def among(self, rows: Ints) -> Beads:
        """Beads that some of the motions make, numbered anew from 0; a bead that others of its motions part is several."""
        return Beads.of(rows, self.group)

    def __len__(self) -> int:
        """Return the number of beads."""
        return int(self.first.size)

    def total(self, values: Floats) -> Floats:
        """Sum (P,) over each bead of the `values` (n,) of its motions."""
        return np.bincount(self.bead, values, minlength=len(self)).astype(np.float64)

    def any(self, which: np.ndarray) -> np.ndarray:
        """Whether each bead (P,) has a motion that is marked in `which` (n,)."""
        return np.asarray(np.bincount(self.bead, which, minlength=len(self)) > 0)

    def greatest(self, values: Floats) -> Floats:
        """Greatest (P,) of the `values` (n,) of each bead; NaN where one is."""
        return (
            np.maximum.reduceat(values, np.searchsorted(self.bead, np.arange(len(self))))
            if len(self)
            else values[:0]
        )

    def middles(self, length_mm: Floats) -> tuple[Floats, Floats]:
        """Distance (n,) of the middle of each motion from the start of its bead, and the length (P,) of each bead, mm."""
        whole = self.total(length_mm)
        before = np.concatenate([[0.0], np.cumsum(whole)])[self.bead]
        return np.cumsum(length_mm) - 0.5 * length_mm - before, whole

    def spread(self, values: Ints, size: int) -> Ints:
        """Give each motion (size,) the value of its bead; -1 for those of none."""
        result = np.full(size, -1, np.int64)
        result[self.rows] = values[self.bead]
        return result
