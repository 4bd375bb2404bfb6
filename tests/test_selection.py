"""The choice of slicers for a machine: rules, the settings file, and the run that obeys it."""

from __future__ import annotations

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from parts import box

from ebamcheck.accuracy.selection import (
    TIE_SHARE,
    Trial,
    choose,
    ranked,
    try_backends,
    workpiece_of_model,
    write_choice,
)
from ebamcheck.commands.accuracy import select
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.plugins.registry import models
from ebamcheck.settings.checking import as_toml
from ebamcheck.settings.config import Config, load_config
from ebamcheck.settings.stages import MACHINE_VARIABLE, for_this_machine
from ebamcheck_models import write_stl

USER_FILE = """\
# Settings of our shop. Do not lose this line.
[process]
travel_speed_mm_s = 12.0 # slower than the handbook

[machines.other]
primary = "manifold" # the laptop
required = []

[comparison]
tolerance_mm = 0.002
"""


def trial(name, seconds=1.0, bound_mm=0.01, measured_mm=0.01, priority=0, available=True, why=""):
    return Trial(name, False, priority, available, why, bound_mm, measured_mm, seconds, "CPU", {"n": "1"})


TRIALS = [
    trial("fast", 0.1, bound_mm=0.2),
    trial("wrong", 0.1, why="outvoted on 3 layers"),
    trial("absent", available=False, why="no display"),
    trial("sound", 1.0, priority=9),
    trial("slow", 5.0),
]


# -- rules -----------------------------------------------------------------------------------------------


def test_the_fastest_that_meets_the_tolerance_is_chosen_and_every_other_has_its_reason():
    choice = choose(TRIALS, 0.1)
    assert (choice.primary, choice.witness, choice.required) == ("sound", "slow", ("sound", "slow"))
    assert choice.reasons["fast"] == "its bound of 0.2 mm is over the tolerance of 0.1 mm"
    assert choice.reasons["wrong"] == "outvoted on 3 layers"
    assert choice.reasons["absent"] == "it is not available: no display"
    assert choice.reasons["slow"].startswith("witness: the next after sound (5 s against 1 s")
    assert choose(TRIALS, 0.3).primary == "fast"


def test_a_tie_goes_by_priority_and_then_by_name():
    tied = [trial("b", 1.0), trial("a", 1.05), trial("c", 1.09, priority=1), trial("d", 1.2, priority=9)]
    assert [t.name for t in ranked(tied)] == ["c", "a", "b", "d"]


@given(st.lists(st.tuples(st.floats(0.01, 9.0), st.integers(0, 3)), min_size=1, max_size=6), st.randoms())
def test_the_choice_does_not_depend_on_the_order_of_the_trials(figures, random):
    trials = [trial(f"t{k}", seconds, priority=p) for k, (seconds, p) in enumerate(figures)]
    chosen = ranked(trials)
    assert chosen[0].seconds <= (1.0 + TIE_SHARE) * min(t.seconds for t in trials)
    random.shuffle(trials)
    assert ranked(trials) == chosen


# -- trials ----------------------------------------------------------------------------------------------

TWO = Config().changed(slicing={"backends": ("planecut", "manifold")})


def test_both_exact_slicers_meet_a_models_exact_sections(tmp_path):
    work = workpiece_of_model(models(["cube"])["cube"], 0.4, 2.0)
    assert work.truth is not None
    assert (len(work.timed), work.truth.uniform.sum()) == (10, 10)
    trials = {t.name: t for t in try_backends(work, TWO, repeats=1)}
    assert set(trials) == {"planecut", "manifold"}
    for found in trials.values():
        assert (found.available, found.why) == (True, "")
        assert found.measured_mm <= 1e-6
        assert found.seconds > 0.0
        assert found.versions


