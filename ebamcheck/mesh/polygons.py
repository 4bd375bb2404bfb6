"""Polygons of mesh files as triangles, and checks shared by the readers."""

from __future__ import annotations

import re

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
        token = bad[:40].decode("ascii", "replace")
        raise InputError(f"{where}: {token!r} is not a number{decimal_comma(token)}") from None


def decimal_comma(token: str) -> str:
    """Say what to do where a number has a comma in place of its point; empty for any other token.

    Examples
    --------
    >>> decimal_comma("1,5"), decimal_comma("1.5x")
    (': it has a decimal comma: export the file with decimal points, or replace the commas', '')
    """
    if not re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", token):
        return ""
    return ": it has a decimal comma: export the file with decimal points, or replace the commas"


def _is_number(token: bytes) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return b"_" not in token
