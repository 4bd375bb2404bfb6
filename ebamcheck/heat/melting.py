"""Limits of power and temperature: the power that melts the wire, and the interpass temperature, from process and material."""

from __future__ import annotations

import numpy as np

from ebamcheck.heat.enthalpy import enthalpy_tables
from ebamcheck.settings.config import Config


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
    process, material = config.process, config.material
    height_mm = config.layer_height_mm if thickness_mm is None else thickness_mm
    laid_mm3_s = process.travel_speed_mm_s * process.hatch_spacing_mm * height_mm
    wire_w = 1e-9 * material.density_kg_m3 * laid_mm3_s * melting_heat_j_kg(config)
    wire = wire_w / (process.melting_efficiency * material.absorptivity * process.power_w)
    pool = wire / (1.0 - process.dilution)
    return pool if pool <= 1.0 else max(wire, 1.0)


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
