"""Curves that recover the surface behind a mesh are never farther from the part than its contours were."""

from __future__ import annotations

import itertools
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ebamcheck
from benchmarks.chance_curves import errors_of
from benchmarks.curve_parts import CurvePart, heights_of, part_of, parts
from benchmarks.curve_parts_meshes import turn
from benchmarks.curve_parts_solids import regular_prism
from ebamcheck.curves import LINE, Curves, contour_error, error_reduction, fit, fit_deviation
from ebamcheck.curves.oriented_contours import FLAT_MM
from ebamcheck.errors import EbamcheckError, SettingsError
from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.plugins.registry import models
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.surface.part_surface import surface_of
from ebamcheck.surface.regions import PLANE

MODELS = models()
LADDER = MODELS["ladder"]
METHODS = ("surface", "bounded")
TOLERANCE_MM = 0.02


def sliced(part: Part, count: int = 6) -> Layers:
    low, high = part.bounds[:, 2]
    return slice_part(part, low + (high - low) * (np.arange(count) + 0.5) / count)


def truth(model: Any, layers: Layers) -> Layers:
    return from_polygons(layers.heights, [model.section(z, 1e-5) for z in layers.heights])


def gains(layers: Layers, reference: Layers, method: str, part: Part) -> Any:
    return error_reduction(contour_error(layers, reference), contour_error(fit(layers, method, part=part), reference))


# -- what the fits are for -----------------------------------------------------------------------------


COARSEST = pytest.mark.xfail(
    strict=True,
    reason="facets of 150 to 320 mm speak for less than half of the lift that their part would need: the largest error falls "
    "by 45 % instead of 80 %, and with facets of 1 mm chord error the RMS by 39 % instead of 90 %",
)


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "mesh_mm", [pytest.param(1.0, marks=COARSEST), pytest.param(0.8, marks=COARSEST), 0.4, 0.2, 0.1]
)
def test_a_coarse_freeform_mesh_gives_its_part_back(mesh_mm: float, method: str) -> None:
    part = LADDER.tessellate(mesh_mm)
    layers = sliced(part)
    found = gains(layers, truth(LADDER, layers), method, part)
    assert found["polar_rms"] >= 0.90
    assert found["polar_max"] >= 0.80


GAINS = {"irregular": 0.85, "cad": 0.5}
"""Share of the RMS error that must go, at least, by the kind of mesh."""

QUICK = {
    *(part.name for part in parts(quick=True)),
    "bracket, direction 11, ascii4",
    "box r 5 of slivers, direction 12",
}


FARTHER = "bearing ring decimated by 0.1 mm, direction 11"
"""Its curve is 5.1 % farther from the part than the contour, at one place."""


def marks_of(name: str) -> list[pytest.MarkDecorator]:
    known = [pytest.mark.xfail(reason="the largest error grows by 5.1 %, at one place")] if name == FARTHER else []
    return known if name in QUICK else [*known, pytest.mark.slow]


@pytest.mark.parametrize("part", [pytest.param(p, id=p.name, marks=marks_of(p.name)) for p in parts()])
def test_no_curve_is_farther_from_its_part_than_the_contour(part: CurvePart) -> None:
    mesh = part.mesh()
    layers = slice_part(mesh, heights_of(mesh, 5))
    truth = part.truth(layers.heights)
    (rms, largest), (fitted_rms, farthest) = (errors_of(one, truth) for one in (layers, fit(layers, part=mesh)))
    slack_mm = 2e-4  # of the truth's chords, and of files with four decimals
    assert fitted_rms <= (1.02 if part.kind == "noise" else 1.0 - GAINS.get(part.kind, 0.0)) * rms + slack_mm
    assert farthest <= 1.05 * largest + slack_mm
    assert part.kind != "flat" or farthest <= slack_mm


def test_fewer_blocks_for_a_looser_tolerance() -> None:
    part = LADDER.tessellate(0.4)
    layers = sliced(part)
    counts = [fit(layers, part=part, tolerance_mm=t).block_count() for t in (0.002, 0.02, 0.2)]
    assert counts[0] > counts[1] >= counts[2]


# -- what stays as it is -------------------------------------------------------------------------------


def turned(part: Part) -> Part:
    return from_arrays(part.vertices @ turn(7).T, part.faces, part.name)


