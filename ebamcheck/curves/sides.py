"""Sides of contours: their points, and what the mesh tells of the segments that come to and leave each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.rings import Bools, Floats

NO_PLANE = -1
"""In place of a plane's number: the segment is in none."""

NO_FORM = -1
"""In place of the number of an exact surface, where it is not known."""


class Sides(NamedTuple):
    """Points of contours, and the directions in which a contour comes to and leaves each."""

    points: Floats
    """(N, 2) mm."""
    before: Floats
    """(N, 2) unit direction on the side of the segment that ends at the point; NaN where unknown."""
    after: Floats
    """(N, 2) unit direction on the side of the segment that begins at the point; NaN where unknown."""
    smooth: Bools
    """(N,) the contour has no corner there."""
    flat: Bools
    """(N,) the segment after the point may be a flat side: its facet has a neighbour in its plane, or is not known."""
    plane_before: Index
    """(N,) plane in which the segment that ends at the point lies; :data:`NO_PLANE` for none."""
    plane_after: Index
    """(N,) plane in which the segment that begins at the point lies."""
    rough: Bools
    """(N,) the noise of the mesh there exceeds what a lift could win: the point was left, and so should its chords be."""
    share: Floats
    """(N,) of what the normals ask for, that points are lifted by and segments bend by there."""
    plausible: Floats
    """(N,) how high the surface plausibly stands over the facets there, over the sine of their slope, mm."""
    form_before: Index
    """(N,) exact surface on which the segment that ends at the point lies, whose section has its direction there;
    :data:`NO_FORM` for none."""
    form_after: Index
    """(N,) exact surface on which the segment that begins at the point lies."""


def as_they_are(points: Floats) -> Sides:
    """Sides of points of which nothing is known but their places (N, 2)."""
    count = len(points)
    unknown = np.full((count, 2), np.nan)
    return Sides(
        points,
        unknown,
        unknown.copy(),
        np.zeros(count, np.bool_),
        np.ones(count, np.bool_),
        np.full(count, NO_PLANE, np.int32),
        np.full(count, NO_PLANE, np.int32),
        np.zeros(count, np.bool_),
        np.ones(count),
        np.full(count, np.inf),
        np.full(count, NO_FORM, np.int32),
        np.full(count, NO_FORM, np.int32),
    )
