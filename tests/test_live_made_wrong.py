"""Mistakes in the code that makes and releases layers of a build, planted one by one: none of these layers is released."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from command_line import write_stl

from ebamcheck.checks.mesh_checks import heights_check, layer_check
from ebamcheck.live import building as building_module
from ebamcheck.live import height_map, publishing
from ebamcheck.live.building import Building
from ebamcheck.live.heights import HeightRule
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.publishing import ended_early
from ebamcheck.live.verifying import verify_build
from ebamcheck.mesh.part import from_arrays
from ebamcheck.mesh.part_source import read_part
from ebamcheck.settings.config import Config

CONFIG = Config().changed(process={"interpass_limit_k": 420.0, "interpass": "dwell"})
LOW_MM, HIGH_MM = 3.0, 5.0  # Z of the part's lowest point in its file, and its height


def tapered():
    """A block that gets narrower upwards, so that every height has a section of its own."""
    around = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], float)
    low, high = np.full((4, 1), LOW_MM), np.full((4, 1), LOW_MM + HIGH_MM)
    corners = np.vstack([np.hstack([around * (15, 12), low]), np.hstack([around * (12, 9), high])])
    faces = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)]
    for i in range(4):
        j = (i + 1) % 4
        faces += [(i, j, j + 4), (i, j + 4, i + 4)]
    return from_arrays(corners, faces)


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    return write_stl(tapered(), tmp_path_factory.mktemp("tapered") / "part.stl")


def built(part, folder):
    """Answers of a build whose layers grow a little higher than planned."""
    answers = []
    with LayerMaker(read_part(part, CONFIG.part)[0], CONFIG) as maker:
        build = Building(maker, folder)
        answer = build.start()
        while answer["answer"] == "published":
            answers.append(answer)
            height_mm = answer["base_mm"] + 1.04 * answer["thickness_mm"]
            answer = build.height({"event": "height", "done": len(answers), "height_mm": height_mm})
        build.close()
    return [*answers, answer]


def test_a_sound_build_is_released_and_verifies(part, tmp_path):
    answers = built(part, tmp_path / "b")
    assert [answer["answer"] for answer in answers] == ["published"] * 3 + ["done"]
    assert [layer.why for layer in verify_build(tmp_path / "b", part)] == [""] * 3


def cut_at_the_bottom(monkeypatch):
    right = LayerMaker.config_of

    def wrong(self, wanted, *given):
        config, cut_mm = right(self, wanted, *given), self.bottom_mm + wanted.base_mm + 1e-3
        return config.model_copy(update={"layers": config.layers.model_copy(update={"heights_mm": (cut_mm,)})})

    monkeypatch.setattr(LayerMaker, "config_of", wrong)


def cut_without_the_bottom(monkeypatch):
    monkeypatch.setattr(LayerMaker, "bottom_mm", LOW_MM + 0.5)


def no_wait(monkeypatch):
    right = building_module.replace
    monkeypatch.setattr(
        building_module,
        "replace",
        lambda made, **to: right(made, **({"wait_s": 0.0} if "wait_s" in to else to)),
    )


def heat_is_forgotten(monkeypatch):
    right = Building._take

    def wrong(self, *given):
        cold = self.before
        right(self, *given)
        self.before = replace(self.before, part=cold.part, last=cold.last)

    monkeypatch.setattr(Building, "_take", wrong)


def another_wait_is_told(monkeypatch):
    right = publishing.current_of
    monkeypatch.setattr(publishing, "current_of", lambda paper: right(paper) | {"wait_s": 0.0})


def another_file_is_called(monkeypatch):
    right = publishing.current_of
    monkeypatch.setattr(
        publishing,
        "current_of",
        lambda paper: right(paper) | {"program": "layers/MAIN_K0001R1/program/x.SPF"},
    )


def ends_too_soon(monkeypatch):
    right = HeightRule.plan
    monkeypatch.setattr(
        HeightRule,
        "plan",
        lambda self, base_mm: right(self, base_mm if base_mm < 3.0 else self.slopes.top_mm),
    )


def another_height_is_read(monkeypatch):
    right = height_map.reading_of
    monkeypatch.setattr(
        height_map,
        "reading_of",
        lambda message: replace(right(message), height_mm=message["height_mm"] - 0.4),
    )


@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        (cut_at_the_bottom, "not cut at its middle"),
        (cut_without_the_bottom, "not cut at its middle"),
        (no_wait, "heat over all layers"),
        (heat_is_forgotten, "heat over all layers"),
        (another_wait_is_told, "told another wait_s"),
        (another_file_is_called, "told another sha256"),
        (ends_too_soon, "said to be done at"),
        (another_height_is_read, "is taken for"),
    ],
)
def test_a_layer_is_not_released(mistake, said, part, monkeypatch, tmp_path):
    mistake(monkeypatch)
    last = built(part, tmp_path / "b")[-1]
    assert last["answer"] in ("kept", "refused"), last
    assert said in last["reason"]


def test_verify_finds_a_build_that_ends_too_soon(part, monkeypatch, tmp_path):
    ends_too_soon(monkeypatch)
    monkeypatch.setattr(publishing, "ended_early", lambda *_: "")
    assert built(part, tmp_path / "b")[-1]["answer"] == "done"
    assert "said to be done at" in verify_build(tmp_path / "b", part)[-1].why


def test_a_build_may_end_where_no_layer_fits():
    assert not ended_early(10.0, 9.5, CONFIG)
    assert not ended_early(10.0, 10.4, CONFIG)
    assert ended_early(10.0, 9.0, CONFIG)
    # A feeder that goes no slower lays nothing thinner.
    slow = CONFIG.changed(process={"wire_speed_min_mm_s": 30.0})
    assert not ended_early(10.0, 9.0, slow)


def test_a_layer_on_what_stands_is_cut_at_its_middle(part):
    mesh = read_part(part, CONFIG.part)[0]
    assert layer_check(mesh, LOW_MM + 2.0, 1.2, 1.6).passed
    assert not layer_check(mesh, LOW_MM + 2.3, 1.2, 1.6).passed
    assert not layer_check(mesh, LOW_MM + 6.0, 5.2, 1.6).passed
    assert not layer_check(mesh, math.nan, 1.2, 1.6).passed
    config = CONFIG.changed(layers={"heights_mm": [4.8, 6.4], "base_mm": 1.0, "layer_height_mm": 1.6})
    assert heights_check(mesh, np.array([4.8, 6.4]), config).passed
    off = heights_check(mesh, np.array([4.4, 6.0]), config)
    assert not off.passed
    assert "layers.heights_mm" in off.remedy
    uneven = np.array([4.8, 6.4, 7.2])
    assert heights_check(mesh, uneven, config.changed(layers={"heights_mm": uneven.tolist()})).passed


def test_the_journal_keeps_what_was_not_released(part, monkeypatch, tmp_path):
    another_wait_is_told(monkeypatch)
    built(part, tmp_path / "b")
    lines = [json.loads(line) for line in (tmp_path / "b" / "journal.jsonl").read_text().splitlines()]
    assert [line["kind"] for line in lines if line["kind"] in ("layer", "kept")] == ["layer", "kept"]
    assert not (tmp_path / "b" / "layers" / "MAIN_K0002R1").exists()
