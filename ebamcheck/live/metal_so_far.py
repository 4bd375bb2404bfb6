"""The metal of a part that is half built: how uneven its surface is, the sums that hold for all of its layers, and what they used up."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from shapely.geometry.base import BaseGeometry

from ebamcheck.live.height_map import MapFigures
from ebamcheck.mesh.part import Part
from ebamcheck.metal import Surface, target_of
from ebamcheck.program.checking.consumables import FRESH, Spent
from ebamcheck.program.checking.metal_below import MetalBelow
from ebamcheck.program.toolpath.wire import metal_region
from ebamcheck.settings.config import Config


@dataclass(frozen=True, eq=False)
class MetalSoFar:
    """What stands when a layer begins.

    Parameters
    ----------
    below
        Sums over the layers that stand.
    surface
        Their surface by the text of their programs; None: taken as level.
    spent
        What they took of the spool and the cathode that are in use, where the profile says how much these hold.
    """

    below: MetalBelow = field(default_factory=MetalBelow)
    surface: Surface | None = None
    spent: Spent = FRESH

    @classmethod
    def none(cls, part: Part, config: Config) -> MetalSoFar:
        """Return that of the bare plate, with room for all layers of a part."""
        bead_mm = config.process.bead_width_mm
        room_mm = bead_mm + config.process.machining_allowance_mm
        low, high = part.bounds[0, :2] - room_mm, part.bounds[1, :2] + room_mm
        return cls(MetalBelow(), Surface(np.concatenate([low, high]), bead_mm))

    @property
    def mapped_surface(self) -> bool:
        """Whether the surface was measured place by place."""
        return self.surface is not None and self.surface.mapped

    def measured(self) -> MetalSoFar:
        """Return the same when its height was measured: its surface is on average there, and as uneven as it was."""
        return self if self.surface is None else replace(self, surface=self.surface.measured())

    @classmethod
    def on(cls, below: MetalBelow, section: BaseGeometry, part: Part, config: Config) -> MetalSoFar:
        """Return that of layers of which the section of the uppermost is known, and no more of its surface."""
        level = cls.none(part, config).surface
        assert level is not None
        target = target_of(metal_region(section, config), level.step_mm, 2.0 * config.process.bead_width_mm)
        level.add(target, target.share, 1.0)
        return cls(below, level)

    def mapped(self, figures: MapFigures, mended: float) -> MetalSoFar:
        """Return it with the surface that was measured, of which the next layer is to mend a share."""
        if self.surface is None:
            return self
        return replace(self, surface=self.surface.with_map(figures.over_mm).mending(mended))

    def with_layer(self, layers: pd.DataFrame, surface: Surface, spent: Spent, config: Config) -> MetalSoFar:
        """Return it with a layer more, of which `layers` has the figures; `spent` is what is used up with it."""
        return MetalSoFar(self.below.and_layers(layers, config.process), surface, spent)
