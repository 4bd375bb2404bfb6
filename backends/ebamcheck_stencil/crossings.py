"""Crossings: the heights at which the ray of each pixel, going up, enters and leaves the solid.

A fragment is a pair of pixel and facet: the pixel's ray meets the facet, at a height interpolated in double precision from the very
lattice triangle that was drawn. A crossing is where the winding number along the ray changes between 0 or less and 1 or more. A
bitmap is a column of 64-bit words, a bit per pixel; a layer's bitmap is the one below it with the pixels flipped that change there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Floats, Ints, ShortInts, kernel
from ebamcheck.mesh.part import Part
from ebamcheck.threads import run_blocks
from ebamcheck_stencil.field_of_view import SUBPIXELS, WORD_BITS, FieldOfView

SMALLEST_BLOCK = 65536  # fewest fragments or pixels worth a thread


class Crossings(NamedTuple):
    """Where rays enter and leave the solid, sorted by pixel and then by height."""

    pixels: NDArray[np.uint32]  # (E,) `row * stride + column` in the field of view
    heights: Floats  # (E,) mm: the pixel changes from empty to solid or back above this height
    # Number of rays that do not leave the solid as often as they enter it: the surface is not closed
    unbalanced: int


def join(parts: Sequence[Crossings]) -> Crossings:
    """Join the crossings of several blocks of pixels."""
    return Crossings(
        np.concatenate([np.zeros(0, np.uint32), *(p.pixels for p in parts)]),
        np.concatenate([np.zeros(0), *(p.heights for p in parts)]),
        sum(p.unbalanced for p in parts),
    )


def crossings_of_fragments(
    fragments: NDArray[np.uint32], part: Part, lattice: ShortInts, stride: int, first_row: int, rows: int
) -> list[Crossings]:
    """Resolve the fragments (n, 2: pixel, facet) of some rows of pixels into crossings, block by block."""
    heights = np.empty(len(fragments))
    signs = np.empty(len(fragments), np.int8)
    z = np.ascontiguousarray(part.vertices[:, 2])

    def measure(start: int, stop: int) -> None:
        _measure(fragments, start, stop, part.faces, lattice, z, stride, heights, signs)

    run_blocks(measure, len(fragments), SMALLEST_BLOCK)
    first_pixel = first_row * stride

    def resolve(start: int, stop: int) -> Crossings:
        return _resolve(fragments, heights, signs, first_pixel + start, first_pixel + stop)

    return run_blocks(resolve, rows * stride, SMALLEST_BLOCK)


@kernel
def _measure(
    fragments: NDArray[np.uint32], start: int, stop: int, faces: ShortInts, lattice: ShortInts, z: Floats,
    stride: int, heights: Floats, signs: NDArray[np.int8],
) -> None:  # fmt: skip
    """Height and sign (+1 going in, -1 going out) of fragments ``start .. stop - 1``."""
    for i in range(start, stop):
        pixel = np.int64(fragments[i, 0])
        facet = np.int64(fragments[i, 1])
        a, b, c = faces[facet, 0], faces[facet, 1], faces[facet, 2]
        ax, ay = np.int64(lattice[a, 0]), np.int64(lattice[a, 1])
        ux, uy = np.int64(lattice[b, 0]) - ax, np.int64(lattice[b, 1]) - ay
        vx, vy = np.int64(lattice[c, 0]) - ax, np.int64(lattice[c, 1]) - ay
        row = pixel // stride
        px = (pixel - row * stride) * SUBPIXELS + SUBPIXELS // 2 - ax
        py = row * SUBPIXELS + SUBPIXELS // 2 - ay
        doubled_area = ux * vy - uy * vx
        rise = float(px * vy - py * vx) * (z[b] - z[a]) + float(ux * py - uy * px) * (z[c] - z[a])
        height = z[a] + rise / doubled_area
        lowest, highest = min(z[a], z[b], z[c]), max(z[a], z[b], z[c])
        heights[i] = min(max(height, lowest), highest)
        signs[i] = -1 if doubled_area > 0 else 1


@kernel
def _resolve(
    fragments: NDArray[np.uint32],
    fragment_heights: Floats,
    fragment_signs: NDArray[np.int8],
    start: int,
    stop: int,
) -> Crossings:
    """Crossings of pixels ``start .. stop - 1``."""
    # Into the order of their pixels, by counting. Each thread looks through all fragments: that takes less than one to sort them.
    starts = np.zeros(stop - start + 1, np.int64)
    for i in range(fragments.shape[0]):
        pixel = np.int64(fragments[i, 0]) - start
        if 0 <= pixel < stop - start:
            starts[pixel + 1] += 1
    for p in range(stop - start):
        starts[p + 1] += starts[p]
    place = starts[:-1].copy()
    heights, signs = np.empty(starts[-1]), np.empty(starts[-1], np.int8)
    for i in range(fragments.shape[0]):
        pixel = np.int64(fragments[i, 0]) - start
        if 0 <= pixel < stop - start:
            heights[place[pixel]], signs[place[pixel]] = fragment_heights[i], fragment_signs[i]
            place[pixel] += 1
    out_pixels = np.empty(heights.size, np.uint32)
    out_heights = np.empty(heights.size)
    n = 0
    unbalanced = 0
    for p in range(stop - start):
        a, b = starts[p], starts[p + 1]
        if a == b:
            continue
        # By insertion, as most pixels have two fragments; many by Shell's method.
        gap = 1
        while gap < (b - a) // 32:
            gap = 3 * gap + 1
        while gap > 0:
            for i in range(a + gap, b):
                height, sign = heights[i], signs[i]
                k = i
                while k >= a + gap and heights[k - gap] > height:
                    heights[k], signs[k] = heights[k - gap], signs[k - gap]
                    k -= gap
                heights[k], signs[k] = height, sign
            gap //= 3
        winding = 0
        solid = False
        for i in range(a, b):
            winding += signs[i]
            # Facets at one height act together: only the sum of their signs counts.
            if i + 1 < b and heights[i + 1] == heights[i]:
                continue
            if (winding > 0) != solid:
                solid = not solid
                out_pixels[n] = start + p
                out_heights[n] = heights[i]
                n += 1
        unbalanced += winding != 0
    return Crossings(out_pixels[:n], out_heights[:n], unbalanced)


Words = NDArray[np.uint64]


class Flips(NamedTuple):
    """Pixels that change at each layer: ``pixels[starts[k] : starts[k + 1]]`` at layer `k`."""

    starts: Ints
    pixels: NDArray[np.uint32]


def empty_bitmap(view: FieldOfView) -> Words:
    """A bitmap of the field with no pixel solid."""
    return np.zeros(view.height_px * view.stride_px // WORD_BITS, np.uint64)


@kernel
def _bucket(height: float, lowest: float, per_mm: float, buckets: int) -> int:
    """Bucket of a height; it never falls where the height rises."""
    place = (height - lowest) * per_mm
    if not place > 0.0:
        return 0
    return int(min(place, float(buckets - 1)))


@kernel
def flips_by_layer(crossings: Crossings, heights: Floats) -> Flips:
    """Assign crossings to the first layer at or above them, so that it shows z = h + 0; those above the last are left out."""
    # A counting sort by layer; layers are looked up in equal buckets of height.
    pixels = crossings.pixels
    count = heights.size
    starts = np.zeros(count + 2, np.int64)
    if count == 0:
        return Flips(starts[:1].copy(), np.empty(0, np.uint32))
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
        height = crossings.heights[i]
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
    return Flips(starts[: count + 1].copy(), flipped)


@kernel
def flip(bitmap: Words, pixels: NDArray[np.uint32]) -> None:
    """Flip pixels of a bitmap in place."""
    for i in range(pixels.size):
        bitmap[pixels[i] >> np.uint32(6)] ^= np.uint64(1) << np.uint64(pixels[i] & np.uint32(63))
