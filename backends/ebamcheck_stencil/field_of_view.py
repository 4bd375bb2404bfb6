"""The field of view: the grid of pixels over a part, and the lattice on which facets are drawn.

Rasterisers move every vertex to a lattice of 1/256 pixel. Vertices are put on it here, in double precision from the part's own
corner, and drawn in a viewport whose side is a power of two, exact in float32: which facet covers which pixel is the same on every
driver."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ebamcheck.mesh.part import Part

SUBPIXELS = 256  # lattice steps in a pixel: the 8 bits of GL_SUBPIXEL_BITS that every desktop driver offers
MARGIN_PX = 2  # empty pixels kept around the part, so that every contour closes inside the field of view

# Place of the part's low corner within its pixel (golden-section fractions): parts are drawn in round numbers, and pixel centres would
# lie on faces and 45 degree edges without it
GRID_SHIFT_PX = (0.381966, 0.236068)

WORD_BITS = 64  # rows of bitmaps are padded to whole words of this size
FINEST_AUTOMATIC_MM = 0.1  # the paper's pixel (section 2.2); automatic ones are coarser only for parts over 409.6 mm
FEWEST_AUTOMATIC_PX = 1024
MOST_AUTOMATIC_PX = 4096  # fewest and most pixels along the larger side, for an automatic pixel


@dataclass(frozen=True)
class FieldOfView:
    """Grid of square pixels over a part, seen along z, margins included."""

    pixel_mm: float
    low_mm: tuple[float, float]  # least x and y of the part in build coordinates
    width_px: int
    height_px: int

    @property
    def stride_px(self) -> int:
        """Pixels from one row to the next in pixel numbers and bitmaps: a multiple of :data:`WORD_BITS`."""
        return -(-self.width_px // WORD_BITS) * WORD_BITS

    @property
    def viewport_px(self) -> int:
        """Side of the square viewport that holds the field: the next power of two."""
        return 1 << max(6, (max(self.width_px, self.height_px) - 1).bit_length())

    def snapped(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """Put points (N, 2+) in mm on the lattice: (N, 2), in 1/256 pixel from the field's low corner."""
        lattice = np.empty((len(points), 2), np.int32)
        limit = 2 * self.viewport_px * SUBPIXELS
        for axis in range(2):
            pixels = (points[:, axis] - self.low_mm[axis]) / self.pixel_mm + (MARGIN_PX + GRID_SHIFT_PX[axis])
            # Only vertices that no facet uses can lie outside the field, at any distance.
            lattice[:, axis] = np.clip(np.rint(pixels * SUBPIXELS), -limit, limit)
        return lattice

    def to_mm(self, half_pixels: NDArray[np.integer | np.floating]) -> NDArray[np.float64]:
        """Build coordinates (N, 2) of points in half pixels from the centre of pixel (0, 0)."""
        low_mm, shift_px, pixel_mm = self.affine
        return low_mm + (0.5 * half_pixels + shift_px) * pixel_mm

    @property
    def affine(self) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Low corner (2,) in mm; offset (2,) from it to the centre of pixel (0, 0), in pixels; side of a pixel in mm."""
        return np.array(self.low_mm), 0.5 - MARGIN_PX - np.array(GRID_SHIFT_PX), self.pixel_mm


def automatic_pixel_mm(part: Part) -> float:
    """Pixel side for a part: 0.1 mm or 1/1024 of its larger side in x and y, the finer one, but at least 1/4096 of it."""
    extent = float(part.size[:2].max())
    finest = min(FINEST_AUTOMATIC_MM, extent / FEWEST_AUTOMATIC_PX)
    return max(finest, extent / MOST_AUTOMATIC_PX) or FINEST_AUTOMATIC_MM


def field_of_view(part: Part, pixel_mm: float | None) -> FieldOfView:
    """Lay a field of view over a part; it depends only on the part and the pixel."""
    side = pixel_mm or automatic_pixel_mm(part)
    low, size = part.bounds[0], part.size
    width, height = (math.ceil(float(size[axis]) / side + GRID_SHIFT_PX[axis]) + 2 * MARGIN_PX for axis in range(2))
    return FieldOfView(side, (float(low[0]), float(low[1])), width, height)


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels of the field of view, its low corner at (x, y)."""

    x: int
    y: int
    width: int
    height: int

    def halves(self) -> tuple[Window, Window] | None:
        """Halve the rows or, of a single row, the columns; None for a single pixel."""
        if self.height > 1:
            low = self.height // 2
            return replace(self, height=low), replace(self, y=self.y + low, height=self.height - low)
        if self.width > 1:
            low = self.width // 2
            return replace(self, width=low), replace(self, x=self.x + low, width=self.width - low)
        return None


def windows(view: FieldOfView, largest_px: int, bands: int = 1) -> Iterator[Window]:
    """Cover the field with windows of at most `largest_px` a side, in at least `bands` bands of rows."""
    rows = min(largest_px, max(1, -(-view.height_px // bands)))
    for y in range(0, view.height_px, rows):
        for x in range(0, view.width_px, largest_px):
            yield Window(x, y, min(largest_px, view.width_px - x), min(rows, view.height_px - y))
