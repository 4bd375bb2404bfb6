"""Layer classes: whether a plane passes through vertices or faces of the part, where slicers differ by definition."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.mesh.part import Part

GENERIC = "generic"
VERTEX_ON_PLANE = "vertex-on-plane"
FACE_ON_PLANE = "face-on-plane"
UNKNOWN = "unknown"
"""Class of a layer if no part is given."""


def layer_classes(part: Part, heights: ArrayLike, margin_mm: float) -> NDArray[np.str_]:
    """Class of each layer, (L,).

    Parameters
    ----------
    part
        The part as placed.
    heights
        (L,) absolute heights, mm.
    margin_mm
        Distance from the plane within which a vertex counts as on it.

    Returns
    -------
    numpy.ndarray
        ``face-on-plane`` where a whole facet lies within the margin of the plane (a level facet, or one too
        small to be told from it), else ``vertex-on-plane`` where a vertex does, else ``generic``. Vertices
        that no facet uses do not count.
    """
    planes = np.asarray(heights, dtype=np.float64).reshape(-1)
    classes = np.full(planes.shape, GENERIC, dtype=f"<U{len(VERTEX_ON_PLANE)}")
    if not len(part.faces):
        return classes
    used = np.zeros(len(part.vertices), np.bool_)
    used[part.faces] = True
    levels = np.sort(part.vertices[used, 2])
    first = np.searchsorted(levels, planes - margin_mm, side="left")
    past = np.searchsorted(levels, planes + margin_mm, side="right")
    classes[past > first] = VERTEX_ON_PLANE
    a, b, c = part.vertices[:, 2][part.faces.T]
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    flat = high - low <= 2.0 * margin_mm
    if not flat.any():
        return classes
    order = np.argsort(low[flat])
    low, high = low[flat][order], high[flat][order]
    # Least upper end among the flat facets that start at or above each place, in one sweep from the top.
    least_high = np.append(np.minimum.accumulate(high[::-1])[::-1], np.inf)
    classes[least_high[np.searchsorted(low, planes - margin_mm, side="left")] <= planes + margin_mm] = (
        FACE_ON_PLANE
    )
    return classes
