"""A stranger's slicer as the harness sees it in its own process: what it has told, and nothing that runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import Any, ClassVar, NoReturn

from pydantic import ConfigDict, PrivateAttr

from ebamcheck.backend import BackendSettings, CoplanarRule, Probe
from ebamcheck.errors import BackendFailed, SettingsError
from ebamcheck.plugins.answers import Answer, ask
from ebamcheck.plugins.points import distribution_of


class StrangerSettings(BackendSettings):
    """Settings that the slicer itself has checked in a process of its own."""

    model_config = ConfigDict(extra="allow", frozen=True)
    _defaults: dict[str, Any] = PrivateAttr(default_factory=dict)

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Settings as plain values; ``exclude_defaults`` leaves out what is the slicer's own default."""
        found = super().model_dump(**options)
        if not options.get("exclude_defaults"):
            return found
        return {k: v for k, v in found.items() if k not in self._defaults or self._defaults[k] != v}


def stranger_settings(values: Mapping[str, Any], defaults: Mapping[str, Any] | None) -> StrangerSettings:
    """Settings that a slicer has checked, with its own defaults."""
    made = StrangerSettings(**{str(k): v for k, v in values.items()})
    made._defaults = dict(defaults or {})
    return made


@dataclass(frozen=True)
class StrangerSlicer:
    """What a slicer of another distribution has told of itself.

    It satisfies :class:`~ebamcheck.backend.Slicer` in form. What would run its code is refused:
    :mod:`ebamcheck.slicers.isolation` runs it in a process of its own.
    """

    name: str
    summary: str
    exact: bool
    priority: int
    coplanar_rule: CoplanarRule
    inside_rule: str
    answer: Answer
    point: EntryPoint
    Settings: ClassVar[type[BackendSettings]] = StrangerSettings

    @property
    def distribution(self) -> str:
        """Name and version of the distribution that it comes with."""
        return " ".join(distribution_of(self.point)).strip()

    def probe(self) -> Probe:
        """What its probe has answered."""
        return self.answer.probe()

    def checked(self, values: Mapping[str, Any]) -> BackendSettings:
        """Have it check settings; raises :class:`SettingsError` naming the first that is wrong."""
        if not values and self.answer.defaults is not None:
            return stranger_settings(self.answer.defaults, self.answer.defaults)
        told, wrong = ask(self.point, "settings", values)
        if isinstance(told.get("wrong"), str):
            raise SettingsError(told["wrong"])
        if wrong or not isinstance(told.get("settings"), dict):
            raise SettingsError(f"backend {self.name!r} did not check its settings: {wrong or 'no answer'}")
        return stranger_settings(told["settings"], self.answer.defaults)

    def error_bound_mm(self, *_: object) -> NoReturn:
        """Refuse: see the class."""
        self._refuse()

    def height_bound_mm(self, *_: object) -> NoReturn:
        """Refuse: see the class."""
        self._refuse()

    def prepare(self, *_: object) -> NoReturn:
        """Refuse: see the class."""
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise BackendFailed(
            f"backend {self.name!r} of {self.distribution or 'another distribution'} runs in a process of its own only: "
            "slice with ebamcheck.slice or `ebamcheck slice`"
        )


def stranger(point: EntryPoint, answer: Answer) -> StrangerSlicer:
    """The slicer of an answer that has attributes."""
    assert answer.attributes is not None
    return StrangerSlicer(**answer.attributes.model_dump(), answer=answer, point=point)
