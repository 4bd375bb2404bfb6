"""Independent reader of NC programs: text in, motions out. It shares no code with the post-processors.

It knows the language that a validated program may use, and refuses every other word with its line and
column: a word that is skipped is a path that is not checked.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ebamcheck.config import Config
from ebamcheck.errors import InputError
from ebamcheck.program.arcs import arc
from ebamcheck.program.motions import (
    ARC,
    POLYNOMIAL,
    RAPID,
    SPLINE_SPAN,
    STRAIGHT,
    Events,
    NCProgram,
    SourceFile,
)
from ebamcheck.program.recognition import StateChange, Templates
from ebamcheck.program.spline_blocks import spline_spans
from ebamcheck.program.words import AXES, END_CODES, Block, UnknownWord, WordError, read_block
from ebamcheck.rings import Bools, Floats, Ints

DEEPEST_CALL = 8
"""Levels of subprograms; deeper ones are taken for a program that calls itself."""

_NUMBER = re.compile(r"\s*N(\d+)(?!\w)\s*", re.IGNORECASE)
_HEADER = re.compile(r"%[A-Z0-9_ ]*", re.IGNORECASE)
_ROLE = re.compile(r"\s*(RING|ISLAND)\s*:?\s*(\d+)\s*")
_KEY = re.compile(r"\s*([^:]+):\s*(.*?)\s*")
_CONVENTION = re.compile(r"BSPLINE.*\bs\s*=\s*([23])\b", re.IGNORECASE)
_KINDS = {"G0": RAPID, "G1": STRAIGHT, "POLY": POLYNOMIAL, "BSPLINE": SPLINE_SPAN, "G2": ARC, "G3": ARC}


def read_program(
    path: str | Path, config: Config | None = None, *, bspline_shift: int | None = None
) -> NCProgram:
    """Read a program from its main file, or from the folder that holds it and its subprograms.

    Parameters
    ----------
    path
        ``.MPF`` (or ``.SPF``) file, or a folder with exactly one ``.MPF``.
    config
        Its machine section holds the beam and wire templates; None: the default profile.
    bspline_shift
        Which knot interval a BSPLINE block's PL carries (2 or 3); None: as the header of the program
        states, else as the machine profile does.

    Raises
    ------
    InputError
        ``FILE:line:column: ...`` for a word or block that is not understood; also where a file is missing.
    """
    main = _main_file(Path(path))
    config = config or Config()
    interpreter = _Interpreter(main.parent, config, bspline_shift)
    interpreter.run(main, depth=0)
    return interpreter.program()


def _main_file(path: Path) -> Path:
    if not path.is_dir():
        return path
    mains = sorted(p for p in path.iterdir() if p.suffix.upper() == ".MPF")
    if len(mains) != 1:
        raise InputError(f"{path}: holds {len(mains)} main programs (.MPF); name one of them")
    return mains[0]


class _Interpreter:
    """State of the control while it runs a program from top to bottom."""

    def __init__(self, folder: Path, config: Config, shift: int | None) -> None:
        self._folder = folder
        self._templates = Templates(config.machine)
        self._default_shift = config.machine.bspline_shift
        self._given_shift = shift
        self._shift = shift or self._default_shift
        self._files: list[SourceFile] = []
        self._file_index: dict[str, int] = {}
        self._header: dict[str, str] = {}
        self._rows: list[tuple[float, ...]] = []
        self._events: list[tuple[int, int, int, str, float]] = []
        self._numbers: list[tuple[int, int, int]] = []
        self._layer_files: list[str] = []
        # modal state
        self._file = self._line = 0
        self._mode = ""
        self._position = dict.fromkeys(AXES, np.nan)
        self._feed = np.nan
        self._beam = self._wire = False
        self._set: dict[str, float] = {}
        self._layer = -1
        self._ring = self._island = -1
        self._spline: list[tuple[float, float, float, int]] = []

    # -- files and lines ---------------------------------------------------------------------------

    def run(self, path: Path, depth: int) -> None:
        """Run one file to its end."""
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        lines = data.decode("latin-1").split("\n")
        index = self._file_index.setdefault(path.name, len(self._files))
        if index == len(self._files):
            self._files.append(SourceFile(path.name, data, len(lines) - (not lines[-1]), 0, ""))
        end_line, end_code = 0, ""
        for number, text in enumerate(lines, start=1):
            self._file, self._line = index, number
            code = self._run_line(text.rstrip("\r"), depth)
            if code and not end_line:
                end_line, end_code = number, code
            elif end_line and code is not None:
                raise self._error(f"a block after the end of the program by {end_code} in line {end_line}", 0)
        self._end_spline()
        self._files[index] = SourceFile(path.name, data, len(lines) - (not lines[-1]), end_line, end_code)

    def _run_line(self, text: str, depth: int) -> str | None:
        """Run one line; its end code, an empty string for another block, None where there is no block."""
        code, mark, comment = text.partition(";")
        if mark:
            self._note(comment.strip(), code)
        if not code.strip() or (self._line == 1 and _HEADER.fullmatch(code)):
            return None
        number = _NUMBER.match(code)
        column = 0
        if number:
            self._numbers.append((self._file, self._line, int(number[1])))
            column = number.end()
        code = code[column:].rstrip().upper()
        try:
            return self._run_block(code, depth, comment) if code else ""
        except WordError as error:
            raise self._error(error.what, column + error.column) from None

    def _error(self, what: str, column: int) -> InputError:
        return InputError(f"{self._files[self._file].name}:{self._line}:{column + 1}: {what}")

    def _note(self, comment: str, code: str) -> None:
        """Read what a comment says: the role of the motions that follow, or a line of the header."""
        role = _ROLE.fullmatch(comment)
        if role and not code.strip():
            self._end_spline()
            number = int(role[2])
            self._ring, self._island = (number, -1) if role[1] == "RING" else (-1, number)
        elif self._file == 0 and not self._rows and not code.strip():
            key = _KEY.fullmatch(comment)
            if key:
                self._header.setdefault(key[1], key[2])
            convention = _CONVENTION.search(comment)
            if convention and not self._given_shift:
                self._shift = int(convention[1])

    # -- blocks ------------------------------------------------------------------------------------

    def _run_block(self, code: str, depth: int, comment: str) -> str:
        try:
            block = read_block(code)
        except UnknownWord:
            change = self._templates.find(code)
            if change is not None:
                self._change_state(change)
            elif not self._call(code, depth):
                raise
            return ""
        end = ""
        for word in block.codes:
            if word in END_CODES:
                end = word
            elif word in _KINDS:
                self._end_spline()
                self._mode = word
            else:
                self._event(word)
        if block.values or block.lists:
            self._run_values(block, comment)
        if self._mode == "BSPLINE" and "BSPLINE" in block.codes and not self._spline:
            self._begin_spline()
        if end:
            self._end_spline()
            self._event(end)
        return end

    def _run_values(self, block: Block, comment: str) -> None:
        values = block.values
        if "F" in values:
            self._feed = values["F"]
        for name in ("CTOL", "ADIS"):
            if name in values:
                self._event(name, values[name])
        if values.get("SD", 3.0) != 3.0 or values.get("PW", 1.0) != 1.0:
            raise WordError(
                "only splines with SD=3 and PW=1 are read: others are no polynomials of degree 3", 0
            )
        if block.lists or any(axis in values for axis in AXES):
            self._move(block, comment)
        elif "I" in values or "J" in values or "CR" in values or "PL" in values:
            raise WordError("a block without an axis has nothing to use I, J, CR or PL for", 0)

    def _event(self, name: str, value: float = np.nan) -> None:
        self._events.append((self._file, self._line, len(self._rows), name, value))

    def _change_state(self, change: StateChange) -> None:
        self._end_spline()
        for name, value in change.values:
            self._set[name] = value
            self._event(name, value)
        for switch in change.switches:
            if switch.startswith("beam"):
                self._beam = switch == "beam_on"
            else:
                self._wire = switch == "wire_start"
            self._event(switch)

    def _call(self, code: str, depth: int) -> bool:
        """Run a subprogram, if the block is the name of one."""
        name = code.strip()
        path = self._folder / f"{name}.SPF"
        if not re.fullmatch(r"[A-Z_][A-Z0-9_]+", name) or not path.is_file():
            return False
        if depth == DEEPEST_CALL:
            raise WordError(f"{name} is called over {DEEPEST_CALL} levels deep", 0)
        self._end_spline()
        self._event(f"call {name}")
        if depth == 0:
            self._layer = len(self._layer_files)
            self._layer_files.append(path.name)
        file, line = self._file, self._line
        self._ring = self._island = -1
        self.run(path, depth + 1)
        self._file, self._line = file, line
        if depth == 0:
            self._layer = -1
            self._ring = self._island = -1
        return True

    # -- motions -----------------------------------------------------------------------------------

    def _move(self, block: Block, comment: str) -> None:
        mode = self._mode
        if not mode:
            raise WordError("an axis before any of G0, G1, G2, G3, POLY, BSPLINE", 0)
        values, lists = block.values, block.lists
        if lists and mode != "POLY":
            raise WordError(f"PO[] under {mode}: it belongs to POLY", 0)
        end = [
            lists[f"PO[{axis}]"][0] if f"PO[{axis}]" in lists else values.get(axis, self._position[axis])
            for axis in AXES
        ]
        if mode == "BSPLINE":
            self._control_point(end, values)
            return
        curve: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 1.0)
        centre = (np.nan, np.nan, np.nan)
        if mode == "POLY":
            curve = self._polynomial(block)
        elif "PL" in values:
            raise WordError(f"PL under {mode}: it belongs to POLY and BSPLINE", 0)
        if mode in ("G2", "G3"):
            start = self._position["X"], self._position["Y"]
            try:
                centre = arc(start, (end[0], end[1]), values, counter_clockwise=mode == "G3")
            except ValueError as error:
                raise WordError(str(error), 0) from None
        elif "I" in values or "J" in values or "CR" in values:
            raise WordError(f"I, J or CR under {mode}: they belong to G2 and G3", 0)
        self._append(_KINDS[mode], self._line, end, curve, centre, comment.strip() == "TURN")

    def _append(
        self,
        kind: int,
        line: int,
        end: list[float],
        curve: tuple[float, ...],
        centre: tuple[float, ...],
        turn: bool = False,
    ) -> None:
        self._rows.append(
            (
                self._file, line, self._layer, kind, *end, *curve, *centre, self._feed, self._beam, self._wire,
                self._set.get("voltage_kv", np.nan) * self._set.get("current_ma", np.nan),
                self._set.get("power_w", np.nan), self._set.get("wire_mm_s", np.nan),
                self._ring, self._island, turn,
            )
        )  # fmt: skip
        self._position.update(zip(AXES, end, strict=True))

    def _polynomial(self, block: Block) -> tuple[float, ...]:
        """Coefficients of t^2 and t^3 in X and Y, and the length of the parameter."""
        length = block.values.get("PL", 1.0)
        if not 0.0001 <= length <= 99999.9999:
            raise WordError(f"PL={length:g} under POLY: it reaches from 0.0001 to 99999.9999", 0)
        if len(block.lists.get("PO[Z]", ())) > 1:
            raise WordError("PO[Z] with coefficients: layers are flat", 0)
        x, y = (block.lists.get(f"PO[{axis}]", ())[1:] for axis in "XY")
        return (*x, *(0.0,) * (2 - len(x)), *y, *(0.0,) * (2 - len(y)), length)

    # -- splines -----------------------------------------------------------------------------------

    def _begin_spline(self) -> None:
        self._spline = [(self._position["X"], self._position["Y"], 0.0, self._line)]

    def _control_point(self, end: list[float], values: dict[str, float]) -> None:
        if "PL" not in values:
            raise WordError("a BSPLINE block without PL: the control would choose the knots itself", 0)
        if end[2] != self._position["Z"]:
            raise WordError("Z changes along a BSPLINE: layers are flat", 0)
        if not self._spline:
            self._begin_spline()
        self._spline.append((end[0], end[1], values["PL"], self._line))
        self._position.update(X=end[0], Y=end[1])

    def _end_spline(self) -> None:
        """Turn the control points gathered into one motion for each knot span."""
        points, self._spline = self._spline, []
        if len(points) < 2:
            return
        lines = [point[3] for point in points]
        try:
            index, ends, curves = spline_spans(np.array([p[:3] for p in points]), self._shift)
        except ValueError as error:
            self._line = lines[1]
            raise WordError(str(error), 0) from None
        self._events.append((self._file, lines[1], len(self._rows), "BSPLINE", float(len(points) - 1)))
        z = self._position["Z"]
        for i, end, curve in zip(index.tolist(), ends.tolist(), curves.tolist(), strict=True):
            self._append(SPLINE_SPAN, lines[i], [*end, z], (*curve, 1.0), (np.nan, np.nan, np.nan))

    # -- result ------------------------------------------------------------------------------------

    def program(self) -> NCProgram:
        """Gather all that was read into columns."""
        table = np.array(self._rows, dtype=np.float64).reshape(len(self._rows), 24).T
        file, line, layer, kind = table[:4].astype(np.int64)
        end = np.ascontiguousarray(table[4:7].T)
        start = np.vstack([np.full((1, 3), np.nan), end[:-1]])[: len(end)]
        length = table[11]
        second = (table[[7, 9]] * length**2).T
        third = (table[[8, 10]] * length**3).T
        first = end[:, :2] - start[:, :2] - second - third
        arc = np.ascontiguousarray(table[12:15].T)
        coefficients = np.stack([start[:, :2], first, second, third], axis=2)
        coefficients[kind == ARC] = np.nan
        ring, island = table[21:23].astype(np.int64)
        events = self._events
        layer, layer_files = self._layers(layer, end[:, 2], (table[16] > 0) & (kind != RAPID))
        return NCProgram(
            files=tuple(self._files),
            header=self._header,
            folder=self._folder,
            file=file,
            line=line,
            layer=layer,
            kind=kind,
            start=start,
            end=end,
            coefficients=coefficients,
            arc=arc,
            feed_mm_min=table[15],
            beam=table[16] > 0,
            wire=table[17] > 0,
            power_w=np.where(np.isnan(table[19]), table[18], table[19]),
            wire_mm_s=table[20],
            ring=ring,
            island=island,
            turn=table[23] > 0,
            events=Events(
                file=np.array([e[0] for e in events], dtype=np.int64),
                line=np.array([e[1] for e in events], dtype=np.int64),
                row=np.array([e[2] for e in events], dtype=np.int64),
                name=tuple(e[3] for e in events),
                value=np.array([e[4] for e in events], dtype=np.float64),
            ),
            numbers=np.array(self._numbers, dtype=np.int64).reshape(-1, 3),
            layer_files=layer_files,
        )

    def _layers(self, layer: Ints, z: Floats, deposit: Bools) -> tuple[Ints, tuple[str, ...]]:
        """Layers by calls of subprograms; in a program without calls, by the levels of Z of its deposits."""
        if self._layer_files:
            return layer, tuple(self._layer_files)
        rows = np.flatnonzero(deposit)
        layer = np.full(layer.size, -1, dtype=np.int64)
        layer[rows] = np.cumsum(np.diff(z[rows], prepend=z[rows[:1]]) != 0.0)
        count = int(layer.max(initial=-1)) + 1
        return layer, (self._files[0].name,) * count
