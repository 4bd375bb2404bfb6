"""Bitmaps: the pixels that change from one layer to the next, and the bitmap of any layer.

A bitmap is a column of 64-bit words, a bit per pixel; a layer's bitmap is the one below it with some bits flipped.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import kernel
from ebamcheck_stencil.crossings import Crossings
from ebamcheck_stencil.field_of_view import WORD_BITS, FieldOfView

Words = NDArray[np.uint64]


class Flips(NamedTuple):
    """Pixels that change at each layer: ``pixels[starts[k] : starts[k + 1]]`` at layer `k`."""

    starts: NDArray[np.int64]
    pixels: NDArray[np.uint32]


def empty_bitmap(view: FieldOfView) -> Words:
    """A bitmap of the field with no pixel solid."""
    return np.zeros(view.height_px * view.stride_px // WORD_BITS, np.uint64)


def flips_by_layer(crossings: Crossings, heights: NDArray[np.float64]) -> Flips:
    """Assign crossings to the first layer at or above them; those above the last layer are left out.

    A crossing exactly at the height of a layer counts as below it, so a layer shows the section at z = h + 0.
    """
    return Flips(*_flips_by_layer(crossings.pixels, crossings.heights, heights))


@kernel
def _bucket(height: float, lowest: float, per_mm: float, buckets: int) -> int:
    """Bucket of a height; it never falls where the height rises."""
    place = (height - lowest) * per_mm
    if not place > 0.0:
        return 0
    return int(min(place, float(buckets - 1)))


@kernel
def _flips_by_layer(
    pixels: NDArray[np.uint32], crossing_heights: NDArray[np.float64], heights: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.uint32]]:
    """Counting sort of crossings by layer; layers are looked up in equal buckets of height."""
    count = heights.size
    starts = np.zeros(count + 2, np.int64)
    if count == 0:
        return starts[:1].copy(), np.empty(0, np.uint32)
    buckets = 2 * count
    lowest = heights[0]
    extent = heights[count - 1] - lowest
    per_mm = buckets / extent if extent > 0.0 else 0.0
    first = np.zeros(buckets + 1, np.int64)
    for k in range(count):
        first[_bucket(heights[k], lowest, per_mm, buckets) + 1] += 1
    for b in range(buckets):
        first[b + 1] += first[b]
    layer = np.empty(pixels.size, np.int32)
    for i in range(pixels.size):
        height = crossing_heights[i]
        b = _bucket(height, lowest, per_mm, buckets)
        low, high = first[b], first[b + 1]
        while low < high:
            middle = (low + high) >> 1
            if heights[middle] < height:
                low = middle + 1
            else:
                high = middle
        layer[i] = low
        starts[low + 1] += 1
    for k in range(count + 1):
        starts[k + 1] += starts[k]
    place = starts[:-1].copy()
    flipped = np.empty(starts[count], np.uint32)
    for i in range(pixels.size):
        k = layer[i]
        if k < count:
            flipped[place[k]] = pixels[i]
            place[k] += 1
    return starts[: count + 1].copy(), flipped


@kernel
def flip(bitmap: Words, pixels: NDArray[np.uint32]) -> None:
    """Flip pixels of a bitmap in place."""
    for i in range(pixels.size):
        bitmap[pixels[i] >> np.uint32(6)] ^= np.uint64(1) << np.uint64(pixels[i] & np.uint32(63))


def as_image(bitmap: Words, view: FieldOfView) -> NDArray[np.bool_]:
    """The bitmap as an image (height, width), row 0 at the least y."""
    bits = np.unpackbits(bitmap.astype("<u8").view(np.uint8), bitorder="little")
    return bits.reshape(view.height_px, view.stride_px)[:, : view.width_px].astype(np.bool_)
