"""Holes, slots, gaps, notches and walls that beads cannot build, or that lie between two cuts, with place and size."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from parts import box, join, sphere, tilted, torus
from prism_program import CONFIG, Made
from shapely import affinity

from benchmarks.curve_parts_solids import extruded
from ebamcheck.checks.mesh_checks import between_check
from ebamcheck.checks.metal import deposit
from ebamcheck.checks.metal_rules import NARROW, deposit_checks
from ebamcheck.checks.narrow_features import narrow_features, narrow_places
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.pipeline.findings import metal_findings, narrow_findings
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part

PLATE = shapely.box(0, 0, 90, 50)
BEAD = 6.0
SHALLOW = 1.0


def disc(x, y, width, fine=32):
    return shapely.Point(x, y).buffer(0.5 * width, fine)


def gusset(angle_deg):
    """Notch of an angle in the upper side of a plate, 20 mm deep."""
    half = 20.0 * math.tan(math.radians(0.5 * angle_deg))
    return PLATE.difference(shapely.Polygon([(45 - half, 50), (45, 30), (45 + half, 50)]))


def turned(section):
    return affinity.rotate(section, 23.0, origin=(0, 0))


NARROW_SECTIONS = {
    "pinhole": (PLATE.difference(disc(30, 20, 0.8)), "hole", 0.8),
    "hole": (PLATE.difference(disc(30, 20, 2.5)), "hole", 2.5),
    "hole in a thin wall": (PLATE.difference(disc(30, 49.3 - 2, 4.0)), "hole", 4.0),
    "square hole": (PLATE.difference(shapely.box(20, 20, 24, 24)), "hole", 4.0),
    "triangular hole": (PLATE.difference(shapely.Polygon([(20, 20), (26, 20), (23, 25.2)])), "hole", None),
    "slot": (PLATE.difference(shapely.box(20, 20, 50, 21)), "slot", 1.0),
    "bent slot": (
        PLATE.difference(shapely.LineString([(20, 10), (40, 10), (40, 30)]).buffer(1.0, cap_style="flat")),
        "slot",
        2.0,
    ),
    "gap": (shapely.union_all([PLATE, shapely.box(91, 0, 130, 50)]), "gap", 1.0),
    "gap of a micrometre": (shapely.MultiPolygon([PLATE, shapely.box(90.001, 0, 130, 50)]), "gap", 0.001),
    "wedge of a gap": (
        shapely.MultiPolygon([PLATE, shapely.Polygon([(90.001, 0), (130, 0), (130, 50), (95, 50)])]),
        "gap",
        0.001,
    ),
    "two bars": (shapely.MultiPolygon([disc(0, 0, 20), disc(20.01, 0, 20)]), "gap", 0.01),
    "ring around a hub": (disc(0, 0, 60).difference(disc(0, 0, 24)).union(disc(0, 0, 18)), "gap", 3.0),
    "slit from outside": (PLATE.difference(shapely.box(40, 20, 42, 60)), "notch", 2.0),
    "keyway": (PLATE.difference(shapely.box(40, 47, 43, 60)), "notch", 3.0),
    "sharp notch": (gusset(20.0), "notch", None),
    "fin": (PLATE.union(shapely.box(40, 50, 42, 80)), "wall", 2.0),
    "wall between holes": (
        PLATE.difference(shapely.box(10, 10, 40, 40)).difference(shapely.box(42, 10, 72, 40)),
        "wall",
        2.0,
    ),
    "pin": (shapely.MultiPolygon([PLATE, disc(120, 20, 2.0)]), "wall", 2.0),
}


@pytest.mark.parametrize("name", NARROW_SECTIONS)
@pytest.mark.parametrize("turn", [lambda s: s, turned], ids=["straight", "turned"])
def test_a_narrow_feature_is_found_with_place_and_size(name, turn):
    section, kind, width = NARROW_SECTIONS[name]
    section = turn(section)
    (found,) = [one for one in narrow_features([section] * 4, Config()) if one.kind == kind]
    assert (found.first, found.last) == (0, 3)
    if width is not None:
        assert found.narrowest_mm == pytest.approx(width, rel=0.02, abs=1e-6)
    place = shapely.Point(found.x_mm, found.y_mm)
    if kind == "wall":
        assert section.distance(place) < 1e-9
    else:
        # The middle of a way across, or in a triangle, whose sides do not face one another, any place in it.
        assert section.boundary.distance(place) <= 0.6 * found.widest_mm
        assert section.buffer(-1e-6).distance(place) > 0.0


@pytest.mark.parametrize("factor", [1.0 / 1.2, 1.2])
@pytest.mark.parametrize("kind", ["hole", "slot", "gap", "notch"])
def test_an_opening_counts_up_to_the_width_of_a_bead(kind, factor):
    wide = factor * BEAD
    section = {
        "hole": PLATE.difference(disc(30, 25, wide)),
        "slot": PLATE.difference(shapely.box(20, 20, 60, 20 + wide)),
        "gap": shapely.MultiPolygon([PLATE, shapely.box(90 + wide, 0, 150, 50)]),
        "notch": PLATE.difference(shapely.box(40, 20, 40 + wide, 60)),
    }[kind]
    assert [found.kind for found in narrow_features([section], Config())] == ([kind] if factor < 1 else [])


@pytest.mark.parametrize("factor", [1.0 / 1.2, 1.2])
def test_a_wall_counts_up_to_the_least_that_beads_can_lay(factor):
    least = 1000.0 / 60.0 / 36.0 * BEAD
    section = PLATE.union(shapely.box(40, 50, 40 + factor * least, 80))
    assert len(narrow_features([section], Config())) == (factor < 1)


@pytest.mark.parametrize("factor", [1.0 / 1.2, 1.2])
def test_a_notch_counts_from_the_unevenness_of_a_side_on(factor):
    section = PLATE.difference(shapely.box(40, 50 - factor * SHALLOW, 42, 60))
    assert len(narrow_places(section, False, BEAD, SHALLOW)) == (factor > 1)


@pytest.mark.parametrize("angle_deg", [40.0 / 1.2, 40.0 * 1.2])
def test_sides_that_hardly_face_one_another_are_corners(angle_deg):
    """Of a notch, and of the tip of a gusset."""
    assert len(narrow_features([gusset(angle_deg)], Config())) == (angle_deg < 40)
    tip = shapely.Polygon([(0, 0), (60, 0), (0, 60.0 * math.tan(math.radians(angle_deg)))])
    assert len(narrow_features([tip], Config())) == (angle_deg < 40)


@pytest.mark.parametrize(
    "section",
    [
        PLATE,
        disc(0, 0, 80),
        disc(0, 0, 80).difference(disc(0, 0, 30)),
        shapely.box(0, 0, 60, 60).difference(shapely.box(20, 20, 40, 40)),
        shapely.union_all([shapely.box(0, 0, 60, 20), shapely.box(0, 0, 20, 60)]),
        shapely.union_all([shapely.box(0, 0, 40, 40), shapely.box(40, 40, 80, 80)]),
    ],
    ids=["plate", "disc", "ring", "frame", "angle", "touching corners"],
)
def test_sound_sections_have_none(section):
    assert narrow_features([turned(section)] * 3, Config()) == []


def test_one_feature_through_many_layers_is_one_finding():
    """Two holes, one of which leans, and one that only some layers have."""
    sections = [
        PLATE.difference(shapely.union_all([disc(20 + k, 20, 2.5), *([disc(70, 30, 3.0)] if k > 10 else [])]))
        for k in range(30)
    ]
    leaning, upper = narrow_features(sections, Config())
    assert (leaning.first, leaning.last) == (0, 29)
    assert (upper.first, upper.last) == (11, 29)
    heights = np.arange(30) * 2.0 + 1.0
    told = list(narrow_findings([leaning, upper], heights, Config()))
    assert [(one.severity, one.code) for one in told] == [("warning", "opening-under-bead")] * 2
    assert "a hole 2.5 mm wide on 30 layers, z = 1.000 to 59.000 mm, is narrower than a bead (6 mm)" in told[0].text
    assert "bridged by the melt" in told[0].text
    assert told[0].place.startswith("layer ")


def test_only_some_of_many_are_told_one_by_one():
    holes = shapely.union_all([disc(5 + 8 * (k % 10), 10 + 10 * (k // 10), 1 + 0.1 * k) for k in range(20)])
    found = narrow_features([PLATE.difference(holes)], Config())
    assert len(found) == 20
    *_, last = told = list(narrow_findings(found, np.array([1.0]), Config()))
    assert len(told) == 9
    assert last.text.startswith("12 more features")


HOLES = PLATE.difference(shapely.union_all([disc(15, 25, 2.5), disc(45, 25, 9.0)]))


@pytest.mark.parametrize(
    ("process", "severities"),
    [
        ({}, ["warning"]),
        ({"least_hole_mm": 20.0}, ["fault", "fault"]),
        ({"least_hole_mm": 2.5 * 1.2}, ["fault"]),
        ({"least_hole_mm": 2.5 / 1.2}, ["note"]),
        ({"machining_allowance_mm": 3.0}, ["warning", "warning"]),
    ],
)
def test_a_setting_says_what_may_not_be_built(tmp_path, process, severities):
    config = CONFIG.changed(process=process)
    made = Made(tmp_path, HOLES, config, layers=2)
    nc = made.read()
    laid = deposit(nc, made.layers, made.z, config)
    checks = deposit_checks(nc, laid, config)
    told = [
        *narrow_findings(laid.narrow, made.layers.heights, config),
        *metal_findings([c for c in checks if c.name == NARROW]),
    ]
    assert [one.severity for one in told] == severities
    (check,) = [c for c in checks if c.name == NARROW]
    assert check.passed == ("fault" not in severities)
    assert check.value == severities.count("fault")
    if "fault" in severities:
        assert "a hole 2.5 mm wide on 2 layers" in check.text
        assert "process.least_hole_mm allows" in check.text
        assert "at (15." in check.text or "at (14." in check.text or "at (16." in check.text
        assert check.where.startswith("MAIN_L0001.SPF:")


@pytest.mark.parametrize("factor", [1.0 / 1.2, 1.2])
def test_a_least_wall_that_is_set_shuts_the_gate(factor):
    config = Config().changed(process={"least_wall_mm": 5.0})
    section = PLATE.union(shapely.box(40, 50, 40 + factor * 5.0, 80))
    assert [one.is_set for one in narrow_features([section], config)] == ([True] if factor < 1 else [])


# -- features that lie on their sides --------------------------------------------------------------


def lying(width_mm, height_mm, centre_mm, high_mm=1.5, layers=14):
    """Sections of a plate with a round bore along X, or of one that is as high as is said, its axis at a height."""
    found = []
    for k in range(layers):
        dz = 2.0 * ((k + 0.5) * high_mm - centre_mm) / height_mm
        half = 0.5 * width_mm * math.sqrt(max(1.0 - dz * dz, 0.0))
        found.append(PLATE.difference(shapely.box(-1, 25 - half, 91, 25 + half)) if half else PLATE)
    return found


@pytest.mark.parametrize("centre_mm", [9.0, 9.3, 9.75, 10.1])
@pytest.mark.parametrize(("share", "count"), [(0.95, 0), (1.2, 1)])
def test_a_bore_on_its_side_is_as_wide_as_it_is_round(centre_mm, share, count):
    """Its crown is narrow on every layer that cuts it there; at its middle it is as wide as the bore."""
    config = Config().changed(layers={"layer_height_mm": 1.5}, process={"least_hole_mm": share * 8.0})
    found = [f for f in narrow_features(lying(8.0, 8.0, centre_mm), config) if f.is_set]
    assert len(found) == count


@pytest.mark.parametrize("walls", [False, True])
def test_what_stands_upright_is_as_wide_as_it_is_narrow(walls):
    """A slot, or a web, of 5 mm through twelve of fourteen layers, closed under and over it."""
    slot = shapely.box(20, 20, 60, 25)
    low = shapely.box(0, 0, 90, 50) if not walls else shapely.Polygon()
    within = PLATE.difference(slot) if not walls else slot
    config = Config().changed(layers={"layer_height_mm": 1.5}, process={"least_hole_mm": 5.2, "least_wall_mm": 5.2})
    found = [f for f in narrow_features([low, *[within] * 12, low], config) if f.is_set]
    assert [f.is_wall for f in found] == [walls]


# -- what no layer has --------------------------------------------------------------------------------------


BLOCK = box((0, 0, 0), (40, 30, 6))


def bored(radius_mm: float, z_mm: float) -> Part:
    """A block of 40 x 30 x 6 mm with a round bore along X through it."""
    turn = -2.0 * np.pi * np.arange(24) / 24
    ring = np.column_stack([15.0 + radius_mm * np.cos(turn), z_mm + radius_mm * np.sin(turn)])
    outer = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 6.0], [0.0, 6.0]])
    upright = extruded([outer, ring], 40.0)
    return from_arrays(upright.vertices[:, [2, 0, 1]], upright.faces)


def found(part: Part, **process: float) -> tuple:
    config = Config().changed(layers={"layer_height_mm": 1.5}, process=process)
    cuts = np.arange(part.bounds[0, 2] + 0.75, part.bounds[1, 2], 1.5)
    check = between_check(part, slice_part(part, cuts), config)
    return check, list(metal_findings([check]))


def test_a_bore_that_lies_between_two_cuts_is_told_and_refused_where_holes_are_wider_by_the_settings():
    part = bored(0.6, 3.0)
    check, told = found(part)
    assert check.passed
    assert [(f.severity, f.code) for f in told] == [("warning", "lost-between-cuts")]
    assert "an opening 1.2 mm high and 1.2 mm wide at z = 3.000 mm, (20.0, 15.0)" in check.text
    check, told = found(part, least_hole_mm=20.0)
    assert not check.passed
    assert [f.severity for f in told] == ["fault"]
    assert "process.least_hole_mm allows none under 20 mm" in check.text
    assert (check.layer, round(check.x_mm), round(check.y_mm)) == (1, 20, 15)


def test_a_bore_that_a_cut_crosses_is_for_the_sections_to_tell():
    check, told = found(bored(0.6, 2.25))
    assert check.value == 0.0
    assert told == []


@pytest.mark.parametrize("gap", [0.1, 0.4, 1.2])
def test_a_gap_between_two_bodies_is_told(gap):
    part = join(box((0, 0, 0), (40, 30, 2.5)), box((0, 0, 2.5 + gap), (40, 30, 6)))
    check, _ = found(part)
    assert check.value == 1.0
    assert f"an opening {gap:.2g} mm high" in check.text


def test_a_rim_is_told_where_it_reaches_farther_than_sides_are_uneven():
    for reach, count in ((0.8, 0.0), (1.2, 1.0)):
        part = join(BLOCK, box((-reach, -reach, 2.6), (40 + reach, 30 + reach, 3.4)))
        check, told = found(part, least_wall_mm=1.0)
        assert check.value == count
        assert check.passed == (count == 0.0)
        assert [f.severity for f in told] == ["fault"] * int(count)


@pytest.mark.parametrize(
    "part",
    [BLOCK, sphere(10.0), torus(), tilted(BLOCK), join(BLOCK, box((10, 10, 5.5), (20, 20, 9.7)))],
    ids=["block", "sphere", "torus", "tilted", "step"],
)
def test_sound_parts_have_nothing_between_their_cuts(part):
    check, told = found(part)
    assert check.value == 0.0
    assert told == []


def test_listed_heights_say_which_layers_there_are():
    config = Config().changed(layers={"heights_mm": [0.75, 5.25]})
    check = between_check(bored(0.6, 3.0), slice_part(bored(0.6, 3.0), np.array([0.75, 5.25])), config)
    assert check.passed
    assert check.value == 0.0


def test_sections_that_meet_in_a_line_are_compared():
    """Two blocks beside each other, one on the lower and one on the upper layer, and a rim of a third between the cuts."""
    part = join(box((0, 0, 0), (20, 30, 1.5)), box((20, 0, 1.5), (40, 30, 3)), box((0, 0, 0.9), (40, 30, 2.1)))
    check, _ = found(part)
    assert check.passed
    assert check.value == 0.0
