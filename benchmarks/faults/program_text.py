"""The text of a program, to be spoiled: files, layers and beads, found by patterns of their own.

Nothing of the product's readers is used: what is planted must not depend on what is to find it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Point = tuple[float, float]

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"


@dataclass(frozen=True)
class Codes:
    """Codes of beam, wire and values as the stock profile of a control has them; patterns take the number as group 1."""

    beam_on: str
    beam_off: str
    wire_on: str
    wire_off: str
    wire_speed: str
    power: str
    voltage: str
    pause: str
    pause_block: str
    """Block of a wait, to be formatted."""


CODES = {
    "sinumerik-840d-sl": Codes(
        r"M60", r"M61", r"M62", r"M63", rf"H3=({NUMBER})", rf"H2=({NUMBER})", rf"H1=({NUMBER})", rf"G4 F({NUMBER})",
        "G4 F{:g}",
    ),
    "linuxcnc": Codes(
        r"M64 P0", r"M65 P0", r"M64 P1", r"M65 P1", rf"M6[78] E2 Q({NUMBER})", rf"M6[78] E1 Q({NUMBER})",
        rf"M68 E0 Q({NUMBER})", rf"G4 P({NUMBER})", "G4 P{:g}",
    ),
    "plain-gcode": Codes(
        rf"M3 S{NUMBER}", r"M5", r"M8", r"M9", rf"M42 P1 S({NUMBER})", rf"(?:M3 )?S({NUMBER})", r"(?!)", rf"G4 S({NUMBER})",
        "G4 S{:g}",
    ),
}  # fmt: skip

_BLOCK_NUMBER = re.compile(r"^N\d+ ?")
_MOTION = re.compile(r"(G[01235]|POLY)\b")
_ROLE = re.compile(r"^; (RING|ISLAND) (\d+)$")
_LAYER = re.compile(r"^; LAYER: (\d+) OF")


@dataclass(frozen=True)
class Bead:
    """One bead: lines of its file, counted from 0."""

    file: str
    layer: int
    contour: bool
    travel: int
    """First line that belongs to it: the way to its start, or its values."""
    on: int
    """Line that switches the beam on."""
    motions: tuple[int, ...]
    off: int
    """Line that switches the beam off: the last one."""
    start: Point

    @property
    def first(self) -> int:
        """Line of its first motion."""
        return self.motions[0]

    @property
    def last(self) -> int:
        """Line of its last motion."""
        return self.motions[-1]

    def after(self, i: int) -> int:
        """Line of the motion after one of them."""
        return self.motions[self.motions.index(i) + 1]


@dataclass(frozen=True)
class Layer:
    """The lines of one layer, counted from 0, the last one left out."""

    number: int
    file: str
    first: int
    end: int
    z: float
    safe_z: float

    def way_to(self, point: Point) -> list[str]:
        """Blocks that rise, travel, and descend."""
        x, y = point
        return [f"G0 Z{self.safe_z:.6f}", f"G0 X{x:.6f} Y{y:.6f}", f"G0 Z{self.z:.6f}"]


@dataclass
class ProgramText:
    """The files of a program as lists of lines, the main one first."""

    control: str
    files: dict[str, list[str]]
    raw: dict[str, Callable[[bytes], bytes]] = field(default_factory=dict)
    """What is done to the bytes of a file when it is written."""

    @classmethod
    def read(cls, folder: Path, control: str) -> ProgramText:
        """Read all files of a program's folder."""
        paths = sorted(folder.iterdir(), key=lambda p: (p.suffix == ".SPF", p.name))
        return cls(control, {p.name: p.read_text(encoding="ascii").split("\n") for p in paths})

    @property
    def main(self) -> str:
        """Name of the file that is started."""
        return next(iter(self.files))

    @property
    def codes(self) -> Codes:
        """Codes of the control's stock profile."""
        return CODES[self.control]

    @property
    def sinumerik(self) -> bool:
        """Whether layers are subprograms, and blocks have numbers."""
        return self.control == "sinumerik-840d-sl"

    # -- reading -------------------------------------------------------------------------------------

    def code(self, file: str, i: int) -> str:
        """Block of a line, without number and comment."""
        return code_of(self.files[file][i])

    def find(self, pattern: str, file: str | None = None, first: int = 0, end: int | None = None) -> list[int]:
        """Lines of a file (the main one) whose block matches a pattern as a whole."""
        lines = self.files[file or self.main]
        wanted = re.compile(pattern)
        stop = len(lines) if end is None else end
        return [i for i in range(first, stop) if wanted.fullmatch(code_of(lines[i]))]

    def everywhere(self, pattern: str) -> list[tuple[str, int]]:
        """Files and lines whose block matches a pattern as a whole."""
        return [(file, i) for file in self.files for i in self.find(pattern, file)]

    def layers(self) -> list[Layer]:
        """Layers in the order in which they stand."""
        if self.sinumerik:
            spans = [(file, 0, len(self.files[file])) for file in self.files if file != self.main]
        else:
            lines = self.files[self.main]
            begins = [i for i, line in enumerate(lines) if _LAYER.match(line)]
            spans = [(self.main, a, b) for a, b in zip(begins, [*begins[1:], self._end_of_layers()], strict=True)]
        return [self._layer(k, *span) for k, span in enumerate(spans)]

    def _end_of_layers(self) -> int:
        """Line after the last rise of the last layer, and the waits behind it, in a program in one file."""
        off = self.find(self.codes.beam_off, end=self.find(r"G[1235] .*")[-1] + 4)[-1]
        rise = self.find(rf"G0 Z{NUMBER}", first=off)[0]
        return max([rise, *self.find(self.codes.pause, first=rise, end=rise + 2)]) + 1

    def _layer(self, number: int, file: str, first: int, end: int) -> Layer:
        rises = {word(self.code(file, i), "Z") for i in self.find(rf"G0 Z{NUMBER}", file, first, end)}
        z, safe_z = sorted(z for z in rises if z is not None)[:2]
        return Layer(number, file, first, end, z, safe_z)

    def beads(self, contour: bool | None = None) -> list[Bead]:
        """All beads, or those of contours or of islands alone."""
        found = [bead for layer in self.layers() for bead in self._beads(layer)]
        return [bead for bead in found if contour is None or bead.contour == contour]

    def _beads(self, layer: Layer) -> Iterator[Bead]:
        lines = self.files[layer.file]
        contour, travel, on = True, -1, -1
        motions: list[int] = []
        here = start = (0.0, 0.0)
        for i in range(layer.first, layer.end):
            role = _ROLE.match(lines[i])
            contour = role[1] == "RING" if role else contour
            code = code_of(lines[i])
            if re.fullmatch(self.codes.beam_on, code):
                on, motions, start = i, [], here
            elif on >= 0 and re.fullmatch(self.codes.beam_off, code):
                if motions:
                    yield Bead(layer.file, layer.number, contour, travel, on, tuple(motions), i, start)
                travel, on = -1, -1
            elif _MOTION.match(code):
                if on >= 0:
                    motions.append(i)
                elif travel < 0:
                    travel = i
                here = end_of(code, here)

    def position(self, file: str, i: int) -> Point:
        """Place in X and Y before a line."""
        here = (0.0, 0.0)
        for line in self.files[file][:i]:
            code = code_of(line)
            if _MOTION.match(code):
                here = end_of(code, here)
        return here

    def ways(self, bead: Bead) -> list[int]:
        """Lines of the ways in X and Y to a bead."""
        return [i for i in range(max(bead.travel, 0), bead.on) if self.code(bead.file, i).startswith("G0 X")]

    def rises(self, layer: Layer, z: float) -> list[int]:
        """Lines of a layer that lead straight to a height."""
        rows = self.find(rf"G0 Z{NUMBER}", layer.file, layer.first, layer.end)
        return [i for i in rows if word(self.code(layer.file, i), "Z") == z]

    def ends(self, file: str, lines: Iterable[int]) -> Floats:
        """Ends of the motions in X and Y of some lines, (n, 2)."""
        codes = [self.code(file, i) for i in lines]
        places = [[word(code, a, word(code, f"PO[{a}]=(")) for a in "XY"] for code in codes]
        return np.array([place for place in places if None not in place], float).reshape(-1, 2)

    def centre(self, file: str, lines: Iterable[int]) -> Floats:
        """Middle of the box around the ends of some lines."""
        points = self.ends(file, lines)
        return np.asarray(0.5 * (points.min(axis=0) + points.max(axis=0)))

    def bounds(self) -> tuple[Floats, Floats]:
        """Least and greatest X, Y of all ends of motions."""
        points = np.concatenate([self.ends(file, range(len(lines))) for file, lines in self.files.items()])
        return points.min(axis=0), points.max(axis=0)

    def pause(self, seconds: float) -> str:
        """Block of a wait."""
        return self.codes.pause_block.format(seconds)

    def is_turn(self, file: str, i: int) -> bool:
        """Whether a motion joins two lines of a hatch."""
        return self.files[file][i].endswith("; TURN")

    # -- spoiling ------------------------------------------------------------------------------------

    def set(self, file: str, i: int, code: str) -> None:
        """Put another block in place of a line's, and leave its comment."""
        _, mark, comment = self.files[file][i].partition(" ;")
        self.files[file][i] = f"{code}{mark}{comment}"

    def set_words(self, file: str, i: int, addresses: str, values: Iterable[float]) -> None:
        """Put other numbers behind addresses."""
        code = self.code(file, i)
        for address, value in zip(addresses, values, strict=True):
            code = with_word(code, address, float(value))
        self.set(file, i, code)

    def move(self, file: str, lines: Iterable[int], matrix: ArrayLike, offset: ArrayLike) -> None:
        """Map the motions of some lines by ``matrix p + offset``."""
        for i in lines:
            if _MOTION.match(code := self.code(file, i)):
                self.set(file, i, moved(code, matrix, offset))

    def insert(self, file: str, i: int, *blocks: str) -> None:
        """Insert blocks before a line."""
        self.files[file][i:i] = blocks

    def delete(self, file: str, first: int, end: int | None = None) -> None:
        """Take lines out, one or up to `end`."""
        del self.files[file][first : first + 1 if end is None else end]

    # -- writing -------------------------------------------------------------------------------------

    def write(self, folder: Path) -> None:
        """Write all files in place of those that are there, blocks numbered anew where the control has numbers."""
        for path in folder.iterdir():
            path.unlink()
        for name, lines in self.files.items():
            data = "\n".join(numbered(lines) if self.sinumerik else lines).encode("latin-1")
            (folder / name).write_bytes(self.raw.get(name, bytes)(data))


