"""The modal groups of each control, and which of their words hold at every motion of a program.

A group is a set of words of which one is in force at any time. A program here establishes every group in its own
first blocks, and may repeat a word, but changes none: a word of a group other than the one wanted is a fault wherever
it stands. Words that would bend the path as it is read (another plane, other units, distances from the position before)
are refused by the reader.

Sources: Siemens NC Programming manual 12/2019, list of G groups; LinuxCNC G-code reference, modal groups.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ebamcheck.program.language.dialects import LINUXCNC, PLAIN, SINUMERIK
from ebamcheck.settings.machine import MachineSettings


@dataclass(frozen=True)
class Group:
    """A modal group: its name in the field's words, and the words that belong to it."""

    name: str
    words: tuple[str, ...]
    path: bool = False
    """Whether it says how the axes follow the path, and not what the path is: the check `smoothing` is about it."""


def _offsets(first: int, last: int) -> tuple[str, ...]:
    return tuple(f"G{number}" for number in range(first, last + 1))


_SINUMERIK = (
    Group("plane", ("G17", "G18", "G19")),
    Group("units", ("G70", "G71", "G700", "G710")),
    Group("distances", ("G90", "G91")),
    Group("feed", ("G93", "G94", "G95", "G96", "G97", "G931", "G961", "G971", "G942", "G952", "G962", "G972", "G973")),
    Group("radius compensation", ("G40", "G41", "G42")),
    Group("tool offset", ("D0", "D")),
    Group("programmable frame", ("TRANS", "ATRANS", "ROT", "AROT", "RPL", "SCALE", "ASCALE", "MIRROR", "AMIRROR", "ROTS", "AROTS", "CROTS", "MEAFRAME", "TOFRAME", "TOROT", "G58", "G59", "G25", "G26", "G110", "G111", "G112")),
    Group("work offset", ("G500", *_offsets(54, 57), *_offsets(505, 599), "G53", "G153", "SUPA")),
    Group("smoothing", ("G60", "G64", "G641", "G642", "G643", "G644", "G645", "G9", "G601", "G602", "G603"), path=True),
    Group("acceleration", ("BRISK", "SOFT", "DRIVE", "BRISKA", "SOFTA", "DRIVEA"), path=True),
    Group("feed forward", ("FFWON", "FFWOF"), path=True),
    Group("compressor", ("COMPOF", "COMPON", "COMPCURV", "COMPCAD", "COMPSURF", "CYCLE832"), path=True),
    Group("feed profile", ("FNORM", "FLIN", "FCUB", "FPO", "CFC", "CFTCP", "CFIN", "FB", "FGROUP", "FGREF", "FL"), path=True),
    Group("path override", ("OVR", "OVRRAP", "OVRA", "ACC", "ACCLIMA", "VELOLIM", "JERKLIM"), path=True),
    Group("transformation", ("TRAORI", "TRANSMIT", "TRACYL", "TRAANG", "TRAFOOF", "DIAMON", "DIAM90", "KONT", "NORM")),
    Group("spindle", ("M3", "M4", "M5", "M19", "M70", "S", "SPOS", "SPCON")),
    Group("tool", ("T", "M6", "L6")),
    Group("coolant", ("M7", "M8", "M9")),
    Group("other axes", ("POS", "POSA", "POSP", "MOV", "A", "B", "C", "U", "V", "W", "STOPRE", "G74", "G75", "G4", "G33", "G331", "CIP", "CT", "ASPLINE", "CSPLINE", "SYNACT", "WHEN", "WHENEVER", "DO", "ID", "IDS")),
    Group("program flow", ("GOTO", "GOTOF", "GOTOB", "GOTOC", "GOTOS", "IF", "ELSE", "ENDIF", "WHILE", "ENDWHILE", "FOR", "ENDFOR", "LOOP", "ENDLOOP", "REPEAT", "REPEATB", "UNTIL", "CASE", "CALL", "MCALL", "PCALL", "EXTCALL", "DEF", "R", "P", "M0", "M1", "M2", "M17", "M30", "RET", "SETAL")),
)  # fmt: skip

_GCODE = (
    Group("plane", ("G17", "G18", "G19", "G17.1", "G18.1", "G19.1")),
    Group("units", ("G20", "G21")),
    Group("distances", ("G90", "G91")),
    Group("arc distances", ("G90.1", "G91.1")),
    Group("feed", ("G93", "G94", "G95")),
    Group("radius compensation", ("G40", "G41", "G42", "G41.1", "G42.1")),
    Group("tool offset", ("G43", "G43.1", "G43.2", "G49")),
    Group("canned cycle", ("G73", "G76", "G80", "G81", "G82", "G83", "G84", "G85", "G86", "G87", "G88", "G89", "G98", "G99")),
    Group("work offset", ("G53", *_offsets(54, 59), "G59.1", "G59.2", "G59.3", "G10")),
    Group("axis offset", ("G52", "G92", "G92.1", "G92.2", "G92.3")),
    Group("path control", ("G61", "G61.1", "G64"), path=True),
    Group("override", ("M48", "M49", "M50", "M51", "M52", "M53", "M220", "M221"), path=True),
    Group("spindle", ("M3", "M4", "M5", "M19", "S", "G96", "G97")),
    Group("tool", ("T", "M6", "M61")),
    Group("coolant", ("M7", "M8", "M9")),
    Group("other axes", ("A", "B", "C", "U", "V", "W", "G28", "G30", "G33", "G38.2", "G4", "G5.1", "G5.2", "G5.3", "E")),
    Group("program flow", ("M0", "M1", "M2", "M30", "M60", "M98", "M99", "O", "G65", "G66")),
)  # fmt: skip

GROUPS: Mapping[str, tuple[Group, ...]] = {SINUMERIK: _SINUMERIK, LINUXCNC: _GCODE, PLAIN: _GCODE}
"""Modal groups of each control. Words that a control does not know are among those of its group all the same."""


def group_of(dialect: str, word: str) -> Group | None:
    """The group that a word belongs to; None for a word of no group."""
    return _INDEX[dialect].get(word)


_INDEX = {name: {word: group for group in groups for word in group.words} for name, groups in GROUPS.items()}


def wanted_words(dialect: str, machine: MachineSettings) -> dict[str, str]:
    """Word of each group that is to hold at every motion, by the group's name."""
    if dialect == SINUMERIK:
        fixed = (
            "G17",
            machine.length_unit,
            "G90",
            "G94",
            "G40",
            "D0",
            "TRANS",
            machine.work_offset,
            *machine.smoothing,
        )
    elif dialect == LINUXCNC:
        fixed = (
            "G17",
            "G21",
            "G90",
            "G91.1",
            "G94",
            "G40",
            "G49",
            "G80",
            "G92.1",
            machine.work_offset,
            "G64",
        )
    else:
        fixed = ("G17", "G21", "G90", "G94", machine.work_offset)
    found = ((group_of(dialect, word), word) for word in fixed)
    return {group.name if group else word: word for group, word in found}


def refusal(dialect: str, word: str) -> str:
    """What there is to say of a word that is not read: its group, where it has one."""
    letters = word.rstrip("0123456789.+-")
    group = group_of(dialect, word) or group_of(dialect, letters)
    return f"unknown word {word!r}" + (f": {group.name} may not change in a program" if group else "")
