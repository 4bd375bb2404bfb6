"""A part as it is built, from its file or that of a plate: read, repaired, rotated, placed, mounted on a table."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import sha256_of_file, sha256_of_json
from ebamcheck.kernels import Floats
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import FROM_PARTS, Part, Vector
from ebamcheck.settings.base import Angle, Between, Place, Section, known_as
from ebamcheck.settings.checking import checked, read_toml
from ebamcheck.settings.machine import OnTable
from ebamcheck.settings.stages import Component, PartSettings

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry


@dataclass(frozen=True)
class Placing:
    """Turn about a vertical axis, counter-clockwise seen from above, then shift along X, Y and Z."""

    turn_deg: float = 0.0
    about_mm: tuple[float, float] = (0.0, 0.0)
    shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def moved(self, part: Part) -> Part:
        """Return the part where it is built; unchanged bit for bit if nothing moves."""
        if self.turn_deg % 360.0 == 0.0 and self.shift_mm == (0.0, 0.0, 0.0):
            return part
        vertices = part.vertices.copy()
        if self.turn_deg % 360.0:
            x, y = vertices[:, 0] - self.about_mm[0], vertices[:, 1] - self.about_mm[1]
            cosine, sine = cosine_and_sine(self.turn_deg)
            vertices[:, 0] = cosine * x - sine * y + self.about_mm[0]
            vertices[:, 1] = sine * x + cosine * y + self.about_mm[1]
        for axis, way_mm in enumerate(self.shift_mm):
            if way_mm:
                vertices[:, axis] += way_mm
        return replace(part, vertices=vertices)


def cosine_and_sine(angle_deg: float) -> tuple[float, float]:
    """Cosine and sine of an angle in degrees; of quarter turns exactly.

    >>> cosine_and_sine(90.0), cosine_and_sine(-180.0)
    ((0.0, 1.0), (-1.0, 0.0))
    """
    quarters, rest = divmod(angle_deg % 360.0, 90.0)
    if rest == 0.0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarters) % 4]
    angle_rad = math.radians(angle_deg)
    return math.cos(angle_rad), math.sin(angle_rad)


def placing_of(part: Part, place_at_mm: tuple[float, ...] | None = None, turn_deg: float = 0.0) -> Placing:
    """Placing about the middle of a part's box, whose turned middle goes to X, Y and, of three, its lowest point to Z."""
    x, y, _ = part.bounds.mean(axis=0).tolist()
    if place_at_mm is None:
        return Placing(turn_deg, (x, y))
    turned = Placing(turn_deg, (x, y)).moved(part)
    mid_x, mid_y, _ = turned.bounds.mean(axis=0).tolist()
    rise_mm = place_at_mm[2] - float(turned.bounds[0, 2]) if len(place_at_mm) > 2 else 0.0
    return Placing(turn_deg, (x, y), (place_at_mm[0] - mid_x, place_at_mm[1] - mid_y, rise_mm))


MOST_PARTS = 10_000  # most parts on a plate: more come from a mistyped number of copies


class PlateEntry(Section):
    """One part of a plate, once or several times."""

    file: str
    """Mesh file, from the folder of the plate's own file."""
    name: str = ""
    """Name in the record; empty: that of the file. Copies are numbered."""
    units: Annotated[Literal["mm", "cm", "m", "um", "in", "ft"], BeforeValidator(known_as)] | None = None
    """Unit of the file's numbers; None: that of the settings."""
    direction: tuple[Component, Component, Component] | None = None
    """Slicing direction in the file's coordinates; None: that of the settings."""
    place_mm: tuple[Place, Place]
    """Where the middle of its box lies in X and Y of the work offset."""
    rotate_deg: Angle = 0.0
    """Turn about the vertical, counter-clockwise seen from above."""
    copies: Annotated[int, Between(1, MOST_PARTS)] = 1
    """How many times it is built."""
    step_mm: tuple[Place, Place] | None = None
    """Way from one copy to the next."""


class Plate(Section):
    """A plate: its parts, and how far apart they are."""

    clearance_mm: Annotated[float, Between(0.1, 1e4)] = 10.0
    """Least distance between two parts, across the plate, measured between their convex outlines seen from above."""
    parts: Annotated[tuple[PlateEntry, ...], Field(min_length=1)]
    """The parts."""


@dataclass(frozen=True)
class Member:
    """One part on a plate: its file, its place, and its facets in the plate's mesh."""

    name: str
    source: str
    sha256: str
    units: str
    units_from: str
    direction: Vector
    place_at_mm: tuple[float, float]
    rotate_deg: float
    facets: tuple[int, int]


