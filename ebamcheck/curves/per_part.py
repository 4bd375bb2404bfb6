"""What follows from a mesh alone is worked out once for a part of which single layers are fitted, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, TypeVar
from weakref import WeakKeyDictionary, WeakSet

from ebamcheck.mesh.part import Part

_Found = TypeVar("_Found")
_Key = TypeVar("_Key", bound=Hashable)

_kept: WeakSet[Part] = WeakSet()

_memories: list[WeakKeyDictionary[Part, Any]] = []
"""What each of the functions knows, by part."""


def keep_surface_of(part: Part) -> None:
    """Keep what is found of the surface of a part as long as that is there: it takes some 100 bytes a facet."""
    _kept.add(part)


@contextmanager
def surface_kept(part: Part) -> Iterator[None]:
    """Keep what is found of the surface of a part for the moment: several fits of one stack ask for the same."""
    if part in _kept:
        yield
        return
    _kept.add(part)
    try:
        yield
    finally:
        _kept.discard(part)
        for memory in _memories:
            memory.pop(part, None)


def once_a_part(function: Callable[[Part, _Key], _Found]) -> Callable[[Part, _Key], _Found]:
    """Keep what a function of a part and of settings returned last, for parts of which it is to be kept.

    Nobody may change what it returns.
    """
    known: WeakKeyDictionary[Part, tuple[_Key, _Found]] = WeakKeyDictionary()
    _memories.append(known)

    @wraps(function)
    def kept(part: Part, key: _Key) -> _Found:
        if part not in _kept:
            return function(part, key)
        if part not in known or known[part][0] != key:
            known[part] = key, function(part, key)
        return known[part][1]

    return kept
