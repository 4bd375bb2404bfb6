"""The feed of a layer follows its real height where wire and beam cannot, within every window, and the metal stays right."""

import math

import numpy as np
import pytest
import shapely
from command_line import FAST, ebamcheck, write_stl
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import box
from slicers_here import runs_cut_here as runs_cut_here

from ebamcheck.checks.metal import deposit
from ebamcheck.errors import SettingsError
from ebamcheck.heat.medium import melting_heat_j_kg
from ebamcheck.live.before import Before
from ebamcheck.live.building import Building
from ebamcheck.live.height_map import HeightMap, figures_of, in_cells
from ebamcheck.live.heights import (
    LOCAL,
    HeightRule,
    Limits,
    Slopes,
    at_layer_feed,
    at_speed,
    bead_limits,
    feed_limits,
    height_rule,
    speed_share,
    speed_window,
)
from ebamcheck.live.making import LayerMaker, Wanted
from ebamcheck.live.relaying import finished_run
from ebamcheck.metal import target_of
from ebamcheck.program import read_program
from ebamcheck.settings.checking import as_toml
from ebamcheck.settings.config import Config, load_config
from ebamcheck.settings.process_window import nominal_wire_speed_mm_s, outside_window, wire_area_mm2
from ebamcheck.verification.verify import verify
from tests.parts import join, sphere

NARROW = "[process]\nwire_speed_min_mm_s = 33.0\nwire_speed_max_mm_s = 60.0\n"
"""A feeder that has wire for layers of 1.54 to 2.79 mm at the feed of the process."""

