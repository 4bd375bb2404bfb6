"""Regions of a mesh, and that no curve is farther from a part than its contour was, however the part is meshed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import ebamcheck, write_stl
from curve_parts import (
    arc,
    as_decimals,
    as_float32,
    bent_plate,
    bracket,
    decimated,
    draft_box,
    extruded,
    frustum,
    knob,
    noisy,
    polygon,
    rounded_box,
    rounded_rectangle,
    scattered_torus,
    split_edges,
    turned,
)

from ebamcheck.curves import contour_error, fit
from ebamcheck.curves.lifting import FLATTEST_SURFACE, Lifting
from ebamcheck.curves.oriented_contours import NO_PLANE
from ebamcheck.mesh.part import Part
from ebamcheck.plugins.registry import models
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.showing.pictures import regions_svg
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.surface.part_surface import surface_of
from ebamcheck.surface.planes import coordinate_error_mm, plane_tolerance_mm
from ebamcheck.surface.surfaces import surfaces

TRUTH_MM = 1e-4
EXACT_MM = 1e-6
LARGEST_SHARE = 1.05
"""Of the contour's largest error, that the curves' may be: the issue's limit for any part."""

SETTINGS = CurveSettings()
Change = Callable[[Part], Part]


def same(part: Part) -> Part:
    return part


def errors(part: Part, truth: Part, layers: int = 7) -> tuple[float, float, float, float]:
    """RMS and largest normal distance of the contours and of the curves, over all rings, mm."""
    low, high = part.bounds[:, 2]
    cut = slice_part(part, low + (high - low) * (np.arange(layers) + 0.43) / layers)
    reference = slice_part(truth, cut.heights)
    found = []
    for measured in (cut, fit(cut, part=part)):
        table = contour_error(measured, reference)
        weights = np.maximum(table["rings"], 1)
        found += [
            float(np.sqrt(np.average(table["normal_rms_mm"] ** 2, weights=weights))),
            float(table["normal_max_abs_mm"].max()),
        ]
    return found[0], found[2], found[1], found[3]


def upright_box(chord_mm: float) -> Part:
    return extruded([rounded_rectangle(30.0, 20.0, 5.0, chord_mm)], 30.0)


CASES: dict[str, tuple[Callable[[float], Part], float, int, Change, float]] = {
    "leaning box, 32 bits": (lambda c: rounded_box([60, 40, 30], 2.5, c), 0.05, 1, as_float32, 0.80),
    "draft box, 4 decimals": (draft_box, 0.05, 0, as_decimals, 0.80),
    "leaning draft box, 4 decimals": (draft_box, 0.05, 3, as_decimals, 0.80),
    "box with split edges": (upright_box, 0.05, 0, lambda p: split_edges(p, 120, 1e-5, near=0.1), 0.0),
    "bracket, tilted": (bracket, 0.05, 1, as_float32, 0.80),
    "bracket, tilted otherwise": (bracket, 0.05, 2, as_float32, 0.80),
    "frustum, tilted": (frustum, 0.1, 7, as_float32, 0.80),
    "cylinder into fillet": (knob, 0.1, 0, same, 0.0),
    "cylinder into fillet, tilted": (knob, 0.05, 1, as_float32, 0.60),
    "slivers": (knob, 0.05, 3, lambda p: as_float32(split_edges(p, 200, 0.0, near=0.02)), 0.0),
    "decimated": (knob, 0.02, 8, lambda p: decimated(p, 0.5), 0.0),
}
"""Maker, chord error, direction (0: as made), what was done to the mesh, and the share of the RMS error that must go."""


@pytest.mark.parametrize("name", CASES)
def test_curves_are_never_farther_from_the_part_than_its_contours(name: str) -> None:
    maker, chord_mm, seed, change, gain = CASES[name]

    def placed(part: Part) -> Part:
        return turned(part, seed) if seed else part

    rms, fitted_rms, largest, fitted_largest = errors(
        change(placed(maker(chord_mm))), placed(maker(TRUTH_MM))
    )
    assert fitted_rms <= (1.0 - gain) * rms
    assert fitted_largest <= LARGEST_SHARE * largest


