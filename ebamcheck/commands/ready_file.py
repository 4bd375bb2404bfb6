"""Compile all kernels for a class of processors into the file that a wheel brings along: part of ``make wheel``.

``python -m ebamcheck.commands.ready_file FILE [PACKAGE ...]`` compiles in a process of its own, with an empty cache, for
the machine's class in :data:`ebamcheck.numeric.ready_kernels.BUILT_FOR`; with packages only their kernels, and what they call.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ebamcheck.numeric.ready_kernels import BUILT_FOR
from ebamcheck.scratch import scratch_folder


def write_file(path: Path, level: str, packages: tuple[str, ...] = ()) -> int:
    """Compile into the cache of this process and write from it; returns how many versions of kernels there are."""
    from ebamcheck.numeric.compiling_ahead import compile_ahead
    from ebamcheck.numeric.kernel_list import kernel_named, read_list
    from ebamcheck.numeric.kernel_stamp import seen_by
    from ebamcheck.numeric.ready_kernels import write

    listed = read_list().whole
    if packages:
        wanted = [kernel_named(name) for name in listed if name.startswith(packages)]
        seen = {name for kernel in wanted if kernel is not None for name in seen_by(kernel.py_func)}
        listed = {name: versions for name, versions in listed.items() if name in seen}
    for name, why in compile_ahead(listed).items():
        print(f"{name} is left out: {why}", file=sys.stderr)
    kernels = [kernel for name in listed if (kernel := kernel_named(name)) is not None]
    return write((part for kernel in kernels for part in _compiled(kernel, level)), level, path)


def _compiled(kernel: Any, level: str) -> Iterator[tuple[Any, Any, bytes]]:
    """Versions of a kernel that the cache holds for the class of processors: function, argument types, and data."""
    held = kernel._cache._cache_file
    for (signature, (_, processor, _), _), name in held._load_index().items():
        if processor == level:
            yield kernel.py_func, signature, Path(held._data_path(name)).read_bytes()


def main(arguments: list[str]) -> int:
    """Write the file named first."""
    path, packages = Path(arguments[0]).absolute(), tuple(arguments[1:])
    level = BUILT_FOR.get(platform.machine())
    if level is None:
        print(
            f"ready-made kernels are compiled on {' and '.join(BUILT_FOR)}, not on {platform.machine()}",
            file=sys.stderr,
        )
        return 2
    if os.environ.get("NUMBA_CPU_NAME") == level:
        print(f"{path}: {write_file(path, level, packages)} versions of kernels, for {level}")
        return 0
    with scratch_folder() as folder:
        environment = {
            "NUMBA_CACHE_DIR": str(folder),
            "NUMBA_CPU_NAME": level,
            "NUMBA_CPU_FEATURES": "",
            "EBAMCHECK_READY_KERNELS": "",
        }
        command = [sys.executable, "-m", "ebamcheck.commands.ready_file", str(path), *packages]
        return subprocess.run(command, env={**os.environ, **environment}, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
