"""Discovery of slicers, models (solids in closed form), report writers, controls and scan orders by entry point.
Plugins of this distribution are imported here, a stranger's once it came through a process of its own, its slicer never.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Any, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import BackendSettings, Probe, Slicer
from ebamcheck.errors import BackendMissing, SettingsError
from ebamcheck.installed import BrokenPlugin, broken, entry_points, is_house, sorted_out
from ebamcheck.mesh.part import Part
from ebamcheck.plugins.processes import one_line
from ebamcheck.plugins.strangers import Answer, StrangerSlicer, ask, slicer_answer, stranger
from ebamcheck.plugins.trial import SLICER_ATTRIBUTES as SLICER_ATTRIBUTES
from ebamcheck.plugins.trial import checked_settings, checked_slicer, lineage, probed
from ebamcheck.showing.short_text import did_you_mean

if TYPE_CHECKING:
    import shapely

BACKENDS = "ebamcheck.backends"
MODELS = "ebamcheck.models"
REPORTS = "ebamcheck.reports"
CONTROLS = "ebamcheck.controls"
CHECKS = "ebamcheck.checks"
ORDERS = "ebamcheck.orders"
COMMANDS = "ebamcheck.commands"
IMPORTED = (MODELS, REPORTS, CONTROLS, CHECKS, ORDERS, COMMANDS)  # groups whose plugins are no slicers
# What a plugin may raise that is not the user's own interrupt
_STRAYS = (Exception, SystemExit, GeneratorExit)


class BrokenPluginWarning(UserWarning):
    """An installed plugin could not be loaded."""


def points(group: str) -> dict[str, EntryPoint]:
    """Entry points of a group by name, sorted; the house's own are never shadowed. None is loaded."""
    return sorted_out(entry_points(group=group))[0]


def left_out(group: str) -> list[BrokenPlugin]:
    """Entry points of a group that bear the name of another one."""
    return sorted_out(entry_points(group=group))[1]


def load_plugins(group: str) -> dict[str, Any]:
    """Load every entry point of a group, sorted by name; broken ones warn and are left out."""
    chosen, unusable = sorted_out(entry_points(group=group))
    found: dict[str, Any] = {}
    for point in chosen.values():
        try:
            found[point.name] = load(point)
        except SettingsError as error:
            unusable.append(broken(point, str(error)))
    for told in unusable:
        _warn(told)
    return found


def load(point: EntryPoint) -> Any:
    """Load one plugin, a stranger's once it has come through a process of its own; the error says why it does not load."""
    if not is_house(point) and (wrong := _trial(point)):
        raise SettingsError(wrong)
    try:
        return point.load()
    except _STRAYS as error:
        raise SettingsError(f"{type(error).__name__}: {one_line(str(error))}") from None


@cache
def _trial(point: EntryPoint) -> str:
    """Why a stranger's plugin does not import; asked once a process."""
    return ask(point, "load")[1]


def plugin(group: str, name: str) -> Any:
    """Load one entry point; raises :class:`SettingsError` with the names there are, or why it does not load."""
    found = points(group)
    if name not in found:
        meant = did_you_mean(name, found)
        raise SettingsError(f"unknown name {name!r} in {group}{meant}: installed are {', '.join(found) or 'none'}")
    try:
        return load(found[name])
    except SettingsError as error:
        raise SettingsError(f"plugin {name!r} of {group} does not load: {error}") from None


def names(group: str) -> list[str]:
    """Names of the entry points of a group, sorted; none is loaded."""
    return list(points(group))


def broken_plugins() -> list[BrokenPlugin]:
    """Every installed plugin that cannot be used, and why; strangers are asked anew, the house's are taken as they are."""
    found = [told for group in (BACKENDS, *IMPORTED) for told in left_out(group)]
    for name, point in _slicer_points().items():
        if isinstance(why := _slicer_or_why(name), str):
            found.append(broken(point, why))
    for group in IMPORTED:
        strangers = [point for point in points(group).values() if not is_house(point)]
        found += [broken(point, why) for point in strangers if (why := _trial(point))]
    return found


def _warn(told: BrokenPlugin) -> None:
    warnings.warn(str(told), BrokenPluginWarning, stacklevel=3)


# -- slicers -------------------------------------------------------------------------------------------


@cache
def _slicer_points() -> Mapping[str, EntryPoint]:
    chosen, unusable = sorted_out(entry_points(group=BACKENDS))
    for told in unusable:
        _warn(told)
    return chosen


@cache
def _answer(name: str) -> Answer:
    return slicer_answer(_slicer_points()[name])


@cache
def _slicer_or_why(name: str) -> Slicer | str:
    """A slicer as the harness sees it here, or why it is left out."""
    point = _slicer_points()[name]
    if is_house(point):
        try:
            return checked_slicer(point)
        except Exception as error:
            return f"{type(error).__name__}: {one_line(str(error))}"
    answer = _answer(name)
    return cast(Slicer, stranger(point, answer)) if answer.attributes else answer.failure


@cache
def _loaded_slicer(name: str) -> Slicer | None:
    """One slicer; a broken one warns, once, and is None."""
    found = _slicer_or_why(name)
    if isinstance(found, str):
        _warn(broken(_slicer_points()[name], found))
        return None
    return found


