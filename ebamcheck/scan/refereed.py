"""Plans driven on the nonlinear referee, to see whether it ranks orders and islands as the linear model does."""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.config import Config
from ebamcheck.heat.referee import Referee, Verdict, judged, referee
from ebamcheck.rings import Floats
from ebamcheck.scan.laying import LaidLayer
from ebamcheck.scan.plan import ScanPlan
from ebamcheck.scan.simulate import beam_lines, simulate_order

CELLS_PER_ISLAND = 4.0
"""Cells of the referee across an island."""


def referee_of(laid: LaidLayer, profile: Config, cells_per_island: float = CELLS_PER_ISLAND) -> Referee:
    """Set up the referee of a layer that has islands."""
    section = laid.regions.section
    width_mm = math.sqrt(section.area / len(laid.islands))
    return referee(section, profile, laid.height_mm, width_mm / cells_per_island)


def refereed(model: Referee, plan: ScanPlan, profile: Config) -> Verdict:
    """Drive a plan of one layer from cold; what it finds is by island of the plan."""
    ends, begin_s, end_s = beam_lines(plan, profile)
    driven = simulate_order(plan, profile).sort_values("island")
    entered: Floats = driven["start_s"].fillna(0.0).to_numpy(np.float64)
    return judged(
        model,
        model.cold(),
        ends,
        begin_s,
        end_s,
        profile.process.power_w * profile.material.absorptivity,
        plan.islands,
        entered,
        float(end_s[-1]) if len(end_s) else 0.0,
    )
