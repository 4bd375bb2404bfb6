"""Gaps and walls from 0.01 to 1 mm, which slicers may close, join or lose."""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from ebamcheck_models.polyhedra import Polyhedron, cells

WIDTHS_MM = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Widths of the comb's gaps and of the thin walls, from left to right."""

PITCH_MM = 5.0
"""Width of a tooth of the comb, and of the free space between two thin walls."""


def _planes() -> list[float]:
    """Alternating wide and narrow intervals, beginning and ending with a wide one."""
    steps = [width for narrow in WIDTHS_MM for width in (PITCH_MM, narrow)]
    return list(accumulate([*steps, PITCH_MM], initial=0.0))


def _comb() -> Polyhedron:
    planes = _planes()
    filled = np.ones((len(planes) - 1, 2, 2), dtype=bool)
    filled[1::2, 1, 1] = False
    return cells(
        "comb",
        "block with gaps of 0.01, 0.02, 0.05, 0.1, 0.2, 0.5 and 1 mm: below a plate, above a comb",
        (planes, (0.0, 6.0, 30.0), (0.0, 4.0, 20.0)),
        filled,
        2,
    )


def _thin_walls() -> Polyhedron:
    planes = _planes()
    filled = np.zeros((len(planes) - 1, 3, 1), dtype=bool)
    filled[1::2] = True
    filled[:, [0, 2]] = True
    return cells(
        "thin-walls",
        "ladder of two rails whose rungs are walls of 0.01, 0.02, 0.05, 0.1, 0.2, 0.5 and 1 mm",
        (planes, (0.0, 5.0, 25.0, 30.0), (0.0, 20.0)),
        filled,
        2 - 2 * (len(WIDTHS_MM) - 1),
    )


COMB, THIN_WALLS = _comb(), _thin_walls()
