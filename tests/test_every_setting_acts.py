"""Every setting of process, plan, material and machine is read by what a run does.

Changed alone, it changes a refusal, the plan, the program or what a check says. That a limit is told to be wide
(``limit-widened``) does not count: that is said of the value, whether or not anything is held against it.
"""

from __future__ import annotations

import json
import re
from itertools import zip_longest
from typing import Any

import numpy as np
import pytest
import shapely
from shapely import affinity

from ebamcheck.checks.metal import deposit
from ebamcheck.errors import EbamcheckError
from ebamcheck.layers.stack import from_polygons
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.pipeline import findings
from ebamcheck.pipeline.stages import bead_paths
from ebamcheck.program import read_program, verify_program, write_program
from ebamcheck.scan import plan_stack
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import checked_window

PART = shapely.box(0, 0, 70, 50).difference(shapely.Point(30, 25).buffer(8, 24))
LAYERS = 2
SECTIONS = ("process", "scan", "material", "machine")
QUICK = {"scan": {"annealing_steps": 200, "hexagon_side_mm": 12.0}}
RAMPS = {"process": {"ramp_up_mm": 3.0, "crater_fill_mm": 3.0}}
# A clamp that a wide head meets, if it hangs low
POST_BESIDE = {"outline_mm": ((95.0, 0.0), (100.0, 0.0), (100.0, 50.0)), "z_mm": (0.0, 60.0)}

# Other values of settings; those that are not here are told by :func:`other`
CHANGED: dict[str, Any] = {
    "process.least_entry_temperature_k": 860.0,
    "process.current_max_ma": 100.0,
    "process.layer_over_bead": (1.5, 2.0),
    "process.line_energy_j_mm": (1000.0, 3000.0),
    "process.voltage_window_kv": (70.0, 200.0),
    "process.current_window_ma": (200.0, 1000.0),
    "process.travel_window_mm_s": (20.0, 100.0),
    "process.bead_section_mm2": (20.0, 60.0),
    "process.metal_energy_j_mm3": (300.0, 600.0),
    "process.wire_speed_min_mm_s": 50.0,
    "process.wire_speed_max_mm_s": 20.0,
    "process.feed_along_path": True,
    "process.surface_temperature_k": 2500.0,
    "material.conductivity_w_mk": 4.0,
    "process.least_wall_mm": 30.0,
    "process.least_hole_mm": 20.0,
    "process.surface_tolerance_mm": 0.01,
    "process.seam_shift_mm": 12.0,
    "process.layer_pause_s": 500.0,
    "process.longest_wait_s": 2.0,
    "process.interpass_limit_k": 700.0,
    "process.power_schedule": ((0.0, 0.9),),
    "process.least_seam_distance_mm": 5.0,
    "process.travel_sectors_deg": ((0.0, 10.0),),
    "process.keep_out": ({"outline_mm": ((0.0, 0.0), (20.0, 0.0), (20.0, 20.0))},),
    "process.largest_overhang_deg": 20.0,
    "process.ramp_power": 0.7,
    "process.ramp_up_window_s": (5.0, 6.0),
    "process.crater_fill_window_s": (5.0, 6.0),
    "scan.order": "raster",
    "scan.seed": 3,
    "scan.stride": 3,
    "scan.hexagon_side_mm": 8.0,
    "scan.contour_offset_mm": 2.0,
    "scan.least_coverage": 0.9999,
    "scan.gap_width": 0.02,
    "scan.travel_share": 0.1,
    "scan.start_travel_mm": 200.0,
    "scan.annealing_steps": 0,
    "material.name": "316L",
    "material.solidus_k": 800.0,
    "material.boiling_k": 800.0,
    "material.conductivity_by_temperature": ((293.0, 15.0), (3533.0, 30.0)),
    "material.heat_capacity_by_temperature": ((293.0, 500.0), (3533.0, 900.0)),
    "machine.name": "another machine",
    "machine.control": "linuxcnc",
    "machine.line_tolerance_mm": 0.1,
    "machine.decimals": 4,
    "machine.bspline_shift": 3,
    "machine.travel_min_mm": (10.0, -1000.0, 0.0),
    "machine.travel_max_mm": (20.0, 1000.0, 1500.0),
    "machine.base_plate_min_mm": (10.0, 10.0),
    "machine.base_plate_max_mm": (20.0, 20.0),
    "machine.park_mm": (50.0, 10.0),
    "machine.program_limit_mb": 0.001,
    "machine.spool_kg": 0.01,
    "machine.cathode_h": 0.001,
    "machine.feed_min_mm_s": 20.0,
    "machine.feed_max_mm_s": 5.0,
    "machine.head_radius_mm": 60.0,
    "machine.head_above_tip_mm": 80.0,
    "machine.work_offset": "G55",
    "machine.smoothing": ("G64",),
    "machine.smoothing_tolerance_mm": 0.2,
    "machine.workpiece_directory": "ANOTHER",
    "machine.program_name": "OTHER",
    "machine.beam_codes": ("M60: off",),
    "machine.wire_codes": ("M62: off",),
    "machine.aux_codes": ("M60",),
    "machine.beam_on": ("M60 ; gun on",),
    "machine.beam_off": ("M61 ; gun off",),
    "machine.set_beam": ("H1={voltage_kv}", "H2={current_ma}"),
    "machine.set_power": ("H2={current_ma}",),
    "machine.wire_start": ("H3={wire_mm_s}", "M62"),
    "machine.set_wire": ("H3={wire_mm_s}",),
    "machine.wire_stop": ("M63",),
    "machine.wire_retract": ("H4={wire_retract_mm}",),
    "machine.layer_pause": ("G4 F{layer_pause_s}",),
    "machine.set_focus": ("H5={defocus}",),
    "machine.layer_begin": ("; layer {layer} begins",),
    "machine.layer_end": ("; layer {layer} ends",),
    "machine.rotary": ({"name": "A"},),
}

