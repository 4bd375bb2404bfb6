"""The heat of a part that is half built: the balance over all layers, and what differs in the uppermost one by modes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ebamcheck.heat.balance import HeatColumn, LayerShape
from ebamcheck.scan.heat.interpass import SimulatedLayer
from ebamcheck.scan.heat.part_heat import PartHeat
from ebamcheck.scan.plan.columns import PlanOfLayers, ScanPlan
from ebamcheck.scan.plan.preheated import preheated
from ebamcheck.settings.config import Config


@dataclass(frozen=True, eq=False)
class HeatSoFar:
    """Heat of a part when its uppermost layer is done, and how that was driven; None: that is not known."""

    part: PartHeat
    last: SimulatedLayer | None = None

    @property
    def laid(self) -> bool:
        """Whether anything stands on the plate."""
        return self.part.column.absorbed_j > 0.0

    @classmethod
    def cold(cls, config: Config) -> HeatSoFar:
        """Return that of the bare plate."""
        return cls(PartHeat(HeatColumn(config)))

    @property
    def layer_s(self) -> float:
        """Time of the uppermost layer, with moves and waits within it."""
        return 0.0 if self.last is None else self.last.time_s

    @property
    def surface_k(self) -> float:
        """Mean temperature of the surface, absolute."""
        return float(self.part.column.surface_k)

    def rested(self, duration_s: float) -> HeatSoFar:
        """Return the same heat after a time with the beam off."""
        if duration_s <= 0.0:
            return self
        part = self.part.copy()
        part.rest(duration_s)
        return replace(self, part=part)


def heat_under(
    plan: ScanPlan | PlanOfLayers, layer: int, thickness_mm: np.ndarray, busy: np.ndarray, config: Config
) -> HeatSoFar:
    """Heat of a part when the layers under one of them were laid as a run planned them, by the balance alone.

    What differs across a section decays while the next layer is laid; the mean stays. An order that begins on it knows
    the mean of the whole body, and what differs from the layer on which it works.

    Parameters
    ----------
    plan
        The run's plan: sections, waits and power of all layers.
    layer
        Index of the layer that comes next.
    thickness_mm
        (L,) of the layers.
    busy
        (L, 2) time with the beam on and with it off in each layer, s.
    """
    column = HeatColumn(config)
    if plan.sections is None:
        return HeatSoFar(PartHeat(column))
    wait_s, share = (np.nan_to_num(plan.metrics[name].to_numpy()) for name in ("wait_s", "power_share"))
    share = np.where(share > 0.0, share, 1.0)
    full_w = config.process.power_w * config.material.absorptivity
    scans = (
        np.zeros(len(wait_s))
        if "preheat_passes" not in plan.metrics
        else plan.metrics["preheat_passes"].to_numpy()
    )
    sections, z_mm = list(plan.sections), np.concatenate([[0.0], np.cumsum(thickness_mm)])
    for k in range(layer):
        shape = LayerShape.of(plan.sections[k], float(thickness_mm[k]))
        if shape.area_mm2 <= 0.0:
            continue
        if scans[k] > 0:
            column = preheated(PartHeat(column), sections, k, float(z_mm[k]), config)[0].column
        column.advance(float(wait_s[k]))
        column.lay(shape)
        column.advance(float(busy[k].sum()), float(busy[k, 0] * share[k]) * full_w)
    return HeatSoFar(PartHeat(column))
