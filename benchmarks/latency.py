"""How soon one layer more, or another direction, is there: what follows a height that was measured in a build."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.worker import Begin
from ebamcheck.mesh.files import load
from ebamcheck.slicers.slicing import Slicing

HEIGHTS, DIRECTIONS = 200, 5
SEED = 5


def latency(begin: Begin, stl: str) -> dict[str, Any]:
    """Time :meth:`~ebamcheck.slicers.slicing.Slicing.at` at heights and :meth:`~ebamcheck.slicers.slicing.Slicing.along` along directions.

    Both are drawn at random, so that none comes twice; they take no part in the warming.

    Returns
    -------
    ``at_s`` one figure a height, ``along_s`` one a direction, and ``along_at_s`` the same with a first layer.
    """
    part = load(Path(stl))
    draw = np.random.default_rng(SEED)
    low, high = part.bounds[:, 2]
    heights = draw.uniform(low, high, HEIGHTS + 1).tolist()
    directions = draw.normal(size=(DIRECTIONS + 1, 3))
    with Slicing(part) as slicing:
        slicing.at(heights.pop())
        _turn_s(slicing, directions[-1])
        begin()
        at_s = []
        for height in heights:
            start = time.perf_counter()
            slicing.at(height)
            at_s.append(time.perf_counter() - start)
        turns = [_turn_s(slicing, direction) for direction in directions[:-1]]
    return {"at_s": at_s, "along_s": [a for a, _ in turns], "along_at_s": [b for _, b in turns]}


def _turn_s(
    slicing: Slicing, direction: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
) -> tuple[float, float]:
    """Seconds until a direction is ready, and until the middle layer along it is there."""
    start = time.perf_counter()
    with slicing.along(direction) as turned:
        ready_s = time.perf_counter() - start
        turned.at(float(turned.part.bounds[:, 2].mean()))
        return ready_s, time.perf_counter() - start
