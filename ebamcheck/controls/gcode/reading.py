"""Reader of LinuxCNC programs and of plain G-code: one file, G0 to G3, and G5 for LinuxCNC; comments in parentheses or after
``;``."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from ebamcheck.controls.gcode import control
from ebamcheck.nc.motions import POLYNOMIAL, NCProgram
from ebamcheck.nc.reader import COMMON_MOTIONS, Reader
from ebamcheck.nc.words import NUMBER, Block, Dialect, WordError
from ebamcheck.settings.config import Config

# Comments that LinuxCNC runs, beside those that only show something (interp_convert.cc, `convert_comment`).
_RUN = re.compile(
    r"\s*(?:PY(?:RUN)?|LOG\w*|PROBE\w*|ABORT)\s*,|\s*PYRELOAD|\s*PROBEOPEN|\s*PROBECLOSE|\s*LOGCLOSE",
    re.IGNORECASE,
)
_COMMENT = re.compile(r"\(([^()]*)\)")
PLAIN_GCODE = Dialect(
    name=control.PLAIN_GCODE.name,
    motions=COMMON_MOTIONS,
    # G18 to G20, G90.1, G91, G93 are refused: a program here has none of them.
    codes=frozenset({
        "G17", "G21", "G90", "G91.1", "G94", "G40", "G49", "G80", "G92.1", "G61", "G64",
        "G54", "G55", "G56", "G57", "M1",
    }),
    ends=frozenset({"M2", "M30"}),
    addresses=frozenset("XYZIJRPQF"),
    word=re.compile(rf"\s*(?:(?P<letter>[A-Z])\s*(?P<number>{NUMBER})|(?P<bad>\S.*))"),
    code_number=lambda number: f"{float(number):g}",
)  # fmt: skip
_N = rf"({NUMBER})"
LINUXCNC = replace(
    PLAIN_GCODE,
    name=control.LINUXCNC.name,
    motions={**COMMON_MOTIONS, "G5": POLYNOMIAL},
    curve=rf"G5 I{_N} J{_N} P{_N} Q{_N} X{_N} Y{_N}",
)


def read_linuxcnc(main: Path, config: Config, **unused: object) -> NCProgram:
    """Read a program of LinuxCNC, which has no BSPLINE whose knots could be told."""
    return GcodeReader(main.parent, config, LINUXCNC).program(main)


def read_plain_gcode(main: Path, config: Config, **unused: object) -> NCProgram:
    """Read a program of plain G-code."""
    return GcodeReader(main.parent, config, PLAIN_GCODE).program(main)


class GcodeReader(Reader):
    """State of a control of G-code while it runs a program from top to bottom."""

    _tangent = (-1, 0.0, 0.0)  # Motions up to the last G5, and I and J of a G5 that goes on tangentially

    def split(self, text: str) -> tuple[str, list[str]]:
        """Code of a line, with blanks in place of its comments, and the comments; refused where the control runs one of them."""
        code, mark, tail = text.partition(";")
        comments = [*_COMMENT.findall(code), *([tail] if mark else [])]
        code = _COMMENT.sub(lambda found: " " * len(found[0]), code)
        if half := re.search(r"[()]", code):
            raise WordError("a parenthesis without its other half", half.start())
        for comment in filter(_RUN.match, comments):
            raise WordError(f"the control runs the comment {comment.strip()!r}", 0)
        return code, comments

    def state_word(self, word: str) -> None:
        """G80 ends the motion in force."""
        self.mode = "" if word == "G80" else self.mode
        super().state_word(word)

    def own_values(self, block: Block) -> None:
        """Take the tolerance of G64."""
        if "G64" in block.codes and "P" in block.values:
            self.out.event("CTOL", block.values.pop("P"))

    def own_motion(self, x: float, y: float, z: float, block: Block) -> bool:
        """G5: I and J may be left out where the motion before is a G5, which goes on tangentially then."""
        if self.mode != "G5":
            return False
        values = block.values
        if "Z" in values and values["Z"] != self.out.z:
            raise WordError("Z along G5: it moves X and Y alone", 0)
        if "R" in values or not {"P", "Q"} <= values.keys() or ("I" in values) != ("J" in values):
            raise WordError("G5 takes P and Q, and I and J both or neither", 0)
        motions, i, j = self._tangent
        if "I" not in values and motions != self.out.motions:
            raise WordError("G5 without I and J after a motion that is none", 0)
        self.run_curve(values.get("I", i), values.get("J", j), values["P"], values["Q"], x, y)
        return True

    def run_curve(self, *numbers: float) -> None:
        """Run G5 by I, J, P, Q, X and Y."""
        i, j, p, q, x, y = numbers
        out, self.mode = self.out, "G5"
        dx, dy = x - out.x, y - out.y
        # Bezier points 0, (i, j), (dx + p, dy + q), (dx, dy) from the start, as powers of t.
        second = 3.0 * (dx + p - 2.0 * i), 3.0 * (dy + q - 2.0 * j)
        third = 3.0 * (i - p) - 2.0 * dx, 3.0 * (j - q) - 2.0 * dy
        out.move(POLYNOMIAL, x, y, out.z, (second[0], third[0], second[1], third[1], 1.0))
        self._tangent = (out.motions, -p, -q)
