"""Kernels that come with the installation, compiled for a whole class of processors: one file beside this module.

``make wheel`` writes it. A kernel is taken from it where the file was made by this version of numba for this kind of
Python, the processor can run it, and the kernel is the one of the sources; anything else is compiled as ever, and nothing
is said. It holds no fused multiply-add: numba asks LLVM for none, so that results are those of any other processor.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import mmap
import os
import pickle
import platform
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numba

from ebamcheck.atomic_file import replacing
from ebamcheck.numeric.kernel_stamp import kernel_stamp
from ebamcheck.numeric.type_text import UnknownType, text_of

FILE = Path(__file__).with_name("ready.kernels")
"""``EBAMCHECK_READY_KERNELS`` names another one; empty, there is none."""

LEVELS: Mapping[str, frozenset[str]] = {
    "x86-64-v3": frozenset({"avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"}),
    "generic": frozenset(),
}
"""Classes of processors by LLVM's name, and what one must have beyond the class below it (x86-64 psABI, 2020)."""

BUILT_FOR: Mapping[str, str] = {"x86_64": "x86-64-v3", "aarch64": "generic"}
"""Class that a wheel is built for, by the machine that builds it: Intel from 2013, AMD from 2015; every 64-bit Arm."""

HEAD_BYTES = 16
"""The size of the index stands before it, in so many decimal digits."""


class _Ready(NamedTuple):
    """What a file holds."""

    kernels: Mapping[str, Any]
    """For each kernel, its stamp and, by argument types, where its versions begin and how long they are."""
    data: memoryview


def loaded(function: Callable[..., Any], signature: Any) -> Any:
    """Version of a kernel as numba keeps it, or None."""
    place = _place(function, signature)
    if place is None:
        return None
    start, size = place
    return pickle.loads(_ready().data[start : start + size])


def holds(function: Callable[..., Any], signature: Any = None) -> bool:
    """Whether a version of a kernel is there; any one, where no argument types are given."""
    if signature is None:
        return bool(_versions(function))
    return _place(function, signature) is not None


def write(versions: Iterable[tuple[Callable[..., Any], Any, bytes]], level: str, path: Path) -> int:
    """Write kernels, each with its argument types and what numba keeps of it; returns how many versions there are."""
    kernels: dict[str, Any] = {}
    parts: list[bytes] = []
    end = 0
    for function, signature, data in versions:
        entry = kernels.setdefault(_name(function), {"stamp": _stamp(function), "versions": {}})
        entry["versions"][_text(signature)] = (end, len(data))
        parts.append(data)
        end += len(data)
    index = json.dumps({"made for": _made_for(level), "level": level, "kernels": kernels}).encode()
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(str(len(index)).rjust(HEAD_BYTES).encode() + index)
        file.writelines(parts)
    return len(parts)


def can_run(level: str) -> bool:
    """Whether this machine's processor has all that a class asks for."""
    features: Mapping[str, bool] = importlib.import_module("llvmlite.binding").get_host_cpu_features()
    return level in LEVELS and all(features.get(name, False) for name in LEVELS[level])


def _place(function: Callable[..., Any], signature: Any) -> tuple[int, int] | None:
    versions = _versions(function)
    try:
        found = versions.get(_text(signature)) if versions else None
    except UnknownType:
        return None
    return None if found is None else (int(found[0]), int(found[1]))


def _versions(function: Callable[..., Any]) -> Mapping[str, Any]:
    """Versions of a kernel as it stands in the sources."""
    entry = _ready().kernels.get(_name(function))
    return entry["versions"] if entry is not None and entry["stamp"] == _stamp(function) else {}


@cache
def _ready() -> _Ready:
    """The file, if it is one for this installation and this machine; else nothing."""
    nothing = _Ready({}, memoryview(b""))
    try:
        with Path(os.environ.get("EBAMCHECK_READY_KERNELS", FILE)).open("rb") as file:
            held = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        start = HEAD_BYTES + int(bytes(held[:HEAD_BYTES]))
        index = json.loads(bytes(held[HEAD_BYTES:start]))
        if index["made for"] != _made_for(index["level"]) or not can_run(index["level"]):
            return nothing
        return _Ready(index["kernels"], held[start:])
    except (OSError, ValueError, KeyError, TypeError):
        return nothing


def _made_for(level: str) -> list[str]:
    return [str(numba.__version__), _python(), platform.system(), platform.machine(), level]


def _python() -> str:
    """Kind of Python as its bytecode tells it, which patch releases share."""
    return f"{sys.implementation.cache_tag} {importlib.util.MAGIC_NUMBER.hex()}"


@cache
def _stamp(function: Callable[..., Any]) -> str:
    return kernel_stamp(function, _python())


def _name(function: Callable[..., Any]) -> str:
    return f"{function.__module__}.{function.__qualname__}"


def _text(signature: Any) -> str:
    return ", ".join(text_of(part) for part in signature)
