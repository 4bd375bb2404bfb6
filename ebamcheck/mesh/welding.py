"""Welding: vertices that are equal in all bits are merged.

Corners are partitioned by a hash of their bits, so that each share fits in the processor's cache and shares run on all threads.
The cost does not depend on the order of the file.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import kernel
from ebamcheck.threads import run_blocks

# Approximate number of corners of a share: with their hash table they fit in the second-level cache of a core
SHARE = 4096

MOST_SHARES = 1024  # most shares: writing to more streams at once costs more than it saves
SMALLEST_BLOCK = 16384  # fewest corners worth a thread

EMPTY = -1

Corners = NDArray[Any]
Keys = NDArray[Any]
Rows = NDArray[np.int32]


def weld(
    triangles: NDArray[np.float32] | NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Merge corner points (F, 3, 3) that are equal in all bits (0 and -0 are equal).

    Returns vertices (V, 3), in order of first appearance, and faces (F, 3).
    """
    corners = np.ascontiguousarray(triangles).reshape(-1, 3)
    earliest = _earliest(corners)
    is_first = earliest == np.arange(len(earliest))
    number = np.cumsum(is_first, dtype=np.int32) - np.int32(1)
    return corners[is_first].astype(np.float64) + 0.0, number[earliest].reshape(-1, 3)


def _earliest(corners: Corners) -> Rows:
    """First row that equals each row, (N,)."""
    count = len(corners)
    keys = corners.view(np.uint32 if corners.dtype == np.float32 else np.uint64)
    shares = min(1 << (count // SHARE).bit_length(), MOST_SHARES)
    share = np.empty(count, np.uint16)
    sizes: dict[int, NDArray[np.int64]] = {}

    def choose(start: int, stop: int) -> None:
        sizes[start] = _choose(corners, keys, share, shares, start, stop)

    run_blocks(choose, count, SMALLEST_BLOCK)
    # Within a share, rows of an earlier block come before those of a later one.
    by_block = np.stack([sizes[start] for start in sorted(sizes)])
    starts = np.concatenate([[0], np.cumsum(by_block.sum(axis=0))])
    places = dict(zip(sorted(sizes), starts[:-1] + np.cumsum(by_block, axis=0) - by_block, strict=True))
    dealt = np.empty((count, 4), keys.dtype)
    run_blocks(lambda a, b: _deal(corners, keys, share, places[a], dealt, a, b), count, SMALLEST_BLOCK)
    result = np.empty(count, np.int32)
    run_blocks(lambda a, b: _weld_shares(dealt, starts[a : b + 1], result), shares)
    return result


@kernel
def _bits(corners: Corners, keys: Keys, i: int, c: int) -> np.uint64:
    """Bits of a coordinate; those of 0 for -0."""
    return np.uint64(keys[i, c]) if corners[i, c] != 0.0 else np.uint64(0)


@kernel
def _hash(x: np.uint64, y: np.uint64, z: np.uint64) -> np.uint64:
    mixed = (x * np.uint64(0x9E3779B97F4A7C15)) ^ (y * np.uint64(0xC2B2AE3D27D4EB4F))
    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (z * np.uint64(0x94D049BB133111EB))) * np.uint64(0xFF51AFD7ED558CCD)
    return mixed ^ (mixed >> np.uint64(32))


@kernel
def _choose(
    corners: Corners, keys: Keys, share: NDArray[np.uint16], shares: int, start: int, stop: int
) -> NDArray[np.int64]:
    """Write the share of each of the rows ``[start, stop)``; returns how many fell to each share."""
    sizes = np.zeros(shares, np.int64)
    last = np.uint64(shares - 1)
    for i in range(start, stop):
        mixed = _hash(_bits(corners, keys, i, 0), _bits(corners, keys, i, 1), _bits(corners, keys, i, 2))
        # The upper half chooses the share, the lower one the place in its table.
        s = np.int64((mixed >> np.uint64(40)) & last)
        share[i] = s
        sizes[s] += 1
    return sizes


@kernel
def _deal(
    corners: Corners,
    keys: Keys,
    share: NDArray[np.uint16],
    places: NDArray[np.int64],
    dealt: Keys,
    start: int,
    stop: int,
) -> None:
    """Copy bits and number of the rows ``[start, stop)`` to the `places` of their shares, which move on."""
    for i in range(start, stop):
        at = places[share[i]]
        places[share[i]] += 1
        for c in range(3):
            dealt[at, c] = _bits(corners, keys, i, c)
        dealt[at, 3] = i


@kernel
def _weld_shares(dealt: Keys, starts: NDArray[np.int64], earliest: Rows) -> None:
    """Find the first equal row of each row of some shares: an open-addressing hash for each share."""
    most = 0
    for s in range(starts.size - 1):
        most = max(most, starts[s + 1] - starts[s])
    size = 16
    while size < 2 * most:
        size *= 2
    table = np.empty(size, np.int32)
    mask = np.uint64(size - 1)
    for s in range(starts.size - 1):
        table[:] = EMPTY
        for i in range(starts[s], starts[s + 1]):
            x, y, z = np.uint64(dealt[i, 0]), np.uint64(dealt[i, 1]), np.uint64(dealt[i, 2])
            slot = _hash(x, y, z) & mask
            while True:
                k = table[slot]
                if k == EMPTY:
                    table[slot] = k = i
                if dealt[k, 0] == dealt[i, 0] and dealt[k, 1] == dealt[i, 1] and dealt[k, 2] == dealt[i, 2]:
                    break
                slot = (slot + np.uint64(1)) & mask
            earliest[dealt[i, 3]] = dealt[k, 3]
