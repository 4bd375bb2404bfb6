"""Cuts a part block by block into a file of layers, in whatever process it is, and tells how it goes; and does so in this one.
Kernels of this project, tested on hostile meshes, need no process of their own, which takes longer to come up than most parts to be
cut."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.backend import BackendSettings, Prepared, Slicer
from ebamcheck.errors import BackendFailed, EbamcheckError, SettingsError
from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers import files as layer_files
from ebamcheck.layers.files import KeptBlocks
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import registry
from ebamcheck.slicers.outcome import Limits, Outcome, bounds_fault, form_fault


class NotLayers(Exception):
    """A slicer returned what no later stage can read."""


def cut(
    slicer: Slicer, part: Part, settings: BackendSettings, heights: Floats, borders: Ints, file: Path,
    tell: Callable[..., None], kept: KeptBlocks | None = None,
) -> bool:  # fmt: skip
    """Slice in this process; whether it came to an end, and not to a failure that it told.

    Heights (L,) strictly increase; `borders` are those of the blocks in which they are cut. `tell` takes the events of
    :mod:`ebamcheck.slicers.outcome` as keywords; `kept` are blocks that an earlier process has left.
    """
    start = time.perf_counter()
    try:
        with slicer.prepare(part, settings) as prepared:
            tell(prepare_s=time.perf_counter() - start)
            blocks = _blocks(prepared, part, heights, borders, tell, kept)
            # A file that cannot be written is no slicer that refuses.
            try:
                layer_files.write_blocks(blocks, file)
            except SettingsError as error:
                tell(unwritable=str(error))
            else:
                tell(written=True)
    except NotLayers as error:
        tell(failure="crashed", why=str(error))
    except EbamcheckError as error:
        tell(failure="refused", why=str(error))
    except MemoryError:
        tell(failure="out of memory", why="an allocation failed")
    else:
        return True
    return False


def _blocks(
    prepared: Prepared, part: Part, heights: Floats, borders: Ints, tell: Callable[..., None], kept: KeptBlocks | None
) -> Iterator[Layers]:  # fmt: skip
    """Cut one block of layers after the other and tell what they hold; the time is that of the slicer alone."""
    seconds, rings, open_paths, points = 0.0, 0, 0, 0
    for first, past in itertools.pairwise(borders.tolist()):
        layers = None if kept is None else kept.read(heights[first:past])
        if layers is not None:
            tell(done=past - first)
        else:
            start = time.perf_counter()
            try:
                layers = prepared.slice(heights[first:past], lambda done: tell(done=done))
            except (EbamcheckError, OSError) as error:
                raise BackendFailed(str(error)) from error
            took = time.perf_counter() - start
            seconds += took
            if fault := form_fault(layers, part, heights[first:past]):
                raise NotLayers(fault)
            if kept is not None and kept.is_worth(took):
                kept.write(layers)
        closed = int(np.count_nonzero(layers.closed))
        rings, open_paths = rings + closed, open_paths + layers.closed.size - closed
        points += len(layers.points)
        tell(slice_s=seconds, rings=rings, open_paths=open_paths, points=points)
        yield layers
        del layers  # so that there are never two blocks in memory


class _OutOfTime(Exception):
    """The backend has used up its time."""


def may_run_here(name: str) -> bool:
    """Whether a backend says that it may share a process, and is of this house, whose word counts."""
    return not registry.is_stranger(name) and not getattr(registry.slicer(name), "isolated", True)


def fits_here(part: Part, block_points: int, limits: Limits) -> bool:
    """Whether a part is so small that its memory need not be watched."""
    # Memory of a facet and of a point in a block, at most; beyond a quarter of what a backend may hold somebody watches from outside.
    most = 400.0 * len(part.faces) + 160.0 * block_points
    return most < 0.25 * 1e6 * limits.memory_mb


def cut_here(
    part: Part, heights: Floats, name: str, settings: BackendSettings, folder: Path, limits: Limits, borders: Ints
) -> Outcome:  # fmt: skip
    """Slice with one backend into ``NAME.parquet`` in this process; time is looked at whenever layers are done."""
    told: dict[str, Any] = {}
    start = time.perf_counter()

    def tell(**event: Any) -> None:
        if "done" not in event:
            told.update(event)
        elif time.perf_counter() - start > limits.time_s:
            raise _OutOfTime

    slicer = registry.available_slicer(name)
    error_mm, height_mm = (
        float(slicer.error_bound_mm(part, settings)),
        float(slicer.height_bound_mm(part, settings)),
    )
    outcome = Outcome(name, probe=registry.probe(name), error_bound_mm=error_mm, height_bound_mm=height_mm)
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
