"""What a kernel is made of: its own code, and the kernels and constants that it sees, at any depth.

A stamp of it says whether a compiled kernel is still the one of the sources. It follows names, not files: an edit of a
docstring, of a setting or of a function beside the kernel compiles nothing anew.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

OUR_PACKAGES = "ebamcheck"
"""Modules whose names begin so, and the kernel's own package, may hold what a kernel sees."""


FORM = 3
"""Form of what is compiled: 2 since names in machine code are a process's own, 3 since long callees are called where they lie."""


def kernel_stamp(function: Callable[..., Any], python: str = sys.version) -> str:
    """SHA-256 over the code of a function and all that it refers to.

    Names are looked up when this is called: by the first call of a kernel, all of its module is there. `python` is the
    version of Python, as precisely as it matters.
    """
    made = hashlib.sha256(f"{FORM} {python}".encode())
    for line in sorted(set(_parts(_plain(function), {}))):
        made.update(line.encode("utf-8", "backslashreplace") + b"\0")
    return made.hexdigest()


def seen_by(function: Callable[..., Any]) -> set[str]:
    """Modules and names of the functions that a function refers to, at any depth, itself included."""
    seen: dict[str, None] = {}
    for _ in _parts(_plain(function), seen):
        pass
    return set(seen)


def _plain(value: Any) -> Any:
    """The Python function behind a kernel."""
    return getattr(value, "py_func", value)


def _parts(function: Any, seen: dict[str, None]) -> Iterator[str]:
    name = f"{function.__module__}.{function.__qualname__}"
    if name in seen:
        return
    seen[name] = None
    yield f"{name} = {_code(function.__code__)}"
    packages = (OUR_PACKAGES, function.__module__.partition(".")[0])
    cells = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
    known: dict[str, Any] = {key: cell.cell_contents for key, cell in cells.items()}
    known |= {
        key: function.__globals__[key] for key in _names(function.__code__) if key in function.__globals__
    }
    for key, value in sorted(known.items()):
        yield from _value(f"{name}.{key}", value, _names(function.__code__), packages, seen)


def _value(
    place: str, value: Any, names: set[str], packages: tuple[str, ...], seen: dict[str, None]
) -> Iterator[str]:
    """What a name stands for: a function is followed, a module of ours by the names that may be asked of it."""
    plain = _plain(value)
    if isinstance(plain, FunctionType):
        if plain.__module__.startswith(packages):
            yield from _parts(plain, seen)
        else:
            yield f"{place} is {plain.__module__}.{plain.__qualname__}"
    elif isinstance(plain, ModuleType):
        yield f"{place} is {plain.__name__}"
        if plain.__name__.startswith(packages):
            for key in sorted(names & vars(plain).keys()):
                yield from _value(f"{place}.{key}", vars(plain)[key], names, packages, seen)
    elif isinstance(plain, np.ndarray):
        yield f"{place} = {plain.dtype} {plain.shape} {hashlib.sha256(plain.tobytes()).hexdigest()}"
    elif isinstance(plain, type):
        yield f"{place} is {plain.__module__}.{plain.__qualname__} {getattr(plain, '_fields', '')}"
    elif isinstance(plain, Mapping):
        yield f"{place} = {sorted(map(repr, plain.items()))}"
    else:
        yield f"{place} = {plain!r}"


def _code(code: CodeType) -> str:
    """Instructions, constants and names of a code object; neither its docstring nor the lines it stands on."""
    constants = code.co_consts
    if constants and isinstance(constants[0], str) and code.co_name != "<lambda>":
        constants = (None, *constants[1:])
    shown = [_code(c) if isinstance(c, CodeType) else repr(c) for c in constants]
    return f"{code.co_code.hex()} {shown} {code.co_names} {code.co_varnames} {code.co_freevars} {code.co_argcount}"


def _names(code: CodeType) -> set[str]:
    """All names that a code object and those within it ask of anything."""
    within = (c for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*(_names(c) for c in within))
