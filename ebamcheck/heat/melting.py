"""Limits of power, wire and temperature: what melts the wire, how wide a bead may be, and the interpass temperature."""

from __future__ import annotations

import numpy as np

from ebamcheck.heat.medium import enthalpy_tables
from ebamcheck.kernels import Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import MOST_SPACINGS, along_window, wire_speed_mm_s

WIDER = 1.0005
"""Width over the spacing from which on a bead is a wider one: widths and wire speeds are rounded in a program."""


def melting_heat_j_kg(config: Config) -> float:
    """Heat that brings the material from the chamber's temperature to the liquidus and melts it, J/kg."""
    tables = enthalpy_tables(config)
    content_j_mm3 = float(tables.heat_content(config.material.liquidus_k))
    return content_j_mm3 / (1e-9 * config.material.density_kg_m3)


def least_power_share(config: Config, thickness_mm: float | None = None) -> float:
    """Share of the beam's power that is needed to melt a layer of a thickness; over 1: the beam is too weak.

    The melt pool consists of the wire, whose amount follows from travel speed, bead spacing and layer height, and
    the metal that is remelted with it; both are heated from the chamber's temperature, which is on the safe side. If
    full power is too little for both, all of it is needed and less is remelted, as long as it melts the wire.
    """
    process = config.process
    height_mm = config.layer_height_mm if thickness_mm is None else thickness_mm
    wire = process.travel_speed_mm_s * process.hatch_spacing_mm * height_mm / melted_mm3_s(config)
    pool = wire / (1.0 - process.dilution)
    return pool if pool <= 1.0 else max(wire, 1.0)


def melted_mm3_s(config: Config) -> float:
    """Metal of the wire that the full power melts from the chamber's temperature, with none of the metal beside it, mm3/s."""
    process, material = config.process, config.material
    melting_w = process.melting_efficiency * material.absorptivity * process.power_w
    return melting_w / (1e-9 * material.density_kg_m3 * melting_heat_j_kg(config))


def own_power_shares(config: Config, width_mm: Floats, thickness_mm: float) -> Floats:
    """Share of the beam's power that each bead needs for itself, since it lays more metal than its neighbours.

    A layer has the power that its beads need at one spacing. A wider one gets as much more as its metal is more, up to the full
    power; and as much as `process.metal_energy_j_mm3` asks for.

    `width_mm`: (n,) metal of each bead, in section over the height of its layer; `thickness_mm`: that height.

    Returns (n,) 0 where a bead lays one spacing or less.

    Examples
    --------
    >>> own_power_shares(Config(), np.array([4.0, 4.5, 6.8]), 1.6755).round(3)
    array([0.   , 0.398, 0.601])
    """
    process = config.process
    metal_mm3_s = process.travel_speed_mm_s * width_mm * thickness_mm
    pool = metal_mm3_s / (melted_mm3_s(config) * (1.0 - process.dilution))
    window = process.metal_energy_j_mm3[0] * metal_mm3_s / process.power_w
    wider = width_mm > WIDER * process.hatch_spacing_mm
    return np.where(wider, np.minimum(np.maximum(pool, window), 1.0), 0.0)


def width_limits_mm(config: Config, thickness_mm: float, power_share: float = 1.0) -> tuple[float, float]:
    """Least and greatest width that a bead can lay in a layer of this height: limits of the wire feed, of the pool, and of the
    metal that the full power melts, which a bead gets where it needs it.

    Where the feed follows along the path, those of wire and feed together, at the share of the power of the layer.
    """
    process = config.process
    per_mm = wire_speed_mm_s(config, 1.0, thickness_mm)
    slow, fast = along_window(config, power_share)
    melts_mm3_s = min(melted_mm3_s(config), process.power_w / process.metal_energy_j_mm3[0])
    most = min(
        process.wire_speed_max_mm_s / (per_mm * slow),
        MOST_SPACINGS * process.hatch_spacing_mm,
        melts_mm3_s / (process.travel_speed_mm_s * thickness_mm),
    )
    least = process.wire_speed_min_mm_s / (per_mm * fast)
    return least, max(least, most)


def entry_limit_k(config: Config) -> float:
    """Absolute temperature of the metal above which no bead may begin, K: whatever is set, that at which it begins to melt at most."""
    process, material = config.process, config.material
    limit_k = process.interpass_limit_k
    if limit_k is None:
        limit_k = material.solidus_k if process.interpass == "off" else material.interpass_limit_k
    return min(limit_k, material.solidus_k)


def scheduled_share(config: Config, height_mm: float) -> float | None:
    """Share of the power at a height above the plate, by the table of the settings; None if the heat model decides."""
    schedule = config.process.power_schedule
    if isinstance(schedule, str):
        return None
    heights, shares = np.array(schedule, np.float64).T
    return float(np.interp(height_mm, heights, shares))
