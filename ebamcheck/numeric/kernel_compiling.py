"""How numba compiles kernels here: what it is spared, and names in machine code that no other process gives."""

from __future__ import annotations

import gc
import importlib
import itertools
import os
import secrets
from collections.abc import Iterator
from functools import cache
from typing import Any

from numba.core.bytecode import FunctionIdentity
from numba.extending import overload

from ebamcheck.numeric.compiler_savings import spare_compiler
from ebamcheck.numeric.kernel_library import KernelLibrary

OBJECTS_BEFORE_GC = 400_000
"""New objects until Python looks for rings of dead ones, in a process that does nothing but compile."""


NUMBER_BITS = 60
"""Bits of the first number that a process gives: two processes come to the same ones once in 10^12 times."""


class _OwnNumbers:
    """Numbers of the functions that a process compiles, which no other process gives.

    Numba counts from 1 in every process, and names machine code by these numbers. What it compiles into a kernel along with
    it, such as a sort, keeps its name on disk. Of two kernels that were compiled by two processes and are loaded by a third,
    both with a function of one name, the loader takes the first for both: ``sort`` ran in the place of ``argsort``, and
    what it returned was taken for places in memory.
    """

    def __init__(self) -> None:
        self._process = -1
        self._numbers: Iterator[int] = iter(())

    def __next__(self) -> int:
        if self._process != os.getpid():  # a forked process, too, counts for itself
            self._process, self._numbers = os.getpid(), itertools.count(secrets.randbits(NUMBER_BITS))
        return next(self._numbers)


def number_functions() -> None:
    """Let this process, and all that it forks, name machine code by numbers of their own."""
    identity: Any = FunctionIdentity
    if not isinstance(identity._unique_ids, _OwnNumbers):
        identity._unique_ids = _OwnNumbers()


@cache
def ready_to_compile() -> None:
    """Give an assignment to a slice an error without figures: the text with them is compiled into every kernel.

    Numba writes the two shapes into it, in compiled code: three tenths of the time that all kernels took to compile, for
    a message that tells of a fault in a kernel. Versions of numba that do not know the function are left as they are.
    """
    spare_compiler()
    _leave_out_entries_from_c()
    arrays: Any = importlib.import_module("numba.np.arrayobj")
    if hasattr(arrays, "raise_with_shape_context"):
        arrays.raise_with_shape_context = _sizes_differ


def _leave_out_entries_from_c() -> None:
    """Make no entry from C for functions that numba compiles into a kernel, such as a sort: nothing can call it."""
    lower: Any = importlib.import_module("numba.core.lowering").Lower
    made = lower.create_cfunc_wrapper

    def create(given: Any) -> None:
        if not isinstance(given.library, KernelLibrary):
            made(given)

    lower.create_cfunc_wrapper = create


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
