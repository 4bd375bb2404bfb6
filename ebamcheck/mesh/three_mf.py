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
from dataclasses import dataclass, field
from typing import Any
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
    "cura:support_mesh": "support", "cura:anti_overhang_mesh": "support blocker", "cura:infill_mesh": "modifier",
    "cura:cutting_mesh": "modifier",
}  # fmt: skip
Key = tuple[str, str]  # an object: its model part, in lower case, and its number there


@dataclass
class Outline:
    """What a 3MF file says of itself."""

    unit: str = ""  # its unit by our short name; empty: it states none
    items: int = 0  # build items
    unprintable: list[int] = field(default_factory=list)  # those of them that are marked as not to be printed
    # What of each object is no part of the solid: first and last facet (-1: to the end), and its kind
    volumes: dict[Key, list[tuple[int, int, str]]] = field(default_factory=dict)
    # Whole objects that are no part of the solid: wherever they stand (the object), or in one assembly (assembly, object)
    marked: dict[tuple[Key, ...], str] = field(default_factory=dict)
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
        return _Package(data, name).outline()
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        raise InputError(f"{name}: cannot be read as 3MF: no whole zip archive: {_short(error)}") from None
    except (UnicodeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: cannot be read as 3MF: {_short(error)}") from None


def _short(told: object) -> str:
    """Words of a file, or of an error that may hold some, in one line of usual length."""
    return printable(" ".join(str(told).split()), 160).lstrip("/")


def _absolute(path: str) -> str:
    """Name of a file of the package as relations name it: from its root, in lower case."""
    return posixpath.normpath("/" + path.replace("\\", "/").lstrip("/")).lower()


class _Package:
    """The archive of a 3MF file, and the model parts in it, by their names in the package."""

    def __init__(self, data: bytes | memoryview, name: str) -> None:
        self.name = name
        self.archive = zipfile.ZipFile(io.BytesIO(data))
        self.parts: dict[str, _ModelPart] = {}
        self._check_sizes(len(data))
        self.files: dict[str, zipfile.ZipInfo] = {}
        for entry in self.archive.infolist():
            if entry.is_dir():
                continue
            path = _absolute(entry.filename)
            if path in self.files:
                raise self._refused(
                    f"holds two files of the name {_short(path)}, which 3MF reads without regard to case: export it anew"
                )
            self.files[path] = entry

    def _refused(self, why: str) -> InputError:
        return InputError(f"{self.name}: {why}")

    def _check_sizes(self, packed: int) -> None:
        entries = self.archive.infolist()
        unpacked = self.unpacked_bytes
        if len(entries) > MOST_ENTRIES:
            raise self._refused(f"holds {len(entries)} files, over {MOST_ENTRIES}: export it anew")
        if unpacked > MOST_BYTES or (unpacked > FREE_BYTES and unpacked > MOST_RATIO * packed):
            raise self._refused(
                f"{packed * 1e-6:.3g} MB would unpack to {unpacked * 1e-6:.6g} MB, which is no mesh that can be built "
                f"(at most {MOST_BYTES * 1e-6:.0f} MB, and {MOST_RATIO} times the file): export it anew"
            )

    @property
    def unpacked_bytes(self) -> int:
        """Bytes of all files, unpacked."""
        return sum(entry.file_size for entry in self.archive.infolist())

    def outline(self) -> Outline:
        """Read all but the meshes."""
        root = self._root()
        top = self.parts[root] = self._read_part(root)
        for path, _ in [key for keys in top.objects.values() for key in keys] + [key for key, _ in top.items]:
            if path not in self.parts:
                self.parts[path] = self._read_part(path)
        self._check_units(top.unit or "millimeter")
        self._check_copies(root)
        found = Outline(
            known_as(top.unit) if top.unit else "",
            len(top.items),
            [k for k, (_, printed) in enumerate(top.items) if not printed],
            unpacked_bytes=self.unpacked_bytes,
        )
        for path, part in self.parts.items():
            found.marked |= {((path, number),): kind for number, kind in part.marked.items()}
        for path, entry in self.files.items():
            if path.startswith("/metadata/") and path.endswith(".config"):
                try:
                    _add_volumes(self.archive.read(entry), path, root, top, found)
                except expat.ExpatError as error:
                    raise self._refused(
                        f"{_short(entry.filename)}, in which a slicer marks negative volumes and modifiers, is no well-formed XML: {error}: save it anew in its slicer"
                    ) from None
        kinds = [(keys[-1], kind) for keys, kind in found.marked.items()]
        kinds += [(key, kind) for key, volumes in found.volumes.items() for _, _, kind in volumes]
        for (_, number), kind in kinds:
            if kind == CUT:
                raise self._refused(
                    f"object {number} has a negative volume, which its slicer alone cuts off: apply it there (as a mesh boolean), and export the result"
                )
        return found

    def _root(self) -> str:
        found: list[str] = []

        def start(tag: str, values: dict[str, str]) -> None:
            if tag.endswith(" Relationship") and values.get("Type") == ROOT_MODEL:
                found.append(_absolute(values.get("Target", "")))

        self._parse("/_rels/.rels", start)
        if not found:
            raise self._refused("names no model among its relations (_rels/.rels): export it anew")
        if len(found) > 1:
            raise self._refused(
                f"names {len(found)} models to start from among its relations (_rels/.rels), {_short(found[0])} and {_short(found[1])}, and 3MF has one: export it anew"
            )
        return found[0]

    def _read_part(self, path: str) -> _ModelPart:
        """Read the tags of a model part that are no vertices or facets."""
        part, open_object, marking = _ModelPart(), "", ""

        def start(tag: str, values: dict[str, str]) -> None:
            nonlocal open_object, marking
            space, _, local = tag.rpartition(" ")
            if space != CORE:
                return
            if local == "model":
                part.unit = values.get("unit", "")
            elif local == "object":
                open_object = values.get("id", "")
                part.objects[open_object] = []
            elif local == "vertex":
                _check_numbers("a vertex", [values[axis] for axis in "xyz" if axis in values])
            elif local in ("component", "item"):
                _check_numbers("a transform", values.get("transform", "").split())
                key = _absolute(values.get(PATH, path)), values.get("objectid", "")
                if local == "component":
                    part.objects.setdefault(open_object, []).append(key)
                else:
                    marks = [values[k] for k in values if k.rpartition(" ")[2] == "printable"]
                    part.items.append((key, not any(m.strip().lower() in ("0", "false") for m in marks)))
            elif local == "metadata":
                marking = CURA.get(values.get("name", ""), "")

        def text(words: str) -> None:
            if marking and words.strip().lower() in ("true", "1"):
                part.marked[open_object] = marking

        def end(_: str) -> None:
            nonlocal marking
            marking = ""

        self._parse(path, start, text, end)
        return part

    def _parse(self, path: str, start: Any, text: Any = None, end: Any = None) -> None:
        """Read a file of XML in the package, without its vertices and facets."""
        if path not in self.files:
            raise self._refused(f"holds no {_short(path)}: no whole 3MF file")
        parser = expat.ParserCreate(namespace_separator=" ")
        parser.StartElementHandler, parser.CharacterDataHandler, parser.EndElementHandler = start, text, end
        parser.StartDoctypeDeclHandler = _no_doctype
        try:
            with self.archive.open(self.files[path]) as file:
                while chunk := file.read(CHUNK):
                    parser.Parse(BULK.sub(b"", chunk), False)
            parser.Parse(b"", True)
        except expat.ExpatError as error:
            raise self._refused(f"{_short(path)} is no well-formed XML: {error}") from None

    def _check_units(self, wanted: str) -> None:
        for path, part in self.parts.items():
            if part.unit and part.unit not in UNITS:
                raise self._refused(
                    f"its unit is {_short(part.unit)!r}, and 3MF knows {', '.join(UNITS)}: export it anew"
                )
            if (part.unit or "millimeter") != wanted:
                unit = part.unit or "millimeter (it states no unit)"
                raise self._refused(
                    f"{_short(path)} is in {unit}, and the model that it belongs to in {wanted}: export it anew"
                )

    def _check_copies(self, root: str) -> None:
        """Count the placed meshes: an object stands before those that contain it, and only the root has parts in other files."""
        count: dict[Key, int] = {}
        for path in sorted(self.parts, key=lambda path: path == root):
            for number, components in self.parts[path].objects.items():
                if lacking := [key for key in components if key not in count]:
                    raise self._refused(
                        f"object {_short(number)} is made of object {_short(lacking[0][1])}, which does not stand before it in the file: it holds no facet"
                    )
                count[path, number] = sum(count[key] for key in components) if components else 1
        items = [key for key, _ in self.parts[root].items]
        if lacking := [key for key in items if key not in count]:
            raise self._refused(
                f"a build item names object {_short(lacking[0][1])!r}, which the file does not hold: export it anew"
            )
        copies = sum(count[key] for key in items)
        if not copies:
            raise self._refused("holds no facet that is built: its build lists no item")
        if copies > MOST_COPIES:
            raise self._refused(
                f"its build places {copies:.6g} meshes, over {MOST_COPIES}: components that contain each other over and over, or too many items"
            )


def _check_numbers(what: str, told: list[str]) -> None:
    for text in told:
        if not re.fullmatch(rf"\s*{NUMBER}\s*", text, re.ASCII):
            raise ValueError(f"{what} has {_short(text)[:40]!r}, which is no number: export it anew")


def _no_doctype(*_: Any) -> None:
    raise ValueError("it declares a document type, which the format forbids")


def _add_volumes(text: bytes, path: str, root: str, top: _ModelPart, found: Outline) -> None:
    """Volumes that a slicer's own notes name: by ranges of facets (PrusaSlicer), or by components (Bambu Studio, OrcaSlicer)."""
    if not path.endswith(NOTES) and not text.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return  # Settings of the slicer, in other forms than XML.
    number, span = "", (0, -1)

    def start(tag: str, values: dict[str, str]) -> None:
        nonlocal number, span
        if tag == "object":
            number = values.get("id", "")
        elif tag == "volume":
            span = int(values.get("firstid", "0")), int(values.get("lastid", "-1"))
        elif tag == "metadata" and values.get("key") in ("volume_type", "modifier"):
            kind = MODIFIERS.get(values.get("value", ""), "")
            kind = "modifier" if values["key"] == "modifier" and values.get("value") == "1" else kind
            if kind and number in top.objects:
                found.volumes.setdefault((root, number), []).append((*span, kind))
        elif tag == "part" and (kind := MODIFIERS.get(values.get("subtype", ""), "")):
            for key in top.objects.get(number, []):
                if key[1] == values.get("id"):
                    found.marked[(root, number), key] = kind

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.Parse(text, True)


# Processor time that lib3mf gets, at least and for its text: some ten times what it takes for sound files
LEAST_SECONDS, BYTES_A_SECOND = 20, 2_000_000


def read_3mf(data: bytes | memoryview, name: str) -> tuple[NDArray[np.float64], list[str], str, str]:
    """Corners (F, 3, 3) of the facets that a 3MF file builds, in its unit; notes; the unit, and who states it."""
    outline = outline_of(data, name)
    with scratch_folder() as folder:
        (folder / "part.3mf").write_bytes(data)
        seconds = LEAST_SECONDS + outline.unpacked_bytes // BYTES_A_SECOND
        asked = {
            "file": str(folder / "part.3mf"),
            "corners": str(folder / "corners.npy"),
            "items": outline.items,
            "unprintable": outline.unprintable,
            "volumes": {"#".join(key): rows for key, rows in outline.volumes.items()},
            "marked": {" ".join(map("#".join, keys)): kind for keys, kind in outline.marked.items()},
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
    whose = FROM_FILE if outline.unit else FROM_FORMAT
    return checked_finite(corners, name), told["notes"], outline.unit or "mm", whose


def _why(done: subprocess.CompletedProcess[bytes], seconds: int) -> str:
    if done.returncode == -signal.SIGXCPU:
        return f"lib3mf takes more than {seconds} s of processor time for it"
    if done.returncode < 0:
        return (
            f"lib3mf ended with {signal.Signals(-done.returncode).name}: the file is damaged, or needs too much memory"
        )
    last = done.stderr.decode(errors="replace").strip().splitlines()
    return f"lib3mf cannot be used: {last[-1][:160] if last else f'exit code {done.returncode}'}"
