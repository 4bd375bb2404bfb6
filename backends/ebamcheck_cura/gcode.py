"""Paths in the G-code that CuraEngine writes in surface mode: the contours of every layer.

A path begins where a travel (``G0``) ends and follows the moves with extrusion (``G1``); a move without X and Y
stays in place. A path that returns to its start is a ring; if no travel follows, another path begins there.
"""

from __future__ import annotations

import re

import numpy as np

from ebamcheck.errors import BackendFailed
from ebamcheck.kernels import Floats

END_WORD = b";End of Gcode"

_NUMBER = rb"(-?[\d.]+)"
_BLOCK = re.compile(
    rb"^(?:;LAYER:(-?\d+)|G([01]) (?=(?:[^\n]*? )??X" + _NUMBER + rb")(?=(?:[^\n]*? )??Y" + _NUMBER + rb"))",
    re.M,
)


def read_paths(text: bytes) -> dict[int, list[Floats]]:
    """Layer as CuraEngine counts to its paths (n, 2) in mm; :class:`BackendFailed` where the text is truncated."""
    if END_WORD not in text[-200:]:
        raise BackendFailed("what CuraEngine wrote is cut: its end code is missing")
    start = text.find(b";LAYER:")
    blocks = np.array(_BLOCK.findall(text, max(start, 0)) if start >= 0 else [], dtype="S").reshape(-1, 4)
    if not len(blocks):
        return {}
    is_layer, is_move = blocks[:, 0] != b"", blocks[:, 1] == b"1"
    # Where each block ends: a layer's comment stays at the place of the block before it.
    places = np.zeros((len(blocks), 2))
    places[~is_layer] = blocks[~is_layer, 2:].astype(np.float64)
    latest = np.maximum.accumulate(np.where(is_layer, 0, np.arange(len(blocks))))
    places = places[latest]
    # A run of moves begins at the place of a layer's comment or of a travel; each return to that place ends a path.
    first = np.maximum.accumulate(np.where(is_move, 0, np.arange(len(blocks))))
    moved = np.flatnonzero(is_move[1:] & (places[1:] != places[:-1]).any(axis=1)) + 1
    if not moved.size:
        return {}
    run_start = places[first[moved]]
    closes = (places[moved] == run_start).all(axis=1)
    begins = np.diff(first[moved], prepend=-1) != 0
    begins[1:] |= closes[:-1]
    at = np.arange(len(moved)) + np.cumsum(begins)
    points = np.empty((len(moved) + np.count_nonzero(begins), 2))
    points[at], points[at[begins] - 1] = places[moved], run_start[begins]
    layers = blocks[is_layer, 0].astype(np.int64)[np.cumsum(is_layer)[moved[begins]] - 1]
    found: dict[int, list[Floats]] = {}
    for layer, path in zip(layers.tolist(), np.split(points, at[begins][1:] - 1), strict=True):
        found.setdefault(layer, []).append(path)
    return found
