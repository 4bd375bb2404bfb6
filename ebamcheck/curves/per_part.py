"""Memory of what is computed from a mesh alone, for parts whose layers are fitted one after the other."""

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
"""Last key and result of each decorated function, by part."""


def keep_surface_of(part: Part) -> None:
    """Keep what is computed from a part's mesh for as long as the part exists: some 100 bytes per facet."""
    _kept.add(part)


@contextmanager
def surface_kept(part: Part) -> Iterator[None]:
    """Keep what is computed from a part's mesh within the block, in which several fits need the same."""
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
    """Decorate a function of a part and a key, such as settings, so that its last result is kept.

    It is kept only for parts named by :func:`keep_surface_of` or :func:`surface_kept`. Callers must not modify it.
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
