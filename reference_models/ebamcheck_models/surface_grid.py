"""How many rows and columns a grid on a closed freeform surface needs to keep a tolerance.

The bound is that of :mod:`ebamcheck_models.sampling`, for surfaces whose heights follow a parameter too,
so that they may turn level: a facet of a grid with steps du, dv leaves the surface by at most
(du^2 |n.S_uu| + dv^2 |n.S_vv|) / 8 + du dv |n.S_uv| / 4. Steps are equal along a whole patch, and none turns
the surface by more than :data:`STEP_DEG`, as in the export of every CAD system: that alone decides how
coarse the coarsest meshes are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ebamcheck_models.model import Floats

Surface = Callable[[Floats, Floats], Floats]
"""Points (3, ...) mm at u (once around, 0 .. 1) and v (0 .. 1, upward)."""

USED_SHARE = 0.95
"""Share of the tolerance for the bound; the rest covers rounding and what the second order leaves out."""

SHARES_AROUND = tuple(0.05 * k for k in range(4, 18))
"""Shares of the tolerance that are tried for the bend around; rows get what is left."""

LEAST_ROWS = 2

STEP_DEG = 15.0
"""Greatest turn of a full circle, or of a rounded end, in one step."""

PROBES_AROUND, PROBES_UP = 180, 48
DIFFERENCE_STEP = 1e-3
"""Step of the second differences, in ranges of the parameter."""


class Bends(NamedTuple):
    """Greatest normal parts of the second derivatives of a patch, mm."""

    around: float
    up: float
    twist: float


def bends(surface: Surface) -> Bends:
    """Measure a patch in the middles of equal cells."""
    h = DIFFERENCE_STEP
    u = ((np.arange(PROBES_AROUND) + 0.5) / PROBES_AROUND)[:, None]
    v = ((np.arange(PROBES_UP) + 0.5) / PROBES_UP)[None, :]
    at = {(a, b): surface(u + a * h, v + b * h) for a in (-1, 0, 1) for b in (-1, 0, 1)}
    along, upward = (at[1, 0] - at[-1, 0]) / (2.0 * h), (at[0, 1] - at[0, -1]) / (2.0 * h)
    normal = np.cross(along, upward, axis=0)
    normal /= np.linalg.norm(normal, axis=0)

    def greatest(second: Floats) -> float:
        return float(np.abs((normal * second).sum(axis=0)).max())

    return Bends(
        greatest((at[1, 0] - 2.0 * at[0, 0] + at[-1, 0]) / h**2),
        greatest((at[0, 1] - 2.0 * at[0, 0] + at[0, -1]) / h**2),
        greatest((at[1, 1] - at[1, -1] - at[-1, 1] + at[-1, -1]) / (4.0 * h * h)),
    )


def grid_counts(patches: list[Bends], turns_deg: list[float], tolerance_mm: float) -> tuple[int, list[int]]:
    """Columns around, the same for all patches, and rows of cells of each patch: the fewest cells that do.

    `turns_deg` is by how much each patch turns from its lower to its upper edge.
    """
    around = max(patch.around for patch in patches)

    def counts(share: float) -> tuple[int, list[int]]:
        wanted = math.sqrt(around / (8.0 * share * tolerance_mm))
        columns = max(math.ceil(wanted), math.ceil(360.0 / STEP_DEG))
        return columns, [
            max(_rows(patch, columns, tolerance_mm), math.ceil(turn / STEP_DEG), LEAST_ROWS)
            for patch, turn in zip(patches, turns_deg, strict=True)
        ]

    return min((counts(share) for share in SHARES_AROUND), key=lambda found: found[0] * sum(found[1]))


def _rows(patch: Bends, columns: int, tolerance_mm: float) -> int:
    """Rows that use up what the columns leave of the tolerance."""
    left = USED_SHARE * tolerance_mm - patch.around / (8.0 * columns**2)
    # left = up / 8 step^2 + twist / (4 columns) step, solved for one over the step.
    half = patch.twist / (8.0 * columns)
    return math.ceil((half + math.sqrt(half * half + 0.125 * patch.up * left)) / left)
