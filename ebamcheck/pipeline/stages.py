"""Stages that a run, a live layer and a verification share: plain functions of values, which know no job and no run folder."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from ebamcheck.curves import LIFTED, Curves
from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.mesh.part import Part
from ebamcheck.nc.control import control
from ebamcheck.pipeline import gates
from ebamcheck.pipeline.fit_evidence import FitVerdict
from ebamcheck.pipeline.planned_power import bead_curves
from ebamcheck.program import ProgramFiles
from ebamcheck.result import Check
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import planned_path
from ebamcheck.writing.tracks import Toolpath

SAMPLING_MM = 0.002
"""Beads are planned inside of polylines this near to the fitted curves, and their path is held against such: a tenth of the
tolerance of the fit."""


def smooth_layers(curves: Curves) -> Layers:
    """Polylines along fitted contours, inside of which beads are planned."""
    return curves.sample_tolerance(SAMPLING_MM)


def smooth_sections(curves: Curves, config: Config) -> Layers | None:
    """Sections with the curves that their chords stand for; None where the method of the fit makes none."""
    return smooth_layers(curves) if config.curves.method in LIFTED else None


def bead_paths(layers: Layers, plan: ScanPlan, config: Config, first_layer: int = 0) -> Curves:
    """Curves along the centre lines of the contour beads, in the direction in which they are driven.

    Parameters
    ----------
    first_layer
        Index in the build of the lowest of the layers.
    """
    lines = from_polygons(
        layers.heights,
        [[region] for region in plan.contours],
        part=layers.part,
        direction=layers.direction,
        backend=layers.backend,
        settings=layers.settings,
    )
    return bead_curves(lines, config, first_layer)


class LaidOut(NamedTuple):
    """What a program is made from."""

    beads: Curves
    plan: ScanPlan
    path: Toolpath


def laid_out(smooth: Layers, plan: ScanPlan, config: Config, first_layer: int = 0) -> LaidOut:
    """Lay out the tracks of a plan; `first_layer` as of :func:`bead_paths`."""
    beads = bead_paths(smooth, plan, config, first_layer)
    return LaidOut(beads, plan, planned_path(beads, plan, config))


def header_of(part: Part) -> dict[str, str]:
    """Lines that the header of a program has beside its own: which part it makes."""
    return {"PART SHA-256": part.source_sha256 or part.sha256}


def written(laid: LaidOut, part: Part, config: Config, folder: Path) -> ProgramFiles:
    """Write the program of a part into a folder."""
    files: ProgramFiles = control(config.machine.control).written(
        laid.beads, laid.plan, config, folder, header=header_of(part), path=laid.path
    )
    return files


def judged_program(
    verdict: FitVerdict, checks: Iterable[Check], metrics: pd.DataFrame, config: Config
) -> list[Check]:
    """Gates of the fit, the plan's coverage, and the checks of a program."""
    made = list(checks)
    return [
        gates.fit_gate(verdict),
        gates.coverage_gate(metrics, config),
        gates.deposit_gate(made, config),
        gates.heat_gate(made, metrics, config),
        gates.program_gate(made),
    ]
