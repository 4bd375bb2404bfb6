"""Data of the wire's material."""

from __future__ import annotations

import itertools
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from ebamcheck.settings.base import Between, Section, Share, Temperature
from ebamcheck.settings.materials import names, preset
from ebamcheck.showing.short_text import did_you_mean

Property = Annotated[float, Between(0.001, 1e6)]
"""Value of a property of a material in SI units."""

DataPoints = Annotated[tuple[tuple[Temperature, Property], ...], Field(min_length=2)]
"""Temperatures and values of a material, by rising temperature; two points of one temperature make a jump."""


OF_ANY_MATERIAL = ("name", "melt_mixing")
"""Settings that a preset may leave out."""


class MaterialSettings(Section):
    """The wire's material."""

    name: str = "Ti-6Al-4V"
    """Name of the material, as it stands in the header of the program. That of an installed preset loads its data (Ti-6Al-4V,
    Inconel 718, 316L, Al 2319, tantalum); any other name needs all data of this section beside it."""
    density_kg_m3: Annotated[float, Between(10.0, 30_000.0)] = 4430.0
    """Density of the wire, for its mass, and of the part, for its heat."""
    conductivity_w_mk: Annotated[float, Between(0.001, 1e6)] = 20.0
    """Heat conductivity k of the linear heat model: Ti-6Al-4V at about 1200 K (Mills 2002: 1.26 + 0.0157 T under the
    beta transus)."""
    heat_capacity_j_kgk: Annotated[float, Between(1.0, 1e5)] = 700.0
    """Heat capacity c of the linear heat model: Ti-6Al-4V at about 1000 K (Mills 2002: 483 + 0.215 T under 1268 K)."""
    conductivity_by_temperature: DataPoints = (
        (293.0, 5.86),
        (1268.0, 21.17),
        (1268.0, 19.61),
        (1877.0, 27.35),
        (1923.0, 33.40),
        (3533.0, 72.04),
    )
    """Heat conductivity by temperature, (K, W/(m K)), linear between: 1.26 + 0.0157 T, 3.51 + 0.0127 T over the
    beta transus, -12.75 + 0.024 T liquid. Nominal, after Mills 2002: check them against the book before citing."""
    heat_capacity_by_temperature: DataPoints = (
        (293.0, 546.0),
        (1268.0, 755.6),
        (1268.0, 640.9),
        (1877.0, 750.6),
        (1923.0, 831.0),
        (3533.0, 831.0),
    )
    """Heat capacity by temperature, without the heat of fusion, (K, J/(kg K)), linear between: 483 + 0.215 T,
    412.7 + 0.180 T over the beta transus, 831 liquid. Nominal, as above."""
    latent_heat_j_kg: Annotated[float, Between(0.0, 1e8)] = 286e3
    """Heat of fusion (Mills 2002)."""
    solidus_k: Temperature = 1877.0
    """Temperature at which melting begins (Mills 2002)."""
    liquidus_k: Temperature = 1923.0
    """Temperature at which it ends (Mills 2002)."""
    boiling_k: Temperature = 3533.0
    """Temperature at which heat leaves as vapour (nominal); no temperature is told above it."""
    interpass_limit_k: Temperature = 873.0
    """Temperature over which no bead is entered, where the process sets none: 600 C, well under the solidus and under the
    beta transus (1268 K), where a Ti-6Al-4V part keeps its shape and its melt pool its size. Nominal."""
    melt_mixing: Annotated[float, Between(1.0, 1000.0)] = 4.0
    """Conduction of the melt over that of still melt: convection carries the heat. Factors from
    2 to 10 are in use; nominal."""
    emissivity: Annotated[float, Between(0.0, 1.0)] = 0.6
    """Radiation of the surface over that of a black body; 0.5 to 0.7 are published for hot Ti-6Al-4V."""
    absorptivity: Share = 0.87
    """Share of the beam's power that the part takes up; 0.85 to 0.9 are published for electrons on titanium."""

    @model_validator(mode="before")
    @classmethod
    def _of_preset(cls, given: Any) -> Any:
        """Take the data of the preset that is named, under those that are set."""
        if not (isinstance(given, dict) and isinstance(name := given.get("name"), str)):
            return given
        found = preset(name)
        if found is not None:
            # The defaults are those of one material: what another one leaves out is not theirs.
            lacking = [
                f for f in cls.model_fields if f not in {**found, **given} and f not in OF_ANY_MATERIAL
            ]
            if found and lacking:
                raise ValueError(
                    f"the preset {name!r} lacks {', '.join(lacking)}: set them, or complete the preset"
                )
            return {**found, **given}
        missing = [field for field in cls.model_fields if field not in given]
        if missing:
            raise ValueError(
                f"unknown material {name!r}{did_you_mean(name, names())}: known are {', '.join(names())}; or give all of its data, of which these are "
                f"missing: {', '.join(missing)}"
            )
        return given

    @field_validator("conductivity_by_temperature", "heat_capacity_by_temperature")
    @classmethod
    def _rising(cls, value: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        if any(a[0] > b[0] for a, b in itertools.pairwise(value)):
            raise ValueError("give the temperatures in rising order")
        return value
