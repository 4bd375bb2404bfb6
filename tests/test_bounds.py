"""Declared bounds under attack: no difference may be deeper, and the worst must be more than a third of it.

Depths are measured by the comparison room from exact sections (tests/test_comparison.py holds it to shapely);
the exact slicers' bounds are attacked in rational arithmetic (tests/test_oracle.py).
"""

from __future__ import annotations

import math

import pytest
import shapely
from hypothesis import HealthCheck, given, settings, target
from hypothesis import strategies as st
from section_oracle import simple_sections

import ebamcheck
from ebamcheck.plugins import registry
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.testing import Subject, solids
from ebamcheck.testing.accuracy import LOOSEST
from ebamcheck.testing.laws import LARGE_OFFSET_MM
from ebamcheck.testing.subject import generic_heights

METHODS = {
    "stencil": ("stencil", {}, "pixel_mm"),
    "stencil, literal": ("stencil", {"mode": "literal"}, "pixel_mm"),
    "embree": ("embree", {}, "grid_mm"),
}
SAMPLES_MM = (0.31, 1.3, pytest.param(0.09, marks=pytest.mark.slow))
"""Pixels and grid cells."""


def subject_of(method, sample_mm):
    backend, chosen, key = METHODS[method]
    if not registry.probe(backend).available:
        pytest.skip(registry.probe(backend).why)
    return Subject(registry.slicer(backend), {**chosen, key: sample_mm})


def share(subject, part, layers=1):
    """Deepest difference of a part's layers over what is promised of them."""
    differences = subject.differences(part, generic_heights(part, layers))
    deepest = float(differences.depth_mm.max(initial=0.0))
    return deepest / subject.limit_mm(part)


def sharp(degrees, direction):
    """Thin pyramid-like wedge: sharp in the plane, and leaning."""
    half = 12.0 * math.tan(math.radians(0.5 * degrees))
    part = solids.prism(shapely.Polygon([(0, 0), (12, -half), (12, half)]), 0.0, 3.0)
    return solids.mapped(part, solids.turn(direction) @ solids.turn(20.0, "y"))


def shallow(degrees):
    """A pyramid whose flanks rise by few degrees: a little height is far in the plane."""
    return solids.revolved([(0.0, 0.0), (15.0, 0.0), (0.0, 15.0 * math.tan(math.radians(degrees)))], 7, closed=False)


@pytest.mark.in_turn(9, 4)
@pytest.mark.parametrize("sample_mm", SAMPLES_MM)
@pytest.mark.parametrize("method", METHODS)
def test_the_bound_holds_and_is_not_idle(method, sample_mm):
    subject = subject_of(method, sample_mm)
    bound = subject.bound_mm(solids.frame())
    shares = {}
    for name, part in solids.attackers(bound).items():
        shares[name] = share(subject, part)
        shares[f"{name}, turned"] = share(subject, solids.mapped(part, solids.turn(29.3), (0.1, 0.2, 0.0)))
    over = {name: value for name, value in shares.items() if value > 1.0}
    assert over == {}
    assert max(shares.values()) > 1.0 / LOOSEST, shares


@pytest.mark.parametrize("method", METHODS)
def test_the_bound_holds_on_sharp_wedges_and_shallow_slopes(method):
    subject = subject_of(method, 0.2)
    for degrees in (0.5, 3.0, 20.0):
        for direction in (0.0, 44.7, 90.0, 193.0):
            part = solids.named(f"{degrees} at {direction}", sharp(degrees, direction))
            assert share(subject, part, 3) <= 1.0, part.name
    for degrees in (0.1, 2.0):
        assert share(subject, solids.named("shallow", shallow(degrees)), 3) <= 1.0


@pytest.mark.parametrize("method", METHODS)
def test_the_bound_holds_far_from_the_origin(method):
    subject = subject_of(method, 0.2)
    for name in ("tilted plate", "sphere", "turned comb", "pillars"):
        part = solids.named(name, solids.mapped(solids.simple(name), shift=LARGE_OFFSET_MM))
        assert share(subject, part, 2) <= 1.0, name


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [10, pytest.param(150, marks=pytest.mark.slow)])
def test_no_searched_outline_breaks_the_bound(method, count):
    """Hypothesis looks for the thin outline of the greatest share, by its target."""
    subject = subject_of(method, 0.25)
    worst = [0.0]
    places = st.integers(0, 6000).map(lambda k: k / 1000.0)

    @settings(
        max_examples=count, derandomize=True, deadline=None, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(
        st.lists(st.tuples(places, places), min_size=3, max_size=7, unique=True),
        st.floats(0.01, 0.9),
        st.floats(0, 360),
    )
    def searched(points, thickness, degrees):
        line = shapely.LineString(points)
        if line.length < 0.5:
            return
        outline = line.buffer(0.5 * thickness, cap_style="flat", join_style="mitre", mitre_limit=5.0)
        outline = max(shapely.get_parts(shapely.set_precision(outline, 1e-6)), key=lambda p: p.area, default=None)
        if outline is None or not outline.area > 1e-4:
            return
        part = solids.mapped(solids.prism(outline, 0.0, 2.0), solids.turn(degrees))
        found = share(subject, solids.named("searched", part))
        worst[0] = max(worst[0], found)
        target(found)
        assert found <= 1.0, (points, thickness, degrees)

    searched()
    assert worst[0] > 0.1


@pytest.mark.corpus
@pytest.mark.slow
@pytest.mark.parametrize("name", ["embree", "stencil"])
def test_areas_of_real_meshes_are_within_the_bound(name, corpus):
    if not registry.probe(name).available:
        pytest.skip(registry.probe(name).why)
    slicer, compared = registry.slicer(name), 0
    for file, rows in simple_sections(corpus).items():
        part = ebamcheck.load(corpus / file)
        areas = slice_part(part, [float(row["z"]) for row in rows], name).areas()
        bound = slicer.error_bound_mm(part, slicer.Settings())
        for area, row in zip(areas, rows, strict=True):
            assert abs(area - float(row["signed_area"])) <= bound * float(row["perimeter"]), (file, row["z"])
        compared += len(rows)
    assert compared > 100
