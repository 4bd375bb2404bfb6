"""Text of NC blocks: columns of numbers as lines, and the numbering of blocks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ebamcheck.rings import Floats, Ints

NUMBER_STEP = 10


class BlockFormat:
    """Formats of the motions of one program, all with the same number of decimals."""

    def __init__(self, decimals: int) -> None:
        self.decimals = decimals
        number = f"%.{decimals}f"
        triple = f"({number},{number},{number})"
        self.axis = number
        self._line = f"G1 X{number} Y{number}\n"
        self._poly = f"POLY PO[X]={triple} PO[Y]={triple} PL=1\n"
        self._control = f"X{number} Y{number} PL={number}\n"

    def rounded(self, values: Floats) -> Floats:
        """Values as they will be printed and read back; no negative zero."""
        return np.asarray(np.round(values, self.decimals) + 0.0)

    def value(self, number: float) -> str:
        """One number."""
        return self.axis % (round(float(number), self.decimals) + 0.0)

    def lines(self, points: Floats) -> list[str]:
        """G1 blocks to rounded points (n, 2)."""
        return _print(self._line, points)

    def polynomials(self, rows: Floats) -> list[str]:
        """POLY blocks over PL=1 from rows (n, 6): x end, x t^2, x t^3, y end, y t^2, y t^3."""
        return _print(self._poly, self.rounded(rows))

    def control_points(self, control: Floats, knots: Floats, shift: int) -> list[str]:
        """BSPLINE blocks for all control points but the first, which is the position before.

        Block i carries ``PL = U[i + shift] - U[i + shift - 1]``. Cumulative knots are rounded, not intervals,
        so that the length of the knot vector does not drift.
        """
        knots = self.rounded(knots - knots[0])
        i = np.arange(1, len(control))
        interval = self.rounded(knots[i + shift] - knots[i + shift - 1])
        return _print(self._control, np.column_stack([self.rounded(control[1:]), interval]))


def _print(block: str, rows: Floats) -> list[str]:
    """Fill the format `block` with each row: one % over all rows is an order faster than one each."""
    text: str = (block * len(rows)) % tuple(rows.ravel().tolist())
    return text.splitlines()


def moving(points: Floats, position: Floats) -> Ints:
    """Indices of the points (n, 2) that differ from the one before; the first is compared with `position`."""
    before = np.vstack([position[None, :], points[:-1]])
    return np.flatnonzero((points != before).any(axis=1))


def numbered(lines: Iterable[str]) -> str:
    """Number blocks from N10 up; lines that begin with ``;`` or ``%`` stay without a number."""
    result = []
    number = 0
    for line in lines:
        if line[0] in ";%":
            result.append(line)
        else:
            number += NUMBER_STEP
            result.append(f"N{number} {line}")
    return "\n".join(result) + "\n"
