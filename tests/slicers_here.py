"""Runs whose slicers cut in this process: for tests of what comes before and after the layers.

A worker takes a second to come up; that the layers are the same bytes without one is told by `test_start_up.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from ebamcheck.pipeline import cross_check, slabs
from ebamcheck.slicers import isolation
from ebamcheck.slicers.cutting import cut_here
from ebamcheck.slicers.isolation import DEFAULT_LIMITS, WorkerPool


def cut_all_here(
    part,
    heights,
    backends,
    target,
    limits=DEFAULT_LIMITS,
    progress=None,
    borders=None,
    *_,
    **__,
):
    """What :func:`slice_all` gives, of backends that do not crash."""
    blocks = np.array([0, len(heights)]) if borders is None else borders
    return {n: cut_here(part, heights, n, chosen, target, limits, blocks) for n, chosen in backends.items()}


@contextmanager
def slicers_here() -> Iterator[None]:
    """Have the runs of this process cut here while the block runs."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (cross_check, slabs):
            patch.setattr(module, "slice_all", cut_all_here)
        # A command starts them ahead.
        for module in (isolation, slabs):
            patch.setattr(module, "WorkerPool", lambda _ahead=(): WorkerPool())
        yield


@pytest.fixture(scope="module", autouse=True)
def runs_cut_here() -> Iterator[None]:
    """The same for all tests of a file that takes this name over."""
    with slicers_here():
        yield
