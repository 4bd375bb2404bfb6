"""A measured temperature of the surface beside the height: it corrects the heat that the next layer is planned on.

The model knows the heat of the part when its uppermost layer was done, and lets it rest until the moment at which the pyrometer was
read. What is least known of it is how much of the beam's power the part takes up, in which its rise over the chamber is linear as long as
conduction carries the heat: so the whole rise is multiplied by that of the surface as measured over that as worked out. A colder part
waits shorter, a warmer one longer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from ebamcheck.live.heat_so_far import HeatSoFar
from ebamcheck.settings.config import Config

LONGEST_S = 4.0 * 3600.0
"""Time after a layer up to which a temperature is taken."""

LEAST_RISE_K = 20.0
"""Rise of the surface over the chamber, by the model, under which a factor says nothing of it."""


@dataclass(frozen=True)
class Warmth:
    """Mean temperature of the surface, K, and the time after the layer at which it was read."""

    surface_k: float
    after_s: float


@dataclass(frozen=True)
class Correction:
    """What a pyrometer says of the model.

    Parameters
    ----------
    measured
        What it read.
    modelled_k
        Temperature of the surface then, by the model before it was corrected.
    factor
        By which the rise over the chamber is multiplied.
    """

    measured: Warmth
    modelled_k: float
    factor: float

    @property
    def why(self) -> str:
        """The reason, in words."""
        off_k = self.measured.surface_k - self.modelled_k
        what = f"{abs(off_k):.0f} K {'warmer' if off_k > 0.0 else 'colder'} than worked out"
        return f"{self.measured.after_s:g} s after the layer the part is {what}: its rise counts {self.factor:.3f} times"

    def told(self) -> dict[str, Any]:
        """Return the figures and the reason, for answer, journal and certificate."""
        return {
            "measured_k": self.measured.surface_k, "after_s": self.measured.after_s, "modelled_k": round(self.modelled_k, 3),
            "factor": round(self.factor, 6), "why": self.why,
        }  # fmt: skip


def warmth_of(message: dict[str, Any]) -> Warmth | str | None:
    """Return the temperature of a message, None where it has none, or what is wrong with it."""
    if message.get("surface_k") is None:
        return None
    values = []
    for name, unit in (("surface_k", "kelvins"), ("after_s", "seconds since the layer was done")):
        value = message.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            return f"{name} {value!r:.20}: give a finite number of {unit}"
        values.append(float(value))
    return Warmth(*values)


def fault_of_warmth(heat: HeatSoFar, found: Warmth, config: Config) -> str:
    """What is wrong with a measured temperature; empty: it is used."""
    if not heat.laid:
        return "surface_k is of a part on which something was laid"
    if not 0.0 <= found.after_s <= LONGEST_S:
        return f"after_s {found.after_s:g} is not from 0 to {LONGEST_S:g} s"
    chamber_k, limit_k = config.process.ambient_temperature_k, config.process.pyrometer_limit_k
    if not chamber_k <= found.surface_k <= config.material.solidus_k:
        return (
            f"surface_k {found.surface_k:g} is not between the chamber's {chamber_k:g} K and the solidus, "
            f"{config.material.solidus_k:g} K: give kelvins"
        )
    modelled_k = heat.rested(found.after_s).surface_k
    if abs(found.surface_k - modelled_k) > limit_k:
        return (
            f"surface_k {found.surface_k:g} is {abs(found.surface_k - modelled_k):.0f} K off the model, {modelled_k:.0f} K then: over "
            f"process.pyrometer_limit_k, {limit_k:g} K"
        )
    if modelled_k - chamber_k < LEAST_RISE_K:
        return f"surface_k: the part is as cold as the chamber ({modelled_k:.0f} K), of which a factor says nothing"
    return ""


def corrected(heat: HeatSoFar, found: Warmth, config: Config) -> tuple[HeatSoFar, Correction]:
    """Return the heat at the moment of the reading, as warm as was measured, and what was done to it."""
    then = heat.rested(found.after_s)
    modelled_k, chamber_k = then.surface_k, config.process.ambient_temperature_k
    factor = (found.surface_k - chamber_k) / (modelled_k - chamber_k)
    part = then.part.copy()
    column = part.column
    assert column.tables is not None
    rise_k = factor * (column.temperature_k - chamber_k)
    column.content = column.tables.heat_content(chamber_k + rise_k)
    part.state = factor * part.state
    return replace(then, part=part), Correction(found, modelled_k, factor)
