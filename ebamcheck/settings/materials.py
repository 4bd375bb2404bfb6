"""The material of a run, and presets by name: the entry points of the group ``ebamcheck.materials``, each a table of settings.
All figures are nominal: check them against the certificate of the wire and the books cited before a production build.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from ebamcheck.installed import entry_points
from ebamcheck.settings.base import Between, Section, Share, Temperature
from ebamcheck.showing.short_text import did_you_mean

MATERIALS = "ebamcheck.materials"

INCONEL_718: Mapping[str, Any] = {
    "density_kg_m3": 8190.0,
    "conductivity_w_mk": 26.0,
    "heat_capacity_j_kgk": 620.0,
    "conductivity_by_temperature": (
        (298.0, 8.9), (473.0, 12.9), (673.0, 17.4), (873.0, 20.8), (1073.0, 26.9), (1273.0, 26.7),
        (1443.0, 29.3), (1609.0, 29.6), (3190.0, 29.6),
    ),
    "heat_capacity_by_temperature": (
        (298.0, 435.0), (473.0, 479.0), (673.0, 515.0), (873.0, 558.0), (1073.0, 680.0), (1273.0, 620.0),
        (1443.0, 650.0), (1609.0, 720.0), (3190.0, 720.0),
    ),
    "latent_heat_j_kg": 210e3,
    "solidus_k": 1533.0,
    "liquidus_k": 1609.0,
    "boiling_k": 3190.0,
    "interpass_limit_k": 873.0,
    "emissivity": 0.6,
    "absorptivity": 0.8,
}  # fmt: skip
"""Solid and liquid data after Mills 2002, "Recommended values of thermophysical properties for selected commercial
alloys", alloy IN 718; boiling point of nickel; interpass limit, emissivity and absorptivity nominal."""

STEEL_316L: Mapping[str, Any] = {
    "density_kg_m3": 7950.0,
    "conductivity_w_mk": 25.0,
    "heat_capacity_j_kgk": 596.0,
    "conductivity_by_temperature": (
        (293.0, 13.85), (1658.0, 35.30), (1723.0, 18.06), (3090.0, 22.54),
    ),
    "heat_capacity_by_temperature": ((293.0, 501.0), (1658.0, 684.0), (1723.0, 775.0), (3090.0, 775.0)),
    "latent_heat_j_kg": 270e3,
    "solidus_k": 1658.0,
    "liquidus_k": 1723.0,
    "boiling_k": 3090.0,
    "interpass_limit_k": 873.0,
    "emissivity": 0.6,
    "absorptivity": 0.82,
}  # fmt: skip
"""Kim 1975, ANL-75-55, "Thermophysical properties of stainless steels": k = 9.248 + 0.01571 T, liquid 12.41 + 0.003279 T;
c = 462 + 0.134 T, liquid 775; heat of fusion and boiling point. Solidus and liquidus after Mills 2002; the rest nominal."""

ALUMINIUM_2319: Mapping[str, Any] = {
    "density_kg_m3": 2840.0,
    "conductivity_w_mk": 150.0,
    "heat_capacity_j_kgk": 1000.0,
    "conductivity_by_temperature": ((293.0, 121.0), (816.0, 170.0), (916.0, 85.0), (2740.0, 100.0)),
    "heat_capacity_by_temperature": ((293.0, 864.0), (816.0, 1150.0), (916.0, 1100.0), (2740.0, 1100.0)),
    "latent_heat_j_kg": 390e3,
    "solidus_k": 816.0,
    "liquidus_k": 916.0,
    "boiling_k": 2740.0,
    "interpass_limit_k": 423.0,
    "emissivity": 0.2,
    "absorptivity": 0.9,
}
"""Data of the parent alloy 2219 (ASM Handbook vol. 2: density, conductivity, heat capacity at room temperature, melting
range 543 to 643 C); hot and liquid values, and the rest, nominal."""

TANTALUM: Mapping[str, Any] = {
    "density_kg_m3": 16650.0,
    "conductivity_w_mk": 62.0,
    "heat_capacity_j_kgk": 155.0,
    "conductivity_by_temperature": ((293.0, 57.5), (1000.0, 60.2), (2000.0, 64.8), (3290.0, 66.0), (5731.0, 66.0)),
    "heat_capacity_by_temperature": ((293.0, 140.0), (1000.0, 152.0), (2000.0, 168.0), (3290.0, 220.0), (5731.0, 230.0)),
    "latent_heat_j_kg": 202e3,
    "solidus_k": 3289.0,
    "liquidus_k": 3291.0,
    "boiling_k": 5731.0,
    "interpass_limit_k": 1273.0,
    "emissivity": 0.3,
    "absorptivity": 0.6,
}  # fmt: skip
"""CRC Handbook of Chemistry and Physics: density, melting (3290 K) and boiling point, heat of fusion (36.57 kJ/mol),
conductivity; heat capacity by temperature and the rest nominal. A melting point is a range of 2 K here."""

TITANIUM: Mapping[str, Any] = {}  # ti-6Al-4V: the defaults of the section, each with its source there


def preset(name: str) -> Mapping[str, Any] | None:
    """Settings of a material by its name, whatever its case; None where no material of that name is installed."""
    if (point := _points().get(name.casefold())) is None:
        return None
    found = point.load()
    if not isinstance(found, Mapping):
        raise ValueError(f"plugin {point.name!r} of {MATERIALS} is no table of settings")
    return found


def names() -> list[str]:
    """Names of the materials that are installed."""
    return sorted(point.name for point in _points().values())


def _points() -> dict[str, Any]:
    return {point.name.casefold(): point for point in entry_points(group=MATERIALS)}


Property = Annotated[float, Between(0.001, 1e6)]  # value of a property of a material in SI units

# Temperatures and values of a material, by rising temperature; two points of one temperature make a jump
DataPoints = Annotated[tuple[tuple[Temperature, Property], ...], Field(min_length=2)]


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
            lacking = [f for f in cls.model_fields if f not in {*found, *given, "name", "melt_mixing"}]
            if found and lacking:
                raise ValueError(f"the preset {name!r} lacks {', '.join(lacking)}: set them, or complete the preset")
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
