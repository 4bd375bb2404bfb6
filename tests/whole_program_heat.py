"""The heat of a whole program on the column of :mod:`ebamcheck.heat.balance`, layer by layer, and where it went."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ebamcheck.heat.balance import HeatColumn, LayerShape
from ebamcheck.heat.medium import HOTTEST_K, EnthalpyTables
from ebamcheck.kernels import Floats
from ebamcheck.settings.config import Config


@dataclass(frozen=True, eq=False)
class Deposits:
    """What a program does, layer by layer from below, as columns (L,).

    Parameters
    ----------
    thickness_mm, area_mm2, outer_mm, inner_mm, hole_mm2
        As in :class:`LayerShape`.
    energy_j
        Heat that the layer takes up: power times absorptivity times the time with the beam on.
    time_s
        Time of the layer, with all moves.
    wait_s
        Wait before it.
    """

    thickness_mm: Floats
    area_mm2: Floats
    outer_mm: Floats
    inner_mm: Floats
    hole_mm2: Floats
    energy_j: Floats
    time_s: Floats
    wait_s: Floats

    def shape(self, layer: int) -> LayerShape:
        """Return the shape of one layer."""
        columns = (self.thickness_mm, self.area_mm2, self.outer_mm, self.inner_mm, self.hole_mm2)
        return LayerShape(*(float(column[layer]) for column in columns))

    def __len__(self) -> int:
        """Return the number of layers."""
        return len(self.area_mm2)


@dataclass(frozen=True, eq=False)
class Balance:
    """Temperatures of the surface over a program, absolute, K, and where the heat went.

    Parameters
    ----------
    start_k
        (L,) mean of the uppermost layer, or of the plate's top, when the next layer begins.
    end_k
        (L,) mean of the layer when it is done.
    absorbed_j, stored_j, base_j, radiated_j
        Heat put in, left in the column, passed to the table, and radiated, until the last layer is done.
    """

    start_k: Floats
    end_k: Floats
    absorbed_j: float
    stored_j: float
    base_j: float
    radiated_j: float


def heat_balance(deposits: Deposits, config: Config, tables: EnthalpyTables | None = None) -> Balance:
    """Follow the heat of a whole program.

    Parameters
    ----------
    tables
        The material; that of the settings, with all its data over temperature, if None.
    """
    column = HeatColumn(config, tables)
    start_k, end_k = np.full(len(deposits), math.nan), np.full(len(deposits), math.nan)
    for k in range(len(deposits)):
        column.advance(float(deposits.wait_s[k]))
        start_k[k] = column.surface_k
        if deposits.area_mm2[k] > 0.0:
            column.lay(deposits.shape(k))
        column.advance(float(deposits.time_s[k]), float(deposits.energy_j[k]))
        end_k[k] = column.surface_k
    return Balance(start_k, end_k, column.absorbed_j, column.stored_j, column.base_j, column.radiated_j)


def constant_tables(config: Config) -> EnthalpyTables:
    """Return the material of the linear heat model: constant conductivity and heat capacity, no heat of fusion."""
    material = config.material
    rise_k = np.array([0.0, HOTTEST_K])
    capacity = 1e-9 * material.density_kg_m3 * material.heat_capacity_j_kgk
    return EnthalpyTables(
        step_j_mm3=capacity * HOTTEST_K,
        temperature_k=config.process.ambient_temperature_k + rise_k,
        theta_w_mm=1e-3 * material.conductivity_w_mk * rise_k,
    )
