"""Sides: the points of contours, and what the mesh tells about the segments that end and begin at each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import Bools, Floats
from ebamcheck.mesh.topology import Index

NO_PLANE = -1
"""Number of the plane of a segment that is in none."""

NO_FORM = -1
"""Number of the exact surface of a segment that is on none."""


class Sides(NamedTuple):
    """Points of contours, with the directions in which a contour enters and leaves each."""

    points: Floats
    """(N, 2) mm."""
    before: Floats
    """(N, 2) unit direction on the side of the segment that ends at the point; NaN where unknown."""
    after: Floats
    """(N, 2) unit direction on the side of the segment that begins at the point; NaN where unknown."""
    smooth: Bools
    """(N,) whether the contour has no corner at the point."""
    unknown: Bools
    """(N,) whether nothing is known of the segment after the point: no facet."""
    plane_before: Index
    """(N,) plane in which the segment that ends at the point lies; :data:`NO_PLANE` for none."""
    plane_after: Index
    """(N,) plane in which the segment that begins at the point lies."""
    share: Floats
    """(N,) share, 0 .. 1, of the lift and bend demanded by the normals that is applied at the point; 0 where they are noise: its
    segments stay chords."""
    plausible: Floats
    """(N,) plausible height of the surface over the facets there, over the sine of their slope, mm."""
    form_before: Index
    """(N,) exact surface on which the segment that ends at the point lies, whose section has its direction there;
    :data:`NO_FORM` for none."""
    form_after: Index
    """(N,) exact surface on which the segment that begins at the point lies."""


def as_they_are(points: Floats) -> Sides:
    """Sides of points (N, 2) of which nothing but their places is known."""
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
        np.ones(count),
        np.full(count, np.inf),
        np.full(count, NO_FORM, np.int32),
        np.full(count, NO_FORM, np.int32),
    )
