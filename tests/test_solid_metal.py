"""Layers against the solid that they stand for: level faces within a layer move to one of its borders."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import FAST, ebamcheck, write_stl
from parts import box, join

from ebamcheck.checks.mesh_checks import layer_borders, solid_check
from ebamcheck.layers.heights import cut_heights, layer_rule, level_faces, section_areas
from ebamcheck.mesh.bodies import volumes_between
from ebamcheck.plugins.registry import models
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part


def of(part, height_mm, **changes):
    config = Config().changed(layers={"layer_height_mm": height_mm}, **changes)
    return solid_check(part, slice_part(part, cut_heights(part, config)), config)


def rule_of(part, height_mm):
    config = Config().changed(layers={"layer_height_mm": height_mm})
    cuts = cut_heights(part, config)
    borders = layer_borders(part, cuts, config)
    top = max(part.bounds[1, 2], borders[-1]) + 1.0
    volumes = volumes_between(part, np.append(borders, top))
    return layer_rule(part, cuts, borders, section_areas(part, cuts), volumes, 36.0), volumes


STEM, CAP = box((-5, -5, 0), (5, 5, 9)), box((-20, -20, 9), (20, 20, 15))
MUSHROOM = join(STEM, CAP)


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("height_mm", [1.0, 1.3, 1.676, 2.5])
@pytest.mark.parametrize("name", ["blade", "cone", "impeller", "sphere", "torus", "tilted-plate", "menger-1"])
def test_what_is_added_less_what_lacks_is_the_metal_less_the_solid(name, height_mm):
    part = models()[name].tessellate(0.3)
    found, volumes = rule_of(part, height_mm)
    config = Config().changed(layers={"layer_height_mm": height_mm})
    metal = slice_part(part, cut_heights(part, config)).areas().sum() * height_mm
    assert found.solid_mm3 == pytest.approx(part.volume, rel=1e-9)
    assert found.added_mm3 - found.lacking_mm3 == pytest.approx(metal - part.volume, abs=2e-6 * part.volume)
    assert found.added_mm3 >= 0.0
    assert found.lacking_mm3 >= 0.0
    assert volumes.sum() == pytest.approx(part.volume)


@pytest.mark.parametrize("name", ["cube", "cylinder", "prism", "sphere", "cone", "bracket", "blade"])
def test_parts_of_every_day_pass(name):
    part = models()[name].tessellate(0.1)
    assert solid_check(part, slice_part(part, cut_heights(part, Config())), Config()).check.passed


def test_faces_on_borders_leave_nothing():
    found, _ = rule_of(MUSHROOM, 1.5)
    assert found.share == pytest.approx(0.0, abs=1e-9)
    assert not found.faces


def test_an_underside_within_a_layer_adds_what_lies_under_it():
    # Layers of 2 mm: the one from 8 to 10 is cut at 9 + 0, where the cap is; the last one ends at 14.
    found, _ = rule_of(MUSHROOM, 2.0)
    assert found.added_mm3 == pytest.approx((40 * 40 - 10 * 10) * 1.0)
    assert found.lacking_mm3 == pytest.approx(40 * 40 * 1.0)
    assert {(face.z_mm, face.up) for face in found.faces} == {(9.0, False), (15.0, True)}


def test_an_underside_over_the_cut_leaves_a_gap():
    part = join(STEM, box((-20, -20, 9.2), (20, 20, 16)), box((-5, -5, 9), (5, 5, 9.2)))
    found, _ = rule_of(part, 2.0)
    assert found.lacking_mm3 == pytest.approx(0.8 * (40 * 40 - 10 * 10))
    assert found.added_mm3 == pytest.approx(0.0, abs=1e-6)


def test_what_one_pillar_has_too_much_does_not_make_up_for_another():
    # In one layer: a top 0.6 mm under its border, and one 0.6 mm over the border below.
    two = join(box((0, 0, 0), (20, 20, 9.4)), box((30, 0, 0), (50, 20, 8.6)), box((60, 0, 0), (66, 6, 10)))
    found, _ = rule_of(two, 2.0)
    assert found.added_mm3 == pytest.approx(0.6 * 400)
    assert found.lacking_mm3 == pytest.approx(0.6 * 400)


def test_a_mushroom_is_refused_with_place_and_remedy():
    solid = of(MUSHROOM, 1.676)
    assert not solid.check.passed
    assert solid.z_mm == 9.0
    assert "at the level face of 1500 mm2 at z = 9.000 mm of the part" in solid.check.text
    assert "goes beyond it by 0.62 mm" in solid.check.text
    assert "layers of 1.5 mm (layers.layer_height_mm) leave 0.00 %" in solid.check.text
    assert of(MUSHROOM, 1.5).check.passed


def test_an_allowance_for_machining_takes_what_is_too_much_and_nothing_that_lacks():
    assert of(MUSHROOM, 1.676, process={"machining_allowance_mm": 1.0}).check.passed
    short = box((0, 0, 0), (20, 20, 10.6))
    assert not of(short, 2.0, process={"machining_allowance_mm": 1.0}).check.passed


def test_bodies_that_overlap_count_once():
    one = of(box((0, 0, 0), (30, 30, 9)), 2.0).check
    both = of(join(box((0, 0, 0), (30, 30, 9)), box((10, 10, 0), (20, 20, 9))), 2.0).check
    assert both.value == pytest.approx(one.value, rel=0.01)
    assert not both.passed


def test_listed_layers_are_held_against_the_solid_between_their_borders():
    # They need not be the whole part: that they end under its top is a warning of its own.
    part = join(box((0, 0, 0), (30, 30, 12)), box((40, 0, 0), (70, 30, 4.6)))
    for heights, base_mm, off in (([3.0, 5.0], 0.0, 0.6 / (2 * 4 - 1.4)), ([5.0, 7.0], 4.0, 0.6 / 4.6)):
        config = Config().changed(layers={"heights_mm": heights, "base_mm": base_mm})
        found = solid_check(part, slice_part(part, heights), config).check
        assert found.value == pytest.approx(off)
        assert "leave 0.00 %" not in found.text


def test_a_layer_that_is_made_alone_is_not_held_against_the_solid():
    config = Config().changed(layers={"heights_mm": [9.0], "base_mm": 8.0})
    found = solid_check(MUSHROOM, slice_part(MUSHROOM, [9.0]), config).check
    assert found.passed
    assert "one layer" in found.text


def test_level_faces_are_level_and_as_large_as_they_are():
    part = models()["tilted-plate"].tessellate(0.1)
    assert level_faces(part, 1.0) == []
    assert [(f.z_mm, f.area_mm2, f.up) for f in level_faces(CAP, 36.0)] == [
        (9.0, 1600.0, False), (15.0, 1600.0, True),
    ]  # fmt: skip


def test_a_run_of_a_step_within_a_layer_is_not_validated_and_verify_finds_it_again(tmp_path):
    write_stl(join(box((0, 0, 0), (24, 24, 9)), box((30, 0, 0), (54, 24, 8.5))), tmp_path / "two.stl")
    (tmp_path / "two.toml").write_text("[layers]\nlayer_height_mm = 1.8\n")
    done = ebamcheck("run", "two.stl", "-o", "run", "-c", "two.toml", "--backends", FAST, cwd=tmp_path)
    assert done.returncode == 1, done.stdout + done.stderr
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert [gate["name"] for gate in record["gates"] if not gate["passed"]] == ["deposit"]
    assert not record["program"]["validated"]
    (told,) = [finding for finding in record["findings"] if finding["severity"] == "fault"]
    assert told["code"] == "level-within-layer"
    assert "at the level face of 576 mm2 at z = 8.500 mm" in told["text"]
    again = json.loads(ebamcheck("verify", "run", "--json", cwd=tmp_path).stdout)
    assert {check["name"] for check in again if not check["passed"]} == {"gate deposit", "metal of the solid"}
    alone = ebamcheck("verify", "run/program", "--part", "two.stl", "--json", cwd=tmp_path)
    assert "metal of the solid" in {check["name"] for check in json.loads(alone.stdout) if not check["passed"]}


@pytest.mark.slow
def test_a_top_beside_its_layer_is_told_once(tmp_path):
    write_stl(box((0, 0, 0), (24, 24, 5)), tmp_path / "low.stl")
    done = ebamcheck("run", "low.stl", "-o", "run", "--backends", FAST, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    write_stl(box((0, 0, 0), (24, 24, 6)), tmp_path / "odd.stl")
    odd = ebamcheck("run", "odd.stl", "-o", "odd", "--backends", FAST, "--layer-height", 1.676, cwd=tmp_path)
    assert odd.returncode == 1
    codes = {f["code"] for f in json.loads((tmp_path / "odd" / "run.json").read_text())["findings"]}
    assert "level-within-layer" in codes
    assert "height-off-part" not in codes
