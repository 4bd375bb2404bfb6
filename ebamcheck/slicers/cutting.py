"""Cuts a part block by block into a file of layers, in whatever process it is, and tells how it goes."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import BackendSettings, Prepared, Slicer
from ebamcheck.errors import BackendFailed, EbamcheckError, SettingsError
from ebamcheck.layers import files as layer_files
from ebamcheck.layers.blocks import KeptBlocks
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.numeric import compiling
from ebamcheck.slicers.layer_forms import form_fault


class NotLayers(Exception):
    """A slicer returned what no later stage can read."""


def cut(
    slicer: Slicer,
    part: Part,
    settings: BackendSettings,
    heights: NDArray[np.float64],
    borders: NDArray[np.int64],
    file: Path,
    tell: Callable[..., None],
    kept: KeptBlocks | None = None,
) -> bool:
    """Slice in this process; whether it came to an end, and not to a failure that it told.

    Parameters
    ----------
    slicer, part, settings
        The slicer, and the part as placed.
    heights, borders
        Strictly increasing heights (L,), mm, and the borders of the blocks in which they are cut.
    file
        Where the layers go.
    tell
        Takes events as keywords: those of :mod:`ebamcheck.slicers.worker_events`.
    kept
        Blocks that an earlier process has left; none where they are not kept.
    """
    start = slicer_time()
    try:
        with slicer.prepare(part, settings) as prepared:
            tell(prepare_s=slicer_time() - start)
            _write(_blocks(prepared, part, heights, borders, tell, kept), file, tell)
    except NotLayers as error:
        tell(failure="crashed", why=str(error))
    except EbamcheckError as error:
        tell(failure="refused", why=str(error))
    except MemoryError:
        tell(failure="out of memory", why="an allocation failed")
    else:
        return True
    return False


def _write(blocks: Iterator[Layers], file: Path, tell: Callable[..., None]) -> None:
    """Write what the slicer gives, and tell a file that cannot be written from a slicer that refuses."""
    try:
        layer_files.write_blocks(blocks, file)
    except SettingsError as error:
        tell(unwritable=str(error))
    else:
        tell(written=True)


def _blocks(
    prepared: Prepared,
    part: Part,
    heights: NDArray[np.float64],
    borders: NDArray[np.int64],
    tell: Callable[..., None],
    kept: KeptBlocks | None,
) -> Iterator[Layers]:
    """Cut one block of layers after the other and tell what they hold; the time is that of the slicer alone."""
    seconds, rings, open_paths, points = 0.0, 0, 0, 0
    for first, past in itertools.pairwise(borders.tolist()):
        layers = None if kept is None else kept.read(heights[first:past])
        if layers is not None:
            tell(done=past - first)
        else:
            start = slicer_time()
            try:
                layers = prepared.slice(heights[first:past], lambda done: tell(done=done))
            except (EbamcheckError, OSError) as error:
                raise BackendFailed(str(error)) from error
            took = slicer_time() - start
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


def slicer_time() -> float:
    """Seconds of a clock that stands still while this process compiles kernels."""
    return time.perf_counter() - compiling.seconds()
