"""Evidence for curves: never farther from the part than the contour was, and what shuts the gate of the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.curve_parts import CAD, CAD_MM, heights_of, part_of
from benchmarks.curve_parts_meshes import as_file, turned
from benchmarks.curve_parts_solids import lathe
from ebamcheck.curves import fit, fit_deviation, fit_for_program
from ebamcheck.curves.crossings import crossings
from ebamcheck.curves.gate import (
    CROSSING,
    NESTING,
    PLANE,
    POLYLINE,
    SAGITTA,
    TURNED,
    Slack,
    evidence,
    polylines,
    stack_evidence,
)
from ebamcheck.curves.lifting import OF_SAGITTAS, Lifting, Limits
from ebamcheck.errors import SettingsError
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.mesh.part import Part
from ebamcheck.pipeline.findings import fit_findings
from ebamcheck.pipeline.fit import FitVerdict
from ebamcheck.pipeline.gates import fit_gate
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.surface.part_surface import surface_of
from ebamcheck.surface.regions import PLANE as FLAT_REGION
from ebamcheck_models import SPHERE, TORUS

SLACK = Slack(0.022, 0.0021)


# -- sagittas ------------------------------------------------------------------------------------------------


def test_sagittas_of_a_sphere_are_those_of_its_chords() -> None:
    part = SPHERE.tessellate(0.1)
    radius = SPHERE.radius_mm
    ends = part.vertices[part.faces], part.vertices[np.roll(part.faces, -1, axis=1)]
    chords = np.linalg.norm(ends[1] - ends[0], axis=2).reshape(-1)
    heights = radius - np.sqrt(radius**2 - 0.25 * chords**2)
    found = surface_of(part, CurveSettings()).sagittas
    assert 0.5 < found.typical / np.median(heights) < 2.0
    assert 0.5 < np.median(found.largest) / np.median(heights) < 2.0


@pytest.mark.parametrize("kept", ["float64", "float32", "ascii4"])
@pytest.mark.parametrize("seed", [0, 11, 12])
def test_planes_of_a_rounded_box_are_left_by_nothing(seed: int, kept: str) -> None:
    part = part_of(as_file(turned(CAD["box r 5"](CAD_MM), seed), kept), "box")
    surface = surface_of(part, CurveSettings())
    corners = part.triangles
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    sides = areas > 0.5 * 20.0 * 25.0  # the facets of the six sides are by far the largest
    assert sides.sum() == 12
    assert (surface.kind[sides] == FLAT_REGION).all()
    inner = sides & sides[surface.across.reshape(-1, 3) // 3].any(axis=1)
    assert inner.any()
    limits = Lifting(surface).limits
    assert limits.plausible_mm.reshape(-1, 3)[sides].min() == 0.0


def test_a_strip_from_rim_to_rim_may_be_left_by_some_sagittas() -> None:
    part = part_of(lathe([(0.0, 0.0), (20.0, 0.0), (20.0, 30.0), (0.0, 30.0)])(0.4), "cylinder")
    layers = slice_part(part, [7.0, 15.0])
    columns = len(layers.ring(0)) // 2  # a point on each edge of the strips, and one on each diagonal
    bulge = 20.0 * (1.0 - np.cos(np.pi / columns))
    assert bulge > 0.1
    limits = limits_of(part, layers, CurveSettings(polygon_sagitta_mm=1.0))
    assert limits.of_point == pytest.approx(OF_SAGITTAS * bulge, rel=0.1)
    assert not limits.plane.any()
    assert (fit(layers).evidence.method == 0).all()  # type: ignore[union-attr]


# -- planted faults ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def box() -> tuple[Part, Layers]:
    part = part_of(CAD["box r 5"](CAD_MM), "box")
    return part, slice_part(part, [8.0, 10.0])


def limits_of(part: Part, layers: Layers, settings: CurveSettings = CurveSettings()) -> Limits:  # noqa: B008
    return Lifting(surface_of(part, settings)).allowed(layers)


def judged(part: Part, layers: Layers, moved: Layers) -> np.ndarray:
    return evidence(polylines(moved), layers, limits_of(part, layers), SLACK).cause


def test_a_flat_side_that_bulges_by_a_hundredth_is_refused_and_the_contour_itself_is_not(
    box: tuple[Part, Layers],
) -> None:
    part, layers = box
    assert not judged(part, layers, layers).any()
    ring = layers.ring(0)
    k = int(np.argmax(np.hypot(*(np.roll(ring, -1, axis=0) - ring).T)))
    ahead = np.roll(ring, -1, axis=0)[k] - ring[k]
    out = np.array([ahead[1], -ahead[0]]) / np.hypot(*ahead)
    bulging = np.insert(ring, k + 1, ring[k] + 0.5 * ahead + 0.01 * out, axis=0)
    moved = from_rings(layers.heights, [[bulging], [layers.ring(1)]])
    assert judged(part, layers, moved).tolist() == [PLANE, 0]


def test_a_round_side_that_leaves_its_contour_by_too_many_sagittas_is_not() -> None:
    part = SPHERE.tessellate(0.1)
    layers = slice_part(part, [0.5, 5.0])
    sagitta = surface_of(part, CurveSettings()).sagittas.largest.max()
    causes = []
    for times in (0.5, 1.5 * OF_SAGITTAS):
        grown = 1.0 + times * sagitta / 20.0
        causes.append(judged(part, layers, replace(layers, points=layers.points * grown)).tolist())
    assert causes == [[0, 0], [SAGITTA, SAGITTA]]


def test_a_hole_that_leaves_its_ring_is_not() -> None:
    square = np.array([(0, 0), (10, 0), (10, 10), (0, 10)], float)
    hole = 0.2 * square[::-1] + 4.0
    layers = from_rings([1.0], [[square, hole]])
    moved = from_rings([1.0], [[square, hole + 20.0]])
    free = Limits(np.full(8, 100.0), np.zeros(8, np.bool_))
    assert NESTING in evidence(polylines(moved), layers, free, SLACK).cause.tolist()


def test_a_ring_that_runs_the_other_way_is_not(box: tuple[Part, Layers]) -> None:
    part, layers = box
    plain = polylines(layers)
    rows = np.concatenate([np.arange(plain.control_starts[k + 1] - 1, plain.control_starts[k] - 1, -1) for k in (0, 1)])
    found = evidence(replace(plain, control=plain.control[rows]), layers, limits_of(part, layers), SLACK)
    assert (found.cause == TURNED).all()


def test_rings_that_cross_are_found_and_those_that_do_not_are_not() -> None:
    square = np.array([(0, 0), (10, 0), (10, 10), (0, 10)], float)
    layers = from_rings([1.0, 2.0], [[square, square + 5.0], [square, 0.5 * square[::-1] + 2.5]])
    assert crossings(polylines(layers)).crossed.tolist() == [True, True, False, False]
    t = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    eight = np.column_stack([30.0 * np.sin(t), 15.0 * np.sin(2.0 * t) + 4.0 * np.cos(t)])
    assert crossings(fit(from_rings([1.0], [[eight]]), "chord")).crossed.tolist() == [True]


def test_curves_that_cross_fall_back_to_contours_that_do_not() -> None:
    # Two slender blades beside each other, whose roundings would meet.
    t = np.linspace(-1.0, 1.0, 5)
    low = np.column_stack([20.0 * t, -0.02 - 0.3 * t**2])
    one = np.concatenate([low, [[20.0, -5.0], [-20.0, -5.0]]])[::-1]
    other = one * [1.0, -1.0]
    layers = from_rings([1.0], [[one, other[::-1]]])
    curves = fit(layers, "chord")
    assert not crossings(curves).crossed.any()
    assert curves.evidence is not None
    assert curves.evidence.accepted.all()


# -- layers --------------------------------------------------------------------------------------------------


def test_a_layer_that_stands_out_is_seen() -> None:
    part = SPHERE.tessellate(0.1)
    layers = slice_part(part, np.linspace(-20.0, 20.0, 21))
    curves = fit(layers)
    assert curves.evidence is not None
    assert stack_evidence(curves, layers, part, curves.evidence).accepted
    rows = np.repeat(curves.ring_layer[curves.piece_ring], np.diff(curves.control_starts)) == 10
    swollen = replace(curves, control=np.where(rows[:, None], 1.03 * curves.control, curves.control))
    found = stack_evidence(swollen, layers, part, curves.evidence)
    assert found.jump_excess_mm[10] > 0.0
    assert found.volume_excess_mm3[10] > 0.0
    gate = fit_gate(FitVerdict(swollen, curves.evidence, found, None))
    assert not gate.passed
    assert "layer 11" in gate.text or "layer 12" in gate.text  # it, or the one above it


# -- gate and findings ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sound(box: tuple[Part, Layers]) -> FitVerdict:
    curves = fit(box[1])
    assert curves.evidence is not None
    return FitVerdict(curves, curves.evidence, None, None)


def test_what_shuts_the_gate_is_named(sound: FitVerdict) -> None:
    errors_mm = {"normal_rms_mm": 0.01, "normal_max_abs_mm": 0.05}
    same = replace(sound, reference={"contour": errors_mm, "curve": errors_mm}, farthest_mm=1.0, most_mm=1.021)
    assert fit_gate(same).passed
    worse = {"contour": errors_mm, "curve": {**errors_mm, "normal_rms_mm": 0.3}}
    cause = np.array([0, CROSSING], np.uint8)
    lost = replace(sound.evidence, accepted=np.array([True, False]), cause=cause)
    wrong = {
        "farther from the reference": replace(same, reference=worse),
        "1.1000 mm": replace(same, farthest_mm=1.1),
        "layer 2, z = 10.000 mm": replace(same, evidence=lost),
        "crosses": replace(same, evidence=lost),
    }
    for words, verdict in wrong.items():
        gate = fit_gate(verdict)
        assert not gate.passed
        assert words in gate.text


def test_what_fell_back_is_told_with_place_cause_and_remedy(sound: FitVerdict) -> None:
    method, at = np.array([0, POLYLINE], np.uint8), np.array([[np.nan, np.nan], [3.0, 4.0]])
    fallen = replace(sound.evidence, cause=np.array([0, PLANE], np.uint8), method=method, at=at)
    (told,) = fit_findings(replace(sound, evidence=fallen))
    assert told.code == "curve-fell-back"
    assert told.place == "layer 2, z = 10.000 mm, (3.000, 4.000)"
    assert told.remedy


# -- edges ---------------------------------------------------------------------------------------------------


def test_contours_that_are_not_on_edges_say_so() -> None:
    part = TORUS.tessellate(0.3)
    layers = slice_part(part, [1.0, 7.0])
    off = replace(layers, points=layers.points + 0.3, edge=None, edge_t=None)
    curves = fit(off)
    assert curves.evidence is not None
    assert not curves.evidence.known
    (told,) = fit_findings(FitVerdict(curves, curves.evidence, None, None))
    assert told.code == "curves-not-lifted"
    with pytest.raises(SettingsError, match="on the edges of the part"):
        fit(off, "surface")


def test_rings_that_a_program_may_not_leave_so_far_stay_their_polygon():
    """What the check of the path refuses whatever speaks for it is not made; near the poles the sections are small, and stay curved."""
    part = SPHERE.tessellate(0.8)
    layers = slice_part(part, heights_of(part, 24))
    settings = CurveSettings()
    lifted, kept = fit(layers, part=part), fit_for_program(layers, settings, part)
    far, near = (fit_deviation(curves, layers)[["points_mm", "bulge_mm"]].max(axis=1) for curves in (lifted, kept))
    limit_mm = settings.section_tolerance_mm
    assert far.max() > 1.5 * limit_mm
    assert near.max() <= limit_mm
    fell = (kept.evidence.method == POLYLINE) & (lifted.evidence.method == 0)
    assert fell[far.to_numpy() > limit_mm].all()
    assert not fell[far.to_numpy() < 0.9 * limit_mm].any()
