"""The conducting material, in the units of the model: mm, s, W, K."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.kernels import Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.materials import MaterialSettings

BEAM_SHARE = 0.25
"""Standard deviation of the beam's heat over the width of the bead: 95 % of it falls on the bead."""

STEFAN_BOLTZMANN_W_M2K4 = 5.670374419e-8
"""Radiation of a black body over T^4 (CODATA 2018)."""


@dataclass(frozen=True)
class Medium:
    """A material with constant data.

    `conductivity_w_mmk`: thermal conductivity k; `heat_capacity_j_mm3k`: heat capacity per volume, rho c;
    `radiation_w_mm2k`: heat flux that the surface radiates, over its temperature rise; 0: none.
    """

    conductivity_w_mmk: float
    heat_capacity_j_mm3k: float
    radiation_w_mm2k: float = 0.0

    @property
    def diffusivity_mm2_s(self) -> float:
        """Diffusivity alpha = k / (rho c)."""
        return self.conductivity_w_mmk / self.heat_capacity_j_mm3k

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


HOTTEST_K = 6000.0
"""End of the tables, beyond any melt: evaporation is not part of them, so a melt may exceed the boiling point."""

STEP_K = 1.0
"""Step of temperature for the integrals of the data."""

NODES = 8192
"""Nodes of the tables over the heat content: about 1 K apart."""


@dataclass(frozen=True, eq=False)
class EnthalpyTables:
    """Tables at equal steps of the heat content h, from 0 at the ambient temperature.

    `step_j_mm3`: step of the heat content, J/mm^3; `temperature_k`: (Q,) absolute temperature, K; `theta_w_mm`: (Q,)
    integral of the conductivity from the ambient temperature, W/mm.
    """

    step_j_mm3: float
    temperature_k: Floats
    theta_w_mm: Floats

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
    corners = np.concatenate(
        [capacities[:, 0], conductivities[:, 0], [material.solidus_k, material.liquidus_k]]
    )
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
