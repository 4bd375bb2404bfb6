"""The one way in which this project compiles its kernels: numba as it comes, with one cache folder for each state of the sources.

A kernel is a plain function on numpy columns. Numba keeps what it has compiled by the kernel's own file; a folder named after
all sources that hold kernels makes sure that no kernel is kept that calls another one as it was before a change.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import os
import re
import stat
import sys
import tempfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
ShortInts = NDArray[np.int32]
Bools = NDArray[np.bool_]

_Function = TypeVar("_Function", bound=Callable[..., Any])

_HOUSE = "ebamcheck"
_config: Any = numba.config


def kernel(function: _Function) -> _Function:
    """Compile `function` with numba at its first call: cached on disk, without the interpreter lock, IEEE arithmetic
    (a division by zero gives an infinity or NaN).

    What it uses of other modules, it imports by name (``from module import name``): so the cache notices when that changes.
    What keeps compiling short: arguments keep one type each, since a second type compiles a second version, and a literal
    (``f(x, 0)`` beside ``f(x, k)``) is a type of its own; columns are copied in loops, since numba compiles a slice that is
    assigned from an array with all the messages for shapes that do not fit.
    """
    folder = cache_folder(function.__module__.partition(".")[0])
    before, _config.CACHE_DIR = _config.CACHE_DIR, str(folder or "")
    try:
        return cast(_Function, numba.njit(nogil=True, error_model="numpy", cache=folder is not None)(function))
    finally:
        _config.CACHE_DIR = before


@functools.cache
def cache_folder(package: str) -> Path | None:
    """Folder of the compiled kernels of a top-level package; None where no folder can be written.

    It lies in ``NUMBA_CACHE_DIR``, else in the user's cache folder, else among the temporary files.
    """
    home = _cache_home()
    return home / f"{package}-{_stamp(package)}" if home else None


def _stamp(package: str) -> str:
    """Hash of all modules with kernels of this project and of `package`, of those they import from, and of what compiles them."""
    made = hashlib.sha256(f"{version('numba')} {version('numpy')} {sys.version}".encode())
    modules = {**_modules(_HOUSE), **_modules(package)}
    with_kernels = {name for name, source in modules.items() if b"@kernel" in source}
    imported = {found.decode() for name in with_kernels for found in _IMPORTED.findall(modules[name])}
    for name in sorted(with_kernels | imported & modules.keys()):
        made.update(modules[name])
    return made.hexdigest()[:16]


_IMPORTED = re.compile(rb"^from ([\w.]+) import", re.MULTILINE)


@functools.cache
def _modules(package: str) -> dict[str, bytes]:
    """Sources of a package by the names of its modules."""
    spec = importlib.util.find_spec(package) if package != "__main__" else None
    folders = map(Path, (spec.submodule_search_locations if spec else None) or ())
    return {
        ".".join((package, *path.relative_to(folder).with_suffix("").parts)): path.read_bytes()
        for folder in folders
        for path in folder.rglob("*.py")
    }


@functools.cache
def _cache_home() -> Path | None:
    if given := os.environ.get("NUMBA_CACHE_DIR", ""):
        return Path(given) if _is_ours(Path(given), or_of_others=True) else None
    user = os.environ.get("XDG_CACHE_HOME", "") or os.path.expanduser("~/.cache")
    temporary = Path(tempfile.gettempdir()) / f"{_HOUSE}-kernels-{os.getuid()}"
    return next(filter(_is_ours, (Path(user) / _HOUSE / "kernels", temporary)), None)


def _is_ours(folder: Path, or_of_others: bool = False) -> bool:
    """Whether a folder is there, or can be made, that this user may write, and nobody else: machine code is run from it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        state = folder.stat()
    except OSError:
        return False
    alone = state.st_uid == os.getuid() and not state.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return (alone or or_of_others) and os.access(folder, os.W_OK)
