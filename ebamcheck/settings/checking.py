"""Checks of the values that a user gives, and settings in words: what each is and takes, and all of them as a TOML text that
explains itself."""

from __future__ import annotations

import itertools
import json
import math
import re
import textwrap
import tomllib
import types
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from ebamcheck.atomic_file import regular_file
from ebamcheck.errors import EbamcheckError, SettingsError
from ebamcheck.settings.base import Between, Section, explanations
from ebamcheck.settings.stages import MachineChoice
from ebamcheck.showing.short_text import did_you_mean

if TYPE_CHECKING:
    from ebamcheck.settings.config import Config

_Kind = TypeVar("_Kind", bound=BaseModel)


def read_toml(path: Path, error: type[EbamcheckError] = SettingsError) -> dict[str, Any]:
    """Read a TOML file; raises `error` where it cannot be read or is none."""
    try:
        return tomllib.loads(regular_file(path, error).read_text(encoding="utf-8"))
    except OSError as found:
        raise error(f"{path}: cannot be read: {found.strerror or found}") from None
    except UnicodeDecodeError:
        raise error(f"{path}: is not UTF-8 text, as TOML must be") from None
    except ValueError as found:  # a number of thousands of digits is one, too
        raise error(f"{path}: is not TOML: {found}") from None
    except RecursionError:
        raise error(f"{path}: is not TOML of ours: hundreds of lists within each other") from None


def checked(
    kind: type[_Kind],
    values: Mapping[str, Any],
    where: Path | str,
    keys: str = "",
    error: type[EbamcheckError] = SettingsError,
) -> _Kind:
    """Check values against a kind of settings, or of all sections of them; raises `error`.

    A message begins with `where` they were given, and names the first key that is wrong. `keys` is where a user finds the keys that
    there are; empty: the message lists them."""
    try:
        return kind.model_validate(values)
    except ValidationError as found:
        first = found.errors()[0]
        told, known = _told(kind, first)
        raise error(f"{where}: {told}; {keys or 'known keys: ' + (', '.join(known) or 'none')}") from None


