"""Reader of 3MF files: a look at the package, then lib3mf in a process of its own, with limits."""

from __future__ import annotations

import io
import json
import posixpath
import re
import signal
import subprocess
import sys
import zipfile
import zlib
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError
from ebamcheck.mesh.part import FROM_FILE, FROM_FORMAT
from ebamcheck.mesh.reading import checked_finite
from ebamcheck.printable import printable
from ebamcheck.scratch import scratch_folder
from ebamcheck.settings.base import known_as

MOST_ENTRIES = 10_000  # most files in the archive
MOST_BYTES = 2 << 30  # most bytes of all files in it, unpacked: about twenty million facets

# Meshes shrink to between a fifth and a fiftieth. An archive of more than that many bytes that shrinks far more holds no mesh
MOST_RATIO, FREE_BYTES = 200, 256 << 20

MOST_COPIES = 100_000  # most placed meshes: more come from components that contain each other over and over
CHUNK = 1 << 22  # bytes that are unpacked at a time

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PATH = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06 path"
ROOT_MODEL = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"

# Units that the format knows; without one it is the millimeter
UNITS = ("micron", "millimeter", "centimeter", "inch", "foot", "meter")
# A number of the format. lib3mf reads `40mm` as 40, and `1_0` as 1
NUMBER = r"[-+]?+(?:\d++\.?+\d*+|\.\d++)(?:[eE][-+]?+\d++)?+"
# Facets, and vertices of the usual form, nearly all of the text: a tag holds no other tag, so nothing else goes with them
BULK = re.compile(r'<(?:triangle\s[^<>]*|vertex(?:\s++[xyz]="N")++\s*+)/>'.replace("N", NUMBER).encode())
# Ends of the names of the files in which Bambu Studio and OrcaSlicer, and PrusaSlicer and its kin, write what each volume is
NOTES = ("/model_settings.config", "_model.config")

CUT = "negative volume"
# Kinds of volumes in the notes of PrusaSlicer, and of Bambu Studio and OrcaSlicer, that are no part of the solid
MODIFIERS = {
    "NegativeVolume": CUT, "negative_part": CUT, "ParameterModifier": "modifier", "modifier_part": "modifier",
    "SupportEnforcer": "support enforcer", "support_enforcer": "support enforcer",
    "SupportBlocker": "support blocker", "support_blocker": "support blocker",
}  # fmt: skip
# Metadata of objects by which Cura says the same
CURA = {
    "cura:support_mesh": "support",
    "cura:anti_overhang_mesh": "support blocker",
    "cura:infill_mesh": "modifier",
    "cura:cutting_mesh": "modifier",
}
Key = tuple[str, str]  # an object: its model part, in lower case, and its number there


class Volume(NamedTuple):
    """Facets of an object that are no part of the solid."""

    first: int
    last: int  # first and last facet; -1: to the end
    kind: str


@dataclass
class Outline:
    """What a 3MF file says of itself."""

    unit: str = ""  # its unit by our short name; empty: it states none
    items: int = 0  # build items
    unprintable: list[int] = field(default_factory=list)  # those of them that are marked as not to be printed
    # What of each object is no part of the solid
    volumes: dict[Key, list[Volume]] = field(default_factory=dict)
    marked: dict[tuple[Key, ...], str] = field(default_factory=dict)
    """Whole objects that are no part of the solid: wherever they stand (the object), or in one assembly (assembly, object)."""
    unpacked_bytes: int = 0


@dataclass
class _ModelPart:
    """One model part: its unit, and its objects with their components, in the order of the text."""

    unit: str = ""
    objects: dict[str, list[Key]] = field(default_factory=dict)
    # Object of each build item, and whether it is to be printed
    items: list[tuple[Key, bool]] = field(default_factory=list)
    marked: dict[str, str] = field(default_factory=dict)  # objects that Cura marks as no part of the solid