# Settings with which others act at all
GIVEN: dict[str, dict[str, Any]] = {
    **dict.fromkeys(("process.ramp_power", "process.ramp_steps", "process.ramp_up_window_s", "process.crater_fill_window_s"), RAMPS),
    "process.longest_wait_s": {"process": {"layer_pause_s": 10.0}},
    # Contours need more wire than hatch lines: here more than there is.
    "process.feed_along_path": {"process": {"wire_speed_max_mm_s": 38.0}},
    "scan.stride": {"scan": {"order": "stride"}},
    "scan.seed": {"scan": {"order": "random"}},
    "machine.poly_licensed": {"machine": {"curve_form": "poly"}},
    "machine.bspline_licensed": {"machine": {"curve_form": "bspline"}},
    "machine.bspline_shift": {"machine": {"curve_form": "bspline"}},
    "machine.line_tolerance_mm": {"machine": {"curve_form": "lines"}},
    "machine.set_power": RAMPS,
    "machine.head_radius_mm": {"process": {"keep_out": (POST_BESIDE,)}},
    "machine.head_above_tip_mm": {"process": {"keep_out": (POST_BESIDE,)}, "machine": {"head_radius_mm": 60.0}},
    "machine.layer_pause": {"process": {"layer_pause_s": 10.0}},
    "machine.wire_retract": {"process": {"wire_retract_mm": 2.0}},
}  # fmt: skip

