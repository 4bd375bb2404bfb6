"""Whether the part that is built is the one in its file: of that size, that way up, at its place, and no other.

An STL file is read again by other code than that of parts, and held against the part: how long it is along the slicing direction,
its surface, and how high the middle of that lies. Then every corner of every facet is turned and placed anew, as settings or plate
say."""

from __future__ import annotations

import cmath
import math
import re
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ebamcheck.checks.checks import SAME_SIZE, limit_check
from ebamcheck.kernels import Floats
from ebamcheck.mesh.files import read_facets
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import PlatePart
from ebamcheck.result import Check
from ebamcheck.settings.base import known_as
from ebamcheck.settings.config import Config

# Millimetres in one unit: the inch is exact since 1959. Written anew here.
UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "in": 25.4, "ft": 12.0 * 25.4}
# Bytes before the first facet of a binary STL file, and a facet.
HEAD, FACET = 84, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
STANDS = "does not stand where direction, turn and place say for the one"  # What is wrong with a part of which a corner is elsewhere
AT_ONCE = 500_000  # Facets that are held at once
# Corners of a facet in an ASCII STL file. A word by itself may be part of the name of the solid.
FACET_TEXT = re.compile(rb"\bloop" + 3 * (rb"\s+vertex" + 3 * rb"\s+(\S+)"), re.IGNORECASE)


class _MeshFile:
    """Facets of a file, mm. Those of a file that is not large are held: copies on a plate ask for them again and again."""

    def __init__(self, path: Path, unit: str | None) -> None:
        self.path, self._unit = path, unit
        self._held: list[Floats] | None = None

    def facets(self) -> Iterator[Floats]:
        """Corners (n, 3, 3) of its facets, mm, as the file has them."""
        if self._held is not None:
            yield from self._held
            return
        held, count = list[Floats](), 0
        for corners in self._read():
            count += len(corners)
            held = [*held, corners] if count <= AT_ONCE else []
            yield corners
        self._held = held if count <= AT_ONCE else None

    def _read(self) -> Iterator[Floats]:
        if self.path.suffix.lower() == ".stl":
            unit_mm = UNIT_MM[self._unit or "mm"]
            return (some * unit_mm for some in _facets_of(self.path))
        every, _, own, _ = read_facets(self.path)
        unit_mm = UNIT_MM[self._unit or own or "mm"]
        starts = range(0, len(every), AT_ONCE)
        return (np.asarray(every[k : k + AT_ONCE], np.float64) * unit_mm for k in starts)


@dataclass(frozen=True)
class _Body:
    """A part in its file: what points up there, the turn about the vertical (counter-clockwise seen from above), and its place.
    That is X and Y of the middle of its box, and Z of its lowest point, if that is told (None: it stays where it is)."""

    file: _MeshFile
    direction: tuple[float, ...]
    turn_deg: float
    place_mm: tuple[float, ...] | None


def file_check(part: Part, config: Config) -> Check:
    """Check that the part is as large as in its STL file, and stands as the settings say; of a part without a file nothing is
    said."""
    bodies = _bodies(part, config)
    if not bodies or not all(body.file.path.is_file() for body in bodies):
        return Check("part of the file", True, 0.0, SAME_SIZE, "of its size", "", "no file of the part")
    size = max(float(np.linalg.norm(part.size)), 1e-9)
    first, name, off = bodies[0], Path(part.source).name, dict[str, float]()
    found = wanted = (float(part.size[2]), 0.0, 0.0)
    if not isinstance(part, PlatePart) and first.file.path.suffix.lower() == ".stl":
        wanted = _measured(first.file.facets(), config.part.direction)
        blocks = (part.vertices[part.faces[k : k + AT_ONCE]] for k in range(0, len(part.faces), AT_ONCE))
        found = _measured(blocks, (0.0, 0.0, 1.0))
        off = {
            "is longer or shorter along the slicing direction than": abs(found[0] - wanted[0]) / size,
            "has another surface than": abs(found[1] - wanted[1]) / max(wanted[1], 1e-9),
            "does not stand as the slicing direction says for the one": abs(found[2] - wanted[2]) / size,
        }
    if max(off.values(), default=0.0) <= SAME_SIZE:
        off[STANDS] = _beside_mm(part, bodies, config) / size
    what = max(off, key=lambda name: off[name])
    value = off[what]
    if value <= SAME_SIZE:
        unit = "" if isinstance(part, PlatePart) else f" in {part.units}"
        text = f"{name}{unit}, {found[0]:.6g} mm high"
    elif math.isinf(value):
        text = f"the part has another number of facets than {name}"
    elif what == STANDS:
        text = f"the part {what} in {name}, but {value * size:.6g} mm beside that"
    else:
        text = f"the part {what} in {name}: {found[0]:.6g} mm high, {wanted[0]:.6g} mm in the file"
    return limit_check("part of the file", value, SAME_SIZE, "of its size", text)


