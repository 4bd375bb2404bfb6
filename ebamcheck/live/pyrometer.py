"""A measured temperature of the surface beside the height: it corrects the heat that the next layer is planned on.

The model knows the heat of the part when its uppermost layer was done. A pyrometer that reads less says that the part has rested
since, or loses more than was thought: the model rests for the time after which it reads the same, and the wait gets shorter. One
that reads more puts the heat into the uppermost layer that makes it read the same, and the wait gets longer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from ebamcheck.live.heat_so_far import HeatSoFar
from ebamcheck.settings.config import Config

ALIKE_K = 1.0
"""Difference that is no difference: what a pyrometer cannot tell."""

LONGEST_REST_S = 4.0 * 3600.0
"""Time for which a model rests at most."""

STEPS = 40
"""Halvings of a search: a rest of hours to a hundredth of a microsecond."""

SOAK_S = 1.0
"""Time in which heat is put into the uppermost layer."""


@dataclass(frozen=True)
class Correction:
    """What a pyrometer says of the model.

    Parameters
    ----------
    measured_k, modelled_k
        Mean temperature of the surface, measured and by the model before it was corrected.
    rested_s, added_j
        What corrected it: one of them is 0.
    """

    measured_k: float
    modelled_k: float
    rested_s: float
    added_j: float

    def told(self) -> dict[str, Any]:
        """Return the figures and the reason, for answer, journal and certificate."""
        if self.rested_s:
            why = f"the part is {self.modelled_k - self.measured_k:.0f} K colder than worked out: the model rests {self.rested_s:.1f} s more"
        elif self.added_j:
            why = f"the part is {self.measured_k - self.modelled_k:.0f} K warmer than worked out: the model takes up {1e-3 * self.added_j:.2f} kJ more"
        else:
            why = "the part is as warm as worked out"
        return {
            "measured_k": self.measured_k, "modelled_k": round(self.modelled_k, 3), "rested_s": round(self.rested_s, 3),
            "added_j": round(self.added_j, 3), "why": why,
        }  # fmt: skip


def temperature_of(message: dict[str, Any]) -> float | str | None:
    """Return the temperature of a message, None where it has none, or what is wrong with it."""
    value = message.get("surface_k")
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return f"surface_k {value!r:.20}: is not a finite number of kelvins"
    return float(value)


def fault_of_temperature(heat: HeatSoFar, measured_k: float, config: Config) -> str:
    """What is wrong with a measured temperature; empty: it is used."""
    if not heat.laid:
        return "surface_k is of a part on which something was laid"
    modelled_k, limit_k = heat.surface_k, config.process.pyrometer_limit_k
    low_k, high_k = config.process.ambient_temperature_k, config.material.solidus_k
    if not low_k <= measured_k <= high_k:
        return f"surface_k {measured_k:g} is not between the chamber's {low_k:g} K and the solidus, {high_k:g} K: give kelvins"
    if abs(measured_k - modelled_k) > limit_k:
        return (
            f"surface_k {measured_k:g} is {abs(measured_k - modelled_k):.0f} K off the model, {modelled_k:.0f} K: over "
            f"process.pyrometer_limit_k, {limit_k:g} K"
        )
    if _rested(heat, LONGEST_REST_S) > measured_k + ALIKE_K:
        return (
            f"surface_k {measured_k:g} is colder than the part gets within {LONGEST_REST_S / 3600.0:g} hours"
        )
    return ""


def corrected(heat: HeatSoFar, measured_k: float) -> tuple[HeatSoFar, Correction]:
    """Return the heat whose surface is as warm as was measured, and what was done to it."""
    modelled_k = heat.surface_k
    if abs(measured_k - modelled_k) <= ALIKE_K:
        return heat, Correction(measured_k, modelled_k, 0.0, 0.0)
    if measured_k < modelled_k:
        rest_s = _found(lambda t: modelled_k - _rested(heat, t), modelled_k - measured_k, LONGEST_REST_S)
        return heat.rested(rest_s), Correction(measured_k, modelled_k, rest_s, 0.0)
    most_j = 1.0
    while _soaked(heat, most_j).surface_k < measured_k:
        most_j *= 4.0
    added_j = _found(lambda e: _soaked(heat, e).surface_k - modelled_k, measured_k - modelled_k, most_j)
    return _soaked(heat, added_j), Correction(measured_k, modelled_k, 0.0, added_j)


def _rested(heat: HeatSoFar, duration_s: float) -> float:
    return heat.rested(duration_s).surface_k


def _soaked(heat: HeatSoFar, energy_j: float) -> HeatSoFar:
    """The same heat with so much more in the uppermost layer."""
    part = heat.part.copy()
    part.column.advance(SOAK_S, energy_j)
    return replace(heat, part=part)


def _found(rising: Callable[[float], float], wanted: float, most: float) -> float:
    """Place from 0 to `most` at which a function that rises comes to a value."""
    low, high = 0.0, most
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rising(middle) < wanted else (low, middle)
    return high
