"""Polygons of mesh files as triangles, and checks shared by the readers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError


def fans(sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangle fans from the first corner of each polygon, as rows of corners.

    Parameters
    ----------
    sizes
        (P,) number of corners of each polygon, 3 or more; corners are numbered polygon after polygon.

    Returns
    -------
    NDArray
        (T, 3) rows of corners, n - 2 triangles for a polygon of n, in the order of the polygons.

    Examples
    --------
    >>> fans(np.array([3, 4])).tolist()
    [[0, 1, 2], [3, 4, 5], [3, 5, 6]]
    """
    starts = np.concatenate([[0], np.cumsum(sizes)])[:-1].astype(np.int64)
    counts = sizes - 2
    first = np.repeat(starts, counts)
    place = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([first, first + place + 1, first + place + 2], axis=1)


def polygon_corners(
    vertices: NDArray[np.float64], index: NDArray[np.int64], sizes: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Corner points (T, 3, 3) of polygons given by rows of vertices, (sum of sizes,)."""
    return vertices[index[fans(sizes)]]


def checked_finite(corners: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """Return corner points (F, 3, 3) unchanged; raises :class:`InputError` with the place if one is not finite."""
    if not np.isfinite(corners).all():
        facet, corner, axis = np.argwhere(~np.isfinite(corners))[0]
        raise InputError(
            f"{name}: facet {facet}, vertex {corner}, {'xyz'[axis]} is {corners[facet, corner, axis]}: "
            "coordinates must be finite"
        )
    return corners


def numbers_of(tokens: list[bytes], where: str) -> NDArray[np.float64]:
    """Decimal numbers from tokens; raises :class:`InputError` with the first that is none."""
    try:
        if any(b"_" in token for token in tokens):
            raise ValueError
        return np.array(tokens, dtype=np.bytes_).astype(np.float64) if tokens else np.zeros(0)
    except ValueError:
        bad = next(token for token in tokens if not _is_number(token))
        raise InputError(f"{where}: {bad[:40].decode('ascii', 'replace')!r} is not a number") from None


def _is_number(token: bytes) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return b"_" not in token
