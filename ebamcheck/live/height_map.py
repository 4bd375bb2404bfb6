"""What is measured under the next layer, from file or line to the cells of the part's metal, and what is wrong with it; nothing is
guessed.

Cells along the border hold the low flank of a bead, and get the height of the nearest cell within. Heights are kept to a
micrometre."""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import math
import zlib
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import ndimage

from ebamcheck.atomic_file import regular_file
from ebamcheck.errors import InputError
from ebamcheck.kernels import Floats
from ebamcheck.metal import Surface
from ebamcheck.metal.surface import HALF, SPOT_BEADS
from ebamcheck.settings.checking import checked, read_toml
from ebamcheck.settings.config import Config
from ebamcheck.settings.stages import HeightMapSettings

RIM_BEADS = 0.5  # width of the border, over the bead width, on which the flank of a bead lies
# Shares of a measured unevenness that a layer is tried to mend, one after the other: it gets at most a fifth thicker or thinner for it
MENDING = (1.0, 0.6, 0.3)
KEPT_MM, MOST_KEPT_MM = 1e-3, 1e5  # step in which heights are kept, and the greatest that is
HOLE = np.iinfo(np.int32).min  # in place of a height that is not known
MOST_POINTS, MOST_BYTES = 50_000_000, 1_000_000_000  # points of a map, 400 MB, and bytes of a file at most
COLUMNS = ("x_mm", "y_mm", "height_mm")


class Refused(InputError):
    """What was measured, or a line, is not used; `code` says what kind of refusal it is."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code

    @property
    def answer(self) -> dict[str, Any]:
        """What is answered."""
        return {"answer": "refused", "code": self.code, "reason": str(self)}


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Measured places (n,) in the coordinates of the program, without holes; heights over the base plate; distance of
    neighbours."""

    x_mm: Floats
    y_mm: Floats
    height_mm: Floats
    step_mm: float


