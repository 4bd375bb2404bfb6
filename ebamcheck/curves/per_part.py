"""What follows from a mesh alone is worked out once for a part of which single layers are fitted, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary, WeakSet

from ebamcheck.mesh.part import Part

_Found = TypeVar("_Found")
_Key = TypeVar("_Key", bound=Hashable)

_kept: WeakSet[Part] = WeakSet()


def keep_surface_of(part: Part) -> None:
    """Keep what is found of the surface of a part as long as that is there: it takes some 100 bytes a facet."""
    _kept.add(part)


def once_a_part(function: Callable[[Part, _Key], _Found]) -> Callable[[Part, _Key], _Found]:
    """Keep what a function of a part and of settings returned last, for parts of which it is to be kept.

    Nobody may change what it returns.
    """
    known: WeakKeyDictionary[Part, tuple[_Key, _Found]] = WeakKeyDictionary()

    @wraps(function)
    def kept(part: Part, key: _Key) -> _Found:
        if part not in _kept:
            return function(part, key)
        if part not in known or known[part][0] != key:
            known[part] = key, function(part, key)
        return known[part][1]

    return kept
