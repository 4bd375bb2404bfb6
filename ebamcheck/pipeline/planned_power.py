"""A plan whose heat is that of the beads of its program: the power along each follows from the wire that it will get."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.backend import Progress
from ebamcheck.curves import LIFTED, Curves, fit
from ebamcheck.curves.turned import turned_over
from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.metal import Surface
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan import ScanPlan, plan_stack
from ebamcheck.scan.heat.part_heat import BeadPower
from ebamcheck.scan.plan.stacking import in_order
from ebamcheck.scan.plan.whole_part import OrderedLayer, PowerOf
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import uppermost_seams, with_bead_ends, written_form
from ebamcheck.writing.bead_parts import along_beads, path_points
from ebamcheck.writing.cuts import segment_lengths
from ebamcheck.writing.seams import NO_SEAMS
from ebamcheck.writing.tracks import toolpath
from ebamcheck.writing.wire import bare_surface, wired


def plan_program(layers: Layers, config: Config, progress: Progress | None = None) -> ScanPlan:
    """Plan a stack whose program is to be written: as :func:`ebamcheck.scan.plan_stack`, by the power that its beads will have."""
    sections = [layers.section(k) for k in range(len(layers))]
    return plan_stack(layers, config, progress, power_of=power_by_wire(sections, config))


def power_by_wire(
    sections: Sequence[BaseGeometry], config: Config, stands: Surface | None = None, first_layer: int = 0
) -> PowerOf | None:
    """Power along beads by their wire, layer by layer from below; None where every layer has the full power.

    Parameters
    ----------
    sections
        (L,) of all layers.
    stands
        What the lowest of them lies on; None: the plate.
    first_layer
        Index in the build of the lowest of them.
    """
    process = config.process
    if isinstance(process.power_schedule, str) and process.interpass in ("off", "dwell"):
        return None
    surface = stands.copy() if stands is not None else None
    seams, number = NO_SEAMS, first_layer

    def power_of(layer: OrderedLayer, thickness_mm: float) -> BeadPower:
        nonlocal surface, seams, number
        if surface is None:
            surface = bare_surface(sections, config)
        plan, machine = _OneLayer.of(layer), config.machine
        decimals = machine.printed_decimals
        lines = from_polygons(plan.heights, [[layer.laid.regions.contour]])
        path = toolpath(
            bead_curves(lines, config, number),
            plan,
            config,
            decimals,
            written_form(machine),
            machine.line_tolerance_mm,
        )
        number += 1
        path = replace(path, z=np.array([config.base_mm + thickness_mm]))
        below, seams = seams, uppermost_seams(path, process, seams)
        path = with_bead_ends(path, process, decimals, below)
        if not path.kind.size:
            return BeadPower(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
        points = path_points(path)
        parts = wired(path, plan, config, points, segment_lengths(path.kind, points), surface)
        return along_beads(parts, path.ring.size, thickness_mm, config)

    return power_of


def bead_curves(lines: Layers, config: Config, first_layer: int = 0) -> Curves:
    """Curves along the centre lines of contour beads, in the direction in which they are driven; `first_layer` as above."""
    # What lies along a bead was lifted with the contour; an inset has no edges of the mesh of its own.
    method = "bounded" if config.curves.method in LIFTED else config.curves.method
    # Half of a bulge's limit is a contour's own; beyond its tolerance a path would leave the curves that it follows.
    bulge_mm = min(config.curves.largest_bulge_mm, 2.0 * config.curves.tolerance_mm)
    curves = fit(lines, method, config.curves, largest_bulge_mm=bulge_mm)
    if config.process.contour_direction == "same":
        return curves
    return turned_over(curves, curves.closed & ((curves.ring_layer + first_layer) % 2 == 1))


class _Lines(NamedTuple):
    """Columns of hatch vectors (V,), in scan order."""

    island: Ints
    x0: Floats
    y0: Floats
    x1: Floats
    y1: Floats


@dataclass(frozen=True, eq=False)
class _OneLayer:
    """Plan of one layer, as far as its path asks for it."""

    heights: Floats
    island_layer: Ints
    order: Ints
    island_kind: NDArray[np.str_]
    sections: NDArray[np.object_]
    vectors: _Lines

    @classmethod
    def of(cls, layer: OrderedLayer) -> _OneLayer:
        laid, lines = layer.laid, in_order(layer).vectors
        sections = np.empty(1, np.object_)
        sections[0] = laid.regions.section
        return cls(
            np.array([laid.height_mm]),
            np.zeros(len(laid.islands), np.int64),
            layer.order,
            laid.kind,
            sections,
            _Lines(lines.island, *lines.start.T, *lines.end.T),
        )
