"""Strict reader of STL files, and writer of binary ones; what is truncated, or has a wrong count or number, is refused with its
place. A file whose size fits its facet count is binary, whatever its header says."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError
from ebamcheck.kernels import Ints, kernel
from ebamcheck.mesh.reading import checked_finite, decimal_comma, how_to_read, is_number

HEADER_BYTES = 84
FACET_BYTES = 50
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_ASCII_START = re.compile(rb"\s*solid[^\r\n]*[\r\n]\s*(facet|endsolid)\s", re.IGNORECASE)
_FACET_BEHIND = rb"(?=facet[ \t]+normal[ \t]+(?:[-+.\d]|nan))"
_ONE_LINE = re.compile(rb"\s*solid\b[^\r\n]*?[ \t]" + _FACET_BEHIND, re.IGNORECASE)
_NAME_END = re.compile(rb"(\bsolid\b[^\r\n]*?)[ \t]" + _FACET_BEHIND, re.IGNORECASE)
_SOLID_FACET = rb"solid\b[^\r\n]*?[ \t]" + _FACET_BEHIND
_SOLID_BEHIND = re.compile(rb"(\bendsolid\b[^\r\n]*?)[ \t](?=" + _SOLID_FACET + rb")", re.IGNORECASE)

# First bytes of other files that people save as .stl, with what to tell them
FOREIGN = (
    (b"version https://git-lfs", "a Git LFS pointer, not the file it stands for: run `git lfs pull`"),
    (b"\x1f\x8b", "a gzip archive: unpack it first"),
    (b"PK\x03\x04", "a zip archive (a 3MF file, perhaps): unpack it, or name it .3mf"),
    (b"<", "a page or an XML file, not a mesh: was the download answered by an error page?"),
    (b"ply", "a PLY file: name it .ply"),
    (b"ISO-10303-21", f"a STEP file, whatever its name: it {how_to_read('.step')}"),
    (b"glTF", f"a glTF file, whatever its name: it {how_to_read('.glb')}"),
    (b"OFF", f"an OFF file, whatever its name: it {how_to_read('.off')}"),
    (b"#VRML", f"a VRML file, whatever its name: it {how_to_read('.wrl')}"),
    (b"3D Geometry File Format", f"a Rhino file, whatever its name: it {how_to_read('.3dm')}"),
    (b"**ABCDEFGHIJKLMNOPQRSTUVWXYZ", f"a Parasolid file, whatever its name: it {how_to_read('.x_t')}"),
)


def read_triangles(data: bytes | memoryview, name: str) -> tuple[NDArray[np.float32], list[str]]:
    """Corner points of the facets of an STL file, (F, 3, 3) in its unit, and harmless irregularities."""
    if not data:
        raise InputError(f"{name}: is empty (0 bytes)")
    head = bytes(data[:HEADER_BYTES])
    expected = HEADER_BYTES + FACET_BYTES * binary_count(head)
    blank = True
    if len(data) != expected:
        data = bytes(data)
        if looks_like_ascii(data):
            return _ascii(data, name), []
        if _ONE_LINE.match(data.removeprefix(BYTE_ORDER_MARK)):
            return _ascii(_names_ended(data), name), []
        refuse_foreign(data, name)
        blank = not data[expected:].strip(b"\0 \t\r\n")
    count, notes = checked_count(head, len(data), name, blank)
    halves = np.frombuffer(data, np.uint16, count * FACET_BYTES // 2, HEADER_BYTES).reshape(count, -1)
    return facet_corners(halves, name), notes


def binary_count(head: bytes) -> int:
    """Number of facets by the first 84 bytes of a binary file; 0 where there are fewer."""
    return int.from_bytes(head[80:HEADER_BYTES], "little") if len(head) == HEADER_BYTES else 0


def checked_count(head: bytes, size: int, name: str, blank: bool = False) -> tuple[int, list[str]]:
    """Number of facets of a binary file, whose bytes behind the last may be `blank`, and harmless irregularities."""
    count = binary_count(head)
    more = size - HEADER_BYTES - FACET_BYTES * count
    if size < HEADER_BYTES:
        raise InputError(f"{name}: is no STL file: {size} bytes, under the 84 of a binary header, and no ASCII 'solid'")
    if more < 0:
        room = (size - HEADER_BYTES) // FACET_BYTES
        raise InputError(
            f"{name}: truncated or not an STL file: byte 80 counts {count} facets, which need {size - more} bytes, "
            f"but there are {size} (room for {room} facets)"
        )
    if more >= FACET_BYTES and not blank:
        raise InputError(
            f"{name}: byte 80 counts {count} facets, but {more} bytes follow the last one: wrong count, or files joined end to end"
        )
    if count == 0:
        raise InputError(f"{name}: holds no facet (binary STL with count 0)")
    return count, [f"{more} bytes after the last facet were ignored"] if more else []


def refuse_foreign(start: bytes, name: str) -> None:
    """Refuse a file that begins like another format; the message names that."""
    for first_bytes, what in FOREIGN:
        if start.removeprefix(BYTE_ORDER_MARK).lstrip().startswith(first_bytes):
            raise InputError(f"{name}: is {what}")


def facet_corners(facets: NDArray[np.uint16], name: str, first: int = 0) -> NDArray[np.float32]:
    """Corner points (F, 3, 3) of facets given as 16-bit words (F, 25), the first of which has the number `first` in its file."""
    # The normal has six words, the attribute one.
    corners = facets[:, 6:-1].copy().view(np.float32).reshape(-1, 3, 3)
    return checked_finite(corners, name, first)


def looks_like_ascii(data: bytes) -> bool:
    """Whether the first line opens a solid, as many binary headers do, and the next word may follow in an ASCII file."""
    text = data.removeprefix(BYTE_ORDER_MARK)
    is_short = len(data) < HEADER_BYTES and text.lstrip()[:5].lower() == b"solid"
    return is_short or bool(_ASCII_START.match(text))


def _names_ended(data: bytes) -> bytes:
    """Mark the end of a solid's name where ``facet normal`` with a number follows on the same line; the length stays."""
    return _SOLID_BEHIND.sub(b"\\1\x0b", _NAME_END.sub(b"\\1\x0b", data))


