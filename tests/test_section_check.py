"""The check of contour paths against sections: sound where an inset moves farther than its outline."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from nc_stack import make_curves, make_plan

from ebamcheck.checks.section_check import Evidence, section_check
from ebamcheck.geometry.regions import inset
from ebamcheck.layers.stack import from_polygons
from ebamcheck.program import read_program, write_program
from ebamcheck.settings.config import Config

INSET_MM, LIMIT_MM = 3.0, 0.25
HEIGHT_MM = 0.75

WEDGE = shapely.Polygon([(0, 0), (120, -16), (120, 16)])
"""Its tip has 15 degrees: an inset there moves seven times as far as the outline."""
NECK = shapely.union_all([shapely.box(0, 0, 40, 40), shapely.box(60, 0, 100, 40), shapely.box(39, 17, 61, 23.02)])
"""Its neck is 6.02 mm wide, just over two insets."""


def checked(tmp_path, made_of, section, move=(0.0, 0.0)):
    """Check a program along the inset of one outline against the section of another."""
    parts = shapely.get_parts(inset(made_of, INSET_MM))
    lines = [ring for p in parts for ring in (p.exterior, *p.interiors)]
    rings = [[(shapely.get_coordinates(line) + move, None)] for line in lines]
    curves = make_curves([HEIGHT_MM], [rings], [True] * len(rings))
    config = Config()
    files = write_program(curves, make_plan([HEIGHT_MM], []), config, tmp_path / "p")
    nc = read_program(files.main, config)
    layers = from_polygons(np.array([HEIGHT_MM]), [[section]])
    return section_check(nc, layers, np.array([1.5]), INSET_MM, LIMIT_MM)


def near(outline, by_mm):
    """An outline grown by `by_mm`; in an inward corner of 90 degrees it lies 1.41 times as far from the other."""
    return shapely.buffer(outline, by_mm, quad_segs=16)


@pytest.mark.parametrize("section", [WEDGE, NECK, shapely.box(0, 0, 50, 30)], ids=["wedge", "neck", "box"])
@pytest.mark.parametrize("by_mm", [-0.17, 0.17])
def test_the_inset_of_any_outline_within_the_limit_passes(tmp_path, section, by_mm):
    check = checked(tmp_path, near(section, by_mm), section)
    assert check.passed, check.text


@pytest.mark.parametrize("section", [WEDGE, NECK, shapely.box(0, 0, 50, 30)], ids=["wedge", "neck", "box"])
@pytest.mark.parametrize("by_mm", [-0.4, 0.4])
def test_the_inset_of_an_outline_beyond_the_limit_fails_by_as_much_or_more(tmp_path, section, by_mm):
    check = checked(tmp_path, near(section, by_mm), section)
    assert not check.passed
    assert check.value >= 0.4 - 1e-3


@pytest.mark.parametrize("move", [(0.3, 0.0), (0.0, 0.3)])
def test_a_shifted_path_fails(tmp_path, move):
    check = checked(tmp_path, shapely.box(0, 0, 50, 30), shapely.box(0, 0, 50, 30), move)
    assert not check.passed
    assert check.value == pytest.approx(0.3, abs=1e-3)


def test_a_path_that_leaves_out_a_part_of_the_section_fails(tmp_path):
    section = shapely.union_all([shapely.box(0, 0, 40, 40), shapely.box(60, 0, 100, 40)])
    check = checked(tmp_path, shapely.box(0, 0, 40, 40), section)
    assert not check.passed
    assert check.value > 10 * LIMIT_MM
    hole = shapely.box(0, 0, 40, 40) - shapely.Point(20, 20).buffer(6)
    assert not checked(tmp_path, shapely.box(0, 0, 40, 40), hole).passed
    assert not checked(tmp_path, hole, shapely.box(0, 0, 40, 40)).passed


BLOCKS = {
    "gap": shapely.MultiPolygon([shapely.box(0, 0, 40, 30), shapely.box(40 + 1e-9, 0, 80, 30)]),
    "notch": shapely.box(0, 0, 80, 30) - shapely.box(40, 0, 40 + 1e-9, 25),
    "hole": shapely.box(0, 0, 80, 30) - shapely.box(40, 5, 40 + 1e-9, 25),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_a_slit_without_width_asks_for_no_contour_and_hides_no_missing_one(tmp_path, name):
    assert checked(tmp_path, shapely.box(0, 0, 80, 30), BLOCKS[name]).passed
    assert not checked(tmp_path, shapely.box(0, 0, 40, 30), BLOCKS[name]).passed
    assert not checked(tmp_path, shapely.box(0, 0, 80, 30), BLOCKS[name], (0.3, 0.0)).passed


def regular(corners, radius=29.0):
    """A polygon of equal sides, whose corners lie on a circle."""
    angle = 2.0 * np.pi * np.arange(corners) / corners
    return shapely.Polygon(radius * np.column_stack([np.cos(angle), np.sin(angle)]))


def round_path(tmp_path, section, evidence, most=LIMIT_MM):
    """Check a path along a circle against a section."""
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    circle = 26.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    circle[-1] = circle[0]
    curves = make_curves([HEIGHT_MM], [[[(circle, None)]]], [True])
    files = write_program(curves, make_plan([HEIGHT_MM], []), Config(), tmp_path / "p")
    layers = from_polygons(np.array([HEIGHT_MM]), [[section]])
    nc = read_program(files.main, Config())
    return section_check(nc, layers, np.array([1.5]), INSET_MM, most, evidence=evidence)


def test_a_prism_of_twelve_sides_is_no_circle_whatever_the_fit_says(tmp_path):
    circle = from_polygons(np.array([HEIGHT_MM]), [[shapely.Point(0, 0).buffer(29, 720)]])
    for smooth in (None, circle):
        check = round_path(tmp_path, regular(12), Evidence(0.05, LIMIT_MM, smooth))
        assert not check.passed
        assert check.limit == LIMIT_MM
        assert check.value == pytest.approx(29.0 * (1.0 - np.cos(np.pi / 12.0)), abs=0.02)
        assert check.layer == 0
        assert np.hypot(check.x_mm, check.y_mm) == pytest.approx(26.0, abs=0.01)


@pytest.mark.parametrize("corners", [40, 80])
def test_chords_of_a_circle_are_evidence_for_it_and_a_path_beside_it_has_none(tmp_path, corners):
    for move, passed in ((0.0, True), (0.12, False)):
        section = shapely.affinity.translate(regular(corners), move, 0.0)
        circle = shapely.affinity.translate(shapely.Point(0, 0).buffer(29, 720), move, 0.0)
        for smooth in (None, from_polygons(np.array([HEIGHT_MM]), [[circle]])):
            check = round_path(tmp_path, section, Evidence(0.01, LIMIT_MM, smooth))
            assert check.passed == passed, check.text


def test_evidence_counts_at_its_place_alone(tmp_path):
    """Where one side is one long chord and the others are short, only the path along that one may leave it."""
    angle = np.concatenate([np.linspace(0.2, 2.0 * np.pi - 0.2, 300), [2.0 * np.pi + 0.2]])[:-1]
    section = shapely.Polygon(29.0 * np.column_stack([np.cos(angle), np.sin(angle)]))
    assert round_path(tmp_path, section, Evidence(0.05, 1.0), most=1.0).passed
    shifted = shapely.affinity.translate(section, 0.0, 0.2)
    assert not round_path(tmp_path, shifted, Evidence(0.05, 1.0), most=1.0).passed
