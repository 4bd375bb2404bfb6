"""Height maps from files: CSV with places, and NPY or TIFF grids in the frame of the settings or of a file beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from ebamcheck.errors import InputError
from ebamcheck.numeric.rings import Floats
from ebamcheck.regular_file import regular_file
from ebamcheck.settings.checking import checked, read_toml
from ebamcheck.settings.stages import HeightMapSettings

FRAME = ".frame.toml"
"""What is put behind the name of a map for the file of its frame."""

MOST_POINTS = 50_000_000
"""Points of a map at most: 400 MB."""

MOST_BYTES = 1_000_000_000
"""Size of a file at most."""

COLUMNS = ("x_mm", "y_mm", "height_mm")
"""Columns of a CSV with places."""

SUFFIXES = (".csv", ".npy", ".tif", ".tiff")


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Measured places.

    Parameters
    ----------
    x_mm, y_mm
        (n,) places in the coordinates of the program.
    height_mm
        (n,) heights over the base plate; holes are left out.
    step_mm
        Distance of neighbouring places.
    """

    x_mm: Floats
    y_mm: Floats
    height_mm: Floats
    step_mm: float


def read_map(path: Path, settings: HeightMapSettings) -> HeightMap:
    """Read a height map.

    Raises
    ------
    InputError
        If it is missing, too large, of another kind, no grid of numbers, or its frame makes no sense.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: height maps are {', '.join(SUFFIXES)}")
    try:
        if regular_file(path).stat().st_size > MOST_BYTES:
            raise InputError(f"{path}: is larger than {MOST_BYTES / 1e6:g} MB")
        frame = _frame(path, settings)
        if path.suffix.lower() == ".csv":
            return _from_csv(path, frame)
        grid = _from_npy(path) if path.suffix.lower() == ".npy" else _from_tiff(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    return placed(grid, frame, str(path))


def _frame(path: Path, settings: HeightMapSettings) -> HeightMapSettings:
    """The frame beside a map, else that of the settings."""
    beside = path.with_name(path.name + FRAME)
    if not beside.is_file():
        return settings
    values = settings.model_dump() | read_toml(beside, InputError)
    return checked(HeightMapSettings, values, beside, error=InputError)


def _from_csv(path: Path, frame: HeightMapSettings) -> HeightMap:
    """Read places with their heights, or, without such a header, a grid of numbers."""
    try:
        head = path.read_bytes()[:4096].decode("utf-8").split("\n", 1)[0]
        if not set(COLUMNS) <= {name.strip() for name in head.split(",")}:
            return placed(pd.read_csv(path, header=None).to_numpy(np.float64), frame, str(path))
        table = pd.read_csv(path, skipinitialspace=True)
        table.columns = [str(name).strip() for name in table.columns]
        x, y, value = (table[name].to_numpy(np.float64) for name in COLUMNS)
    except (ValueError, UnicodeDecodeError) as error:
        said = " ".join(str(error).split())[:120]
        raise InputError(
            f"{path}: is neither {','.join(COLUMNS)} with numbers below nor a grid of numbers: {said}"
        ) from None
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        row = int(np.argmin(np.isfinite(x) & np.isfinite(y)))
        raise InputError(f"{path}:{row + 2}: a place is no number; a hole is a row without a height")
    steps = [float(np.median(np.diff(found))) for at in (x, y) if (found := np.unique(at)).size > 1]
    step_mm = max(steps) if steps else 0.0
    return _known(x, y, value, frame, step_mm, str(path))


def _from_npy(path: Path) -> Floats:
    try:
        found = np.load(path, allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise InputError(f"{path}: is no NPY file of numbers: {' '.join(str(error).split())[:120]}") from None
    if not isinstance(found, np.ndarray) or found.ndim != 2 or found.dtype.kind not in "fiu":
        raise InputError(f"{path}: is no grid of numbers in rows and columns")
    return found.astype(np.float64)


def _from_tiff(path: Path) -> Floats:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            if image.width * image.height > MOST_POINTS:
                raise InputError(f"{path}: has more than {MOST_POINTS} points")
            if image.mode not in ("F", "I", "I;16", "I;16B", "I;16L", "L"):
                raise InputError(
                    f"{path}: has the mode {image.mode!r}: give one channel of whole or floating numbers"
                )
            return np.asarray(image).astype(np.float64)
    except (UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError) as error:
        raise InputError(f"{path}: is no TIFF: {' '.join(str(error).split())[:120]}") from None


def placed(grid: Floats, frame: HeightMapSettings, where: str) -> HeightMap:
    """Put a grid (rows, columns) at its place.

    Examples
    --------
    >>> frame = HeightMapSettings(origin_mm=(10.0, 20.0), step_mm=(1.0, 2.0), rows="up")
    >>> found = placed(np.array([[1.0, np.nan], [3.0, 4.0]]), frame, "")
    >>> found.x_mm, found.y_mm, found.height_mm
    (array([10., 10., 11.]), array([20., 22., 22.]), array([1., 3., 4.]))
    """
    if grid.ndim != 2 or not grid.size:
        raise InputError(f"{where}: is no grid of numbers in rows and columns")
    if grid.size > MOST_POINTS:
        raise InputError(f"{where}: has more than {MOST_POINTS} points")
    if frame.rows == "down":
        grid = grid[::-1]
    row, column = np.indices(grid.shape)
    along, up = column.reshape(-1) * frame.step_mm[0], row.reshape(-1) * frame.step_mm[1]
    turn = math.radians(frame.turn_deg)
    x = frame.origin_mm[0] + math.cos(turn) * along - math.sin(turn) * up
    y = frame.origin_mm[1] + math.sin(turn) * along + math.cos(turn) * up
    return _known(x, y, grid.reshape(-1), frame, max(frame.step_mm), where)


def _known(
    x: Floats, y: Floats, value: Floats, frame: HeightMapSettings, step_mm: float, where: str
) -> HeightMap:
    """Leave holes out, and give heights in millimetres."""
    known = np.isfinite(value)
    if frame.hole is not None:
        known &= value != frame.hole
    if not known.any():
        raise InputError(f"{where}: has no height at all")
    height = frame.zero_mm + frame.unit_mm * value[known]
    return HeightMap(x[known], y[known], np.asarray(height, np.float64), step_mm)
