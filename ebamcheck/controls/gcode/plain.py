"""What the house knows of plain G-code: hobby and laser controls, M3 S and M5 for the source, M42 for a pin, M8 and M9."""

from __future__ import annotations

from ebamcheck.controls.gcode.groups import GROUPS
from ebamcheck.nc.control import Control
from ebamcheck.settings.machine import MachineSettings

NAME = "plain-gcode"

TEMPLATES = {
    "beam_on": ("M3 S{power_w} ; beam on, W",),
    "beam_off": ("M5 ; beam off",),
    "set_beam": (),
    "set_power": ("S{power_w} ; beam, W",),
    "set_wire": ("M42 P1 S{wire_mm_s} ; wire speed, mm/s",),
    "wire_start": ("M42 P1 S{wire_mm_s} ; wire speed, mm/s", "M8 ; wire on"),
    "wire_stop": ("M9 ; wire off",),
    "wire_retract": ("M42 P2 S{wire_retract_mm} ; wire drawn back, mm",),
    "layer_pause": ("G4 S{layer_pause_s} ; wait, s",),
}

CODES = {
    "M3": "beam_on", "M5": "beam_off", "M8": "wire_start", "M9": "wire_stop",
    "S": "power_w", "M42 P1 S": "wire_mm_s", "M42 P2 S": "wire_retract_mm",
}  # fmt: skip


def words(machine: MachineSettings) -> tuple[str, ...]:
    """Words that hold at every motion."""
    return "G17", "G21", "G90", "G94", "G40", "G49", "G80", "G92.1", machine.work_offset


def form_lines(machine: MachineSettings) -> dict[str, str]:
    """Lines of the header on curves."""
    g1 = machine.curve_form == "lines"
    return {"CURVES": f"{'G1' if g1 else 'G2 and G3'}, within {machine.line_tolerance_mm:g} mm"}


CONTROL = Control(
    name=NAME,
    writer="ebamcheck.controls.gcode.writing:write_plain_gcode",
    reader="ebamcheck.controls.gcode.reading:read_plain_gcode",
    suffixes=(".GCODE", ".NC", ".G"),
    templates=TEMPLATES,
    codes=CODES,
    dwell_address="S",
    groups=GROUPS,
    words=words,
    form_lines=form_lines,
    splines="arcs",
)