@dataclass(frozen=True, eq=False)
class PlatePart(Part):
    """The mesh of a whole plate, with its parts as members."""

    members: tuple[Member, ...] = ()
    clearance_mm: float = 0.0

    def member(self, member: Member) -> Part:
        """Mesh of one part, placed on the plate."""
        faces = self.faces[slice(*member.facets)]
        first, last = int(faces.min()), int(faces.max()) + 1
        vertices = self.vertices[first:last]
        return Part(vertices, faces - np.int32(first), name=member.name, source=member.source)

    def outlines(self) -> list[BaseGeometry]:
        """Convex outline of every part, seen from above."""
        return [outline(self.member(member)) for member in self.members]


def is_plate(path: str | Path) -> bool:
    """Whether a file lists the parts of a plate."""
    return Path(path).suffix.lower() == ".toml"


def load_plate(path: str | Path, units: str = "", direction: Vector = (0.0, 0.0, 1.0)) -> PlatePart:
    """Read a plate and its parts; `units` and `direction` are for parts that have none of their own."""
    path = Path(path)
    plate = read_plate(path)
    part = _joined(path, plate, list(_placed(path, plate, units, direction)))
    _check_apart(path, part)
    return part


def read_plate(path: Path) -> Plate:
    """Read the file of a plate, without its parts."""
    plate = checked(Plate, read_toml(path, InputError), path)
    for number, entry in enumerate(plate.parts, 1):
        if entry.copies > 1 and entry.step_mm is None:
            raise SettingsError(f"{path}: parts {number} ({entry.file}): {entry.copies} copies need step_mm")
    if (count := sum(entry.copies for entry in plate.parts)) > MOST_PARTS:
        raise SettingsError(f"{path}: {count} parts are over {MOST_PARTS}")
    return plate


def plate_sha256(path: Path) -> str:
    """SHA-256 of the plate's file and the files of its parts."""
    files = sorted({entry.file for entry in read_plate(path).parts})
    try:
        made = {file: sha256_of_file(path.parent / file) for file in files}
        return sha256_of_json({"plate": sha256_of_file(path), "parts": made})
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror or error}") from None


def outline(part: Part) -> BaseGeometry:
    """Convex outline of a part, seen from above."""
    import shapely

    hull: BaseGeometry = shapely.MultiPoint(part.vertices[:, :2]).convex_hull
    return hull


def _placed(path: Path, plate: Plate, units: str, direction: Vector) -> Iterator[tuple[Member, Part]]:
    """Yield every part of a plate in its place; ranges of facets are set later."""
    for entry in plate.parts:
        file = path.parent / entry.file
        if is_plate(file):
            raise SettingsError(f"{path}: {entry.file} is a plate itself: list its parts here")
        turned = load(file, entry.units or units).along(entry.direction or direction)
        step_x, step_y = entry.step_mm or (0.0, 0.0)
        for copy in range(entry.copies):
            place = entry.place_mm[0] + copy * step_x, entry.place_mm[1] + copy * step_y
            part = placing_of(turned, (*place, 0.0), entry.rotate_deg).moved(turned)
            name = entry.name or file.stem
            said = turned.source_sha256, turned.units, turned.units_from, turned.direction
            named = f"{name} {copy + 1}" if entry.copies > 1 else name
            yield Member(named, entry.file, *said, place, entry.rotate_deg, (0, len(part.faces))), part


def _joined(path: Path, plate: Plate, placed: list[tuple[Member, Part]]) -> PlatePart:
    """One mesh of all parts, each with a unique name and its range of facets."""
    names = [member.name for member, _ in placed]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise SettingsError(f"{path}: two parts are called {repeated[0]!r}: give each a name of its own")
    vertex = np.concatenate([[0], np.cumsum([len(part.vertices) for _, part in placed])])
    facet = np.concatenate([[0], np.cumsum([len(part.faces) for _, part in placed])])
    if vertex[-1] > np.iinfo(np.int32).max // 4:
        told = f"{vertex[-1]} vertices are more than one mesh can hold: build fewer copies"
        raise SettingsError(f"{path}: {told}")
    of_each = zip(placed, itertools.pairwise(facet.tolist()), strict=True)
    members = tuple(replace(member, facets=facets) for (member, _), facets in of_each)
    return PlatePart(
        np.concatenate([part.vertices for _, part in placed]),
        np.concatenate([part.faces + np.int32(vertex[k]) for k, (_, part) in enumerate(placed)]),
        name=path.stem,
        source=str(path),
        source_sha256=plate_sha256(path),
        units_from=FROM_PARTS,
        notes=tuple(dict.fromkeys(f"{Path(p.source).name}: {note}" for _, p in placed for note in p.notes)),
        members=members,
        clearance_mm=plate.clearance_mm,
    )