def code_of(line: str) -> str:
    """Block of a line, without number and comment."""
    if line.startswith("%"):
        return line
    return _BLOCK_NUMBER.sub("", line.partition(";")[0].strip())


def word(code: str, address: str, otherwise: float | None = None) -> float | None:
    """Return the number behind an address: `X`, `PL=`, or `PO[X]=(`."""
    found = re.search(rf"(?<![A-Z\[=]){re.escape(address)}({NUMBER})", code)
    return float(found[1]) if found else otherwise


def end_of(code: str, here: Point) -> Point:
    """Place in X and Y after a motion from `here`."""
    ends = [word(code, axis, word(code, f"PO[{axis}]=(")) for axis in "XY"]
    x, y = (at if end is None else end for end, at in zip(ends, here, strict=True))
    return x, y


def with_word(code: str, address: str, value: float) -> str:
    """Return a block with another number behind an address."""
    decimals = 0 if address in "FS" and value == int(value) else 6
    return re.sub(rf"(?<![A-Z\[=])({re.escape(address)}){NUMBER}", rf"\g<1>{value:.{decimals}f}", code, count=1)


def moved(code: str, matrix: ArrayLike, offset: ArrayLike = (0.0, 0.0)) -> str:
    """Return a motion's block with its path mapped by ``matrix p + offset``; one without X and Y stays."""
    a, b = np.asarray(matrix, float), np.asarray(offset, float)
    if code.startswith("POLY"):
        lists = re.findall(r"PO\[[XY]\]=\(([^)]*)\)", code)
        values = a @ np.array([[float(v) for v in some.split(",")] for some in lists])
        values[:, 0] += b
        for axis, row in zip("XY", values, strict=True):
            numbers = ",".join(f"{v:.6f}" for v in row)
            code = re.sub(rf"PO\[{axis}\]=\([^)]*\)", f"PO[{axis}]=({numbers})", code)
        return code
    if word(code, "X") is None or word(code, "Y") is None:
        return code
    for names, shift in (
        ("XY", b),
        ("IJ", 0.0),
        ("PQ", 0.0),
    ):  # a vector to a centre or a handle is not shifted
        u, v = (word(code, name) for name in names)
        if u is not None and v is not None:
            for name, value in zip(names, a @ (u, v) + shift, strict=True):
                code = with_word(code, name, float(value))
    return reversed_arc(code) if np.linalg.det(a) < 0.0 else code


