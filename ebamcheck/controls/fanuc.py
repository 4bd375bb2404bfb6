"""Fanuc-like controls: one file with a program number, arcs by I and J, look-ahead off, comments in parentheses.

Places, values, feeds and waits carry a decimal point, without which they may be read in thousandths (parameters 3401, 1403). Beam
and wire are G codes that call custom macros (6050 to 6059). Each axis of a rapid goes at its own speed (1401). Source: Fanuc 30i
B-64484EN."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

from ebamcheck.controls.gcode import control as gcode
from ebamcheck.controls.gcode.reading import PLAIN_GCODE, GcodeReader
from ebamcheck.controls.gcode.writing import one_file
from ebamcheck.nc.control import Control, Group
from ebamcheck.nc.files import ProgramFiles, write_files
from ebamcheck.nc.inputs import CurveColumns, ScanColumns
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.words import WordError
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings
from ebamcheck.writing.layer_text import Post

NAME = "fanuc"
CURRENT, WIRE = "G102 A{current_ma:.4f} ; beam current, mA", "G103 A{wire_mm_s:.4f} ; wire speed, mm/s"
TEMPLATES = {
    "beam_on": ("M60 ; beam on",),
    "beam_off": ("M61 ; beam off",),
    "set_beam": ("G101 A{voltage_kv:.4f} ; accelerating voltage, kV", CURRENT),
    "set_power": (CURRENT,),
    "wire_start": (WIRE, "M62 ; wire on"),
    "set_wire": (WIRE,),
    "wire_stop": ("M63 ; wire off",),
    "wire_retract": ("G104 A{wire_retract_mm:.4f} ; wire drawn back, mm",),
    "layer_pause": ("G4 X{layer_pause_s:.3f} ; wait, s",),
}
CODES = {
    "M60": "beam_on", "M61": "beam_off", "M62": "wire_start", "M63": "wire_stop",
    "G101 A": "voltage_kv", "G102 A": "current_ma", "G103 A": "wire_mm_s", "G104 A": "wire_retract_mm",
}  # fmt: skip
GROUPS = (
    *(group for group in gcode.GROUPS if group.name not in ("path control", "work offset", "axis offset")),
    Group("work offset", ("G53", "G54", "G55", "G56", "G57", "G58", "G59", "G54.1", "G10")),
    Group("local offset", ("G52", "G92", "G92.1")),
    Group("scaling", ("G50", "G51")),
    Group("rotation", ("G68", "G69")),
    Group("exact stop", ("G9", "G61", "G62", "G63", "G64"), path=True),
    Group("look-ahead", ("G5.1", "G8"), path=True),
)
# Takes back what G52, G92, and motions by hand have shifted the work offsets by (preset of the workpiece coordinate system).
SHIFTS_OFF = "G92.1 X0.0 Y0.0 Z0.0"
_PROGRAM_NUMBER = re.compile(r"O\d{4,8}")
# Blocks that take look-ahead and shifts back, and their codes.
_OFF = {"G5.1": r"G0?5\.1\s*Q0(?:\.0*)?", "G92.1": r"G92\.1\s*X0(?:\.0*)?\s*Y0(?:\.0*)?\s*Z0(?:\.0*)?"}
# An address that may have a decimal point, with a number that has none.
_NO_POINT = re.compile(r"[XYZUVWABCIJKRF]\s*[+-]?\d+(?![\d.])")


def words(machine: MachineSettings) -> tuple[str, ...]:
    """Words that hold at every motion."""
    offsets_off = ("G40", "G49", "G80", "G50", "G69")
    return "G17", "G21", "G90", "G94", *offsets_off, machine.work_offset, "G92.1", "G64", "G5.1"


def form_lines(machine: MachineSettings) -> dict[str, str]:
    """Lines of the header on curves and smoothing."""
    smoothing = "G64, look-ahead off, corners are the control's own"
    return gcode.lines_of_curves(machine) | {"SMOOTHING": smoothing}


CONTROL = Control(
    name=NAME,
    title="Fanuc",
    writer="ebamcheck.controls.fanuc:write_program",
    reader="ebamcheck.controls.fanuc:read_program",
    suffixes=(".CNC",),
    templates=TEMPLATES,
    codes=CODES,
    dwell_address="X",
    groups=GROUPS,
    words=words,
    form_lines=form_lines,
    splines="arcs",
    parentheses=True,
    rapids_apart=True,
)


def write_program(
    curves: CurveColumns, plan: ScanColumns, config: Config, folder: str | Path, *, validated: bool = False,
    header: Mapping[str, str] | None = None,
) -> ProgramFiles:  # fmt: skip
    """Write one ``.cnc`` file between percent signs, with arcs or lines for splines.

    The program's number is ``machine.program_name`` where that is one, such as O1234, and O0001 where it is none.
    Takes and raises what :func:`ebamcheck.write_program` does.
    """
    machine = config.machine
    form: Literal["chords", "arcs"] = "chords" if machine.curve_form == "lines" else "arcs"
    modes = ["G17 G21 G90 G94", "G40 G49 G80", "G50 G69", machine.work_offset, SHIFTS_OFF, "G64", "G5.1 Q0"]
    lines = one_file(Post.of(curves, plan, config, CONTROL, form, None), modes, validated, header)
    own = _PROGRAM_NUMBER.fullmatch(machine.program_name)
    first = f"{machine.program_name if own else 'O0001'} ({machine.program_name})"
    texts = ["%", first]
    for code, mark, note in (line.partition(";") for line in lines):
        # The feed gets its decimal point, and what stands behind a semicolon parentheses.
        code = re.sub(r" F(\d+)(?![\d.])", r" F\1.0", code)
        texts.append(f"{code}({CONTROL.comment_text(note.strip())})" if mark else code)
    text = "\n".join([*texts, "M30", "%"]) + "\n"
    return write_files({f"{machine.program_name}.cnc": text}, Path(folder), validated=validated)


_CODES = (PLAIN_GCODE.codes | {"G50", "G69"}) - {"G91.1", "G92.1", "G61"}
DIALECT = replace(PLAIN_GCODE, name=NAME, codes=_CODES)


def read_program(main: Path, config: Config, **unused: object) -> NCProgram:
    """Read a program from its one file."""
    return FanucReader(main.parent, config, DIALECT).program(main)


class FanucReader(GcodeReader):
    """State of a Fanuc-like control while it runs a program from top to bottom."""

    _in_blocks = False

    def run_plain(self, text: str) -> bool:
        """Run a block whose numbers have decimal points."""
        return ";" not in text and _NO_POINT.search(text) is None and super().run_plain(text)

    def run_line(self, text: str) -> str | None:
        """Run one line; a semicolon ends a block here, and what stands behind it would be run."""
        if ";" in text:
            what = "a semicolon ends a block on this control: comments stand in parentheses"
            raise WordError(what, text.index(";"))
        code = self.split(text)[0]
        if small := re.search("[a-z]", code):
            raise WordError(f"{small[0]!r}: this control takes capitals alone", small.start())
        # Anywhere else a number begins another program, and this one is what stands before it.
        number = None if self._in_blocks or self.out.started else _PROGRAM_NUMBER.match(text)
        self._in_blocks = self._in_blocks or code.strip() not in ("", "%")
        return super().run_line(" " * number.end() + text[number.end() :] if number else text)

    def own_block(self, code: str) -> bool:
        """Run the blocks that take look-ahead and shifts back; refuse a number without its decimal point, and a code with one."""
        for bare in (m for m in _NO_POINT.finditer(code) if float(m[0][1:]) != 0.0):
            what = f"{bare[0]} has no decimal point: the control may read it in thousandths (parameter 3401)"
            raise WordError(what, bare.start())
        if pointed := re.search(r"[GM]\s*\d*\.0*(?!\d)", code):
            raise WordError(f"{pointed[0]}: a code has no decimal point here", pointed.start())
        taken_back = [word for word, block in _OFF.items() if re.fullmatch(block, code)]
        for word in taken_back:
            self.out.event(word)
        return bool(taken_back)