MELT_J_KG = melting_heat_j_kg(Config())


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with a run of a box on a machine with a narrow range of wire speeds."""
    folder = tmp_path_factory.mktemp("feed")
    write_stl(box(upper=(36, 30, 7)), folder / "box.stl")
    (folder / "narrow.toml").write_text(NARROW)
    given_by = ("-c", "narrow.toml", "--layer-height", 1.75)
    done = ebamcheck("run", "box.stl", "-o", "box.run", "--backends", FAST, *given_by, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def maker(place):
    found = finished_run(place / "box.run")
    with LayerMaker(found.part, found.config, found.primary) as made:
        yield made


@settings(deadline=None, max_examples=150)
@given(
    st.floats(0.3, 6.0),
    st.floats(5.0, 60.0),
    st.floats(1.05, 6.0),
    st.floats(20.0, 250.0),
    st.sampled_from([(1.0, 1.0), LOCAL]),
)
def test_a_feed_keeps_every_window_and_is_the_nearest_that_does(height, least, ratio, current, room):
    config = Config().changed(
        process={
            "wire_speed_min_mm_s": least,
            "wire_speed_max_mm_s": least * ratio,
            "current_ma": current,
            "layer_over_bead": (0.1, 10.0),
            "line_energy_j_mm": (100.0, 4000.0),
        }
    )

    def kept(share):
        made = at_speed(config, share)
        wire = nominal_wire_speed_mm_s(made, height)
        process, machine = made.process, made.machine
        speed, power = process.travel_speed_mm_s, process.power_w
        melted_w = process.melting_efficiency * made.material.absorptivity * power
        return all(
            low * (1 - 1e-9) <= value <= high * (1 + 1e-9)
            for low, value, high in (
                (process.wire_speed_min_mm_s, wire * room[0], math.inf),
                (0.0, wire * room[1], process.wire_speed_max_mm_s),
                (machine.feed_min_mm_s, speed, machine.feed_max_mm_s),
                (process.travel_window_mm_s[0], speed, process.travel_window_mm_s[1]),
                (process.line_energy_j_mm[0], power / speed, process.line_energy_j_mm[1]),
                (process.metal_energy_j_mm3[0], power / (wire * wire_area_mm2(made)), process.metal_energy_j_mm3[1]),
                (0.0, wire * wire_area_mm2(made) * 1e-9 * made.material.density_kg_m3 * MELT_J_KG, melted_w),
            )
        )  # fmt: skip

    found = speed_share(config, height, room)
    grid = np.geomspace(*speed_window(config), 400)
    if found is None:
        assert not any(kept(share) for share in grid)
        return
    assert kept(found)
    # The share is rounded to four decimals.
    nearer = [s for s in (*grid, 1.0) if abs(math.log(s)) < abs(math.log(found)) and abs(s - found) > 2e-4]
    assert not any(kept(share) for share in nearer if (share - 1.0) * (found - 1.0) >= 0.0)
    # A bead by itself stays as high as it was: the limit of layers over it means the same.
    assert at_speed(config, found).process.bead_height_mm == pytest.approx(config.process.bead_height_mm)


def test_the_feed_of_the_process_stays_where_wire_and_beam_can_follow():
    config = Config()
    for height in np.linspace(1.0, bead_limits(config).most_mm, 30):
        assert at_layer_feed(config, float(height)) is config
    # On a measured surface, too, where the wire has room.
    assert at_layer_feed(config, 1.7, mapped=True) is config


def test_heights_that_the_wire_alone_cannot_lay_are_planned_by_feed():
    config = Config().changed(process={"wire_speed_min_mm_s": 33.0, "wire_speed_max_mm_s": 60.0})
    limits = bead_limits(config)
    outer = feed_limits(config, limits)
    assert outer.least_mm < limits.least_mm < limits.most_mm < outer.most_mm
    slopes = Slopes.of(box(upper=(30, 30, 10)), 0.05)
    # What stands leaves 1.2 mm: less than the wire has a speed for at this feed.
    alone = HeightRule(slopes, limits).plan(8.8)
    assert "no number of layers" in alone.said[0]
    followed = HeightRule(slopes, limits, by_feed=outer).plan(8.8)
    assert followed.said == ()
    assert followed.thickness_mm.tolist() == pytest.approx([1.2])
    assert speed_share(config, 1.2) == pytest.approx(33.0 / nominal_wire_speed_mm_s(config, 1.2), abs=1e-4)


def test_what_no_feed_can_meet_is_said_before():
    config = Config().changed(
        process={"wire_speed_min_mm_s": 33.0, "wire_speed_max_mm_s": 60.0, "travel_window_mm_s": (9.0, 11.0)}
    )
    limits = bead_limits(config)
    rule = HeightRule(Slopes.of(box(upper=(30, 30, 10)), 0.05), limits, by_feed=feed_limits(config, limits))
    plan = rule.plan(8.8)
    assert "from Z 8.800 to 10.000 mm no number of layers is within 1.396 mm" in plan.said[0]
    assert "every feed" in plan.said[0]
    assert rule.plan(8.5).said == ()


def test_wide_limits_are_never_narrower_and_end_at_the_bead():
    for config in (Config(), Config().changed(process={"current_ma": 60.0})):
        limits = bead_limits(config)
        outer = feed_limits(config, limits)
        low, high = (share * config.process.bead_height_mm for share in config.process.layer_over_bead)
        assert low - 1e-9 <= outer.least_mm <= limits.least_mm
        assert limits.most_mm <= outer.most_mm <= high + 1e-9
        assert not [f for f in outside_window(at_layer_feed(config, outer.most_mm)) if "wire" in f.text]
    assert Limits(1.0, 2.0, 1.5).why == ("", "")


@pytest.mark.parametrize(("height", "faster"), [(1.2, True), (1.7, None), (3.1, False)])
def test_metal_is_height_times_area_at_every_feed(maker, place, tmp_path, height, faster):
    made = maker.make(Wanted(1, 1.7, height, "MAIN_K0002R1"), Before.cold(maker.config), tmp_path / "program")
    assert made.passed, made.why
    (tmp_path / "settings.toml").write_text(as_toml(made.config))
    config = load_config(tmp_path / "settings.toml")
    speed, usual = config.process.travel_speed_mm_s, maker.config.process.travel_speed_mm_s
    assert speed == usual if faster is None else (speed > usual) is faster
    nc = read_program(made.files.main, config)
    rows = nc.deposit & (nc.wire_mm_s > 0.0)
    assert nc.feed_mm_min[rows] / 60.0 == pytest.approx(speed, rel=1e-6)
    seconds = 60.0 * nc.lengths[rows] / nc.feed_mm_min[rows]
    metal = float((nc.wire_mm_s[rows] * seconds).sum()) * wire_area_mm2(config)
    assert metal == pytest.approx(36 * 30 * height, rel=config.process.mass_tolerance)
    low, high = config.process.wire_speed_min_mm_s, config.process.wire_speed_max_mm_s
    assert low * (1 - 1e-6) <= nc.wire_mm_s[rows].min() <= nc.wire_mm_s[rows].max() <= high * (1 + 1e-5)
    folder = made.files.folder
    assert not [check for check in verify(folder, place / "box.stl", config) if not check.passed]


def test_a_build_that_drifts_lays_its_last_layer_by_feed(maker, tmp_path):
    building = Building(maker, tmp_path / "live")
    try:
        answer, speeds = building.start(), []
        while answer["answer"] == "published":
            speeds.append(answer["travel_speed_mm_s"])
            done = answer["layer"]
            # The layers before the last come out so that a rest stays for which the wire alone has no speed.
            grown = {1: 1.9, 2: 3.8, 3: 5.75}.get(done, answer["base_mm"] + answer["thickness_mm"])
            answer = building.height({"event": "height", "done": done, "height_mm": grown})
        assert answer["answer"] == "done", answer
        assert abs(answer["off_mm"]) < 1e-6
    finally:
        building.close()
    assert speeds[-1] > maker.config.process.travel_speed_mm_s
    assert set(speeds[:-1]) == {maker.config.process.travel_speed_mm_s}


TILT = 0.025
"""Slope of a measured surface, mm over mm along X."""


def on_a_tilt(found, config, thickness_mm, folder):
    """Layers that know of a tilted surface and that do not: feed, metal, and the slope that is left on them.

    What is left is reckoned by the gate, from the text on the tilted surface, and read over the whole section. Metal along the
    beads is no measure of it: where beads overlap each has less of it, and layouts alone make that mean slope by half the tilt.
    """
    x, y = (grid.reshape(-1) for grid in np.meshgrid(np.arange(-3.0, 39.5, 0.5), np.arange(-3.0, 33.5, 0.5)))
    with LayerMaker(found.part, config, found.primary) as maker:
        metal = Before.cold(maker.config).on_section(maker.section_at(1.0), maker.part, maker.config)
        cells = in_cells(HeightMap(x, y, 1.7 + TILT * (x - 18.0), 0.5), metal.surface)
        under = metal.mapped(figures_of(cells, metal.surface, maker.config), 1.0)
        target = target_of(shapely.box(0, 0, 36, 30), metal.surface.step_mm, config.process.bead_width_mm)
        row, column = np.nonzero(target.share >= 0.5)
        places = np.column_stack([column, row, np.ones(row.size)]) * metal.surface.step_mm
        made = []
        for name, known in (("blind", metal), ("map", under)):
            wanted = Wanted(1, 1.7, thickness_mm, "MAIN_K0002R1")
            layer = maker.make(wanted, known, folder / f"{name}-{thickness_mm}" / "p")
            assert layer.passed, layer.why
            nc = read_program(layer.files.main, layer.config)
            wire = nc.wire_mm_s[nc.deposit & nc.wire]
            assert wire.max() <= config.process.wire_speed_max_mm_s * (1 + 1e-5)
            assert wire.min() >= config.process.wire_speed_min_mm_s * (1 - 1e-5)
            sections = maker._slicings[maker.witness].at(layer.cut_mm)
            laid = deposit(nc, sections, np.array([wanted.top_mm]), layer.config, stands=under.surface)
            over = laid.surface.over_mm(target)[row, column]
            left = np.linalg.lstsq(places, over, rcond=None)[0][0]
            made.append((layer.config.process.travel_speed_mm_s, float(laid.layers["laid_mm3"].iloc[0]), left / TILT))
    return made


def test_on_a_map_the_feed_leaves_the_wire_room_for_the_local_height(place, tmp_path):
    """A layer near the most that the wire has at the usual feed: over a dip there would be no more of it."""
    found = finished_run(place / "box.run")
    (usual_mm_s, mm3, left), (feed_mm_s, mapped_mm3, mended) = on_a_tilt(found, found.config, 2.7, tmp_path)
    assert feed_mm_s < usual_mm_s < found.config.process.travel_speed_mm_s
    # Metal is moved, none is made.
    assert mapped_mm3 == pytest.approx(mm3, rel=0.02)
    # The feeder's ends are 1.8 times apart, and contours at the low end would need 1.9: four fifths are mended. What layouts tilt by
    # themselves stands in both, and differs with the order of the islands: the difference is what the map does.
    assert left - abs(mended) > 0.8 - 0.22
    assert abs(mended) < 0.22
    # At the usual feed the wire for the low side would not be there.
    usual = nominal_wire_speed_mm_s(found.config, 2.7 + 9.0 * TILT)
    assert usual > found.config.process.wire_speed_max_mm_s


@pytest.mark.parametrize("thickness_mm", [1.7, 2.7])
def test_a_feeder_with_room_mends_a_tilt_in_one_layer(place, tmp_path, thickness_mm):
    found = finished_run(place / "box.run")
    config = found.config.changed(process={"wire_speed_min_mm_s": 5.0, "wire_speed_max_mm_s": 200.0})
    (_, mm3, left), (_, mapped_mm3, mended) = on_a_tilt(found, config, thickness_mm, tmp_path)
    assert mapped_mm3 == pytest.approx(mm3, rel=0.02)
    assert left > 0.8
    # What is left lies along the border, on the flanks of beads.
    assert abs(mended) < 0.1


# -- Laws of the planner of heights: it fills the way to the top exactly, meets every face, and keeps the bead's limits --


LIMITS = Limits(0.8, 3.0, 1.6, ("least", "most"))


def stairs(*tops):
    """Boxes side by side, each as high as given."""
    return join(*[box((20 * k, 0, 0), (20 * k + 15, 15, z)) for k, z in enumerate(tops)])


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.floats(0.5, 60.0), min_size=1, max_size=6),
    st.floats(0.0, 50.0),
    st.sampled_from(["uniform", "adaptive"]),
)
def test_layers_fill_the_way_to_the_top_within_limits_and_meet_what_they_do_not_name(faces, base, mode):
    part = stairs(*faces)
    rule = HeightRule(Slopes.of(part, 0.05), LIMITS, mode)
    plan = rule.plan(base)
    top = max(faces)
    if top - base <= rule.met_mm:
        assert not len(plan)
        return
    assert rule.slopes.top_mm == pytest.approx(top, abs=1e-12)
    named = " ".join(plan.said)
    for face in sorted({z for z in faces if z > base + rule.met_mm}):
        met = np.abs(plan.tops_mm - face).min() <= 2e-6
        assert met or f"{face:.3f}" in named or any(abs(face - o) < 1e-6 and o != face for o in faces)
    # Whatever the rest: what is planned can be laid, and the top is met within what counts as met.
    assert (plan.thickness_mm >= LIMITS.least_mm - 1e-9).all(), plan.thickness_mm
    assert (plan.thickness_mm <= LIMITS.most_mm + 1e-9).all()
    assert abs(plan.tops_mm[-1] - top) <= rule.met_mm + 1e-9
    if "no number" not in named:
        assert plan.tops_mm[-1] == rule.slopes.top_mm


@pytest.mark.parametrize(
    ("limits", "rest", "tops"),
    [
        (LIMITS, 0.39, []),
        (LIMITS, 0.41, [0.8]),
        (LIMITS, 0.79, [0.8]),
        (LIMITS, 0.81, [0.81]),
        # No number of layers from 0.8 to 1.2 mm fills 1.3 or 1.5 mm: one of 1.2, two of 0.8.
        (Limits(0.8, 1.2, 1.0), 1.3, [1.2]),
        (Limits(0.8, 1.2, 1.0), 1.5, [0.8, 1.6]),
    ],
)
def test_a_rest_that_no_layer_fills_gets_the_nearest_that_can_be_laid(limits, rest, tops):
    plan = HeightRule(Slopes.of(box((0, 0, 0), (20, 20, 10)), 0.05), limits).plan(10.0 - rest)
    assert plan.tops_mm - (10.0 - rest) == pytest.approx(tops)
    assert bool(plan.said) == (bool(tops) and abs(tops[-1] - rest) > 1e-6)


@settings(deadline=None, max_examples=40)
@given(st.floats(-0.15, 0.15), st.integers(0, 1000), st.sampled_from(["uniform", "adaptive"]))
def test_closed_loop_ends_at_the_top_whatever_the_beads_do(drift, seed, mode):
    random = np.random.default_rng(seed)
    rule = HeightRule(Slopes.of(sphere(20.0), 0.05), LIMITS, mode, cusp_mm=0.9)
    z, last = 0.0, 0.0
    for _ in range(200):
        plan = rule.plan(z)
        if not len(plan):
            break
        last = plan.thickness_mm[0]
        z += last * (1.0 + drift + 0.02 * random.standard_normal())
    assert abs(z - 40.0) <= max(rule.met_mm, 0.25 * last)


def test_cusp_is_kept_where_the_bead_can_and_named_where_not():
    rule = HeightRule(Slopes.of(sphere(20.0, 96, 96), 0.02), LIMITS, "adaptive", cusp_mm=0.9)
    plan = rule.plan(0.0)
    over = plan.cusp_mm > 0.9 * 1.001
    assert over.any(), "the poles of a sphere are too flat for the least layer"
    assert plan.said
    assert "cusp" in plan.said[0]
    middle = (plan.tops_mm > 15.0) & (plan.tops_mm < 25.0)
    assert (plan.cusp_mm[middle] <= 0.9 * 1.001).all()
    assert plan.thickness_mm[middle].min() > 1.5 * plan.thickness_mm[~middle].min()
    # Oracle: the slope of a sphere at the height z is |z - R| / R.
    for top, thick, cusp in zip(plan.tops_mm, plan.thickness_mm, plan.cusp_mm, strict=True):
        far = max(abs(top - 20.0), abs(top - thick - 20.0)) / 20.0
        assert cusp <= thick * min(1.0, far + 0.06) + 1e-9


def test_a_face_that_no_layer_can_meet_is_named_before():
    plan = HeightRule(Slopes.of(stairs(10.0, 10.3, 20.0), 0.05), LIMITS).plan(0.0)
    assert [text for text in plan.said if "Z 10.300" in text]
    assert 10.0 in plan.tops_mm


def test_thin_rest_under_the_top_is_laid_with_the_layers_below():
    plan = HeightRule(Slopes.of(stairs(19.8, 20.0), 0.05), LIMITS).plan(0.0)
    assert plan.tops_mm[-1] == 20.0
    assert plan.thickness_mm.min() >= LIMITS.least_mm
    assert "19.800" in plan.said[0]


def test_listed_heights_are_kept_and_too_large_steps_are_divided_and_named():
    rule = HeightRule(Slopes.of(box(upper=(20, 20, 12)), 0.05), LIMITS, "listed", listed_mm=(2.0, 4.5, 10.0))
    plan = rule.plan(0.0)
    assert {2.0, 4.5, 10.0, 12.0} <= set(plan.tops_mm.tolist())
    assert plan.thickness_mm.max() <= LIMITS.most_mm
    assert "10.000 is laid in" in plan.said[0]


def test_over_the_top_is_named():
    plan = HeightRule(Slopes.of(box(upper=(20, 20, 12)), 0.05), LIMITS).plan(13.0)
    assert not len(plan)
    assert "over the part's top" in plan.said[0]


def test_limits_are_those_of_window_wire_and_power():
    config = Config()
    limits = bead_limits(config)
    for height in (limits.least_mm, limits.most_mm):
        wire = nominal_wire_speed_mm_s(config, height)
        assert config.process.wire_speed_min_mm_s <= wire * (1 + 1e-9)
        assert wire <= config.process.wire_speed_max_mm_s * (1 + 1e-9)
    slow = bead_limits(config.changed(process={"wire_speed_max_mm_s": nominal_wire_speed_mm_s(config, 2.0)}))
    assert slow.most_mm == pytest.approx(2.0)
    assert slow.why[1] == "process.wire_speed_max_mm_s"
    weak = bead_limits(config.changed(machine={}, process={"current_ma": 40.0, "line_energy_j_mm": (1, 1e4)}))
    assert weak.most_mm < limits.most_mm


@pytest.mark.parametrize("listed", [(), (3.0, 2.0), (0.0, 2.0)])
def test_listed_heights_that_do_not_rise_are_refused(listed):
    with pytest.raises(SettingsError, match="rise"):
        height_rule(box(upper=(20, 20, 12)), Config(), "listed", listed_mm=listed)


def test_cusp_must_be_positive():
    with pytest.raises(SettingsError, match="cusp"):
        height_rule(box(upper=(20, 20, 12)), Config(), "adaptive", cusp_mm=float("nan"))
