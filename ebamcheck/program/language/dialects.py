"""What controls understand beside motions: the beam and wire blocks of a profile that names none of its own.

The templates of the machine profile are those of a SINUMERIK unless they are set; a control of another
language takes its own in their place. The codes of beam and wire are the machine maker's in any case.
"""

from __future__ import annotations

from collections.abc import Mapping

from ebamcheck.settings.machine import MachineSettings

SINUMERIK, LINUXCNC, PLAIN = "sinumerik-840d-sl", "linuxcnc", "plain-gcode"
"""Controls whose programs are text that the reader reads."""

TEXT_CONTROLS = (SINUMERIK, LINUXCNC, PLAIN)

TEMPLATES = (
    "beam_on", "beam_off", "wire_start", "wire_stop", "wire_retract",
    "set_beam", "set_power", "set_wire", "layer_begin", "layer_end", "layer_pause",
)  # fmt: skip
"""Templates of the machine profile."""

STOCK: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    # LinuxCNC: M64, M65 switch digital outputs at once, M68 sets analog ones, M67 does with the motion that follows: the
    # beam is given its current at once before it is switched on, or it would stand at that of before.
    LINUXCNC: {
        "beam_on": ("M68 E1 Q{current_ma} ; beam current, mA", "M64 P0 ; beam on"),
        "beam_off": ("M65 P0 ; beam off",),
        "set_beam": (
            "M68 E0 Q{voltage_kv} ; accelerating voltage, kV",
            "M68 E1 Q{current_ma} ; beam current, mA",
        ),
        "set_power": ("M67 E1 Q{current_ma} ; beam current, mA",),
        "set_wire": ("M67 E2 Q{wire_mm_s} ; wire speed, mm/s",),
        "wire_start": ("M68 E2 Q{wire_mm_s} ; wire speed, mm/s", "M64 P1 ; wire on"),
        "wire_stop": ("M65 P1 ; wire off",),
        "wire_retract": ("M68 E3 Q{wire_retract_mm} ; wire drawn back, mm",),
        "layer_pause": ("G4 P{layer_pause_s} ; wait, s",),
    },
    # Hobby and laser controls: M3 S, M5 for the source; M42 sets a pin, M8 and M9 a second output.
    PLAIN: {
        "beam_on": ("M3 S{power_w} ; beam on, W",),
        "beam_off": ("M5 ; beam off",),
        "set_beam": (),
        "set_power": ("S{power_w} ; beam, W",),
        "set_wire": ("M42 P1 S{wire_mm_s} ; wire speed, mm/s",),
        "wire_start": ("M42 P1 S{wire_mm_s} ; wire speed, mm/s", "M8 ; wire on"),
        "wire_stop": ("M9 ; wire off",),
        "wire_retract": ("M42 P2 S{wire_retract_mm} ; wire drawn back, mm",),
        "layer_pause": ("G4 S{layer_pause_s} ; wait, s",),
    },
}


def templates_of(machine: MachineSettings, control: str) -> dict[str, tuple[str, ...]]:
    """Blocks of every template for a control: those of the profile, or the stock ones where it sets none."""
    stock = STOCK.get(control, {})
    result = {}
    for name in TEMPLATES:
        given = getattr(machine, name)
        untouched = given == MachineSettings.model_fields[name].default
        result[name] = stock.get(name, given) if untouched else given
    return result
