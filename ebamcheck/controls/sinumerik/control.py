"""What the house knows of the SINUMERIK 840D sl. Source: Siemens NC Programming manual 12/2019, list of G groups."""

from __future__ import annotations

from ebamcheck.nc.control import Control, Group, offsets
from ebamcheck.settings.machine import MachineSettings

NAME = "sinumerik-840d-sl"
GROUPS = (
    Group("plane", ("G17", "G18", "G19")),
    Group("units", ("G70", "G71", "G700", "G710")),
    Group("distances", ("G90", "G91")),
    Group("feed", ("G93", "G94", "G95", "G96", "G97", "G931", "G961", "G971", "G942", "G952", "G962", "G972", "G973")),
    Group("radius compensation", ("G40", "G41", "G42")),
    Group("tool offset", ("D0", "D")),
    Group("programmable frame", ("TRANS", "ATRANS", "ROT", "AROT", "RPL", "SCALE", "ASCALE", "MIRROR", "AMIRROR", "ROTS", "AROTS", "CROTS", "MEAFRAME", "TOFRAME", "TOROT", "G58", "G59", "G25", "G26", "G110", "G111", "G112")),
    Group("work offset", ("G500", *offsets(54, 57), *offsets(505, 599), "G53", "G153", "SUPA")),
    Group("smoothing", ("G60", "G64", "G641", "G642", "G643", "G644", "G645", "G9", "G601", "G602", "G603"), path=True),
    Group("acceleration", ("BRISK", "SOFT", "DRIVE", "BRISKA", "SOFTA", "DRIVEA"), path=True),
    Group("feed forward", ("FFWON", "FFWOF"), path=True),
    Group("compressor", ("COMPOF", "COMPON", "COMPCURV", "COMPCAD", "COMPSURF", "CYCLE832"), path=True),
    Group("rapids", ("RTLION", "RTLIOF")),
    Group("feed profile", ("FNORM", "FLIN", "FCUB", "FPO", "CFC", "CFTCP", "CFIN", "FB", "FGROUP", "FGREF", "FL"), path=True),
    Group("path override", ("OVR", "OVRRAP", "OVRA", "ACC", "ACCLIMA", "VELOLIM", "JERKLIM"), path=True),
    Group("transformation", ("TRAORI", "TRANSMIT", "TRACYL", "TRAANG", "TRAFOOF", "DIAMON", "DIAM90", "KONT", "NORM")),
    Group("spindle", ("M3", "M4", "M5", "M19", "M70", "S", "SPOS", "SPCON")),
    Group("tool", ("T", "M6", "L6")),
    Group("coolant", ("M7", "M8", "M9")),
    Group("other axes", ("POS", "POSA", "POSP", "MOV", "A", "B", "C", "U", "V", "W", "STOPRE", "G74", "G75", "G4", "G33", "G331", "CIP", "CT", "ASPLINE", "CSPLINE", "SYNACT", "WHEN", "WHENEVER", "DO", "ID", "IDS")),
    Group("program flow", ("GOTO", "GOTOF", "GOTOB", "GOTOC", "GOTOS", "IF", "ELSE", "ENDIF", "WHILE", "ENDWHILE", "FOR", "ENDFOR", "LOOP", "ENDLOOP", "REPEAT", "REPEATB", "UNTIL", "CASE", "CALL", "MCALL", "PCALL", "EXTCALL", "DEF", "R", "P", "M0", "M1", "M2", "M17", "M30", "RET", "SETAL")),
)  # fmt: skip
CODES = {
    "M60": "beam_on", "M61": "beam_off", "M62": "wire_start", "M63": "wire_stop",
    "H1": "voltage_kv", "H2": "current_ma", "H3": "wire_mm_s", "H4": "wire_retract_mm",
}  # fmt: skip
# The path is driven as it is written: blocks are not joined by a compressor, and rapids go straight.
AS_WRITTEN = ("COMPOF", "RTLION")
# Exact stop, and rounding within the tolerances of the axes, which CTOL sets. G641 goes by ADIS, G644 by the dynamics of the axes, and
# G64 by neither.
KEEPS_TOLERANCE = ("G60", "G642", "G643", "G645")


def words(machine: MachineSettings) -> tuple[str, ...]:
    """Words that hold at every motion."""
    offsets_off = ("G40", "D0", "TRAFOOF", "TRANS")
    return (
        "G17", machine.length_unit, "G90", "G94", *offsets_off, machine.work_offset, *AS_WRITTEN, *machine.smoothing
    )  # fmt: skip


def form_lines(machine: MachineSettings) -> dict[str, str]:
    """Lines of the header on curves and smoothing."""
    values = {
        "CURVES": machine.curve_form,
        "POLY": "PL=1 in every block, coefficients over 0 .. 1",
        "SMOOTHING": f"{' '.join(machine.smoothing)}, path may leave the program by "
        f"{machine.smoothing_tolerance_mm:g} mm",
    }
    if machine.curve_form in ("arcs", "lines"):
        values["CURVES"] += f", within {machine.line_tolerance_mm:g} mm"
    elif machine.curve_form == "bspline" and machine.bspline_shift == "uniform":
        values["BSPLINE CONVENTION"] = "uniform, no PL, U clamped with even intervals, other splines as POLY"
    elif machine.curve_form == "bspline":
        s = machine.bspline_shift
        values["BSPLINE CONVENTION"] = f"s={s}, block i carries PL = U(i+{s}) - U(i+{int(s) - 1}), U clamped"
        values["BSPLINE NOTE"] = (
            "PL=0 in the end blocks and at repeated knots is outside the range documented for PL, prove on the control"
        )
    return values


# Names that the control takes for its own: programs, cycles, definitions and initialisation files, by ending or by path name.
LOADS = r"_N_.*|.*[._](MPF|SPF|CPF|CYC|DEF|GUD|INI|TEA|SEA|COM|TOA|TMA|RPA|UFR|ARC|WPD|SYF|JOB)"
CONTROL = Control(
    name=NAME,
    loads=LOADS,
    title="SINUMERIK 840D sl",
    writer="ebamcheck.controls.sinumerik.writing:write_program",
    reader="ebamcheck.controls.sinumerik.reading:read_program",
    suffixes=(".MPF", ".SPF"),
    mark=b"%_N",
    subprogram_suffix=".SPF",
    codes=CODES,
    dwell_address="F",
    groups=GROUPS,
    words=words,
    form_lines=form_lines,
    tolerance_word=" CTOL=",
    keeps_tolerance=KEEPS_TOLERANCE,
    frames=True,
    file_faults="ebamcheck.controls.sinumerik.reading:file_faults",
    waiting="ebamcheck.controls.sinumerik.waiting:waiting_program",
    handshake="ebamcheck.controls.sinumerik.handshake:handshake_check",
)
