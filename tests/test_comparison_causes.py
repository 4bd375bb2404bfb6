"""Causes of a difference: read off the mesh; or each kind planted with a random size, found again, and nothing in noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from comparison_stacks import SQUARE, box, judged

from ebamcheck.comparison import compare_all
from ebamcheck.comparison.naming import REMEDIES, worst_of
from ebamcheck.comparison.place_causes import MeshFlaws, Place, likely_cause
from ebamcheck.comparison.whole_causes import KINDS
from ebamcheck.layers.stack import from_polygons, from_rings
from ebamcheck.mesh.part import from_arrays
from ebamcheck.plugins.registry import models
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.testing.solids import joined, mapped


def test_causes_read_off_the_mesh():
    part = box()
    assert MeshFlaws(part).edge_flaw(0.0, 0.0, 2.0, 1.0) == ""
    holed = from_arrays(part.vertices, np.delete(part.faces, [8, 9], axis=0))
    assert MeshFlaws(holed).edge_flaw(0.0, 0.5, 2.0, 1.0) == "open edge"
    fin = from_arrays(np.vstack([part.vertices, [(-5, -5, 2)]]), np.vstack([part.faces, [(0, 4, 8)]]))
    assert MeshFlaws(fin).edge_flaw(0.0, 0.1, 2.0, 1.0) == "non-manifold edge"
    turned = from_arrays(part.vertices, np.vstack([part.faces[:4], part.faces[4:6, ::-1], part.faces[6:]]))
    assert MeshFlaws(turned).edge_flaw(0.0, 0.1, 2.0, 1.0) == "inconsistent orientation"
    inner = box((2, 2, 1), (8, 8, 3))
    double = from_arrays(np.vstack([part.vertices, inner.vertices]), np.vstack([part.faces, inner.faces + 8]))
    assert MeshFlaws(double).winding_flaw(2.0, 5.0, 2.0, 1.0) == "overlapping shells"
    assert MeshFlaws(double).winding_flaw(0.5, 5.0, 2.0, 1.0) == ""
    assert MeshFlaws(part.reversed()).winding_flaw(0.5, 5.0, 2.0, 1.0) == "inconsistent orientation"


def test_a_feature_of_few_limits_is_thin():
    fin = shapely.box(10, 4.99, 15, 5.01)
    with_fin = from_polygons([2.0], [[shapely.box(0, 0, 10, 10).union(fin)]])
    without = from_rings([2.0], [[SQUARE]])
    result = judged({"a": with_fin, "b": without}, tolerance_mm=0.004, exact=("a",))
    assert [f.cause for f in result.findings] == ["thin feature"]


def cause_at(part, x, y, declared=(), depth=0.5, limit=0.1):
    place = Place(x, y, 2.0, depth, limit, "generic", False)
    return likely_cause(MeshFlaws(part), place, declared)


def test_a_declared_doubt_is_the_cause_in_its_box_only():
    declared = [{}, {"doubtful_regions": [{"box_mm": [9, 4, 1, 10, 6, 3], "why": "an edge was turned"}]}]
    assert cause_at(box(), 10.05, 5.0, declared) == "an edge was turned"
    assert cause_at(box(), 10.15, 5.0, declared) == "unknown"
    walls = {name: from_rings([2.0], [[SQUARE * scale]]) for name, scale in (("a", 1.0), ("b", 1.1))}
    walls["b"] = walls["b"].labelled(
        settings={"doubtful_regions": [{"box_mm": [-9, -9, 0, 19, 19, 4], "why": "an edge was turned"}]}
    )
    assert [f.cause for f in judged(walls, exact=("a",)).findings] == ["an edge was turned"]


def test_shells_that_cross_or_touch_are_told_apart():
    assert cause_at(joined(box(), box((9, 2, 0), (15, 8, 4))), 10.0, 2.1) == "overlapping shells"
    assert cause_at(joined(box(), box((10, 0, 0), (15, 10, 4))), 10.0, 5.0) == "touching shells"
    assert cause_at(joined(box(), box((10, 0, 0), (15, 10, 4))), 0.0, 5.0) == "unknown"


def test_a_body_through_itself_is_self_intersection():
    part = box()
    vertices = part.vertices.copy()
    vertices[[3, 7]] = [(5, -5, 0), (5, -5, 4)]  # one upright edge pulled through the opposite wall
    pulled = from_arrays(vertices, part.faces)
    assert cause_at(pulled, 5.0, -0.5) == "self-intersection"


@pytest.mark.parametrize(("width", "cause"), [(0.3, "thin"), (3.0, "unknown")])
def test_walls_and_gaps_by_their_width(width, cause):
    wall = box((0, 0, 0), (width, 10, 4))
    assert cause_at(wall, 0.1, 5.0) == ("thin feature" if cause == "thin" else cause)
    gap = joined(box((-10, 0, 0), (0, 10, 4)), box((width, 0, 0), (width + 10, 10, 4)))
    assert cause_at(gap, 0.1, 5.0) == ("thin gap" if cause == "thin" else cause)


def test_unbalanced_pixels_count_only_where_the_mesh_is_open():
    part = box()
    holed = from_arrays(part.vertices, np.delete(part.faces, [8, 9], axis=0))
    assert cause_at(holed, 10.0, 5.0, [{"unbalanced_pixels": 3}, {}]) == "open surface"
    assert cause_at(part, 10.0, 5.0, [{"unbalanced_pixels": 3}, {}]) == "unknown"


# -- what a whole stack has in common ------------------------------------------------------------------


LAYERS = 16


@pytest.fixture(scope="module")
def parts():
    """A part of many shapes, one of free form, two bodies that overlap, and a box with a box in its hole."""
    chosen = models(["bracket", "two-spheres", "torus"])
    found = {name: model.tessellate(0.1) for name, model in chosen.items()}
    shell = joined(box((0, 0, 0), (30, 20, 9)), box((4, 3, 0), (26, 17, 9)).reversed())
    found["nested"] = joined(shell, mapped(box((0, 0, 0), (6, 5, 9)), shift=(9, 7, 0)))
    return found


@pytest.fixture(scope="module")
def stacks(parts):
    found = {}
    for name, part in parts.items():
        low, high = part.bounds[:, 2]
        heights = low + (high - low) * (np.arange(LAYERS) + 0.437) / LAYERS
        found[name] = slice_part(part, heights, "planecut")
    return found


def found_in(part, a, b):
    """Kind, finding and comparison of two stacks of which `a` differs and a second `b` agrees with the first."""
    stacks = {"a": a.labelled(part=""), "b": b, "c": b}
    result = compare_all(
        stacks, part, dict.fromkeys(stacks, (0.0, 0.0)), dict.fromkeys(stacks, True), dict.fromkeys(stacks, "half-open"),
    )  # fmt: skip
    return result, worst_of(result.findings)


def mapped_points(layers, function):
    moved = replace(layers, points=function(layers.points))
    return from_rings(layers.heights, [[moved.ring(r) for r in moved.rings_of(k)] for k in range(len(moved))])


def offset(layers, by_mm):
    regions = [shapely.union_all(layers.polygons(k)).buffer(by_mm, join_style="mitre") for k in range(len(layers))]
    return from_polygons(layers.heights, [[r] for r in regions])


def turned(points, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return points @ np.array([[c, s], [-s, c]])


@pytest.mark.in_turn(3, 1)
@pytest.mark.parametrize("name", ["bracket", "two-spheres", "torus"])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_moves_contours_is_found_with_its_size(parts, stacks, name, seed):
    rng = np.random.default_rng([seed, len(name)])
    part, exact = parts[name], stacks[name]
    sign = rng.choice([-1.0, 1.0])
    d, e, angle = (
        sign * rng.uniform(0.02, 0.2),
        1.0 + sign * rng.uniform(0.003, 0.05),
        sign * rng.uniform(0.3, 3.0),
    )
    shift = rng.uniform(0.05, 0.4, 2) * rng.choice([-1, 1], 2)
    planted = {
        "translation": (mapped_points(exact, lambda p: p + shift), float(np.hypot(*shift))),
        "constant offset": (offset(exact, d), d),
        "scale": (mapped_points(exact, lambda p: p * e), e),
    }
    if name != "torus":
        planted["rotation"] = (mapped_points(exact, lambda p: turned(p, angle)), angle)
    for kind, (differing, size) in planted.items():
        result, worst = found_in(part, differing, exact)
        assert not result.passed
        assert (worst.backend, worst.cause) == ("a", kind), worst
        measured = np.log(worst.cause_size) / np.log(size) if kind == "scale" else worst.cause_size / size
        assert measured == pytest.approx(1.0, abs=0.04), (kind, size, worst)
        assert worst.cause_share > 0.9
        assert f"{100 * worst.cause_share:.0f} %" in worst.cause_text


@pytest.mark.parametrize("name", ["two-spheres", "torus"])
@pytest.mark.parametrize("dz", [0.07, -0.11])
def test_a_wrong_height_is_fitted_by_the_rate_of_the_section(parts, stacks, name, dz):
    exact = stacks[name]
    wrong = replace(slice_part(parts[name], exact.heights + dz, "planecut"), heights=exact.heights)
    _, worst = found_in(parts[name], wrong, exact)
    assert worst.cause == "wrong height"
    assert worst.cause_size == pytest.approx(dz, rel=0.05)


@pytest.mark.parametrize(("words", "factor"), [("inches taken for", 1 / 25.4), ("for inches", 25.4), ("centim", 0.1)])
def test_a_unit_of_the_whole_part_is_found(parts, stacks, words, factor):
    part, exact = parts["bracket"], stacks["bracket"]
    other = slice_part(from_arrays(part.vertices * factor, part.faces), exact.heights, "planecut")
    _, worst = found_in(part, other, exact)
    assert worst.cause == "wrong unit"
    assert worst.cause_size == pytest.approx(factor)
    assert words in worst.cause_text


def test_mirrors_and_half_turns(parts, stacks):
    part, exact = parts["nested"], stacks["nested"]
    flipped = from_rings(
        exact.heights, [[exact.ring(r)[::-1] * (-1, 1) for r in exact.rings_of(k)] for k in range(len(exact))]
    )
    _, worst = found_in(part, flipped, exact)
    assert worst.cause == "mirrored"
    assert "about x = 0.000 mm" in worst.cause_text
    _, worst = found_in(part, mapped_points(exact, lambda p: np.subtract((30, 20), p)), exact)
    assert worst.cause == "rotation"
    assert abs(worst.cause_size) == pytest.approx(180.0)


@pytest.mark.parametrize("step", [0.01, 0.037, 0.25])
def test_a_grid_is_found_with_its_step(parts, stacks, step):
    exact = stacks["two-spheres"]
    _, worst = found_in(parts["two-spheres"], mapped_points(exact, lambda p: np.round(p / step) * step), exact)
    assert worst.cause == "quantised coordinates"
    assert worst.cause_size == pytest.approx(step, rel=1e-6)


def ringed(layers, function):
    """Layers of other rings, by a function of ring, signed area and depth in the nest."""
    made = []
    for k in range(len(layers)):
        rings = []
        for r in layers.rings_of(k):
            depth, above = 0, layers.parents[r]
            while above >= 0:
                depth, above = depth + 1, layers.parents[above]
            rings += function(layers.ring(r), layers.ring_areas[r], depth)
        made.append(rings)
    return from_rings(layers.heights, made)


@pytest.mark.in_turn(2)
@pytest.mark.parametrize(
    ("kind", "function"),
    [
        ("missing holes", lambda ring, area, _: [ring] if area > 0 else []),
        ("missing outer rings", lambda ring, _, depth: [ring] if depth < 2 else []),
        ("extra outer rings", lambda ring, _, depth: [ring, np.add(ring, (60, 0))] if not depth else [ring]),
        ("wrong ring direction", lambda ring, _, __: [ring[::-1]]),
        ("wrong nesting", lambda ring, _, depth: [ring[::-1]] if depth == 2 else [ring]),
    ],
)
def test_rings_are_told_by_their_class(parts, stacks, kind, function):
    exact = stacks["nested"]
    _, worst = found_in(parts["nested"], ringed(exact, function), exact)
    assert worst.cause == kind, worst
    assert worst.cause_share > 0.95
    assert worst.cause_unit == "rings"


def test_layers_that_are_dropped_doubled_or_shifted(parts, stacks):
    part, exact = parts["torus"], stacks["torus"]
    empty = ringed(exact, lambda ring, _, __: [ring])
    every_third = from_rings(
        exact.heights, [[empty.ring(r) for r in empty.rings_of(k)] if k % 3 else [] for k in range(LAYERS)]
    )
    dropped, worst = found_in(part, every_third, exact)
    assert {f.cause for f in dropped.findings} == {"dropped layers"}
    assert worst.cause_size == np.count_nonzero(np.arange(LAYERS) % 3 == 0)
    doubled, worst = found_in(part, replace(exact.take(np.arange(LAYERS) // 2 * 2), heights=exact.heights), exact)
    assert {f.cause for f in doubled.findings} == {"duplicated layers"}
    assert worst.cause_size == LAYERS // 2
    above = np.minimum(np.arange(LAYERS) + 2, LAYERS - 1)
    _, worst = found_in(part, replace(exact.take(above), heights=exact.heights), exact)
    assert (worst.cause, worst.cause_size) == ("shifted layers", 2.0)


def test_another_inside_rule_is_told_by_the_windings_of_the_mesh(parts):
    first, second = box((0, 0, 0), (9, 8, 5)), box((4, 3, -1), (14, 12, 6))
    part = joined(first, second)
    heights = np.array([1.03, 2.07, 3.11])
    united, odd = (
        shapely.box(0, 0, 9, 8) | shapely.box(4, 3, 14, 12),
        shapely.box(0, 0, 9, 8) ^ shapely.box(4, 3, 14, 12),
    )
    a, b = (from_polygons(heights, [[region]] * 3) for region in (odd, united))
    _, worst = found_in(part, a, b)
    assert worst.cause == "other winding rule"
    assert "odd" in worst.cause_text


@pytest.mark.parametrize("name", ["bracket", "two-spheres", "torus", "nested"])
@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_noise_has_no_cause(parts, stacks, name, seed):
    exact, rng = stacks[name], np.random.default_rng(seed)
    noisy = mapped_points(exact, lambda p: p + rng.normal(size=p.shape) * 0.02)
    result, _ = found_in(parts[name], noisy, exact)
    assert not result.passed
    assert not {f.cause for f in result.findings} & set(KINDS)
    assert all(f.cause_size is None for f in result.findings)


def test_every_cause_has_a_remedy_that_names_the_slicer(parts, stacks):
    assert set(KINDS) <= set(REMEDIES)
    exact = stacks["torus"]
    _, worst = found_in(parts["torus"], mapped_points(exact, lambda p: np.add(p, (0.3, 0.0))), exact)
    assert "slicing.settings.a" in worst.remedy


def test_reports_know_what_every_cause_means():
    words = pytest.importorskip("ebamcheck_reports.words")
    assert set(REMEDIES) <= set(words.CAUSES)
