"""Discovery of slicers, models, report writers, post-processors and scan orders by entry point.

A plugin that does not load warns and is left out; it never stops the others.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from ebamcheck.backend import BackendSettings, Probe, Slicer
from ebamcheck.errors import BackendMissing, SettingsError

BACKENDS = "ebamcheck.backends"
MODELS = "ebamcheck.models"
REPORTS = "ebamcheck.reports"
POSTS = "ebamcheck.posts"
ORDERS = "ebamcheck.orders"


class BrokenPluginWarning(UserWarning):
    """An installed plugin could not be loaded."""


SLICER_ATTRIBUTES = (
    "name", "summary", "exact", "priority", "coplanar_rule", "inside_rule", "Settings",
    "probe", "error_bound_mm", "height_bound_mm", "prepare",
)  # fmt: skip


def load_plugins(group: str) -> dict[str, Any]:
    """Load every entry point of a group, sorted by name; broken ones warn and are left out."""
    found: dict[str, Any] = {}
    for point in sorted(entry_points(group=group), key=lambda p: p.name):
        try:
            found[point.name] = point.load()
        except Exception as error:
            _warn_broken(point, f"{type(error).__name__}: {error}")
    return found


def plugin(group: str, name: str) -> Any:
    """Load one entry point; raises :class:`SettingsError` with the names there are, or why it does not load."""
    points = {point.name: point for point in entry_points(group=group)}
    if name not in points:
        raise SettingsError(
            f"unknown name {name!r} in {group}: installed are {', '.join(sorted(points)) or 'none'}"
        )
    try:
        return points[name].load()
    except Exception as error:
        raise SettingsError(
            f"plugin {name!r} of {group} does not load: {type(error).__name__}: {error}"
        ) from None


def names(group: str) -> list[str]:
    """Names of the entry points of a group, sorted; none is loaded."""
    return sorted({point.name for point in entry_points(group=group)})


def _warn_broken(point: EntryPoint, why: str) -> None:
    warnings.warn(
        f"plugin {point.name!r} of {point.group} ({point.value}) was left out: {why}",
        BrokenPluginWarning,
        stacklevel=3,
    )


@cache
def _slicer_points() -> Mapping[str, EntryPoint]:
    """Entry points of slicers, sorted by name."""
    return {point.name: point for point in sorted(entry_points(group=BACKENDS), key=lambda p: p.name)}


@cache
def _loaded_slicer(name: str) -> Slicer | None:
    """Load one slicer; a broken one warns, once, and is None."""
    point = _slicer_points()[name]
    try:
        slicer: Slicer = point.load()()
        missing = [a for a in SLICER_ATTRIBUTES if not hasattr(slicer, a)]
        if missing:
            raise TypeError(f"it lacks {', '.join(missing)} of the Slicer protocol")
        if slicer.name != point.name:
            raise TypeError(f"it calls itself {slicer.name!r}, its entry point {point.name!r}")
    except Exception as error:
        _warn_broken(point, f"{type(error).__name__}: {error}")
        return None
    return slicer


def forget() -> None:
    """Forget what was found, so that slicers installed since are found, too."""
    _slicer_points.cache_clear()
    _loaded_slicer.cache_clear()
    probe.cache_clear()


def slicers() -> Mapping[str, Slicer]:
    """Return all installed slicers by name."""
    loaded = {name: _loaded_slicer(name) for name in _slicer_points()}
    return {name: slicer for name, slicer in loaded.items() if slicer is not None}


def house_slicers() -> list[str]:
    """Names of the slicers that take part in a job unless it names others: those of priority 0 and more."""
    return [name for name, slicer in slicers().items() if slicer.priority >= 0]


def witnesses() -> list[str]:
    """Names of the slicers that take part only where they are asked for: outside programs, of negative priority."""
    return [name for name, slicer in slicers().items() if slicer.priority < 0]


def slicer(name: str) -> Slicer:
    """Return the slicer of that name, without a look at the others; :class:`BackendMissing` where there is none."""
    found = _loaded_slicer(name) if name in _slicer_points() else None
    if found is None:
        raise BackendMissing(f"unknown backend {name!r}: installed are {', '.join(slicers()) or 'none'}")
    return found


@cache
def probe(name: str) -> Probe:
    """Probe a slicer once per process; a probe that raises counts as unavailable."""
    try:
        return slicer(name).probe()
    except BackendMissing:
        raise
    except Exception as error:
        return Probe(False, why=f"its probe raised {type(error).__name__}: {error}")


def available_slicer(name: str) -> Slicer:
    """Return the slicer of that name; raises :class:`BackendMissing` where this machine cannot run it."""
    found = probe(name)
    if not found.available:
        hint = f"; {found.hint}" if found.hint else ""
        raise BackendMissing(f"backend {name!r} is not available: {found.why}{hint}")
    return slicer(name)


def default_backend() -> str:
    """Name of the available exact slicer of the highest priority."""
    usable = [slicer(name) for name in house_slicers() if slicer(name).exact and probe(name).available]
    if not usable:
        raise BackendMissing("no exact backend is available: see `ebamcheck backends` for the reasons")
    return max(usable, key=lambda s: (s.priority, s.name)).name


def slicer_settings(name: str, values: Mapping[str, Any]) -> BackendSettings:
    """Check settings of a slicer; raises :class:`SettingsError` naming the first that is wrong."""
    from pydantic import ValidationError

    kind = slicer(name).Settings
    try:
        return kind(**values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(k) for k in first["loc"])
        known = ", ".join(kind.model_fields) or "none"
        raise SettingsError(
            f"backend {name!r}, setting {key!r}: {first['msg']} (given {first.get('input')!r}); it knows: {known}"
        ) from None
