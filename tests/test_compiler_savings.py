"""What numba is spared while it compiles changes neither what it answers nor what kernels do."""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import njit, types
from numba.core import compiler, event, ir
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys
from numba.extending import overload

from ebamcheck.numeric.compiler_savings import spare_compiler
from ebamcheck.numeric.kernel_compiling import ready_to_compile

ready_to_compile()


class Inner(NamedTuple):
    """A named tuple with an array."""

    weight: float
    rows: Any


class Outer(NamedTuple):
    """One within another, and beside it what is not counted."""

    count: int
    inner: Inner
    pair: tuple[Any, float]


@njit
def _made(n: int) -> Any:
    inner = Inner(2.0, np.ones(n))
    made = Outer(n, inner, (np.arange(n), 1.5))
    for _ in range(n):
        made = Outer(made.count + 1, Inner(made.inner.weight, made.inner.rows + made.pair[0]), made.pair)
    kept = [made.inner.rows[:2].copy() for _ in range(n)]
    return made, kept[0]


def test_all_that_kernels_allocate_is_freed_once() -> None:
    _made(1)
    memory: Any = importlib.import_module("numba.core.runtime._nrt_python")
    memory.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    made, kept = _made(5)
    assert made.count == 10
    assert made.inner.rows.tolist() == [1.0, 6.0, 11.0, 16.0, 21.0]
    assert kept.tolist() == [1.0, 6.0]
    del made, kept
    after = rtsys.get_allocation_stats()
    memory.memsys_disable_stats()
    assert after.alloc - before.alloc == after.free - before.free > 0
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free > 0


@pytest.mark.parametrize("kind", [
    types.boolean, types.int32, types.float64, types.Array(types.float64, 2, "C"), types.UniTuple(types.int64, 3),
    types.Tuple((types.float64, types.Array(types.int8, 1, "A"), types.boolean)),
])  # fmt: skip
def test_sizes_are_those_of_llvm(kind: Any) -> None:
    context: Any = cpu_target.target_context
    llvm = context.get_value_type(kind)
    for _ in range(2):
        assert context.get_abi_sizeof(llvm) == llvm.get_abi_size(context.target_data)


def test_what_is_declared_after_a_compilation_is_found() -> None:
    @njit
    def before(x: float) -> float:
        return x + 1.0

    assert before(1.0) == 2.0

    def later(x: float) -> float:
        raise NotImplementedError

    @overload(later)
    def _later(x: Any) -> Any:
        def thrice(x: Any) -> Any:
            return 3.0 * x

        return thrice

    @njit
    def after(x: float) -> float:
        return later(x)

    assert after(2.0) == 6.0


def test_settings_are_equal_where_their_values_are() -> None:
    one, other = compiler.Flags(), compiler.Flags()
    assert one == other
    other.nrt = True
    assert one != other
    one.nrt = True
    assert one == other
    assert hash(one) == hash(other)
    one.error_model = one.error_model
    assert one == other
    assert one.values() == {name: getattr(one, name) for name in one.options}


def _variables(value: Any) -> list[Any]:
    """Variables of a part of an instruction, the plain way."""
    if isinstance(value, ir.Var):
        return [value]
    if isinstance(value, ir.Inst):
        return list(value.list_vars())
    if isinstance(value, list | tuple | dict):
        parts = value.values() if isinstance(value, dict) else value
        return [found for part in parts for found in _variables(part)]
    return []


def test_variables_of_instructions_come_in_their_order() -> None:
    held: Any = compiler.run_frontend(_made.py_func)
    seen = 0
    for block in held.blocks.values():
        for line in block.body:
            assert line.list_vars() == _variables(vars(line))
            seen += len(line.list_vars())
    assert seen > 0


def test_events_reach_those_who_listen() -> None:
    spare_compiler()
    with event.install_recorder("numba:compile") as heard:
        njit(lambda x: x - 2)(3)
    assert [one.is_start for _, one in heard.buffer] == [True, False]
