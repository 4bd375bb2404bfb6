"""Reader of LinuxCNC programs and of plain G-code: one file, G0 to G3, and G5 for LinuxCNC."""

from __future__ import annotations

import re
from pathlib import Path

from ebamcheck.controls.gcode import linuxcnc, plain
from ebamcheck.controls.gcode.words import (
    ENDS,
    MODES,
    MOTIONS,
    read_gcode_block,
    without_comments,
)
from ebamcheck.nc.arcs import arc
from ebamcheck.nc.motions import ARC, POLYNOMIAL, RAPID, STRAIGHT, NCProgram
from ebamcheck.nc.recognition import Templates
from ebamcheck.nc.recorder import Recorder
from ebamcheck.nc.template_rules import checked_templates
from ebamcheck.nc.words import (
    NUMBER,
    SKIP,
    SKIPPED,
    Block,
    UnknownWord,
    WordError,
)
from ebamcheck.settings.config import Config

_BLOCK_NUMBER = re.compile(r"\s*N(\d+)(?![\d.])\s*", re.IGNORECASE)
_KINDS = {"G0": RAPID, "G1": STRAIGHT, "G2": ARC, "G3": ARC}

_N = rf"({NUMBER})"
_PLAIN_BLOCK = re.compile(
    rf"G1 X{_N} Y{_N}(?: ; [A-Z ]+)?(?P<line>)|G5 I{_N} J{_N} P{_N} Q{_N} X{_N} Y{_N}(?P<cubic>)"
    rf"|(G[23]) X{_N} Y{_N} I{_N} J{_N}(?P<arc>)"
)
"""The blocks of which a program mostly consists; all others are read word by word."""


def read_linuxcnc(main: Path, config: Config, **unused: object) -> NCProgram:
    """Read a program of LinuxCNC, which has no BSPLINE whose knots could be told."""
    return _read(main, config, linuxcnc.NAME)


def read_plain_gcode(main: Path, config: Config, **unused: object) -> NCProgram:
    """Read a program of plain G-code."""
    return _read(main, config, plain.NAME)


def _read(main: Path, config: Config, control: str) -> NCProgram:
    reader = GcodeReader(main.parent, config, control)
    reader.run(main)
    return reader.out.program()


