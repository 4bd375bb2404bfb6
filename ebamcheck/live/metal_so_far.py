"""The metal of a part that is half built: how uneven its surface is, the sums that hold for all of its layers, and what they used up.

A layer is judged on it before it is released, and once more for all layers of a build by their texts.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.consumables import FRESH, Spent, consumed, spent_after
from ebamcheck.checks.metal import deposit
from ebamcheck.checks.metal_rules import MetalBelow, deposit_checks
from ebamcheck.checks.verification import read_checked
from ebamcheck.errors import EbamcheckError
from ebamcheck.layers.stack import Layers
from ebamcheck.live.height_map import MapFigures
from ebamcheck.mesh.part import Part
from ebamcheck.metal import Surface, target_of
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.roles import by_height
from ebamcheck.pipeline.choice import witness_backend
from ebamcheck.pipeline.mesh_sections import layer_check, sections_check
from ebamcheck.pipeline.placement import cut_heights
from ebamcheck.program import Check
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.writing.inputs import deposition_heights
from ebamcheck.writing.wire import metal_region


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


def metal_checks(
    program: NCProgram, witness: Layers, stands: MetalSoFar | None, config: Config
) -> tuple[list[Check], MetalSoFar]:
    """Checks of a layer's metal on what stands, and what stands with it.

    Sums and means count from the plate up, by the limits of a whole part; the layer, and the surface that all layers so far
    come to, by those of a single one. The layer has to pass by its text alone, too, as anybody can judge it: on a level surface,
    of which nothing is known. Spool and cathode have to last for it with what the layers below took of them.
    """
    z_of = deposition_heights(witness.heights, config.layer_height_mm, config.base_mm)
    known = stands or MetalSoFar()
    found = deposit(program, witness, z_of, config, stands=known.surface)
    checks = deposit_checks(program, found, config, None if stands is None else stands.below)
    if known.below.layers:
        by_itself = found if known.surface is None else deposit(program, witness, z_of, config)
        checks += [
            replace(check, text=f"by its text alone: {check.text}")
            for check in deposit_checks(program, by_itself, config)
            if not check.passed
        ]
    used = consumed(program, config, known.spent)
    if known.spent != FRESH:
        checks += [one.check() for one in used]
    return checks, known.with_layer(found.layers, found.surface, spent_after(used), config)


def mesh_and_metal(
    program: NCProgram, part: Part, witness: Layers, stands: MetalSoFar | None, config: Config
) -> tuple[list[Check], MetalSoFar]:
    """Whether a layer is cut where it comes to lie, its section is that of the mesh, and its metal that of the section.

    Parameters and result as of :func:`ebamcheck.live.metal_so_far.metal_checks`.
    """
    checks, now = metal_checks(program, witness, stands, config)
    height = layer_check(part, float(witness.heights[0]), config.base_mm, config.layer_height_mm)
    return [*checks, height, sections_check(part, witness, config)], now


SAME = 1e-3
"""Share by which sums of a certificate may differ from those worked out anew: by far less for another slicer, by far more where those of
a layer are missing."""


class MetalAgain:
    """Metal of a build, followed from the plate up."""

    def __init__(self, part: Part, config: Config) -> None:
        self._part = part
        self._so_far = MetalSoFar.none(part, config)

    def with_layer(self, program: Path, paper: dict[str, Any], config: Config) -> str | None:
        """Lay one more layer; what is wrong with it, empty where nothing is, or None where what lies above cannot be told."""
        text, _ = read_checked(program, config)
        # What a map has measured is not what the texts come to.
        if text is None or "height_map" in paper:
            return None
        try:
            witness = witness_backend(str(paper["primary"]))
            section = slice_part(self._part, cut_heights(self._part, config), witness)
            told = paper["metal_so_far"]
        except (EbamcheckError, KeyError, TypeError, ValueError):
            return None
        text = by_height(text, np.array([config.base_mm + config.layer_height_mm]))
        checks, self._so_far = metal_checks(text, section, self._so_far.measured(), config)
        wrong = [f"metal over all layers: {check.in_words()}" for check in checks if not check.passed]
        if not _same(told, asdict(self._so_far.below)):
            wrong.append("metal over all layers: its certificate has other sums of it than the texts so far")
        return "; ".join(wrong)


def _same(told: Any, worked_out: dict[str, Any]) -> bool:
    """Whether sums over layers, as a certificate has them, are those worked out."""
    try:
        pairs = [
            (np.asarray(told[name], np.float64), np.asarray(value)) for name, value in worked_out.items()
        ]
        return all(np.allclose(said, found, rtol=SAME, atol=SAME) for said, found in pairs)
    except (KeyError, TypeError, ValueError):
        return False
