"""Plan and text find the same temperatures where beads are entered, on parts whose upper layers shrink to nothing."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from ebamcheck.checks.interpass_checks import INTERPASS, heat_checks, text_beads, text_bed_k, text_shapes
from ebamcheck.controls.sinumerik.writing import write_program
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.layers.stack import from_polygons
from ebamcheck.pipeline.stages import bead_paths, contour_curves, power_by_wire
from ebamcheck.program import read_program
from ebamcheck.scan.islands.regions import contour_region
from ebamcheck.scan.plan.stacking import stack_plans
from ebamcheck.scan.plan.whole_part import Stack, ordered_layers
from ebamcheck.settings.config import Config

CONFIG = Config().changed(scan={"annealing_steps": 100})
INSTANT = {"rapid_mm_s": 1e6}
"""Moves that take no time: then nothing of plan and text differs."""

LAYERS = 10
ROUNDING_K = 0.1
"""Times and power of a text are rounded to its decimals."""

WAYS_K = 12.0
"""What a surface near the limit cools down in the second that the longest way over these parts takes."""


def disc(radius):
    return shapely.Point(3, 2).buffer(max(radius, 0.0), 64)


def round_at(share):
    """Half width of a circle at a share of its height."""
    return float(np.sqrt(1.0 - (2.0 * share - 1.0) ** 2))


SHAPES = {
    "torus": lambda s: disc(40 + 8 * round_at(s)).difference(disc(40 - 8 * round_at(s))),
    "sphere": lambda s: disc(19 * round_at(s)),
    "cone": lambda s: disc(26 * (1 - s)),
    "ellipsoid": lambda s: shapely.affinity.scale(disc(17 * float(np.sqrt(1 - s**2))), 2.0, 1.0),
    # Thin in the middle of its height: heat under the layers of contours alone goes on to those above.
    "waist": lambda s: disc(22.0 if abs(s - 0.5) > 0.15 else 5.0),
    "tube": lambda s: disc(30).difference(disc(22)),
}


def made(shape, config, folder):
    """A part planned and written: the plan, its mean temperatures at every entry, and the program."""
    heights = (np.arange(LAYERS) + 0.5) * config.layer_height_mm
    layers = from_polygons(heights, [[shape((k + 0.5) / LAYERS)] for k in range(LAYERS)])
    order, seed = config.scan.order, config.scan.seed
    stack = Stack([layers.section(k) for k in range(LAYERS)], heights, range(LAYERS))
    contours = [contour_region(section, config) for section in stack.sections]
    beads = contour_curves(layers, contours, config)
    power_of = power_by_wire(stack.sections, beads, config)
    done = list(ordered_layers(stack, config, order, seed, carry=True, power_of=power_of))
    plan = stack_plans(list(done), config, order, seed)
    files = write_program(bead_paths(layers, plan, config), plan, config, folder)
    return plan, np.concatenate([layer.heat.mean_k for layer in done]), read_program(files.main, config)


def entries_of_text(nc, config, plan):
    beads = text_beads(nc, config)
    return beads, *text_bed_k(beads, config, text_shapes(nc, config, list(plan.sections)))


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", SHAPES)
def test_plan_and_text_enter_every_bead_at_the_same_temperature(name, tmp_path):
    config = CONFIG.changed(machine=INSTANT)
    plan, planned_k, nc = made(SHAPES[name], config, tmp_path / "p")
    beads, text_k, leave_k = entries_of_text(nc, config, plan)
    assert planned_k == pytest.approx(text_k, abs=ROUNDING_K)
    known = leave_k < config.material.boiling_k
    assert plan.metrics["leave_k"][known].to_numpy() == pytest.approx(leave_k[known], abs=ROUNDING_K)
    assert set(beads.layer) == set(range(LAYERS))


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", SHAPES)
def test_no_bead_is_entered_warmer_than_planned_and_every_layer_has_a_figure(name, tmp_path):
    plan, planned_k, nc = made(SHAPES[name], CONFIG, tmp_path / "p")
    beads, text_k, _ = entries_of_text(nc, CONFIG, plan)
    # Ways to contours are planned by the shortest ones: the text comes later, never sooner.
    assert (text_k < planned_k + ROUNDING_K).all()
    assert (text_k > planned_k - WAYS_K).all()
    # Contours and islands alike are held to the limit: none without a figure, none over it.
    entry_k = plan.metrics["entry_max_k"].to_numpy() + CONFIG.process.ambient_temperature_k
    assert (entry_k <= entry_limit_k(CONFIG)).all()
    assert np.isfinite(plan.metrics["enter_k"]).all()
    hottest_k = np.array([planned_k[beads.layer == k].max() for k in range(LAYERS)])
    assert (hottest_k <= entry_k + 1e-6).all()
    checks = {check.name: check for check in heat_checks(nc, CONFIG, list(plan.sections))}
    assert checks[INTERPASS].passed, checks[INTERPASS].text
