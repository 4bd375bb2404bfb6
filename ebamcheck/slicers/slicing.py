"""Slice a part with one backend, in this process or in one of its own, once or again and again."""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.backend import BackendSettings, Prepared, Progress, Turnable
from ebamcheck.errors import SettingsError
from ebamcheck.layers import files as layer_files
from ebamcheck.layers.heights import checked_heights, is_rising, layer_blocks
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import registry
from ebamcheck.scratch import scratch_folder
from ebamcheck.settings.stages import SlicingSettings
from ebamcheck.showing import short_text
from ebamcheck.slicers.cutting import cut_here, fits_here, may_run_here
from ebamcheck.slicers.outcome import Limits, Outcome

if TYPE_CHECKING:
    from ebamcheck.slicers.isolation import WorkerPool

_Result = TypeVar("_Result")


def slice_part(
    part: Part,
    heights: ArrayLike,
    backend: str = "",
    isolate: bool = False,
    progress: Progress | None = None,
    limits: Limits | None = None,
    **settings: Any,
) -> Layers:
    """Cut a part at the given heights.

    Parameters
    ----------
    part
        The part as placed.
    heights
        (L,) absolute heights, mm, in any order; a single number is one layer.
    backend
        Name in the registry; the default is the available exact slicer of the highest priority.
    isolate
        Run the backend in a process of its own, so that a crash of it raises here instead of ending
        this process. A backend of another distribution always runs so.
    progress
        Called with the number of layers done since the last call.
    limits
        Time and memory that the backend may use where it runs isolated.
    **settings
        The backend's own settings.

    Returns
    -------
    Layers
        One layer a height, in the order given.

    Raises
    ------
    BackendMissing
        If the backend is unknown or cannot run on this machine.
    BackendFailed
        If it refuses the part, crashes or (isolated) outlives its limits.
    SettingsError
        If a height is not finite or a setting is wrong.

    Examples
    --------
    >>> from ebamcheck_models import CUBE
    >>> layers = slice_part(CUBE.tessellate(0.1), [1.0, 3.0])
    >>> layers.areas().tolist(), layers.points.shape[1]
    ([400.0, 400.0], 2)
    """
    name = backend or registry.default_backend()
    wanted = checked_heights(heights)
    increasing, where = np.unique(wanted, return_inverse=True)
    checked = registry.slicer_settings(name, settings)
    if not isolate:
        registry.available_slicer(name)
    if isolate or registry.is_stranger(name):
        from ebamcheck.slicers.isolation import slice_isolated

        layers = slice_isolated(name, part, increasing, checked, limits, progress)
    else:
        with registry.slicer(name).prepare(part, checked) as prepared:
            layers = prepared.slice(increasing, progress)
    layers = layers if np.array_equal(increasing, wanted) else layers.take(where)
    return layers.labelled(mesh=part)


def slice_to_file(
    part: Part, heights: ArrayLike, path: str | Path, backend: str = "", limits: Limits | None = None,
    block_points: int = SlicingSettings().block_points, pool: WorkerPool | None = None, **settings: Any,
) -> Outcome:  # fmt: skip
    """Cut a part into a file of layers, which appears when it is whole; errors are those of :func:`slice_part`.

    A backend of this project's own kernels cuts in this process, unless the part is very large, others in one of theirs. Rising
    heights into Parquet are cut and written block by block, each of at most `block_points` points of an exact contour."""
    name, path = backend or registry.default_backend(), Path(path)
    wanted = checked_heights(heights)
    increasing, where = np.unique(wanted, return_inverse=True)
    chosen = registry.slicer_settings(name, settings)
    borders = layer_blocks(part, increasing, block_points)
    limits = limits or Limits()
    try:
        # Beside the file, so that what is whole is moved and not copied.
        with scratch_folder(f".{path.name}", path.parent) as folder:
            if may_run_here(name) and fits_here(part, block_points, limits):
                outcome = cut_here(part, increasing, name, chosen, folder, limits, borders)
            else:
                from ebamcheck.slicers.isolation import slice_all

                outcome = slice_all(part, increasing, {name: chosen}, folder, limits, borders=borders, pool=pool)[name]
            if path.suffix.lower() == ".parquet" and is_rising(wanted):
                os.replace(outcome.made(), path)
                return replace(outcome, file=path)
            layers = outcome.read().take(where)
    except OSError as error:
        raise SettingsError(f"{path}: cannot be written: {error.strerror or error}") from None
    layer_files.write_layers(layers, path)
    closed, points = int(np.count_nonzero(layers.closed)), len(layers.points)
    return replace(outcome, file=path, rings=closed, open_paths=layers.closed.size - closed, points=points)


