"""Facets as the literal mode sends them: those that hold a pixel centre, in bands of height from the top of the part downwards.

Where the near plane cuts a facet, the driver rounds the points of the cut, so those that only come near a centre are sent for the
layers that cut them. Within a band facets keep the order of the file, in which neighbours share vertices.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Floats, Ints, ShortInts, kernel
from ebamcheck.mesh.part import Part
from ebamcheck.threads import run_blocks
from ebamcheck_stencil.field_of_view import SUBPIXELS, FieldOfView

BANDS = 256  # bands of height, of about as many facets each: a layer's draw begins and ends with a band
SAMPLES = 2**14  # facets by which the bands are laid
FACETS_A_BLOCK = 65536  # fewest facets worth a thread
# Distance along x and y, in lattice steps, that drivers may move a point in which they clip an edge
CLIPPED_SLACK = 1.0
# Distance that such a point may be off by float32, as a share of the viewport's side
ROUNDED_SHARE = 2.0**-21
HOLDS, COMES_NEAR = 1, 2  # what a facet can do with a pixel centre


class DrawnFacets(NamedTuple):
    """Facets in the order in which they are drawn."""

    # (F, 3) vertices of each: first the facets that hold a centre, then those that come near one
    faces: ShortInts
    holding: Bands
    near: Bands

    def ranges(self, heights: Floats, slack: float) -> list[list[tuple[int, int]]]:
        """First facet and number of each run of facets to be drawn for each height; a height may be off by `slack`."""
        below = self.holding.reaching(heights - slack)
        first, past = self.near.cut(heights + slack), self.near.reaching(heights - slack)
        behind = self.holding.size
        return [
            [(0, a), (behind + b, c - b)] if c > b else [(0, a)]
            for a, b, c in zip(below.tolist(), first.tolist(), past.tolist(), strict=True)
        ]


class Bands(NamedTuple):
    """Consecutive facets, by bands of height from the top."""

    tops: Floats  # (B,) highest point of each band, falling
    bottoms: Floats  # (B,) lowest point of each band and those before it, falling
    ends: Ints  # (B + 1,) facets before each band, and all of them

    @property
    def size(self) -> int:
        """Number of facets."""
        return int(self.ends[-1])

    def reaching(self, heights: Floats) -> Ints:
        """Number of facets that hold all which reach to or above each height."""
        return self.ends[np.searchsorted(-self.tops, -heights, side="right")]

    def cut(self, heights: Floats) -> Ints:
        """Number of facets before the first that reaches to or below each height."""
        return self.ends[np.searchsorted(-self.bottoms, -heights, side="left")]


def drawn_facets(part: Part, lattice: ShortInts, heights: NDArray[np.float32], view: FieldOfView) -> DrawnFacets:
    """Choose and order the facets of a part whose vertices lie at `lattice` (N, 2) and `heights` (N,)."""
    slack = math.ceil(CLIPPED_SLACK + ROUNDED_SHARE * view.viewport_px * SUBPIXELS)
    reach = np.empty(len(part.faces), np.uint8)
    extents = np.empty((len(part.faces), 2), np.float32)

    def choose(start: int, stop: int) -> None:
        _choose(lattice, heights, part.faces, slack, start, stop, reach, extents)

    run_blocks(choose, len(part.faces), FACETS_A_BLOCK)
    order, holding = _banded(np.flatnonzero(reach == HOLDS), extents)
    near_order, near = _banded(np.flatnonzero(reach == COMES_NEAR), extents)
    return DrawnFacets(part.faces[np.concatenate([order, near_order])], holding, near)


def _banded(chosen: Ints, extents: NDArray[np.float32]) -> tuple[Ints, Bands]:
    """Order facets by bands of height."""
    if not chosen.size:
        return chosen, Bands(np.empty(0), np.empty(0), np.zeros(1, np.int64))
    bottoms, tops = extents[chosen].astype(np.float64).T
    sample = tops[:: max(1, tops.size // SAMPLES)]
    edges = np.unique(np.quantile(sample, np.linspace(0.0, 1.0, BANDS + 1)[1:-1]))
    band = (edges.size - np.searchsorted(edges, tops, side="right")).astype(np.uint16)
    order = np.argsort(band, kind="stable")
    starts = np.flatnonzero(np.diff(band[order], prepend=np.uint16(BANDS)))
    return chosen[order], Bands(
        np.maximum.reduceat(tops[order], starts),
        np.minimum.accumulate(np.minimum.reduceat(bottoms[order], starts)),
        np.concatenate([starts, [order.size]]),
    )


@kernel
def _choose(
    lattice: ShortInts, heights: NDArray[np.float32], faces: ShortInts, slack: int, start: int, stop: int,
    reach: NDArray[np.uint8], extents: NDArray[np.float32],
) -> None:  # fmt: skip
    """Tell of facets ``start .. stop - 1`` whether they hold a pixel centre or come within `slack` lattice steps of one, and their
    heights."""
    for i in range(start, stop):
        a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
        extents[i, 0] = min(heights[a], heights[b], heights[c])
        extents[i, 1] = max(heights[a], heights[b], heights[c])
        reach[i] = 0
        if _is_near_a_centre(lattice, a, b, c, slack):
            reach[i] = HOLDS if _is_near_a_centre(lattice, a, b, c, 0) else COMES_NEAR


@kernel
def _is_near_a_centre(lattice: ShortInts, a: int, b: int, c: int, slack: int) -> bool:
    """Whether a pixel centre lies in a facet grown by a square of `slack` to each side (a Minkowski sum)."""
    ax, ay = int(lattice[a, 0]), int(lattice[a, 1])
    bx, by = int(lattice[b, 0]), int(lattice[b, 1])
    cx, cy = int(lattice[c, 0]), int(lattice[c, 1])
    if (bx - ax) * (cy - ay) < (by - ay) * (cx - ax):
        bx, by, cx, cy = cx, cy, bx, by
    first_row, last_row = _centres(min(ay, by, cy) - slack, max(ay, by, cy) + slack)
    low_x, high_x = min(ax, bx, cx) - slack, max(ax, bx, cx) + slack
    for row in range(first_row, last_row + 1):
        y = row * SUBPIXELS + SUBPIXELS // 2
        low, high = _left_of(low_x, high_x, ax, ay, bx, by, y, slack)
        low, high = _left_of(low, high, bx, by, cx, cy, y, slack)
        low, high = _left_of(low, high, cx, cy, ax, ay, y, slack)
        first, last = _centres(low, high)
        if first <= last:
            return True
    return False


@kernel
def _centres(low: int, high: int) -> tuple[int, int]:
    """First and last row (or column) of pixels whose centres lie between two places of the lattice."""
    half = SUBPIXELS // 2
    return (low - half + SUBPIXELS - 1) // SUBPIXELS, (high - half) // SUBPIXELS


@kernel
def _left_of(low: int, high: int, ax: int, ay: int, bx: int, by: int, y: int, slack: int) -> tuple[int, int]:
    """Part of ``low .. high`` on the line at y that lies left of the line from a to b, which is grown by the square."""
    dx, dy = bx - ax, by - ay
    room = dx * (y - ay) + slack * (abs(dx) + abs(dy))
    if dy > 0:
        return low, min(high, ax + room // dy)
    if dy < 0:
        return max(low, ax - room // -dy), high
    return (low, high) if room >= 0 else (high + 1, high)
