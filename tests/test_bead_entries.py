"""A bead is entered wherever the beam comes on: plan, events and text agree on it, and nothing else tells them."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import shapely

from benchmarks.faults.program_text import without_comments
from ebamcheck.checks.interpass_checks import INTERPASS, text_beads, text_bed_k, text_shapes
from ebamcheck.controls.gcode.writing import write_plain_gcode
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.layers.stack import from_polygons
from ebamcheck.pipeline.stages import bead_paths, contour_curves, power_by_wire
from ebamcheck.program import read_program, verify_program
from ebamcheck.scan.islands.regions import contour_region
from ebamcheck.scan.plan.laying import bead_sequence, contour_beads
from ebamcheck.scan.plan.stacking import stack_plans
from ebamcheck.scan.plan.whole_part import Stack, ordered_layers
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import planned_path
from ebamcheck.writing.events import MOVE, WAIT, process_events

LAYERS = 4
CONFIG = Config().changed(
    scan={"annealing_steps": 100},
    machine={"control": "plain-gcode", "curve_form": "lines", "rapid_mm_s": 1e6},
)
"""Moves that take no time: the way to the first contour is not known to a plan."""

ENDS = {
    "plain ends": {},
    "overlap": {"overlap_mm": 6.0, "seam_shift_mm": 9.0},
    "ramps": {"ramp_up_mm": 4.0, "crater_fill_mm": 5.0, "ramp_power": 0.4},
    "ramps longer than beads": {"ramp_up_mm": 40.0, "crater_fill_mm": 30.0},
    "all of them": {"overlap_mm": 3.0, "ramp_up_mm": 6.0, "ramp_steps": 7},
}

SECTION = (
    shapely.box(-18, -10, 18, 10)
    .buffer(8, 32)
    .difference(shapely.Point(-10, 0).buffer(8, 32))
    .difference(shapely.Point(14, 0).buffer(5, 32))
)
"""Bores that part the lines of islands, and leave gaps to fill."""

ROUNDING_K = 0.2
"""Times and power of a text are rounded to its decimals."""


class Made:
    """A block with bores, planned and written."""

    def __init__(self, config, folder):
        self.config = config
        heights = (np.arange(LAYERS) + 0.5) * config.layer_height_mm
        self.layers = from_polygons(heights, [[SECTION]] * LAYERS)
        stack = Stack([self.layers.section(k) for k in range(LAYERS)], heights, range(LAYERS))
        contours = [contour_region(section, config) for section in stack.sections]
        beads = contour_curves(self.layers, contours, config)
        self.powers, by_wire = [], power_by_wire(stack.sections, beads, config)

        def power_of(layer, thickness_mm):
            self.powers.append(by_wire(layer, thickness_mm))
            return self.powers[-1]

        self.ordered = list(
            ordered_layers(stack, config, config.scan.order, 0, carry=True, power_of=by_wire and power_of)
        )
        self.plan = stack_plans(self.ordered, config, config.scan.order, 0)
        self.curves = bead_paths(self.layers, self.plan, config)
        self.files = write_plain_gcode(self.curves, self.plan, config, folder)

    def planned(self, layer):
        """Beads of one layer by the plan."""
        done = self.ordered[layer]
        heat = done.islands.cold_heat()
        contours = contour_beads(done.laid, self.config, heat)
        beads = bead_sequence(done.laid, contours, self.config, heat, done.order, done.options)[0]
        return replace(beads, power=self.powers[layer] if self.powers else None)

    def entries(self):
        """Beads of the text as they are entered, with nothing known but the text."""
        nc = read_program(self.files.main, self.config)
        beads = text_beads(nc, self.config)
        return (
            nc,
            beads,
            text_bed_k(beads, self.config, text_shapes(nc, self.config, list(self.plan.sections)))[0],
        )


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    return Made(CONFIG, tmp_path_factory.mktemp("block") / "p")


@pytest.mark.parametrize("ends", ENDS)
def test_the_heat_of_a_plan_is_that_of_its_events_and_of_its_text(ends, tmp_path):
    config = CONFIG.changed(process=ENDS[ends])
    made = Made(config, tmp_path / "p")
    events = process_events(planned_path(made.curves, made.plan, config), made.plan, config)
    metal = events[~events["role"].isin([MOVE, WAIT])]
    joules = (metal["power_w"] * metal["time_s"]).groupby(metal["layer"]).sum()
    seconds = metal["time_s"].groupby(metal["layer"]).sum()
    starts = metal["starts"].groupby(metal["layer"]).sum()
    for k in range(LAYERS):
        beads = made.planned(k)
        on = beads.at_share(made.plan.metrics["power_share"][k]).on
        assert beads.time_s.sum() == pytest.approx(seconds[k], rel=1e-4)
        assert config.process.power_w * (beads.time_s @ on) == pytest.approx(joules[k], rel=1e-4)
        assert len(beads) == starts[k]
    planned_k = np.concatenate([layer.heat.mean_k for layer in made.ordered])
    _, found, bed_k = made.entries()
    assert len(found) == starts.sum()
    assert planned_k == pytest.approx(bed_k, abs=ROUNDING_K)
    assert (bed_k <= entry_limit_k(config)).all()


def test_islands_have_further_beads_and_each_of_them_is_entered_under_the_limit(block):
    _, beads, bed_k = block.entries()
    inner = np.concatenate([block.planned(k).inner for k in range(LAYERS)])
    assert inner.sum() >= 8
    assert block.plan.inner_wait_s.any()
    assert len(block.plan.further_beads()) == inner.sum()
    # Warm ones among them: they are held to the limit, not far from it.
    assert entry_limit_k(CONFIG) - 20.0 < bed_k[inner].max() <= entry_limit_k(CONFIG)
    assert len(beads) == inner.size


def test_comments_have_no_say_in_where_beads_are_entered(block, tmp_path):
    _, beads, bed_k = block.entries()
    text = block.files.main.read_text()
    bare = tmp_path / block.files.main.name
    bare.write_text(without_comments(text))
    assert bare.read_text() != text
    again = text_beads(read_program(bare, CONFIG), CONFIG)
    assert again.row.tolist() == beads.row.tolist()
    assert again.wait_s.tolist() == beads.wait_s.tolist()
    shapes = text_shapes(read_program(bare, CONFIG), CONFIG, list(block.plan.sections))
    assert text_bed_k(again, CONFIG, shapes)[0] == pytest.approx(bed_k, abs=1e-9)


def test_waits_within_islands_that_are_left_out_shut_the_gate(block, tmp_path):
    text = block.files.main.read_text()
    # A wait within an island is followed by a move; one before a contour or an island by its comment.
    less, count = re.subn(r"^G4 .*\n(?=G0 X)", "", text, flags=re.MULTILINE)
    assert count > 3
    for changed, sound in ((text, True), (less, False)):
        path = tmp_path / block.files.main.name
        path.write_text(without_comments(changed))
        nc = read_program(path, CONFIG)
        checks = {c.name: c for c in verify_program(nc, config=CONFIG, layers=block.layers, heat=True)}
        assert checks[INTERPASS].passed is sound
        known = {"plan": block.plan, "curves": block.curves}
        checks = {c.name: c for c in verify_program(nc, config=CONFIG, layers=block.layers, **known)}
        assert checks["layer pause"].passed is sound
    assert "further bead of island" in checks["layer pause"].text
