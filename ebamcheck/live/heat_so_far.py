"""The heat of a part that is half built: the balance over all layers, and what differs in the uppermost one by modes.

A layer is planned on it before it is released, and the balance of all layers of a build is made once more by their texts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.heat_again import BeadHeat, FollowedHeat, highest_entry_k, may_differ_k
from ebamcheck.checks.interpass_checks import within_range
from ebamcheck.checks.text_heat import sections_of_text, text_beads
from ebamcheck.heat.balance import HeatColumn, LayerShape
from ebamcheck.nc.roles import by_height, by_shape
from ebamcheck.numeric.rings import Floats
from ebamcheck.program.verification import read_checked
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


@dataclass(frozen=True, eq=False)
class LayerText:
    """What the text of one layer says of its heat: section, height, settings, and of each bead (P,) the time with the beam off before it, its
    own time, s, and the heat that the part takes up, J."""

    section: BaseGeometry
    height_mm: float
    config: Config
    off_s: Floats
    time_s: Floats
    heat_j: Floats


def layer_text(program: Path, paper: Mapping[str, Any], config: Config) -> LayerText | None:
    """Read one layer, whose certificate tells the wait before it; None where its text does not say how warm it makes the part.

    A text that cannot be read says nothing, and one that preheats has its temperatures judged where it is made. On a surface
    that was measured it begins with other heat than that of the texts below.
    """
    height_mm, wait_s = config.layer_height_mm, paper.get("wait_s")
    if not isinstance(wait_s, int | float) or "temperature" in paper:
        return None
    text, _ = read_checked(program, config)
    if text is None:
        return None
    text = by_shape(by_height(text, np.array([config.base_mm + height_mm])))
    beads = text_beads(text, config)
    if beads.scans or not len(beads):
        return None
    off_s = beads.move_s + beads.wait_s
    off_s[0] += wait_s
    section = sections_of_text(text, config, None)[0]
    return LayerText(
        section, height_mm, config, off_s, beads.time_s, beads.energy_j * config.material.absorptivity
    )


def heated(heat: FollowedHeat | None, layer: LayerText) -> tuple[str, FollowedHeat]:
    """Lay one more layer on the heat of those below, None on the bare plate.

    Returns
    -------
    why, heat
        Why it is too warm, in words: a bead is entered above the limit, with what two balances may differ by on top; empty where
        none is. And the heat when the layer is done.
    """
    config = layer.config
    beads = BeadHeat(np.zeros(layer.off_s.size, np.int64), layer.off_s, layer.time_s, layer.heat_j)
    bed_k, after = (heat or FollowedHeat(config)).with_layer(beads, layer.section, layer.height_mm)
    entered_k = float(bed_k[0] if config.process.interpass_at == "layer" else bed_k.max())
    most_k = highest_entry_k(config) + may_differ_k(config)
    if entered_k <= most_k:
        return "", after
    said_k, mark = within_range(entered_k, config)
    said = f"a bead of it is entered at {said_k:.0f} K{mark} by the texts so far; the limit is {most_k:.0f} K"
    return f"heat over all layers: {said}", after
