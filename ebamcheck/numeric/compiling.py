"""Kernels while they are compiled: which, how many are still to come, and how long it takes.

A kernel is compiled once on a machine and then read from disk (:mod:`ebamcheck.numeric.kernel_cache`). Whoever waits is told
here: by numba's own events in this process, and by :func:`begun` for what another process tells of itself. What is
compiled already is told by the small index files of the cache; no machine code is read for it.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from numba.core import event
from numba.core.dispatcher import Dispatcher

from ebamcheck.numeric.kernel_cache import KernelCache
from ebamcheck.numeric.kernel_stamp import OUR_PACKAGES

Told = Callable[[int, int, str], None]
"""Called as a kernel is begun: its number, how many there are at most, and its name."""

COMPILE = "numba:compile"

_lock = threading.RLock()
_listeners: list[Told] = []
_begun: dict[str, None] = {}
"""Names of the kernels whose compilation began while somebody listened, here or in a process that tells of it."""
_expected: set[str] = set()


class _Clock:
    """Time in which this process compiled anything: kernels within a kernel count once."""

    def __init__(self) -> None:
        self.depth = 0
        self.since = 0.0
        self.seconds = 0.0
        self.ended: list[Callable[[float], None]] = []


_clock = _Clock()


class _Listener(event.Listener):
    """Hears from numba what is compiled here; what is read from disk makes no event."""

    def on_start(self, found: Any) -> None:
        """Start the clock, and tell which kernel it is."""
        with _lock:
            _clock.depth += 1
            if _clock.depth == 1:
                _clock.since = time.perf_counter()
        dispatcher = found.data["dispatcher"]
        if isinstance(dispatcher._cache, KernelCache):
            begun(name_of(dispatcher))

    def on_end(self, found: Any) -> None:
        """Stop the clock."""
        with _lock:
            _clock.depth -= 1
            if _clock.depth:
                return
            _clock.seconds += time.perf_counter() - _clock.since
            for tell in _clock.ended:
                tell(_clock.seconds)


_listener = _Listener()
_is_watching = False


def watch() -> None:
    """Have numba tell what it compiles in this process, from now on; a second call changes nothing."""
    global _is_watching
    if not _is_watching:
        event.register(COMPILE, _listener)  # type: ignore[no-untyped-call]
        _is_watching = True


def seconds() -> float:
    """Time in which this process has compiled since :func:`watch`."""
    with _lock:
        running = time.perf_counter() - _clock.since if _clock.depth else 0.0
        return _clock.seconds + running


def when_ended(tell: Callable[[float], None]) -> None:
    """Call `tell` with :func:`seconds` each time that this process has compiled something."""
    _clock.ended.append(tell)


@contextmanager
def heard_by(told: Told) -> Iterator[None]:
    """Have `told` called for every kernel whose compilation begins while the block runs; nobody else hears of it."""
    watch()
    with _lock:
        if not _listeners:
            _begun.clear()
            _expected.clear()
        _listeners.append(told)
    try:
        yield
    finally:
        with _lock:
            _listeners.remove(told)


def leave_to_parent() -> None:
    """Tell nobody of what this process compiles: one that was forked to compile, whose parent tells of it."""
    with _lock:
        _listeners.clear()


def begun(name: str, others: Iterable[str] = ()) -> None:
    """Tell whoever listens that the compilation of a kernel has begun.

    Parameters
    ----------
    name
        The kernel, of this process or another.
    others
        Kernels that the other process has still to compile, :func:`missing` there.
    """
    with _lock:
        if not _listeners or name in _begun:
            return
        if name not in _expected:
            # The first one, or one of a module that was loaded since.
            _expected.update(missing())
            _expected.add(name)
        _expected.update(others)
        _begun[name] = None
        _listeners[-1](len(_begun), len(_expected), name)


def missing() -> list[str]:
    """Kernels of the modules that are loaded of which the cache holds nothing; those never called are among them."""
    return sorted(name_of(found) for found in loaded_kernels() if not found._cache.holds_any())


def loaded_kernels() -> list[Any]:
    """Kernels of all modules that are loaded."""
    modules = [
        m
        for name, m in sys.modules.copy().items()
        if isinstance(m, ModuleType) and name.startswith(OUR_PACKAGES)
    ]
    found: dict[int, Any] = {
        id(value): value
        for module in modules
        for value in vars(module).copy().values()
        if isinstance(value, Dispatcher) and isinstance(getattr(value, "_cache", None), KernelCache)
    }
    return list(found.values())


def name_of(kernel: Any) -> str:
    """Module and name of a kernel."""
    return f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"
