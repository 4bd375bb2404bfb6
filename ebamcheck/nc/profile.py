"""The beam and wire blocks of a machine profile, for one control.

The templates of the machine profile are those of a SINUMERIK unless they are set; a control of another language takes its
own in their place. The codes of beam and wire are the machine maker's in any case.
"""

from __future__ import annotations

from ebamcheck.nc.control import control
from ebamcheck.settings.machine import MachineSettings

TEMPLATES = (
    "beam_on", "beam_off", "wire_start", "wire_stop", "wire_retract",
    "set_beam", "set_power", "set_wire", "set_focus", "layer_begin", "layer_end", "layer_pause",
)  # fmt: skip
"""Templates of the machine profile."""


def templates_of(machine: MachineSettings, name: str) -> dict[str, tuple[str, ...]]:
    """Blocks of every template for a control: those of the profile, or the stock ones where it sets none."""
    stock = control(name).templates
    result = {}
    for template in TEMPLATES:
        given = getattr(machine, template)
        untouched = given == MachineSettings.model_fields[template].default
        result[template] = stock.get(template, given) if untouched else given
    return result