def forget(kept: bool = False) -> None:
    """Forget all slicers, so that new ones are found; `kept` asks strangers anew now, whatever the disk holds."""
    for known in (_slicer_points, _answer, _slicer_or_why, _loaded_slicer, probe, _trial):
        known.cache_clear()
    if kept:
        _ask_strangers(fresh=True)


def _ask_strangers(fresh: bool = False) -> None:
    """Ask the strangers side by side; where there are none, nothing is started."""
    strangers = [name for name, point in _slicer_points().items() if not is_house(point)]
    if fresh or len(strangers) > 1:
        with ThreadPoolExecutor(4) as pool:
            asked = (lambda name: slicer_answer(_slicer_points()[name], fresh=True)) if fresh else _answer
            list(pool.map(asked, strangers))


def slicers() -> Mapping[str, Slicer]:
    """Return all installed slicers by name."""
    _ask_strangers()
    return {name: made for name in _slicer_points() if (made := _loaded_slicer(name)) is not None}


def is_stranger(name: str) -> bool:
    """Whether a slicer of that name is there and comes with another distribution."""
    return name in _slicer_points() and not is_house(_slicer_points()[name])


def one_method(a: str, b: str) -> bool:
    """Whether two slicers are one method: the class of one is made from that of the other, or is the same."""
    lines = [
        list(found.answer.lineage) if isinstance(found, StrangerSlicer) else lineage(found)
        for found in (slicer(a), slicer(b))
    ]
    return any(one[:1] and one[0] in other for one, other in (lines, lines[::-1]))


def loaded_slicer(name: str) -> Slicer:
    """Load a slicer into this process, whoever made it: for workers, which have no other task, and for its author."""
    if name not in _slicer_points():
        raise _unknown(name)
    try:
        return checked_slicer(_slicer_points()[name])
    except _STRAYS as error:
        raise BackendMissing(f"backend {name!r} does not load: {type(error).__name__}: {error}") from None


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
        raise _unknown(name)
    return found


def _unknown(name: str) -> BackendMissing:
    return BackendMissing(f"unknown backend {name!r}: installed are {', '.join(slicers()) or 'none'}")


@cache
def probe(name: str) -> Probe:
    """Probe a slicer once per process; a probe that raises, or ends the process that asks, counts as unavailable."""
    return probed(slicer(name))


def available_slicer(name: str) -> Slicer:
    """Return the slicer of that name; raises :class:`BackendMissing` where this machine cannot run it."""
    found = probe(name)
    if not found.available:
        hint = f"; {found.hint}" if found.hint else ""
        raise BackendMissing(f"backend {name!r} is not available: {found.why}{hint}")
    return slicer(name)


def default_backend() -> str:
    """Name of the available exact slicer of the highest priority."""
    exact = [found for found in slicers().values() if found.exact and found.priority >= 0]
    # From the first choice down: most machines can run it, and none other is probed.
    for one in sorted(exact, key=lambda s: (s.priority, s.name), reverse=True):
        if probe(one.name).available:
            return one.name
    raise BackendMissing("no exact backend is available: see `ebamcheck backends` for the reasons")


def slicer_settings(name: str, values: Mapping[str, Any]) -> BackendSettings:
    """Check settings of a slicer; raises :class:`SettingsError` naming the first that is wrong."""
    found: Any = slicer(name)
    if isinstance(found, StrangerSlicer):
        return found.checked(values)
    return checked_settings(name, found.Settings, values)


@runtime_checkable
class Model(Protocol):
    """A solid known in closed form, in mm.

    >>> model = models(["sphere"])["sphere"]
    >>> part = model.tessellate(0.01)
    >>> bool(part.volume < model.volume < part.volume + 0.02 * model.area(0.0) * 4)
    True
    """

    @property
    def name(self) -> str:
        """Key in the entry point group ``ebamcheck.models``, and the name of its parts."""
        ...

    @property
    def summary(self) -> str:
        """What it is, in one line."""
        ...

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Least and greatest corner, (2, 3) mm."""
        ...

    @property
    def volume(self) -> float:
        """Exact volume, mm3."""
        ...

    @property
    def euler_number(self) -> int:
        """Vertices - edges + faces of any mesh of the surface."""
        ...

    def section(self, z: float, tolerance_mm: float = ...) -> Sequence[shapely.Polygon]:
        """Solid regions at height `z` (that of z + 0 at a step), rings as dense as the tolerance asks."""
        ...

    def area(self, z: float) -> float:
        """Exact area of the section at height `z`, mm2."""
        ...

    def tessellate(self, tolerance_mm: float) -> Part:
        """Return a closed, outward mesh no point of which is farther than the tolerance from the surface."""
        ...


def models(names: Sequence[str] | None = None) -> dict[str, Model]:
    """Find the installed models, all or those named, by name."""
    found = {name: m for name, m in load_plugins(MODELS).items() if isinstance(m, Model)}
    if names is None:
        return found
    unknown = [name for name in names if name not in found]
    if unknown:
        raise SettingsError(f"unknown model {unknown[0]!r}: installed are {', '.join(found) or 'none'}")
    return {name: found[name] for name in names}