class GcodeReader:
    """State of the control while it runs a program from top to bottom."""

    known: frozenset[str] = MOTIONS | MODES | ENDS
    """G and M words that are read, beside G5 of LinuxCNC."""

    def __init__(self, folder: Path, config: Config, dialect: str) -> None:
        self.out = Recorder(folder, dialect)
        self._templates = Templates(checked_templates(config.machine, dialect))
        self._cubics = dialect == linuxcnc.NAME
        self._codes = self.known | ({"G5"} if self._cubics else frozenset())
        self._mode = ""
        self._tangent: tuple[float, float] | None = None
        self._begun = False

    def run(self, path: Path) -> None:
        """Run a file to its end."""
        out = self.out
        end_line, end_code = 0, ""
        for number, text in enumerate(out.open(path), start=1):
            out.line = number
            if not end_line and self._run_plain(text):
                continue
            try:
                code = self._run_line(text.rstrip("\r"))
            except WordError as error:
                raise out.error(error.what, error.column) from None
            if code and not end_line:
                end_line, end_code = number, code
            elif end_line and code not in (None, "%"):
                out.line = end_line if end_code == "%" else number
                raise out.error(f"a block after the end of the program by {end_code} in line {end_line}", 0)
        out.close(end_line, end_code)

    def _run_plain(self, text: str) -> bool:
        """Run one of the blocks of which a program mostly consists; return whether it is one."""
        found = _PLAIN_BLOCK.fullmatch(text)
        if found is None:
            return False
        part = found.groups()
        if found.lastgroup == "line":
            self._mode, self._tangent = "G1", None
            self.out.move(STRAIGHT, float(part[0]), float(part[1]), self.out.z)
        elif found.lastgroup == "arc":
            return self._run_plain_arc(part[10], *map(float, part[11:15]))
        elif self._cubics:
            self._mode = "G5"
            i, j, p, q, x, y = map(float, part[3:9])
            self._bezier(i, j, p, q, x, y)
        else:
            return False
        return True

    def _run_plain_arc(self, mode: str, x: float, y: float, i: float, j: float) -> bool:
        """Run G2 or G3; one that is no arc is left to be refused with its place."""
        out = self.out
        try:
            centre = arc((out.x, out.y), (x, y), {"I": i, "J": j}, counter_clockwise=mode == "G3")
        except ValueError:
            return False
        self._mode, self._tangent = mode, None
        out.move(ARC, x, y, out.z, centre=centre)
        return True

    def _run_line(self, text: str) -> str | None:
        """Run one line; its end code, an empty string for another block, None where there is no block."""
        code, comments = without_comments(text)
        if not code.strip() and not self.out.started:
            for comment in comments:
                self.out.read_header(comment)
        if not code.strip():
            return None
        if code.strip() == "%":
            return self._run_percent()
        self._begun = True
        skip = SKIP.match(code)
        column = skip.end() if skip else 0
        number = _BLOCK_NUMBER.match(code, column)
        if number:
            self.out.number(number[1])
            column = number.end()
        code = code[column:].rstrip().upper()
        if skip and code:
            self.out.event(SKIPPED)
        try:
            return self._run_block(code) if code else ""
        except WordError as error:
            raise WordError(error.what, column + error.column) from None

    def _run_percent(self) -> str | None:
        """A lone ``%`` begins a program before its first block; anywhere else the control stops reading there."""
        if self._begun or self.out.started:
            return "%"
        self._begun = True
        return None

    # -- blocks ------------------------------------------------------------------------------------

    def _run_block(self, code: str) -> str:
        try:
            block = read_gcode_block(code, self._codes, self.out.dialect)
        except UnknownWord:
            change = self._templates.find(code)
            if change is None:
                raise
            self.out.change(change)
            return ""
        end = ""
        for word in block.codes:
            if word in ENDS:
                end = word
            elif word in _KINDS or word == "G5":
                self._mode = word
            elif word == "G80":
                self._mode = ""
                self.out.event(word)
            else:
                self.out.event(word)
        self._run_values(block)
        if end:
            self.out.event(end)
        return end

    def _run_values(self, block: Block) -> None:
        values = block.values
        if "F" in values:
            self.out.feed(values.pop("F"))
        if "G64" in block.codes and "P" in values:
            self.out.event("CTOL", values.pop("P"))
        if any(axis in values for axis in "XYZ"):
            self._move(values)
        elif values:
            raise WordError(f"a block without an axis has nothing to use {', '.join(values)} for", 0)

    def _move(self, values: dict[str, float]) -> None:
        out, mode = self.out, self._mode
        if not mode:
            raise WordError(
                "an axis before any of " + ", ".join((*_KINDS, *(("G5",) if self._cubics else ()))), 0
            )
        if mode == "G5" and "Z" in values and values["Z"] != out.z:
            raise WordError("Z along G5: it moves X and Y alone", 0)
        x, y, z = values.pop("X", out.x), values.pop("Y", out.y), values.pop("Z", out.z)
        if mode == "G5":
            self._cubic(values, x, y)
            return
        self._tangent = None
        if mode in ("G2", "G3"):
            if "R" in values:
                values["CR"] = values.pop("R")
            if not values.keys() <= {"I", "J", "CR"}:
                raise WordError(f"{', '.join(values)} under {mode}: it takes I and J, or R", 0)
            try:
                centre = arc((out.x, out.y), (x, y), values, counter_clockwise=mode == "G3")
            except ValueError as error:
                raise WordError(str(error).replace("CR=", "R"), 0) from None
            out.move(ARC, x, y, z, centre=centre)
        elif values:
            raise WordError(f"{', '.join(values)} under {mode}: it takes axes and F alone", 0)
        else:
            out.move(_KINDS[mode], x, y, z)

    def _cubic(self, values: dict[str, float], x: float, y: float) -> None:
        """G5: I and J may be left out where the motion before is a G5, which goes on tangentially then."""
        if "R" in values or not {"P", "Q"} <= values.keys() or ("I" in values) != ("J" in values):
            raise WordError("G5 takes P and Q, and I and J both or neither", 0)
        if "I" not in values and self._tangent is None:
            raise WordError("G5 without I and J after a motion that is none", 0)
        i, j = (values["I"], values["J"]) if "I" in values else self._tangent or (0.0, 0.0)
        self._bezier(i, j, values["P"], values["Q"], x, y)

    def _bezier(self, i: float, j: float, p: float, q: float, x: float, y: float) -> None:
        out = self.out
        dx, dy = x - out.x, y - out.y
        # Bezier points 0, (i, j), (dx + p, dy + q), (dx, dy) from the start, as powers of t.
        second = 3.0 * (dx + p - 2.0 * i), 3.0 * (dy + q - 2.0 * j)
        third = 3.0 * (i - p) - 2.0 * dx, 3.0 * (j - q) - 2.0 * dy
        out.move(POLYNOMIAL, x, y, out.z, (second[0], third[0], second[1], third[1], 1.0))
        self._tangent = (-p, -q)
