"""Checks of the values that a user gives: one way from texts and tables to settings, and one form of message.

A message reads ``WHERE: KEY: what it takes (given VALUE); which keys there are``, whether the value came from a settings
file, a plate, a table of tolerances, the command line or the arguments of a function.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from ebamcheck.errors import EbamcheckError, SettingsError
from ebamcheck.regular_file import regular_file
from ebamcheck.settings.slicing import MachineChoice
from ebamcheck.settings.text import wanted
from ebamcheck.showing.short_text import did_you_mean

_Kind = TypeVar("_Kind", bound=BaseModel)


def read_toml(path: Path, error: type[EbamcheckError] = SettingsError) -> dict[str, Any]:
    """Read a TOML file; raises `error` where it cannot be read or is none."""
    try:
        return tomllib.loads(regular_file(path, error).read_text(encoding="utf-8"))
    except OSError as found:
        raise error(f"{path}: cannot be read: {found.strerror or found}") from None
    except UnicodeDecodeError:
        raise error(f"{path}: is not UTF-8 text, as TOML must be") from None
    except ValueError as found:  # a number of thousands of digits is one, too
        raise error(f"{path}: is not TOML: {found}") from None
    except RecursionError:
        raise error(f"{path}: is not TOML of ours: hundreds of lists within each other") from None


def checked(
    kind: type[_Kind],
    values: Mapping[str, Any],
    where: Path | str,
    keys: str = "",
    error: type[EbamcheckError] = SettingsError,
) -> _Kind:
    """Check values against a kind of settings, or of all sections of them.

    A message begins with `where` they were given, and names the first key that is unknown or missing, or whose value is wrong. `keys`
    is where a user finds the keys that there are; empty: the message lists them. `error` is raised.
    """
    try:
        return kind.model_validate(values)
    except ValidationError as found:
        first = found.errors()[0]
        place = _place(kind, first["loc"])
        known = keys or f"known keys: {', '.join(place.known) or 'none'}"
        raise error(f"{where}: {_told(place, first)}; {known}") from None


class _Place(NamedTuple):
    """A setting that something is wrong with."""

    section: str
    """Section that it stands in; empty where the settings have none."""
    kind: type[BaseModel]
    """Settings that it is one of."""
    path: tuple[int | str, ...]
    """Its key, and behind it keys and numbers within it, and types that were tried."""

    @property
    def info(self) -> FieldInfo | None:
        """The setting; None for a key that is none."""
        return self.kind.model_fields.get(str(self.path[0])) if self.path else None

    @property
    def inner(self) -> type[BaseModel] | None:
        """Kind of the tables in a setting that is a list of them."""
        kinds = get_args(self.info.annotation) if self.info is not None else ()
        return next((k for k in kinds if _is_settings(k)), None)

    def is_key(self, name: int | str) -> bool:
        """Whether a part of the path is a key of a table, by itself or in a list."""
        if self.info is not None and get_origin(self.info.annotation) is dict:
            return name == self.path[1]
        return self.inner is not None and name in self.inner.model_fields

    def told(self, unknown: bool = False) -> str:
        """Its name for a user, to whom types that were tried mean nothing; tables of a list are counted from 1."""
        last = len(self.path) - 1
        return self._joined(
            [
                k
                for n, k in enumerate(self.path[1:], 1)
                if isinstance(k, int) or self.is_key(k) or (unknown and n == last)
            ]
        )

    def _joined(self, behind: Sequence[int | str]) -> str:
        names = [self.section] if self.section else []
        names += map(str, self.path[:1])
        if self.inner is not None and behind and isinstance(behind[0], int):
            names[-1] += f" {behind[0] + 1}"
            behind = behind[1:]
        return ".".join([*names, *map(str, behind)]) or "settings"

    @property
    def known(self) -> Sequence[str]:
        """Keys of the table that it stands in."""
        return [*(self.inner or self.kind).model_fields]

    def takes(self) -> str:
        """What it takes."""
        if self.info is None and self.path:
            return "a table with " + ", ".join(MachineChoice.model_fields)
        if self.info is None or _is_settings(self.info.annotation):
            return "a table of settings"
        key = next((str(k) for k in self.path[1:] if self.is_key(k)), "")
        if self.inner is not None and key in self.inner.model_fields:
            prefix = f"{self.section}." if self.section else ""
            return wanted(f"{prefix}{self.path[0]}", key, self.inner.model_fields[key])
        return wanted(self.section, str(self.path[0]), self.info)


def _is_settings(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _place(kind: type[BaseModel], loc: tuple[int | str, ...]) -> _Place:
    """Find the settings that a place is in: a section, or a table of a table of settings by name."""
    info = kind.model_fields.get(str(loc[0])) if loc else None
    section: Any = None if info is None else info.annotation
    used = 1
    while get_origin(section) is dict:
        section, used = get_args(section)[1], used + 1
    if _is_settings(section) and len(loc) > used:
        return _Place(".".join(map(str, loc[:used])), section, loc[used:])
    return _Place("", kind, loc)


def _told(place: _Place, first: Mapping[str, Any]) -> str:
    given = first.get("input")
    shown = "" if isinstance(given, dict | BaseModel) else f" (given {given!r})"
    if first["type"] == "extra_forbidden":
        return f"{place.told(unknown=True)}: unknown key{did_you_mean(str(place.path[-1]), place.known)}"
    if first["type"] == "missing" and isinstance(first["loc"][-1], str):
        return f"{place.told()}: is missing: it takes {place.takes()}"
    if isinstance(given, float) and not math.isfinite(given):
        return f"{place.told()}: it takes {place.takes()}, and a finite one{shown}"
    if first["type"] == "value_error":
        return f"{place.told()}: {str(first['msg']).removeprefix('Value error, ')}{shown}"
    return f"{place.told()}: it takes {place.takes()}" + (
        shown or f" (given a {'table' if isinstance(given, dict) else 'value'})"
    )
