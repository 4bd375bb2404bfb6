"""Heat and metal of live layers: each is entered as warm as its plan says, on what those below left, and all together are judged again."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import shapely
from command_line import write_stl
from live_boxes import maker_of, run_of_box
from parts import box
from prism_program import CONFIG, Made

import ebamcheck
from ebamcheck.checks.heat_again import BeadHeat
from ebamcheck.checks.interpass_checks import INTERPASS
from ebamcheck.checks.metal import deposit
from ebamcheck.checks.metal_rules import MetalBelow, deposit_checks
from ebamcheck.heat.interpass import greatest_that_fits
from ebamcheck.heat.near_field import DIRECTIONS, FELT, ON_OUTLINE_MM, enclosed_share, ray_table
from ebamcheck.live import building as building_module
from ebamcheck.live import verifying
from ebamcheck.live.before import Before, metal_checks
from ebamcheck.live.building import Building
from ebamcheck.live.making import LayerMaker, Wanted
from ebamcheck.live.verifying import FollowedLayers, verify_build
from ebamcheck.metal import Surface
from ebamcheck.program import read_program
from ebamcheck.settings.config import Config

THICKNESS_MM = 1.7


def test_the_first_bead_is_entered_as_warm_as_planned(tmp_path):
    # The rise at the end of the program below cools the surface by kelvins: it is in no text of the layer above.
    part = tmp_path / "box.stl"
    write_stl(box(upper=(60, 40, 12)), part)
    config = Config().changed(process={"interpass_at": "layer", "interpass": "off"})
    with LayerMaker(ebamcheck.load(part), config) as maker:
        before = Before.cold(config)
        for layer in range(3):
            wanted = Wanted(layer, layer * THICKNESS_MM, THICKNESS_MM, f"MAIN_K{layer}")
            made = maker.make(wanted, before, tmp_path / str(layer))
            (entry,) = (check for check in made.checks if check.name == INTERPASS)
            if layer:
                assert entry.value == pytest.approx(made.after.last.mean_k[0], abs=0.5)
            before = made.after


# -- over all layers, by their texts ------------------------------------------------------------------


class Blind(FollowedLayers):
    """What follows the texts and says nothing of them."""

    def too_warm(self, program, paper, config):
        return ""


class Forgetful(Building):
    """A server that takes every layer to lie on cold metal."""

    def _take(self, reading, answer, layer):
        super()._take(reading, answer, layer)
        cold = Before.cold(self.maker.config)
        self.before = replace(self.before, part=cold.part, last=None)


class Levelled(Building):
    """A server that takes every layer to lie on a level plate."""

    def _take(self, reading, answer, layer):
        super()._take(reading, answer, layer)
        warm, level = self.before, Before.plate(self.maker.part, self.maker.config)
        self.before = replace(level, part=warm.part, last=warm.last)


class Impatient(Building):
    """A server that tells no wait before a layer, in the journal as in the certificates."""

    def _made(self, reading):
        answer, made = super()._made(reading)
        if made is None:
            return answer, made
        staged, layer, certificate = made
        return answer, (staged, replace(layer, wait_s=0.0), {**certificate, "wait_s": 0.0})


@pytest.mark.parametrize(
    ("server", "found"), [(Building, ""), (Forgetful, "heat"), (Impatient, "heat"), (Levelled, "metal")]
)
def test_verify_follows_heat_and_metal_over_all_layers(server, found, monkeypatch, tmp_path_factory, tmp_path):
    # A server that looks at it itself releases no such layer (test_live_made_wrong.py).
    monkeypatch.setattr(building_module, "FollowedLayers", Blind)
    place = run_of_box(tmp_path_factory, (30, 24, 12))
    with maker_of(place) as maker:
        building = server(maker, tmp_path / "b")
        answer = building.start()
        for done in range(1, 7):
            height_mm = answer["base_mm"] + answer["thickness_mm"]
            answer = building.height({"done": done, "height_mm": height_mm})
            assert answer["answer"] == "published"
        building.close()
    layers = verify_build(tmp_path / "b", place / "box.stl")
    wrong = [layer for layer in layers if not layer.passed]
    assert bool(wrong) == bool(found)
    assert all(layer.why.startswith(f"{found} over all layers: ") for layer in wrong)


def test_a_slim_column_on_a_wide_foot_is_followed_from_the_plate_up(monkeypatch):
    """The foot takes up the heat: the uppermost layers on a plate of their own would be far too warm."""
    foot, column = shapely.box(0, 0, 150, 150), shapely.box(0, 0, 30, 24)

    def text(section, beads):
        off_s = np.full(beads, 0.3)
        off_s[0] = 60.0
        heat = BeadHeat(np.zeros(beads, np.int64), off_s, np.full(beads, 30.0), np.full(beads, 9e4))
        return heat, section

    def said(layers):
        texts = iter(layers)
        monkeypatch.setattr(verifying, "layer_text", lambda *_: next(texts))
        stack, found, config = FollowedLayers(), [], Config(layers={"layer_height_mm": 1.7})
        for _ in layers:
            found.append(stack.too_warm(None, {}, config))
            stack.take()
        return found

    layers = [text(foot, 20)] * 6 + [text(column, 1)] * 10
    assert said(layers) == [""] * 16
    assert any(said(layers[6:]))
    assert said([*layers, None, text(column, 40), text(column, 40)])[16:] == [""] * 3


# -- The metal of a build, layer by layer: judged by the limits of a whole part for what stands, and of a single layer for each --


SQUARE = shapely.box(0, 0, 70, 70)
FIGURES = (
    "wanted_mm3", "laid_mm3", "outside_mm3", "inside", "edge", "inside_settled", "inside_owed", "edge_owed", "zone_settled",
    "zone_owed", "low_mm", "high_mm",
)  # fmt: skip
MEANS = ("metal", "metal outside", "height inside", "height at edges")


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    """A program of four layers, its layers one by one as programs of their own, and their settings."""
    folder = tmp_path_factory.mktemp("stack")
    made = Made(folder, SQUARE)
    main = made.files.main
    lines = main.read_text().split("\n")
    single = []
    for k in range(4):
        kept = [line for line in lines if not any(f"MAIN_L{n + 1:04d}" in line for n in range(4) if n != k)]
        place = folder / f"layer{k}"
        place.mkdir()
        (place / main.name).write_text("\n".join(kept))
        name = f"MAIN_L{k + 1:04d}.SPF"
        (place / name).write_bytes((main.parent / name).read_bytes())
        base_mm = float(made.z[k - 1]) if k else 0.0
        config = CONFIG.changed(layers={"base_mm": base_mm})
        single.append((read_program(place / main.name, config), made.layers.block(k, k + 1), config))
    return made, single


def test_layers_one_by_one_are_the_whole_program(stack):
    made, single = stack
    nc = made.read()
    whole = deposit(nc, made.layers, made.z, CONFIG)
    metal = MetalBelow()
    surface = Surface(np.array(SQUARE.bounds), CONFIG.process.bead_width_mm)
    for k, (layer, section, config) in enumerate(single):
        found = deposit(layer, section, made.z[k : k + 1], config, stands=surface)
        for name in FIGURES:
            assert found.layers[name].iloc[0] == pytest.approx(whole.layers[name].iloc[k], abs=1e-9), name
        last = deposit_checks(layer, found, config, metal)
        metal, surface = metal.and_layers(found.layers, config.process), found.surface
    # What holds for the whole part is said of it when its last layer is judged.
    of_whole = {check.name: check for check in deposit_checks(nc, whole, CONFIG)}
    assert metal.layers == 4
    for check in last:
        if check.name in MEANS:
            assert check.value == pytest.approx(of_whole[check.name].value, abs=1e-9), check.name
            assert check.limit == of_whole[check.name].limit


def judged(single, height, below, tolerance):
    """Check of the mean inside of a layer's metal, on what stands."""
    layer, section, config = single
    config = config.changed(process={"inside_tolerance": tolerance})
    found = deposit(layer, section, np.array([config.base_mm + height]), config)
    return {check.name: check for check in deposit_checks(layer, found, config, below)}["height inside"], found


