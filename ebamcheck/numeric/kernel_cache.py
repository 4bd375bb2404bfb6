"""Compiled kernels on disk, that several processes share and that follow their sources.

Numba keeps a compiled function as long as the file that defines it does not change. A kernel also holds the code of
the kernels that it calls and the constants that it reads, wherever they are defined; so what is kept here carries the
stamp of :mod:`ebamcheck.numeric.kernel_stamp`, and is compiled anew when something of that changes, and only then.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pickle
import re
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from numba.core import config as numba_config
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache, _CacheLocator

from ebamcheck.numeric import ready_kernels
from ebamcheck.numeric.kernel_compiling import ready_to_compile
from ebamcheck.numeric.kernel_library import about_data, has_callees, loading
from ebamcheck.numeric.kernel_running import ready_to_run
from ebamcheck.numeric.kernel_stamp import kernel_stamp
from ebamcheck.numeric.kernel_turns import end_turn, take_turn

UNREADABLE = (OSError, EOFError, ValueError, pickle.UnpicklingError, AttributeError, ImportError)
"""A file that raises one of these counts as absent: the kernel is compiled, and written over it.

The last two are those of an older version whose kernels took a type that is no longer there.
"""


ENTRY = ".entry"
"""Kind of the cache of versions that were compiled once more, with an entry from Python."""


Missed = Callable[[], None]
"""Called when the cache lacks a kernel that this process wants to run, before it is compiled."""

_listeners: list[Missed] = []


@contextlib.contextmanager
def missing_told(told: Missed) -> Iterator[None]:
    """Have `told` called for every kernel that the cache lacks while the block runs."""
    _listeners.append(told)
    try:
        yield
    finally:
        _listeners.remove(told)


_try_folder: Any = _CacheLocator.ensure_cache_path
_tried: set[str] = set()


def _try_folder_once(locator: Any) -> None:
    """Make a folder of compiled kernels and write a file there for a trial; numba does so for every kernel."""
    folder = locator.get_cache_path()
    if folder not in _tried or not os.path.isdir(folder):
        _try_folder(locator)
        _tried.add(folder)


_CacheLocator.ensure_cache_path = _try_folder_once  # type: ignore[method-assign]


class KernelCache(FunctionCache):
    """Numba's cache of one function, stamped by all that it is made of; a full disk does not stop the work."""

    def __init__(self, function: Callable[..., Any], kind: str = "") -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._kind = kind
        name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        base = re.sub(r"[^\w.-]", "", name) + f"{kind}.{sys.implementation.cache_tag}"
        self._cache_file = _SharedFile(self._cache_path, base, function)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Read a compiled version, if there is one.

        Numba would first set up all that it compiles with, which takes longer than all kernels of a command; it does so
        anyway when it compiles something.
        """
        ready_to_run()
        found = self._loaded(signature, context)
        if found is None:
            ready_to_compile()
            for told in _listeners.copy():
                told()
            take_turn(self._cache_path, self._what(signature))
            found = self._loaded(signature, context)  # whoever had the turn before has made it
            if found is not None:
                self.give_up(signature)
        return found

    def _loaded(self, signature: Any, context: Any) -> Any:
        codegen = context.codegen()
        data = None if self._kind else ready_kernels.loaded(self._py_func, signature)
        if data is None:
            data = self._cache_file.load(self._index_key(signature, codegen))  # type: ignore[no-untyped-call]
        if data is None or not has_callees(about_data(data)):
            return None
        with loading(codegen):
            return self._impl.rebuild(context, data)

    def give_up(self, signature: Any) -> None:
        """Let other processes compile a version: it is there, or does not compile."""
        end_turn(self._cache_path, self._what(signature))

    def _what(self, signature: Any) -> str:
        return f"{self._py_func.__module__}.{self._py_func.__qualname__}{self._kind} {signature}"

    def holds(self, signature: Any, codegen: Any) -> bool:
        """Whether a version need not be compiled."""
        return (not self._kind and ready_kernels.holds(self._py_func, signature)) or (
            self._index_key(signature, codegen) in self._cache_file._load_index()  # type: ignore[no-untyped-call]
        )

    def holds_any(self) -> bool:
        """Whether any version is compiled."""
        return (not self._kind and ready_kernels.holds(self._py_func)) or bool(self._cache_file._load_index())  # type: ignore[no-untyped-call]

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep a compiled version; where there is no room for it, the next process compiles again."""
        # Without the text of the source with types beside it, for which nobody asks.
        kept = compiled._replace(type_annotation="")
        with contextlib.suppress(OSError):
            super().save_overload(signature, kept)  # type: ignore[no-untyped-call]
        self.give_up(signature)


class _SharedFile(IndexDataCacheFile):
    """Index and data of one kernel, for one process at a time.

    Without the lock, two processes that compile different signatures at once write them to the same data file, and
    a third runs the one where it wants the other.
    """

    def __init__(self, folder: str, base: str, function: Callable[..., Any]) -> None:
        super().__init__(folder, base, "")  # type: ignore[no-untyped-call]
        self._function = function
        del self._source_stamp

    @cached_property
    def _source_stamp(self) -> str:
        """Stamp of the function, worked out when it is first asked for: what it refers to is there by then."""
        return kernel_stamp(self._function)

    def save(self, key: Any, data: Any) -> None:
        with self._locked(fcntl.LOCK_EX):
            super().save(key, data)  # type: ignore[no-untyped-call]

    def load(self, key: Any) -> Any:
        with contextlib.suppress(*UNREADABLE), self._locked(fcntl.LOCK_SH):
            return super().load(key)  # type: ignore[no-untyped-call]
        return None

    def _load_index(self) -> dict[Any, str]:
        with contextlib.suppress(*UNREADABLE):
            return dict(super()._load_index())  # type: ignore[no-untyped-call]
        return {}

    @contextlib.contextmanager
    def _locked(self, kind: int) -> Iterator[None]:
        descriptor = os.open(os.path.join(self._cache_path, "kernels.lock"), os.O_RDWR | os.O_CREAT, 0o600)
        try:
            fcntl.flock(descriptor, kind)
            yield
        finally:
            os.close(descriptor)


def kernel_cache(function: Callable[..., Any], kind: str = "") -> FunctionCache | NullCache:
    """Cache of a kernel: beside its source, else in the user's cache folder, else in a temporary one, else none."""
    try:
        return KernelCache(function, kind)
    except RuntimeError:
        folder = _private_folder()
    if folder is None:
        return NullCache()
    config: Any = numba_config
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
    try:
        return KernelCache(function, kind)
    except RuntimeError:
        return NullCache()
    finally:
        config.CACHE_DIR = before


@cache
def _private_folder() -> Path | None:
    """A folder for temporary files that nobody else can write to: what lies there is run as code."""
    folder = Path(tempfile.gettempdir(), f"ebamcheck-kernels-{os.getuid()}")
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return folder if ours else None
