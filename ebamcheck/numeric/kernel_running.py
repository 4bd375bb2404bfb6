"""What numba needs to run kernels that are compiled already: far less than it needs to compile one.

Its compiler takes half a second to set up, and imports SciPy's linear algebra; numba does so by itself before it compiles.
"""

from __future__ import annotations

import importlib
from functools import cache
from typing import Any


@cache
def ready_to_run() -> None:
    """Tell the loader of machine code where the functions are that kernels call: those of memory and of hashes."""
    llvm: Any = importlib.import_module("llvmlite.binding")
    runtime: Any = importlib.import_module("numba.core.runtime._nrt_python")
    for name, address in runtime.c_helpers.items():
        llvm.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)
    importlib.import_module("numba.cpython.hashing")
    _import_array_functions()


def _import_array_functions() -> None:
    """Import numba's array functions, to which most kernels refer, without its look for SciPy's linear algebra.

    SciPy is there: this project depends on it. Kernels that call it look for it again as they are compiled.
    """
    searching: Any = importlib.import_module("numba.np.linalg")
    look, searching.ensure_blas = searching.ensure_blas, lambda: None
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        searching.ensure_blas = look
