"""What a setting takes, in a user's words, with an example of each kind."""

from __future__ import annotations

import types
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ebamcheck.settings.base import Between

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
"""What is filled in where it stands in braces in a template of the machine."""

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
"""Templates of the machine's blocks, with an example each."""

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
"""Examples of settings whose default does not show what they take; each is TOML."""

_NUMBERS = "a list of numbers"


def example_of(section: str, key: str, info: FieldInfo) -> str:
    """An example of a setting as TOML; empty for one whose value shows nothing."""
    if (told := EXAMPLES.get(f"{section}.{key}")) is not None:
        return told
    default = None if info.is_required() else info.get_default(call_default_factory=True)
    if default is None or default in ((), "", {}):
        return ""
    return _toml(default)


def wanted(section: str, key: str, info: FieldInfo) -> str:
    """What a setting takes.

    Examples
    --------
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
    """Name a type and its range."""
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return _kind(inner, [*metadata, *_flat(more)])
    origin, inside = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        named = [_kind(one, metadata) for one in inside if one is not type(None)]
        return " or ".join(named)
    if origin is Literal:
        return (
            "one of " + ", ".join(_toml(value) for value in inside) if len(inside) > 1 else _toml(inside[0])
        )
    if origin is tuple:
        return _list(inside, metadata)
    if origin is dict or annotation is dict:
        return "a table of settings by name"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"a table with {', '.join(annotation.model_fields)}"
    plain = {bool: "true or false", int: "a whole number", float: "a number", str: "a text in quotes"}
    return plain.get(annotation, "a value") + _range(metadata)


def _list(inside: Sequence[Any], metadata: Sequence[Any]) -> str:
    """Name a list of one kind, or of a fixed number of values."""
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
    """Range of a number in words."""
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


def _toml(value: Any) -> str:
    """A default as TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_toml(one) for one in value) + "]"
    return str(value)
