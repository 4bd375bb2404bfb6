"""From the file of a part, or of a plate with several, to the part as it is built: read, repaired, rotated and placed."""

from __future__ import annotations

from pathlib import Path

from ebamcheck.errors import SettingsError
from ebamcheck.json_values import sha256_of_file
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.placing import Placing, placing_of
from ebamcheck.mesh.plates import is_plate, load_plate, plate_sha256
from ebamcheck.settings.slicing import PartSettings


def read_part(path: str | Path, settings: PartSettings) -> tuple[Part, int]:
    """Read the part, repair it if requested, rotate and place it; returns it and the number of facets reversed.

    Raises
    ------
    InputError
        If the file cannot be read.
    SettingsError
        If a setting is invalid, or the settings place a plate, whose parts have places of their own.
    """
    plate = is_plate(path)
    if plate and (settings.place_at_mm is not None or settings.rotate_deg):
        raise SettingsError(
            f"{path}: part.place_at_mm and part.rotate_deg are of one part: a plate places each of its parts itself"
        )
    part: Part = (
        load_plate(path, settings.units or "", settings.direction)
        if plate
        else load(path, settings.units or "")
    )
    turned = 0
    if settings.fix_orientation:
        from ebamcheck.mesh.inspection import fix_orientation  # kernels load when they are needed

        part, turned = fix_orientation(part)
    if plate:
        return part, turned
    upright = part.along(settings.direction)
    return _placing(upright, settings).moved(upright), turned


def read_reference(path: str | Path, part_path: str | Path, settings: PartSettings) -> Part:
    """Read a finer mesh of a part, and move it exactly as the part is moved, although their boxes differ slightly.

    Raises
    ------
    InputError
        If a file cannot be read.
    SettingsError
        If either of them is a plate.
    """
    for file in (path, part_path):
        if is_plate(file):
            raise SettingsError(
                f"{file}: a reference is of one part: measure the parts of a plate one by one"
            )
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
