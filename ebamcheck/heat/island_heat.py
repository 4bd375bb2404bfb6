"""The heat model of a layer's islands, and how warm they are when the beam enters them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.heat import HeatModel, Medium, contour_modes, depth_modes
from ebamcheck.heat.field import Modes, Timetable, surfaces_at_entries
from ebamcheck.heat.near_field import OPTIONS, NearField, entry_rise, near_field, young_mean
from ebamcheck.kernels import Floats, Ints, kernel
from ebamcheck.settings.config import Config

PLANNING_MODES = 400  # modes of the section that a plan uses at most: beyond, only the longest waves count
PLANNING_WORK = 4e9  # modes times the square of the islands in a plan at most: over 3000 islands it knows fewer modes


@dataclass(frozen=True, eq=False)
class IslandHeat:
    """Islands as sources and readings of the heat model."""

    modes: Modes
    start_k: Floats  # (K, N) amplitudes when the layer begins
    model: HeatModel  # whose modes these are
    complete: float  # eigenvalue up to which these are all modes of section and depth, 1/mm^2
    near: NearField | None = (
        None  # young heat between islands near each other, which the modes lack; None: by the modes alone
    )

    @property
    def fresh(self) -> NearField:
        """What the modes lack, where it is known."""
        assert self.near is not None, "the fresh heat of this model was not set up: see with_fresh_heat"
        return self.near


def island_heat(
    section: BaseGeometry,
    islands: NDArray[np.object_],
    beam_s: Floats,
    time_s: Floats,
    config: Config,
    height_mm: float,
    fine: bool = False,
) -> IslandHeat:
    """Set up the heat model of a layer.

    `section`: solid region of the layer; `islands`: (I,) polygons; `beam_s`, `time_s`: (I,) time with the beam on, and in all, while
    each island is scanned; `height_mm`: height of the layer over the base plate; `fine`: resolve waves shorter than an island, for a
    simulation, and not only those that last while the next island is scanned, for a plan.
    """
    medium, process = Medium.of(config), config.process
    width_mm = math.sqrt(section.area / max(len(islands), 1))
    planned = max(1, min(PLANNING_MODES, int(PLANNING_WORK / max(len(islands), 1) ** 2)))
    # Shortest wave in widths of an island, modes of the section at most, and cells in the shortest wave: in a plan as few as can carry
    # it, since plans made on finer cells were no cooler in a finer simulation.
    wave, most, cells = (2.0 / 3.0, 800, 3.0) if fine else (1.0, planned, 2.0)
    largest = (2.0 * math.pi / (width_mm * wave)) ** 2
    plane = contour_modes(section, largest, most, cells)
    depth_mm = max(height_mm, 0.0) + process.base_plate_mm
    waves = min(40, math.ceil(depth_mm * math.sqrt(largest) / math.pi) + 1)
    depth = depth_modes(depth_mm, waves, process.base == "cooled", medium.loss_per_mm)
    model = HeatModel(plane, depth, medium, min(config.layer_height_mm, depth_mm))
    on = np.divide(beam_s, time_s, out=np.zeros_like(beam_s), where=time_s > 0)
    power_w = process.power_w * config.material.absorptivity * on
    return IslandHeat(
        modes=Modes(
            mean=np.ascontiguousarray(plane.means(islands).T),
            plane_rate=medium.diffusivity_mm2_s * plane.eigenvalue,
            depth_rate=medium.diffusivity_mm2_s * depth.wave_number**2,
            in_layer=model.in_layer,
            source_k_s=np.asarray(power_w / medium.heat_capacity_j_mm3k, np.float64),
        ),
        start_k=model.cold(),
        model=model,
        complete=min(
            largest if len(plane.eigenvalue) < most else float(plane.eigenvalue[-1]),
            float(depth.wave_number[-1]) ** 2,
        ),
    )


def with_fresh_heat(
    heat: IslandHeat,
    entry: Floats,
    lines: tuple[Ints, Floats, Floats],
    section: BaseGeometry,
    islands: NDArray[np.object_],
    config: Config,
) -> IslandHeat:
    """Add the fresh heat that the modes lack: see :func:`ebamcheck.heat.near_field.near_field`."""
    bead_mm = config.process.bead_width_mm
    return replace(heat, near=near_field(heat.model, heat.complete, entry, lines, section, islands, bead_mm))


def old_at_entries(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats, at: Floats | None = None) -> Floats:
    """Rise of each island when it is entered by heat older than the horizon, of which the modes have all, K: means of the islands
    (I,); with modes (I, E, K) at places of each, at these (I, E)."""
    horizon_s, modes = heat.fresh.horizon_s, heat.modes
    timetable = Timetable(order, start_s, end_s)
    surface = surfaces_at_entries(modes.late(horizon_s), timetable, horizon_s, heat.start_k, modes.in_layer)
    if at is None:
        return np.asarray(np.einsum("ki,ik->i", modes.mean, surface), np.float64)
    return np.asarray((at @ surface[:, :, None])[:, :, 0], np.float64)


@kernel
def young_at_entries(
    near: NearField, source: Floats, order: Ints, start: Floats, end: Floats, options: Ints, every: bool
) -> tuple[Floats, Floats]:
    """Rises by heat younger than the horizon, K: of islands' means (I,), and of entries (I, 4), every one or that of the option."""
    means, rise = np.zeros(len(start)), np.zeros((len(start), OPTIONS))
    place = np.full(len(start), -1)
    for n in range(len(order)):
        place[order[n]] = n
    for i in order:
        for p in range(near.first[i], near.first[i + 1]):
            j = near.other[p]
            since, time = start[i] - end[j], end[j] - start[j]
            if place[j] >= place[i] or place[j] < 0 or since > near.horizon_s:
                continue
            if every:
                for w in range(OPTIONS):
                    rise[i, w] += source[j] * entry_rise(near, i, w, j, options[j], since, time)
            else:
                w = options[i]
                means[i] += source[j] * young_mean(near, near.pair[p], since, time)
                rise[i, w] += source[j] * entry_rise(near, i, w, j, options[j], since, time)
    return means, rise