@pytest.mark.parametrize("degrees", [3.0, 10.0, 25.0])
@pytest.mark.parametrize("seed", [0, 4])
def test_a_bend_between_two_planes_is_sharp_whatever_its_angle(degrees: float, seed: int) -> None:
    part = turned(bent_plate(degrees), seed) if seed else bent_plate(degrees)
    assert errors(part, part)[3] <= EXACT_MM


@pytest.mark.parametrize("sides", [9, 10, 12, 16, 24])
@pytest.mark.parametrize("seed", [0, 5])
def test_a_polygon_stays_one(sides: int, seed: int) -> None:
    radius = 0.97 / (1.0 - np.cos(np.pi / sides))  # a circle would be off by 0.97 mm, under any gate
    part = extruded([polygon(sides, radius)], 30.0, rows=3)
    part = turned(part, seed) if seed else part
    assert errors(part, part)[3] <= EXACT_MM


@pytest.mark.parametrize("noise_mm", [0.05, 0.1, 0.3])
def test_noise_is_not_made_worse(noise_mm: float) -> None:
    model = models()["torus"]
    rms, fitted_rms, largest, fitted_largest = errors(
        noisy(model.tessellate(0.1), noise_mm), model.tessellate(0.001)
    )
    assert fitted_rms <= 1.02 * rms
    assert fitted_largest <= LARGEST_SHARE * largest


def test_an_irregular_mesh_of_a_curved_part_gives_most_of_it_back() -> None:
    part = scattered_torus(1500)
    cut = slice_part(part, [-9.0, -4.0, 1.0, 6.0])
    kept = Lifting(surface_of(part, SETTINGS)).lift(cut)
    height = np.repeat(np.repeat(cut.heights, np.diff(cut.layer_starts)), np.diff(cut.ring_starts))
    wide = np.sqrt(144.0 - height**2)

    def off(points: np.ndarray) -> float:
        radius = np.hypot(*points.T)
        return float(np.sqrt(np.mean(np.minimum(abs(radius - 30.0 - wide), abs(radius - 30.0 + wide)) ** 2)))

    assert off(kept.points) <= 0.5 * off(cut.points)


# -- what the regions are -------------------------------------------------------------------------------


def kinds_of(part: Part) -> dict[str, int]:
    found = surfaces(part, SETTINGS)
    return {kind: sum(s.kind == kind for s in found) for kind in {s.kind for s in found}}


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_rounded_box_is_six_planes_and_twelve_cylinders(seed: int) -> None:
    part = rounded_box([60, 40, 30], 4.0, 0.02)
    part = as_float32(turned(part, seed)) if seed else part
    found = kinds_of(part)
    assert found["plane"] == 6
    assert found["cylinder"] == 12


def test_surfaces_hold_every_facet_once_and_their_area() -> None:
    part = as_float32(turned(bracket(0.05), 3))
    found = surfaces(part, SETTINGS)
    facets = np.sort(np.concatenate([s.facets for s in found]))
    assert np.array_equal(facets, np.arange(len(part.faces)))
    a, b, c = np.moveaxis(part.triangles, 1, 0)
    total = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert sum(s.area_mm2 for s in found) == pytest.approx(total)
    radii = sorted(float(s.figure.split()[1]) for s in found if s.kind == "cylinder")
    assert radii == pytest.approx([2.0, 3.0, 3.0, 3.0, 5.0], abs=1e-4)


def test_a_frustum_is_a_cone_between_two_planes() -> None:
    found = surfaces(frustum(0.05), SETTINGS)
    assert sorted(s.kind for s in found) == ["cone", "plane", "plane"]
    cone = next(s for s in found if s.kind == "cone")
    assert cone.figure == f"half angle {np.degrees(np.arctan(13 / 35)):.4g} degrees"


def test_the_order_of_facets_changes_no_region() -> None:
    part = as_float32(turned(bracket(0.05), 3))
    order = np.random.default_rng(1).permutation(len(part.faces))
    shuffled = Part(part.vertices, np.ascontiguousarray(np.roll(part.faces[order], 1, axis=1)))
    one, other = (surfaces(p, SETTINGS) for p in (part, shuffled))
    assert sorted((s.kind, len(s.facets), round(s.area_mm2, 6)) for s in one) == sorted(
        (s.kind, len(s.facets), round(s.area_mm2, 6)) for s in other
    )


