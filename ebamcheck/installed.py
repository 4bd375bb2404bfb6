"""What is installed: entry points with their distributions, read once while they stay the same, and which of two with one name
counts."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import Distribution, EntryPoint, EntryPoints
from importlib.metadata import entry_points as read_entry_points
from typing import Any
from weakref import WeakKeyDictionary

HOUSE = "ebamcheck"  # the distribution whose plugins are imported in this process; every other one's are a stranger's

_names: WeakKeyDictionary[Distribution, tuple[str, str]] = WeakKeyDictionary()


def entry_points(group: str) -> EntryPoints:
    """Entry points of a group; all are read again where the folders from which modules come have changed, or are others."""
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
    with suppress(OSError):
        return os.stat(place or ".").st_mtime_ns
    return 0


@dataclass(frozen=True)
class BrokenPlugin:
    """A plugin that was left out, and why."""

    group: str
    name: str
    value: str
    distribution: str
    why: str

    def __str__(self) -> str:
        whose = f"{self.value}, of {self.distribution}" if self.distribution else self.value
        return f"plugin {self.name!r} of {self.group} ({whose}) was left out: {self.why}"


def distribution_of(point: EntryPoint) -> tuple[str, str]:
    """Name and version of the distribution that a plugin comes with; empty where they cannot be read."""
    dist = getattr(point, "dist", None)
    return ("", "") if dist is None else name_and_version(dist)


def is_house(point: EntryPoint) -> bool:
    """Whether a plugin is shipped in this distribution."""
    return distribution_of(point)[0].lower().replace("_", "-") == HOUSE


def broken(point: EntryPoint, why: str) -> BrokenPlugin:
    """A plugin that was left out."""
    name, version = distribution_of(point)
    return BrokenPlugin(point.group, point.name, point.value, f"{name} {version}".strip(), why)


def sorted_out(points: Iterable[EntryPoint]) -> tuple[dict[str, EntryPoint], list[BrokenPlugin]]:
    """One plugin a name: the house's own, else a stranger's whose distribution comes first by name; and those that bear the name of
    another."""
    ranked = sorted(points, key=lambda p: (not is_house(p), distribution_of(p), str(p.value), str(p.name)))
    found: dict[str, EntryPoint] = {}
    left_out = []
    for point in ranked:
        first = found.setdefault(point.name, point)
        if first is not point:
            owner = distribution_of(first)[0] or "another plugin"
            left_out.append(broken(point, f"its name is that of a plugin of {owner}"))
    return dict(sorted(found.items())), left_out
