"""Heights at which a part is cut, and blocks of them that fit in memory."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.errors import SettingsError
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.kernels import kernel, run_blocks

Levels = NDArray[np.int32]

LARGEST_STACK = 1_000_000
"""Most layers of a stack: more come from a mistyped layer height."""

LARGEST_BLOCK = 1024
"""Most layers of a block, however small their contours: rasters need memory for empty layers, too."""

SMALLEST_BLOCK = 65536
"""Fewest vertices or facets worth a thread."""


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
    rising, z = planes[order], np.ascontiguousarray(part.vertices[:, 2])
    level = np.empty(z.size, np.int32)
    run_blocks(lambda a, b: _levels(z, rising, level, a, b), z.size, SMALLEST_BLOCK)
    changes = run_blocks(
        lambda a, b: _level_changes(part.faces, level, planes.size, a, b), len(part.faces), SMALLEST_BLOCK
    )
    counts = np.empty(planes.size, np.int64)
    counts[order] = np.cumsum(np.sum(changes, axis=0))[: planes.size]
    return counts


@kernel
def _levels(
    z: NDArray[np.float64], planes: NDArray[np.float64], level: Levels, start: int, stop: int
) -> None:
    """Count the rising planes under each of the vertices ``[start, stop)``."""
    for v in range(start, stop):
        level[v] = np.searchsorted(planes, z[v])


@kernel
def _level_changes(
    faces: NDArray[np.int32], level: Levels, planes: int, start: int, stop: int
) -> NDArray[np.int64]:
    """Count the facets ``[start, stop)`` that each plane cuts and the one below it does not, less the other way round.

    A facet is cut by the planes between the levels of its vertices.
    """
    change = np.zeros(planes + 1, np.int64)
    for f in range(start, stop):
        a, b, c = level[faces[f, 0]], level[faces[f, 1]], level[faces[f, 2]]
        change[min(a, b, c)] += 1
        change[max(a, b, c)] -= 1
    return change


def layer_blocks(part: Part, heights: ArrayLike, most_points: int) -> NDArray[np.int64]:
    """Borders (B + 1,) of consecutive blocks of layers, each small enough to be processed at once.

    An exact contour has one point per cut facet, so the memory of a block is known before anything is sliced.

    Parameters
    ----------
    part
        The part as placed.
    heights
        (L,) heights, mm.
    most_points
        Most points of a block; a single layer with more is a block of its own.

    Returns
    -------
    numpy.ndarray
        From 0 to L; ``[0, 0]`` if there is no layer.
    """
    ends = np.cumsum(crossing_counts(part, heights))
    borders = [0]
    while borders[-1] < ends.size:
        start = borders[-1]
        before = ends[start - 1] if start else 0
        fitting = int(np.searchsorted(ends, before + most_points, side="right"))
        borders.append(min(max(fitting, start + 1), start + LARGEST_BLOCK, ends.size))
    return np.array(borders if ends.size else [0, 0], dtype=np.int64)
