"""Types of a kernel's arguments as text that a person reads, and back.

Numba's own text does not lead back: it leaves out where a named tuple comes from. What is written here is an
expression, such as ``array(float64, 2, C)``, ``const(int64, 1, A)`` for an array that is read only,
``ebamcheck.heat.medium.Medium(float64, float64)`` for a named tuple, ``default(False)`` for an argument left out and
``literal(0)`` for a constant known at compile time.
"""

from __future__ import annotations

import ast
import importlib
from typing import Any, cast

from numba import types

SCALARS: dict[str, Any] = {
    str(found): found
    for found in (
        types.boolean, types.uint8, types.int8, types.uint16, types.int16, types.uint32, types.int32,
        types.uint64, types.int64, types.float32, types.float64, types.none, types.unicode_type,
    )
}  # fmt: skip


class UnknownType(ValueError):
    """A type that has no text here, or a text that is no type on this installation."""


def text_of(found: Any) -> str:
    """The text of a numba type; :class:`UnknownType` where there is none."""
    if SCALARS.get(str(found)) is found or SCALARS.get(str(found)) == found:
        return str(found)
    if type(found) is types.Array and found.aligned:
        kind = "array" if found.mutable else "const"
        return f"{kind}({text_of(found.dtype)}, {found.ndim}, {found.layout})"
    if isinstance(found, types.Omitted):
        return f"default({found.value!r})"
    if isinstance(found, types.Literal):
        return f"literal({found.literal_value!r})"
    if isinstance(found, types.NamedTuple | types.NamedUniTuple):
        made = found.instance_class
        return f"{made.__module__}.{made.__qualname__}({_listed(found)})"
    if type(found) in (types.Tuple, types.UniTuple):
        return f"tuple({_listed(found)})"
    raise UnknownType(f"{found} has no text")


def types_of(text: str) -> tuple[Any, ...]:
    """The numba types of texts with commas between them."""
    try:
        listed = ast.parse(f"({text},)" if text else "()", mode="eval").body
        return tuple(_made(node) for node in cast(ast.Tuple, listed).elts)
    except (SyntaxError, ValueError, KeyError, AttributeError, ImportError, TypeError) as error:
        raise UnknownType(f"{text}: {error}") from error


def _listed(found: Any) -> str:
    return ", ".join(text_of(part) for part in found.types)


def _made(node: ast.expr) -> Any:
    if isinstance(node, ast.Name):
        return SCALARS[node.id]
    if not isinstance(node, ast.Call):
        raise UnknownType(ast.unparse(node))
    name, given = ast.unparse(node.func), node.args
    if name in ("array", "const"):
        dtype, axes, layout = given
        array: Any = types.Array
        return array(_made(dtype), ast.literal_eval(axes), ast.unparse(layout), readonly=name == "const")
    if name == "default":
        return types.Omitted(ast.literal_eval(given[0]))  # type: ignore[no-untyped-call]
    if name == "literal":
        return types.literal(ast.literal_eval(given[0]))  # type: ignore[no-untyped-call]
    parts = [_made(part) for part in given]
    if name == "tuple":
        return types.Tuple(parts)  # type: ignore[no-untyped-call]
    module, _, made = name.rpartition(".")
    # The same constructor as for a value that is passed: all parts alike are another type than parts that differ.
    return types.BaseTuple.from_types(parts, getattr(importlib.import_module(module), made))  # type: ignore[no-untyped-call]
