"""The layer height that a run takes where none is set: level faces of the part lie between its layers."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import FAST, ebamcheck, write_stl
from parts import box, join

from ebamcheck.checks.mesh_checks import solid_check
from ebamcheck.layers.heights import (
    OTHER_HEIGHTS,
    cut_heights,
    level_faces,
    moved_mm3,
    nearest_fitting,
    share_off,
)
from ebamcheck.plugins.registry import models
from ebamcheck.preflight.report import chosen_height
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part

BEAD_MM = Config().process.bead_height_mm
MUSHROOM = join(box((-5, -5, 0), (5, 5, 9)), box((-20, -20, 9), (20, 20, 15)))


def solid(part, config):
    return solid_check(part, slice_part(part, cut_heights(part, config)), config).check


@pytest.mark.parametrize("name", ["cube", "prism", "sphere", "torus", "blade", "bracket"])
def test_the_height_of_a_bead_is_kept_where_it_has_the_metal(name):
    found = chosen_height(models()[name].tessellate(0.3), True, Config())
    assert found.config == Config()
    assert not found.fitted
    assert found.check.level == "pass"


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("name", ["cube", "sphere", "cone", "torus", "bracket", "impeller"])
@pytest.mark.parametrize("height_mm", [1.1, 1.676, 2.3])
def test_the_share_is_that_of_the_gate(name, height_mm):
    part, config = models()[name].tessellate(0.3), Config().changed(layers={"layer_height_mm": height_mm})
    assert share_off(part, config) == pytest.approx(solid(part, config).value, abs=1e-6)


@pytest.mark.parametrize("top_mm", [1.9, 4.2, 6.0, 7.0, 12.0, 17.5, 22.0])
def test_a_box_of_any_height_gets_layers_that_end_at_its_top(top_mm):
    part = box((0, 0, 0), (30, 30, top_mm))
    found = chosen_height(part, True, Config())
    assert solid(part, found.config).passed
    assert abs(found.config.layer_height_mm / BEAD_MM - 1.0) <= OTHER_HEIGHTS
    assert found.fitted == (not solid(part, Config()).passed)


def test_metal_within_the_allowance_for_machining_moves_nothing():
    # The foot ends 0.2 mm short at a bead's height; layers of 1.7 mm mend that, and go 0.7 mm beyond the smaller top.
    config = Config().changed(process={"machining_allowance_mm": 1.0})
    part = join(box((0, 0, 0), (30, 30, 3.4)), box((40, 0, 0), (70, 30, 4.4)))
    near = nearest_fitting(part, config)
    assert near is not None
    assert solid(part, config.changed(layers={"layer_height_mm": near.height_mm})).passed
    cuts = cut_heights(part, config.changed(layers={"layer_height_mm": 1.7}))
    borders, faces = 1.7 * np.arange(len(cuts) + 1), level_faces(part, 36.0)
    assert moved_mm3(faces, cuts, borders) == pytest.approx(0.7 * 900)
    assert moved_mm3(faces, cuts, borders, 1.0) == 0.0


def test_what_is_set_stays_as_it_is():
    for layers in (
        {"layer_height_mm": 1.676},
        {"heights_mm": [1.0, 3.0]},
        {"fit_height": False},
        {"base_mm": 3.0},
    ):
        config = Config().changed(layers=layers)
        found = chosen_height(MUSHROOM, True, config)
        assert found.config == config
        assert not found.fitted
    assert not chosen_height(MUSHROOM, False, Config()).fitted


def test_where_nothing_fits_the_preflight_warns():
    part = join(box((0, 0, 0), (20, 20, 2.6)), box((30, 0, 0), (50, 20, 3.3)))
    found = chosen_height(part, True, Config())
    assert found.config == Config()
    assert found.check.level == "warning"
    assert not solid(part, Config()).passed


def test_a_run_takes_it_tells_it_and_is_verified(tmp_path):
    write_stl(box((0, 0, 0), (24, 24, 7)), tmp_path / "box.stl")
    looked = ebamcheck("preflight", "box.stl", "--json", cwd=tmp_path)
    (told,) = [check for check in json.loads(looked.stdout)["checks"] if check["name"] == "layer height"]
    assert "layers of 1.75 mm in place of a bead's" in told["text"]
    done = ebamcheck("run", "box.stl", "--backends", FAST, "-o", "r", cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    record = json.loads((tmp_path / "r/run.json").read_text())
    assert record["heights"]["layer_height_mm"] == record["settings"]["layers"]["layer_height_mm"] == 1.75
    assert record["heights"]["count"] == 4
    assert [f["severity"] for f in record["findings"] if f["code"] == "layer-height-fitted"] == ["note"]
    assert ebamcheck("verify", "r", cwd=tmp_path).returncode == 0
    # Elsewhere, with the part and the default settings alone, its layers are those that a run has.
    assert ebamcheck("post", "r", "-o", "away", cwd=tmp_path).returncode == 0
    alone = ebamcheck("verify", "away", "--part", "box.stl", "--json", cwd=tmp_path)
    assert [check["name"] for check in json.loads(alone.stdout) if not check["passed"]] == []
