"""Independent reader of programs: text in, motions out. It shares no code with the post-processors."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from ebamcheck.atomic_file import regular_file
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.nc.control import Control, control, controls
from ebamcheck.nc.motions import ARC, RAPID, STRAIGHT, NCProgram
from ebamcheck.nc.recorder import NO_CENTRE, Recorder, StateChange, Templates
from ebamcheck.nc.templates import checked_templates
from ebamcheck.nc.words import NUMBER, SKIP, SKIPPED, Block, Dialect, UnknownWord, WordError, read_block
from ebamcheck.settings.config import Config

AXES = ("X", "Y", "Z")
COMMON_MOTIONS: Mapping[str, int] = {"G0": RAPID, "G1": STRAIGHT, "G2": ARC, "G3": ARC}
ARCS = ("G2", "G3")
RADIUS_TOLERANCE_MM = 0.01  # Of start and end of an arc; larger differences stop the control with an alarm
CHORD_ROUNDING = 1e-9  # Share by which a chord may exceed the diameter, for the rounding of a half circle
_N = rf"({NUMBER})"
# The blocks of which a program mostly consists, in the spelling of most posts; all others are read word by word.
_PLAIN = rf"(G[0-3])(?: X{_N})?(?: Y{_N})?(?: Z{_N})?(?: I{_N} J{_N})?(?: F{_N})?(?: ; (?:TURN|GOES ON))?(?P<plain>)"
TABLE_TITLES = (b"Mode\t", b"Mode X(m)", b"Number of path segments")  # First lines of path tables


def read_program(
    path: str | Path, config: Config | None = None, *, bspline_shift: Literal[2, 3, "uniform"] | None = None
) -> NCProgram:
    """Read a program from its main file, or from the folder that holds it and its subprograms.

    Parameters
    ----------
    path
        ``.MPF`` (or ``.SPF``) file of a SINUMERIK, ``.ngc`` of LinuxCNC, ``.gcode``, ``.nc`` or ``.g`` of plain
        G-code, or a folder with exactly one of them that is no ``.SPF``.
    config
        Its machine section holds the beam and wire templates; None: the default profile.
    bspline_shift
        Which knot interval a BSPLINE block's PL carries (2 or 3, or "uniform" for none); None: as the
        machine profile says. What the header of the program says of it counts for nothing.

    Returns
    -------
    NCProgram
        Every motion with its curve (mm), feed (mm/min), beam and wire, and the place in the text that it comes from.

    Raises
    ------
    InputError
        ``FILE:line:column: ...`` for a word or block that is not understood; also where a file is missing.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "square.ngc"
    ...     _ = file.write_text("G21 G90 G94\\nG0 X0 Y0 Z5\\nG1 X10 F600\\nG1 Y10\\nM2\\n")
    ...     nc = read_program(file)
    >>> nc.lengths[1:].tolist(), nc.feed_mm_min[1:].tolist()
    ([10.0, 10.0], [600.0, 600.0])
    """
    config = config or Config()
    known = {name: control for name, control in controls().items() if control.is_read}
    main = _main_file(Path(path), known)
    control = _control_of(main, config, known)
    options = {} if bspline_shift is None else {"bspline_shift": bspline_shift}
    nc: NCProgram = control.load("reader")(main, config, **options)
    return nc


def _main_file(path: Path, controls: Mapping[str, Control]) -> Path:
    if not path.is_dir():
        return path
    endings = [s for c in controls.values() for s in c.suffixes if s != c.subprogram_suffix]
    mains = sorted(p for p in path.iterdir() if p.suffix.upper() in endings)
    if len(mains) != 1:
        raise InputError(f"{path}: holds {len(mains)} main programs ({', '.join(endings)}); name one of them")
    return mains[0]


def _control_of(path: Path, config: Config, controls: Mapping[str, Control]) -> Control:
    """The control of a file: by its first bytes, by its ending, the one of the profile first, else that of the profile."""
    try:
        with regular_file(path).open("rb") as file:
            begin = file.readline(40)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if begin.startswith(TABLE_TITLES):
        what = "the path table of a heat simulator is an export, no program to be read"
        raise InputError(f"{path}:1:1: {what}")
    marked = [c for c in controls.values() if c.mark and begin.startswith(c.mark)]
    ending = [c for c in controls.values() if path.suffix.upper() in c.suffixes]
    own = controls.get(config.machine.control)
    if own is not None and (own in marked or not marked) and (own in ending or not ending):
        return own
    if found := marked or ending:
        return found[0]
    raise SettingsError(f"{path}: machine.control {config.machine.control!r} is none whose programs are read")


class Reader:
    """State of a control while it runs a program from top to bottom: lines, blocks, words and motions."""

    def __init__(self, folder: Path, config: Config, dialect: Dialect) -> None:
        known = control(dialect.name)
        self.dialect = dialect
        self.rotary = tuple(axis.name for axis in config.machine.rotary) if known.frames else ()
        in_layers = bool(known.subprogram_suffix) and config.preheat.scan_in == "layer"
        self.out = Recorder(folder, dialect.name, self.rotary, in_layers)
        self.mode = ""  # Word of motion in force
        self._begun = False
        self._templates = Templates(checked_templates(config.machine, dialect.name))
        self._changes: dict[str, StateChange] = {}
        curve = f"|{dialect.curve}(?P<curve>)" if dialect.curve else ""
        self._plain = re.compile(rf"(?:N(\d+) )?(?:{_PLAIN}{curve})")

    def split(self, text: str) -> tuple[str, list[str]]:
        """Code of a line, blanks in place of comments that do not end it, and the comments."""
        raise NotImplementedError

    def percent(self, code: str) -> str | None:
        """What a line with a percent sign is: no block (None), the end of what is read ("%"), or a block like others ("")."""
        if code.strip() != "%":
            return ""
        return "%" if self._begun or self.out.started else None

    def own_block(self, code: str) -> bool:
        """Run a block that is none of words, templates or calls; return whether it is one."""
        return False

    def call(self, code: str) -> bool:
        """Run a subprogram, if the block is the name of one."""
        return False

    def settle(self) -> None:
        """End a curve that several blocks make, before anything that is none of it."""

    def motion_word(self, word: str) -> None:
        """Change the kind of motion."""
        self.settle()
        self.mode = word

    def state_word(self, word: str) -> None:
        """Do what a word does that is none of motion."""
        self.out.event(word)

    def own_values(self, block: Block) -> None:
        """Take the values that are none of a motion out of a block."""

    def own_motion(self, x: float, y: float, z: float, block: Block) -> bool:
        """Run a motion other than G0 to G3; return whether it is one."""
        return False

    def run_curve(self, *numbers: float) -> None:
        """Run the block of the pattern of curves."""
        raise NotImplementedError

    def stray(self, values: Mapping[str, float]) -> str:
        """What is wrong with the addresses of a motion beside its axes; empty if nothing."""
        allowed = {"I", "J", self._radius} if self.mode in ARCS else set()
        takes = f"it takes I and J, or {self._radius}" if allowed else "it takes axes and F alone"
        return "" if values.keys() <= allowed else f"{', '.join(values)} under {self.mode}: {takes}"

    def program(self, main: Path) -> NCProgram:
        """Run a program from its main file; what it commands."""
        self.run(main)
        return self.out.program()

    def run(self, path: Path) -> None:
        """Run one file to its end."""
        out = self.out
        end_line, end_code = 0, ""
        for number, text in enumerate(out.open(path), start=1):
            out.line = number
            if not end_line and self.run_plain(text):
                continue
            try:
                code = self.run_line(text.rstrip("\r"))
            except WordError as error:
                raise out.error(error.what, error.column) from None
            if code and not end_line:
                end_line, end_code = number, code
            elif end_line and code not in (None, "%"):
                out.line = end_line if end_code == "%" else number
                raise out.error(f"a block after the end of the program by {end_code} in line {end_line}", 0)
        self.settle()
        out.close(end_line, end_code)

    def run_plain(self, text: str) -> bool:
        """Run one of the blocks of which a program mostly consists; return whether it is one."""
        found = self._plain.fullmatch(text)
        out = self.out
        if found is None or out.table.fresh:
            return False
        number, mode, *parts = found.groups()
        if mode is None:
            self.run_curve(*map(float, parts[7:-1]))
        else:
            x, y, z, i, j, feed = parts[:6]
            if (x is None and y is None and z is None) or (i is None) == (mode in ARCS):
                return False
            to = (
                out.x if x is None else float(x),
                out.y if y is None else float(y),
                out.z if z is None else float(z),
            )
            centre: tuple[float, ...] = NO_CENTRE
            if i is not None:
                try:
                    centre = arc((out.x, out.y), to[:2], float(i), float(j), counter_clockwise=mode == "G3")
                except ValueError:
                    return False  # to be refused with its place
            self.mode = mode
            if feed is not None:
                out.feed(float(feed))
            out.move(COMMON_MOTIONS[mode], *to, centre=centre)
        if number is not None:
            out.number(number)
        return True

    def run_line(self, text: str) -> str | None:
        """Run one line; its end code, an empty string for another block, None where there is no block."""
        out = self.out
        code, comments = self.split(text)
        if not code.strip():
            # What a comment says of motions counts for nothing.
            for comment in comments if out.file == 0 and not out.started else ():
                out.read_header(comment.strip())
            return None
        if "%" in code and (what := self.percent(code)) != "":
            self._begun = True
            return what
        self._begun = True
        skip = SKIP.match(code)
        column = skip.end() if skip else 0
        number = self.dialect.block_number.match(code, column)
        if number:
            out.number(number[1])
            column = number.end()
        code = code[column:].rstrip().upper()
        if skip and code and not self._says_only(code):
            out.event(SKIPPED)
        try:
            return self._run_block(code) if code else ""
        except WordError as error:
            raise WordError(error.what, column + error.column) from None

    def _says_only(self, code: str) -> bool:
        return self.dialect.message is not None and self.dialect.message.fullmatch(code) is not None

    def _run_block(self, code: str) -> str:
        if (change := self._changes.get(code)) is not None:
            self.settle()
            self.out.change(change)
            return ""
        if self._says_only(code):
            self.settle()
            return ""
        if self.own_block(code):
            return ""
        try:
            block = read_block(code, self.dialect, self.rotary)
        except UnknownWord:
            change = self._templates.find(code)
            if change is not None:
                # The same text is one of a template wherever it stands: it need not be split into words again.
                self._changes[code] = change
                self.settle()
                self.out.change(change)
            elif not self.call(code):
                raise
            return ""
        end = ""
        for word in block.codes:
            if word in self.dialect.ends:
                end = word
            elif word in self.dialect.motions:
                self.motion_word(word)
            else:
                self.state_word(word)
        if block.values or block.lists:
            self._run_values(block)
        if end:
            self.settle()
            self.out.event(end)
        return end

    def _run_values(self, block: Block) -> None:
        values = block.values
        moves = bool(block.lists) or any(axis in values for axis in (*AXES, *self.rotary))
        if "F" in values:
            self.out.feed(values.pop("F"))
        self.own_values(block)
        if moves:
            self._move(block)
        elif values:
            unused = self.dialect.unused or ", ".join(values)
            raise WordError(f"a block without an axis has nothing to use {unused} for", 0)

    def _move(self, block: Block) -> None:
        out, mode, values = self.out, self.mode, block.values
        if not mode:
            raise WordError("an axis before any of " + ", ".join(self.dialect.motions), 0)
        x, y, z = (
            block.lists[f"PO[{axis}]"][0] if f"PO[{axis}]" in block.lists else values.get(axis, here)
            for axis, here in zip(AXES, (out.x, out.y, out.z), strict=True)
        )
        if self.own_motion(x, y, z, block):
            return
        rest = {address: value for address, value in values.items() if address not in AXES}
        if what := self.stray(rest):
            raise WordError(what, 0)
        centre: tuple[float, ...] = NO_CENTRE
        if mode in ARCS:
            radius = rest.get(self._radius)
            try:
                i, j = rest.get("I", 0.0), rest.get("J", 0.0)
                centre = arc((out.x, out.y), (x, y), i, j, radius, counter_clockwise=mode == "G3")
            except ValueError as error:
                given = "" if radius is None else f"{self.dialect.radius}{radius:g}: "
                raise WordError(f"{given}{error}", 0) from None
        out.move(self.dialect.motions[mode], x, y, z, centre=centre)

    @property
    def _radius(self) -> str:
        return self.dialect.radius.rstrip("=")


def arc(
    start: tuple[float, float], end: tuple[float, float], i: float, j: float, radius: float | None = None, *,
    counter_clockwise: bool,
) -> tuple[float, float, float]:  # fmt: skip
    """Centre X, Y and signed sweep (radians) of an arc; by I and J, equal ends make a full circle."""
    sense = 1.0 if counter_clockwise else -1.0
    x, y = start
    dx, dy = end[0] - x, end[1] - y
    if radius is not None:
        chord, size = math.hypot(dx, dy), abs(radius)
        if not 0.0 < chord <= 2.0 * size * (1.0 + CHORD_ROUNDING):
            raise ValueError("no circle of that radius joins start and end")
        rise = math.copysign(math.sqrt(max(size**2 - 0.25 * chord**2, 0.0)), sense * radius) / chord
        cx, cy = x + 0.5 * dx - rise * dy, y + 0.5 * dy + rise * dx
    else:
        cx, cy = x + i, y + j
    first, last = math.hypot(x - cx, y - cy), math.hypot(end[0] - cx, end[1] - cy)
    if not (first > 0.0 and abs(first - last) <= RADIUS_TOLERANCE_MM):
        raise ValueError(f"radius {first:.6g} mm at the start of the arc and {last:.6g} mm at its end")
    turn = math.atan2(end[1] - cy, end[0] - cx) - math.atan2(y - cy, x - cx)
    return cx, cy, sense * ((sense * turn) % (2.0 * math.pi) or 2.0 * math.pi)
