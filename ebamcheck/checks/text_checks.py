"""Checks of a program's text: encoding, names, headers, numbers, ends, hashes, and the words of its motions."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Callable, Mapping

import numpy as np

from ebamcheck.checks.checks import Faults, count_check, lines_of, place_of
from ebamcheck.nc.control import control
from ebamcheck.nc.files import layer_of_preheat
from ebamcheck.nc.motions import RAPID, NCProgram, SourceFile
from ebamcheck.nc.timeline import Kind
from ebamcheck.printable import printable
from ebamcheck.result import Check
from ebamcheck.settings.config import Config

BLOCK_LIMIT = 200  # Characters; every software version of the control reads shorter blocks
FIRST_PRINTABLE, LAST_PRINTABLE = 0x20, 0x7E
BLANK_BYTES = tuple(b"\t\n\r")  # Bytes of a program: printable ASCII, tabs and ends of lines
_LAYER_NAME = re.compile(r"(.+)_L(\d+)")
_ENDS = {".MPF": ("M30", "M2"), ".SPF": ("M17", "RET")}
_MAIN_ENDS = ("M30", "M2")
# Comments, and the lists of a polynomial, whose axis stands before them.
_ASIDE = re.compile(rb"\([^)]*\)|;.*")
# The form of nearly all blocks of metal, which name both axes; of others _absent tells what they lack.
_PLAIN = re.compile(rb"[^(;XY]*X[^(;XY]*Y")
MOST_WHOLE = 0.9  # Share of the blocks with metal that name both axes from which on that is the form
LEAST_WHOLE = 4  # Rapids across for each with one axis from which on naming both is the form
FEW = 2  # So many beads without a way are a loss in a program of any size


def text_checks(nc: NCProgram, config: Config, sha256: Mapping[str, str] | None = None) -> list[Check]:
    """Check the bytes of every file that the program opened."""

    def each(check: Callable[[SourceFile], Faults]) -> Faults:
        return [fault for file in nc.files for fault in check(file)]

    checks = [
        count_check("encoding", each(_encoding), "printable ASCII throughout"),
        count_check("line ends", each(_line_ends), "every block ends with LF alone"),
        _block_length(nc),
    ]
    if control(nc.dialect).file_faults:
        faults = control(nc.dialect).load("file_faults")(nc, config)
        checks.append(count_check("names and headers", faults, "legal names, first lines and paths"))
    subprograms = "each is a layer of this program, in its order, and called once"
    checks += [
        count_check("block numbers", _numbers(nc), "N rises from block to block in every file"),
        count_check("end of program", each(_end), "one end in each file, in its last block"),
        count_check("subprograms", _calls(nc), subprograms),
    ]
    if sha256 is not None:
        checks.append(count_check("unchanged", _changed(nc, sha256), "SHA-256 of every file as recorded"))
    return checks


def _encoding(file: SourceFile) -> Faults:
    data = np.frombuffer(file.data, np.uint8)
    # Carriage returns have a check of their own; what a control makes of other control characters, nobody says.
    bad = np.flatnonzero((data > LAST_PRINTABLE) | ((data < FIRST_PRINTABLE) & ~np.isin(data, BLANK_BYTES)))
    if not bad.size:
        return []
    offset = int(bad[0])
    what = f"byte 0x{file.data[offset]:02X} is not {'printable' if file.data[offset] < 128 else 'ASCII'}"
    return [(place_of(file, offset), what)]


def _line_ends(file: SourceFile) -> Faults:
    offset = file.data.find(b"\r")
    return [] if offset < 0 else [(place_of(file, offset), "carriage return: lines must end with LF alone")]


def _block_length(nc: NCProgram) -> Check:
    longest, where = 0, ""
    for file in nc.files:
        for number, line in enumerate(file.data.split(b"\n"), start=1):
            if len(line) > longest:
                longest, where = len(line), f"{file.name}:{number}"
    text = f"longest block has {longest} characters"
    return Check("block length", longest < BLOCK_LIMIT, longest, BLOCK_LIMIT - 1, "characters", where, text)


def _numbers(nc: NCProgram) -> Faults:
    faults: Faults = []
    for index, file in enumerate(nc.files):
        rows = nc.numbers[nc.numbers[:, 0] == index]
        rows = rows[np.sort(np.unique(rows[:, 1], return_index=True)[1])]
        faults += [
            (f"{file.name}:{rows[i + 1, 1]}", f"N{rows[i + 1, 2]} follows N{rows[i, 2]}")
            for i in np.flatnonzero(np.diff(rows[:, 2]) <= 0)
        ]
    return faults


def _end(file: SourceFile) -> Faults:
    wanted = _ENDS.get(file.name[-4:].upper(), _MAIN_ENDS)
    last = f"{file.name}:{file.line_count}"
    if not file.end_line:
        return [(last, f"no {wanted[0]} at the end: the file is cut off")]
    if file.end_code not in wanted:
        return [(f"{file.name}:{file.end_line}", f"ends with {file.end_code} in place of {wanted[0]}")]
    if not file.data.endswith(b"\n"):
        return [(last, "the last block has no LF: the file is cut off")]
    return []


def _calls(nc: NCProgram) -> Faults:
    """Calls of what is no layer of this program (MAIN_L0001 and on), or of one out of its order or twice; layers that are not called."""
    e, stem, before, faults = nc.events, nc.files[0].name.rpartition(".")[0].upper(), -1, Faults()
    at = np.flatnonzero(e.kind == Kind.CALL).tolist()
    calls = [e.said(i) for i in at]
    for i, name in zip(at, calls, strict=True):
        if layer_of_preheat(stem, name) is not None:
            continue  # checked by itself: see preheating
        found = _LAYER_NAME.fullmatch(name)
        if found is None or found[1] != stem or int(e.file[i]) != 0:
            faults.append((nc.where_event(i), f"{name} is no layer of {stem}: nothing says what it is for"))
            continue
        if before >= 0 and int(found[2]) != before + 1:
            faults.append((nc.where_event(i), f"{name} follows layer {before}"))
        before = int(found[2])
    last = dict(zip(calls, at, strict=True))
    many = [(name, count) for name, count in Counter(calls).items() if count > 1]
    faults += [(nc.where_event(last[name]), f"{name} is called {count} times") for name, count in many]
    loads, suffix = control(nc.dialect).loads, control(nc.dialect).subprogram_suffix
    if calls and loads:
        # A control takes MAIN_L0001 and main_l0001 for one name: which of the two runs, nobody says.
        there = {path.name for path in nc.folder.iterdir() if re.fullmatch(loads, path.name.upper())}
        known = {file.name for file in nc.files} | {f"{call}{suffix}" for call in calls}
        where = f"{nc.files[0].name}:{e.line[at].max()}"
        what = "is never called, and lies beside the program"
        faults += [(where, f"{printable(name)} {what}") for name in sorted(there - known)]
    return faults


def _changed(nc: NCProgram, sha256: Mapping[str, str]) -> Faults:
    faults = []
    for file in nc.files:
        if file.name not in sha256:
            faults.append((f"{file.name}:1", "is not among the files recorded"))
        elif hashlib.sha256(file.data).hexdigest() != sha256[file.name]:
            faults.append((f"{file.name}:1", "its bytes are not those recorded"))
    missing = [name for name in sha256 if name not in {file.name for file in nc.files}]
    return faults + [(f"{nc.files[0].name}:1", f"{name} was recorded but is not run") for name in missing]


def words_check(nc: NCProgram) -> Check:
    """Check that no block of a bead lacks an axis that nearly all others name, and no way to a bead lacks its place or half of it."""
    lines = [file.data.split(b"\n") for file in nc.files]
    text = f"{len(nc)} motions name X and Y as the others do"
    blocks = _blocks(nc, lines)
    # Where blocks of metal name what changes, rapids may, too.
    faults = _ways(nc, lines) if blocks is None else [*blocks, *_half_ways(nc, lines), *_ways(nc, lines)]
    return count_check("words of motions", faults, text)


def _blocks(nc: NCProgram, lines: list[list[bytes]]) -> Faults | None:
    """Blocks of metal that lack an axis; None of a program in which blocks name what changes."""
    metal = np.flatnonzero(nc.deposit & (nc.kind != RAPID))
    places = lines_of(nc, metal)
    lacking = [
        (file, line, absent)
        for file, line in places
        if not _PLAIN.match(block := lines[file][line - 1]) and (absent := _absent(block))
    ]
    whole = len(places) - len(lacking)
    if whole < MOST_WHOLE * len(places):
        return None
    what = f"as {whole} other blocks of beads do"
    return [
        (f"{nc.files[file].name}:{line}", f"names no {' and no '.join(absent)}, {what}")
        for file, line, absent in lacking
    ]


def _half_ways(nc: NCProgram, lines: list[list[bytes]]) -> Faults:
    """Rapids that name one axis of the plane, where nearly all others name both: the bead behind one begins elsewhere."""
    rows = np.flatnonzero((nc.kind == RAPID) & (nc.layer >= 0))
    absent = [(place, _absent(lines[place[0]][place[1] - 1])) for place in lines_of(nc, rows)]
    across = [(place, axes) for place, axes in absent if axes != ["X", "Y"]]
    half = [(place, axes) for place, axes in across if axes]
    if len(half) > max(FEW, (1.0 - MOST_WHOLE) * len(across)) or len(across) < LEAST_WHOLE * len(half):
        return []  # A program in which blocks name what changes.
    what = f"as {len(across) - len(half)} others do"
    return [
        (f"{nc.files[file].name}:{line}", f"a rapid names no {axes[0]}, {what}")
        for (file, line), axes in half
    ]


def _ways(nc: NCProgram, lines: list[list[bytes]]) -> Faults:
    """Beads to which the tool rises and descends without a rapid in X or Y between."""
    beads = nc.beads
    before = np.concatenate([[-1], beads.last[:-1]]) if len(beads) else beads.last
    bare, hops = [], 0
    for after, first in zip(before.tolist(), beads.first.tolist(), strict=True):
        rapids = [row for row in range(after + 1, first) if nc.kind[row] == RAPID]
        codes = [lines[nc.file[row]][nc.line[row] - 1] for row in rapids]
        hops += bool(codes)
        if codes and all(_absent(code) == ["X", "Y"] for code in codes):
            what = "is reached by a rise and a descent on one spot: the way to it is missing"
            bare.append((nc.where(first), what))
    return bare if len(bare) <= max(FEW, (1.0 - MOST_WHOLE) * hops) else []


def _absent(line: bytes) -> list[str]:
    """Axes of the plane that a block does not name."""
    if b";" in line or b"(" in line:
        line = _ASIDE.sub(b"", line)
    code = line.upper()
    if b"X" in code and b"Y" in code:
        return []
    return [axis for axis in "XY" if axis.encode() not in code]
