"""The conducting material, in the units of the model: mm, s, W, K; and the limits of power, wire and temperature that follow from
it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.kernels import Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.materials import MaterialSettings
from ebamcheck.settings.process_window import MOST_SPACINGS, along_window, wire_speed_mm_s

# Standard deviation of the beam's heat over the width of the bead: 95 % of it falls on the bead
BEAM_SHARE = 0.25
STEFAN_BOLTZMANN_W_M2K4 = 5.670374419e-8  # radiation of a black body over T^4 (CODATA 2018)


@dataclass(frozen=True)
class Medium:
    """A material with constant data."""

    conductivity_w_mmk: float  # k
    heat_capacity_j_mm3k: float  # heat capacity per volume, rho c
    radiation_w_mm2k: float = 0.0  # heat flux that the surface radiates, over its temperature rise

    @property
    def diffusivity_mm2_s(self) -> float:
        """Diffusivity alpha = k / (rho c)."""
        return self.conductivity_w_mmk / self.heat_capacity_j_mm3k

    @property
    def loss_per_mm(self) -> float:
        """Heat transfer coefficient of the surface over the conductivity."""
        return self.radiation_w_mm2k / self.conductivity_w_mmk

    @classmethod
    def of(cls, config: Config) -> Medium:
        """Return the material of the settings, with its radiation linearised at the surface temperature of the process."""
        material, process = config.material, config.process
        warm, cold = process.surface_temperature_k, process.ambient_temperature_k
        # The secant of eps sigma (T^4 - Ta^4): exact at the surface temperature.
        radiation_w_m2k = material.emissivity * STEFAN_BOLTZMANN_W_M2K4 * (warm**2 + cold**2) * (warm + cold)
        return cls(
            conductivity_w_mmk=1e-3 * material.conductivity_w_mk,
            heat_capacity_j_mm3k=1e-9 * material.density_kg_m3 * material.heat_capacity_j_kgk,
            radiation_w_mm2k=1e-6 * radiation_w_m2k,
        )


HOTTEST_K = 6000.0  # end of the tables, beyond any melt: evaporation is not part of them, so a melt may exceed the boiling point
STEP_K = 1.0  # step of temperature for the integrals of the data
NODES = 8192  # nodes of the tables over the heat content: about 1 K apart


@dataclass(frozen=True, eq=False)
class EnthalpyTables:
    """Tables at equal steps of the heat content h, from 0 at the ambient temperature."""

    step_j_mm3: float  # step of the heat content
    temperature_k: Floats  # (Q,) absolute temperature
    theta_w_mm: Floats  # (Q,) integral of the conductivity from the ambient temperature

    @property
    def greatest_diffusivity_mm2_s(self) -> float:
        """Greatest slope of theta over h, which limits an explicit step."""
        return float(np.diff(self.theta_w_mm).max() / self.step_j_mm3)

    def heat_content(self, temperature_k: ArrayLike) -> Floats:
        """Heat content at temperatures, J/mm^3."""
        where = np.asarray(temperature_k, np.float64)
        place = np.interp(where, self.temperature_k, np.arange(len(self.temperature_k)))
        return np.asarray(self.step_j_mm3 * place, np.float64)

    def temperature(self, heat_content_j_mm3: ArrayLike) -> Floats:
        """Temperature at heat contents, K."""
        # The same as np.interp, to the last bit, which would need a column of thousands of integers at every call.
        place = np.asarray(heat_content_j_mm3, np.float64) / self.step_j_mm3
        table = self.temperature_k
        inside = np.minimum(np.maximum(place, 0.0), len(table) - 1.0)
        # A heat content that is NaN, as after a feed of 0, gives a temperature that is NaN.
        node = np.minimum(np.fmax(inside, 0.0).astype(np.int64), len(table) - 2)
        return np.asarray((table[node + 1] - table[node]) * (inside - node) + table[node], np.float64)


def enthalpy_tables(config: Config) -> EnthalpyTables:
    """Integrate the data of the material, with its heat of fusion spread from solidus to liquidus."""
    return _tables(config.material, config.process.ambient_temperature_k)


@lru_cache(maxsize=8)
def _tables(material: MaterialSettings, ambient_k: float) -> EnthalpyTables:
    capacities: Floats = np.array(material.heat_capacity_by_temperature, np.float64)
    conductivities: Floats = np.array(material.conductivity_by_temperature, np.float64)
    # The nodes of the data are among the temperatures, so the trapezoidal sums over linear pieces are exact.
    corners = np.concatenate([capacities[:, 0], conductivities[:, 0], [material.solidus_k, material.liquidus_k]])
    even = np.arange(ambient_k, HOTTEST_K + STEP_K, STEP_K)
    temperature = np.union1d(even, corners[(corners > ambient_k) & (corners < HOTTEST_K)])
    width, middle = np.diff(temperature), 0.5 * (temperature[:-1] + temperature[1:])
    capacity = np.interp(middle, capacities[:, 0], capacities[:, 1])
    conductivity = np.interp(middle, conductivities[:, 0], conductivities[:, 1])
    conductivity[middle > material.liquidus_k] *= material.melt_mixing
    melted = np.interp(temperature, [material.solidus_k, material.liquidus_k], [0.0, 1.0])
    sensible = np.concatenate([[0.0], np.cumsum(capacity * width)])
    content = 1e-9 * material.density_kg_m3 * (sensible + material.latent_heat_j_kg * melted)
    theta = 1e-3 * np.concatenate([[0.0], np.cumsum(conductivity * width)])
    nodes = np.linspace(0.0, content[-1], NODES)
    return EnthalpyTables(
        step_j_mm3=float(nodes[1]),
        temperature_k=np.interp(nodes, content, temperature),
        theta_w_mm=np.interp(nodes, content, theta),
    )


WIDER = 1.0005  # width over the spacing from which on a bead is a wider one: widths and wire speeds are rounded in a program


def melting_heat_j_kg(config: Config) -> float:
    """Heat that brings the material from the chamber's temperature to the liquidus and melts it, J/kg."""
    tables = enthalpy_tables(config)
    content_j_mm3 = float(tables.heat_content(config.material.liquidus_k))
    return content_j_mm3 / (1e-9 * config.material.density_kg_m3)


def least_power_share(config: Config, thickness_mm: float | None = None) -> float:
    """Share of the beam's power that is needed to melt a layer of a thickness; over 1: the beam is too weak.

    The melt pool consists of the wire, whose amount follows from travel speed, bead spacing and layer height, and the metal that is
    remelted with it; both are heated from the chamber's temperature, which is on the safe side. If full power is too little for both,
    all of it is needed and less is remelted, as long as it melts the wire.
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
    """Share of the beam's power (n,) that each bead needs for itself, since it lays more metal than its neighbours; 0 where it lays
    one spacing or less.

    A layer has the power that its beads need at one spacing. A wider one gets as much more as its metal is more, up to the full
    power; and as much as `process.metal_energy_j_mm3` asks for. The widths (n,) are metal in section over the layer's thickness.

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
    """Absolute temperature of the metal above which no bead may begin, K: whatever is set, that at which it begins to melt at
    most."""
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