def reversed_arc(code: str) -> str:
    """Return an arc's block with its direction reversed."""
    return {"G2": "G3", "G3": "G2"}.get(code[:2], code[:2]) + code[2:]


def turn(angle_deg: float) -> Floats:
    """Matrix of a turn, counter-clockwise."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.array([[c, -s], [s, c]])


def about(matrix: ArrayLike, centre: ArrayLike) -> Floats:
    """Offset by which a matrix leaves a centre where it is."""
    c = np.asarray(centre, float)
    return np.asarray(c - np.asarray(matrix, float) @ c)


def numbered(lines: list[str]) -> list[str]:
    """Return lines with their blocks numbered by tens; numbers that were planted stay."""
    result, number = [], 10
    for line in lines:
        if not code_of(line) or line.startswith(("%", "!")):
            result.append(line.removeprefix("!"))
            continue
        result.append(f"N{number} {_BLOCK_NUMBER.sub('', line)}")
        number += 10
    return result


def without_comments(text: str) -> str:
    """Return the text of a file without any comment; a SINUMERIK's two lines of header are none."""
    lines = text.split("\n")
    kept = 2 if lines[0].startswith("%_N_") else 0
    bare = [re.sub(r"\s*;[^\r]*", "", line) for line in lines[kept:]]
    if not kept:
        bare = [re.sub(r"\([^)]*\)", "", line) for line in bare]
    return "\n".join([*lines[:kept], *bare])
