"""Balance: how much wire each bead needs so that the beads together lay the section, no more and no less.

Beads overlap where hatch lines end, turn and meet the contour, and lie apart where an island has no room for a whole
number of lines. So each bead gets the wire for the metal that is missing under it: the width times the layer's height
of what it lays. The widths are those that make a layer flat with the greatest likelihood, found by the multiplicative
iteration of Richardson (1972, J. Opt. Soc. Am. 62:55) and Lucy (1974, Astron. J. 79:745), which keeps them positive and
the sum of the metal that of the section.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.kernels import Floats, Ints, kernel
from ebamcheck.metal.footprints import Footprints

LEAST_RIM, MOST_RIM = 1.0 / 1.15, 1.4
"""Factors by which all widths of a layer are changed at most so that the sum of the metal is right. Walls that are a little wider
than a bead get less than three quarters of their metal by their middle, where pools overlap, and which counts most."""

ITERATIONS = 10
"""Steps of the iteration: the sum is right after the first, and a layer hardly gets flatter after so many."""


def balanced_widths(
    found: Footprints,
    share: Floats,
    weight: Floats,
    cell_mm2: float,
    width_mm: Floats,
    limits_mm: tuple[float, float],
) -> Floats:
    """Widths of metal (B,) that lay a section flat, mm.

    `share` and `weight` (rows, columns) are what of each cell is to be metal, one layer high, and how much it counts; the widths
    (B,) to begin with are changed between the limits.
    """
    columns = found.starts, found.cell, found.length_mm
    width = np.array(width_mm, np.float64)
    iterate(columns, share.ravel(), weight.ravel(), cell_mm2, width, limits_mm, ITERATIONS)
    # Cells that count less, or that pools only touch, miss some of a layer: all beads lay it together, but for those at a limit,
    # whose places ask for less, or for more, than they get.
    free = (width > limits_mm[0]) & (width < limits_mm[1])
    laid, by_free = (
        found.laid(some, share.size, cell_mm2).sum() for some in (width, np.where(free, width, 0.0))
    )
    if by_free <= 0.0:
        return width
    missing = min(max(1.0 + (share.sum() - laid) / by_free, LEAST_RIM), MOST_RIM)
    return np.where(free, np.clip(width * missing, *limits_mm), width)


@kernel
def iterate(
    columns: tuple[Ints, Ints, Floats],
    share: Floats,
    weight: Floats,
    cell_mm2: float,
    width: Floats,
    limits_mm: tuple[float, float],
    steps: int,
) -> None:
    """Change `width` step by step, by footprints' starts, cells and lengths."""
    starts, cell, length_mm = columns
    least, most = limits_mm
    laid = np.empty(share.size)
    for _ in range(steps):
        laid[:] = 0.0
        for bead in range(len(width)):
            for n in range(starts[bead], starts[bead + 1]):
                laid[cell[n]] += width[bead] * length_mm[n] / cell_mm2
        for bead in range(len(width)):
            wanted, whole = 0.0, 0.0
            for n in range(starts[bead], starts[bead + 1]):
                counted = weight[cell[n]] * length_mm[n]
                whole += counted
                if share[cell[n]] > 0.0:
                    wanted += counted * share[cell[n]] / laid[cell[n]]
            if whole > 0.0:
                width[bead] = min(max(width[bead] * wanted / whole, least), most)
