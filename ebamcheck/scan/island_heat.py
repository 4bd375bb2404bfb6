"""The heat model of a layer's islands, in the columns that the kernels of :mod:`ebamcheck.scan.thermal` read."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.config import Config
from ebamcheck.heat import HeatModel, Medium, contour_modes, depth_modes
from ebamcheck.rings import Floats

FINER = 1.5
"""Waves of a simulation over an island's width are this much shorter than those of a plan."""

PLANNING_MODES = 300
"""Modes of the section that a plan uses at most: beyond, only the longest waves count."""

SIMULATION_MODES = 400
"""Modes of the section that a simulation uses at most."""

MOST_DEPTH_MODES = 40
"""Modes of the depth at most."""


@dataclass(frozen=True, eq=False)
class IslandHeat:
    """Islands as sources and readings of the heat model.

    Parameters
    ----------
    mean
        (K, I) means of the section's modes over the islands.
    plane_rate, depth_rate
        (K,) and (N,), whose sums are the decays of the amplitudes, 1/s.
    in_layer
        (N,) means of the depth's modes over the layer.
    source_k_s
        (I,) beam power on the island over the heat capacity of a volume, while it is scanned.
    """

    mean: Floats
    plane_rate: Floats
    depth_rate: Floats
    in_layer: Floats
    source_k_s: Floats


def island_heat(
    section: BaseGeometry,
    islands: NDArray[np.object_],
    beam_s: Floats,
    time_s: Floats,
    profile: Config,
    height_mm: float,
    fine: bool = False,
) -> IslandHeat:
    """Set up the heat model of a layer.

    Parameters
    ----------
    section
        Solid region of the layer.
    islands
        (I,) polygons.
    beam_s, time_s
        (I,) time with the beam on, and in all, while each island is scanned.
    height_mm
        Height of the layer over the base plate.
    fine
        Resolve waves shorter than an island, for a simulation; a plan needs none under its width.
    """
    medium, process = Medium.of(profile), profile.process
    width_mm = math.sqrt(section.area / max(len(islands), 1)) / (FINER if fine else 1.0)
    largest = (2.0 * math.pi / width_mm) ** 2
    plane = contour_modes(section, largest, SIMULATION_MODES if fine else PLANNING_MODES)
    depth_mm = max(height_mm, 0.0) + process.base_plate_mm
    waves = min(MOST_DEPTH_MODES, math.ceil(depth_mm * math.sqrt(largest) / math.pi) + 1)
    loss = medium.radiation_w_mm2k / medium.conductivity_w_mmk
    depth = depth_modes(depth_mm, waves, process.base == "cooled", loss)
    model = HeatModel(plane, depth, medium, min(profile.layer_height_mm, depth_mm))
    on = np.divide(beam_s, time_s, out=np.zeros_like(beam_s), where=time_s > 0)
    power_w = process.power_w * profile.material.absorptivity * on
    return IslandHeat(
        mean=np.ascontiguousarray(plane.means(islands).T),
        plane_rate=medium.diffusivity_mm2_s * plane.eigenvalue,
        depth_rate=medium.diffusivity_mm2_s * depth.wave_number**2,
        in_layer=model.in_layer,
        source_k_s=np.asarray(power_w / medium.heat_capacity_j_mm3k, np.float64),
    )
