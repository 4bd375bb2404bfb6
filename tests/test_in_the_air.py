"""Metal in the air: an island of a layer under which nothing stands, nor beside it, and beads that reach far out."""

from __future__ import annotations

import pytest
import shapely
from motion_faults import POSTS, SHAPES, checks_of, made, written

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
