"""Layers made while a build goes on, end to end, and the readings of heights that ask for them."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from command_line import ebamcheck
from live_boxes import failed_checks, third_layer

from ebamcheck.errors import SettingsError
from ebamcheck.json_values import sha256_of_file
from ebamcheck.live.building import Building
from ebamcheck.live.height_map import Reading, Refused, check_height
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.publishing import CURRENT, LAYERS, certificate_of, publish
from ebamcheck.live.relaying import check_below, finished_run
from ebamcheck.settings.config import Config
from ebamcheck_reports.run_data import GATES

SIZE = (30, 24, 12)


def relayer(place, folder, *arguments):
    """Make a layer of the run again, as a user does, into the folder `o`."""
    return ebamcheck("relayer", place / "box.run", *arguments, "-o", folder / "o", cwd=folder)


def with_settings(place, folder, section, **keys):
    """A copy of the run whose record has other settings."""
    run = shutil.copytree(place / "box.run", folder / "box.run")
    manifest = json.loads((run / "run.json").read_text())
    manifest["settings"][section] |= keys
    (run / "run.json").write_text(json.dumps(manifest))
    shutil.copy(place / "box.stl", folder)
    return folder


def test_relayer_publishes_a_layer_at_the_measured_height_that_verifies_from_its_text(place, tmp_path):
    before = {p: p.read_bytes() for p in (place / "box.run").rglob("*") if p.is_file()}
    done = relayer(place, tmp_path, "--layer", 4, "--measured-z", 5.3, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    folder = tmp_path / "o" / LAYERS / told["name"]
    text = (folder / "program" / told["called"]).read_text()
    # The rest of 6.7 mm is four layers of 1.675 mm, and the text works at the top of the first of them.
    assert told["thickness_mm"] == pytest.approx(6.7 / 4)
    assert told["cut_mm"] == pytest.approx(5.3 + 6.7 / 8)
    assert f"Z {5.3 + 6.7 / 4:.6f}" in text
    assert "; VALIDATED" in text
    assert failed_checks(folder, place / "box.stl") == []
    for name, sha256 in told["files"].items():
        assert sha256_of_file(folder / "program" / name) == sha256
    assert [gate["name"] for gate in told["gates"]] == [*GATES]
    assert {p: p.read_bytes() for p in (place / "box.run").rglob("*") if p.is_file()} == before
    again = relayer(place, tmp_path, "--layer", 4, "--measured-z", 5.4)
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "o" / LAYERS / "MAIN_K0004R2").is_dir()
    # Without a build there is no journal: the layers' own certificates name their files.
    every = ebamcheck("verify", "o", "--part", place / "box.stl", cwd=tmp_path)
    assert every.returncode == 0, every.stdout + every.stderr
    assert "2 of 2 published layers verify" in every.stdout
    (folder / "program" / told["called"]).write_text(text.replace("; VALIDATED", "; VALID"))
    spoiled = ebamcheck("verify", "o", "--part", place / "box.stl", cwd=tmp_path)
    assert spoiled.returncode == 1
    assert "is not the file that its layer.json names" in spoiled.stdout


def test_a_text_that_was_changed_does_not_verify(maker, place, tmp_path):
    made = third_layer(maker, tmp_path / "s")
    assert made.passed, made.why
    publish(tmp_path / "b", made, certificate_of(made, maker))
    folder = tmp_path / "b" / LAYERS / "MAIN_K0003R1"
    assert failed_checks(folder, place / "box.stl") == []
    path = folder / "program" / "MAIN_K0003R1_L0001.SPF"
    text = path.read_text().replace("Z5.000000", "Z6.600000")
    assert path.read_text() != text
    path.write_text(text)
    failed = {check.name for check in failed_checks(folder, place / "box.stl")}
    assert failed & {"layer heights", "process window", "header", "layers"}, failed


def test_metal_of_a_layer_follows_its_real_height(maker, tmp_path):
    def wire(thickness):
        made = third_layer(maker, tmp_path / f"{thickness}", thickness)
        assert made.passed, made.why
        text = (made.files.folder / "MAIN_K0003R1_L0001.SPF").read_text()
        return np.mean([float(line.split("H3=")[1].split()[0]) for line in text.split("\n") if "H3=" in line])

    assert wire(1.9) / wire(1.4) == pytest.approx(1.9 / 1.4, rel=0.01)


def test_a_shut_gate_keeps_the_old_layer_and_says_why(place, tmp_path):
    other = with_settings(place, tmp_path, "process", line_energy_j_mm=[150.0, 151.0])
    done = relayer(other, tmp_path, "--layer", 6, "--measured-z", 8.5, "--part", "box.stl")
    assert done.returncode == 1, done.stdout + done.stderr
    assert "process window" in done.stdout
    assert "the old layer stays, MAIN_L0006.SPF" in done.stdout
    assert not (tmp_path / "o" / LAYERS).exists()
    assert not (tmp_path / "o" / CURRENT).exists()


# Two layers of 12 / 7 mm: 0.75 of one is what a bead may be off.
@pytest.mark.parametrize(
    ("height", "said"),
    [
        (0.0, "is not over 1.714"),
        (0.001, "is not over 1.714"),
        (0.33, "is not over 1.714"),
        (30.0, "off the plan, 3.429"),
        (3.4 / 25.4, "in inches"),
        (24 / 7 - 1.2 * 0.75 * 12 / 7, "off the plan"),
        (24 / 7 + 1.2 * 0.75 * 12 / 7, "off the plan"),
        (24 / 7 - 0.75 * 12 / 7 / 1.2, ""),
        (24 / 7 + 0.75 * 12 / 7 / 1.2, ""),
    ],
)
def test_a_single_layer_takes_the_heights_that_a_build_takes(height, said, place, tmp_path):
    run, below = finished_run(place / "box.run"), tmp_path / "none"
    if not said:
        check_below(below, run, 2, height)
        return
    with pytest.raises(SettingsError, match=said):
        check_below(below, run, 2, height)


def test_a_layer_that_was_made_again_is_the_one_below_of_the_next(place, tmp_path):
    # 1.1 mm too low, and the next one once more: each is within 0.75 of a layer of the one below, not of the run.
    assert relayer(place, tmp_path, "--layer", 3, "--measured-z", 2.4).returncode == 0
    assert relayer(place, tmp_path, "--layer", 4, "--measured-z", 2.9).returncode == 0
    done = relayer(place, tmp_path, "--layer", 5, "--measured-z", 0.33)
    assert done.returncode == 2
    assert "by MAIN_K0004R1" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--layer", 8, "--measured-z", 5.0), "the run has the layers 1 to 7"),
        (("--layer", 0, "--measured-z", 0.0), "--layer 0: layers are counted from 1"),
        (("--layer", 2, "--measured-z", "nan"), "height over the base plate"),
        (("--layer", 2, "--measured-z", -1), "height over the base plate"),
        (("--layer", 2, "--measured-z", 2, "--direction", "1,2"), "three numbers"),
        (("--layer", 2, "--measured-z", 2, "--direction", "0,0,0"), "direction"),
        (
            ("--layer", 2, "--measured-z", 1.7, "--direction", "1,0,0"),
            "no axes that turn the part between layers (machine.tilt_axes)",
        ),
    ],
)
def test_bad_arguments_are_one_line(place, tmp_path, arguments, said):
    done = relayer(place, tmp_path, *arguments)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "o").exists()


def test_a_build_and_single_layers_do_not_share_a_folder(place, maker, tmp_path):
    """They would come to the same names, and the build would keep its own layer back without end."""
    # The direction of the run itself needs no axes.
    arguments = ("--layer", 2, "--measured-z", 1.7, "--direction", "0,0,2")
    Building(maker, tmp_path / "o").close()
    done = relayer(place, tmp_path, *arguments)
    assert done.returncode == 2
    assert "is the folder of a build" in done.stderr
    shutil.rmtree(tmp_path / "o")
    assert relayer(place, tmp_path, *arguments).returncode == 0
    with pytest.raises(SettingsError, match="holds MAIN_K0002R1, which `ebamcheck relayer` made"):
        Building(maker, tmp_path / "o")


def test_another_direction_through_what_stands_is_refused(place, tmp_path):
    """The part is cut turned, and the layer that stands is in the section: see test_turned_layers for what is built."""
    other = with_settings(place, tmp_path, "machine", tilt_axes=True)
    turned = ("--direction", "1,0,0", "--part", "box.stl", "--json")
    done = relayer(other, tmp_path, "--layer", 2, "--measured-z", 1.7, *turned)
    assert done.returncode == 1, done.stderr + done.stdout
    told = json.loads(done.stdout)
    assert told["direction"] == [1.0, 0.0, 0.0]
    said = {gate["name"]: gate["text"] for gate in told["gates"]}
    # 30 mm of it stand upright now: 24 x 12 mm are cut.
    kg = 24 * 12 * told["thickness_mm"] * Config().material.density_kg_m3 * 1e-9
    assert f"{kg:.6f} kg of part" in said["deposit"]
    assert "standing metal" in said["program"]
    assert told["place"] is None
    assert not (tmp_path / "o" / LAYERS / told["name"]).exists()


def test_controls_of_one_file_get_a_file_of_one_layer_and_those_not_read_back_none(place, tmp_path):
    part = finished_run(place / "box.run").part
    for control in ("linuxcnc", "plain-gcode"):
        with LayerMaker(part, Config().changed(machine={"control": control})) as maker:
            made = third_layer(maker, tmp_path / f"{control}-made")
            assert made.passed, made.why
            (name,) = made.files.names
            assert publish(tmp_path / control, made, certificate_of(made, maker))["program"].endswith(name)
    with pytest.raises(SettingsError, match="not read back"):
        LayerMaker(part, Config().changed(machine={"control": "3dthesis"}))


@pytest.mark.parametrize("height", [0.0, -1.0, 1.7 / 25.4, 1.7e3, 1.7e-3, 17.0, 1e308, 0.3])
def test_heights_that_no_bead_has_are_faults(height):
    with pytest.raises(Refused):
        check_height(Reading(1, height), 0.0, 1.7)


@pytest.mark.parametrize("share", [0.3, 0.9, 1.0, 1.1, 1.7])
def test_heights_that_a_bead_may_have_are_none(share):
    assert check_height(Reading(5, 10.0 + 1.7 * share), 10.0, 11.7) is None


def test_a_reading_before_the_start_is_refused(maker, tmp_path):
    building = Building(maker, tmp_path / "b")
    assert building.height({"event": "height", "done": 1, "height_mm": 1.8})["code"] == "not-started"
    building.close()
