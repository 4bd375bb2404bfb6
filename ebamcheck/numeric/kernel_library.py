"""Machine code of kernels as it comes from the cache, and no more than that.

Numba also reads what another kernel would need to be compiled with this one in it, and looks through all names that it
defines: most of the time that it takes to load a kernel. Here that is read when such a kernel is compiled.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.codegen import CodeLibrary, JITCodeLibrary

_llvm: Any = importlib.import_module("llvmlite.binding")


class LoadedLibrary(JITCodeLibrary):
    """Library of a kernel whose machine code was compiled by another process."""

    _bitcode: bytes
    _parsed: Any

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> LoadedLibrary:
        """Load what :meth:`serialize_using_object_code` made: a name, and machine code with what it was made of."""
        name, _, (machine_code, bitcode) = state
        made: Any = cls.__new__(cls)
        # Not that of the class between them, which makes an empty module to be filled.
        CodeLibrary.__init__(made, codegen, name)
        made._linking_libraries = []
        made._bitcode, made._parsed = bitcode, None
        made._finalized = made._disable_inspection = True
        engine = codegen._engine
        engine._ee.add_object_file(_llvm.ObjectFileRef.from_data(machine_code))
        engine.finalize_object()
        return made  # type: ignore[no-any-return]

    def get_pointer_to_function(self, name: str) -> int:
        """Address of a function; that of the kernel itself is there."""
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


@contextmanager
def loading(codegen: Any) -> Iterator[None]:
    """Have numba make its libraries so while the block runs; it holds its lock meanwhile."""
    codegen._library_class = LoadedLibrary
    try:
        yield
    finally:
        del codegen._library_class
