"""A measured surface under the next layer: its mean, hump and slope, and how uneven it is, in the cells of the part's metal.

Cells along the border hold the flank of a bead, which is low whatever lies there: they do not count, and get the height of the
nearest cell within. Heights are kept to a micrometre, as the journal holds them, so that a replay plans on the same numbers.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from ebamcheck.errors import InputError
from ebamcheck.live.map_files import HeightMap
from ebamcheck.metal import Surface
from ebamcheck.metal.surface import HALF, SPOT_BEADS
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.settings.config import Config

RIM_BEADS = 0.5
"""Width of the border, over the bead width, on which the flank of a bead lies."""

UNEVEN_SHARE = 0.5
"""Share of the usual height of a layer that a hump may have where no limit is set: the tip of the wire passes over it."""

MENDING = (1.0, 0.6, 0.3)
"""Shares of a measured unevenness that a layer is tried to mend, one after the other, until every gate is open: the most that
can be proved. A layer gets at most a fifth thicker or thinner for it (``MOST_MENDED``)."""

KEPT_MM = 1e-3
"""Step in which heights are kept."""

HOLE = np.iinfo(np.int32).min
"""In place of a height that is not known."""

MOST_KEPT_MM = 1e5
"""Greatest height that is kept."""


@dataclass(frozen=True, eq=False)
class MapCells:
    """A map in the cells of a part's metal.

    Parameters
    ----------
    corner
        Column and row of the first cell, counted from the origin of the part.
    kept
        (rows, columns) heights in micrometres, :data:`HOLE` where none is known.
    """

    corner: tuple[int, int]
    kept: np.ndarray[Any, np.dtype[np.int32]]

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
        return {
            "corner": list(self.corner),
            "shape": list(self.kept.shape),
            "um": packed,
            "sha256": self.sha256,
        }

    @classmethod
    def of_entry(cls, entry: dict[str, Any]) -> MapCells:
        """Take it back from the journal.

        Raises
        ------
        InputError
            If it is not what was kept.
        """
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
    """Lay a map into the cells of a surface: the mean of the places in a cell; between coarser places, by their distance.

    Cells further than a step of the map from any known place stay holes.
    """
    rows, columns = surface.share.shape
    at = np.stack([found.x_mm, found.y_mm]) / surface.step_mm - np.array(surface.corner)[:, None]
    column, row = np.floor(at).astype(np.int64)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    cell = row[inside] * columns + column[inside]
    count = np.bincount(cell, minlength=rows * columns).reshape(rows, columns).astype(np.float64)
    # Sums over no place at all are whole numbers to numpy.
    total = (
        np.bincount(cell, found.height_mm[inside], rows * columns).astype(np.float64).reshape(rows, columns)
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
        filled = near & ~known & (weight > 0.0)
        height = np.where(
            filled, np.divide(spread, weight, out=np.zeros_like(weight), where=weight > 0.0), height
        )
    sound = np.isfinite(height) & (np.abs(height) < MOST_KEPT_MM)
    kept = np.full(height.shape, HOLE, np.int32)
    kept[sound] = np.round(height[sound] / KEPT_MM).astype(np.int32)
    return MapCells(surface.corner, kept)


@dataclass(frozen=True, eq=False)
class MapFigures:
    """What a map says of a layer.

    Parameters
    ----------
    mean_mm
        Mean height of the layer over the base plate.
    hump_mm, hump_at_mm, dip_mm, dip_at_mm
        How far the highest spot of a bead lies over the mean, and where; and the lowest under it.
    slope_deg, slope_to_deg
        Slope of the plane through the layer, and the direction in which it rises.
    known
        Share of the layer of which the height is known.
    over_mm
        (rows, columns) height over the mean, in the cells of the surface.
    """

    mean_mm: float
    hump_mm: float
    hump_at_mm: tuple[float, float]
    dip_mm: float
    dip_at_mm: tuple[float, float]
    slope_deg: float
    slope_to_deg: float
    known: float
    over_mm: Floats

    def told(self) -> dict[str, Any]:
        """Return the figures for an answer, and for the certificate of the layer on it."""
        return {
            "mean_mm": round(self.mean_mm, 6), "hump_mm": round(self.hump_mm, 4), "hump_at_mm": list(self.hump_at_mm),
            "dip_mm": round(self.dip_mm, 4), "dip_at_mm": list(self.dip_at_mm), "slope_deg": round(self.slope_deg, 4),
            "slope_to_deg": round(self.slope_to_deg, 1), "known": round(self.known, 4),
        }  # fmt: skip


class UnevenLayer(InputError):
    """A measured layer on which none can be laid; `code` says why."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code


