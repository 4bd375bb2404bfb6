"""Heat and metal of live layers: each is entered as warm as its plan says, on what those below left, and all together are judged again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from command_line import write_stl
from live_boxes import maker_of, run_of_box

import ebamcheck
from ebamcheck.checks.interpass_checks import INTERPASS
from ebamcheck.live import building as building_module
from ebamcheck.live import verifying
from ebamcheck.live.before import Before
from ebamcheck.live.building import Building
from ebamcheck.live.making import LayerMaker, Wanted
from ebamcheck.live.verifying import FollowedLayers, LayerText, verify_build
from ebamcheck.settings.config import Config
from tests.parts import box

THICKNESS_MM = 1.7


def test_the_first_bead_is_entered_as_warm_as_planned(tmp_path):
    # The rise at the end of the program below cools the surface by kelvins: it is in no text of the layer above.
    part = tmp_path / "box.stl"
    write_stl(box(upper=(60, 40, 12)), part)
    config = Config().changed(process={"interpass_at": "layer", "interpass": "off"})
    with LayerMaker(ebamcheck.load(part), config) as maker:
        before = Before.cold(config)
        for layer in range(3):
            wanted = Wanted(layer, layer * THICKNESS_MM, THICKNESS_MM, f"MAIN_K{layer}")
            made = maker.make(wanted, before, tmp_path / str(layer))
            (entry,) = (check for check in made.checks if check.name == INTERPASS)
            if layer:
                assert entry.value == pytest.approx(made.after.last.mean_k[0], abs=0.5)
            before = made.after


# -- over all layers, by their texts ------------------------------------------------------------------


class Blind(FollowedLayers):
    """What follows the texts and says nothing of them."""

    def too_warm(self, program, paper, config):
        return ""


class Forgetful(Building):
    """A server that takes every layer to lie on cold metal."""

    def _take(self, reading, answer, layer):
        super()._take(reading, answer, layer)
        cold = Before.cold(self.maker.config)
        self.before = replace(self.before, part=cold.part, last=None)


class Levelled(Building):
    """A server that takes every layer to lie on a level plate."""

    def _take(self, reading, answer, layer):
        super()._take(reading, answer, layer)
        warm, level = self.before, Before.plate(self.maker.part, self.maker.config)
        self.before = replace(level, part=warm.part, last=warm.last)


class Impatient(Building):
    """A server that tells no wait before a layer, in the journal as in the certificates."""

    def _made(self, reading):
        answer, made = super()._made(reading)
        if made is None:
            return answer, made
        staged, layer, certificate = made
        return answer, (staged, replace(layer, wait_s=0.0), {**certificate, "wait_s": 0.0})


@pytest.mark.parametrize(
    ("server", "found"), [(Building, ""), (Forgetful, "heat"), (Impatient, "heat"), (Levelled, "metal")]
)
def test_verify_follows_heat_and_metal_over_all_layers(
    server, found, monkeypatch, tmp_path_factory, tmp_path
):
    # A server that looks at it itself releases no such layer (test_live_made_wrong.py).
    monkeypatch.setattr(building_module, "FollowedLayers", Blind)
    place = run_of_box(tmp_path_factory, (30, 24, 12))
    with maker_of(place) as maker:
        building = server(maker, tmp_path / "b")
        answer = building.start()
        for done in range(1, 7):
            height_mm = answer["base_mm"] + answer["thickness_mm"]
            answer = building.height({"done": done, "height_mm": height_mm})
            assert answer["answer"] == "published"
        building.close()
    layers = verify_build(tmp_path / "b", place / "box.stl")
    wrong = [layer for layer in layers if not layer.passed]
    assert bool(wrong) == bool(found)
    assert all(layer.why.startswith(f"{found} over all layers: ") for layer in wrong)


def test_a_slim_column_on_a_wide_foot_is_followed_from_the_plate_up(monkeypatch):
    """The foot takes up the heat: the uppermost layers on a plate of their own would be far too warm."""
    foot, column = shapely.box(0, 0, 150, 150), shapely.box(0, 0, 30, 24)

    def text(section, beads):
        off_s = np.full(beads, 0.3)
        off_s[0] = 60.0
        return LayerText(section, 1.7, Config(), off_s, np.full(beads, 30.0), np.full(beads, 9e4))

    def said(layers):
        texts = iter(layers)
        monkeypatch.setattr(verifying, "layer_text", lambda *_: next(texts))
        stack, found = FollowedLayers(), []
        for _ in layers:
            found.append(stack.too_warm(None, {}, Config()))
            stack.take()
        return found

    layers = [text(foot, 20)] * 6 + [text(column, 1)] * 10
    assert said(layers) == [""] * 16
    assert any(said(layers[6:]))
    assert said([*layers, None, text(column, 40), text(column, 40)])[16:] == [""] * 3
