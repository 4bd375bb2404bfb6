"""Presets of materials by name: the entry points of the group ``ebamcheck.materials``, each a table of settings.

``material.name`` names one, and its data take the place of the defaults; what is set beside the name counts for more. All
figures are nominal: check them against the certificate of the wire and the books cited before a production build.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ebamcheck.installed import entry_points

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

TITANIUM: Mapping[str, Any] = {}
"""Ti-6Al-4V: the defaults of the section, each with its source there."""


def preset(name: str) -> Mapping[str, Any] | None:
    """Settings of a material by its name, whatever its case; None where no material of that name is installed."""
    point = _points().get(name.casefold())
    if point is None:
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