def _is_settings(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _place(kind: type[BaseModel], loc: tuple[int | str, ...], unknown: bool) -> tuple[str, list[str], str]:
    """Name of the setting at a place, for a user, to whom types that were tried mean nothing; the keys of its table; and what it
    takes."""
    info = kind.model_fields.get(str(loc[0])) if loc else None
    table: Any = info and info.annotation
    section, used = "", 1
    while get_origin(table) is dict:
        table, used = get_args(table)[1], used + 1
    if _is_settings(table) and len(loc) > used:
        section, kind, loc = ".".join(map(str, loc[:used])), table, loc[used:]
        info = kind.model_fields.get(str(loc[0]))
    annotation = info and info.annotation
    # Kind of the tables in a setting that is a list of them; these are counted from 1.
    inner = next((one for one in get_args(annotation) if _is_settings(one)), None)
    keys = list(loc[1:2]) if get_origin(annotation) is dict else list(inner.model_fields) if inner else []
    behind: list[Any] = [
        k for n, k in enumerate(loc[1:], 2) if isinstance(k, int) or k in keys or (unknown and n == len(loc))
    ]
    names = [name for name in (section, *map(str, loc[:1])) if name]
    if inner and behind and isinstance(behind[0], int):
        names[-1] += f" {behind.pop(0) + 1}"
    key = next((str(k) for k in loc[1:] if k in keys), "")
    if loc and info is None:
        takes = f"a table with {', '.join(MachineChoice.model_fields)}"
    elif info is None or _is_settings(annotation):
        takes = "a table of settings"
    elif inner and key:
        takes = wanted(".".join(names).partition(" ")[0], key, inner.model_fields[key])
    else:
        takes = wanted(section, str(loc[0]), info)
    return ".".join([*names, *map(str, behind)]) or "settings", list((inner or kind).model_fields), takes


def _told(kind: type[BaseModel], first: Mapping[str, Any]) -> tuple[str, list[str]]:
    """What is wrong with a setting, and the keys that there are beside it."""
    loc, given, unknown = first["loc"], first.get("input"), first["type"] == "extra_forbidden"
    name, known, takes = _place(kind, loc, unknown)
    shown = "" if isinstance(given, dict | BaseModel) else f" (given {given!r})"
    if unknown:
        told = f"unknown key{did_you_mean(str(loc[-1]), known)}"
    elif first["type"] == "missing" and isinstance(loc[-1], str):
        told = f"is missing: it takes {takes}"
    elif isinstance(given, float) and not math.isfinite(given):
        told = f"it takes {takes}, and a finite one{shown}"
    elif first["type"] == "value_error":
        told = f"{str(first['msg']).removeprefix('Value error, ')}{shown}"
    else:
        told = f"it takes {takes}{shown or ' (given a table)'}"
    return f"{name}: {told}", known


# -- settings in words -----------------------------------------------------------------------------

# What is filled in where it stands in braces in a template of the machine
PLACEHOLDERS: Mapping[str, str] = {
    "power_w": "power of the beam, W",
    "voltage_kv": "accelerating voltage, kV",
    "current_ma": "beam current, mA",
    "wire_mm_s": "wire speed, mm/s",
    "wire_retract_mm": "wire drawn back, mm",
    "feed_mm_min": "feed along a bead, mm/min",
    "layer_pause_s": "wait between two layers, s",
    "layer": "number of the layer, from 1",
    "height_mm": "Z of the layer, mm",
    "defocus": "focus of the beam, in the machine's own unit; in set_focus alone",
}
# Templates of the machine's blocks, with an example each
TEMPLATES: Mapping[str, str] = {
    "beam_on": '["M60 ; beam on"]',
    "beam_off": '["M61 ; beam off"]',
    "set_beam": '["H1={voltage_kv}", "H2={current_ma}"]',
    "set_power": '["H2={current_ma}"]',
    "wire_start": '["H3={wire_mm_s}", "M62"]',
    "set_wire": '["H3={wire_mm_s}"]',
    "wire_stop": '["M63"]',
    "wire_retract": '["H4={wire_retract_mm}"]',
    "set_focus": '["H5={defocus} ; focus"]',
    "layer_pause": '["G4 F{layer_pause_s}"]',
    "layer_begin": '["MSG(\\"LAYER {layer} AT {height_mm}\\")"]',
    "layer_end": '["M77"]',
}
# Examples of settings whose default does not show what they take; each is TOML
EXAMPLES: Mapping[str, str] = {
    **{f"machine.{name}": example for name, example in TEMPLATES.items()},
    "machine.beam_codes": '["M60: on", "M61: off", "H2: current_ma"]',
    "machine.wire_codes": '["M62: on", "M63: off", "H3: wire_mm_s"]',
    "machine.aux_codes": '["M77", "H9"]',
    "layers.heights_mm": "[0.5, 1.5, 3.0]",
    "process.keep_out": '[{ name = "clamp", outline_mm = [[0, 0], [20, 0], [20, 10]], z_mm = [0, 50] }]',
    "process.keep_out.outline_mm": "[[0, 0], [20, 0], [20, 10]]",
    "process.travel_sectors_deg": "[[-45, 45], [135, 225]]",
    "process.power_schedule": "[[0, 1], [60, 0.5]]",
    "slicing.backends": '["planecut", "manifold"]',
    "slicing.required": '["planecut"]',
    "slicing.witnesses": '["all"]',
}


def wanted(section: str, key: str, info: FieldInfo) -> str:
    """What a setting takes.

    >>> from ebamcheck.settings.machine import MachineSettings
    >>> wanted("machine", "beam_on", MachineSettings.model_fields["beam_on"])
    'a list of blocks, such as ["M60 ; beam on"]'
    >>> wanted("machine", "clearance_mm", MachineSettings.model_fields["clearance_mm"])
    'a number from 0.01 to 10000, such as 5.0'
    """
    default = None if info.is_required() else info.get_default(call_default_factory=True)
    shown = "" if default is None or default in ((), "", {}) else value_text(default)
    example = EXAMPLES.get(f"{section}.{key}", shown)
    is_template = key in TEMPLATES and section == "machine"
    kind = "a list of blocks" if is_template else _kind(info.annotation, info.metadata)
    return kind + (f", such as {example}" if example and get_origin(info.annotation) is not Literal else "")


def _kind(annotation: Any, metadata: Sequence[Any] = ()) -> str:
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return _kind(inner, [*metadata, *_flat(more)])
    origin, inside = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        named = [_kind(one, metadata) for one in inside if one is not type(None)]
        return " or ".join(named)
    if origin is Literal:
        return ("one of " if len(inside) > 1 else "") + ", ".join(map(value_text, inside))
    if origin is tuple:
        return _list(inside, metadata)
    if origin is dict or annotation is dict:
        return "a table of settings by name"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"a table with {', '.join(annotation.model_fields)}"
    plain = {bool: "true or false", int: "a whole number", float: "a number", str: "a text in quotes"}
    return plain.get(annotation, "a value") + _range(metadata)


def _list(inside: Sequence[Any], metadata: Sequence[Any]) -> str:
    if len(inside) == 2 and inside[1] is Ellipsis:
        one = _kind(inside[0])
        least = next((m.min_length for m in _flat(metadata) if isinstance(m, MinLen)), 0)
        told = "a list of texts in quotes" if one == "a text in quotes" else f"a list, each {one}"
        if one.startswith(("a number", "a list of numbers")):
            told = one.replace("a number", "a list of numbers", 1)
        return told + (f" ({least} or more)" if least else "")
    first, *others = {_kind(one) for one in inside}
    return f"a list of {len(inside)} numbers{'' if others else first.removeprefix('a number')}"


def _flat(metadata: Sequence[Any]) -> list[Any]:
    """Metadata of a type, those within a field among them."""
    found: list[Any] = []
    for one in metadata:
        found += _flat(one.metadata) if isinstance(one, FieldInfo) else [one]
    return found


def _range(metadata: Sequence[Any]) -> str:
    forms: dict[type, str] = {
        Gt: "over {one.gt:g}",
        Ge: "from {one.ge:g} up",
        Lt: "under {one.lt:g}",
        Le: "up to {one.le:g}",
    }
    forms[Between] = "from {one.least:.10g} to {one.greatest:.10g}"
    words = [forms[type(one)].format(one=one) for one in _flat(metadata) if type(one) in forms]
    return (" " + " and ".join(words)).replace(" up and up to", " to") if words else ""


def values_as_toml(config: Config) -> str:
    """Settings as TOML without a word of explanation, which takes a while to find: for a file that programs read."""
    return _as_toml(config, "# Settings of ebamcheck: `ebamcheck config` explains every key.", False)


def as_toml(config: Config) -> str:
    """Settings as TOML: every key with its value, its explanation as a comment before it; one that is not set stands as a
    comment."""
    head = "# Settings of ebamcheck. Every key may be left out; these are the values in force."
    return _as_toml(config, head, True)


def _as_toml(config: Config, head: str, explained: bool) -> str:
    sections = (_of_section(name, getattr(config, name), explained) for name in type(config).model_fields)
    return "\n".join([head, "", *itertools.chain.from_iterable(sections)])


def _of_section(name: str, section: Section, explained: bool) -> list[str]:
    """Lines of one section."""
    kind = type(section)
    lines = [f"# {first_line(kind)}"] if explained else []
    lines.append(f"[{name}]")
    tables: list[str] = []
    for key in kind.model_fields:
        value = getattr(section, key)
        lines += explained_in_comments(name, kind, key) if explained else []
        if isinstance(value, dict):
            tables += _tables(f"{name}.{key}", value)
            lines += [f"# [{name}.{key}.NAME]"] if explained and not value else []
        elif value is None:
            lines += [f"# {key} ="] if explained else []
        else:
            lines.append(f"{key} = {value_text(value)}")
    named = {key: table.model_dump(mode="json") for key, table in (section.model_extra or {}).items()}
    return [*lines, "", *tables, *_tables(name, named)]


def first_line(kind: type[Section]) -> str:
    """What a section is."""
    return (kind.__doc__ or "").strip().splitlines()[0]


def explained_in_comments(section: str, kind: type[Section], key: str) -> list[str]:
    """Comments that explain a setting, with an example of what needs one; the placeholders stand before the first template."""
    said = explanations(kind).get(key, "")
    lines = textwrap.wrap(said, 100, initial_indent="# ", subsequent_indent="# ")
    if section == "machine" and key == next(iter(TEMPLATES)):
        lines.append("# Placeholders, filled in where they stand in braces in the blocks of these templates:")
        lines += [f"#   {{{name}}}  {meaning}" for name, meaning in PLACEHOLDERS.items()]
    if example := EXAMPLES.get(f"{section}.{key}"):
        lines.append(f"# Example: {key} = {example}")
    return lines


def _tables(path: str, values: Mapping[str, Any]) -> list[str]:
    plain = {name: value for name, value in values.items() if not isinstance(value, Mapping)}
    tables = {path: plain} if plain else {}
    tables |= {f"{path}.{_key(name)}": values[name] for name in values if name not in plain}
    lines = []
    for name, table in tables.items():
        rows = [f"{_key(k)} = {value_text(v)}" for k, v in table.items() if v is not None]
        lines += [f"[{name}]", *rows, ""]
    return lines


def value_text(value: Any) -> str:
    """Value of a key as TOML."""
    if isinstance(value, Section):
        value = value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {value_text(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(value_text, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, int | float) else _quoted(str(value))


def _key(name: str) -> str:
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else _quoted(name)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
