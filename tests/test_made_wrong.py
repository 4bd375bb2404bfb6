"""Mistakes in the code that makes programs, planted one by one: each leaves a program that agrees with its own plan, and a gate shuts."""

from __future__ import annotations

import pytest
import shapely
from prism_program import Made

from ebamcheck.metal import target
from ebamcheck.settings import wire_speed

FRAME = shapely.box(0, 0, 60, 40).difference(shapely.box(24, 14, 38, 26))


# -- metal -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_wrong_section_of_the_wire_is_found(factor, monkeypatch, tmp_path):
    right = wire_speed.wire_mm2
    monkeypatch.setattr(wire_speed, "wire_mm2", lambda config: factor * right(config))
    assert "metal" in Made(tmp_path, FRAME).failed()


def test_cells_with_too_little_of_the_section_are_found(monkeypatch, tmp_path):
    right = target.cell_shares
    monkeypatch.setattr(target, "cell_shares", lambda *given: 0.965 * right(*given))
    assert "metal" in Made(tmp_path, FRAME).failed()
