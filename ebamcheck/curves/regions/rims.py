"""Rims: bends at the sides of strips that may be a coarse rounding across them.

A strip that is curved along its length, between two bends, may be one of a few strips of a rounding that is curved the other
way across them, as at the inner rim of a ring. The contour's chord errors in the two directions have opposite signs there and
partly cancel; correcting only one would increase the error.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.curves.regions.borders import Borders
from ebamcheck.curves.regions.segmentation import STRIP, Kinds
from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

INWARD, OUTWARD = 0, 1
"""Columns of the rims' sagittas: the side of the strip on which the surface may lie."""


@kernel
def rim_sagittas(twin: Index, whole: Index, label: Index, borders: Borders, kind: Kinds) -> Floats:
    """How far a surface would stand off each strip (G, 2), mm, if its bends to other strips were a rounding's; else 0.

    `twin` lacks the half-edges at which the surface is sharp, `whole` none. Edges at which facets meet by the crease angle or
    more are no such bends: `borders` does not have their turns.
    """
    found = np.zeros((len(kind), 2))
    for h in range(twin.size):
        group, turn = label[h // 3], borders.turn[h]
        if twin[h] != NO_TWIN or turn == 0.0 or kind[group] != STRIP:
            continue
        if kind[label[whole[h] // 3]] == STRIP:
            side = OUTWARD if turn > 0.0 else INWARD
            found[group, side] = max(found[group, side], borders.width[h] * abs(turn) / 8.0)
    return found
