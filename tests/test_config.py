"""Settings: read strictly, printed so that they explain themselves and read back the same."""

from __future__ import annotations

import json
import math
import random
import tomllib
import types
from typing import Annotated, Any, Union, get_args, get_origin

import pytest
import tomlkit
from command_line import ebamcheck
from pydantic import BaseModel

from ebamcheck.accuracy.measurement import Case, Tolerance
from ebamcheck.errors import SettingsError
from ebamcheck.plugins import registry
from ebamcheck.plugins.registry import plugin
from ebamcheck.settings.base import Between, Section, explanations
from ebamcheck.settings.checking import as_toml, values_as_toml
from ebamcheck.settings.config import Config, load_config, validated
from ebamcheck.settings.files import merge, merged, write_new
from ebamcheck.settings.process import KeepOut


def written(tmp_path, text, name="ebamcheck.toml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def all_keys():
    return [
        (section, key)
        for section, info in Config.model_fields.items()
        for key in info.annotation.model_fields
    ]


def test_without_a_file_the_defaults_hold():
    assert load_config() == Config()
    assert Config().layer_height_mm == pytest.approx(1.6755, abs=1e-4)  # 2/3 w h v = pi/4 d^2 w


def test_printed_settings_read_back_the_same(tmp_path):
    changed = Config().changed(
        part={"units": "in", "direction": (0, 1, 0)},
        layers={"heights_mm": (1.0, 2.5)},
        slicing={"backends": ("planecut",), "settings": {"stencil": {"pixel_mm": 0.1, "mode": "literal"}}},
        machine={"beam_on": ('M60 ; "quoted" \\ and\ttabbed',), "decimals": 4},
        scan={"hexagon_side_mm": 12.5},
    )
    for config in (Config(), changed):
        assert load_config(written(tmp_path, as_toml(config))) == config


def test_printed_settings_name_every_key():
    text = as_toml(Config())
    lines = text.splitlines()
    values = tomllib.loads(text)
    for section, key in all_keys():
        told = key in values[section] or f"# {key} =" in lines or f"# [{section}.{key}.NAME]" in lines
        assert told, f"{section}.{key} is not printed"
    for section, info in Config.model_fields.items():
        told = explanations(info.annotation)
        assert sorted(told) == sorted(info.annotation.model_fields)
        for key, said in told.items():
            first_words = " ".join(said.split()[:5])
            assert first_words in text, f"{section}.{key} is not explained"


def test_the_schema_describes_the_defaults():
    schema = Config.model_json_schema()
    defaults = json.loads(Config().model_dump_json())
    assert set(schema["properties"]) == set(defaults)
    for section, key in all_keys():
        described = schema["$defs"][type(getattr(Config(), section)).__name__]
        assert key in described["properties"]
        assert described["additionalProperties"] is False
    assert Config.model_validate(defaults) == Config()


def test_settings_stand_in_pyproject_too(tmp_path):
    text = "[project]\nname = 'x'\n[tool.ebamcheck.process]\nbead_width_mm = 5.0\n"
    assert load_config(written(tmp_path, text, "pyproject.toml")).process.bead_width_mm == 5.0
    assert load_config(written(tmp_path, "[project]\nname = 'x'\n", "pyproject.toml")) == Config()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "layers.layer_hight_mm = 1",
            r"layers\.layer_hight_mm: unknown key \(did you mean 'layer_height_mm'\?\)",
        ),
        ("layer = 1", r"layer: unknown key \(did you mean 'layers'\?\)"),
        ("layers = 3", r"layers: .*given 3"),
        ("layers.layer_height_mm = 'high'", r"layers\.layer_height_mm: .*given 'high'"),
        ("layers.layer_height_mm = 0", r"layers\.layer_height_mm: .*from 0\.005 to 100 \(given 0\)"),
        ("layers.layer_height_mm = nan", r"layers\.layer_height_mm: .*finite.*given nan"),
        ("layers.heights_mm = [1, inf]", r"layers\.heights_mm\.1: .*finite.*given inf"),
        ("part.units = 'furlong'", r"part\.units: .*given 'furlong'"),
        ("process.current_ma = 900", r"process: .*current_ma 900\.0 is over current_max_ma 250\.0"),
        ("machine.program_name = 'con'", r"machine\.program_name: .*an NC name"),
        ("machine.travel_min_mm = [0, 0, 2000]", r"machine: .*travel_min_mm must be under"),
        ("machine.poly_licensed = false", r"machine: .*'poly' needs machine\.poly_licensed"),
        ("slicing.settings.planecut = 4", r"slicing\.settings\.planecut: .*given 4"),
        ("x = ", "is not TOML"),
    ],
)
def test_what_makes_no_sense_is_refused_by_key_and_value(tmp_path, text, message):
    with pytest.raises(SettingsError, match=message) as told:
        load_config(written(tmp_path, text))
    assert "ebamcheck.toml" in str(told.value)
    assert "\n" not in str(told.value)


