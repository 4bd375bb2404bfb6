"""Compiled kernels on disk, that several processes share and that follow their sources.

Numba keeps a compiled function as long as the file that defines it does not change. A kernel also holds the code of
the kernels that it calls and the constants that it reads, wherever they are defined; so what is kept here carries a
hash over every module of this project that the kernel's module imports, and is compiled anew when one of them changes.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import importlib.util
import inspect
import os
import pickle
import re
import stat
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import config as numba_config
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache

_IMPORT = re.compile(rb"^(?:from|import)\s+([\w.]+)(?:\s+import\s+(\([^)]*\)|[^\n]*))?", re.MULTILINE)
_NAME = re.compile(rb"\w+")
UNREADABLE = (OSError, EOFError, ValueError, pickle.UnpicklingError, AttributeError, ImportError)
"""A file that raises one of these counts as absent: the kernel is compiled, and written over it.

The last two are those of an older version whose kernels took a type that is no longer there.
"""

OUR_PACKAGES = "ebamcheck"
"""Packages whose name begins so, and the kernel's own package, may hold kernels and constants that it sees."""


class KernelCache(FunctionCache):
    """Numba's cache of one function, stamped by all the sources it depends on; a full disk does not stop the work."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        stamp = sources_stamp(function.__module__, inspect.getfile(function))
        self._cache_file = _SharedFile(self._cache_path, self._impl.filename_base, stamp)  # type: ignore[no-untyped-call]

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep a compiled version; where there is no room for it, the next process compiles again."""
        with contextlib.suppress(OSError):
            super().save_overload(signature, compiled)  # type: ignore[no-untyped-call]


class _SharedFile(IndexDataCacheFile):
    """Index and data of one kernel, for one process at a time.

    Without the lock, two processes that compile different signatures at once write them to the same data file, and
    a third runs the one where it wants the other.
    """

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


def kernel_cache(function: Callable[..., Any]) -> FunctionCache | NullCache:
    """Cache of a kernel: beside its source, else in the user's cache folder, else in a temporary one, else none."""
    try:
        return KernelCache(function)
    except RuntimeError:
        folder = _private_folder()
    if folder is None:
        return NullCache()
    config: Any = numba_config
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
    try:
        return KernelCache(function)
    except RuntimeError:
        return NullCache()
    finally:
        config.CACHE_DIR = before


@cache
def sources_stamp(module: str, path: str | Path) -> str:
    """SHA-256 over a module and all modules of this project and of its own package that it imports, at any depth."""
    packages = (OUR_PACKAGES, module.partition(".")[0])
    files = {module: Path(path)}
    waiting = [module]
    while waiting:
        for name, imported in _imports(files[waiting.pop()], packages):
            if name not in files:
                files[name] = imported
                waiting.append(name)
    made = hashlib.sha256()
    for name in sorted(files):
        made.update(name.encode() + b"\0" + _source(files[name]) + b"\0")
    return made.hexdigest()


@cache
def _imports(path: Path, packages: tuple[str, ...]) -> tuple[tuple[str, Path], ...]:
    """Modules of some packages that a source file names in its imports at the top level, loaded or not."""
    found: dict[str, Path] = {}
    for match in _IMPORT.finditer(_source(path)):
        module = match[1].decode()
        if not module.startswith(packages):
            continue
        inner = (f"{module}.{name.decode()}" for name in _NAME.findall(match[2] or b""))
        for name in (module, *inner):
            if (file := _file_of(name)) is not None:
                found[name] = file
    return tuple(found.items())


@cache
def _file_of(name: str) -> Path | None:
    """Source of a module by its name, without loading it or a package on the way: what is loaded depends on who asks."""
    top, *rest = name.split(".")
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None:
        return None
    if not rest and spec.submodule_search_locations is None:
        return Path(spec.origin) if spec.origin and spec.origin.endswith(".py") else None
    for folder in spec.submodule_search_locations or ():
        for file in (Path(folder, *rest).with_suffix(".py"), Path(folder, *rest, "__init__.py")):
            if (rest or file.name == "__init__.py") and file.is_file():
                return file
    return None


@cache
def _source(path: Path) -> bytes:
    return path.read_bytes()


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
