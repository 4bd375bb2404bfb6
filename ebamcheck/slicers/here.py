"""Slicing to a file in this process: for backends of this project's kernels (and shapely), where memory is no question.

A process of its own is what ends a crash, a hang or a flood of memory. Kernels of this project, tested on hostile meshes,
have none of these to fear, and an interpreter takes longer to come up than most parts take to be cut.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import BackendSettings
from ebamcheck.errors import SettingsError
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import registry
from ebamcheck.slicers.cutting import cut, slicer_time
from ebamcheck.slicers.outcome import Limits, Outcome
from ebamcheck.slicers.worker_events import bounds_fault

FACET_BYTES, POINT_BYTES = 400.0, 160.0
"""Memory of a facet and of a point in a block, at most, with the mesh sorted and the layers in canonical form."""

SHARE = 0.25
"""Of the memory that a backend may hold, what it may come to here; beyond it somebody watches from outside."""


class _OutOfTime(Exception):
    """The backend has used up its time."""


def may_run_here(name: str) -> bool:
    """Whether a backend says that it may share a process, and is of this house, whose word counts."""
    return not registry.is_stranger(name) and not getattr(registry.slicer(name), "isolated", True)


def fits_here(part: Part, block_points: int, limits: Limits) -> bool:
    """Whether a part is so small that its memory need not be watched."""
    most = FACET_BYTES * len(part.faces) + POINT_BYTES * block_points
    return most < SHARE * 1e6 * limits.memory_mb


def cut_here(
    part: Part,
    heights: NDArray[np.float64],
    name: str,
    settings: BackendSettings,
    folder: Path,
    limits: Limits,
    borders: NDArray[np.int64],
) -> Outcome:
    """Slice with one backend into ``NAME.parquet`` in this process; see :func:`isolation.slice_all`.

    Time is looked at whenever layers are done.
    """
    told: dict[str, Any] = {}
    start = slicer_time()

    def tell(**event: Any) -> None:
        if "done" not in event:
            told.update(event)
        elif slicer_time() - start > limits.time_s:
            raise _OutOfTime

    slicer = registry.available_slicer(name)
    outcome = Outcome(
        name,
        probe=registry.probe(name),
        error_bound_mm=float(slicer.error_bound_mm(part, settings)),
        height_bound_mm=float(slicer.height_bound_mm(part, settings)),
    )
    if fault := bounds_fault(asdict(outcome), float(part.size.max())):
        return replace(outcome, failure="crashed", why=fault)
    file = folder / f"{name}.parquet"
    try:
        done = cut(slicer, part, settings, heights, borders, file, tell)
    except _OutOfTime:
        why = f"took over {limits.time_s:g} s (slicing.time_limit_s)"
        return replace(outcome, failure="timed out", why=why)
    if "unwritable" in told:
        raise SettingsError(told["unwritable"])
    told.pop("written", None)
    return replace(outcome, file=file if done else None, **told)