SHARP = ("cube", "pyramid", "menger-1", "menger-2", "tilted-plate", "comb", "thin-walls")


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("name", SHARP)
@pytest.mark.parametrize("method", METHODS)
def test_parts_without_a_smooth_edge_stay_exact(name: str, method: str) -> None:
    for part in (MODELS[name].tessellate(0.1), turned(MODELS[name].tessellate(0.1))):
        layers = sliced(part, 8)
        curves = fit(layers, method, part=part)
        # The plate's 32-bit vertices are not quite in its planes: points on its facets' diagonals go.
        assert set(curves.kind) == {LINE}
        assert fit_deviation(curves, layers)["bulge_mm"].max() < (FLAT_MM if name == "tilted-plate" else 1e-9)


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 8])
def test_a_crease_is_what_the_angle_says(sides: int) -> None:
    part = part_of(regular_prism(sides, 10.0, 20.0)(1.0), "prism")
    layers = sliced(part, 3)
    sharp = fit(layers, "surface", part=part, crease_angle_deg=min(360.0 / sides, 90.0) - 1.0)
    assert set(sharp.kind) == {LINE}
    assert sharp.block_count() == 3 * sides
    if sides >= 8:  # and smooth, it is the cylinder through its edges
        wide = 360.0 / sides + 1.0
        smooth = fit(layers, "surface", part=part, crease_angle_deg=wide, polygon_angle_deg=wide)
        radii = np.hypot(*smooth.sample(0.1).points.T)
        assert np.abs(radii - 10.0).max() < 0.15 * 10.0 * (1.0 - np.cos(np.pi / sides))


def corpus() -> list[Path]:
    folder = os.environ.get("EBAMCHECK_CORPUS", "")
    return sorted(p for kind in ("good", "nasty") for p in Path(folder, kind).glob("*.stl")) if folder else []


@pytest.mark.long
@pytest.mark.skipif(not corpus(), reason="EBAMCHECK_CORPUS names no folder: the mesh corpus is not part of it")
@pytest.mark.filterwarnings("ignore")
def test_any_mesh_stays_near_its_contour() -> None:
    for path in corpus():
        if path.stat().st_size > 1_000_000:
            continue
        try:
            part = ebamcheck.load(path)
            layers = sliced(part, 7)
        except EbamcheckError:
            continue
        for method in METHODS:
            curves = fit(layers, method, part=part)
            assert np.isfinite(curves.control).all(), path
            assert_chained(curves)
            chords = np.hypot(*np.diff(layers.points, axis=0).T) if len(layers.points) > 1 else np.zeros(1)
            edges = np.ptp(part.triangles, axis=1).max(initial=0.0)
            bulge = fit_deviation(curves, layers)["bulge_mm"].max()
            # An edge that bends by the crease angle at both ends rises by a tenth of its length.
            assert bulge <= 0.2 * max(edges, chords.max()) + TOLERANCE_MM, path


# -- laws ----------------------------------------------------------------------------------------------


def assert_chained(curves: Curves) -> None:
    """Each piece ends, bit for bit, where the next starts; closed rings end where they start."""
    for ring in range(curves.closed.size):
        pieces = [curves.piece(i) for i in curves.pieces_of(ring)]
        for a, b in itertools.pairwise(pieces):
            assert np.array_equal(a.control[-1], b.control[0])
        if pieces and curves.closed[ring]:
            assert np.array_equal(pieces[-1].control[-1], pieces[0].control[0])


def distance(a: Curves, b: Curves) -> float:
    """Greatest normal distance of one stack of curves from another with the same rings."""
    found = contour_error(a, b)
    assert not found["unmatched"].any()
    return float(found["normal_max_abs_mm"].max())


@pytest.mark.parametrize("method", METHODS)
def test_the_order_of_facets_and_turns_about_z_change_nothing(method: str) -> None:
    part = MODELS["impeller"].tessellate(0.5)
    layers = sliced(part, 3)
    curves = fit(layers, method, part=part)
    order = np.random.default_rng(3).permutation(len(part.faces))
    shuffled = from_arrays(part.vertices, np.roll(part.faces[order], 1, axis=1))
    assert distance(curves, fit(sliced(shuffled, 3), method, part=shuffled)) < 1e-4
    quarter = from_arrays(part.vertices[:, [1, 0, 2]] * [-1.0, 1.0, 1.0], part.faces)
    back = fit(sliced(quarter, 3), method, part=quarter)
    there = Curves(**{**vars_of(back), "control": back.control[:, ::-1] * [1.0, -1.0]})
    assert distance(curves, there) < (1e-4 if method == "surface" else 2 * TOLERANCE_MM)


