"""Laws of the planner of heights: it fills the way to the top exactly, meets every face, and keeps the bead's limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ebamcheck.errors import SettingsError
from ebamcheck.live.heights import HeightRule, Limits, Slopes, bead_limits, height_rule
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import nominal_wire_speed_mm_s
from tests.parts import box, join, sphere

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