# Settings that act on other runs than this one, and on which
ELSEWHERE = {
    "process.pyrometer_limit_k": "a measured temperature comes while a build goes on (tests/test_pyrometer.py)",
    "material.melt_mixing": "heat above the liquidus (tests/test_heat_referee.py)",
    "machine.live_r": "the main program that waits between layers (tests/test_handshake.py)",
    "machine.live_poll_s": "the same",
    "machine.live_timeout_s": "the same",
    "machine.live_late": "the same",
    "machine.set_focus": "preheating alone sets the focus",
    "machine.tilt_axes": "parts on a tilt table (tests/test_tilt_table.py)",
    "machine.rotary": "the same",
    "machine.smoothing_tolerance_mm": "the feeds of a program beside those of polygons (tests/test_kinematics.py)",
    "scan.start_travel_mm": "the price of travel on many islands (tests/test_scan_improvement.py)",
    "scan.travel_share": "the same",
    "scan.annealing_steps": "the same",
}


def fields():
    """Names of all settings of the sections."""
    return [f"{section}.{key}" for section in SECTIONS for key in type(getattr(Config(), section)).model_fields]


def other(name: str, config: Config) -> Any:
    """Another value of a setting: the one in the table, the other of two, or one a little less."""
    if name in CHANGED:
        return CHANGED[name]
    section, _, key = name.partition(".")
    value = getattr(getattr(config, section), key)
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return 0.93 * value if value else 1.0
    choices = re.findall(r"'([\w-]+)'", str(type(getattr(config, section)).model_fields[key].annotation))
    return next(choice for choice in choices if choice != value)


def outcome(config: Config, folder, part=PART):
    """Yield what a run with these settings comes to, the quickest first."""
    try:
        checked_window(config)
        heights = (np.arange(LAYERS) + 0.5) * config.layer_height_mm
        layers = from_polygons(heights, [[part]] * LAYERS)
        plan = plan_stack(layers, config)
        yield plan.metrics.to_csv()
        beads = bead_paths(layers, plan, config)
        files = write_program(beads, plan, config, folder)
        texts = [(files.folder / name).read_text() for name in files.names]
        yield list(files.names), [re.sub(r"(?im)^.*sha-256.*$", "", text) for text in texts]
        nc = read_program(files.main, config)
        found = deposit(nc, layers, deposition_heights(heights, config.layer_height_mm), config, asked=True)
        checks = verify_program(
            nc, config=config, curves=beads, plan=plan, layers=layers,
            beads=True, metal=True, heat=True, laid=lambda: found,
        )  # fmt: skip
        yield [(c.name, c.passed, c.value, c.limit, c.text) for c in checks]
        yield list(findings.heat_findings(plan, config))
    except EbamcheckError as error:
        yield str(error)


BASE: dict[str, list[Any]] = {}  # What runs come to without the change, by what is given


def changed(config: Config, sections) -> Config:
    for name, keys in sections.items():
        config = config.changed(**{name: keys})
    return config


def acts(name: str, folder) -> bool:
    """Whether a setting changes what a run comes to."""
    given = GIVEN.get(name, {})
    config = changed(Config().changed(**QUICK), given)
    section, _, key = name.partition(".")
    try:
        another = config.changed(**{section: {key: other(name, config)}})
    except EbamcheckError:
        return True
    # A rectangle around a part that lies along the axes is the same by every rule.
    part = affinity.rotate(PART, 17.0) if name == "scan.rectangle" else PART
    of_given = json.dumps([given, part.wkt], default=str)
    if of_given not in BASE:
        BASE[of_given] = list(outcome(config, folder / "without", part))
    return any(a != b for a, b in zip_longest(outcome(another, folder / "with", part), BASE[of_given]))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in fields() if name not in ELSEWHERE])
def test_a_setting_acts(name, tmp_path):
    assert acts(name, tmp_path)


def test_the_tables_name_settings_that_there_are():
    assert {*CHANGED, *GIVEN, *ELSEWHERE} <= set(fields())


@pytest.mark.slow
def test_without_a_change_a_run_comes_to_the_same(tmp_path):
    """So that a setting which nothing reads is seen."""
    config = Config().changed(**QUICK)
    first, again = (list(outcome(config, tmp_path / name)) for name in ("first", "again"))
    assert first == again
    assert len(first) == 4
