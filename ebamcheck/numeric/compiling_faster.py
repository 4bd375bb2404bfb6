"""What numba spares itself in a process that does nothing but compile: the same machine code, with less work in Python.

Each of these does what numba's own does. Where a version of numba lacks the name, nothing is put in its place.
"""

from __future__ import annotations

import importlib
from typing import Any


def compile_faster() -> None:
    """Let this process, which only compiles, spare itself what costs most beside the compiling."""
    _say_errors_plainly()
    _list_variables_at_once()
    _compare_flags_at_once()


def _say_errors_plainly() -> None:
    """Colour no message: numba finds the types of an expression by errors, thousands of them that nobody sees."""
    errors: Any = importlib.import_module("numba.core.errors")
    scheme = getattr(errors, "HighlightColorScheme", None)  # there where colorama is installed
    if scheme is not None:
        scheme._markup = lambda _, message, *__, **___: message


def _list_variables_at_once() -> None:
    """List the variables of an instruction without a list for each of its parts."""
    ir: Any = importlib.import_module("numba.core.ir")
    if not hasattr(ir.Inst, "_rec_list_vars"):
        return
    kinds = (ir.Var, ir.Inst, (list, tuple), dict)
    known: dict[type, int] = {}

    def kind_of(given: type) -> int:
        found = [number for number, kind in enumerate(kinds) if issubclass(given, kind)]
        known[given] = found[0] if found else len(kinds)
        return known[given]

    def add_to(found: list[Any], value: Any) -> None:
        kind = known.get(type(value))
        if kind is None:
            kind = kind_of(type(value))
        if kind == 0:
            found.append(value)
        elif kind == 1:
            found += value.list_vars()
        elif kind < len(kinds):
            for part in value if kind == 2 else value.values():
                add_to(found, part)

    def list_variables(_: Any, value: Any) -> list[Any]:
        found: list[Any] = []
        add_to(found, value)
        return found

    ir.Inst._rec_list_vars = list_variables


def _compare_flags_at_once() -> None:
    """Compare the flags of two compilations without looking up each by its name: it is done at every call that is typed."""
    config: Any = importlib.import_module("numba.core.targetconfig").TargetConfig
    if not {"values", "__hash__", "__eq__"} <= vars(config).keys():
        return
    defaults: dict[type, dict[str, Any]] = {}

    def values(flags: Any) -> dict[str, Any]:
        kind = type(flags)
        if kind not in defaults:
            defaults[kind] = {name: option.default for name, option in flags.options.items()}
        return {**defaults[kind], **flags._values}

    def equals(flags: Any, other: Any) -> Any:
        if flags is other:
            return True
        return values(flags) == values(other) if isinstance(other, config) else NotImplemented

    config.values, config.__eq__ = values, equals
    config.__hash__ = lambda flags: hash(
        type(flags)
    )  # Numba's takes the names alone, which are those of the type.
