"""The list of kernels, each with its argument types, that the main job and other commands call: what may be compiled ahead.

The list is a file of this package that :mod:`ebamcheck.commands.kernel_record` writes. It is a hint and no more: what it
names and is not there, or does not compile, is left out; what it lacks is compiled when it is first called.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from numba.core.dispatcher import Dispatcher

from ebamcheck.atomic_file import replacing
from ebamcheck.numeric.compiling import name_of
from ebamcheck.numeric.kernel_cache import ENTRY, KernelCache, kernel_cache
from ebamcheck.numeric.kernel_library import about_data
from ebamcheck.numeric.type_text import UnknownType, text_of, types_of

LIST = Path(__file__).with_name("kernel_list.json")

FOR_KERNELS = "for kernels: "
"""What stands before the types of a version that only other kernels call (:mod:`ebamcheck.numeric.kernel_entries`)."""

Listed = dict[str, list[str]]
"""For each kernel, by module and name, the argument types of each of its compiled versions, as text."""


class KernelList(NamedTuple):
    """What may be compiled ahead."""

    main: Listed
    """What the main job calls."""
    whole: Listed
    """That, and what other commands call."""


def read_list(path: Path = LIST) -> KernelList:
    """The list, by kernel; empty where there is none."""
    if not path.is_file():
        return KernelList({}, {})
    held = json.loads(path.read_text(encoding="utf-8"))
    main, others = (
        {
            f"{module}.{name}": versions
            for module, kernels in rooms.items()
            for name, versions in kernels.items()
        }
        for rooms in (held["main job"], held["other commands"])
    )
    return KernelList(main, main | others)


def write_list(main: Listed, whole: Listed, path: Path = LIST) -> None:
    """Write the list, by module, in the order of the alphabet."""
    others = {name: versions for name, versions in whole.items() if versions != main.get(name)}
    held = {"main job": _by_module(main), "other commands": _by_module(others)}
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(held, indent=1) + "\n", encoding="utf-8")


def _by_module(listed: Listed) -> dict[str, Listed]:
    held: dict[str, Listed] = {}
    for name in sorted(listed):
        module, _, kernel = name.rpartition(".")
        held.setdefault(module, {})[kernel] = sorted(listed[name])
    return held


def versions(kernel: Any) -> list[str]:
    """Argument types, as text, of all versions of a kernel that the cache holds; those without a text are left out."""
    found = []
    entered: Any = kernel_cache(kernel.py_func, ENTRY)
    for key in kernel._cache._cache_file._load_index():
        try:
            text = ", ".join(text_of(part) for part in key[0])
        except UnknownType:
            continue
        about = about_data(kernel._cache._cache_file.load(key))
        has_entry = about.is_entered or entered.holds(key[0], kernel.targetctx.codegen())
        found.append(text if has_entry else FOR_KERNELS + text)
    return sorted(set(found))


def compile_listed(kernel: Any, version: str) -> None:
    """Compile a version of a kernel, or load it, as it is listed."""
    given = types_of(version.removeprefix(FOR_KERNELS))
    if version.startswith(FOR_KERNELS):
        kernel.entries.compile_for_kernels(given)
    else:
        kernel.compile(given)


def is_cached(kernel: Any, version: str) -> bool:
    """Whether the cache holds a version; one whose types are unknown here is nothing to compile."""
    try:
        types = types_of(version.removeprefix(FOR_KERNELS))
    except UnknownType:
        return True
    return bool(kernel._cache.holds(types, kernel.targetctx.codegen()))


def kernel_named(name: str) -> Any:
    """The kernel of a module and a name; None where there is none with a cache."""
    module, _, inner = name.rpartition(".")
    try:
        found = getattr(importlib.import_module(module), inner, None)
    except ImportError:
        return None
    is_kernel = isinstance(found, Dispatcher) and isinstance(getattr(found, "_cache", None), KernelCache)
    return found if is_kernel and name_of(found) == name else None


def cached(kernels: Mapping[str, Any]) -> Listed:
    """All versions of kernels that the cache holds."""
    held = {name: versions(kernel) for name, kernel in kernels.items()}
    return {name: found for name, found in held.items() if found}
