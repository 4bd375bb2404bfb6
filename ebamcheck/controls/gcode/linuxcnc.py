"""The control LinuxCNC: its templates, codes and modal groups, and the names of its writer and reader.

M64, M65 switch digital outputs at once, M68 sets analog ones, M67 does with the motion that follows: the beam is given its
current at once before it is switched on, or it would stand at that of before.
"""

from __future__ import annotations

from ebamcheck.controls.gcode.groups import GROUPS
from ebamcheck.nc.control import Control
from ebamcheck.nc.numbers import plain
from ebamcheck.settings.machine import MachineSettings

NAME = "linuxcnc"

TEMPLATES = {
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
}

CODES = {
    "M64 P0": "beam_on", "M65 P0": "beam_off", "M64 P1": "wire_start", "M65 P1": "wire_stop",
    "M68 E0 Q": "voltage_kv", "M67 E0 Q": "voltage_kv", "M68 E1 Q": "current_ma", "M67 E1 Q": "current_ma",
    "M68 E2 Q": "wire_mm_s", "M67 E2 Q": "wire_mm_s", "M68 E3 Q": "wire_retract_mm", "M67 E3 Q": "wire_retract_mm",
}  # fmt: skip


def words(machine: MachineSettings) -> tuple[str, ...]:
    """Words that hold at every motion."""
    offsets_off = ("G40", "G49", "G80", "G92.1")
    return "G17", "G21", "G90", "G91.1", "G94", *offsets_off, machine.work_offset, "G64"


def form_lines(machine: MachineSettings) -> dict[str, str]:
    """Lines of the header on curves and smoothing."""
    g1 = machine.curve_form == "lines"
    within = f"{'G1' if g1 else 'G2 and G3'}, within {machine.line_tolerance_mm:g} mm"
    tolerance = plain(machine.smoothing_tolerance_mm)
    return {
        "CURVES": within if machine.curve_form in ("arcs", "lines") else "G5, exactly",
        "SMOOTHING": f"G64 P{tolerance}, path may leave the program by {tolerance} mm",
    }


CONTROL = Control(
    name=NAME,
    writer="ebamcheck.controls.gcode.writing:write_linuxcnc",
    reader="ebamcheck.controls.gcode.reading:read_linuxcnc",
    suffixes=(".NGC",),
    templates=TEMPLATES,
    codes=CODES,
    dwell_address="P",
    groups=GROUPS,
    words=words,
    form_lines=form_lines,
    tolerance_word="P",
    smoothing_needs_tolerance="G64",
)
