"""Power of layers of several parts, judged from the text alone: the balance of a text spreads heat over all of them."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from ebamcheck.controls.gcode.writing import write_plain_gcode
from ebamcheck.layers.stack import from_polygons
from ebamcheck.pipeline.stages import bead_paths, plan_program
from ebamcheck.program import read_program, verify_program
from ebamcheck.settings.config import Config

CONFIG = Config().changed(
    scan={"annealing_steps": 100}, machine={"control": "plain-gcode", "curve_form": "lines"}
)


def tube(x, outer, inner):
    return shapely.Point(x, 0).buffer(outer, 32).difference(shapely.Point(x, 0).buffer(inner, 32))


PARTS = [tube(0, 30, 15), tube(160, 60, 38), tube(300, 60, 38)]


def plate(parts, count=2):
    heights = (np.arange(count) + 0.5) * CONFIG.layer_height_mm
    return from_polygons(heights, [parts] * count)


def power_check(parts, folder, config=CONFIG, count=2):
    layers = plate(parts, count)
    plan = plan_program(layers, config)
    files = write_plain_gcode(bead_paths(layers, plan, config), plan, config, folder)
    nc = read_program(files.main, config)
    checks = verify_program(nc, config=config, layers=layers, heat=True)
    return plan, next(check for check in checks if check.name == "power")


@pytest.mark.parametrize("parts", [PARTS, PARTS[:1]], ids=["three", "one"])
def test_power_that_is_taken_back_for_one_of_the_parts_is_no_fault(parts, tmp_path):
    plan, check = power_check(parts, tmp_path / "p")
    assert (plan.metrics["power_share"] < 1.0).all()
    assert check.passed, check.text


def test_under_a_low_limit_a_place_may_be_as_hot_as_it_while_the_section_is_cool(tmp_path):
    # Aluminium: 130 K over the chamber, of which the section as a whole has half.
    bores = shapely.MultiPoint([(20, 20), (60, 20), (40, 60)]).buffer(8, 16)
    plan, check = power_check(
        [shapely.box(0, 0, 80, 80).difference(bores)],
        tmp_path / "p",
        CONFIG.changed(material={"name": "Al 2319"}),
        6,
    )
    assert (plan.metrics["power_share"] < 0.5).all()
    assert check.passed, check.text
