"""What stands under the next layer: heat, metal and what was used up, as worked out, as measured, and with one layer more."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.consumables import FRESH, Spent, consumed, spent_after
from ebamcheck.checks.metal import deposit
from ebamcheck.checks.metal_rules import MetalBelow, deposit_checks
from ebamcheck.heat.balance import HeatColumn
from ebamcheck.heat.interpass import SimulatedLayer
from ebamcheck.heat.part_heat import PartHeat
from ebamcheck.layers.stack import Layers
from ebamcheck.live.height_map import MENDING, MapFigures, Reading, Refused, Warmth, figures_of
from ebamcheck.mesh.part import Part
from ebamcheck.metal import Surface, target_of
from ebamcheck.metal.surface import MENDED
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.nc.motions import NCProgram
from ebamcheck.program import Check
from ebamcheck.settings.config import Config
from ebamcheck.writing.wire import metal_region

LONGEST_S = 4.0 * 3600.0  # time after a layer up to which a temperature is taken


@dataclass(frozen=True, eq=False)
class Before:
    """What stands when a layer begins; None where it is not known."""

    part: PartHeat  # when its uppermost layer is done
    last: SimulatedLayer | None = None  # how that was driven
    below: MetalBelow | None = None  # sums of the metal over the layers that stand
    surface: Surface | None = None  # by the text of their programs; None: level
    spent: Spent = FRESH  # what they took of spool and cathode

    @classmethod
    def cold(cls, config: Config) -> Before:
        """Return a part that is as cold as the bare plate, of whose metal nothing is known."""
        return cls(PartHeat(HeatColumn(config)))

    @classmethod
    def plate(cls, part: Part, config: Config) -> Before:
        """Return the bare plate, with room for all layers of a part."""
        bead_mm = config.process.bead_width_mm
        room_mm = bead_mm + config.process.machining_allowance_mm
        box = np.concatenate([part.bounds[0, :2] - room_mm, part.bounds[1, :2] + room_mm])
        return replace(cls.cold(config), below=MetalBelow(), surface=Surface(box, bead_mm))

    @property
    def laid(self) -> bool:
        """Whether anything stands on the plate."""
        return self.part.column.absorbed_j > 0.0

    @property
    def surface_k(self) -> float:
        """Mean temperature of the surface, absolute."""
        return float(self.part.column.surface_k)

    def rested(self, duration_s: float) -> Before:
        """Return the same after a time with the beam off."""
        if duration_s <= 0.0:
            return self
        part = self.part.copy()
        part.rest(duration_s)
        return replace(self, part=part)

    def measured(self) -> Before:
        """Return the same when its height was measured: its surface is on average there, and as uneven as it was."""
        return self if self.surface is None else replace(self, surface=self.surface.measured())

    def on_section(self, section: BaseGeometry, part: Part, config: Config) -> Before:
        """Return the same with a level surface of which the section of the uppermost layer is known, and no more."""
        level = Before.plate(part, config).surface
        assert level is not None
        target = target_of(metal_region(section, config), level.step_mm, 2.0 * config.process.bead_width_mm)
        level.add(target, target.share, 1.0)
        return replace(self, below=self.below or MetalBelow(), surface=level)

    def mapped(self, figures: MapFigures, mended: float) -> Before:
        """Return it with the surface that was measured, of which the next layer is to mend a share."""
        assert self.surface is not None
        return replace(self, surface=self.surface.with_map(figures.over_mm).mending(mended))


def metal_checks(program: NCProgram, witness: Layers, before: Before, config: Config) -> tuple[list[Check], Before]:
    """Checks of a layer's metal on what stands, and what stands with it; its heat is that before it.

    Sums count from the plate up, by the limits of a whole part, the layer and the surface by those of a single one. It has to pass
    by its text alone, too, on a level surface; and spool and cathode have to last for it with what the layers below took of them.
    """
    z_of = deposition_heights(witness.heights, config.layer_height_mm, config.base_mm)
    below = before.below or MetalBelow()
    found = deposit(program, witness, z_of, config, stands=before.surface)
    checks = deposit_checks(program, found, config, before.below)
    if below.layers:
        by_itself = found if before.surface is None else deposit(program, witness, z_of, config)
        checks += [
            replace(check, text=f"by its text alone: {check.text}")
            for check in deposit_checks(program, by_itself, config)
            if not check.passed
        ]
    used = consumed(program, config, before.spent)
    if before.spent != FRESH:
        checks += [one.check() for one in used]
    below = below.and_layers(found.layers, config.process)
    return checks, replace(before, below=below, surface=found.surface, spent=spent_after(used))


@dataclass(frozen=True)
class Correction:
    """What a pyrometer says of the model: temperature of the surface then, before it was corrected, and factor of its rise."""

    measured: Warmth
    modelled_k: float
    factor: float

    @property
    def why(self) -> str:
        """The reason, in words."""
        off_k = self.measured.surface_k - self.modelled_k
        what = f"{abs(off_k):.0f} K {'warmer' if off_k > 0.0 else 'colder'} than worked out"
        return (
            f"{self.measured.after_s:g} s after the layer the part is {what}: its rise counts {self.factor:.3f} times"
        )

    def told(self) -> dict[str, Any]:
        """Return the figures and the reason, for answer, journal and certificate."""
        said = {"measured_k": self.measured.surface_k, "after_s": self.measured.after_s, "why": self.why}
        return {**said, "modelled_k": round(self.modelled_k, 3), "factor": round(self.factor, 6)}


def check_warmth(before: Before, found: Warmth, config: Config) -> None:
    """Refuse a measured temperature that the part cannot have, or of which the model says nothing."""
    chamber_k, limit_k = config.process.ambient_temperature_k, config.process.pyrometer_limit_k
    if not before.laid:
        why = "surface_k is of a part on which something was laid"
    elif not 0.0 <= found.after_s <= LONGEST_S:
        why = f"after_s {found.after_s:g} is not from 0 to {LONGEST_S:g} s"
    elif not chamber_k <= found.surface_k <= config.material.solidus_k:
        bounds = f"the chamber's {chamber_k:g} K and the solidus, {config.material.solidus_k:g} K"
        why = f"surface_k {found.surface_k:g} is not between {bounds}: give kelvins"
    elif (off_k := abs(found.surface_k - (modelled_k := before.rested(found.after_s).surface_k))) > limit_k:
        over = f"over process.pyrometer_limit_k, {limit_k:g} K"
        why = f"surface_k {found.surface_k:g} is {off_k:.0f} K off the model, {modelled_k:.0f} K then: {over}"
    elif modelled_k - chamber_k < 20.0:
        why = f"surface_k: the part is as cold as the chamber ({modelled_k:.0f} K), of which a factor says nothing"
    else:
        return
    raise Refused("temperature", why)


def corrected(before: Before, found: Warmth, config: Config) -> tuple[Before, Correction]:
    """Return what stands at the moment of a reading, as warm as was measured, and what was done to it.

    How much of the beam's power the part takes up is least known, and its rise over the chamber is linear in it as long as
    conduction carries the heat: so the whole rise is multiplied by that of the surface as measured over that as worked out."""
    then = before.rested(found.after_s)
    modelled_k, chamber_k = then.surface_k, config.process.ambient_temperature_k
    factor = (found.surface_k - chamber_k) / (modelled_k - chamber_k)
    part = then.part.copy()
    column = part.column
    rise_k = factor * (column.temperature_k - chamber_k)
    column.content = column.material.heat_content(chamber_k + rise_k)
    part.field.state *= factor
    return replace(then, part=part), Correction(found, modelled_k, factor)


@dataclass(frozen=True, eq=False)
class Ground:
    """What a layer is laid on, joined with a reading: what a map and a pyrometer say of it; None without them."""

    reading: Reading
    before: Before
    figures: MapFigures | None
    correction: Correction | None

    @classmethod
    def of(cls, reading: Reading, before: Before, config: Config) -> Ground:
        """Join what was worked out with a reading; its heat is then that of the moment at which a temperature was read."""
        figures = correction = None
        if reading.cells is not None and before.surface is not None:
            figures = figures_of(reading.cells, before.surface, config)
        if reading.warmth is not None:
            before, correction = corrected(before, reading.warmth, config)
        return cls(reading, before, figures, correction)

    @property
    def since_s(self) -> float:
        """Time since the layer was done, at which the heat is known."""
        return 0.0 if self.correction is None else self.correction.measured.after_s

    @property
    def mending(self) -> tuple[float, ...]:
        """Shares of what is uneven that are tried to be mended, one after the other."""
        return (MENDED,) if self.figures is None else MENDING

    def mended(self, share: float) -> Before:
        """What the layer is planned on that mends a share."""
        return self.before if self.figures is None else self.before.mapped(self.figures, share)

    def told(self, mended: float) -> dict[str, Any]:
        """What was measured beside the height, for answer and certificate."""
        found: dict[str, Any] = {}
        if self.figures is not None:
            found["height_map"] = {**self.figures.told(), "sha256": self.reading.map_sha256, "mended": mended}
        if self.correction is not None:
            found["temperature"] = self.correction.told()
        return found