def _check_apart(path: Path, part: PlatePart) -> None:
    """Refuse parts that are nearer to each other than the clearance; the message names the nearest two."""
    import shapely

    outlines = np.array(part.outlines(), object)
    tree = shapely.STRtree(outlines)
    a, b = tree.query(outlines, predicate="dwithin", distance=part.clearance_mm)
    a, b = a[a < b], b[a < b]
    apart = shapely.distance(outlines[a], outlines[b])
    if not apart.size or apart.min() >= part.clearance_mm:
        return
    k = int(np.argmin(apart))
    one, other = part.members[a[k]].name, part.members[b[k]].name
    how = f"{apart[k]:.4g} mm apart" if apart[k] > 0.0 else "in each other's way"
    raise SettingsError(
        f"{path}: the parts {one!r} and {other!r} are {how}, and clearance_mm asks for {part.clearance_mm:g} mm "
        "(between their convex outlines seen from above): change place_mm, rotate_deg or step_mm"
    )


def read_part(path: str | Path, settings: PartSettings) -> tuple[Part, int]:
    """Read the part, repair it if requested, rotate and place it; returns it and the number of facets reversed."""
    plate = is_plate(path)
    if plate and (settings.place_at_mm is not None or settings.rotate_deg):
        raise SettingsError(
            f"{path}: part.place_at_mm and part.rotate_deg are of one part: a plate places each of its parts itself"
        )
    units, turned = settings.units or "", 0
    part = load_plate(path, units, settings.direction) if plate else load(path, units)
    if settings.fix_orientation:
        from ebamcheck.mesh.inspection import fix_orientation  # kernels load when they are needed

        part, turned = fix_orientation(part)
    if plate:
        return part, turned
    upright = part.along(settings.direction)
    return _placing(upright, settings).moved(upright), turned


def read_reference(path: str | Path, part_path: str | Path, settings: PartSettings) -> Part:
    """Read a finer mesh of a part, and move it exactly as the part is moved, although their boxes differ slightly."""
    if plates := [file for file in (path, part_path) if is_plate(file)]:
        raise SettingsError(f"{plates[0]}: a reference is of one part: measure the parts of a plate one by one")
    fine = load(path, settings.units or "").along(settings.direction)
    if settings.place_at_mm is None and not settings.rotate_deg:
        return fine
    return _placing(load(part_path, settings.units or "").along(settings.direction), settings).moved(fine)


def source_sha256(path: str | Path) -> str:
    """SHA-256 of the source of a part: of its file, or of a plate's file and the files of all its parts."""
    return plate_sha256(Path(path)) if is_plate(path) else sha256_of_file(Path(path))


def _placing(upright: Part, settings: PartSettings) -> Placing:
    if settings.place_at_mm is None and not settings.rotate_deg:
        return Placing()
    return placing_of(upright, settings.place_at_mm, settings.rotate_deg)


def rigid_motion(before: Part, now: Part) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and shift (3,) that take one part to the other as p @ rotation + shift, from their vertices."""
    other = InputError(f"part {now.name!r}: is of another file than the one that was built")
    if before.vertices.shape != now.vertices.shape:
        raise other
    middle = before.vertices.mean(axis=0)
    turn, *_ = np.linalg.lstsq(before.vertices - middle, now.vertices - now.vertices.mean(axis=0), rcond=None)
    u, _, v = np.linalg.svd(turn)
    turn = np.asarray(u @ v, np.float64)
    shift = now.vertices.mean(axis=0) - middle @ turn
    scale = max(float(np.abs(before.bounds).max()), 1.0)
    if np.abs(before.vertices @ turn + shift - now.vertices).max() > 1e-6 * scale:
        raise other
    return turn, np.asarray(shift, np.float64)


def on_table(before: Part, now: Part, built_mm: float = 0.0) -> OnTable:
    """Mounting of a part built up to a height: `before` on the table with all axes at 0, `now` in a turned layer's program."""
    turn, shift = rigid_motion(before, now)
    zero = np.array([0.0, 0.0, before.bounds[0, 2]])
    shift = zero @ turn + shift - np.array([0.0, 0.0, now.bounds[0, 2]])
    low, high = before.bounds - zero
    plain = {"turn": turn, "shift_mm": shift, "low_mm": low, "high_mm": high}
    return OnTable.model_validate(
        {name: np.asarray(values + 0.0).tolist() for name, values in plain.items()}
        | {"direction": before.direction, "built_mm": built_mm}
    )
