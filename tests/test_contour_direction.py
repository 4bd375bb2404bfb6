"""The direction of contours, which a setting turns over from layer to layer."""

import numpy as np
import pytest
import shapely
from prism_program import CONFIG, Made

from ebamcheck.curves.columns import turned_over
from ebamcheck.program import read_program, verify_program, write_program

RING = shapely.Point(0, 0).buffer(40, 32).difference(shapely.Point(0, 0).buffer(20, 32))
SHAPED = {"overlap_mm": 4.0, "seam_shift_mm": 15.0, "ramp_up_mm": 3.0, "crater_fill_mm": 3.0}


def turns(nc, layer):
    """Sense of every contour of a layer, outer one first: twice the area to the left of its path."""
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0) & (nc.layer == layer))
    found = []
    for ring in np.unique(nc.ring[rows]):
        _, points = nc.samples(rows[nc.ring[rows] == ring], 0.5)
        x, y = points.T
        found.append(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))
    return np.sign(sorted(found, key=abs, reverse=True)).tolist()


@pytest.mark.parametrize("direction", ["same", "alternating"])
@pytest.mark.parametrize("ends", [{}, SHAPED])
def test_contours_run_as_the_setting_says_and_pass_all_checks(tmp_path, direction, ends):
    made = Made(tmp_path, RING, CONFIG.changed(process={"contour_direction": direction, **ends}))
    nc = made.read()
    checks = verify_program(nc, config=made.config, curves=made.beads, plan=made.plan, layers=made.layers, beads=True)
    assert [(c.name, c.text) for c in checks if not c.passed] == []
    for layer in range(4):
        other_way = direction == "alternating" and layer % 2 == 1
        assert turns(nc, layer) == ([-1.0, 1.0] if other_way else [1.0, -1.0])


def test_arcs_alternate_between_g3_and_g2(tmp_path):
    made = Made(
        tmp_path,
        shapely.Point(0, 0).buffer(40, 32),
        CONFIG.changed(process={"contour_direction": "alternating"}, machine={"curve_form": "arcs"}),
    )
    for k in range(1, 5):
        text = (made.files.folder / f"MAIN_L{k:04d}.SPF").read_text()
        assert (" G3 " in text, " G2 " in text) == ((True, False) if k % 2 else (False, True))


def test_a_ring_turned_over_is_the_same_curve(tmp_path):
    beads = Made(tmp_path, RING).beads
    rings = np.arange(beads.closed.size) % 2 == 0
    turned = turned_over(beads, rings)
    twice = turned_over(turned, rings)
    for name in ("kind", "control", "control_starts", "knot_starts"):
        assert np.array_equal(getattr(twice, name), getattr(beads, name)), name
    assert np.allclose(twice.knots, beads.knots, atol=1e-9)
    for ring in range(beads.closed.size):
        there, back = list(beads.pieces_of(ring)), list(turned.pieces_of(ring))
        for i, j in zip(there, reversed(back) if rings[ring] else back, strict=True):
            whole = beads.lengths()[i] if beads.kind[i] != 1 else beads.piece(i).knots[-1]
            t = np.linspace(0.0, whole, 9)
            other = t[::-1] if rings[ring] else t
            assert np.allclose(turned.evaluate(j, other), beads.evaluate(i, t), atol=1e-9)


def test_a_contour_driven_against_its_plan_is_found(tmp_path):
    made = Made(tmp_path, RING, CONFIG.changed(process={"contour_direction": "alternating"}))
    other = turned_over(made.beads, np.arange(made.beads.closed.size) == 3)
    for ends in ({}, SHAPED):
        config = made.config.changed(process=ends)
        files = write_program(other, made.plan, config, tmp_path / f"turned {len(ends)}")
        checks = verify_program(read_program(files.main, config), config=config, curves=made.beads, plan=made.plan)
        (found,) = [check for check in checks if check.name == "contour rings"]
        assert not found.passed
        assert found.where.startswith("MAIN_L0002.SPF:")
        assert "contour ring 3 is driven the other way" in found.text
