"""The controls LinuxCNC and plain G-code: templates, codes, and modal groups (LinuxCNC G-code reference); their writers and readers
by name."""

from __future__ import annotations

from ebamcheck.nc.control import Control, Group, offsets
from ebamcheck.nc.conventions import plain
from ebamcheck.settings.machine import MachineSettings

GROUPS = (
    Group("plane", ("G17", "G18", "G19", "G17.1", "G18.1", "G19.1")),
    Group("units", ("G20", "G21")),
    Group("distances", ("G90", "G91")),
    Group("arc distances", ("G90.1", "G91.1")),
    Group("feed", ("G93", "G94", "G95")),
    Group("radius compensation", ("G40", "G41", "G42", "G41.1", "G42.1")),
    Group("tool offset", ("G43", "G43.1", "G43.2", "G49")),
    Group("canned cycle", ("G73", "G76", "G80", "G81", "G82", "G83", "G84", "G85", "G86", "G87", "G88", "G89", "G98", "G99")),
    Group("work offset", ("G53", *offsets(54, 59), "G59.1", "G59.2", "G59.3", "G10")),
    Group("axis offset", ("G52", "G92", "G92.1", "G92.2", "G92.3")),
    Group("path control", ("G61", "G61.1", "G64"), path=True),
    Group("override", ("M48", "M49", "M50", "M51", "M52", "M53", "M220", "M221"), path=True),
    Group("spindle", ("M3", "M4", "M5", "M19", "S", "G96", "G97")),
    Group("tool", ("T", "M6", "M61")),
    Group("coolant", ("M7", "M8", "M9")),
    Group("other axes", ("A", "B", "C", "U", "V", "W", "G28", "G30", "G33", "G38.2", "G4", "G5.1", "G5.2", "G5.3", "E")),
    Group("program flow", ("M0", "M1", "M2", "M30", "M60", "M98", "M99", "O", "G65", "G66")),
)  # fmt: skip

# M64, M65 switch digital outputs at once, M68 sets analog ones, M67 does with the motion that follows: the beam is given its
# current at once before it is switched on, or it would stand at that of before.
LINUXCNC_TEMPLATES = {
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
LINUXCNC_CODES = {
    "M64 P0": "beam_on", "M65 P0": "beam_off", "M64 P1": "wire_start", "M65 P1": "wire_stop",
    "M68 E0 Q": "voltage_kv", "M67 E0 Q": "voltage_kv", "M68 E1 Q": "current_ma", "M67 E1 Q": "current_ma",
    "M68 E2 Q": "wire_mm_s", "M67 E2 Q": "wire_mm_s", "M68 E3 Q": "wire_retract_mm", "M67 E3 Q": "wire_retract_mm",
}  # fmt: skip


def _linuxcnc_words(machine: MachineSettings) -> tuple[str, ...]:
    """Words that hold at every motion."""
    offsets_off = ("G40", "G49", "G80", "G92.1")
    return "G17", "G21", "G90", "G91.1", "G94", *offsets_off, machine.work_offset, "G64"


def lines_of_curves(machine: MachineSettings) -> dict[str, str]:
    """Line of the header on curves of controls that have arcs and lines alone."""
    g1 = machine.curve_form == "lines"
    return {"CURVES": f"{'G1' if g1 else 'G2 and G3'}, within {machine.line_tolerance_mm:g} mm"}


def _linuxcnc_lines(machine: MachineSettings) -> dict[str, str]:
    """Lines of the header on curves and smoothing."""
    tolerance = plain(machine.smoothing_tolerance_mm)
    curves = lines_of_curves(machine) if machine.curve_form in ("arcs", "lines") else {"CURVES": "G5, exactly"}
    return curves | {"SMOOTHING": f"G64 P{tolerance}, path may leave the program by {tolerance} mm"}


LINUXCNC = Control(
    name="linuxcnc",
    writer="ebamcheck.controls.gcode.writing:write_linuxcnc",
    reader="ebamcheck.controls.gcode.reading:read_linuxcnc",
    suffixes=(".NGC",),
    templates=LINUXCNC_TEMPLATES,
    codes=LINUXCNC_CODES,
    dwell_address="P",
    groups=GROUPS,
    words=_linuxcnc_words,
    form_lines=_linuxcnc_lines,
    tolerance_word="P",
    smoothing_needs_tolerance="G64",
)


PLAIN_TEMPLATES = {
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
PLAIN_CODES = {
    "M3": "beam_on", "M5": "beam_off", "M8": "wire_start", "M9": "wire_stop",
    "S": "power_w", "M42 P1 S": "wire_mm_s", "M42 P2 S": "wire_retract_mm",
}  # fmt: skip


def _plain_words(machine: MachineSettings) -> tuple[str, ...]:
    """Words that hold at every motion."""
    return "G17", "G21", "G90", "G94", "G40", "G49", "G80", "G92.1", machine.work_offset


PLAIN_GCODE = Control(
    name="plain-gcode",
    writer="ebamcheck.controls.gcode.writing:write_plain_gcode",
    reader="ebamcheck.controls.gcode.reading:read_plain_gcode",
    suffixes=(".GCODE", ".NC", ".G"),
    templates=PLAIN_TEMPLATES,
    codes=PLAIN_CODES,
    dwell_address="S",
    groups=GROUPS,
    words=_plain_words,
    form_lines=lines_of_curves,
    splines="arcs",
)
