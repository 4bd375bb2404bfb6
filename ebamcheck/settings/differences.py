"""Which settings differ between two sets of them, each by name with both values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ebamcheck.settings.config import Config

MISSING = "nothing"
"""Stands for the value of a setting that one side lacks."""


def differences(one: Config, other: Config) -> list[str]:
    """Settings whose values differ, in their order: ``SECTION.NAME is VALUE, not OTHER VALUE``.

    Examples
    --------
    >>> differences(Config().changed(scan={"seed": 4}), Config())
    ['scan.seed is 4, not 0']
    """
    return list(_differing(one.model_dump(mode="json"), other.model_dump(mode="json"), ""))


def _differing(one: Mapping[str, Any], other: Mapping[str, Any], within: str) -> Iterator[str]:
    for name in dict.fromkeys([*one, *other]):
        mine, its = one.get(name, MISSING), other.get(name, MISSING)
        if isinstance(mine, Mapping) and isinstance(its, Mapping):
            yield from _differing(mine, its, f"{within}{name}.")
        elif mine != its:
            yield f"{within}{name} is {mine}, not {its}"
