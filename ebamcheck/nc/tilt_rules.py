"""What a turned layer needs of machine and control before anything is written: rotary axes, and a control with frames."""

from __future__ import annotations

from itertools import product

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.nc.control import control
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import KeepOut

NO_HEIGHT = KeepOut.model_fields["z_mm"].default
"""Heights of a keep-out zone for which nobody gave any: a place to stay out of, and no body that turns with the table."""


def checked_tilt(config: Config, name: str) -> None:
    """Refuse a turned layer for a control that has no frames, or a machine without rotary axes.

    Raises
    ------
    SettingsError
        That names the setting, and what to do.
    """
    if config.part.on_table is None:
        return
    if not config.machine.rotary:
        raise SettingsError(
            "part.on_table says that the part is turned between layers, and machine.rotary names no axis that turns it"
        )
    if not control(name).frames:
        raise SettingsError(
            f"machine.control {name!r}: no program is written for it that turns a tilt table (machine.rotary), since it has no frame for the "
            "turned layer: leave machine.rotary out, turn the part with machine.tilt_axes, and set the offset on the control"
        )
    if config.preheat.when != "off":
        raise SettingsError(
            f"preheat.when is {config.preheat.when!r}: a turned layer is not preheated; set preheat.when = 'off'"
        )


def carried_corners(config: Config) -> Floats:
    """Corners (n, 3) of all that the table carries, its axes at 0: box of the part, base plate, and clamps of known height."""
    stands = config.part.on_table
    assert stands is not None
    machine, process = config.machine, config.process
    (x0, y0, z0), (x1, y1, z1) = stands.low_mm, stands.high_mm
    px0, py0 = machine.base_plate_min_mm or (x0, y0)
    px1, py1 = machine.base_plate_max_mm or (x1, y1)
    corners = [
        *product((x0, x1), (y0, y1), (z0, z1)),
        *product((px0, px1), (py0, py1), (-process.base_plate_mm, 0.0)),
    ]
    for zone in process.keep_out:
        if zone.z_mm != NO_HEIGHT:
            corners += [(x, y, z) for (x, y), z in product(zone.outline_mm, zone.z_mm)]
    return np.array(corners, np.float64)
