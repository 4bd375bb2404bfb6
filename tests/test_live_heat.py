"""Heat of a live layer: its text alone is entered as warm as its plan says, on what the layer below left."""

from __future__ import annotations

import pytest
from command_line import write_stl

import ebamcheck
from ebamcheck.live.heat_so_far import HeatSoFar
from ebamcheck.live.making import LayerMaker, Wanted
from ebamcheck.program.checking.interpass_checks import INTERPASS
from ebamcheck.settings.config import Config
from tests.parts import box

THICKNESS_MM = 1.7


def test_the_first_bead_is_entered_as_warm_as_planned(tmp_path):
    # The rise at the end of the program below cools the surface by kelvins: it is in no text of the layer above.
    part = tmp_path / "box.stl"
    write_stl(box(upper=(60, 40, 12)), part)
    config = Config().changed(process={"interpass_at": "layer", "interpass": "off"})
    with LayerMaker(ebamcheck.load(part), config) as maker:
        heat = HeatSoFar.cold(config)
        for layer in range(3):
            wanted = Wanted(layer, layer * THICKNESS_MM, THICKNESS_MM, f"MAIN_K{layer}")
            made = maker.make(wanted, heat, tmp_path / str(layer))
            (entry,) = (check for check in made.checks if check.name == INTERPASS)
            if layer:
                assert entry.value == pytest.approx(made.heat.last.mean_k[0], abs=0.5)
            heat = made.heat