def read_map(path: Path, settings: HeightMapSettings) -> HeightMap:
    """Read a map: CSV with places, or an NPY or TIFF grid in the frame of the settings or of a file beside it."""
    suffix, beside = path.suffix.lower(), path.with_name(f"{path.name}.frame.toml")
    if suffix not in (known := (".csv", ".npy", ".tif", ".tiff")):
        raise InputError(f"{path}: height maps are {', '.join(known)}")
    try:
        if regular_file(path).stat().st_size > MOST_BYTES:
            raise InputError(f"{path}: is larger than {MOST_BYTES / 1e6:g} MB")
        if beside.is_file():
            values = settings.model_dump() | read_toml(beside, InputError)
            settings = checked(HeightMapSettings, values, beside, error=InputError)
        if suffix == ".csv":
            return _from_csv(path, settings)
        grid = _from_npy(path) if suffix == ".npy" else _from_tiff(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    return placed(grid, settings, str(path))


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
        said = f"is neither {','.join(COLUMNS)} with numbers below nor a grid of numbers"
        raise InputError(f"{path}: {said}: {' '.join(str(error).split())[:120]}") from None
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
                said = "give one channel of whole or floating numbers"
                raise InputError(f"{path}: has the mode {image.mode!r}: {said}")
            return np.asarray(image).astype(np.float64)
    except (UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError) as error:
        raise InputError(f"{path}: is no TIFF: {' '.join(str(error).split())[:120]}") from None


def placed(grid: Floats, frame: HeightMapSettings, where: str) -> HeightMap:
    """Put a grid (rows, columns) at its place.

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


def _known(x: Floats, y: Floats, value: Floats, frame: HeightMapSettings, step_mm: float, where: str) -> HeightMap:
    """Leave holes out, and give heights in millimetres."""
    known = np.isfinite(value)
    if frame.hole is not None:
        known &= value != frame.hole
    if not known.any():
        raise InputError(f"{where}: has no height at all")
    height = frame.zero_mm + frame.unit_mm * value[known]
    return HeightMap(x[known], y[known], np.asarray(height, np.float64), step_mm)


@dataclass(frozen=True, eq=False)
class MapCells:
    """A map in the cells of a part's metal."""

    corner: tuple[int, int]  # column and row of the first cell from the part's origin
    kept: np.ndarray[Any, np.dtype[np.int32]]  # (rows, columns) heights in micrometres, HOLE where none is known

    @property
    def height_mm(self) -> Floats:
        """(rows, columns) heights over the base plate; NaN where none is known."""
        return np.where(self.kept == HOLE, np.nan, self.kept * KEPT_MM)

    @property
    def sha256(self) -> str:
        """Hash of the heights and their place."""
        shape = np.array([*self.corner, *self.kept.shape], "<i8").tobytes()
        return hashlib.sha256(shape + self.kept.astype("<i4").tobytes()).hexdigest()

    def entry(self) -> dict[str, Any]:
        """Return what the journal keeps of it."""
        packed = base64.b64encode(zlib.compress(self.kept.astype("<i4").tobytes(), 9)).decode("ascii")
        place = {"corner": list(self.corner), "shape": list(self.kept.shape)}
        return {**place, "um": packed, "sha256": self.sha256}

    @classmethod
    def of_entry(cls, entry: dict[str, Any]) -> MapCells:
        """Take it back from the journal."""
        try:
            rows, columns = (int(n) for n in entry["shape"])
            content = zlib.decompress(base64.b64decode(entry["um"], validate=True))
            kept = np.frombuffer(content, "<i4").reshape(rows, columns).astype(np.int32)
            found = cls((int(entry["corner"][0]), int(entry["corner"][1])), kept)
        except (KeyError, ValueError, TypeError, binascii.Error, zlib.error):
            raise InputError("the height map of the journal cannot be read") from None
        if found.sha256 != entry.get("sha256"):
            raise InputError("the height map of the journal is not the one that was kept")
        return found


def in_cells(found: HeightMap, surface: Surface) -> MapCells:
    """Lay a map into cells: the mean of the places in one; between coarser places, by their distance; beyond a step of the map,
    holes."""
    rows, columns = surface.share.shape
    at = np.stack([found.x_mm, found.y_mm]) / surface.step_mm - np.array(surface.corner)[:, None]
    column, row = np.floor(at).astype(np.int64)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    cell = row[inside] * columns + column[inside]
    # Sums over no place at all are whole numbers to numpy.
    count, total = (
        np.bincount(cell, weights, rows * columns).reshape(rows, columns).astype(np.float64)
        for weights in (None, found.height_mm[inside])
    )
    known = count > 0.0
    height = np.divide(total, count, out=np.full_like(total, np.nan), where=known)
    reach = found.step_mm / surface.step_mm
    if reach > 1.0 and known.any():
        # Cells lie closer than places: those between them get the places around, the nearer ones the more.
        sigma = 0.5 * reach
        weight = ndimage.gaussian_filter(known.astype(np.float64), sigma, truncate=3.0)
        spread = ndimage.gaussian_filter(np.where(known, height, 0.0), sigma, truncate=3.0)
        near = ndimage.distance_transform_edt(~known) <= reach
        np.divide(spread, weight, out=height, where=near & ~known & (weight > 0.0))
    sound = np.isfinite(height) & (np.abs(height) < MOST_KEPT_MM)
    kept = np.full(height.shape, HOLE, np.int32)
    kept[sound] = np.round(height[sound] / KEPT_MM).astype(np.int32)
    return MapCells(surface.corner, kept)


@dataclass(frozen=True, eq=False)
class MapFigures:
    """What a map says of a layer."""

    mean_mm: float  # over the base plate
    hump_mm: float  # highest and lowest spot of a bead from there
    hump_at_mm: tuple[float, float]
    dip_mm: float
    dip_at_mm: tuple[float, float]
    slope_deg: float  # of its plane, and the direction in which that rises
    slope_to_deg: float
    known: float  # share of the layer
    over_mm: Floats  # (rows, columns) height over the mean in the surface's cells

    def told(self) -> dict[str, Any]:
        """Return the figures for an answer, and for the certificate of the layer on it."""
        digits = {"mean_mm": 6, "slope_to_deg": 1}
        values = {name: value for name, value in vars(self).items() if name != "over_mm"}
        return {
            name: list(value) if isinstance(value, tuple) else round(value, digits.get(name, 4))
            for name, value in values.items()
        }


def figures_of(cells: MapCells, surface: Surface, config: Config) -> MapFigures:
    """Judge a map on the metal of the layer that it was taken of; :class:`Refused` where none can be laid on that."""
    settings, bead_mm = config.height_map, config.process.bead_width_mm
    metal = surface.share >= HALF
    if not metal.any():
        raise Refused("map", "a height map is of a layer that was laid: nothing stands yet")
    if cells.corner != surface.corner or cells.kept.shape != surface.share.shape:
        raise Refused("map", "the height map is in cells of another part")
    depth_mm = ndimage.distance_transform_edt(np.pad(metal, 1))[1:-1, 1:-1] * surface.step_mm
    inner = metal & (depth_mm > RIM_BEADS * bead_mm)
    judged = inner if inner.any() else metal
    height = cells.height_mm
    known = judged & np.isfinite(height)
    if known.any():
        known &= np.abs(height - np.median(height[known])) <= settings.spike_mm
    share = float(known.sum() / judged.sum())
    if share < settings.least_known:
        hole_cells = ndimage.distance_transform_edt(np.pad(judged & ~known, 1))[1:-1, 1:-1]
        x, y = _place(surface, int(np.argmax(hole_cells)))
        raise Refused(
            "map-holes",
            f"the height map knows {100 * share:.0f} % of the layer, height_map.least_known is {100 * settings.least_known:.0f} %: "
            f"the middle of the largest hole is at ({x:.1f}, {y:.1f})",
        )
    mean_mm = float(height[known].mean())
    row, column = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    over = height[row, column] - mean_mm
    # Means over the spot of a bead, of what is known.
    blurred = partial(ndimage.gaussian_filter, sigma=SPOT_BEADS * bead_mm / surface.step_mm, mode="constant")
    weight, value = blurred(known.astype(np.float64)), blurred(np.where(known, over, 0.0))
    spots = np.divide(value, weight, out=np.zeros_like(value), where=known & (weight > 0.0))
    top, low = int(np.argmax(np.where(known, spots, -np.inf))), int(np.argmin(np.where(known, spots, np.inf)))
    # Gradient of the plane through known cells; 0 along a direction in which they do not extend.
    places = np.argwhere(known)[:, ::-1] * surface.step_mm
    slope, *_ = np.linalg.lstsq(places - places.mean(axis=0), over[known], rcond=1e-9)
    figures = MapFigures(
        mean_mm, float(spots.flat[top]), _place(surface, top), -float(spots.flat[low]), _place(surface, low),
        math.degrees(math.atan(math.hypot(*slope))), math.degrees(math.atan2(slope[1], slope[0])) % 360.0, share, over,
    )  # fmt: skip
    limit = settings.uneven_mm
    if limit is None:
        # The tip of the wire passes over half the usual height of a layer.
        limit = min(config.process.largest_unevenness_mm, 0.5 * config.layer_height_mm)
    if max(figures.hump_mm, figures.dip_mm) > limit:
        hump, dip = (
            (figures.hump_mm, "over", figures.hump_at_mm),
            (figures.dip_mm, "under", figures.dip_at_mm),
        )
        off, side, (x, y) = hump if hump[0] >= dip[0] else dip
        where = f"the layer lies {off:.2f} mm {side} its mean of {mean_mm:.3f} mm at ({x:.1f}, {y:.1f})"
        what = (
            f"at most {limit:.2f} mm can be mended (height_map.uneven_mm): machine or fill it there, and measure again"
        )
        raise Refused("map-uneven", f"{where}: {what}")
    return figures


def _place(surface: Surface, cell: int) -> tuple[float, float]:
    row, column = divmod(cell, surface.share.shape[1])
    x, y = ((np.array([column, row]) + np.array(surface.corner) + 0.5) * surface.step_mm).tolist()
    return round(x, 2), round(y, 2)


LONGEST_LINE = 4096  # bytes of a line; a reading takes a hundred


@dataclass(frozen=True)
class Warmth:
    """Mean temperature of the surface, K, and the time after the layer at which it was read."""

    surface_k: float
    after_s: float


@dataclass(frozen=True)
class Reading:
    """A height that was measured when so many layers were done; the map of which it is the mean, and the temperature, if there
    are."""

    done: int
    height_mm: float
    cells: MapCells | None = field(default=None, compare=False)
    warmth: Warmth | None = None
    map_sha256: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "map_sha256", self.cells.sha256 if self.cells else "")

    def entry(self) -> dict[str, Any]:
        """Line of the journal."""
        values: dict[str, Any] = {"kind": "height", "done": self.done, "height_mm": self.height_mm}
        if self.warmth is not None:
            values |= {"surface_k": self.warmth.surface_k, "after_s": self.warmth.after_s}
        return values if self.cells is None else {**values, "map": self.cells.entry()}

    @classmethod
    def of_entry(cls, entry: dict[str, Any]) -> Reading:
        """Take it back from a line of the journal."""
        cells = MapCells.of_entry(entry["map"]) if "map" in entry else None
        return cls(int(entry["done"]), float(entry["height_mm"]), cells, warmth_of(entry))


