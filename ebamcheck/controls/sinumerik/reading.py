"""Reader of SINUMERIK programs: POLY, BSPLINE, G0 to G3, subprograms."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np

from ebamcheck.controls.sinumerik.control import NAME
from ebamcheck.controls.sinumerik.spline_blocks import spline_spans
from ebamcheck.controls.sinumerik.words import (
    AXES,
    END_CODES,
    read_block,
    split_comment,
)
from ebamcheck.nc.arcs import arc
from ebamcheck.nc.files import layer_of_preheat
from ebamcheck.nc.motions import ARC, POLYNOMIAL, RAPID, SPLINE_SPAN, STRAIGHT, NCProgram
from ebamcheck.nc.recognition import StateChange, Templates
from ebamcheck.nc.recorder import LINE_OF_T, NAN, NO_CENTRE, Recorder
from ebamcheck.nc.table import NONE, frame_after, on_part
from ebamcheck.nc.template_rules import checked_templates
from ebamcheck.nc.timeline import AXIS_EVENT
from ebamcheck.nc.words import (
    NUMBER,
    SKIP,
    SKIPPED,
    Block,
    UnknownWord,
    WordError,
)
from ebamcheck.settings.config import Config

DEEPEST_CALL = 8
"""Levels of subprograms; deeper ones are taken for a program that calls itself."""

Shift = Literal[2, 3, "uniform"]

_BLOCK_NUMBER = re.compile(r"\s*[N:]\s*(\d+)(?![\d._]|\s*=)\s*", re.IGNORECASE)
"""Of a block, and behind a colon of a main block; what follows may do so without a blank."""
_CALL = re.compile(r"([A-Z_][A-Z0-9_]+)(?:\s+P\s*=?\s*(\d+))?")
"""A subprogram by its name, and how often it is run."""
_MESSAGE = re.compile(r'MSG\s*\(\s*"[^"]*"\s*\)|MSG\s*\(\s*\)')
"""A line for the operator; it changes nothing."""
_HEADER = re.compile(r"%[A-Z0-9_ ]*", re.IGNORECASE)
_KINDS = {"G0": RAPID, "G1": STRAIGHT, "POLY": POLYNOMIAL, "BSPLINE": SPLINE_SPAN, "G2": ARC, "G3": ARC}

_N = rf"({NUMBER})"
_LIST = rf"=\({_N},{_N},{_N}\)"
_PLAIN_BLOCK = re.compile(
    rf"N(\d+) (?:G1 X{_N} Y{_N}(?: F{_N})?( ; [A-Z ]+)?(?P<line>)|POLY PO\[X\]{_LIST} PO\[Y\]{_LIST} PL=1(?P<poly>)"
    rf"|X{_N} Y{_N} PL={_N}(?P<control>)|(G[23]) X{_N} Y{_N} I{_N} J{_N}(?P<arc>)"
    rf"|G0 X{_N} Y{_N}(?P<rapid>)|G0 Z{_N}(?P<lift>))"
)
"""The blocks of which a program mostly consists, in the spelling of most posts; all others are read word by word."""


def read_program(main: Path, config: Config, *, bspline_shift: Shift | None = None) -> NCProgram:
    """Read a program from its main file; subprograms lie beside it."""
    reader = SinumerikReader(main.parent, config, bspline_shift)
    reader.run(main)
    return on_part(reader.out.program(), config)


class SinumerikReader:
    """State of the control while it runs a program from top to bottom."""

    def __init__(self, folder: Path, config: Config, shift: Shift | None) -> None:
        self._rotary = tuple(axis.name for axis in config.machine.rotary)
        self.out = Recorder(folder, NAME, self._rotary, config.preheat.scan_in == "layer")
        self._templates = Templates(checked_templates(config.machine, NAME))
        self._changes: dict[str, StateChange] = {}
        self._shift: Shift = shift or config.machine.bspline_shift
        self._mode = ""
        self._spline: list[tuple[float, float, float, int]] = []
        self._degree = 3

    # -- files and lines ---------------------------------------------------------------------------

    def run(self, path: Path, depth: int = 0) -> None:
        """Run one file to its end."""
        out = self.out
        end_line, end_code = 0, ""
        for number, text in enumerate(out.open(path), start=1):
            out.line = number
            if not end_line and self._run_plain(text):
                continue
            code = self._run_line(text.rstrip("\r"), depth)
            if code and not end_line:
                end_line, end_code = number, code
            elif end_line and code is not None:
                raise out.error(f"a block after the end of the program by {end_code} in line {end_line}", 0)
        self._end_spline()
        out.close(end_line, end_code)

    def _run_plain(self, text: str) -> bool:
        """Run one of the blocks of which a program mostly consists; return whether it is one."""
        found = _PLAIN_BLOCK.fullmatch(text)
        if found is None or self.out.table.fresh:
            return False
        out, part, what = self.out, found.groups(), found.lastgroup
        if what == "control":
            if self._mode != "BSPLINE" or self._shift == "uniform" or not self._spline:
                return False
            x, y = float(part[13]), float(part[14])
            self._spline.append((x, y, float(part[15]), out.line))
            out.x, out.y = x, y
        elif self._spline:
            return False
        elif what == "line":
            self._mode = "G1"
            if part[3] is not None:
                out.feed(float(part[3]))
            out.move(STRAIGHT, float(part[1]), float(part[2]), out.z)
        elif what == "arc":
            return self._run_plain_arc(part[0], part[17], *map(float, part[18:22]))
        elif what == "poly":
            self._mode = "POLY"
            xe, x2, x3, ye, y2, y3 = map(float, part[6:12])
            out.move(POLYNOMIAL, xe, ye, out.z, (x2, x3, y2, y3, 1.0))
        else:
            self._mode = "G0"
            x, y, z = (
                (float(part[23]), float(part[24]), out.z)
                if what == "rapid"
                else (out.x, out.y, float(part[26]))
            )
            out.move(RAPID, x, y, z)
        out.number(part[0])
        return True

    def _run_plain_arc(self, number: str, mode: str, x: float, y: float, i: float, j: float) -> bool:
        """Run G2 or G3; one that is no arc is left to be refused with its place."""
        out = self.out
        try:
            centre = arc((out.x, out.y), (x, y), {"I": i, "J": j}, counter_clockwise=mode == "G3")
        except ValueError:
            return False
        self._mode = mode
        out.move(ARC, x, y, out.z, centre=centre)
        out.number(number)
        return True

    def _run_line(self, text: str, depth: int) -> str | None:
        """Run one line; its end code, an empty string for another block, None where there is no block."""
        code, comment = split_comment(text)
        if comment:
            self._note(comment.strip(), code)
        if not code.strip() or (self.out.line == 1 and _HEADER.fullmatch(code)):
            return None
        skip = SKIP.match(code)
        column = skip.end() if skip else 0
        number = _BLOCK_NUMBER.match(code, column)
        if number:
            self.out.number(number[1])
            column = number.end()
        code = code[column:].rstrip().upper()
        if skip and code and not _MESSAGE.fullmatch(code):
            self.out.event(SKIPPED)
        try:
            return self._run_block(code, depth) if code else ""
        except WordError as error:
            raise self.out.error(error.what, column + error.column) from None

    def _note(self, comment: str, code: str) -> None:
        """Read what a comment says in the header; what one says of motions counts for nothing."""
        if not code.strip() and self.out.file == 0 and not self.out.started:
            self.out.read_header(comment)

    # -- blocks ------------------------------------------------------------------------------------

    def _run_block(self, code: str, depth: int) -> str:
        if (change := self._changes.get(code)) is not None:
            self._end_spline()
            self.out.change(change)
            return ""
        if _MESSAGE.fullmatch(code):
            self._end_spline()
            return ""
        if self._rotary and (frame := frame_after(code, self.out.table.frame)) is not None:
            self._end_spline()
            self.out.event("frame")
            self.out.set_frame(frame)
            return ""
        try:
            block = read_block(code, self._rotary)
        except UnknownWord:
            change = self._templates.find(code)
            if change is not None:
                # The same text is one of a template wherever it stands: it need not be split into words again.
                self._changes[code] = change
                self._end_spline()
                self.out.change(change)
            elif not self._call(code, depth):
                raise
            return ""
        end = ""
        for word in block.codes:
            if word in END_CODES:
                end = word
            elif word in _KINDS:
                self._motion_word(word)
            elif word == "TRANS" and self.out.table.frame is not NONE:
                self.out.event("frame taken back")
                self.out.set_frame(NONE)
            else:
                self.out.event(word)
        if block.values or block.lists:
            self._run_values(block)
        if end:
            self._end_spline()
            self.out.event(end)
        return end

    def _run_values(self, block: Block) -> None:
        values = block.values
        if "F" in values:
            self.out.feed(values["F"])
        for name in ("CTOL", "ADIS"):
            if name in values:
                self.out.event(name, values[name])
        if values.get("PW", 1.0) != 1.0:
            raise WordError("only splines with PW=1 are read: others are no polynomials", 0)
        if values.get("SD", 3.0) not in (2.0, 3.0):
            raise WordError(f"SD={values['SD']:g}: a BSPLINE has degree 2 or 3", 0)
        if "BSPLINE" in block.codes:
            self._degree = int(values.get("SD", 3.0))
        elif "SD" in values:
            raise WordError("SD belongs to the block with BSPLINE", 0)
        if any(axis in values for axis in self._rotary):
            self._end_spline()
            for axis in self._rotary:
                if axis in values:
                    self.out.event(f"{AXIS_EVENT}{axis}", values[axis])
            self.out.table.turn(values)
        if block.lists or any(axis in values for axis in (*AXES, *self._rotary)):
            self._move(block)
        elif "I" in values or "J" in values or "CR" in values or "PL" in values:
            raise WordError("a block without an axis has nothing to use I, J, CR or PL for", 0)

    def _call(self, code: str, depth: int) -> bool:
        """Run a subprogram, if the block is the name of one."""
        out = self.out
        found = _CALL.fullmatch(code.strip())
        name = found[1] if found else ""
        path = out.folder / f"{name}.SPF"
        if not found or not path.is_file():
            return False
        if found[2] is not None and found[2].lstrip("0") != "1":
            raise WordError(f"{name} P{found[2]}: a subprogram is run once", 0)
        if depth == DEEPEST_CALL:
            raise WordError(f"{name} is called over {DEEPEST_CALL} levels deep", 0)
        self._end_spline()
        out.event(f"call {name}")
        if depth == 0 and layer_of_preheat(out.main_stem, name) is None:
            out.layer(len(out.layer_files))
            out.layer_files.append(path.name)
        file, line = out.file, out.line
        self.run(path, depth + 1)
        out.enter(file, line)
        if depth == 0:
            out.layer(-1)
        return True

    # -- motions -----------------------------------------------------------------------------------

    def _move(self, block: Block) -> None:
        mode, out = self._mode, self.out
        if not mode:
            raise WordError("an axis before any of G0, G1, G2, G3, POLY, BSPLINE", 0)
        values, lists = block.values, block.lists
        if out.table.fresh and not (named := self._axes(block)) >= set(AXES):
            out.event("frame lacks " + " ".join(axis for axis in AXES if axis not in named))
        out.table.fresh = out.table.fresh and not self._axes(block)
        if lists and mode != "POLY":
            raise WordError(f"PO[] under {mode}: it belongs to POLY", 0)
        here = {"X": out.x, "Y": out.y, "Z": out.z}
        x, y, z = (
            lists[f"PO[{axis}]"][0] if f"PO[{axis}]" in lists else values.get(axis, here[axis])
            for axis in AXES
        )
        if mode == "BSPLINE":
            self._control_point(x, y, z, values)
            return
        curve, centre = LINE_OF_T, NO_CENTRE
        if mode == "POLY":
            curve = self._polynomial(block)
        elif "PL" in values:
            raise WordError(f"PL under {mode}: it belongs to POLY and BSPLINE", 0)
        if mode in ("G2", "G3"):
            try:
                centre = arc((out.x, out.y), (x, y), values, counter_clockwise=mode == "G3")
            except ValueError as error:
                raise WordError(str(error), 0) from None
        elif "I" in values or "J" in values or "CR" in values:
            raise WordError(f"I, J or CR under {mode}: they belong to G2 and G3", 0)
        out.move(_KINDS[mode], x, y, z, curve, centre)

    @staticmethod
    def _axes(block: Block) -> set[str]:
        """Geometry axes that a block names."""
        return {axis for axis in AXES if axis in block.values or f"PO[{axis}]" in block.lists}

    def _polynomial(self, block: Block) -> tuple[float, float, float, float, float]:
        """Coefficients of t^2 and t^3 in X and Y, and the length of the parameter."""
        length = block.values.get("PL", 1.0)
        if length != 1.0:
            self.out.event("POLY", length)
        if not 0.0001 <= length <= 99999.9999:
            raise WordError(f"PL={length:g} under POLY: it reaches from 0.0001 to 99999.9999", 0)
        if len(block.lists.get("PO[Z]", ())) > 1:
            raise WordError("PO[Z] with coefficients: layers are flat", 0)
        x, y = ((*block.lists.get(f"PO[{axis}]", ()), 0.0, 0.0, 0.0) for axis in "XY")
        return x[1], x[2], y[1], y[2], length

    # -- splines -----------------------------------------------------------------------------------

    def _motion_word(self, word: str) -> None:
        """Change the kind of motion; BSPLINE begins a spline at the position before."""
        if word == self._mode == "BSPLINE":
            raise WordError("BSPLINE where it is in force: the control goes on with the spline before", 0)
        self._end_spline()
        self._mode = word
        if word == "BSPLINE":
            self._spline = [(self.out.x, self.out.y, 0.0, self.out.line)]

    def _control_point(self, x: float, y: float, z: float, values: dict[str, float]) -> None:
        if self._shift == "uniform" and "PL" in values:
            raise WordError("PL in a BSPLINE of a program whose control chooses the knots itself", 0)
        if self._shift != "uniform" and "PL" not in values:
            raise WordError("a BSPLINE block without PL: the control would choose the knots itself", 0)
        if z != self.out.z:
            raise WordError("Z changes along a BSPLINE: layers are flat", 0)
        if not self._spline:
            what = "a control point after a block that is none of its spline: G1 and BSPLINE begin another"
            raise WordError(what, 0)
        self._spline.append((x, y, values.get("PL", NAN), self.out.line))
        self.out.x, self.out.y = x, y

    def _end_spline(self) -> None:
        """Turn the control points gathered into one motion for each knot span."""
        points, self._spline = self._spline, []
        if len(points) < 2:
            return
        out = self.out
        here, lines = out.line, [point[3] for point in points]
        out.line = lines[1]
        try:
            index, ends, curves = spline_spans(np.array([p[:3] for p in points]), self._shift, self._degree)
        except ValueError as error:
            raise out.error(str(error), 0) from None
        out.event("BSPLINE", float(len(points) - 1))
        for i, (x, y), (x2, x3, y2, y3) in zip(index.tolist(), ends.tolist(), curves.tolist(), strict=True):
            out.move(SPLINE_SPAN, x, y, out.z, (x2, x3, y2, y3, 1.0), line=lines[i])
        out.line = here
