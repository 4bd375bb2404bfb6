"""Names of a package that load when they are first used: who wants one of them waits for no other's modules."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def on_demand(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package, by the modules in it in which its names live; ``module:name`` where they have
    another there.

    >>> find = on_demand("ebamcheck", {"InputError": "errors"})
    >>> find("InputError").__name__
    'InputError'
    >>> find("Nothing")
    Traceback (most recent call last):
    AttributeError: module 'ebamcheck' has no attribute 'Nothing'
    """

    def found(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, _, its_name = homes[name].partition(":")
        return getattr(import_module(f"{package}.{module}"), its_name or name)

    return found