def _bodies(part: Part, config: Config) -> list[_Body]:
    """Parts in their files, in the order of their facets; those of a plate by its own file, read anew."""
    if not part.source:
        return []
    source, own = Path(part.source), config.part
    if not isinstance(part, PlatePart):
        return [_Body(_MeshFile(source, own.units), own.direction, own.rotate_deg, own.place_at_mm)]
    bodies, files = [], dict[tuple[Path, str | None], _MeshFile]()
    for entry in tomllib.loads(source.read_text(encoding="utf-8"))["parts"] if source.is_file() else ():
        unit = known_as(entry.get("units", own.units))
        (x, y), (step_x, step_y) = entry["place_mm"], entry.get("step_mm", (0.0, 0.0))
        path, turn_deg = source.parent / entry["file"], entry.get("rotate_deg", 0.0)
        direction = tuple(entry.get("direction", own.direction))
        file = files.setdefault((path, unit), _MeshFile(path, unit))
        for n in range(entry.get("copies", 1)):
            place = (x + n * step_x, y + n * step_y, 0.0)
            bodies.append(_Body(file, direction, turn_deg, place))
    return bodies


def _beside_mm(part: Part, bodies: list[_Body], config: Config) -> float:
    """Greatest distance of a corner of the part from where it is to stand; infinite where there are other facets."""
    first, off_mm = 0, 0.0
    for body in bodies:
        for corners in _standing(body):
            rows = part.faces[first : first + len(corners)]
            first += len(corners)
            if len(rows) < len(corners):
                return np.inf
            there = part.vertices[rows]
            off = np.abs(there - corners).max(axis=(1, 2), initial=0.0)
            # Facets that are turned over have their corners the other way round.
            if config.part.fix_orientation:
                off = np.minimum(off, np.abs(there - corners[:, ::-1]).max(axis=(1, 2), initial=0.0))
            off_mm = max(off_mm, float(off.max(initial=0.0)))
    return off_mm if first == len(part.faces) else np.inf


def _standing(body: _Body) -> Iterator[Floats]:
    """Corners (n, 3, 3) of the facets of a part where they are to stand."""
    # The shortest turn that takes one direction to another is a half turn about the first and one about the middle between them.
    up = np.asarray(body.direction, np.float64) / np.linalg.norm(body.direction)
    middle = up + np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(middle) > 1e-7:
        middle /= np.linalg.norm(middle)
        upright = (2.0 * np.outer(middle, middle) - np.eye(3)) @ (2.0 * np.outer(up, up) - np.eye(3))
    else:
        upright = np.diag([1.0, -1.0, -1.0])
    turn = cmath.exp(1j * math.radians(body.turn_deg))
    # Lowest and highest X and Y before the turn and after it, and Z.
    low, high = np.full(5, np.inf), np.full(5, -np.inf)
    for facets in body.file.facets():
        flat, z = _flat(facets, upright)
        turned = turn * flat
        for k, values in enumerate((flat.real, flat.imag, turned.real, turned.imag, z)):
            low[k], high[k] = (
                min(low[k], values.min(initial=np.inf)),
                max(high[k], values.max(initial=-np.inf)),
            )
    still, moved = (complex(*(0.5 * (low[k : k + 2] + high[k : k + 2]))) for k in (0, 2))
    shift, rise = still - turn * still, 0.0
    if body.place_mm is not None:
        shift = complex(*body.place_mm[:2]) - moved
        rise = body.place_mm[2] - low[4] if len(body.place_mm) > 2 else 0.0
    for facets in body.file.facets():
        flat, z = _flat(facets, upright)
        at = turn * flat + shift
        yield np.stack([at.real, at.imag, z + rise], axis=2)


def _flat(facets: Floats, turn: Floats) -> tuple[NDArray[np.complex128], Floats]:
    """Corners of facets (n, 3, 3) after a turn, (n, 3) each: X + iY, and Z."""
    a, b, c = (facets[:, :, axis] for axis in range(3))
    x, y, z = (a * r[0] + b * r[1] + c * r[2] for r in turn.tolist())
    return x + 1j * y, z


def _measured(facets: Iterable[Floats], direction: tuple[float, ...]) -> tuple[float, float, float]:
    """Length along a direction, mm, surface, mm2, and how high the middle of the surface lies, mm, of facets (n, 3, 3), mm."""
    up = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    low, high, surface, moment = np.inf, -np.inf, 0.0, 0.0
    for corners in facets:
        along = corners @ up
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = 0.5 * np.linalg.norm(across, axis=1)
        low, high = min(low, float(along.min(initial=np.inf))), max(high, float(along.max(initial=-np.inf)))
        surface += float(area.sum())
        moment += float((area * along.mean(axis=1)).sum())
    return high - low, surface, moment / max(surface, 1e-9) - low


def _facets_of(path: Path) -> Iterator[Floats]:
    """Corners (n, 3, 3) of the facets of an STL file, in the unit of the file."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEAD)
        count = int.from_bytes(head[80:84], "little")
        # The reader of parts leaves out padding behind the last facet, too; in text these bytes count more facets than a file holds.
        if len(head) == HEAD and 0 < count * FACET.itemsize <= size - HEAD:
            for first in range(0, count, AT_ONCE):
                yield np.fromfile(file, FACET, min(AT_ONCE, count - first))["corners"].astype(np.float64)
            return
        found = FACET_TEXT.finditer(head + file.read())
    # A part has the 32-bit numbers of a binary file, whatever digits the text prints.
    while some := [facet.groups() for facet in islice(found, AT_ONCE)]:
        yield np.array(some, np.float64).astype(np.float32).astype(np.float64).reshape(-1, 3, 3)