@pytest.mark.slow
def test_the_command_chooses_on_a_part_and_writes_the_machines_section(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(MACHINE_VARIABLE, "bench-7")
    write_stl(box(upper=(8.0, 6.0, 4.0)), tmp_path / "part.stl")
    config = tmp_path / "ebamcheck.toml"
    config.write_text('[slicing] # ours\nbackends = ["planecut", "manifold"]\n')
    code = select(part=tmp_path / "part.stl", layer_height=1.0, repeats=1, write=True, config_file=config)
    assert code is ExitCode.PASS
    text = capsys.readouterr().out
    assert "machine bench-7: part, 12 facets, 4 layers" in text
    section = tomllib.loads(config.read_text())["machines"]["bench-7"]
    assert set(section["required"]) == {"planecut", "manifold"}
    assert section["primary"] in section["required"]
    assert section["provenance"]["tolerance_mm"] == 0.1
    assert "[slicing] # ours" in config.read_text()


def test_what_makes_no_sense_is_refused(tmp_path):
    with pytest.raises(SettingsError, match="not both"):
        select(part=tmp_path / "a.stl", model="cube")
    with pytest.raises(SettingsError, match="positive number"):
        select(model="cube", tolerance_mm=-1.0)
    with pytest.raises(SettingsError, match="unknown model"):
        select(model="nosuch")


# -- the settings file -----------------------------------------------------------------------------------


def write(path, machine="bench-7"):
    write_choice(path, machine, choose(TRIALS, 0.1), TRIALS, {"part": "block", "tolerance_mm": 0.1})


def test_only_the_machines_section_of_the_users_file_changes(tmp_path):
    path = tmp_path / "ebamcheck.toml"
    path.write_text(USER_FILE)
    write(path)
    text = path.read_text()
    kept = [line for line in USER_FILE.splitlines() if line]
    assert [line for line in text.splitlines() if line in kept] == kept
    values = tomllib.loads(text)
    section = values["machines"].pop("bench-7")
    assert values == tomllib.loads(USER_FILE)
    assert (section["primary"], section["required"]) == ("sound", ["sound", "slow"])
    backends = section["provenance"]["backends"]
    assert backends["sound"] == {
        "reason": choose(TRIALS, 0.1).reasons["sound"], "device": "CPU", "versions": {"n": "1"},
        "bound_mm": 0.01, "measured_mm": 0.01, "seconds": 1.0,
    }  # fmt: skip
    write(path)
    assert path.read_text() == text


@pytest.mark.parametrize("text", ["not toml", "machines = 3\n", "[[machines]]\n"])
def test_a_file_that_cannot_take_the_section_is_left_as_it_is(tmp_path, text):
    path = tmp_path / "ebamcheck.toml"
    path.write_text(text)
    with pytest.raises(SettingsError, match=r"ebamcheck\.toml"):
        write(path)
    assert path.read_text() == text
    assert [p.name for p in tmp_path.iterdir()] == ["ebamcheck.toml"]


# -- the run that obeys ----------------------------------------------------------------------------------


def settings_of(machines: dict) -> Config:
    return Config.model_validate({"machines": machines, "slicing": {"required": ["manifold"]}})


def test_the_section_of_this_machine_is_in_force_and_no_other(monkeypatch):
    monkeypatch.setenv(MACHINE_VARIABLE, "bench-7")
    choice = {"primary": "planecut", "required": ["planecut", "manifold"]}
    obeyed = for_this_machine(settings_of({"bench-7": choice, "other": {"primary": "stencil"}}))
    assert obeyed.slicing.primary == "planecut"
    assert obeyed.slicing.required == ("manifold", "planecut")
    untouched = for_this_machine(settings_of({"other": choice}))
    assert untouched == for_this_machine(settings_of({}))  # what others use does not show in a run's settings
    assert untouched.slicing.required == ("manifold",)
    assert for_this_machine(Config()) == Config()


def test_what_is_written_is_what_a_run_reads_and_config_shows(tmp_path, monkeypatch):
    monkeypatch.setenv(MACHINE_VARIABLE, "bench-7")
    path = tmp_path / "ebamcheck.toml"
    path.write_text(USER_FILE)
    write(path)
    assert for_this_machine(load_config(path)).slicing.primary == "sound"
    shown = tmp_path / "shown.toml"
    shown.write_text(as_toml(load_config(path)))
    assert load_config(shown) == load_config(path)
    path.write_text(path.read_text().replace("required = [", "requird = ["))
    with pytest.raises(SettingsError, match="requird"):
        load_config(path)