@pytest.mark.parametrize("noise_mm", [0.02, 0.1])
def test_the_noise_of_a_freeform_patch_is_told(noise_mm: float) -> None:
    patch = max(surfaces(noisy(scattered_torus(3000), noise_mm), SETTINGS), key=lambda s: len(s.facets))
    assert patch.kind == "freeform"
    assert 0.3 * noise_mm < float(patch.figure.split()[1]) < 3.0 * noise_mm


def test_slivers_in_a_plane_belong_to_it() -> None:
    box = as_float32(turned(split_edges(extruded([polygon(4, 40.0)], 30.0), 150, 0.0, near=0.01), 2))
    assert kinds_of(box) == {"plane": 6}


@pytest.mark.parametrize(("off_mm", "planes"), [(1e-5, 6), (0.01, 4)])
def test_a_vertex_off_its_plane_by_more_than_the_rounding_is_seen(off_mm: float, planes: int) -> None:
    part = extruded([polygon(4, 40.0)], 30.0, rows=2)
    vertices = part.vertices.copy()
    vertices[4, 1] += off_mm  # half-way up the edge between two sides
    assert kinds_of(Part(vertices, part.faces))["plane"] == planes


def test_decimals_and_bits_tell_the_tolerance() -> None:
    part = turned(bracket(0.05), 3)
    assert coordinate_error_mm(as_decimals(part, 4)) == pytest.approx(5e-5)
    assert coordinate_error_mm(as_decimals(part, 3)) == pytest.approx(5e-4)
    assert coordinate_error_mm(as_float32(part)) < 1e-5
    assert plane_tolerance_mm(as_float32(part)) == pytest.approx(5e-5)


# -- the lift -------------------------------------------------------------------------------------------


def test_points_of_planes_stay_and_say_so() -> None:
    part = as_float32(turned(rounded_box([60, 40, 30], 2.5, 0.05), 1))
    cut = slice_part(part, part.bounds[0, 2] + np.array([8.0, 15.0, 22.0]))
    sides = Lifting(surface_of(part, SETTINGS)).lift(cut)
    inside = (sides.plane_before != NO_PLANE) & (sides.plane_after == sides.plane_before)
    assert inside.any()
    assert np.array_equal(sides.points[inside], cut.points[inside])
    moved = np.hypot(*(sides.points - cut.points).T)
    assert moved.max() <= 0.05 / FLATTEST_SURFACE  # the chord error of the mesh
    assert moved.max() > 0.01


def test_arcs_close_on_their_ends() -> None:
    quarter = arc(1.0, 2.0, 3.0, 0.0, 90.0, 0.01)
    assert quarter[0] == pytest.approx([4.0, 2.0])
    assert quarter[-1] == pytest.approx([1.0, 5.0])


# -- inspect --regions ----------------------------------------------------------------------------------


def test_inspect_lists_and_draws_regions(tmp_path: Path) -> None:
    file, picture = tmp_path / "box.stl", tmp_path / "regions.svg"
    write_stl(rounded_box([60, 40, 30], 4.0, 0.05), file)
    told = ebamcheck("inspect", file, "--regions", "--picture", picture, cwd=tmp_path)
    assert "cylinder       12 regions" in told.stdout
    assert picture.read_text(encoding="utf-8").startswith("<svg")
    listed = json.loads(ebamcheck("inspect", file, "--regions", "--json", cwd=tmp_path).stdout)["regions"]
    assert sum(r["facets"] for r in listed) == len(rounded_box([60, 40, 30], 4.0, 0.05).faces)
    refused = ebamcheck("inspect", file, "--picture", picture, cwd=tmp_path)
    assert refused.returncode == 2
    assert "give --regions" in refused.stderr


def test_the_picture_shows_each_kind_with_its_count() -> None:
    part = rounded_box([60, 40, 30], 4.0, 0.05)
    drawn = regions_svg(
        part.triangles, [(s.kind, s.facets) for s in surfaces(part, SETTINGS)], f"Regions of {part.name}"
    )
    assert "plane (6)" in drawn
    assert "cylinder (12)" in drawn