def test_a_layer_is_judged_by_its_own_limit_and_by_the_mean_of_all(stack):
    made, single = stack
    height = float(made.z[0])
    _, found = judged(single[1], height, None, 0.03)
    off, area = float(found.layers["inside"].iloc[0]) - 1.0, float(found.layers["inside_mm2"].iloc[0])
    assert abs(off) > 1e-3
    tight = 0.5 * abs(off)

    def below(mean):
        return MetalBelow(9, zone_mm2=(9.0 * area, 0.0), zone_layers_mm2=(9.0 * area * mean, 0.0))

    # On layers whose mean is right the mean stays within; where it was off as far, this layer does not bring it in.
    assert judged(single[1], height, below(1.0), tight)[0].passed
    assert judged(single[1], height, below(1.0), tight)[0].value == pytest.approx(abs(off) / 10.0)
    assert not judged(single[1], height, below(1.0 + off), tight)[0].passed
    assert not judged(single[1], height, below(1.0 + 2.0 * off), tight)[0].passed
    # The lowest layer is all that stands. One on layers of which nothing is known has the limit of a single layer.
    assert not judged(single[0], height, None, tight)[0].passed
    assert not judged(single[0], height, MetalBelow(), tight)[0].passed
    alone = judged(single[1], height, None, tight)[0]
    assert alone.passed
    process = CONFIG.process
    assert alone.limit == pytest.approx(tight + 0.5 * process.hatch_spacing_mm / np.sqrt(area))


def test_the_sums_of_a_build_keep_their_limits(stack):
    made, single = stack
    layer, section, config = single[1]
    found = deposit(layer, section, made.z[1:2], config)
    wanted = float(found.layers["wanted_mm3"].iloc[0])

    def checks(**sums):
        below = MetalBelow(9, 9.0 * wanted, **{"laid_mm3": 9.0 * wanted, **sums})
        return {check.name: check for check in deposit_checks(layer, found, config, below)}

    assert checks()["metal"].passed
    assert not checks(laid_mm3=9.0 * 1.03 * wanted)["metal"].passed
    assert checks()["metal outside"].passed
    assert not checks(outside_mm3=0.06 * 10.0 * wanted)["metal outside"].passed


