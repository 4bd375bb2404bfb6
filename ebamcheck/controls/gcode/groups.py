"""Modal groups of LinuxCNC and of controls of its kind. Source: LinuxCNC G-code reference, modal groups."""

from __future__ import annotations

from ebamcheck.nc.control import Group
from ebamcheck.nc.modal_groups import offsets

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
