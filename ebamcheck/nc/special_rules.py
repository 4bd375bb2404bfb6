"""What preheating and a turned part need of machine, control and process, before anything is sliced or written."""

from __future__ import annotations

from itertools import product

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.heat.melting import entry_limit_k
from ebamcheck.nc.control import control
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import KeepOut

# Heights of a keep-out zone for which nobody gave any: a place to stay out of, and no body that turns with the table.
NO_HEIGHT = KeepOut.model_fields["z_mm"].default


def checked_preheating(config: Config, name: str) -> None:
    """Refuse preheating that this machine, or the control `name`, cannot do, or that would be none.

    Raises
    ------
    SettingsError
        That names the setting, and what to do.
    """
    settings, machine, process = config.preheat, config.machine, config.process
    if settings.when == "off":
        return
    why = ""
    if not control(name).subprogram_suffix:
        why = f"control {name!r} has programs of one file: a scan is a subprogram of its own"
    elif not machine.set_focus:
        why = 'machine.set_focus is empty: give the block that sets the focus, such as "H5={defocus} ; focus"'
    elif settings.defocus == 0.0:
        why = "preheat.defocus is 0, the focus of the beads: give the value at which the beam is preheat.spot_mm wide"
    elif settings.current_ma > process.current_max_ma:
        why = f"preheat.current_ma {settings.current_ma:g} is over process.current_max_ma {process.current_max_ma:g}"
    elif not machine.feed_min_mm_s <= settings.speed_mm_s <= machine.feed_max_mm_s:
        why = (
            f"preheat.speed_mm_s {settings.speed_mm_s:g} is not within machine.feed_min_mm_s and feed_max_mm_s, "
            f"{machine.feed_min_mm_s:g} .. {machine.feed_max_mm_s:g}"
        )
    elif settings.when == "layers" and process.layer_pause_s > 0.0:
        why = "process.layer_pause_s lets layers cool that preheat.when = 'layers' heats: use one of them"
    elif settings.target_k + settings.over_k > entry_limit_k(config):
        why = (
            f"preheat.target_k + over_k is {settings.target_k + settings.over_k:g} K, over {entry_limit_k(config):g} K at which no bead "
            "may be entered"
        )
    elif config.base_mm > 0.0 and settings.scan_in == "own":
        why = "the program begins on what stands (layers.base_mm), and its main program preheats nothing: set preheat.scan_in = 'layer'"
    if why:
        raise SettingsError(f"preheat.when is {settings.when!r}: {why}")


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