class Slicing:
    """A part made ready for one slicer, to be cut again at any height while a build goes on.

    What the slicer needs of the part (an index, a tree, a graphics context) is made once, here; one of another distribution makes
    it in a process of its own at every call. Calls may come from any thread: they are served one after the other by a thread of the
    object's own.

    Parameters
    ----------
    part
        The part as placed.
    backend
        Name in the registry; the default is the available exact slicer of the highest priority.
    **settings
        The backend's own settings.

    Raises
    ------
    BackendMissing
        If the backend is unknown or cannot run on this machine.
    BackendFailed
        If it refuses the part.
    SettingsError
        If a setting is wrong; from every method once the object is closed.

    Examples
    --------
    >>> from ebamcheck_models import CUBE
    >>> with Slicing(CUBE.tessellate(0.1)) as slicing:
    ...     float(slicing.at(4.37).areas()[0])
    400.0
    """

    def __init__(self, part: Part, backend: str = "", **settings: Any) -> None:
        name = backend or registry.default_backend()
        checked = registry.slicer_settings(name, settings)
        slicer = registry.available_slicer(name)
        if registry.is_stranger(name):
            self._begin(part, part, name, checked, lambda: _Apart(name, part, checked))
        else:
            self._begin(part, part, name, checked, lambda: slicer.prepare(part, checked))

    def _begin(
        self, part: Part, unturned: Part, backend: str, settings: BackendSettings,
        prepare: Callable[[], Prepared],
    ) -> None:  # fmt: skip
        self.part, self.backend, self.settings, self._unturned = part, backend, settings, unturned
        self._thread, self._open = ThreadPoolExecutor(1, thread_name_prefix=f"ebamcheck-{backend}"), True
        try:
            self._prepared: Prepared = self._in_thread(lambda: prepare().__enter__())
        except BaseException:
            self._thread.shutdown()
            raise
        self._release = weakref.finalize(self, _leave, self._thread, self._prepared)

    def __repr__(self) -> str:
        state = "" if self._open else "closed"
        return short_text.line("Slicing", self.part.name, f"by {self.backend}", state)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free what the slicer holds; may be called twice."""
        self._open = False
        self._release()

    def at(self, height: float) -> Layers:
        """Cut one layer at an absolute height, mm: a stack of one, the same in every bit as in a stack of many."""
        return self.layers([height])

    def layers(self, heights: ArrayLike, progress: Progress | None = None) -> Layers:
        """Cut at (L,) heights, mm, in any order; one layer a height, in the order given."""
        wanted = checked_heights(heights)
        increasing, where = np.unique(wanted, return_inverse=True)
        layers: Layers = self._in_thread(self._prepared.slice, increasing, progress)
        return layers if np.array_equal(increasing, wanted) else layers.take(where)

    def along(self, direction: ArrayLike) -> Slicing:
        """Make the same part ready along another direction (3,), in the coordinates of the file; this object stays as it is."""
        part = self._unturned.along(direction)
        if isinstance(self._prepared, Turnable):
            turned = self._in_thread(self._prepared.turned, part)
            made = Slicing.__new__(Slicing)
            made._begin(part, self._unturned, self.backend, self.settings, lambda: turned)
            return made
        made = Slicing(part, self.backend, **self.settings.model_dump())
        made._unturned = self._unturned
        return made

    def _in_thread(self, call: Callable[..., _Result], *arguments: Any) -> _Result:
        """Run a call in the thread of the slicer and wait for it."""
        if not self._open:
            told = f"the slicing of {self.part.name!r} by {self.backend!r} is closed: make another"
            raise SettingsError(told)
        return self._thread.submit(call, *arguments).result()


@dataclass
class _Apart:
    """A part for a slicer of another distribution, which is prepared anew in a process of its own at each call."""

    backend: str
    part: Part
    settings: BackendSettings

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def slice(self, heights: NDArray[np.float64], progress: Progress | None = None) -> Layers:
        from ebamcheck.slicers.isolation import slice_isolated

        return slice_isolated(self.backend, self.part, heights, self.settings, progress=progress)


def _leave(thread: ThreadPoolExecutor, prepared: Prepared) -> None:
    """Free a prepared part in the thread where it was made, and end that thread."""
    # At the end of the process the thread may be gone already, and what it held with it.
    with suppress(RuntimeError):
        thread.submit(prepared.__exit__, None, None, None).result()
    thread.shutdown()
