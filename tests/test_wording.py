"""What a user is told of settings: every field with a value of the wrong type, every example, every placeholder."""

import re
import tomllib
from dataclasses import fields

import numpy as np
import pytest

from ebamcheck.accuracy.measurement import read_tolerances
from ebamcheck.commands.options import assignments
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.live.height_map import read_map
from ebamcheck.mesh.part_source import read_plate
from ebamcheck.nc.templates import ProcessValues
from ebamcheck.plugins import registry
from ebamcheck.settings.checking import EXAMPLES, PLACEHOLDERS, TEMPLATES, as_toml
from ebamcheck.settings.config import Config, load_config, validated

FIELDS = [
    (section, key)
    for section, info in Config.model_fields.items()
    if section != "machines"
    for key in info.annotation.model_fields
]

PYDANTIC = re.compile(
    r"Input should|valid (string|tuple|number|boolean|integer|dictionary)|tuple|pydantic|Undefined|dictionary|NoneType|type="
)


@pytest.mark.parametrize(("section", "key"), FIELDS, ids=lambda name: name)
def test_a_value_of_the_wrong_type_is_told_in_plain_words(section, key):
    # A date is no value of any setting.
    with pytest.raises(SettingsError) as told:
        validated(tomllib.loads(f"[{section}]\n{key} = 1979-05-27"), "f.toml")
    message = str(told.value)
    assert message.startswith(f"f.toml: {section}.{key}: it takes ")
    assert not PYDANTIC.search(message), message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('machine.beam_on = "M60"', 'it takes a list of blocks, such as ["M60 ; beam on"] (given \'M60\')'),
        ("process.keep_out = [{ outline_mm = 5 }]", "process.keep_out 1.outline_mm: it takes a list, each a list of 2 numbers"),
        ('scan.partition = "z"', 'it takes one of "hexagons", "squares", "stripes", "whole"'),
        ("part = 5", "part: it takes a table of settings (given 5)"),
    ],
)  # fmt: skip
def test_messages_show_what_to_write(text, said):
    with pytest.raises(SettingsError) as told:
        validated(tomllib.loads(text), "f.toml")
    assert said in str(told.value)


@pytest.mark.parametrize("name", [n for n in EXAMPLES if n.count(".") == 1])
def test_every_example_is_accepted_as_it_stands(name):
    section, key = name.split(".")
    validated(tomllib.loads(f"[{section}]\n{key} = {EXAMPLES[name]}"), "example")


def test_placeholders_are_those_that_are_filled_in():
    # The increments are no value: they say how the others are printed.
    assert set(PLACEHOLDERS) == {field.name for field in fields(ProcessValues)} - {"increments"}
    assert all(used in PLACEHOLDERS for text in TEMPLATES.values() for used in re.findall(r"{(\w+)}", text))


def test_config_documents_keep_out_and_placeholders():
    text = as_toml(Config())
    assert f"# Example: keep_out = {EXAMPLES['process.keep_out']}" in text
    assert all(f"#   {{{name}}}  {meaning}" in text for name, meaning in PLACEHOLDERS.items())
    validated(tomllib.loads(text), "config")


FORM = re.compile(r"^[^:]+: [\w. ]+: .+; (known keys: .+|`ebamcheck config` lists every key)$")


def from_a_file(at):
    (at / "f.toml").write_text("[process]\nbead_width_mm = 'wide'")
    load_config(at / "f.toml")


def from_a_plate(at):
    (at / "plate.toml").write_text("clearance_mm = 'wide'")
    read_plate(at / "plate.toml")


def from_tolerances(at):
    (at / "t.toml").write_text("[metrics.area_mm2]\nabsolute = 'wide'")
    read_tolerances(at / "t.toml")


def from_a_frame(at):
    np.save(at / "m.npy", np.ones((3, 3)))
    (at / "m.npy.frame.toml").write_text("unit_mm = 'wide'")
    read_map(at / "m.npy", Config().height_map)


def from_the_command_line(at):
    registry.slicer_settings("stencil", assignments(["pixel_mm=wide"]))


def from_arguments(at):
    Config().changed(curves={"tolerance_mm": "wide"})


@pytest.mark.parametrize(
    "given", [from_a_file, from_a_plate, from_tolerances, from_a_frame, from_the_command_line, from_arguments]
)
def test_whatever_a_value_comes_from_it_is_refused_in_one_form(given, tmp_path):
    with pytest.raises((SettingsError, InputError)) as told:
        given(tmp_path)
    message = str(told.value)
    assert FORM.match(message.removeprefix(str(tmp_path))), message
    assert "it takes a number" in message
    assert "(given 'wide')" in message