# -- ASCII: one compiled pass finds every number, one vectorised pass converts them ------------------

# Words of one facet in order; an empty one is a number
_WORDS = (
    b"facet", b"normal", b"", b"", b"", b"outer", b"loop",
    b"vertex", b"", b"", b"", b"vertex", b"", b"", b"", b"vertex", b"", b"", b"", b"endloop", b"endfacet",
)  # fmt: skip

_WORD_TABLE = np.zeros((len(_WORDS), 8), np.uint8)
for _row, _word in enumerate(_WORDS):
    _WORD_TABLE[_row, : len(_word)] = np.frombuffer(_word, np.uint8)
_WORD_SIZES = np.array([len(w) for w in _WORDS])
# Bytes of the shortest facet that can be written; bounds the number of facets before parsing
_SHORTEST_FACET = 75

_DONE, _WANT_SOLID, _WANT_WORD, _BAD_NUMBER, _CUT, _CONTROL = 0, 1, 2, 3, 4, 5


@kernel
def _is_word(text: NDArray[np.uint8], start: int, stop: int, word: NDArray[np.uint8], size: int) -> bool:
    """Whether ``text[start:stop]`` is the lower-case `word`, ignoring case."""
    if stop - start != size:
        return False
    for i in range(size):  # noqa: SIM110 (generators do not compile)
        if (text[start + i] | 0x20) != word[i]:
            return False
    return True


@kernel
def _scan(
    text: NDArray[np.uint8], words: NDArray[np.uint8], sizes: Ints, solid: NDArray[np.uint8],
    endsolid: NDArray[np.uint8], starts: Ints, stops: Ints,
) -> tuple[int, int, int, int]:  # fmt: skip
    """Find the coordinates of all facets: (status, facets, position and expected word of the error)."""
    n = text.size
    i = 0
    facets = 0
    in_solid = False
    step = 0
    while True:
        while i < n and (text[i] == 32 or 9 <= text[i] <= 13):
            i += 1
        if i == n:
            return (_CUT if in_solid else _DONE), facets, i, step
        start = i
        while i < n and not (text[i] == 32 or 9 <= text[i] <= 13):
            if text[i] < 32 or text[i] == 127:
                return _CONTROL, facets, i, step
            i += 1
        if not in_solid:
            if not _is_word(text, start, i, solid, 5):
                return _WANT_SOLID, facets, start, step
            in_solid = True
            while i < n and text[i] != 10 and text[i] != 11 and text[i] != 13:
                i += 1
            continue
        if step == 0 and _is_word(text, start, i, endsolid, 8):
            in_solid = False
            while i < n and text[i] != 10 and text[i] != 11 and text[i] != 13:
                i += 1
            continue
        if sizes[step] > 0:
            if not _is_word(text, start, i, words[step], sizes[step]):
                return _WANT_WORD, facets, start, step
        elif step > 4:
            for j in range(start, i):
                c = text[j]
                if not (48 <= c <= 57 or c == 43 or c == 45 or c == 46 or c == 69 or c == 101):
                    return _BAD_NUMBER, facets, start, step
            # Words 8-10, 12-14 and 16-18 of a facet are the coordinates of its three vertices.
            index = (step - 8) // 4 * 3 + (step - 8) % 4
            starts[facets * 9 + index] = start
            stops[facets * 9 + index] = i
        step += 1
        if step == sizes.size:
            step = 0
            facets += 1


