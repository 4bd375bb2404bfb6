"""Stages that a run, a live layer and a verification share: plain functions of values, which know no job and no run folder."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from shapely.geometry.base import BaseGeometry

from ebamcheck.backend import Progress
from ebamcheck.curves import LIFTED, Curves, fit
from ebamcheck.curves.columns import turned_over
from ebamcheck.heat.part_heat import BeadPower
from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.mesh.part import Part
from ebamcheck.metal import Surface
from ebamcheck.nc.control import control
from ebamcheck.pipeline import gates
from ebamcheck.pipeline.fit import FitVerdict
from ebamcheck.program import ProgramFiles
from ebamcheck.result import Check
from ebamcheck.scan import ScanPlan, plan_stack
from ebamcheck.scan.islands.clipping import column
from ebamcheck.scan.islands.regions import contour_region
from ebamcheck.scan.plan.whole_part import OrderedLayer, PowerOf
from ebamcheck.settings.config import Config
from ebamcheck.threads import run_each
from ebamcheck.writing.bead_ends import NO_SEAMS, planned_path, uppermost_seams, with_bead_ends, written_form
from ebamcheck.writing.bead_parts import along_beads
from ebamcheck.writing.tracks import Toolpath, toolpath
from ebamcheck.writing.wire import bare_surface, wired

# Beads are planned inside of polylines this near to the fitted curves, and their path is held against such: a tenth of the tolerance of the fit
SAMPLING_MM = 0.002


def smooth_layers(curves: Curves) -> Layers:
    """Polylines along fitted contours, inside of which beads are planned."""
    return curves.sample_tolerance(SAMPLING_MM)


def smooth_sections(curves: Curves, config: Config) -> Layers | None:
    """Sections with the curves that their chords stand for; None where the method of the fit makes none."""
    return smooth_layers(curves) if config.curves.method in LIFTED else None


# -- plan --------------------------------------------------------------------------------------------


def plan_program(layers: Layers, config: Config, progress: Progress | None = None) -> ScanPlan:
    """Plan a stack whose program is to be written: as :func:`ebamcheck.scan.plan_stack`, by the power that its beads will have."""
    sections = [layers.section(k) for k in range(len(layers))]
    contours = run_each(lambda section: contour_region(section, config), sections)
    beads = contour_curves(layers, contours, config)
    power_of = power_by_wire(sections, beads, config)
    return replace(plan_stack(layers, config, progress, power_of=power_of, contours=contours), beads=beads)


def power_by_wire(
    sections: Sequence[BaseGeometry], beads: Curves, config: Config, stands: Surface | None = None
) -> PowerOf | None:
    """Power along beads by their wire, layer by layer from below; None where every layer has the full power.

    `beads` are the curves of the contour beads of all these layers; `stands` is what the lowest lies on (None: the plate).
    """
    process = config.process
    if isinstance(process.power_schedule, str) and process.interpass in ("off", "dwell"):
        return None
    surface = stands.copy() if stands is not None else None
    seams, number = NO_SEAMS, 0

    def power_of(layer: OrderedLayer, thickness_mm: float) -> BeadPower:
        nonlocal surface, seams, number
        if surface is None:
            surface = bare_surface(sections, config)
        plan, machine = _one_layer(layer), config.machine
        decimals = machine.printed_decimals
        curves = replace(beads.block(number, number + 1), heights=plan.heights)
        path = toolpath(curves, plan, config, decimals, written_form(machine), machine.line_tolerance_mm)
        number += 1
        path = replace(path, z=np.array([config.base_mm + thickness_mm]))
        below, seams = seams, uppermost_seams(path, process, seams)
        path = with_bead_ends(path, process, decimals, below)
        if not path.kind.size:
            return BeadPower(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
        return along_beads(wired(path, plan, config, surface), path.ring.size, thickness_mm, config)

    return power_of


def contour_curves(layers: Layers, contours: Sequence[BaseGeometry], config: Config, first_layer: int = 0) -> Curves:
    """Curves along the centre lines (L,) of the contour beads of layers, as they are driven; the lowest is `first_layer` of the
    build."""
    labels = {name: getattr(layers, name) for name in ("part", "direction", "backend", "settings")}
    lines = from_polygons(layers.heights, [[region] for region in contours], **labels)
    # What lies along a bead was lifted with the contour; an inset has no edges of the mesh of its own.
    method = "bounded" if config.curves.method in LIFTED else config.curves.method
    # Half of a bulge's limit is a contour's own; beyond its tolerance a path would leave the curves that it follows.
    bulge_mm = min(config.curves.largest_bulge_mm, 2.0 * config.curves.tolerance_mm)
    curves = fit(lines, method, config.curves, largest_bulge_mm=bulge_mm)
    if config.process.contour_direction == "same":
        return curves
    return turned_over(curves, curves.closed & ((curves.ring_layer + first_layer) % 2 == 1))


def _one_layer(layer: OrderedLayer) -> Any:
    """Plan of one layer, as far as its path asks for it."""
    laid, lines = layer.laid, layer.lines
    (x0, y0), (x1, y1) = lines.start.T, lines.end.T
    return SimpleNamespace(
        heights=np.array([laid.height_mm]),
        island_layer=np.zeros(len(laid.islands), np.int64),
        order=layer.order,
        island_kind=laid.kind,
        sections=column([laid.regions.section]),
        vectors=SimpleNamespace(island=lines.island, x0=x0, y0=y0, x1=x1, y1=y1),
    )


# -- program -----------------------------------------------------------------------------------------


def bead_paths(layers: Layers, plan: ScanPlan, config: Config, first_layer: int = 0) -> Curves:
    """Curves along the contour beads of a plan: those that it was made with, or new ones as of :func:`contour_curves`."""
    found: Curves | None = plan.beads
    return contour_curves(layers, list(plan.contours), config, first_layer) if found is None else found


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


def judged_program(verdict: FitVerdict, checks: Iterable[Check], metrics: pd.DataFrame, config: Config) -> list[Check]:
    """Gates of the fit, the plan's coverage, and the checks of a program."""
    made = list(checks)
    return [
        gates.fit_gate(verdict),
        gates.coverage_gate(metrics, config),
        gates.deposit_gate(made, config),
        gates.heat_gate(made, metrics, config),
        gates.program_gate(made),
    ]
