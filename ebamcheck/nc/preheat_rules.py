"""What preheating needs of machine, control and process, before anything is sliced or written."""

from __future__ import annotations

from ebamcheck.errors import SettingsError
from ebamcheck.heat.melting import entry_limit_k
from ebamcheck.nc.control import control
from ebamcheck.settings.config import Config


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
