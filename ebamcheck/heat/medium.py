"""The conducting material, in the units of the model: mm, s, W, K."""

from __future__ import annotations

from dataclasses import dataclass

from ebamcheck.settings.config import Config

BEAM_SHARE = 0.25
"""Standard deviation of the beam's heat over the width of the bead: 95 % of it falls on the bead."""

STEFAN_BOLTZMANN_W_M2K4 = 5.670374419e-8
"""Radiation of a black body over T^4 (CODATA 2018)."""


@dataclass(frozen=True)
class Medium:
    """A material with constant data.

    Parameters
    ----------
    conductivity_w_mmk
        Thermal conductivity k.
    heat_capacity_j_mm3k
        Heat capacity per volume, rho c.
    radiation_w_mm2k
        Heat flux that the surface radiates, over its temperature rise; 0: none.
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
