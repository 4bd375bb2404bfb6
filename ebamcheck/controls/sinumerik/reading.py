"""Reader of SINUMERIK programs: POLY, BSPLINE, G0 to G3, frames, subprograms; and the names and first lines of its files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from ebamcheck.controls.sinumerik.control import NAME
from ebamcheck.kernels import Floats, Ints
from ebamcheck.nc.files import layer_of_preheat
from ebamcheck.nc.motions import ARC, POLYNOMIAL, RAPID, SPLINE_SPAN, STRAIGHT, NCProgram
from ebamcheck.nc.reader import ARCS, AXES, Reader
from ebamcheck.nc.recorder import NAN
from ebamcheck.nc.table import NONE, frame_after, on_part
from ebamcheck.nc.timeline import AXIS_EVENT
from ebamcheck.nc.words import NUMBER, Block, Dialect, WordError
from ebamcheck.settings.config import Config

DEEPEST_CALL = 8  # Levels of subprograms; deeper ones are taken for a program that calls itself
Shift = Literal[2, 3, "uniform"]
_CODE = re.compile(r'[^;"]*(?:"[^"]*"[^;"]*)*')
# A subprogram by its name, and how often it is run.
_CALL = re.compile(r"([A-Z_][A-Z0-9_]+)(?:\s+P\s*=?\s*(\d+))?")
_N = rf"({NUMBER})"
_LIST = rf"=\({_N},{_N},{_N}\)"
# A control point of a spline, in the spelling of most posts.
_POINT = re.compile(rf"(?:N(\d+) )?X{_N} Y{_N} PL={_N}")
DIALECT = Dialect(
    name=NAME,
    motions={"G0": RAPID, "G1": STRAIGHT, "G2": ARC, "G3": ARC, "POLY": POLYNOMIAL, "BSPLINE": SPLINE_SPAN},
    # Those that would bend the path (G18, G70, G91, G95 and others) are refused: a program has none.
    codes=frozenset({
        "G17", "G71", "G710", "G90", "G94", "G40", "D0", "TRAFOOF", "TRANS", "G54", "G55", "G56", "G57",
        "COMPOF", "RTLION", "SOFT", "BRISK", "FFWON", "FFWOF", "G60", "G64", "G641", "G642", "G643", "G644", "G645", "M1",
    }),
    ends=frozenset({"M30", "M17", "RET", "M2"}),
    addresses=frozenset({*AXES, "F", "I", "J", "CR", "PL", "PW", "SD", "CTOL", "ADIS"}),
    word=re.compile(
        rf"""\s*(?:
          (?P<list_address>PO\[[XYZ]\])\s*=\s*\((?P<list>[^()]*)\)   # PO[X]=(1,2,3)
        | (?P<letter>[A-Z])(?P<number>{NUMBER})(?![\d.]|\s*=)         # G1  X12.5, with blanks between them or without
        | (?P<name>[A-Z][A-Z0-9_]*)\s*=\s*(?P<value>{NUMBER})        # PL=1  CTOL=0.05  X=10
        | (?P<identifier>[A-Z_][A-Z0-9_]*)                           # BSPLINE  SOFT  MAIN_L0001
        | (?P<bad>\S.*)
        )""",
        re.VERBOSE,
    ),
    code_letters="GMD",
    # Behind a colon stands that of a main block; what follows may do so without a blank.
    block_number=re.compile(r"\s*[N:]\s*(\d+)(?![\d._]|\s*=)\s*", re.IGNORECASE),
    radius="CR=",
    curve=rf"POLY PO\[X\]{_LIST} PO\[Y\]{_LIST} PL=1",
    message=re.compile(r'MSG\s*\(\s*"[^"]*"\s*\)|MSG\s*\(\s*\)'),
    alone={
        "TRANS": "by itself it takes back every frame, else it sets one",
        "TRAFOOF": "it takes the work offset with it, and stands in a block of its own before that",
    },
    unused="I, J, CR or PL",
)  # fmt: skip


def read_program(main: Path, config: Config, *, bspline_shift: Shift | None = None) -> NCProgram:
    """Read a program from its main file; subprograms lie beside it."""
    reader = SinumerikReader(main.parent, config, bspline_shift or config.machine.bspline_shift)
    return on_part(reader.program(main), config)


class SinumerikReader(Reader):
    """State of the control while it runs a program from top to bottom."""

    def __init__(self, folder: Path, config: Config, shift: Shift) -> None:
        super().__init__(folder, config, DIALECT)
        self._shift = shift
        self._spline: list[tuple[float, float, float, int]] = []
        self._degree = 3
        self._depth = 0

    def split(self, text: str) -> tuple[str, list[str]]:
        """Code and comment of a line, from the first semicolon in no message; a quotation mark without its other half stays in the
        code."""
        end = _CODE.match(text).end()  # type: ignore[union-attr]
        return (text, []) if text[end : end + 1] == '"' else (text[:end], [text[end + 1 :]])

    def percent(self, code: str) -> str | None:
        """The first line of a file names it; elsewhere a percent sign begins no block."""
        return None if self.out.line == 1 and re.fullmatch(r"(?i)%[A-Z0-9_ ]*", code) else ""

    def run_plain(self, text: str) -> bool:
        """Run a control point, or another of the blocks of which a program mostly consists; return whether it is one."""
        if not self._spline:
            return super().run_plain(text)
        found, out = _POINT.fullmatch(text), self.out
        if found is None or self._shift == "uniform" or out.table.fresh:
            return False
        number, x, y, interval = found.groups()
        out.x, out.y = float(x), float(y)
        self._spline.append((out.x, out.y, float(interval), out.line))
        if number is not None:
            out.number(number)
        return True

    def own_block(self, code: str) -> bool:
        """Put a frame in force."""
        if not self.rotary or (frame := frame_after(code, self.out.table.frame)) is None:
            return False
        self.settle()
        self.out.event("frame")
        self.out.set_frame(frame)
        return True

    def state_word(self, word: str) -> None:
        """TRANS takes the frame in force back."""
        if word == "TRANS" and self.out.table.frame is not NONE:
            self.out.event("frame taken back")
            self.out.set_frame(NONE)
        else:
            self.out.event(word)

    def own_values(self, block: Block) -> None:
        """Take the tolerances, degree and weight of a spline, and the rotary axes."""
        values = block.values
        for name in ("CTOL", "ADIS"):
            if name in values:
                self.out.event(name, values.pop(name))
        if values.pop("PW", 1.0) != 1.0:
            raise WordError("only splines with PW=1 are read: others are no polynomials", 0)
        degree = values.pop("SD", None)
        if degree not in (None, 2.0, 3.0):
            raise WordError(f"SD={degree:g}: a BSPLINE has degree 2 or 3", 0)
        if "BSPLINE" in block.codes:
            self._degree = int(degree or 3.0)
        elif degree is not None:
            raise WordError("SD belongs to the block with BSPLINE", 0)
        turned = {axis: values.pop(axis) for axis in self.rotary if axis in values}
        if turned:
            self.settle()
            for axis, position in turned.items():
                self.out.event(f"{AXIS_EVENT}{axis}", position)
            self.out.table.turn(turned)

    def call(self, code: str) -> bool:
        """Run a subprogram, if the block is the name of one."""
        out, depth = self.out, self._depth
        found = _CALL.fullmatch(code.strip())
        name = found[1] if found else ""
        path = out.folder / f"{name}.SPF"
        if not found or not path.is_file():
            return False
        if found[2] is not None and found[2].lstrip("0") != "1":
            raise WordError(f"{name} P{found[2]}: a subprogram is run once", 0)
        if depth == DEEPEST_CALL:
            raise WordError(f"{name} is called over {DEEPEST_CALL} levels deep", 0)
        self.settle()
        out.event(f"call {name}")
        if depth == 0 and layer_of_preheat(out.main_stem, name) is None:
            out.layer(len(out.layer_files))
            out.layer_files.append(path.name)
        file, line = out.file, out.line
        self._depth += 1
        self.run(path)
        self._depth = depth
        out.enter(file, line)
        if depth == 0:
            out.layer(-1)
        return True

    def _move(self, block: Block) -> None:
        out, mode = self.out, self.mode
        named = {axis for axis in AXES if axis in block.values or f"PO[{axis}]" in block.lists}
        if mode and out.table.fresh:
            if len(named) < len(AXES):
                out.event("frame lacks " + " ".join(axis for axis in AXES if axis not in named))
            out.table.fresh = not named
        if block.lists and mode not in ("", "POLY"):
            raise WordError(f"PO[] under {mode}: it belongs to POLY", 0)
        super()._move(block)

    def own_motion(self, x: float, y: float, z: float, block: Block) -> bool:
        """Run POLY, or take a control point of BSPLINE."""
        if self.mode == "BSPLINE":
            self._control_point(x, y, z, block.values)
            return True
        if self.mode != "POLY":
            return False
        length = block.values.get("PL", 1.0)
        if length != 1.0:
            self.out.event("POLY", length)
        if not 0.0001 <= length <= 99999.9999:
            raise WordError(f"PL={length:g} under POLY: it reaches from 0.0001 to 99999.9999", 0)
        if len(block.lists.get("PO[Z]", ())) > 1:
            raise WordError("PO[Z] with coefficients: layers are flat", 0)
        # Coefficients of t^2 and t^3 in X and Y.
        (_, x2, x3, *_), (_, y2, y3, *_) = ((*block.lists.get(f"PO[{axis}]", ()), 0.0, 0.0, 0.0) for axis in "XY")
        if what := self.stray(block.values):
            raise WordError(what, 0)
        self.out.move(POLYNOMIAL, x, y, z, (x2, x3, y2, y3, length))
        return True

    def run_curve(self, *numbers: float) -> None:
        """Run POLY by its lists."""
        x, x2, x3, y, y2, y3 = numbers
        self.mode = "POLY"
        self.out.move(POLYNOMIAL, x, y, self.out.z, (x2, x3, y2, y3, 1.0))

    def stray(self, values: Mapping[str, float]) -> str:
        """What is wrong with the addresses of a motion beside its axes; empty if nothing."""
        mode = self.mode
        if "PL" in values and mode != "POLY":
            return f"PL under {mode}: it belongs to POLY and BSPLINE"
        if mode not in ARCS and ("I" in values or "J" in values or "CR" in values):
            return f"I, J or CR under {mode}: they belong to G2 and G3"
        return ""

    def motion_word(self, word: str) -> None:
        """Change the kind of motion; BSPLINE begins a spline at the position before."""
        if word == self.mode == "BSPLINE":
            raise WordError("BSPLINE where it is in force: the control goes on with the spline before", 0)
        super().motion_word(word)
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

    def settle(self) -> None:
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


# A name that is none of a device, and a path.
_FILE_NAME = re.compile(r"(?!(?:CON|PRN|AUX|NUL|COM\d|LPT\d)\.)(?=.{1,24}\.)(?:[A-Z]{2}|_[A-Z])[A-Z0-9_]*\.(?:MPF|SPF)")
_PATH = re.compile(rb";\$PATH=/_N_(?:WKS_DIR/_N_[A-Z0-9_]+_WPD|MPF_DIR|SPF_DIR)\r?")


def file_faults(nc: NCProgram, config: Config) -> list[tuple[str, str]]:
    """Places and texts of what is wrong with names, first lines and paths of the files."""
    profile = f";$PATH=/_N_WKS_DIR/_N_{config.machine.workpiece_directory}_WPD"
    faults = []
    for file in nc.files:
        if not _FILE_NAME.fullmatch(file.name):
            faults.append((f"{file.name}:1", f"{file.name!r} is not a legal name of a program"))
        first, second, *_ = [*file.data.split(b"\n", 2), b"", b""]
        wanted = f"%_N_{file.name.replace('.', '_')}"
        if first.rstrip(b"\r") != wanted.encode("latin-1", "replace"):
            faults.append((f"{file.name}:1", f"first line is not {wanted}"))
        if not _PATH.fullmatch(second):
            faults.append((f"{file.name}:2", "second line is not ;$PATH=/_N_WKS_DIR/_N_..._WPD"))
        said = second.rstrip(b"\r").decode("latin-1")
        if said.startswith(";$PATH=") and said != profile:
            faults.append((f"{file.name}:2", f"says {said}, the profile {profile}"))
    return faults


CUBIC = 3


def knot_vector(intervals: Floats, shift: Literal[2, 3], degree: int = CUBIC) -> Floats:
    """Knots (m + degree + 2,) of a spline of m + 1 control points from the m intervals PL of its blocks.

    Block i = 1 .. m of a cubic carries ``PL = U[i + shift] - U[i + shift - 1]``; one of degree 2 has a knot less before its first
    interval. Unless the outer degree + 1 coincide at both ends, the program means the other convention, and is refused with a
    ValueError."""
    m = intervals.size
    if (intervals < 0.0).any():
        raise ValueError(f"PL={intervals.min():g} in a BSPLINE: intervals cannot be negative")
    before = shift - CUBIC + degree
    inner = np.concatenate([[0.0], np.cumsum(intervals)])
    knots = np.concatenate([np.zeros(before), inner, np.full(degree + 1 - before, inner[-1])])
    if knots[degree] != 0.0 or knots[m + 1] != knots[-1]:
        zeros = "first and last interval are" if shift == 2 else "last two intervals are"
        if degree < CUBIC:
            zeros = "first interval is" if shift == 2 else "last interval is"
        raise ValueError(f"BSPLINE read by the convention s={shift}: the {zeros} 0 there, but not here")
    if knots[-1] == 0.0:
        raise ValueError("a BSPLINE whose intervals PL are all 0 has no length")
    return knots


def spline_spans(blocks: Floats, shift: Literal[2, 3, "uniform"], degree: int = CUBIC) -> tuple[Ints, Floats, Floats]:
    """Split a spline of degree 2 or 3 into its knot spans, each over 0 <= t <= 1.

    `blocks` (m + 1, 3) are X, Y and PL of the control points; PL of the first, the position before, is not used. Returns the block
    (S,) whose control point is the last to shape the span, its end (S, 2), mm, and the coefficients (S, 4) of t^2 and t^3 in X,
    then in Y."""
    m = len(blocks) - 1
    if m < degree:
        name = "cubic" if degree == CUBIC else "quadratic"
        raise ValueError(f"a BSPLINE of {m} blocks: a {name} needs at least {degree} after its first point")
    if shift == "uniform":
        # Clamped, with intervals of 1.
        knots = np.clip(np.arange(m + degree + 2.0) - degree, 0.0, m + 1.0 - degree)
    else:
        knots = knot_vector(blocks[1:, 2], shift, degree)
    from scipy.interpolate import BSpline  # half of the time that this package takes to import

    spline = BSpline(knots, blocks[:, :2], degree)
    index = degree + np.flatnonzero(np.diff(knots[degree : m + 2]) > 0.0)
    begin, h = knots[index], (knots[index + 1] - knots[index])[:, None]
    end = np.asarray(spline(knots[index + 1]), dtype=np.float64)
    end[-1] = blocks[-1, :2]
    # Taylor's series at the start of each span; the third derivative is that of the span to the right.
    curve = np.stack([spline(begin, 2) * h**2 / 2.0, spline(begin, 3) * h**3 / 6.0], axis=2)
    return index.astype(np.int64), end, curve.reshape(-1, 4)
