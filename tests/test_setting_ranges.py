"""Every number of the settings has a range that makes sense, and says so where a value is outside of it."""

from __future__ import annotations

import math
import types
from typing import Annotated, Any, Union, get_args, get_origin

import pytest
from pydantic import BaseModel

from ebamcheck.accuracy.matrix import Case, Tolerance
from ebamcheck.errors import SettingsError
from ebamcheck.plugins import registry
from ebamcheck.settings.base import Between, Section
from ebamcheck.settings.config import Config, validated
from ebamcheck.settings.process import KeepOut

SECTIONS: dict[str, type[Section]] = {
    name: kind
    for name, field in Config.model_fields.items()
    if isinstance(kind := field.annotation, type) and issubclass(kind, Section)
}


def bounds_in(kind: Any, metadata: tuple[Any, ...] = ()) -> list[Between | None]:
    """Range of every number of a type, None where one has none."""
    if get_origin(kind) is Annotated:
        inner, *more = get_args(kind)
        return bounds_in(inner, tuple(more))
    if kind in (int, float):
        return [next((m for m in metadata if isinstance(m, Between)), None)]
    if get_origin(kind) in (tuple, list, dict, Union, types.UnionType):
        return [found for inner in get_args(kind) for found in bounds_in(inner, metadata)]
    return []


def number_fields() -> dict[str, list[Between | None]]:
    slicers = {
        name: registry.slicer(name).Settings for name in (*registry.house_slicers(), *registry.witnesses())
    }
    kinds: dict[str, type[BaseModel]] = {
        **slicers,
        **SECTIONS,
        "process.keep_out": KeepOut,
        "matrix": Case,
        "tolerances": Tolerance,
    }
    found = {}
    for section, kind in kinds.items():
        for name, field in kind.model_fields.items():
            bounds = bounds_in(field.annotation, tuple(field.metadata))
            if bounds:
                found[f"{section}.{name}"] = bounds
    return found


FIELDS = number_fields()


def test_the_walk_sees_the_numbers_of_all_kinds():
    assert len(FIELDS) > 100
    for name in (
        "layers.layer_height_mm", "scan.seed", "process.power_schedule", "process.layer_over_bead", "machine.decimals",
        "material.conductivity_by_temperature", "process.keep_out.outline_mm", "kinematics.axis_jerk_mm_s3",
        "part.place_at_mm", "stencil.pixel_mm", "embree.rays_per_call", "cura.time_limit_s", "process.travel_sectors_deg", "work.most_layers", "process.keep_out.z_mm",
    ):  # fmt: skip
        assert name in FIELDS


def test_a_number_without_a_range_is_seen():
    class Loose(Section):
        free: float | None = None
        half: tuple[Annotated[float, Between(0.0, 1.0)], float] = (0.0, 0.0)

    assert bounds_in(Loose.model_fields["free"].annotation) == [None]
    assert bounds_in(Loose.model_fields["half"].annotation) == [Between(0.0, 1.0), None]


@pytest.mark.parametrize("name", FIELDS)
def test_every_number_has_a_finite_range(name):
    for bounds in FIELDS[name]:
        assert bounds is not None, f"{name} has a number without a range"
        assert math.isfinite(bounds.least)
        assert math.isfinite(bounds.greatest)
        assert bounds.least < bounds.greatest <= 1e12


def plain_numbers() -> list[tuple[str, str, Between]]:
    """Fields that hold one number, by section and key."""
    found = []
    for section, kind in SECTIONS.items():
        for key, field in kind.model_fields.items():
            kinds = {field.annotation, *get_args(field.annotation)}
            numbers = bounds_in(field.annotation, tuple(field.metadata))
            whole = any(k in (int, float) or get_origin(k) is Annotated for k in kinds)
            tuples = any("tuple" in str(k) for k in kinds)
            if len(numbers) == 1 and whole and not tuples and numbers[0] is not None:
                found.append((section, key, numbers[0]))
    return found


@pytest.mark.parametrize(("section", "key", "bounds"), plain_numbers(), ids=lambda value: str(value))
def test_what_is_outside_is_refused_with_the_range(section, key, bounds):
    beyond = [bounds.least - max(1.0, abs(bounds.least)), bounds.greatest * 2 + 1, 1e300, -1e300]
    for value in (*beyond, True, False, math.nan, math.inf, "1"):
        with pytest.raises(SettingsError) as told:
            validated({section: {key: value}}, "here")
        message = str(told.value)
        assert f"here: {section}.{key}: " in message
        assert f"from {bounds.least:.10g} to {bounds.greatest:.10g}" in message, (value, message)
        assert "\n" not in message


def test_the_plain_numbers_are_most_of_them():
    assert len(plain_numbers()) > 80


def test_the_schema_tells_the_ranges():
    schema = Config.model_json_schema()["$defs"]["LayerSettings"]["properties"]["layer_height_mm"]
    assert {"minimum": 0.005, "maximum": 100.0}.items() <= schema["anyOf"][0].items()


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("layers", "layer_height_mm", 1e-4),
        ("process", "bead_width_mm", 0.01),
        ("scan", "hexagon_side_mm", 0.05),
        ("process", "travel_speed_mm_s", 1e300),
        ("layers", "layer_height_mm", True),
        ("part", "direction", (0.0, 0.0, 1e300)),
        ("part", "place_at_mm", (0.0, math.nan)),
        ("kinematics", "axis_speed_mm_s", (True, 1.0, 1.0)),
        ("process", "power_schedule", ((0.0, 1e300),)),
        ("material", "conductivity_by_temperature", ((293.0, 1e300), (300.0, 1.0))),
    ],
)
def test_settings_that_ran_until_memory_or_patience_ended(section, key, value):
    with pytest.raises(SettingsError, match=rf"settings: {section}\.{key}"):
        Config().changed(**{section: {key: value}})


@pytest.mark.parametrize("name", ["in", "inch", "inches", "Inch", "mm", "cm", "m", "um", "feet", "ft", "µm"])
def test_units_by_their_usual_names(name):
    assert Config().changed(part={"units": name}).part.units in ("in", "mm", "cm", "m", "um", "ft")
