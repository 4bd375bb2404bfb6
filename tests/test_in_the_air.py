"""Metal in the air: an island of a layer under which nothing stands, nor beside it, and beads that reach far out."""

from __future__ import annotations

from dataclasses import replace

import pytest
import shapely
from motion_faults import POSTS, SHAPES, checks_of, made, written

from ebamcheck.pipeline import noticed_in_program
from ebamcheck.program import Check
from ebamcheck.settings.config import Config

BLOCK = shapely.box(0, 0, 30, 30)
ASIDE = shapely.box(60, 0, 84, 24)
AIR = {
    "a body that begins in the air": lambda k: BLOCK if k < 2 else shapely.union_all([BLOCK, ASIDE]),
    "a body over an empty layer": lambda k: BLOCK if k != 1 else shapely.Polygon(),
}
STANDS = {
    "a cap far beyond its stem": lambda k: BLOCK if k < 2 else BLOCK.buffer(14.0, join_style="mitre"),
    "a body that leans by less than its width": lambda k: shapely.box(20 * k, 0, 20 * k + 30, 30),
    "two bodies on the plate": lambda k: shapely.union_all([BLOCK, ASIDE]),
}


def support_of(tmp_path, monkeypatch, shape, control, planned=False):
    monkeypatch.setitem(SHAPES, "now", shape)
    part = made("now")
    return checks_of(written(part, control, tmp_path / "p"), part, planned)["support"]


@pytest.mark.parametrize("control", POSTS)
@pytest.mark.parametrize("shape", AIR)
def test_metal_that_begins_in_the_air_is_found(tmp_path, monkeypatch, shape, control):
    found = support_of(tmp_path, monkeypatch, AIR[shape], control)
    assert not found.passed
    assert "begin in the air" in found.text
    assert found.value > 30.0


@pytest.mark.parametrize("shape", STANDS)
def test_what_hangs_on_metal_that_stands_is_not_in_the_air(tmp_path, monkeypatch, shape):
    assert support_of(tmp_path, monkeypatch, STANDS[shape], "linuxcnc").passed


def test_an_overhang_that_nothing_limits_is_warned_of_where_beads_hang_in_the_air():
    reach = Check(
        "overhang", True, 85.6, 90.0, "deg", "MAIN_L0010.SPF:35", "layers reach out by up to 85.6 deg"
    )
    (told,) = noticed_in_program.of_overhang([reach], Config())
    assert (told.severity, told.code, told.place) == ("warning", "overhang-unlimited", "MAIN_L0010.SPF:35")
    # A bead of 6 mm in layers of 1.68 mm: its centre line lies over metal up to 74 degrees.
    assert told.limit == pytest.approx(74.4, abs=0.1)
    assert not list(noticed_in_program.of_overhang([replace(reach, value=74.0)], Config()))
    limited = Config().changed(process={"largest_overhang_deg": 89.0})
    assert not list(noticed_in_program.of_overhang([reach], limited))
