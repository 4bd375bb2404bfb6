"""Choice of slicers: which ones a job runs, and whose contours become the program."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ebamcheck.backend import BackendSettings, Probe
from ebamcheck.errors import BackendMissing, SettingsError
from ebamcheck.plugins import registry
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Outcome

ALL = "all"
"""Word for every installed witness."""


def chosen_backends(config: Config) -> dict[str, BackendSettings]:
    """Settings of the backends to run, by name: those asked for or all that are available, and the witnesses.

    Raises SettingsError for a choice that contradicts itself, BackendMissing for a name that is unknown or not available.
    """
    chosen = config.slicing
    for name in chosen.required:
        registry.available_slicer(name)
    for name in chosen.settings:
        registry.slicer(name)
    if chosen.primary:
        registry.available_slicer(chosen.primary)
    names = _named(config) if chosen.backends else _available()
    names = list(dict.fromkeys([*names, *_witnesses(config)]))
    return {name: registry.slicer_settings(name, chosen.settings.get(name, {})) for name in names}


def unavailable_backends(config: Config) -> dict[str, Outcome]:
    """Outcomes of the backends that would have run if this machine had what they need."""
    asked = [] if config.slicing.backends else registry.house_slicers()
    if ALL in config.slicing.witnesses:
        asked += registry.witnesses()
    probes = {name: registry.probe(name) for name in asked}
    return {
        name: Outcome(name, "unavailable", _reason(probe), probe=probe)
        for name, probe in probes.items()
        if not probe.available
    }


def primary_backend(config: Config, names: Iterable[str]) -> str:
    """Backend whose contours go on, of those that came to an end: the one set, else the best exact one; or none."""
    done = list(names)
    return config.slicing.primary if config.slicing.primary in done else max(done, key=_rank, default="")


def _rank(name: str) -> tuple[bool, bool, int, str]:
    slicer = registry.slicer(name)
    return slicer.priority >= 0, slicer.exact, slicer.priority, name


def _named(config: Config) -> list[str]:
    """Backends that the settings name, once they hold what else the settings ask for."""
    chosen = config.slicing
    for name in (chosen.primary, *chosen.required):
        if name and name not in chosen.backends:
            raise SettingsError(
                f"slicing.backends {', '.join(chosen.backends)} leaves out {name!r}, "
                "which slicing.primary or slicing.required names"
            )
    return [registry.slicer(name).name for name in chosen.backends]


def _available() -> list[str]:
    """House slicers that this machine can run."""
    usable = [name for name in registry.house_slicers() if registry.probe(name).available]
    if not usable:
        raise BackendMissing("no backend is available: see `ebamcheck backends` for the reasons")
    return usable


def _witnesses(config: Config) -> list[str]:
    """Witnesses asked for; of `all`, those that this machine can run."""
    if ALL not in config.slicing.witnesses:
        return [registry.slicer(name).name for name in config.slicing.witnesses]
    return [name for name in registry.witnesses() if registry.probe(name).available]


def _reason(probe: Probe) -> str:
    return f"{probe.why}; {probe.hint}" if probe.hint else probe.why


def witness_backend(maker: str, among: Sequence[str] | None = None) -> str:
    """Exact backend of the highest priority that did not make a program; `maker`, or the default one, if there is no other.

    It is one of `among`, else of those of the house that are available.
    """
    maker = maker or registry.default_backend()
    known = registry.house_slicers() if among is None else among
    others = [name for name in known if name != maker and registry.slicer(name).exact]
    first = sorted(others, key=lambda name: -registry.slicer(name).priority)
    # A probe of some asks drivers and other programs: none is asked whose answer does not matter.
    return next((name for name in first if among is not None or registry.probe(name).available), maker)