def parsed(line: bytes) -> dict[str, Any]:
    """Return a line as a JSON object."""
    if len(line) > LONGEST_LINE:
        raise Refused("unreadable", f"a line of more than {LONGEST_LINE} bytes")
    if not line.strip():
        raise Refused("unreadable", "the line is empty")

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = [key for key, _ in pairs]
        # Which of two values was meant, nobody knows.
        for twice in (key for k, key in enumerate(keys) if key in keys[:k]):
            raise Refused("unreadable", f"{twice!r:.40} is in the line twice")
        return dict(pairs)

    try:
        found = json.loads(line.decode("utf-8"), object_pairs_hook=once)
    except (ValueError, RecursionError):
        raise Refused("unreadable", "the line is no JSON") from None
    if not isinstance(found, dict):
        raise Refused("unreadable", "the line is no JSON object")
    return found


def reading_of(message: dict[str, Any]) -> Reading:
    """Return the reading of a message, by its types alone."""
    unit = message.get("unit", "mm")
    if unit != "mm":
        raise Refused("unit", f"unit {unit!r:.20}: heights are in mm and are not converted")
    done = done_of(message)
    height = message.get("height_mm")
    if height is None:
        raise Refused("missing", "`height_mm` is missing")
    if isinstance(height, bool) or not isinstance(height, int | float):
        raise Refused("not-a-number", f"height_mm {height!r:.20}: is not a number")
    try:
        height_mm = float(height)
    except OverflowError:
        height_mm = math.inf
    if not math.isfinite(height_mm):
        raise Refused("not-a-number", f"height_mm {height_mm}: is not finite")
    return Reading(done, height_mm)


