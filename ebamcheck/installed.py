"""What is installed: entry points, and the names of the distributions that they come with, read once while they stay the same."""

from __future__ import annotations

import os
import sys
from functools import lru_cache
from importlib.metadata import Distribution, EntryPoints
from importlib.metadata import entry_points as read_entry_points
from typing import Any
from weakref import WeakKeyDictionary

_names: WeakKeyDictionary[Distribution, tuple[str, str]] = WeakKeyDictionary()


def entry_points(group: str) -> EntryPoints:
    """Entry points of a group, as :func:`importlib.metadata.entry_points` returns them.

    All of them are read again where the folders from which modules come have changed, or are others.
    """
    places = tuple(sys.path)
    return _of_group(places, tuple(_changed_ns(place) for place in places), group)


def name_and_version(distribution: Distribution) -> tuple[str, str]:
    """Name and version of a distribution; empty where they cannot be read."""
    if distribution not in _names:
        try:
            told = str(distribution.metadata["Name"] or ""), str(distribution.version or "")
        except Exception:  # whatever its metadata are, they are not ours
            told = "", ""
        _names[distribution] = told
    return _names[distribution]


@lru_cache(maxsize=32)
def _of_group(places: tuple[str, ...], changed_ns: tuple[int, ...], group: str) -> EntryPoints:
    """Pick a group: each layer of a plan asks for its order, and there are hundreds of points to look through."""
    found: EntryPoints = _read(places, changed_ns).select(group=group)
    return found


@lru_cache(maxsize=2)
def _read(places: tuple[str, ...], changed_ns: tuple[int, ...]) -> Any:
    """Read all entry points; the arguments say for which state of the folders."""
    return read_entry_points()


def _changed_ns(place: str) -> int:
    """Time at which a folder got or lost a file; 0 where there is none."""
    try:
        return os.stat(place or ".").st_mtime_ns
    except OSError:
        return 0