def vars_of(curves: Curves) -> dict[str, Any]:
    return {name: getattr(curves, name) for name in curves.__dataclass_fields__}


def test_a_larger_part_has_larger_curves() -> None:
    part = LADDER.tessellate(1.0)
    double = from_arrays(2.0 * part.vertices, part.faces)
    small, large = (fit(sliced(p, 3), "surface", part=p) for p in (part, double))
    grown = {"control": 2.0 * small.control, "heights": 2.0 * small.heights}
    assert distance(Curves(**{**vars_of(small), **grown}), large) < 1e-4


@pytest.mark.parametrize("method", METHODS)
def test_threads_do_not_change_a_byte(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    part = LADDER.tessellate(0.4)
    layers = sliced(part, 40)
    found = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("EBAMCHECK_THREADS", threads)
        found.append(fit(layers, method, part=part))
    for name in ("kind", "control", "knots", "control_starts", "knot_starts", "ring_starts"):
        assert np.array_equal(getattr(found[0], name), getattr(found[1], name))
        assert np.array_equal(getattr(found[0], name), getattr(found[2], name))


@pytest.mark.parametrize("method", METHODS)
def test_pieces_join_without_a_kink(method: str) -> None:
    part = LADDER.tessellate(0.2)
    curves = fit(sliced(part, 6), method, part=part)
    assert_chained(curves)
    spans = curves.bezier_spans()
    for ring in range(curves.closed.size):
        B = spans.points[spans.ring == ring]
        out, into = np.roll(B[:, 1] - B[:, 0], -1, axis=0), B[:, 3] - B[:, 2]
        kink = np.abs(np.arctan2(into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0], (into * out).sum(axis=1)))
        assert kink[:-1].max() < 1e-6
        assert kink[-1] < 5e-3  # where the ring closes, an arc may end a little off


# -- normals -------------------------------------------------------------------------------------------


def test_normals_of_a_sphere_are_its_radii() -> None:
    part = MODELS["sphere"].tessellate(0.2)
    found = surface_of(part, CurveSettings())
    centre = part.bounds.mean(axis=0)
    corners = part.vertices[part.faces.reshape(-1)] - centre
    radii = corners / np.linalg.norm(corners, axis=1)[:, None]
    normals = found.normals[found.sectors.reshape(-1)]
    assert np.arccos(np.clip((radii * normals).sum(axis=1), -1.0, 1.0)).max() < 0.02
    assert found.smooth.all()


def test_a_cube_has_three_normals_at_each_corner() -> None:
    part = MODELS["cube"].tessellate(0.1)
    found = surface_of(part, CurveSettings())
    assert len(found.normals) == 24
    assert np.allclose(np.sort(np.abs(found.normals), axis=1), [0.0, 0.0, 1.0])
    assert (found.kind == PLANE).all()


# -- files and wrong use -------------------------------------------------------------------------------


def test_without_part_or_edges_the_contour_itself_is_followed() -> None:
    part = MODELS["sphere"].tessellate(0.05)
    layers = replace(sliced(part, 4), mesh=None)
    deviation = fit_deviation(fit(layers), layers)
    assert deviation["points_mm"].max() <= TOLERANCE_MM + 2e-3
    with pytest.raises(SettingsError, match="needs part="):
        fit(layers, "surface")


def test_contours_of_another_part_are_refused() -> None:
    with pytest.raises(SettingsError, match="another mesh"):
        fit(sliced(MODELS["sphere"].tessellate(0.1), 2), part=MODELS["sphere"].tessellate(0.2))


@pytest.mark.parametrize("method", METHODS)
def test_nothing_gives_nothing(method: str) -> None:
    part = MODELS["cube"].tessellate(0.1)
    layers = slice_part(part, [1000.0, 1001.0])
    curves = fit(layers, method, part=part)
    assert len(curves) == 2
    assert curves.block_count() == 0