def test_a_surface_that_was_measured_keeps_its_pattern_and_loses_its_mean(stack):
    made, single = stack
    layer, section, config = single[0]
    found = deposit(layer, section, made.z[:1], config)
    target = found.fields[0].target
    before, after = found.surface.over_mm(target), found.surface.measured().over_mm(target)
    # Corners that no bead reaches have no metal, and no height.
    metal = before != 0.0
    assert metal.sum() > 0.9 * (target.share >= 1.0).sum()
    assert np.ptp((before - after)[metal]) == pytest.approx(0.0, abs=1e-9)
    again = found.surface.measured().measured().over_mm(target)
    assert again == pytest.approx(after, abs=1e-12)
    # And the one that was measured is not changed by building on its copy.
    copy = found.surface.copy()
    copy.add(target, np.zeros_like(target.share), 2.0)
    assert np.array_equal(found.surface.over_mm(target), before)


def hump(height_mm):
    """Surface of the square whose left half lies higher than its right one."""
    surface = Surface(np.array(SQUARE.bounds), CONFIG.process.bead_width_mm)
    surface._share[:] = 0.0
    rows, columns = surface._share.shape
    x = (surface._corner[0] + np.arange(columns) + 0.5) * surface.step_mm
    y = (surface._corner[1] + np.arange(rows) + 0.5) * surface.step_mm
    inside = ((y > 0) & (y < 70))[:, None] & ((x > 0) & (x < 70))
    surface._share[inside] = 1.0
    surface._over_mm = np.where(inside, np.where(x < 35, 0.5, -0.5) * height_mm, 0.0)
    return surface


def test_a_surface_that_is_too_uneven_refuses_the_layer(stack):
    _, single = stack
    layer, section, config = single[1]
    limit_mm = config.process.largest_unevenness_mm
    sums = MetalBelow(1, 1.0, 1.0)

    def failed(height_mm):
        checks, _ = metal_checks(
            layer, section, replace(Before.cold(config), below=sums, surface=hump(height_mm)), config
        )
        return {check.name for check in checks if not check.passed}

    assert "surface" not in failed(1.0)
    assert "surface" in failed(4.0 * limit_mm)


def test_the_greatest_that_fits_is_found_from_every_guess_and_no_number_is_asked_twice():
    for low, high, guess in itertools.product(range(8), range(1, 10), range(12)):
        for top in range(low - 1, high):
            asked: list[int] = []

            def fits(n: int, top: int = top, asked: list[int] = asked) -> bool:
                asked.append(n)
                return n <= top

            if low < high:
                assert greatest_that_fits(fits, low, high, guess) == max(top, low)
                assert len(set(asked)) == len(asked)
                assert all(low <= n < high for n in asked)


@pytest.mark.parametrize("corners", [202, 7, 4 * DIRECTIONS])
def test_what_is_in_sight_is_what_the_plain_sum_says(corners):
    # Of the last ring corners lie on rays from its middle, or a hair beside them.
    turn = np.linspace(0.0, 2.0 * np.pi, corners + 1)
    ring = np.column_stack([(50.0 + 10.0 * np.sin(7.0 * turn)) * f(turn) for f in (np.cos, np.sin)])
    ring[-1] = ring[0]
    segments = np.hstack([ring[:-1], ring[1:]])
    draw = np.random.default_rng(0)
    points, variance = draw.uniform(-25.0, 25.0, (11, 2)), draw.uniform(300.0, 900.0, (11, 3))
    # All of the ring is felt.
    variance[:, 2] = 110.0**2 / (2.0 * FELT)
    points[:4] = np.array([[0.0, 0.0], [1e-13, 0.0], [0.0, -1e-9], [1e-6, 1e-6]])
    a, b = segments[:, :2] - points[:, None], segments[:, 2:] - points[:, None]
    wanted = np.zeros(variance.shape)
    for dx, dy, share in ray_table().T:
        left, right = dx * a[..., 1] - dy * a[..., 0], dx * b[..., 1] - dy * b[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            place = a + (left / (left - right))[..., None] * (b - a)
        reach = place @ np.array([dx, dy])
        met = ((left > 0.0) != (right > 0.0)) & (reach > ON_OUTLINE_MM)
        nearest = np.where(met, reach, np.inf).min(axis=1)
        wanted -= share * np.expm1(-0.5 * nearest[:, None] ** 2 / variance)
    # A second part, far away: no segment goes from the outline of the one to that of the other.
    section = shapely.MultiPolygon([shapely.Polygon(ring), shapely.box(900.0, 0.0, 901.0, 1.0)])
    assert enclosed_share(section, points, variance) == pytest.approx(wanted, abs=1e-10)
    assert ray_table()[2].sum() == pytest.approx(1.0)
    assert np.hypot(*ray_table()[:2]) == pytest.approx(np.ones(DIRECTIONS))