def map_reading(
    message: dict[str, Any], surface: Surface | None, config: Config, last: Reading | None = None
) -> Reading:
    """Read the map of a message; its mean on metal is the height. One that was used for the `last` reading is that reading."""
    done = done_of(message)
    if message.get("unit", "mm") != "mm":
        raise Refused("unit", "the unit of a map is height_map.unit_mm of its frame")
    if message.get("height_mm") is not None:
        raise Refused("map", "give `height_mm` or `height_map`: the mean of a map is its height")
    name = message["height_map"]
    if not isinstance(name, str) or not name or "\x00" in name:
        raise Refused("map", f"height_map {name!r:.40}: give the name of a file")
    if surface is None:
        raise Refused("map", "nothing is known of what stands")
    try:
        cells = in_cells(read_map(Path(name), config.height_map), surface)
        if last is not None and (last.done, last.map_sha256) == (done, cells.sha256):
            return replace(last, warmth=None)
        figures = figures_of(cells, surface, config)
    except Refused:
        raise
    except InputError as error:
        raise Refused("map", str(error)) from None
    except MemoryError:
        raise Refused("map", f"{name:.80}: is too large for the memory of this machine") from None
    return Reading(done, figures.mean_mm, cells)


def warmth_of(message: dict[str, Any]) -> Warmth | None:
    """Return the temperature of a message, None where it has none."""
    if message.get("surface_k") is None:
        return None
    values = []
    for name, unit in (("surface_k", "kelvins"), ("after_s", "seconds since the layer was done")):
        value = message.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise Refused("temperature", f"{name} {value!r:.20}: give a finite number of {unit}")
        values.append(float(value))
    return Warmth(*values)


def done_of(message: dict[str, Any]) -> int:
    """Return how many layers are done, by a message."""
    done = message.get("done")
    if done is None:
        raise Refused("missing", "`done`, the number of layers that are done, is missing")
    if not isinstance(done, int) or isinstance(done, bool) or done < 0:
        raise Refused("counter", f"done {done!r:.20}: give the number of layers that are done")
    return done


def check_height(reading: Reading, base_mm: float, top_mm: float) -> None:
    """Refuse a height that a layer that was laid from `base_mm` to `top_mm` cannot have."""
    height, planned = reading.height_mm, top_mm - base_mm
    room = 0.75 * planned  # beyond it is no bead but a fault
    if abs(height - top_mm) <= room:
        return
    for factor, unit in ((25.4, "inches"), (1000.0, "metres"), (1.0 / 1000.0, "micrometres")):
        if abs(height * factor - top_mm) <= 0.35 * planned:
            said = f"would be the layer's height in {unit}: heights are in mm"
            raise Refused("unit", f"height_mm {height:g} {said}")
    if height <= base_mm:
        said = f"is not over {base_mm:.3f}, on which the layer was laid"
        raise Refused("decreasing", f"height_mm {height:g} {said}")
    off_mm = abs(height - top_mm)
    off = f"{off_mm:.3f}" if off_mm < 1e6 else f"{off_mm:.4g}"  # of one that no machine has a few digits
    raise Refused("absurd", f"height_mm {height:g} is {off} mm off the plan, {top_mm:.3f}: over {room:.3f}")
