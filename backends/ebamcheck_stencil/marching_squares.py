"""Marching squares on bitmaps: contours half way between solid and empty pixel centres.

A contour is followed with a solid pixel on its left and an empty one on its right; each step tests the two pixels ahead. Pixels
that touch only at a corner stay separate, as in scikit-image's ``find_contours``; points inside straight runs are left out. Rings
are found by their marks, pixels that differ from their right neighbours, which follow the changes from layer to layer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Floats, Ints, ShortInts, kernel
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.threads import run_blocks
from ebamcheck_stencil.crossings import Flips, Words, flip
from ebamcheck_stencil.field_of_view import FieldOfView

# Points for which room is made beyond those at hand, at least where more layers are to come; doubled as needed
SPARE_POINTS = 2**22
FIRST_POINTS = 4096
FIRST_RINGS = 64  # initial sizes of the output columns; they grow as needed
# Most points of contours for each pair of neighbours in a row of which exactly one is solid: itself, and both ends of a run along x after it
POINTS_PER_EDGE = 3

_ONE = np.uint64(1)
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
# Steps and right-hand sides of the four directions of travel +x, +y, -x, -y.
_STEP_X = np.array([1, 0, -1, 0])
_STEP_Y = np.array([0, 1, 0, -1])
_RIGHT_X = np.array([0, 1, 0, -1])
_RIGHT_Y = np.array([-1, 0, 1, 0])


class Rings(NamedTuple):
    """Rings of a block of layers, as marching squares finds them."""

    points: ShortInts  # (N, 2) half pixels from the centre of pixel (0, 0)
    starts: Ints  # (R + 1,) first point of each ring
    least: Ints  # (R,) row of each ring's lexicographically least point
    counts: Ints  # (L,) rings of each layer


@kernel
def contours_of_layers(flips: Flips, bitmaps: NDArray[np.uint64], start: int, stop: int, row_words: int) -> Rings:
    """Contours of layers ``start .. stop - 1`` by their `bitmaps` (L, words).

    Where L is 0, a bitmap of so many words, of which no pixel is solid, changes by the flips of one layer after another.
    """
    drawn = bitmaps.shape[0] > 0
    words = bitmaps.shape[1]
    bitmap = np.zeros(words, np.uint64)
    marks, busy, left = np.empty_like(bitmap), np.zeros((words + 63) // 64, np.uint64), np.zeros_like(bitmap)
    if not drawn:
        flip(bitmap, flips.pixels[: flips.starts[start]])
        _mark_edges(bitmap, marks, busy)
    points = np.empty((FIRST_POINTS, 2), np.int32)
    ends = np.zeros(FIRST_RINGS, np.int64)
    rings = int(np.int64(1))
    counts = np.zeros(stop - start, np.int64)
    for layer in range(start, stop):
        if drawn:
            bitmap = bitmaps[layer]
            _mark_edges(bitmap, marks, busy)
        else:
            changed = flips.pixels[flips.starts[layer] : flips.starts[layer + 1]]
            flip(bitmap, changed)
            _follow_changes(marks, busy, changed)
        before = rings
        points, ends, rings = _add_rings(bitmap, marks, busy, left, row_words, points, ends, rings, stop - layer)
        counts[layer - start] = rings - before
    return Rings(points[: ends[rings - 1]], ends[:rings], _least_points(points, ends[:rings]), counts)


@kernel
def _add_rings(
    bitmap: Words, marks: Words, busy: Words, left: Words, row_words: int, points: ShortInts, ends: Ints,
    rings: int, layers: int,
) -> tuple[ShortInts, Ints, int]:  # fmt: skip
    """Append the rings of a bitmap to the columns, which grow by what the `layers` to come need if they are like this one.

    `busy` has a bit for each word of `marks` that may have some; `left`, 0 before and after, is for marks that no ring has passed.
    """
    size = ends[rings - 1]
    most = POINTS_PER_EDGE * _copy_marks(marks, busy, left)
    if size + most > len(points):
        spare = min((layers - 1) * most, max(SPARE_POINTS, len(points)))
        grown = np.empty((size + most + spare, 2), np.int32)
        grown[:size] = points[:size]
        points = grown
    for group in range(busy.size):
        waiting = busy[group]
        while waiting != 0:
            word = 64 * group + _lowest_bit(waiting)
            waiting &= waiting - _ONE
            while left[word] != 0:
                size = _walk(bitmap, left, word, row_words, points, size)
                if rings == ends.size:
                    ends = np.concatenate((ends, np.zeros_like(ends)))
                ends[rings] = size
                rings += 1
    return points, ends, rings


@kernel
def _least_points(points: ShortInts, starts: Ints) -> Ints:
    """Row of the lexicographically least point of each ring."""
    least = np.empty(starts.size - 1, np.int64)
    for r in range(least.size):
        best = starts[r]
        for i in range(best + 1, starts[r + 1]):
            if points[i, 0] <= points[best, 0] and (points[i, 0] < points[best, 0] or points[i, 1] < points[best, 1]):
                best = i
        least[r] = best
    return least


@kernel
def _mark_edges(bitmap: Words, marks: Words, busy: Words) -> None:
    """Mark each pixel that differs from its right neighbour; the margin keeps rows apart."""
    busy[:] = 0
    following = np.uint64(0)
    for i in range(bitmap.size - 1, -1, -1):
        marks[i] = bitmap[i] ^ ((bitmap[i] >> _ONE) | (following << np.uint64(63)))
        following = bitmap[i]
        if marks[i] != 0:
            busy[i >> 6] |= _ONE << np.uint64(i & 63)


@kernel
def _follow_changes(marks: Words, busy: Words, pixels: NDArray[np.uint32]) -> None:
    """Bring marks up to date with pixels that have changed: each differs from two neighbours if it did not before."""
    for i in range(pixels.size):
        for pixel in (np.int64(pixels[i]), np.int64(pixels[i]) - 1):
            word = pixel >> 6
            marks[word] ^= _ONE << np.uint64(pixel & 63)
            busy[word >> 6] |= _ONE << np.uint64(word & 63)


@kernel
def _copy_marks(marks: Words, busy: Words, left: Words) -> int:
    """Copy the marks of busy words, count them, and forget words that have none."""
    count = 0
    for group in range(busy.size):
        waiting = busy[group]
        while waiting != 0:
            first = waiting & (~waiting + _ONE)
            waiting ^= first
            word = 64 * group + _lowest_bit(first)
            left[word] = bits = marks[word]
            if bits == 0:
                busy[group] ^= first
            while bits != 0:
                bits &= bits - _ONE
                count += 1
    return count


@kernel
def _is_solid(bitmap: Words, x: int, y: int, row_words: int) -> bool:
    """Whether pixel (x, y) is solid."""
    return bool((bitmap[y * row_words + (x >> 6)] >> np.uint64(x & 63)) & _ONE)


@kernel
def _lowest_bit(word: np.uint64) -> int:
    """Place of the lowest set bit of a word that is not 0."""
    place = 0
    for width in (32, 16, 8, 4, 2, 1):
        if word & (_ALL >> np.uint64(64 - width)) == 0:
            word >>= np.uint64(width)
            place += width
    return place


@kernel
def _walk(bitmap: Words, marks: Words, word: int, row_words: int, points: ShortInts, size: int) -> int:
    """Walk the ring through the first mark of a word, clear its marks and append its corners; the new size."""
    y = word // row_words
    x = (word - y * row_words) * 64 + _lowest_bit(marks[word])
    direction = 1
    if not _is_solid(bitmap, x, y, row_words):
        x += 1
        direction = 3
    first_x, first_y, first_direction = x, y, direction
    first_heading = heading = -1
    while True:
        if direction & 1:
            left = x if direction == 1 else x - 1
            marks[y * row_words + (left >> 6)] &= ~(_ONE << np.uint64(left & 63))
        point_x = 2 * x + _RIGHT_X[direction]
        point_y = 2 * y + _RIGHT_Y[direction]
        ahead_x, ahead_y = x + _STEP_X[direction], y + _STEP_Y[direction]
        # The eight headings count in steps of 45 degrees.
        if not _is_solid(bitmap, ahead_x, ahead_y, row_words):
            new_heading = (2 * direction + 1) & 7
            direction = (direction + 1) & 3
        else:
            x, y = ahead_x, ahead_y
            ahead_x += _RIGHT_X[direction]
            ahead_y += _RIGHT_Y[direction]
            if _is_solid(bitmap, ahead_x, ahead_y, row_words):
                x, y = ahead_x, ahead_y
                new_heading = (2 * direction - 1) & 7
                direction = (direction - 1) & 3
            else:
                new_heading = 2 * direction
        if heading < 0:
            first_heading = new_heading
        elif new_heading != heading:
            points[size, 0], points[size, 1] = point_x, point_y
            size += 1
        heading = new_heading
        if x == first_x and y == first_y and direction == first_direction:
            break
    if heading != first_heading:
        points[size, 0], points[size, 1] = 2 * x + _RIGHT_X[direction], 2 * y + _RIGHT_Y[direction]
        size += 1
    return size


# Side of a pixel over the largest coordinate, above which float64 keeps points apart and areas clear of rounding
LEAST_PIXEL = 2.0**-40


def layers_of(heights: Floats, found: Sequence[Rings], view: FieldOfView, labels: dict[str, Any]) -> Layers:
    """Make layers at heights (L,) of the rings of their blocks, in canonical form.

    No point is passed twice, and every ring encloses a pixel, so the form is a matter of order alone: by layer, and there by least
    points; unless pixels are so small, and the part so far from the origin, that points fall together in mm.
    """
    layer_of = [np.repeat(np.arange(len(block.counts)), block.counts) for block in found]
    least = [block.points[block.least] for block in found]
    orders = [np.lexsort((at[:, 1], at[:, 0], layer)) for at, layer in zip(least, layer_of, strict=True)]
    sizes = [np.diff(block.starts)[order] for block, order in zip(found, orders, strict=True)]
    ring_starts = np.concatenate([[0], np.cumsum(np.concatenate(sizes))]).astype(np.int64)
    first_rings = np.cumsum([0, *(len(order) for order in orders)]).tolist()
    points = np.empty((int(ring_starts[-1]), 2))

    def place(start: int, stop: int) -> None:
        for k in range(start, stop):
            block, first = found[k], first_rings[k]
            _place(block.points, block.starts, block.least, orders[k], ring_starts[first:], *view.affine, points)

    run_blocks(place, len(found))
    layer_starts = np.concatenate([[0], np.cumsum(np.concatenate([block.counts for block in found]))])
    closed = np.ones(len(ring_starts) - 1, np.bool_)
    if view.pixel_mm < LEAST_PIXEL * float(np.abs(points).max(initial=0.0)):
        return canonical(heights, points, ring_starts, layer_starts, closed, **labels)
    return Layers(heights, points, ring_starts, layer_starts, closed, **labels)


@kernel
def _place(
    half_pixels: ShortInts, starts: Ints, least: Ints, order: Ints, new_starts: Ints, low_mm: Floats,
    shift_px: Floats, pixel_mm: float, points: Floats,
) -> None:  # fmt: skip
    """Write the rings of a block in their order, each from its least point on, in mm as :meth:`FieldOfView.to_mm` gives them."""
    for n in range(order.size):
        r = order[n]
        to = new_starts[n]
        for a, b in ((least[r], starts[r + 1]), (starts[r], least[r])):
            for i in range(a, b):
                for axis in range(2):
                    points[to, axis] = low_mm[axis] + (0.5 * half_pixels[i, axis] + shift_px[axis]) * pixel_mm
                to += 1
