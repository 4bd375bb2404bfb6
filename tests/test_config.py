"""Settings: read strictly, printed so that they explain themselves and read back the same."""

from __future__ import annotations

import json
import tomllib

import pytest

from ebamcheck.errors import SettingsError
from ebamcheck.plugins.registry import plugin
from ebamcheck.settings.checking import as_toml, explained_schema, explanations
from ebamcheck.settings.config import Config, load_config


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
    schema = explained_schema(Config)
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
