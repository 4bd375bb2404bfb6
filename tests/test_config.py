"""Settings: read strictly, printed so that they explain themselves and read back the same."""

from __future__ import annotations

import json
import math
import random
import re
import tomllib
import types
from dataclasses import fields
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np
import pytest
import tomlkit
from command_line import ebamcheck

from ebamcheck.accuracy.measurement import Case, Tolerance, read_tolerances
from ebamcheck.commands.options import assignments
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.live.height_map import read_map
from ebamcheck.mesh.part_source import read_plate
from ebamcheck.nc.templates import ProcessValues
from ebamcheck.plugins import registry
from ebamcheck.plugins.registry import plugin
from ebamcheck.settings.base import Between, explanations
from ebamcheck.settings.checking import EXAMPLES, PLACEHOLDERS, TEMPLATES, as_toml, values_as_toml
from ebamcheck.settings.config import Config, load_config, validated
from ebamcheck.settings.files import merge, merged, write_new
from ebamcheck.settings.process import KeepOut


def written(tmp_path, text, name="ebamcheck.toml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def all_keys():
    return [(section, key) for section, info in Config.model_fields.items() for key in info.annotation.model_fields]


def test_without_a_file_the_defaults_hold():
    assert load_config() == Config()
    assert Config().layer_height_mm == pytest.approx(1.6755, abs=1e-4)  # 2/3 w h v = pi/4 d^2 w
    config = Config().changed(process={"machining_allowance_mm": 1.25})
    assert config.contour_offset_mm == pytest.approx(0.5 * config.process.bead_width_mm - 1.25)


def test_printed_settings_read_back_the_same(tmp_path):
    changed = Config().changed(
        part={"units": "in", "direction": (0, 1, 0)},
        layers={"heights_mm": (1.0, 2.5)},
        slicing={"backends": ("planecut",), "settings": {"stencil": {"pixel_mm": 0.1, "mode": "literal"}}},
        machine={"beam_on": ('M60 ; "quoted" \\ and\ttabbed',), "decimals": 4, "program_name": "OTHER"},
        scan={"hexagon_side_mm": 12.5},
        process={"keep_out": [{"outline_mm": [[0, 0], [20, 0], [20, 10]], "z_mm": [0, 50]}]},
        opcua={"nodes": {"height": "ns=2;s=/Plc/DB200.DBD4:REAL"}},
    )
    for config in (Config(), changed, Config()):
        plain, explained = values_as_toml(config), as_toml(config)
        assert load_config(written(tmp_path, explained)) == config == validated(tomllib.loads(plain), "plain")
        assert tomllib.loads(plain) == tomllib.loads(explained)
        # Programs read the values alone, in a tenth of the time.
        assert len(plain) < 0.5 * len(explained)


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
    height = schema["$defs"]["LayerSettings"]["properties"]["layer_height_mm"]
    assert {"minimum": 0.005, "maximum": 100.0}.items() <= height["anyOf"][0].items()


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
        ("part.direction = [0, 0, 1e300]", r"part\.direction"),
        ("part.place_at_mm = [0, nan]", r"part\.place_at_mm"),
        ("kinematics.axis_speed_mm_s = [true, 1, 1]", r"kinematics\.axis_speed_mm_s"),
        ("process.power_schedule = [[0, 1e300]]", r"process\.power_schedule"),
        (
            "machine.beam_on = 'M60'",
            r"""takes a list of blocks, such as \["M60 ; beam on"\] \(given 'M60'\)""",
        ),
        (
            "process.keep_out = [{outline_mm = 5}]",
            r"keep_out 1\.outline_mm: it takes a list, each a list of 2 numbers",
        ),
        ("scan.partition = 'z'", 'it takes one of "hexagons", "squares", "stripes", "whole"'),
        ("process.machining_allowance_mm = 4", "machining_allowance_mm 4 is over the inset"),
        ("material.name = 'Inconel718'", r"unknown material 'Inconel718' \(did you mean 'Inconel 718'"),
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


def test_an_unknown_plugin_is_told_the_nearest_known_one():
    with pytest.raises(SettingsError, match=r"'fanuk' in ebamcheck.controls .did you mean 'fanuc'"):
        plugin("ebamcheck.controls", "fanuk")


# -- Every number of the settings has a range that makes sense, and says so where a value is outside of it --


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


SLICERS = {name: registry.slicer(name).Settings for name in (*registry.house_slicers(), *registry.witnesses())}
SECTIONS = {name: field.annotation for name, field in Config.model_fields.items() if name != "machines"}
OTHERS = {"process.keep_out": KeepOut, "matrix": Case, "tolerances": Tolerance}
NUMBERS = {
    (section, key): (str(field.annotation), bounds)
    for section, kind in {**SLICERS, **SECTIONS, **OTHERS}.items()
    for key, field in kind.model_fields.items()
    if (bounds := bounds_in(field.annotation, tuple(field.metadata)))
}
# Fields that hold one number, by section and key
PLAIN = [
    (*name, bounds[0])
    for name, (kind, bounds) in NUMBERS.items()
    if name[0] in SECTIONS and len(bounds) == 1 and "tuple" not in kind and "dict" not in kind
]


def test_every_number_has_a_finite_range():
    assert len(NUMBERS) > 100
    assert len(PLAIN) > 80
    assert [name for name, (_, bounds) in NUMBERS.items() if None in bounds] == []
    for name, (_, bounds) in NUMBERS.items():
        assert all(math.isfinite(b.least) and b.least < b.greatest <= 1e12 for b in bounds), name


@pytest.mark.parametrize(("section", "key", "bounds"), PLAIN, ids=str)
def test_what_is_outside_is_refused_with_the_range(section, key, bounds):
    beyond = [bounds.least - max(1.0, abs(bounds.least)), bounds.greatest * 2 + 1, 1e300, -1e300]
    for value in (*beyond, True, False, math.nan, math.inf, "1"):
        with pytest.raises(SettingsError) as told:
            validated({section: {key: value}}, "here")
        message = str(told.value)
        assert f"here: {section}.{key}: " in message
        assert f"from {bounds.least:.10g} to {bounds.greatest:.10g}" in message, (value, message)
        assert "\n" not in message


def test_units_by_their_usual_names():
    for name in ("in", "inch", "inches", "Inch", "mm", "cm", "m", "um", "feet", "ft", "µm"):
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


@pytest.mark.parametrize("seed", range(2, 6))
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


def test_new_keys_bring_their_explanations_comments_stay_and_unknown_keys_are_told(tmp_path):
    path = tmp_path / "ebamcheck.toml"
    path.write_text(OURS)
    done = ebamcheck("config", "--merge", path, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    text = path.read_text()
    assert all(line in text for line in OURS.splitlines())
    assert "added process.voltage_kv = 60.0" in done.stdout
    assert "added process.bead_width_mm" not in done.stdout
    assert "# Accelerating voltage.\nvoltage_kv = 60.0\n" in text
    assert load_config(path).slicing.settings == {"planecut": {"overlaps": "keep"}}
    path.write_text("[process]\nbead_widht_mm = 5.0\n[bead]\nwidth = 1\n")
    done = ebamcheck("config", "--merge", path, cwd=tmp_path)
    assert done.returncode == 2
    of_process, of_bead = done.stderr.splitlines()
    assert "process.bead_widht_mm: unknown key (did you mean 'bead_width_mm'?)" in of_process
    assert "bead: unknown key" in of_bead
    assert tomllib.loads(path.read_text())["process"]["bead_widht_mm"] == 5.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[process]\nbead_width_mm = -1\n", "bead_width_mm"),
        ("a = [\n", "is not TOML"),
        ("process = { bead_width_mm = 5.0 }\n", r"write its sections as \[NAME\]"),
        (
            '[slicing.settings.planecut]\noverlaps = "keep"\n[slicing]\nprimary = ""\n',
            "write its sections as",
        ),
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


# -- what a user is told ----------------------------------------------------------------------------


OF_THE_LIBRARY = re.compile(
    r"Input should|valid (string|tuple|number|boolean|integer|dictionary)|tuple|pydantic|Undefined|dictionary|NoneType|type="
)


@pytest.mark.parametrize(("section", "key"), [pair for pair in all_keys() if pair[0] != "machines"])
def test_a_value_of_the_wrong_type_is_told_in_plain_words(section, key):
    # A date is no value of any setting.
    with pytest.raises(SettingsError) as told:
        validated(tomllib.loads(f"[{section}]\n{key} = 1979-05-27"), "f.toml")
    message = str(told.value)
    assert message.startswith(f"f.toml: {section}.{key}: it takes ")
    assert not OF_THE_LIBRARY.search(message), message
    assert "\n" not in message


def test_examples_and_placeholders_stand_in_the_settings_and_are_accepted_as_they_stand():
    text = as_toml(Config())
    assert f"# Example: keep_out = {EXAMPLES['process.keep_out']}" in text
    assert all(f"#   {{{name}}}  {meaning}" in text for name, meaning in PLACEHOLDERS.items())
    for section, key in (name.split(".") for name in EXAMPLES if name.count(".") == 1):
        assert validated(tomllib.loads(f"[{section}]\n{key} = {EXAMPLES[f'{section}.{key}']}"), "example")
    # The increments are no value: they say how the others are printed.
    assert set(PLACEHOLDERS) == {field.name for field in fields(ProcessValues)} - {"increments"}
    assert {used for text in TEMPLATES.values() for used in re.findall(r"{(\w+)}", text)} <= set(PLACEHOLDERS)


FORM = re.compile(r"^[^:]+: [\w. ]+: .+; (known keys: .+|`ebamcheck config` lists every key)$")


def from_a_frame(at):
    np.save(at / "m.npy", np.ones((3, 3)))
    read_map(at / "m.npy", Config().height_map)


@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("f.toml", "[process]\nbead_width_mm = 'wide'", lambda at: load_config(at / "f.toml")),
        ("plate.toml", "clearance_mm = 'wide'", lambda at: read_plate(at / "plate.toml")),
        ("t.toml", "[metrics.area_mm2]\nabsolute = 'wide'", lambda at: read_tolerances(at / "t.toml")),
        ("m.npy.frame.toml", "unit_mm = 'wide'", from_a_frame),
        ("none", "", lambda _: registry.slicer_settings("stencil", assignments(["pixel_mm=wide"]))),
        ("none", "", lambda _: Config().changed(curves={"tolerance_mm": "wide"})),
    ],
)
def test_whatever_a_value_comes_from_it_is_refused_in_one_form(name, text, read, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises((SettingsError, InputError)) as told:
        read(tmp_path)
    message = str(told.value)
    assert FORM.match(message.removeprefix(str(tmp_path))), message
    assert "it takes a number" in message
    assert "(given 'wide')" in message