def outline_of(data: bytes | memoryview, name: str) -> Outline:
    """Look at a 3MF file before its meshes are read, and refuse what cannot be read exactly."""
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
        _check_sizes(archive, len(data), name)
        return _outline(archive, name)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        raise InputError(f"{name}: cannot be read as 3MF: no whole zip archive: {_short(error)}") from None
    except (UnicodeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: cannot be read as 3MF: {_short(error)}") from None


def _short(told: object) -> str:
    """Words of a file, or of an error that may hold some, in one line of usual length."""
    return printable(" ".join(str(told).split()), 160).lstrip("/")


def _check_sizes(archive: zipfile.ZipFile, packed: int, name: str) -> None:
    entries = archive.infolist()
    unpacked = sum(entry.file_size for entry in entries)
    if len(entries) > MOST_ENTRIES:
        raise InputError(f"{name}: holds {len(entries)} files, over {MOST_ENTRIES}: export it anew")
    if unpacked > MOST_BYTES or (unpacked > FREE_BYTES and unpacked > MOST_RATIO * packed):
        raise InputError(
            f"{name}: {packed * 1e-6:.3g} MB would unpack to {unpacked * 1e-6:.6g} MB, which is no mesh that can be built "
            f"(at most {MOST_BYTES * 1e-6:.0f} MB, and {MOST_RATIO} times the file): export it anew"
        )


def _outline(archive: zipfile.ZipFile, name: str) -> Outline:
    named = _named(archive, name)
    root = _root_of(archive, named, name)
    parts = {root: _read_part(archive, named, root, name)}
    used = [key for components in parts[root].objects.values() for key in components]
    for path, _ in [*used, *(key for key, _ in parts[root].items)]:
        if path not in parts:
            parts[path] = _read_part(archive, named, path, name)
    _check_units(parts, root, name)
    _check_copies(parts, root, name)
    top = parts[root]
    found = Outline(
        known_as(top.unit) if top.unit else "",
        len(top.items),
        [k for k, (_, printed) in enumerate(top.items) if not printed],
        unpacked_bytes=sum(entry.file_size for entry in archive.infolist()),
    )
    for path, part in parts.items():
        for number, kind in part.marked.items():
            found.marked[((path, number),)] = kind
    for path, entry in named.items():
        if path.startswith("/metadata/") and path.endswith(".config"):
            try:
                _add_volumes(archive.read(entry), path, root, top, found)
            except expat.ExpatError as error:
                raise InputError(
                    f"{name}: {_short(entry.filename)}, in which a slicer marks negative volumes and modifiers, is no well-formed XML: {error}: save it anew in its slicer"
                ) from None
    kinds = [(keys[-1], kind) for keys, kind in found.marked.items()]
    kinds += [(key, volume.kind) for key, volumes in found.volumes.items() for volume in volumes]
    for (_, number), kind in kinds:
        if kind == CUT:
            raise InputError(
                f"{name}: object {number} has a negative volume, which its slicer alone cuts off: apply it there (as a mesh boolean), and export the result"
            )
    return found


def _named(archive: zipfile.ZipFile, name: str) -> dict[str, zipfile.ZipInfo]:
    """Files of the archive by their names in the package; where two have the same, readers differ in which they take."""
    named: dict[str, zipfile.ZipInfo] = {}
    for entry in archive.infolist():
        if entry.is_dir():
            continue
        path = _absolute(entry.filename)
        if path in named:
            raise InputError(
                f"{name}: holds two files of the name {_short(path)}, which 3MF reads without regard to case: export it anew"
            )
        named[path] = entry
    return named


def _absolute(path: str) -> str:
    """Name of a file of the package as relations name it: from its root, in lower case."""
    return posixpath.normpath("/" + path.replace("\\", "/").lstrip("/")).lower()


def _root_of(archive: zipfile.ZipFile, named: dict[str, zipfile.ZipInfo], name: str) -> str:
    found: list[str] = []

    def start(tag: str, values: dict[str, str]) -> None:
        if tag.endswith(" Relationship") and values.get("Type") == ROOT_MODEL:
            found.append(_absolute(values.get("Target", "")))

    _parsed(archive, named, "/_rels/.rels", name, start)
    if not found:
        raise InputError(f"{name}: names no model among its relations (_rels/.rels): export it anew")
    if len(found) > 1:
        raise InputError(
            f"{name}: names {len(found)} models to start from among its relations (_rels/.rels), {_short(found[0])} and {_short(found[1])}, and 3MF has one: export it anew"
        )
    return found[0]


def _read_part(
    archive: zipfile.ZipFile, named: dict[str, zipfile.ZipInfo], path: str, name: str
) -> _ModelPart:
    """Read the tags of a model part that are no vertices or facets."""
    part, open_object, marking = _ModelPart(), [""], [""]

    def start(tag: str, values: dict[str, str]) -> None:
        space, _, local = tag.rpartition(" ")
        if space != CORE:
            return
        if local == "model":
            part.unit = values.get("unit", "")
        elif local == "object":
            open_object[0] = values.get("id", "")
            part.objects[open_object[0]] = []
        elif local == "vertex":
            _check_numbers("a vertex", [values[axis] for axis in "xyz" if axis in values])
        elif local in ("component", "item"):
            _check_numbers("a transform", values.get("transform", "").split())
            key = _absolute(values.get(PATH, path)), values.get("objectid", "")
            if local == "component":
                part.objects.setdefault(open_object[0], []).append(key)
            else:
                marks = [values[k] for k in values if k.rpartition(" ")[2] == "printable"]
                part.items.append((key, not any(mark.strip().lower() in ("0", "false") for mark in marks)))
        elif local == "metadata":
            marking[0] = CURA.get(values.get("name", ""), "")

    def text(words: str) -> None:
        if marking[0] and words.strip().lower() in ("true", "1"):
            part.marked[open_object[0]] = marking[0]

    def end(tag: str) -> None:
        marking[0] = ""

    _parsed(archive, named, path, name, start, text, end)
    return part


def _parsed(
    archive: zipfile.ZipFile,
    named: dict[str, zipfile.ZipInfo],
    path: str,
    name: str,
    start: Any,
    text: Any = None,
    end: Any = None,
) -> None:
    """Read a file of XML in the package, without its vertices and facets."""
    if path not in named:
        raise InputError(f"{name}: holds no {_short(path)}: no whole 3MF file")
    parser = expat.ParserCreate(namespace_separator=" ")
    parser.StartElementHandler, parser.CharacterDataHandler, parser.EndElementHandler = start, text, end
    parser.StartDoctypeDeclHandler = _no_doctype
    try:
        with archive.open(named[path]) as file:
            while chunk := file.read(CHUNK):
                parser.Parse(BULK.sub(b"", chunk), False)
        parser.Parse(b"", True)
    except expat.ExpatError as error:
        raise InputError(f"{name}: {_short(path)} is no well-formed XML: {error}") from None


def _check_numbers(what: str, told: list[str]) -> None:
    for text in told:
        if not re.fullmatch(rf"\s*{NUMBER}\s*", text, re.ASCII):
            raise ValueError(f"{what} has {_short(text)[:40]!r}, which is no number: export it anew")


def _no_doctype(*_: Any) -> None:
    raise ValueError("it declares a document type, which the format forbids")


def _check_units(parts: dict[str, _ModelPart], root: str, name: str) -> None:
    wanted = parts[root].unit or "millimeter"
    for path, part in parts.items():
        if part.unit and part.unit not in UNITS:
            raise InputError(
                f"{name}: its unit is {_short(part.unit)!r}, and 3MF knows {', '.join(UNITS)}: export it anew"
            )
        if (part.unit or "millimeter") != wanted:
            unit = part.unit or "millimeter (it states no unit)"
            raise InputError(
                f"{name}: {_short(path)} is in {unit}, and the model that it belongs to in {wanted}: export it anew"
            )


def _check_copies(parts: dict[str, _ModelPart], root: str, name: str) -> None:
    """Count the placed meshes: an object stands before those that contain it, and parts other than the root contain no further part."""
    count: dict[Key, int] = {}
    for path in [*(path for path in parts if path != root), root]:
        for number, components in parts[path].objects.items():
            if lacking := [key for key in components if key not in count]:
                raise InputError(
                    f"{name}: object {_short(number)} is made of object {_short(lacking[0][1])}, which does not stand before it in the file: it holds no facet"
                )
            count[path, number] = sum(count[key] for key in components) if components else 1
    of_items = Counter(key for key, _ in parts[root].items)
    if lacking := [key for key in of_items if key not in count]:
        raise InputError(
            f"{name}: a build item names object {_short(lacking[0][1])!r}, which the file does not hold: export it anew"
        )
    copies = sum(times * count[key] for key, times in of_items.items())
    if not copies:
        raise InputError(f"{name}: holds no facet that is built: its build lists no item")
    if copies > MOST_COPIES:
        raise InputError(
            f"{name}: its build places {copies:.6g} meshes, over {MOST_COPIES}: components that contain each other over and over, or too many items"
        )


def _add_volumes(text: bytes, path: str, root: str, top: _ModelPart, found: Outline) -> None:
    """Volumes that a slicer's own notes name: by ranges of facets (PrusaSlicer), or by components (Bambu Studio, OrcaSlicer)."""
    if not path.endswith(NOTES) and not text.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return  # Settings of the slicer, in other forms than XML.
    parser = expat.ParserCreate()
    number, span = [""], [(0, -1)]

    def start(tag: str, values: dict[str, str]) -> None:
        if tag == "object":
            number[0] = values.get("id", "")
        elif tag == "volume":
            span[0] = int(values.get("firstid", "0")), int(values.get("lastid", "-1"))
        elif tag == "metadata" and values.get("key") in ("volume_type", "modifier"):
            kind = MODIFIERS.get(values.get("value", ""), "")
            kind = "modifier" if values["key"] == "modifier" and values.get("value") == "1" else kind
            if kind and number[0] in top.objects:
                found.volumes.setdefault((root, number[0]), []).append(Volume(*span[0], kind))
        elif tag == "part" and (kind := MODIFIERS.get(values.get("subtype", ""), "")):
            for key in top.objects.get(number[0], []):
                if key[1] == values.get("id"):
                    found.marked[(root, number[0]), key] = kind

    parser.StartElementHandler = start
    parser.Parse(text, True)


# Processor time that lib3mf gets, at least and for its text: some ten times what it takes for sound files
LEAST_SECONDS, BYTES_A_SECOND = 20, 2_000_000


def read_3mf(data: bytes | memoryview, name: str) -> tuple[NDArray[np.float64], list[str], str, str]:
    """Read the facets that a 3MF file builds.

    They are corners (F, 3, 3) as placed by the build, in the file's unit; with what was left out, one line each, the unit, and
    whether the file states it or its format does.
    """
    outline = outline_of(data, name)
    with scratch_folder() as folder:
        (folder / "part.3mf").write_bytes(data)
        seconds = LEAST_SECONDS + outline.unpacked_bytes // BYTES_A_SECOND
        asked = {
            "file": str(folder / "part.3mf"),
            "corners": str(folder / "corners.npy"),
            "items": outline.items,
            "unprintable": outline.unprintable,
            "volumes": {f"{path}#{number}": rows for (path, number), rows in outline.volumes.items()},
            "marked": {
                " ".join(f"{path}#{number}" for path, number in keys): kind
                for keys, kind in outline.marked.items()
            },
            "seconds": seconds,
        }
        done = subprocess.run(
            [sys.executable, "-P", "-m", "ebamcheck.mesh.three_mf_meshes"],
            input=json.dumps(asked).encode(),
            capture_output=True,
            check=False,
        )
        if done.returncode:
            raise InputError(f"{name}: cannot be read as 3MF: {_why(done, seconds)}")
        told = json.loads(done.stdout)
        if "error" in told:
            raise InputError(f"{name}: cannot be read as 3MF: {told['error']}")
        corners = np.load(folder / "corners.npy")
    return (
        checked_finite(corners, name),
        told["notes"],
        outline.unit or "mm",
        FROM_FILE if outline.unit else FROM_FORMAT,
    )


def _why(done: subprocess.CompletedProcess[bytes], seconds: int) -> str:
    if done.returncode == -signal.SIGXCPU:
        return f"lib3mf takes more than {seconds} s of processor time for it"
    if done.returncode < 0:
        return f"lib3mf ended with {signal.Signals(-done.returncode).name}: the file is damaged, or needs too much memory"
    last = done.stderr.decode(errors="replace").strip().splitlines()
    return f"lib3mf cannot be used: {last[-1][:160] if last else f'exit code {done.returncode}'}"