@kernel
def _copy_tokens(text: NDArray[np.uint8], starts: Ints, stops: Ints, table: NDArray[np.uint8]) -> None:
    for row in range(starts.size):
        for j in range(stops[row] - starts[row]):
            table[row, j] = text[starts[row] + j]


def _ascii(data: bytes, name: str) -> NDArray[np.float32]:
    text = np.frombuffer(data.removeprefix(BYTE_ORDER_MARK), np.uint8)
    room = (text.size // _SHORTEST_FACET + 1) * 9
    starts, stops = np.zeros(room, np.int64), np.zeros(room, np.int64)
    solid, endsolid = (np.frombuffer(word, np.uint8) for word in (b"solid", b"endsolid"))
    status, facets, at, step = _scan(text, _WORD_TABLE, _WORD_SIZES, solid, endsolid, starts, stops)
    if status != _DONE:
        _refuse_ascii(text, name, status, facets, at, step)
    if facets == 0:
        raise InputError(f"{name}: holds no facet (ASCII STL)")
    starts, stops = starts[: facets * 9], stops[: facets * 9]
    width = int((stops - starts).max())
    table = np.zeros((facets * 9, width), np.uint8)
    _copy_tokens(text, starts, stops, table)
    tokens = table.view(f"S{width}").reshape(-1)
    try:
        values = tokens.astype(np.float64)
    except ValueError:
        bad = next(i for i, token in enumerate(tokens) if not is_number(token))
        _refuse_number(text, name, int(starts[bad]), "is not a number")
    too_large = np.flatnonzero(~(np.abs(values) <= np.finfo(np.float32).max))
    if too_large.size:
        _refuse_number(text, name, int(starts[too_large[0]]), "is beyond the range of STL's 32-bit numbers")
    return values.astype(np.float32).reshape(-1, 3, 3)


def _refuse_ascii(text: NDArray[np.uint8], name: str, status: int, facets: int, at: int, step: int) -> NoReturn:
    if status == _BAD_NUMBER:
        _refuse_number(text, name, at, "is not a finite decimal number")
    expected = f"{_WORDS[step].decode()!r}" if _WORDS[step] else "a number"
    expected = expected if step else "'facet' or 'endsolid'"
    if status == _CUT:
        told = f"truncated: the file ends after {facets} facets where {expected} should follow"
    elif status == _CONTROL:
        told = f"byte {int(text[at]):#04x} does not belong in an ASCII STL"
    else:
        expected = "'solid' or the end of the file" if status == _WANT_SOLID else expected
        told = f"found {_token(text, at)!r}, expected {expected}"
    raise InputError(f"{name}: line {_line(text, at)}: {told}")


def _refuse_number(text: NDArray[np.uint8], name: str, at: int, why: str) -> NoReturn:
    token = _token(text, at)
    raise InputError(f"{name}: line {_line(text, at)}: vertex coordinate {token!r} {why}{decimal_comma(token)}")


def _token(text: NDArray[np.uint8], at: int) -> str:
    words = text[at : at + 40].tobytes().split()
    return words[0].decode("ascii", "replace") if words else ""


def _line(text: NDArray[np.uint8], at: int) -> int:
    before = text[:at].tobytes().replace(b"\r\n", b"\n")
    return before.count(b"\n") + before.count(b"\r") + 1


TITLE_BYTES = 80


def write_triangles(triangles: NDArray[np.floating], path: Path, name: str = "") -> None:
    """Write triangles (F, 3, 3), mm, in 32 bits, with their unit normals, 0 without area; equal parts give equal bytes."""
    facets = np.zeros(len(triangles), FACET)
    facets["corners"] = triangles
    corners = facets["corners"].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
    # Readers would take a file whose header begins with "solid" for ASCII.
    header = f"binary STL: {name}, mm" if name else "binary STL, mm"
    with path.open("wb") as file:
        file.write(header.encode("ascii", "replace")[:TITLE_BYTES].ljust(TITLE_BYTES))
        file.write(np.array(len(facets), "<u4").tobytes())
        facets.tofile(file)
