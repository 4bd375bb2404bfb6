"""Slice a part with one backend, in this process or in one of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck import registry
from ebamcheck.backend import Progress
from ebamcheck.heights import checked_heights
from ebamcheck.isolate import Limits, slice_isolated
from ebamcheck.layers import Layers
from ebamcheck.part import Part


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
        this process.
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
    """
    name = backend or registry.default_backend()
    wanted = checked_heights(heights)
    increasing, where = np.unique(wanted, return_inverse=True)
    checked = registry.slicer_settings(name, settings)
    if isolate:
        layers = slice_isolated(name, part, increasing, checked, limits, progress)
    else:
        with registry.available_slicer(name).prepare(part, checked) as prepared:
            layers = prepared.slice(increasing, progress)
    return layers if np.array_equal(increasing, wanted) else layers.take(where)
