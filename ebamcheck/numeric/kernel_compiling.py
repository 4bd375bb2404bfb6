"""What numba is spared when it compiles kernels."""

from __future__ import annotations

import gc
import importlib
from functools import cache
from typing import Any

from numba.extending import overload

OBJECTS_BEFORE_GC = 100_000
"""New objects until Python looks for rings of dead ones, in a process that does nothing but compile."""


@cache
def ready_to_compile() -> None:
    """Give an assignment to a slice an error without figures: the text with them is compiled into every kernel.

    Numba writes the two shapes into it, in compiled code: three tenths of the time that all kernels took to compile, for
    a message that tells of a fault in a kernel. Versions of numba that do not know the function are left as they are.
    """
    arrays: Any = importlib.import_module("numba.np.arrayobj")
    if hasattr(arrays, "raise_with_shape_context"):
        arrays.raise_with_shape_context = _sizes_differ


def _sizes_differ(given: Any, wanted: Any) -> None:
    """Tell that what is assigned to a slice has another shape; compiled kernels have what stands below."""
    raise NotImplementedError


@overload(_sizes_differ)
def _compiled_sizes_differ(given: Any, wanted: Any) -> Any:
    def raise_it(given: Any, wanted: Any) -> None:
        raise ValueError("cannot assign an array to a slice of another shape")

    return raise_it


def only_compile() -> None:
    """Prepare a process that was forked to do nothing but compile: its parent's objects stay, and few new ones die."""
    gc.freeze()
    gc.set_threshold(OBJECTS_BEFORE_GC)
