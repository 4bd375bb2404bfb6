"""What the tests of the regression reports install as a plugin: a model, and slicers whose loss is known.

A module of its own, so that worker processes need not import the tests.
"""

from __future__ import annotations

import os

import numpy as np
from broken_backends import FAULTS, broken, rebuilt

from ebamcheck_models.polyhedra import cells
from ebamcheck_planecut import PlaneCut

BOUND_MM = 0.1
"""Bound that the rough slicers below declare."""
ROUGH_MM = 0.05
"""What they really are off, before a loss is planted."""


def _block():
    """A stepped block with a hole, a pore of 0.02 mm and a slit of 0.05 mm; no symmetry, every coordinate exact."""
    x = (0.0, 6.0, 8.0, 10.0, 10.02, 13.0, 13.05, 20.0)
    y = (0.0, 4.0, 6.0, 6.02, 9.0, 12.0)
    filled = np.ones((len(x) - 1, len(y) - 1, 2), dtype=bool)
    filled[1, 1] = False
    filled[3, 2] = False
    filled[5, 3:] = False
    filled[0, 3:, 1] = False
    return cells("trial-block", "stepped block with hole, pore and slit", (x, y, (0.0, 5.0, 10.0)), filled, -2)


BLOCK = _block()


def _rough(name: str, off_mm: float) -> type[PlaneCut]:
    """The exact cut, moved along x by a known distance under a declared bound."""
    return broken(
        PlaneCut,
        name,
        lambda part, cut, heights: rebuilt(cut(heights), change=lambda p: p + np.array([off_mm, 0.0])),
        error_bound_mm=lambda self, part, settings: BOUND_MM,
    )


ALLOWED_MM = 6e-5
"""What the tolerance of a length allows over that."""
PLANTED = {
    "rough": _rough("rough", ROUGH_MM),
    "rough-within": _rough("rough-within", ROUGH_MM + 0.5 * ALLOWED_MM),
    "rough-beyond": _rough("rough-beyond", ROUGH_MM + ALLOWED_MM + 0.01 * BOUND_MM),
}


class Aborting(PlaneCut):
    name = "aborting"

    def prepare(self, part, settings):
        os.abort()


SLICERS = {made.name: made for made in (*(f.slicer for f in FAULTS.values()), *PLANTED.values(), Aborting)}
"""All slicers of the plugin by name."""

globals().update({name.replace("-", "_"): made for name, made in SLICERS.items()})
