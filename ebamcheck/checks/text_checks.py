"""Checks of a program's text, that what it says of itself is true, and of a program that begins at a layer.

Nothing rests on comments, and a program without them is judged alike; one that says something untrue is refused, since a person
reads them at the control. A program that begins at a layer is the end of the whole one, which was proved: motion by motion, value
by value."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.checks.checks import PLACE_MM, PRINTED, Faults, count_check, limit_check, lines_of, place_of
from ebamcheck.checks.state_checks import machine_state_checks
from ebamcheck.nc.codes import BEAM_VALUES
from ebamcheck.nc.control import control
from ebamcheck.nc.conventions import comment, header_lines
from ebamcheck.nc.files import (
    NOT_VALIDATED,
    STATUS_LINES,
    VALIDATED,
    ProgramFiles,
    layer_of_preheat,
    mark_validated,
    status_of,
)
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.nc.motions import RAPID, NCProgram, SourceFile
from ebamcheck.nc.timeline import Kind
from ebamcheck.printable import printable
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings

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

    longest, where = 0, ""
    for one in nc.files:
        for number, line in enumerate(one.data.split(b"\n"), start=1):
            if len(line) > longest:
                longest, where = len(line), f"{one.name}:{number}"
    text = f"longest block has {longest} characters"
    checks = [
        count_check("encoding", each(_encoding), "printable ASCII throughout"),
        count_check("line ends", each(_line_ends), "every block ends with LF alone"),
        Check("block length", longest < BLOCK_LIMIT, longest, BLOCK_LIMIT - 1, "characters", where, text),
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
        found = {file.name: hashlib.sha256(file.data).hexdigest() for file in nc.files}
        others = [name for name in found if sha256.get(name) != found[name]]
        why = ("is not among the files recorded", "its bytes are not those recorded")
        faults = [(f"{name}:1", why[name in sha256]) for name in others]
        missing, main = [name for name in sha256 if name not in found], nc.files[0].name
        faults += [(f"{main}:1", f"{name} was recorded but is not run") for name in missing]
        checks.append(count_check("unchanged", faults, "SHA-256 of every file as recorded"))
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
    """Calls of what is no layer of this program (MAIN_L0001 and on), or of one out of its order or twice; layers that are not
    called."""
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


def words_check(nc: NCProgram) -> Check:
    """Check that no block of a bead lacks an axis that nearly all others name, and no way to a bead lacks its place or half of
    it."""
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
    return [(f"{nc.files[file].name}:{line}", f"a rapid names no {axes[0]}, {what}") for (file, line), axes in half]


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


# Lines of the header that do not follow from the settings and the program's own text.
FREE = ("SOFTWARE", "SETTINGS SHA-256")
# Lines that follow from the program's own text, or are known of it.
OF_THE_TEXT = ("LAYERS", "PART SHA-256", "SETTINGS SHA-256")
TOLD, LETTERS = 3, 12  # Differing settings that are told, and letters of a hash
_LAYER = re.compile(rb"^(?:; |\()LAYER: (\d+) OF (\d+)(?:, CUT AT (-?[\d.]+), Z (-?[\d.]+))?", re.MULTILINE)
MEGABYTE = 1e6
MARK, NOT = b"VALIDATED", b"NOT "  # What a validated program says, and what it loses when marked


@dataclass(frozen=True)
class Truth:
    """What is known of a program from elsewhere; None for what is not."""

    validated: bool | None = None
    part_sha256: str | None = None
    settings_sha256: str | None = None
    # Hash of settings that were given by someone, who need not have those that the program was made with.
    given_sha256: str | None = None
    # Which of the settings given are not those that the program was made with, where both are known, in words.
    differences: tuple[str, ...] = ()


def header_checks(nc: NCProgram, config: Config, truth: Truth, heights: ArrayLike | None = None) -> list[Check]:
    """Check status and header of a program against settings, text, and what is known of it from elsewhere."""
    faults = [*_header(nc, config, truth), *_layers(nc, heights, config)]
    # Settings that name no control name the default one.
    if config.machine.control not in (nc.dialect, MachineSettings.model_fields["control"].default):
        what = f"is read as one of {nc.dialect}, machine.control is {config.machine.control}"
        faults.insert(0, (f"{nc.files[0].name}:1", what))
    header = count_check("header", faults, f"true{_other_settings(nc, truth)}")
    return [status_check(nc, truth), header, _size(nc, config)]


def status_check(nc: NCProgram, truth: Truth) -> Check:
    """Check that main program and layers have a status where any file has, the same in all, and the recorded one."""
    said = [(file, *_status_of(file)) for file in nc.files]
    told = [(file, status, line) for file, status, line in said if status is not None]
    faults = [
        (f"{file.name}:1", "has comments and no status in its first lines")
        for file, status, _ in said
        if status is None and (_LAYER.search(file.data) is not None or (told and file is nc.files[0]))
    ]
    most = 2 * sum(status for _, status, _ in told) > len(told)
    wanted = most if truth.validated is None else truth.validated
    words = {True: "VALIDATED", False: "NOT VALIDATED"}
    faults += [
        (f"{file.name}:{line}", f"says {words[status]}, the program is {words[wanted]}")
        for file, status, line in told
        if status != wanted
    ]
    return count_check("status", faults, "the same in every file, and as recorded")


def _status_of(file: SourceFile) -> tuple[bool | None, int]:
    """Status of a file, and its line; None where it has none."""
    found = status_of(file.data)
    return (None, 0) if found is None else (found[0] == MARK, file.data.count(b"\n", 0, found.start()) + 1)


def _header(nc: NCProgram, config: Config, truth: Truth) -> Faults:
    layers = len(nc.layer_files)
    told = sum(len(_LAYER.findall(file.data)) for file in nc.files)
    if nc.header.get("LAYERS") == str(told):
        layers = told  # a layer without a bead is no level of Z
    known = header_lines(config, control(nc.dialect), layers)
    # As they stand in a comment of the control, which has no reserved characters and ends with its block.
    said = {key: control(nc.dialect).comment_text(comment(f"{key}: {value}")) for key, value in known.items()}
    wanted = {key: line.removeprefix(f"; {key}:").strip() for key, line in said.items() if key not in FREE}
    hashes = {"PART SHA-256": truth.part_sha256, "SETTINGS SHA-256": truth.settings_sha256}
    faults, file = [], nc.files[0]
    for key, value in (wanted | hashes).items():
        if value is not None and nc.header.get(key, value) != value:
            by = "in truth it is" if key in OF_THE_TEXT else "by the settings it is"
            where = place_of(file, max(file.data.find(f"{key}:".encode("ascii", "replace")), 0))
            faults.append((where, f"says {key}: {nc.header[key]}, {by} {value}"))
    return faults


def _other_settings(nc: NCProgram, truth: Truth) -> str:
    """What is told where the program was made with other settings than those by which it is judged: that is no fault."""
    said = nc.header.get("SETTINGS SHA-256")
    if said is None or truth.given_sha256 in (None, said):
        return ""
    more = len(truth.differences) - TOLD
    names = [*truth.differences[:TOLD], *([f"{more} more"] if more > 0 else [])]
    which = "; ".join(names) or "which ones, its text does not say"
    return (
        f"; made with other settings than those by which it is judged here, SETTINGS SHA-256 {said[:LETTERS]}..., not "
        f"{str(truth.given_sha256)[:LETTERS]}...: {which}"
    )


def _layers(nc: NCProgram, heights: ArrayLike | None, config: Config) -> Faults:
    """Comments at the head of layers: their number, in the order in which they come, their cut and their Z."""
    # Files in the order in which they run, the main one first.
    files, suffix = {file.name: file for file in nc.files}, control(nc.dialect).subprogram_suffix
    called = [f"{nc.events.said(i)}{suffix}" for i in np.flatnonzero(nc.events.kind == Kind.CALL).tolist()]
    order = [nc.files[0], *(files[name] for name in dict.fromkeys(called) if name in files)]
    found = [(file, layer) for file in order for layer in _LAYER.finditer(file.data)]
    cuts = np.asarray(() if heights is None else heights, np.float64)
    z, faults = deposition_heights(cuts, config.layer_height_mm, config.base_mm), []
    for k, (file, layer) in enumerate(found):
        said = f"layer {int(layer[1])} of {int(layer[2])}"
        true = f"layer {k + 1} of {len(found)}"
        wrong = said != true
        if not wrong and layer[3] and k < cuts.size:
            off_mm = max(abs(float(layer[3]) - cuts[k]), abs(float(layer[4]) - z[k]))
            wrong = off_mm > PRINTED
            said += f" cut at {float(layer[3]):.6f} mm, Z {float(layer[4]):.6f} mm"
            true += f" cut at {cuts[k]:.6f} mm, Z {z[k]:.6f} mm"
        if wrong:
            faults.append((place_of(file, layer.start()), f"says {said}, it is {true}"))
    return faults


def _size(nc: NCProgram, config: Config) -> Check:
    """Bytes of all files, as they are when they are validated, against the room on the control."""
    longer = len(NOT_VALIDATED) - len(VALIDATED)
    size = sum(len(file.data) - longer * (_status_of(file)[0] is False) for file in nc.files)
    megabytes = size / MEGABYTE
    limit = config.machine.program_limit_mb
    text = f"{megabytes:.3g} MB in {len(nc.files)} files"
    if limit is None:
        text += "; the profile sets no limit (machine.program_limit_mb)"
        return Check("size on the control", True, megabytes, megabytes, "MB", "", text)
    where = "" if megabytes <= limit else f"{nc.files[0].name}:1"
    return limit_check("size on the control", megabytes, limit, "MB", text, where)


def marked_validated(files: ProgramFiles) -> ProgramFiles:
    """Mark a program that was checked as validated; RuntimeError, and the files as they were, if more than its status has
    changed."""
    checked = {name: (files.folder / name).read_bytes() for name in files.names}
    made = mark_validated(files)
    for name, data in checked.items():
        if made.folder != files.folder or not is_marked(data, (made.folder / name).read_bytes()):
            for file, before in checked.items():
                (files.folder / file).write_bytes(before)
            raise RuntimeError(f"{made.folder / name}: more than its status has changed since it was checked")
    return made


def is_marked(checked: bytes, marked: bytes) -> bool:
    """Whether bytes are those that were checked, with the status of a program that is validated in one of its first lines."""
    at = next((i for i, (a, b) in enumerate(zip(checked, marked, strict=False)) if a != b), len(marked))
    if checked[at : at + len(NOT)] != NOT or not checked.startswith(MARK, at + len(NOT)):
        return False
    return marked == checked[:at] + checked[at + len(NOT) :] and checked[:at].count(b"\n") < STATUS_LINES


COLUMNS = ("kind", "feed_mm_min", "beam", "wire", "power_w", "wire_mm_s")
VALUES = (*BEAM_VALUES, "wire_mm_s")
GEOMETRY = ("end", "coefficients", "arc")


def entry_check(whole: NCProgram, entry: NCProgram, layer: int, z_mm: float, config: Config, validated: bool) -> Check:
    """Check a program that begins at a layer, from 1, against the whole one; it is to be called `validated` as that is."""
    faults = list(_faults(whole, entry, layer, z_mm, config, Truth(validated)))
    good = f"{len(entry)} motions from layer {layer} on are those of the whole program"
    return count_check("entry", faults, good)


def _faults(
    whole: NCProgram, entry: NCProgram, layer: int, z_mm: float, config: Config, truth: Truth
) -> Iterator[tuple[str, str]]:
    made = (status_check(entry, truth), *text_checks(entry, config), *machine_state_checks(entry, config))
    for check in made:
        if not check.passed:
            yield check.where, f"{check.name}: {check.text}"
    main = f"{entry.files[0].name}:1"
    laid = np.flatnonzero(entry.deposit)
    if len(entry) > len(whole) or not laid.size:
        yield main, f"{len(entry)} motions, the whole program has {len(whole)}"
        return
    offset = len(whole) - len(entry)
    before = np.flatnonzero(whole.deposit[:offset])
    first, lower = int(laid[0]), before.size and not whole.end[before[-1], 2] < z_mm - PLACE_MM
    if not abs(entry.end[first, 2] - z_mm) <= PLACE_MM or lower:
        yield entry.where(first), f"begins at Z {entry.end[first, 2]:g}, layer {layer} lies at {z_mm:g}"
    # First motion that is another than that of the whole program; places that nothing has given yet are left to the way in.
    alike = np.ones(len(entry), np.bool_)
    for name in COLUMNS:
        alike &= _same(getattr(entry, name), getattr(whole, name)[offset:])
    unknown = ~np.isfinite(entry.start).all(axis=1)
    for name in GEOMETRY:
        mine, other = getattr(entry, name), getattr(whole, name)[offset:]
        same = _same(mine, other).reshape(len(entry), -1)
        given = ~np.isnan(mine).reshape(len(entry), -1)
        alike &= np.where(unknown, (same | ~given).all(axis=1), same.all(axis=1))
    # The wire's speed of before is set anew with the first bead.
    idle = ~entry.wire & ~whole.wire[offset:] & ~entry.beam
    same_way = (entry.kind == whole.kind[offset:]) & (idle & (entry.kind == RAPID))
    alike |= same_way & _same(entry.end, whole.end[offset:]).all(axis=1)
    alike |= same_way & unknown
    for row in np.flatnonzero(~alike)[:1].tolist():
        yield entry.where(row), "is another motion, or at other values, than in the whole program"
    yield from _other_events(whole, entry, offset, first)
    # What the way to the first bead does that is no rise, travel and descent by rapids, beam and wire off.
    way = np.arange(first)
    rise = z_mm + config.machine.clearance_mm
    bad = (entry.kind[way] != RAPID) | entry.beam[way] | entry.wire[way]
    for row in way[bad][:1].tolist():
        yield entry.where(row), "the way to the first bead is none of rapids with beam and wire off"
    if not way.size or not entry.end[0, 2] >= rise or not np.isnan(entry.end[0, :2]).all():
        yield entry.beginning, f"does not begin with a rise to Z {rise:g} or above, from wherever the tool is"
    low = np.fmin(entry.start[way[1:], 2], entry.end[way[1:], 2]) < rise
    start, end = entry.start[way[1:], :2], entry.end[way[1:], :2]
    aside = ~((start == end) & (end == entry.start[first, :2])).all(axis=1)
    for row in way[1:][low & aside][:1].tolist():
        yield entry.where(row), f"goes below Z {rise:g} elsewhere than over the first bead"
    if not _same(entry.start[first], whole.start[first + offset]).all():
        what = "the first bead begins at another place than in the whole program, or at one that nothing has given"
        yield entry.where(first), what


def _other_events(whole: NCProgram, entry: NCProgram, offset: int, first: int) -> Iterator[tuple[str, str]]:
    """First wait, switch or value from the first bead on that the whole program does not have there, or has otherwise."""
    # Motions alone tell nothing of waits, without which the part is too warm where the next bead comes.
    at = [np.flatnonzero(nc.events.row >= row) for nc, row in ((entry, first), (whole, first + offset))]
    for name in VALUES:
        # What was set last before the motion; NaN where nothing was.
        both = ((entry, first), (whole, first + offset))
        mine, other = (nc.events.chosen(nc.events.row <= row).set_before(name)[-1:] for nc, row in both)
        if not _same(mine, other).all():
            what = f"{name} is {mine[0]:g} at the first bead, {other[0]:g} in the whole program"
            yield entry.where(first), what
    count = min(at[0].size, at[1].size)
    a, b = entry.events.chosen(at[0][:count]), whole.events.chosen(at[1][:count])
    alike = (a.row + offset == b.row) & _same(a.value, b.value)
    alike &= np.array([one == two for one, two in zip(a.name, b.name, strict=True)], np.bool_)
    if not alike.all():
        i = int(np.argmin(alike))
        told = f"{a.name[i]} {a.value[i]:g}, in the whole program {b.name[i]} {b.value[i]:g}"
        yield entry.where_event(int(at[0][i])), f"has {told} there, or at another motion"
    elif at[0].size > count:
        i = int(at[0][count])
        yield entry.where_event(i), f"has {entry.events.name[i]} in place of nothing"
    elif at[1].size > count:
        place = entry.where_event(int(at[0][-1]) if count else 0)
        yield place, f"lacks {whole.events.name[at[1][count]]} in place of nothing"


def _same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray((a == b) | (np.isnan(a) & np.isnan(b)) if a.dtype.kind == "f" else a == b)