def test_files_that_are_no_text_are_refused(tmp_path):
    with pytest.raises(SettingsError, match=r"nosuch\.toml: cannot be read: No such file"):
        load_config(tmp_path / "nosuch.toml")
    with pytest.raises(SettingsError, match="is a folder, not a file"):
        load_config(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b"material.name = 'Tit\xe4n'")
    with pytest.raises(SettingsError, match="is not UTF-8"):
        load_config(tmp_path / "latin.toml")


def test_changed_settings_are_checked_anew():
    with pytest.raises(SettingsError, match=r"curves\.corner_angle_deg"):
        Config().changed(curves={"corner_angle_deg": 200.0})


def test_an_allowance_for_machining_moves_the_contour_beads_outward() -> None:
    config = Config().changed(process={"machining_allowance_mm": 1.25})
    assert config.contour_offset_mm == pytest.approx(0.5 * config.process.bead_width_mm - 1.25)
    with pytest.raises(SettingsError, match="machining_allowance_mm 4 is over the inset"):
        Config().changed(process={"machining_allowance_mm": 4.0})


@pytest.mark.parametrize(
    ("given", "meant"), [("Inconel718", "Inconel 718"), ("316 L", "316L"), ("tantal", "tantalum")]
)
def test_an_unknown_material_is_told_the_nearest_known_one(given, meant):
    with pytest.raises(SettingsError, match=f"unknown material '{given}' .did you mean '{meant}'"):
        Config().changed(material={"name": given})


def test_an_unknown_plugin_is_told_the_nearest_known_one():
    with pytest.raises(SettingsError, match=r"'fanuk' in ebamcheck.controls .did you mean 'fanuc'"):
        plugin("ebamcheck.controls", "fanuk")


# -- Settings that programs read: the same values as with their explanations, in a tenth of the time --


def test_values_are_those_of_the_text_that_explains_itself():
    changed = Config().changed(
        process={
            "keep_out": [{"outline_mm": [[0, 0], [20, 0], [20, 10]], "z_mm": [0, 50]}],
            "interpass_limit_k": 700.0,
        },
        machine={"set_focus": ["H5={defocus} ; focus"], "program_name": "OTHER"},
        preheat={"when": "plate", "defocus": 20.0},
        layers={"heights_mm": [0.5, 1.5, 3.0]},
        opcua={"nodes": {"height": "ns=2;s=/Plc/DB200.DBD4:REAL"}},
    )
    for config in (Config(), changed, Config()):
        plain, told = values_as_toml(config), as_toml(config)
        assert validated(tomllib.loads(plain), "plain") == config == validated(tomllib.loads(told), "told")
        assert tomllib.loads(plain) == tomllib.loads(told)
        assert plain.count("#") - plain.count(" # ") < 40 < told.count("#")
        assert len(plain) < 0.5 * len(told)


# -- Every number of the settings has a range that makes sense, and says so where a value is outside of it --


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


# -- Settings files keep what was set in them, whatever is added -----------------------------------


KEYS = [
    (name, key)
    for name, section in tomllib.loads(as_toml(Config())).items()
    for key in type(getattr(Config(), name)).model_fields
    if key in section
]

OURS = """# mine
[process] # of machine 7
bead_width_mm = 5.0  # measured

[slicing.settings.planecut]
overlaps = "keep"
"""


