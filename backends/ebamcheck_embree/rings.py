"""Rings under construction: columns that grow layer by layer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck_embree.scene import Floats, Ints

FIRST_POINTS = 4096
FIRST_RINGS = 64
"""Initial room; it doubles as needed."""


class Rings(NamedTuple):
    """Rings of consecutive layers; of the columns, which have room to spare, `used` gives the filled part."""

    points: Floats
    """(N, 2) mm."""
    ring_starts: Ints
    """(R + 1,) first point of each ring."""
    layer_starts: Ints
    """(L + 1,) first ring of each layer."""
    unpaired: Ints
    """(L,) rays of each layer that did not pair."""
    used: Ints
    """(2,) numbers of points and rings so far."""


@kernel
def room_for_rings(layers: int) -> Rings:
    """No rings yet, of so many layers."""
    return Rings(
        np.empty((FIRST_POINTS, 2)),
        np.zeros(FIRST_RINGS, np.int64),
        np.zeros(layers + 1, np.int64),
        np.zeros(layers, np.int64),
        np.zeros(2, np.int64),
    )


@kernel
def append_layer(rings: Rings, layer: int, points: Floats, ring_starts: Ints, shift_mm: Floats) -> Rings:
    """Append the rings of the next layer, shifted by (2,) mm."""
    size, count = rings.used
    more_points, more_rings = len(points), ring_starts.size - 1
    grown = Rings(
        _grown_points(rings.points, size, more_points),
        _grown_starts(rings.ring_starts, count + 1, more_rings),
        rings.layer_starts,
        rings.unpaired,
        rings.used,
    )
    for n in range(more_points):
        grown.points[size + n, 0] = points[n, 0] + shift_mm[0]
        grown.points[size + n, 1] = points[n, 1] + shift_mm[1]
    for n in range(more_rings):
        grown.ring_starts[count + 1 + n] = size + ring_starts[n + 1]
    grown.layer_starts[layer + 1] = count + more_rings
    grown.used[0], grown.used[1] = size + more_points, count + more_rings
    return grown


@kernel
def _grown_points(points: Floats, used: int, more: int) -> Floats:
    if used + more <= len(points):
        return points
    grown = np.empty((2 * (used + more), 2))
    grown[:used] = points[:used]
    return grown


@kernel
def _grown_starts(starts: Ints, used: int, more: int) -> Ints:
    if used + more <= starts.size:
        return starts
    grown = np.empty(2 * (used + more), np.int64)
    grown[:used] = starts[:used]
    return grown
