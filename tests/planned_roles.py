"""Roles of the beads of a program that was read back, by the plan that it was made from."""

from __future__ import annotations

from ebamcheck.checks.matching import matched, tracks_known
from ebamcheck.nc.motions import NCProgram
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import planned_path
from ebamcheck.writing.inputs import CurveColumns, ScanColumns


def as_planned(
    nc: NCProgram, curves: CurveColumns | None, plan: ScanColumns | None, config: Config
) -> NCProgram:
    """Return the program with the roles of the plan that it was made from: contours, islands, or both."""
    if curves is not None and plan is not None:
        return matched(nc, planned_path(curves, plan, config))[0]
    path = tracks_known(curves, plan, config)
    return nc if path is None else matched(nc, path)[0]
