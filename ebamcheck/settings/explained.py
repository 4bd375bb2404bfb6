"""What each setting is, from the docstring under it in the source.

Pydantic would read them as every class is made, which each command would wait for; few ever show one.
"""

from __future__ import annotations

import ast
import inspect
import itertools
import sys
import textwrap
from functools import cache
from typing import Any

from pydantic import BaseModel


@cache
def explanations(kind: type[BaseModel]) -> dict[str, str]:
    """What each setting of a section is, by name; those that say nothing are left out."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if issubclass(base, BaseModel) and base is not BaseModel:
            found |= _docstrings(base)
    described = {name: info.description for name, info in kind.model_fields.items() if info.description}
    return {name: text for name, text in (found | described).items() if name in kind.model_fields}


def _docstrings(kind: type[BaseModel]) -> dict[str, str]:
    """Texts that stand under the annotations of one class."""
    made = _classes(kind.__module__).get(kind.__qualname__) or _class_within(kind)
    return {
        line.target.id: inspect.cleandoc(under.value.value)
        for line, under in itertools.pairwise(made.body)
        if isinstance(line, ast.AnnAssign)
        and isinstance(line.target, ast.Name)
        and isinstance(under, ast.Expr)
        and isinstance(under.value, ast.Constant)
        and isinstance(under.value.value, str)
    }


@cache
def _classes(module: str) -> dict[str, ast.ClassDef]:
    """Classes of the top level of a module by name, its source read once for all of them."""
    found = ast.parse(inspect.getsource(sys.modules[module])).body
    return {made.name: made for made in found if isinstance(made, ast.ClassDef)}


def _class_within(kind: type[BaseModel]) -> ast.ClassDef:
    """A class that is defined within something else."""
    made = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(made, ast.ClassDef)
    return made


def explained_schema(kind: type[BaseModel]) -> dict[str, Any]:
    """JSON schema of settings, with what each of them is."""
    schema = kind.model_json_schema()
    known = {one.__name__: one for one in _kinds(kind)}
    for name, part in ((kind.__name__, schema), *schema.get("$defs", {}).items()):
        for key, text in explanations(known[name]).items():
            if key in part.get("properties", {}):
                part["properties"][key]["description"] = text
    return schema


def _kinds(kind: type[BaseModel]) -> list[type[BaseModel]]:
    """All classes of settings whose base is that of a section."""
    root = next(
        base for base in reversed(kind.__mro__) if issubclass(base, BaseModel) and base is not BaseModel
    )
    found, waiting = [root], [root]
    while waiting:
        below = waiting.pop().__subclasses__()
        found += below
        waiting += below
    return found
