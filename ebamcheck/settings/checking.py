"""Checks of the values that a user gives, and settings in words: what each is and takes, and all of them as a TOML text that explains itself.

A message reads ``WHERE: KEY: what it takes (given VALUE); which keys there are``, whether the value came from a settings
file, a plate, a table of tolerances, the command line or the arguments of a function.
"""

from __future__ import annotations

import json
import math
import re
import textwrap
import tomllib
import types
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

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
    """Check values against a kind of settings, or of all sections of them.

    A message begins with `where` they were given, and names the first key that is unknown or missing, or whose value is wrong. `keys`
    is where a user finds the keys that there are; empty: the message lists them. `error` is raised.
    """
    try:
        return kind.model_validate(values)
    except ValidationError as found:
        first = found.errors()[0]
        place = _place(kind, first["loc"])
        known = keys or f"known keys: {', '.join(place.known) or 'none'}"
        raise error(f"{where}: {_told(place, first)}; {known}") from None


class _Place(NamedTuple):
    """A setting that something is wrong with."""

    section: str  # section that it stands in; empty where the settings have none
    kind: type[BaseModel]  # settings that it is one of
    path: tuple[int | str, ...]
    """Its key, and behind it keys and numbers within it, and types that were tried."""

    @property
    def info(self) -> FieldInfo | None:
        """The setting; None for a key that is none."""
        return self.kind.model_fields.get(str(self.path[0])) if self.path else None

    @property
    def inner(self) -> type[BaseModel] | None:
        """Kind of the tables in a setting that is a list of them."""
        kinds = get_args(self.info.annotation) if self.info is not None else ()
        return next((k for k in kinds if _is_settings(k)), None)

    def is_key(self, name: int | str) -> bool:
        """Whether a part of the path is a key of a table, by itself or in a list."""
        if self.info is not None and get_origin(self.info.annotation) is dict:
            return name == self.path[1]
        return self.inner is not None and name in self.inner.model_fields

    def told(self, unknown: bool = False) -> str:
        """Its name for a user, to whom types that were tried mean nothing; tables of a list are counted from 1."""
        last = len(self.path) - 1
        behind = [
            k
            for n, k in enumerate(self.path[1:], 1)
            if isinstance(k, int) or self.is_key(k) or (unknown and n == last)
        ]
        names = [self.section] if self.section else []
        names += map(str, self.path[:1])
        if self.inner is not None and behind and isinstance(behind[0], int):
            names[-1] += f" {behind[0] + 1}"
            behind = behind[1:]
        return ".".join([*names, *map(str, behind)]) or "settings"

    @property
    def known(self) -> Sequence[str]:
        """Keys of the table that it stands in."""
        return [*(self.inner or self.kind).model_fields]

    def takes(self) -> str:
        """What it takes."""
        if self.info is None and self.path:
            return "a table with " + ", ".join(MachineChoice.model_fields)
        if self.info is None or _is_settings(self.info.annotation):
            return "a table of settings"
        key = next((str(k) for k in self.path[1:] if self.is_key(k)), "")
        if self.inner is not None and key in self.inner.model_fields:
            prefix = f"{self.section}." if self.section else ""
            return wanted(f"{prefix}{self.path[0]}", key, self.inner.model_fields[key])
        return wanted(self.section, str(self.path[0]), self.info)


def _is_settings(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _place(kind: type[BaseModel], loc: tuple[int | str, ...]) -> _Place:
    """Find the settings that a place is in: a section, or a table of a table of settings by name."""
    info = kind.model_fields.get(str(loc[0])) if loc else None
    section: Any = None if info is None else info.annotation
    used = 1
    while get_origin(section) is dict:
        section, used = get_args(section)[1], used + 1
    if _is_settings(section) and len(loc) > used:
        return _Place(".".join(map(str, loc[:used])), section, loc[used:])
    return _Place("", kind, loc)


def _told(place: _Place, first: Mapping[str, Any]) -> str:
    given = first.get("input")
    shown = "" if isinstance(given, dict | BaseModel) else f" (given {given!r})"
    if first["type"] == "extra_forbidden":
        return f"{place.told(unknown=True)}: unknown key{did_you_mean(str(place.path[-1]), place.known)}"
    if first["type"] == "missing" and isinstance(first["loc"][-1], str):
        return f"{place.told()}: is missing: it takes {place.takes()}"
    if isinstance(given, float) and not math.isfinite(given):
        return f"{place.told()}: it takes {place.takes()}, and a finite one{shown}"
    if first["type"] == "value_error":
        return f"{place.told()}: {str(first['msg']).removeprefix('Value error, ')}{shown}"
    return f"{place.told()}: it takes {place.takes()}" + (
        shown or f" (given a {'table' if isinstance(given, dict) else 'value'})"
    )


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

_NUMBERS = "a list of numbers"


def example_of(section: str, key: str, info: FieldInfo) -> str:
    """An example of a setting as TOML; empty for one whose value shows nothing."""
    if (told := EXAMPLES.get(f"{section}.{key}")) is not None:
        return told
    default = None if info.is_required() else info.get_default(call_default_factory=True)
    if default is None or default in ((), "", {}):
        return ""
    return value_text(default)


def wanted(section: str, key: str, info: FieldInfo) -> str:
    """What a setting takes.

    >>> from ebamcheck.settings.machine import MachineSettings
    >>> wanted("machine", "beam_on", MachineSettings.model_fields["beam_on"])
    'a list of blocks, such as ["M60 ; beam on"]'
    >>> wanted("machine", "clearance_mm", MachineSettings.model_fields["clearance_mm"])
    'a number from 0.01 to 10000, such as 5.0'
    """
    kind = _kind(info.annotation, info.metadata)
    if key in TEMPLATES and section == "machine":
        kind = "a list of blocks"
    example = example_of(section, key, info)
    choices = get_origin(info.annotation) is Literal
    return kind + (f", such as {example}" if example and not choices else "")


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
        if one.startswith("a number"):
            one = one.replace("a number", _NUMBERS, 1)
        names = {"a text in quotes": "a list of texts in quotes"}
        least = next((m.min_length for m in _flat(metadata) if isinstance(m, MinLen)), 0)
        told = one if one.startswith(_NUMBERS) else names.get(one, f"a list, each {one}")
        return told + (f" ({least} or more)" if least else "")
    kinds = {_kind(one) for one in inside}
    return f"a list of {len(inside)} numbers" + (
        next(iter(kinds)).removeprefix("a number") if len(kinds) == 1 else ""
    )


def _flat(metadata: Sequence[Any]) -> list[Any]:
    """Metadata of a type, those within a field among them."""
    found: list[Any] = []
    for one in metadata:
        found += _flat(one.metadata) if isinstance(one, FieldInfo) else [one]
    return found


def _range(metadata: Sequence[Any]) -> str:
    words = []
    for one in _flat(metadata):
        if isinstance(one, Between):
            words.append(f"from {one.least:.10g} to {one.greatest:.10g}")
        elif isinstance(one, Gt):
            words.append(f"over {one.gt:g}")
        elif isinstance(one, Ge):
            words.append(f"from {one.ge:g} up")
        elif isinstance(one, Lt):
            words.append(f"under {one.lt:g}")
        elif isinstance(one, Le):
            words.append(f"up to {one.le:g}")
    return (" " + " and ".join(words)).replace(" up and up to", " to") if words else ""


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


def _of_section(name: str, section: Section, explained: bool = True) -> list[str]:
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
