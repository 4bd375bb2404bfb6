"""Heights at which a part is cut, those of its settings or given ones, and blocks of them that fit in memory."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Floats
from ebamcheck.mesh.part import Part
from ebamcheck.settings.config import Config

LARGEST_STACK = 1_000_000  # most layers of a stack: more come from a mistyped layer height

LARGEST_BLOCK = (
    1024  # most layers of a block, however small their contours: rasters need memory for empty layers, too
)


def layer_heights(part: Part, layer_height: float) -> NDArray[np.float64]:
    """Heights of the middles of uniform layers, from the part's lowest point up, (L,) mm.

    The number of layers is the part's height over the layer height, rounded to the nearest, at least 1;
    layer k spans ``zmin + k h .. zmin + (k + 1) h`` and is cut at its middle.

    Parameters
    ----------
    part
        The part as placed.
    layer_height
        Height of one layer, mm.

    Returns
    -------
    ndarray
        (L,) absolute heights of the cuts, mm, ascending.

    Raises
    ------
    SettingsError
        If the layer height is not positive, or would give more than :data:`LARGEST_STACK` layers.

    Examples
    --------
    >>> from ebamcheck_models import CUBE
    >>> layer_heights(CUBE.tessellate(0.1), 5.0).tolist()
    [2.5, 7.5, 12.5, 17.5]
    """
    if not (math.isfinite(layer_height) and layer_height > 0.0):
        raise SettingsError(f"layer height {layer_height} mm: give a positive number of millimetres")
    bottom, top = float(part.bounds[0, 2]), float(part.bounds[1, 2])
    count = max(1, math.ceil((top - bottom) / layer_height - 0.5 - 1e-9))
    if count > LARGEST_STACK:
        raise SettingsError(
            f"layer height {layer_height} mm cuts {top - bottom:g} mm into {count} layers, "
            f"over the limit of {LARGEST_STACK}: give a larger one, or check the unit of the part"
        )
    if count == 1 and top - bottom < layer_height:
        return np.array([0.5 * (bottom + top)])
    return np.asarray(bottom + (np.arange(count) + 0.5) * layer_height, dtype=np.float64)


def checked_heights(heights: ArrayLike) -> NDArray[np.float64]:
    """Heights as a float64 column; raises :class:`SettingsError` if one is not finite."""
    column = np.asarray(heights, dtype=np.float64).reshape(-1)
    if not np.isfinite(column).all():
        k = int(np.flatnonzero(~np.isfinite(column))[0])
        raise SettingsError(f"height {k} is {column[k]}: heights must be finite numbers of millimetres")
    return column


def is_rising(heights: NDArray[np.float64]) -> bool:
    """Whether each height is above the one before it."""
    return bool((np.diff(heights) > 0.0).all())


def crossing_counts(part: Part, heights: ArrayLike) -> NDArray[np.int64]:
    """Number of facets with ``min z <= h < max z`` at each height, (L,): those that a section at h + 0 cuts."""
    planes = np.asarray(heights, dtype=np.float64).reshape(-1)
    order = np.argsort(planes, kind="stable")
    level = np.searchsorted(planes[order], part.vertices[:, 2])
    a, b, c = level[part.faces.T]
    # A facet is cut by the planes between the levels of its vertices.
    begin, end = (
        np.bincount(reach(reach(a, b), c), minlength=planes.size + 1) for reach in (np.minimum, np.maximum)
    )
    counts = np.empty(planes.size, np.int64)
    counts[order] = np.cumsum(begin - end)[: planes.size]
    return counts


def layer_blocks(part: Part, heights: ArrayLike, most_points: int) -> NDArray[np.int64]:
    """Borders (B + 1,) from 0 to L of consecutive blocks of layers, each small enough to be processed at once.

    An exact contour has one point per cut facet, so the memory of a block is known before anything is sliced. A single layer with
    more than `most_points` is a block of its own; without a layer the borders are ``[0, 0]``.
    """
    ends = np.cumsum(crossing_counts(part, heights))
    borders = [0]
    while borders[-1] < ends.size:
        start = borders[-1]
        before = ends[start - 1] if start else 0
        fitting = int(np.searchsorted(ends, before + most_points, side="right"))
        borders.append(min(max(fitting, start + 1), start + LARGEST_BLOCK, ends.size))
    return np.array(borders if ends.size else [0, 0], dtype=np.int64)


def cut_heights(part: Part, config: Config) -> Floats:
    """Heights of the cuts by the settings, (L,) mm, checked to rise and to lie in the part."""
    if not config.layers.heights_mm:
        return layer_heights(part, config.layer_height_mm)
    heights = checked_heights(config.layers.heights_mm)
    if not is_rising(heights):
        raise SettingsError("layers.heights_mm must rise from layer to layer: sort them and drop repeats")
    return heights_within(part, heights, "layers.heights_mm")


def heights_within(part: Part, heights: ArrayLike, named: str) -> Floats:
    """Return heights after checking that all of them cut the part; `named` tells messages where they were given.

    A section is that at z = h + 0, so a cut at the lowest point is valid, and one at the highest is empty.
    """
    column = checked_heights(heights)
    low, high = part.bounds[:, 2].tolist()
    outside = np.flatnonzero((column < low) | (column > high))
    if outside.size:
        more = f" (and {outside.size - 1} more)" if outside.size > 1 else ""
        raise SettingsError(
            f"{named}: {column[outside[0]]:.10g} mm{more} is outside of the part {part.name!r}, which reaches from "
            f"z = {low:.10g} to {high:.10g} mm"
        )
    return column
