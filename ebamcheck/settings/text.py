"""All settings as a TOML text that explains itself."""

from __future__ import annotations

import textwrap
from functools import cache
from typing import Any

import tomlkit

from ebamcheck.settings.base import Section
from ebamcheck.settings.config import Config
from ebamcheck.settings.explained import explanations
from ebamcheck.settings.wording import EXAMPLES, PLACEHOLDERS, TEMPLATES

WIDTH = 100


def values_as_toml(config: Config) -> str:
    """Settings as TOML without a word of explanation, which takes a while to find: for a file that programs read."""
    lines = ["# Settings of ebamcheck: `ebamcheck config` explains every key.", ""]
    for name in type(config).model_fields:
        lines += _of_section(name, getattr(config, name), False)
    return "\n".join(lines)


def as_toml(config: Config) -> str:
    """Settings as TOML: every key with its value, its explanation as a comment before it.

    A key that is not set has its automatic meaning explained and stands as a comment.
    """
    lines = ["# Settings of ebamcheck. Every key may be left out; these are the values in force.", ""]
    for name in type(config).model_fields:
        lines += _of_section(name, getattr(config, name))
    return "\n".join(lines)


_written: dict[tuple[int, bool], tuple[Section, list[str]]] = {}
"""Lines of sections that were written last. Sections do not change, and settings that differ in one share the others."""

MOST_WRITTEN = 64


def _of_section(name: str, section: Section, explained: bool = True) -> list[str]:
    """Lines of one section; those of the same object are written once."""
    known = _written.get((id(section), explained))
    if known is not None and known[0] is section:
        return known[1]
    lines = [f"# {_first_line(section)}", f"[{name}]"] if explained else [f"[{name}]"]
    tables: list[str] = []
    said = explanations(type(section)) if explained else {}
    for key in type(section).model_fields:
        value = getattr(section, key)
        lines += _explained(said.get(key, ""))
        lines += told_beside(name, key) if explained else []
        if isinstance(value, dict):
            tables += _tables(f"{name}.{key}", value)
            lines += [f"# [{name}.{key}.NAME]"] if explained and not value else []
        elif value is None:
            lines += [f"# {key} ="] if explained else []
        else:
            lines.append(f"{key} = {_same_text(f'{name}.{key}', value)}")
    if section.model_extra:
        named = {key: table.model_dump(mode="json") for key, table in section.model_extra.items()}
        tables += tomlkit.dumps({name: named}).removeprefix(f"[{name}]\n").splitlines()
    while len(_written) >= MOST_WRITTEN:
        del _written[next(iter(_written))]
    made = [*lines, "", *tables]
    _written[id(section), explained] = section, made
    return made


@cache
def _explained(description: str) -> tuple[str, ...]:
    """Lines of comment with what a key means."""
    return tuple(textwrap.wrap(description, WIDTH, initial_indent="# ", subsequent_indent="# "))


_texts: dict[str, tuple[Any, str]] = {}
"""Value and text of each key as it was written last: a section that differs in one value shares the others."""


def _same_text(key: str, value: Any) -> str:
    """Text of the value of a key; that of the same object is made once."""
    known = _texts.get(key)
    if known is None or known[0] is not value:
        known = _texts[key] = value, value_text(value)
    return known[1]


def told_beside(section: str, key: str) -> list[str]:
    """Comments with the placeholders of the templates, before the first of them, and an example of what needs one."""
    lines = []
    if section == "machine" and key == next(iter(TEMPLATES)):
        lines.append("# Placeholders, filled in where they stand in braces in the blocks of these templates:")
        lines += [f"#   {{{name}}}  {meaning}" for name, meaning in PLACEHOLDERS.items()]
    if example := EXAMPLES.get(f"{section}.{key}"):
        lines.append(f"# Example: {key} = {example}")
    return lines


def _tables(path: str, values: dict[str, Any]) -> list[str]:
    plain = {name: value for name, value in values.items() if not isinstance(value, dict)}
    lines = (
        [f"[{path}]", *(f"{name} = {value_text(value)}" for name, value in plain.items()), ""]
        if plain
        else []
    )
    for name, table in values.items():
        if name in plain:
            continue
        lines += [
            f"[{path}.{name}]",
            *(f"{k} = {value_text(v)}" for k, v in table.items() if v is not None),
            "",
        ]
    return lines


def value_text(value: Any) -> str:
    """Value of a key as TOML."""
    if isinstance(value, tuple):
        return str(tomlkit.array("[" + ", ".join(value_text(v) for v in value) + "]").as_string())
    if isinstance(value, Section):
        table = tomlkit.inline_table()
        table.update(value.model_dump(mode="json"))
        return str(table.as_string())
    return str(tomlkit.item(value).as_string())


def _first_line(section: Section) -> str:
    return (type(section).__doc__ or "").strip().splitlines()[0]
