"""Settings of preheating: a scan of the base plate, or of what stands, with a wide beam and without wire."""

from __future__ import annotations

from typing import Annotated, Literal

from ebamcheck.settings.base import Between, Length, Section, Temperature

Kelvins = Annotated[float, Between(1.0, 1000.0)]
"""Difference of temperatures, K."""

LEAST_LINE_MM = 0.1
"""Shorter lines of a scan are left out."""

JOINED_SPACINGS = 1.6
"""Ends of lines nearer than this, over the spacing, are joined under the beam, where the way lies within the region."""

AIM_K = 3.0
"""The passes aim so far over the target: travel and chunks of time make no more between plan and text."""

LEAST_REST_S = 5.0
"""Time in which the surface of a layer that was just laid comes to what lies under it, at least."""


class PreheatSettings(Section):
    """Preheating by scans of plate and layers; off unless it is asked for.

    It needs `machine.set_focus`, and a control with subprograms.
    """

    when: Literal["off", "plate", "layers"] = "off"
    """Never; before the first layer, on the base plate; or before every layer, too, on what stands, where that is colder than
    target_k."""
    scan_in: Literal["own", "layer"] = "own"
    """Where a scan stands: in a subprogram of its own, which the main program calls; or at the beginning of its layer's, which then is all
    that is to be called. `live` and `relayer` write it so, since a layer is released as one file."""
    pattern: Literal["lines", "crossed"] = "crossed"
    """Lines along X in every pass, every second one half a spacing aside; or along X and Y in turn."""
    current_ma: Annotated[float, Between(0.01, 1e4)] = 20.0
    """Current of the beam while it preheats."""
    defocus: Annotated[float, Between(-1e6, 1e6)] = 0.0
    """What {defocus} in machine.set_focus stands for, in the machine's own unit: how far the focus is off for a beam of spot_mm.
    0 is the focus of the beads, and is refused."""
    spot_mm: Annotated[float, Between(0.1, 500.0)] = 20.0
    """Diameter of the beam on the surface when it is out of focus, four standard deviations of its intensity."""
    speed_mm_s: Annotated[float, Between(0.01, 1e4)] = 50.0
    """Speed of the beam."""
    spacing_mm: Annotated[float, Between(0.1, 500.0)] = 10.0
    """Distance of the lines."""
    passes: Annotated[int, Between(1, 10000)] | None = None
    """How many times the surface is scanned; None: as often as the target asks for, by the heat model."""
    most_passes: Annotated[int, Between(1, 10000)] = 100
    """How often at most, where passes is not set."""
    target_k: Temperature = 450.0
    """Mean temperature of the scanned surface that is to be reached when the first bead begins."""
    over_k: Kelvins = 50.0
    """How far it may lie over that."""
    evenness_k: Kelvins = 60.0
    """Greatest difference of temperatures on the scanned surface then."""
    soak_s: Annotated[float, Between(0.0, 1e5)] = 30.0
    """Wait with the beam off after the last pass, in which the temperature evens out."""
    margin_mm: Length = 10.0
    """How far the scan of the plate reaches beyond the box around the lowest section."""
