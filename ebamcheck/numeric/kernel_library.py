"""Machine code of kernels: what of the kernels that it calls is put into it, and how it comes from the cache.

Numba puts all kernels that a kernel calls, at any depth, into it, and compiles their machine code once more with it: a
third of the time that all kernels took. Here only short ones are, which LLVM may put in place of the call; others are
called where they lie, and a kernel keeps a note of these.

Of a kernel from the cache numba also reads what another kernel would need to be compiled with it, and looks through all
names that it defines: most of the time that it takes to load one. Here that is read when such a kernel is compiled.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from numba.core.codegen import CodeLibrary, JITCodeLibrary

_llvm: Any = importlib.import_module("llvmlite.binding")

SHORT_LINES = 150
"""Lines of LLVM's language up to which a kernel is put into those that call it: several times what LLVM puts in place."""


CLEARING_LEVEL = 1
"""LLVM's level of optimisation for single functions. Numba has 3 here, and once more for the module they are part of."""


class Callee(NamedTuple):
    """A version of a kernel that others call where it lies."""

    module: str
    name: str
    types: tuple[Any, ...]
    symbol: str
    """Its name in machine code, which no other compilation gives."""


class About(NamedTuple):
    """What is kept of a kernel's version beside its machine code."""

    itself: Callee | None
    """None where it is put into those that call it."""
    is_entered: bool
    calls: tuple[Callee, ...]


class KernelLibrary(JITCodeLibrary):
    """Library of a kernel that is compiled here, or of a function of numba's that is compiled into one."""

    about: About | None = None

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)  # type: ignore[no-untyped-call]
        self.calls: dict[Callee, None] = {}

    def add_linking_library(self, library: Any) -> None:
        """Put a library of a function that is called into this one, unless it is to be called where it lies."""
        about = getattr(library, "about", None)
        if about is not None and about.itself is not None:
            self.calls[about.itself] = None
            return
        super().add_linking_library(library)  # type: ignore[no-untyped-call]
        self.calls.update(getattr(library, "calls", {}))

    def _optimize_functions(self, module: Any) -> None:
        """Clear up each function before the module is optimised as a whole, which does the rest of it once."""
        module.data_layout = self._codegen._data_layout
        for function in module.functions:
            if not function.is_declaration:
                passes, builder = self._codegen._function_pass_manager(opt=CLEARING_LEVEL)  # type: ignore[no-untyped-call]
                passes.run(function, builder)

    def serialize_using_object_code(self) -> Any:
        """Name, machine code, what it is compiled with into others, and what is kept beside it."""
        self._ensure_finalized()  # type: ignore[no-untyped-call]
        about = self.about or About(None, True, tuple(self.calls))
        bitcode = self._get_module_for_linking().as_bitcode() if about.itself is None else b""  # type: ignore[no-untyped-call]
        return (self.name, "object", (self._get_compiled_object(), bitcode, about))  # type: ignore[no-untyped-call]


class LoadedLibrary(KernelLibrary):
    """Library of a kernel whose machine code was compiled by another process."""

    _bitcode: bytes
    _parsed: Any

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> LoadedLibrary:
        """Load what :meth:`serialize_using_object_code` made."""
        name, _, (machine_code, bitcode, about) = state
        made: Any = cls.__new__(cls)
        # Not that of the class between them, which makes an empty module to be filled.
        CodeLibrary.__init__(made, codegen, name)
        made._linking_libraries = []
        made._bitcode, made._parsed = bitcode, None
        made.about, made.calls = about, dict.fromkeys(about.calls)
        made._finalized = made._disable_inspection = True
        engine = codegen._engine
        engine._ee.add_object_file(_llvm.ObjectFileRef.from_data(machine_code))
        engine.finalize_object()
        return made  # type: ignore[no-any-return]

    def get_pointer_to_function(self, name: str) -> int:
        """Address of the kernel's entry from Python; 0 where it has none."""
        if self.about is not None and not self.about.is_entered:
            return 0
        return int(self._codegen._engine.get_function_address(name))

    def _get_module_for_linking(self) -> Any:
        """What a kernel that calls this one is compiled with."""
        if self._parsed is None:
            self._parsed = _llvm.parse_bitcode(self._bitcode)
            self._codegen._engine._load_defined_symbols(self._parsed)  # type: ignore[no-untyped-call]
        return self._parsed

    @property
    def _final_module(self) -> Any:
        return self._get_module_for_linking()


def describe(version: Any, function: Callable[..., Any]) -> None:
    """Note of a version that was compiled here what is to be kept beside its machine code."""
    library = version.library
    if not isinstance(library, KernelLibrary) or library.about is not None:
        return
    symbol, entry = version.fndesc.llvm_func_name, version.fndesc.llvm_cpython_wrapper_name
    itself = None
    is_found = function is getattr(kernel_at(function.__module__, function.__qualname__), "py_func", None)
    if is_found and str(library.get_function(symbol)).count("\n") > SHORT_LINES:  # type: ignore[no-untyped-call]
        itself = Callee(function.__module__, function.__qualname__, tuple(version.signature.args), symbol)
    library.about = About(itself, _is_entered(library, entry), tuple(library.calls))


def _is_entered(library: Any, entry: str) -> bool:
    return bool(library.get_pointer_to_function(entry))


def about_data(data: Any) -> About:
    """What is kept beside the machine code, of a version as the cache holds it."""
    return data[0][2][2]  # type: ignore[no-any-return]


def has_callees(about: About) -> bool:
    """Whether all that a version calls where it lies is loaded; it is loaded, or compiled, where it is not yet."""
    for callee in about.calls:
        kernel = kernel_at(callee.module, callee.name)
        if kernel is None:
            return False
        kernel.entries.compile_for_kernels(callee.types)
        found = kernel.overloads.get(callee.types)
        if found is None or found.fndesc.llvm_func_name != callee.symbol:
            return False  # compiled anew since, on its own
    return True


def kernel_at(module: str, name: str) -> Any:
    """The kernel of a module that is loaded."""
    return getattr(sys.modules.get(module), name, None)


@contextmanager
def loading(codegen: Any) -> Iterator[None]:
    """Have numba make its libraries from machine code while the block runs; it holds its lock meanwhile."""
    with _making(codegen, LoadedLibrary):
        yield


@contextmanager
def compiling(codegen: Any) -> Iterator[None]:
    """Have numba make libraries of kernels while the block runs; it holds its lock meanwhile."""
    with _making(codegen, KernelLibrary):
        yield


@contextmanager
def _making(codegen: Any, kind: type[KernelLibrary]) -> Iterator[None]:
    before, codegen._library_class = codegen._library_class, kind
    try:
        yield
    finally:
        codegen._library_class = before
