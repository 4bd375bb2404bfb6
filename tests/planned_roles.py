"""Roles of the beads of a program that was read back, by the plan that it was made from."""

from __future__ import annotations

from nc_stack import make_curves, make_plan

from ebamcheck.checks.matching import matched
from ebamcheck.nc.inputs import CurveColumns, ScanColumns
from ebamcheck.nc.motions import NCProgram
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import planned_path


def as_planned(nc: NCProgram, curves: CurveColumns | None, plan: ScanColumns | None, config: Config) -> NCProgram:
    """Return the program with the roles of the plan that it was made from: contours, islands, or both."""
    if curves is None and plan is None:
        return nc
    if curves is None:
        curves = make_curves(plan.heights, [[] for _ in plan.heights], [])
    if plan is None:
        plan = make_plan(curves.heights, [])
    return matched(nc, planned_path(curves, plan, config))[0]
