"""What numba does again and again while it compiles kernels, and need do once or not at all.

None of it changes what a kernel computes: values that are found and thrown away, questions whose answer is known, and
news for which nobody has asked. A version of numba without one of these functions does as it ever did.
"""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable
from functools import cache
from typing import Any

_NOTHING, _VARIABLE, _LISTED, _MAPPING, _INSTRUCTION = range(5)


def spare_compiler() -> None:
    """Have numba compile without what it need not do; a second call changes nothing."""
    for spare in (
        _spare_counts,
        _spare_sizes,
        _spare_news,
        _spare_refreshing,
        _spare_flags,
        _spare_variables,
        _spare_operators,
    ):
        with contextlib.suppress(AttributeError, ImportError):
            spare()


@cache
def _spare_counts() -> None:
    """Take apart a value for its references only where it holds some.

    Whenever a variable ends, numba takes all fields out of its value, of arrays and of named tuples at any depth, to count
    down those that are counted: most instructions of a kernel before LLVM throws them away.
    """
    context: Any = importlib.import_module("numba.core.runtime.context").NRTContext
    lower: Any = importlib.import_module("numba.core.lowering").Lower
    count_up, count_down, end = lower.incref, lower.decref, lower.delvar

    def meminfos(self: Any, builder: Any, kind: Any, value: Any) -> list[tuple[Any, Any]]:
        models = self._context.data_model_manager
        model = models[kind]
        if not _is_counted(model):
            return []
        found = [(kind, model.get_nrt_meminfo(builder, value))] if model.has_nrt_meminfo() else []
        for inner, taken_from in model.traverse(builder):
            if _is_counted(models[inner]):
                found.extend(meminfos(self, builder, inner, taken_from(value)))
        return found

    def incref(self: Any, kind: Any, value: Any) -> None:
        if _is_counted(self.context.data_model_manager[kind]):
            count_up(self, kind, value)

    def decref(self: Any, kind: Any, value: Any) -> None:
        if _is_counted(self.context.data_model_manager[kind]):
            count_down(self, kind, value)

    def delvar(self: Any, name: str) -> None:
        if _is_counted(self.context.data_model_manager[self.typeof(name)]):
            end(self, name)
        elif name not in self._blk_local_varmap:
            self._singly_assigned_vars.discard(name)

    context.get_meminfos = meminfos
    lower.incref, lower.decref, lower.delvar = incref, decref, delvar


def _is_counted(model: Any) -> bool:
    """Whether values of a type hold references, at any depth."""
    try:
        return bool(model.is_counted)
    except AttributeError:
        model.is_counted = model.contains_nrt_meminfo()
        return bool(model.is_counted)


@cache
def _spare_sizes() -> None:
    """Ask LLVM once for the size of a type: it is asked for each variable, by a module written and read for it."""
    context: Any = importlib.import_module("numba.core.base").BaseContext
    size_of = context.get_abi_sizeof
    known: dict[Any, int] = {}

    def get_abi_sizeof(self: Any, kind: Any) -> int:
        key = str(kind), getattr(kind, "elements", None)
        if key not in known:
            known[key] = size_of(self, kind)
        return known[key]

    context.get_abi_sizeof = get_abi_sizeof


@cache
def _spare_news() -> None:
    """Make no event of a kind that nobody listens to, and no colours in errors that are tried and forgotten."""
    event: Any = importlib.import_module("numba.core.event")
    errors: Any = importlib.import_module("numba.core.errors")

    def unless_unheard(tell: Callable[..., None]) -> Callable[..., None]:
        def told(kind: str, *given: Any, **named: Any) -> None:
            if event._registered.get(event._guard_kind(kind)):
                tell(kind, *given, **named)

        return told

    event.start_event, event.end_event = unless_unheard(event.start_event), unless_unheard(event.end_event)
    if hasattr(errors, "HighlightColorScheme"):
        errors.HighlightColorScheme._markup = lambda _self, text, *_colours: text


@cache
def _spare_refreshing() -> None:
    """Look through numba's registries only where something was registered since: it does so for every function."""
    _refresh_if_new(importlib.import_module("numba.core.base").BaseContext)
    _refresh_if_new(importlib.import_module("numba.core.typing.context").BaseContext)


def _refresh_if_new(context: Any) -> None:
    refresh = context.refresh

    def refresh_if_new(self: Any) -> None:
        if getattr(self, "registered", None) != _registered(self):
            refresh(self)
            self.registered = _registered(self)

    context.refresh = refresh_if_new


def _registered(context: Any) -> int:
    """How many declarations the registries hold that a context and its context of types know."""
    held = dict(context._registries)
    held.update(getattr(getattr(context, "typing_context", None), "_registries", {}))
    return sum(len(getattr(one, name)) for one, loader in held.items() for name in loader.registry_items)


@cache
def _spare_flags() -> None:
    """Compare settings of compilations without asking for each of them by its name."""
    config: Any = importlib.import_module("numba.core.targetconfig").TargetConfig
    defaults: dict[type, dict[str, Any]] = {}

    def values(self: Any) -> Any:
        kind = type(self)
        if kind not in defaults:
            defaults[kind] = {name: option.default for name, option in kind.options.items()}
        return defaults[kind] | self._values

    config.values = values


@cache
def _spare_variables() -> None:
    """List the variables of an instruction without a list for each of its parts."""
    ir: Any = importlib.import_module("numba.core.ir")
    known: dict[type, int] = {}

    def sort_of(value: Any) -> int:
        kinds = (ir.Var, _VARIABLE), (ir.Inst, _INSTRUCTION), ((list, tuple), _LISTED), (dict, _MAPPING)
        return next((sort for kind, sort in kinds if isinstance(value, kind)), _NOTHING)

    def collect(value: Any, found: list[Any]) -> None:
        sort = known.get(type(value))
        if sort is None:
            sort = known[type(value)] = sort_of(value)
        if sort == _VARIABLE:
            found.append(value)
        elif sort == _INSTRUCTION:
            found.extend(value.list_vars())
        elif sort != _NOTHING:
            for part in value.values() if sort == _MAPPING else value:
                collect(part, found)

    def listed(_self: Any, value: Any) -> list[Any]:
        found: list[Any] = []
        collect(value, found)
        return found

    ir.Inst._rec_list_vars = listed


@cache
def _spare_operators() -> None:
    """Work out once what an operator gives for numbers and arrays: numba tries all its templates at each place again."""
    types: Any = importlib.import_module("numba.core.types")
    context: Any = importlib.import_module("numba.core.typing.context").BaseContext
    resolve = context.resolve_function_type
    lasting = types.Number, types.Boolean, types.Array, types.SliceType, types.UniTuple
    known: dict[tuple[int, tuple[Any, ...]], tuple[Any, Any]] = {}

    def resolve_function_type(self: Any, function: Any, given: tuple[Any, ...], named: Any) -> Any:
        is_plain = not named and getattr(function, "__module__", "") == "_operator"
        # What stands for the operator is another object once something is declared for it.
        meaning = self._lookup_global(function) if is_plain else None
        if meaning is None or not all(isinstance(one, lasting) for one in given):
            return resolve(self, function, given, named)
        key = id(meaning), given
        if key not in known:
            found = resolve(self, function, given, named)
            if found is None or self._lookup_global(function) is not meaning:
                return found
            known[key] = meaning, found
        return known[key][1]

    context.resolve_function_type = resolve_function_type