def figures_of(cells: MapCells, surface: Surface, config: Config) -> MapFigures:
    """Judge a map on the metal of the layer that it was taken of.

    Raises
    ------
    UnevenLayer
        If it is of another grid, nothing was laid, too little of the layer is known, or it is too uneven.
    """
    settings, bead_mm = config.height_map, config.process.bead_width_mm
    metal = surface.share >= HALF
    if not metal.any():
        raise UnevenLayer("map", "a height map is of a layer that was laid: nothing stands yet")
    if cells.corner != surface.corner or cells.kept.shape != surface.share.shape:
        raise UnevenLayer("map", "the height map is in cells of another part")
    depth_mm = ndimage.distance_transform_edt(np.pad(metal, 1))[1:-1, 1:-1] * surface.step_mm
    inner = metal & (depth_mm > RIM_BEADS * bead_mm)
    judged = inner if inner.any() else metal
    height = cells.height_mm
    known = judged & np.isfinite(height)
    if known.any():
        known &= np.abs(height - np.median(height[known])) <= settings.spike_mm
    share = float(known.sum() / judged.sum())
    if share < settings.least_known:
        x, y = _place(surface, _deepest(judged & ~known))
        raise UnevenLayer(
            "map-holes",
            f"the height map knows {100 * share:.0f} % of the layer, height_map.least_known is {100 * settings.least_known:.0f} %: "
            f"the middle of the largest hole is at ({x:.1f}, {y:.1f})",
        )
    mean_mm = float(height[known].mean())
    row, column = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    over = height[row, column] - mean_mm
    spots = _spots(over, known, SPOT_BEADS * bead_mm / surface.step_mm)
    top, low = int(np.argmax(np.where(known, spots, -np.inf))), int(np.argmin(np.where(known, spots, np.inf)))
    slope = _slope(over, known, surface.step_mm)
    figures = MapFigures(
        mean_mm, float(spots.flat[top]), _place(surface, top), -float(spots.flat[low]), _place(surface, low),
        math.degrees(math.atan(math.hypot(*slope))), math.degrees(math.atan2(slope[1], slope[0])) % 360.0, share, over,
    )  # fmt: skip
    limit = settings.uneven_mm
    if limit is None:
        limit = min(config.process.largest_unevenness_mm, UNEVEN_SHARE * config.layer_height_mm)
    if max(figures.hump_mm, figures.dip_mm) > limit:
        hump = figures.hump_mm >= figures.dip_mm
        off, (x, y) = (figures.hump_mm, figures.hump_at_mm) if hump else (figures.dip_mm, figures.dip_at_mm)
        raise UnevenLayer(
            "map-uneven",
            f"the layer lies {off:.2f} mm {'over' if hump else 'under'} its mean of {mean_mm:.3f} mm at ({x:.1f}, {y:.1f}): at most "
            f"{limit:.2f} mm can be mended (height_map.uneven_mm): machine or fill it there, and measure again",
        )
    return figures


def _spots(over: Floats, known: Bools, sigma: float) -> Floats:
    """Mean over the spot of a bead, of what is known."""
    weight = ndimage.gaussian_filter(known.astype(np.float64), sigma, mode="constant")
    value = ndimage.gaussian_filter(np.where(known, over, 0.0), sigma, mode="constant")
    return np.divide(value, weight, out=np.zeros_like(value), where=known & (weight > 0.0))


def _slope(over: Floats, known: Bools, step_mm: float) -> tuple[float, float]:
    """Gradient of the plane through known cells; 0 along a direction in which they do not extend."""
    row, column = np.nonzero(known)
    places = np.column_stack([column * step_mm, row * step_mm]).astype(np.float64)
    places -= places.mean(axis=0)
    found, *_ = np.linalg.lstsq(places, over[known], rcond=1e-9)
    return float(found[0]), float(found[1])


def _deepest(cells: Bools) -> int:
    """Cell that is furthest from all that are not among some."""
    return int(np.argmax(ndimage.distance_transform_edt(np.pad(cells, 1))[1:-1, 1:-1]))


def _place(surface: Surface, cell: int) -> tuple[float, float]:
    row, column = divmod(cell, surface.share.shape[1])
    x, y = ((np.array([column, row]) + np.array(surface.corner) + 0.5) * surface.step_mm).tolist()
    return round(x, 2), round(y, 2)
