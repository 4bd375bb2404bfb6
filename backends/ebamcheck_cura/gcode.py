"""Paths in the G-code that CuraEngine writes in surface mode: the contours of every layer.

A path begins where a travel (``G0``) ends and follows the moves with extrusion (``G1``); a move without X and Y
stays in place. A path that returns to its start is a ring; if no travel follows, another path begins there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import BackendFailed
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

LAYER_WORD = np.frombuffer(b";LAYER:", np.uint8)
END_WORD = b";End of Gcode"
NO_LAYER = -1

_NEWLINE, _SPACE, _MINUS, _POINT, _ZERO, _NINE = 10, 32, 45, 46, 48, 57
_G, _X, _Y = 71, 88, 89


def read_paths(text: bytes) -> dict[int, list[Floats]]:
    """Read the paths of each layer.

    Returns
    -------
    dict
        Layer as CuraEngine counts to its paths (n, 2) in mm; a ring ends where it begins.

    Raises
    ------
    BackendFailed
        If the text is truncated.
    """
    if END_WORD not in text[-200:]:
        raise BackendFailed("what CuraEngine wrote is cut: its end code is missing")
    data = np.frombuffer(text, np.uint8)
    points, starts, layers = _paths(data, LAYER_WORD, *_sizes(text))
    found: dict[int, list[Floats]] = {}
    for layer, first, past in zip(layers.tolist(), starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        found.setdefault(layer, []).append(points[first:past])
    return found


def _sizes(text: bytes) -> tuple[int, int]:
    """Upper bounds of the numbers of points and paths: each path follows a travel or a ring that closed."""
    moves = text.count(b"\nG1 ")
    return 2 * moves + 2, moves + 1


@kernel
def _paths(
    data: NDArray[np.uint8], layer_word: NDArray[np.uint8], most_points: int, most_paths: int
) -> tuple[Floats, Ints, Ints]:
    """Points of all paths (N, 2), first point of each path (P + 1,) and its layer (P,)."""
    points = np.empty((most_points, 2))
    starts = np.zeros(most_paths + 1, np.int64)
    layers = np.empty(most_paths, np.int64)
    count = paths = 0
    layer = NO_LAYER
    x = y = 0.0
    i = 0
    while i < data.size:
        end = i
        while end < data.size and data[end] != _NEWLINE:
            end += 1
        if (
            data[i : i + layer_word.size].size == layer_word.size
            and (data[i : i + layer_word.size] == layer_word).all()
        ):
            count, paths = _end_path(count, starts, paths, layers, layer)
            layer = int(_number(data, i + layer_word.size, end))
        elif layer != NO_LAYER and end - i > 3 and data[i] == _G and data[i + 2] == _SPACE:
            has_x, new_x = _word(data, i, end, _X)
            has_y, new_y = _word(data, i, end, _Y)
            if has_x and has_y:
                if data[i + 1] == _ZERO:
                    count, paths = _end_path(count, starts, paths, layers, layer)
                elif data[i + 1] == _ZERO + 1 and (new_x != x or new_y != y):
                    if count == starts[paths]:
                        points[count, 0], points[count, 1] = x, y
                        count += 1
                    points[count, 0], points[count, 1] = new_x, new_y
                    count += 1
                    first = starts[paths]
                    if points[first, 0] == new_x and points[first, 1] == new_y:
                        count, paths = _end_path(count, starts, paths, layers, layer)
                x, y = new_x, new_y
        i = end + 1
    count, paths = _end_path(count, starts, paths, layers, layer)
    return points[:count].copy(), starts[: paths + 1].copy(), layers[:paths].copy()


@kernel
def _end_path(count: int, starts: Ints, paths: int, layers: Ints, layer: int) -> tuple[int, int]:
    """End the path that is under way, if it has points."""
    if count > starts[paths]:
        layers[paths] = layer
        paths += 1
        starts[paths] = count
    return count, paths


@kernel
def _word(data: NDArray[np.uint8], start: int, end: int, letter: int) -> tuple[bool, float]:
    """Whether a block has a word of that letter, and its number."""
    for i in range(start + 2, end):
        if data[i] == letter and data[i - 1] == _SPACE:
            return True, _number(data, i + 1, end)
    return False, 0.0


@kernel
def _number(data: NDArray[np.uint8], start: int, end: int) -> float:
    """Decimal number without exponent at a place; exact to the nearest float up to 15 digits."""
    whole, scale, sign = 0, 0, 1
    for i in range(start, end):
        byte = data[i]
        if byte == _MINUS:
            sign = -1
        elif byte == _POINT:
            scale = 1
        elif _ZERO <= byte <= _NINE:
            whole = 10 * whole + (byte - _ZERO)
            scale *= 10
        else:
            break
    return sign * whole / max(scale, 1)