def test_a_file_that_is_there_is_not_written_over(tmp_path):
    path = tmp_path / "ebamcheck.toml"
    write_new(path, Config())
    assert load_config(path) == Config()
    path.write_text(OURS)
    done = ebamcheck("config", "-o", path, cwd=tmp_path)
    assert (done.returncode, path.read_text()) == (2, OURS)
    assert "--merge" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("seed", range(6))
def test_keys_that_are_taken_out_come_back_and_no_other_line_changes(tmp_path, seed):
    path = tmp_path / ("pyproject.toml" if seed % 2 else "ebamcheck.toml")
    gone = random.Random(seed).sample(KEYS, [0, 1, 5, 20, 80, len(KEYS)][seed])
    document = tomlkit.parse(as_toml(Config().changed(process={"bead_width_mm": 5.0}, scan={"seed": 7})))
    for name, key in gone:
        del document[name][key]
    if seed % 2:
        outer = tomlkit.document()
        outer["project"] = {"name": "x"}
        outer["tool"] = {"ebamcheck": document}
        document = outer
    path.write_text(tomlkit.dumps(document))
    before, lines = load_config(path), path.read_text().splitlines()
    made = merge(path)
    assert {text.partition(" = ")[0] for text in made.added} == {f"{name}.{key}" for name, key in gone}
    assert load_config(path) == before
    left = iter(path.read_text().splitlines())
    assert all(line in left for line in lines if line.strip()), "what was there stands in its order"
    assert (merge(path).added, made.unknown) == ([], [])


def test_new_keys_bring_their_explanations_and_comments_stay(tmp_path):
    path = tmp_path / "ebamcheck.toml"
    path.write_text(OURS)
    done = ebamcheck("config", "--merge", path, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    text = path.read_text()
    for line in OURS.splitlines():
        assert line in text
    assert "added process.voltage_kv = 60.0" in done.stdout
    assert "added process.bead_width_mm" not in done.stdout
    assert "# Accelerating voltage.\nvoltage_kv = 60.0\n" in text
    explained = {line for line in as_toml(Config()).splitlines() if line.startswith("# ")}
    left = {line for line in explained if line not in text}
    # The file's own head, and the words of what it has set.
    heads = [
        type(getattr(Config(), name)).__doc__.strip().splitlines()[0]
        for name in ("process", "slicing", "machines")
    ]
    assert left - {f"# {head}" for head in heads} == {
        "# Settings of ebamcheck. Every key may be left out; these are the values in force.",
        "# Width of one bead.",
        "# Settings of each backend, by its name.",
        "# [slicing.settings.NAME]",
    }
    assert load_config(path).slicing.settings == {"planecut": {"overlaps": "keep"}}


def test_unknown_keys_are_told_and_kept(tmp_path):
    path = tmp_path / "ebamcheck.toml"
    path.write_text("[process]\nbead_widht_mm = 5.0\n[bead]\nwidth = 1\n")
    done = ebamcheck("config", "--merge", path, cwd=tmp_path)
    assert done.returncode == 2
    told = done.stderr.splitlines()
    assert len(told) == 2
    assert "process.bead_widht_mm: unknown key (did you mean 'bead_width_mm'?)" in told[0]
    assert "bead: unknown key" in told[1]
    assert tomllib.loads(path.read_text())["process"]["bead_widht_mm"] == 5.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[process]\nbead_width_mm = -1\n", "bead_width_mm"),
        ("a = [\n", "is not TOML"),
        (b"\xff", "UTF-8"),
        (None, "-o"),
    ],
)
def test_a_file_that_cannot_be_merged_stays_as_it_is(tmp_path, text, message):
    path = tmp_path / "ebamcheck.toml"
    data = text.encode() if isinstance(text, str) else text
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(SettingsError, match=message):
        merge(path)
    assert (path.read_bytes() if path.exists() else None) == data


def test_dotted_keys_are_added_to_as_well(tmp_path):
    text = 'slicing.backends = ["planecut"]  # ours\n[machines.a]\nprimary = "planecut"\n'
    made = merged(text, tmp_path / "ebamcheck.toml")
    assert 'slicing.backends = ["planecut"]  # ours\n' in made.text
    assert tomllib.loads(made.text)["slicing"]["primary"] == ""
    assert tomllib.loads(made.text)["machines"] == {"a": {"primary": "planecut"}}
