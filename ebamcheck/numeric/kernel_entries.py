"""Entries of kernels from Python: only those versions have one that Python calls.

An entry unpacks every array and every field of a named tuple, and writes the errors. It is a quarter of the time that a
kernel takes to compile, and most kernels are called by other kernels alone. Where Python calls a version without an entry
after all, as tests do, the kernel is compiled once more, with one, and that is kept beside the first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba import types
from numba.core.compiler_lock import global_compiler_lock

from ebamcheck.numeric.kernel_cache import KernelCache
from ebamcheck.numeric.kernel_library import compiling, describe

NARROW = (types.int8, types.int16, types.int32)
"""Whole numbers that a kernel takes as 64 bits wide when another one passes them."""


class KernelEntries:
    """What numba asks of a kernel's dispatcher, where it depends on who calls.

    Parameters
    ----------
    kernel
        Numba's dispatcher of it, which this changes.
    with_entry
        Makes another dispatcher of the same function, whose versions all have an entry.
    """

    def __init__(self, kernel: Any, with_entry: Callable[[], Any]) -> None:
        self._kernel, self._with_entry = kernel, with_entry
        self._other: Any = None
        self._calling = 0
        self._template = kernel.get_call_template
        self._compile_for_args = kernel._compile_for_args
        self._add_overload = kernel.add_overload
        self._compile = kernel._compiler.compile
        kernel.get_call_template = self.for_kernel
        kernel._compile_for_args = self.for_python
        kernel.add_overload = self.add
        kernel._compiler.compile = self.compile
        kernel.entries = self

    def for_kernel(self, given: Any, named: Any) -> Any:
        """The version that another kernel calls: one for all whole numbers that are passed by value.

        Numba compiles one for each constant among the arguments, and one for each width of an integer.
        """
        with self._called_by_kernel():
            return self._template(
                [_plain(one) for one in given], {k: _plain(one) for k, one in named.items()}
            )

    def compile_for_kernels(self, given: Any) -> None:
        """Have the version for these types, for other kernels; with an entry only if it is there already."""
        with self._called_by_kernel():
            self._kernel.compile(given)

    def for_python(self, *given: Any) -> Any:
        """Entry of the version for these arguments."""
        entry = self._compile_for_args(*given)
        with global_compiler_lock:
            found = next(one for one in self._kernel.overloads.values() if one.entry_point is entry)
            if _is_entered(found):
                return entry
            if self._other is None:
                self._other = self._with_entry()
            with compiling(self._kernel.targetctx.codegen()):
                entry = self._other.compile(tuple(found.signature.args))
            self._kernel._insert([one._code for one in found.signature.args], entry, False)
        return entry

    def add(self, version: Any) -> None:
        """Keep a version that was compiled or loaded; Python is to find it if it has an entry."""
        describe(version, self._kernel.py_func)
        if _is_entered(version):
            self._add_overload(version)
        else:
            self._kernel.overloads[tuple(version.signature.args)] = version

    def compile(self, given: Any, returned: Any) -> Any:
        """Compile a version, for whoever calls."""
        self._kernel._compiler.targetoptions["no_cpython_wrapper"] = self._calling > 0
        try:
            with compiling(self._kernel.targetctx.codegen()):
                return self._compile(given, returned)
        except BaseException:
            if isinstance(self._kernel._cache, KernelCache):
                self._kernel._cache.give_up(given)
            raise

    @contextmanager
    def _called_by_kernel(self) -> Iterator[None]:
        # Numba holds its lock while a kernel is compiled, so that no other thread comes between.
        self._calling += 1
        try:
            yield
        finally:
            self._calling -= 1


def _is_entered(version: Any) -> bool:
    return bool(version.library.get_pointer_to_function(version.fndesc.llvm_cpython_wrapper_name))


def _plain(given: Any) -> Any:
    """Type of an argument without its value; a signed integer as wide as Python's."""
    plain: Any = types.unliteral(given)  # type: ignore[no-untyped-call]
    return types.int64 if plain in NARROW else plain
