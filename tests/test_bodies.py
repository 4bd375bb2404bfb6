"""Bodies in bodies: how they lie, the volume of what is built of them, and its check against the sections."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import shapely
from parts import box, join, welded
from typer.testing import CliRunner

import ebamcheck
from ebamcheck.commands.main import app
from ebamcheck.layers.heights import layer_heights
from ebamcheck.mesh.bodies import bodies_of
from ebamcheck.mesh.inspection import inspect
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.pipeline import gates
from ebamcheck.pipeline.findings import set_aside_findings
from ebamcheck.pipeline.gates import volume_off
from ebamcheck.preflight.report import ready
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.testing.solids import mapped, prism, turn
from tests.three_mf import QUADS

OUT, IN = 1, -1


def boxes(*rows: tuple[tuple[float, float, float], tuple[float, float, float], int]) -> Part:
    """Boxes, each by its lowest corner, its size, and whether its facets look out of it; equal corners are welded."""
    corners = []
    for at, size, sense in rows:
        points = np.array(
            [[a + s * (k >> n & 1) for n, (a, s) in enumerate(zip(at, size, strict=True))] for k in range(8)]
        )
        facets = np.array([[q[i] for i in t] for q in QUADS for t in ((0, 1, 2), (0, 2, 3))])
        corners.append(points[facets[:, ::sense]])
    flat = np.concatenate(corners).reshape(-1, 3)
    points, faces = np.unique(flat, axis=0, return_inverse=True)
    return from_arrays(points, faces.reshape(-1, 3))


CUBE, INNER = ((0, 0, 0), (60, 60, 60)), ((20, 20, 20), (20, 20, 20))
PLATE = ((0, 0, 0), (60, 60, 20))
CASES = {
    "same sense": (boxes((*CUBE, OUT), (*INNER, OUT)), 216000, ["inside"]),
    "opposite sense": (boxes((*CUBE, OUT), (*INNER, IN)), 208000, ["inside"]),
    "doubled": (boxes((*PLATE, OUT), (*PLATE, OUT)), 72000, ["doubled"]),
    "three times": (boxes((*PLATE, OUT), (*PLATE, OUT), (*PLATE, OUT)), 72000, ["doubled", "doubled"]),
    "overlap": (boxes(((0, 0, 0), (40, 40, 20), OUT), ((20, 20, 0), (40, 40, 20), OUT)), 56000, ["overlapping"]),
    "three overlap": (boxes(((0, 0, 0), (40, 40, 20), OUT), ((20, 0, 0), (40, 40, 20), OUT), ((30, 30, 0), (40, 40, 20), OUT)), 74000, ["overlapping"] * 3),
    "crossed bars": (boxes(((0, 20, 5), (60, 20, 10), OUT), ((20, 0, 0), (20, 60, 20), OUT)), 12000 + 24000 - 4000, ["overlapping"]),
    "a body in a cavity": (boxes((*CUBE, OUT), (*INNER, IN), ((25, 25, 25), (10, 10, 10), OUT)), 209000, ["inside", "inside"]),
    "a cavity in an overlap": (boxes(((0, 0, 0), (40, 40, 20), OUT), ((20, 0, 0), (40, 40, 20), OUT), ((25, 5, 5), (10, 10, 10), IN)), 48000, ["inside", "overlapping"]),
    "a cavity beside an overlap": (boxes(((0, 0, 0), (40, 40, 20), OUT), ((20, 0, 0), (40, 40, 20), OUT), ((5, 5, 5), (10, 10, 10), IN)), 47000, ["inside", "overlapping"]),
    "side by side": (boxes(((0, 0, 0), (40, 40, 20), OUT), ((50, 0, 0), (40, 40, 20), OUT)), 64000, []),
    "touching": (boxes(((0, 0, 0), (40, 40, 20), OUT), ((40, 10, 0), (40, 20, 20), OUT)), 48000, []),
    "one face": (boxes(((0, 0, 0), (40, 40, 20), OUT), ((40, 0, 0), (40, 40, 20), OUT)), 64000, []),
    "flush inside": (boxes((*PLATE, OUT), ((0, 10, 5), (20, 20, 10), OUT)), 72000, ["inside"]),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_volume_and_relations(name):
    part, volume, kinds = CASES[name]
    found = inspect(part)
    assert found.verdict == "sound"
    assert found.volume_mm3 == part.volume == pytest.approx(volume, rel=1e-9)
    assert sorted(relation.kind for relation in found.relations) == kinds
    assert found.union_known


def test_a_tip_that_reaches_out_between_the_points_that_are_looked_at_is_no_inner_body():
    """One point of each facet lies in the block; over it stands a pyramid of (20/34)^3 of the tip."""
    block = boxes(((-30, -30, 0), (60, 60, 20), OUT))
    tip = np.array([[-10.0, -6.0, 6.0], [10.0, -6.0, 6.0], [0.0, 12.0, 6.0], [0.0, 0.0, 40.0]])
    part = from_arrays(
        np.vstack([block.vertices, tip]),
        np.vstack([block.faces, len(block.vertices) + np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])]),
    )
    found = inspect(part)
    assert [relation.kind for relation in found.relations] == ["overlapping"]
    assert found.volume_mm3 == pytest.approx(72000.0 + 0.5 * 20.0 * 18.0 * 34.0 / 3.0 * (20.0 / 34.0) ** 3)


@pytest.mark.parametrize("name", CASES)
def test_sections_have_the_volume_that_is_told(name):
    part, volume, _ = CASES[name]
    cuts = layer_heights(part, 1.0)
    areas = slice_part(part, cuts).areas()
    assert float(areas.sum()) == pytest.approx(volume, rel=0.05)
    assert volume_off(part, cuts, areas, Config().changed(layers={"layer_height_mm": 1.0})) == ""


def _told(part: Part, share: float) -> Part:
    """Part with the volume of its sections plus a share of that."""
    other = dataclasses.replace(part)
    known = bodies_of(part)
    other.__dict__["bodies"] = dataclasses.replace(known, volume_mm3=known.volume_mm3 * (1.0 + share))
    return other


@pytest.mark.parametrize("name", ["same sense", "doubled", "side by side", "overlap"])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_volume_just_outside_of_the_bound_shuts_the_gate_and_one_just_inside_does_not(name, sign):
    part, volume, _ = CASES[name]
    config = Config().changed(layers={"layer_height_mm": 0.5})
    cuts = layer_heights(part, 0.5)
    areas = slice_part(part, cuts).areas()
    seen = {"same sense": 2 * 400, "doubled": 4 * 3600, "side by side": 0, "overlap": 4 * 1600}[name]
    tolerance = config.process.mass_tolerance
    allowed = tolerance + 0.25 * seen / volume
    inside, outside = (sign * allowed * times for times in (1 / 1.2, 1.2))
    assert volume_off(_told(part, inside), cuts, areas, config) == ""
    said = volume_off(_told(part, outside), cuts, areas, config)
    assert "mm3 apart, over" in said
    shut = gates.input_gate(inspect(part), said)
    assert not shut.passed
    assert shut.figure == 1.0
    assert gates.input_gate(inspect(part)).passed


def test_a_shell_that_cuts_itself_shuts_the_gate():
    # A box whose upper half is turned about by a quarter more than once would be odd; a bow tie swept upwards is plain.
    outline = np.array([(0, 0), (40, 0), (40, 40), (10, 40), (10, 10), (30, 10), (30, 30), (0, 30)], float)
    n = len(outline)
    points = np.concatenate([np.c_[outline, np.zeros(n)], np.c_[outline, np.full(n, 20.0)]])
    sides = [t for k in range(n) for t in ((k, (k + 1) % n, (k + 1) % n + n), (k, (k + 1) % n + n, k + n))]
    lids = [t for k in range(1, n - 1) for t in ((0, k + 1, k), (n, n + k, n + k + 1))]
    part = from_arrays(points, [*sides, *lids])
    assert inspect(part).verdict == "overlapping"
    cuts = layer_heights(part, 1.0)
    areas = slice_part(part, cuts).areas()
    lost = part.volume - 20.0 * areas[0]
    assert abs(lost) > 0.05 * part.volume
    assert "facets of one body cut each other" in volume_off(
        part, cuts, areas, Config().changed(layers={"layer_height_mm": 1.0})
    )


@pytest.mark.parametrize(
    ("name", "level", "words"),
    [
        ("same sense", "warning", "body inside a body, same sense: lost cavity? It is built as solid metal"),
        ("doubled", "warning", "is body 1 once more, doubled: it is built once"),
        ("opposite sense", "pass", "lies in body 1, opposite sense: its surface bounds a cavity"),
        ("overlap", "pass", "overlaps body 1: they are built as one"),
    ],
)
def test_inspect_and_preflight_say_what_is_made_of_each_body(name, level, words, tmp_path):
    path = ebamcheck.save(CASES[name][0], tmp_path / "part.stl")
    found = [check for check in ready(path, Config()).preflight.checks if check.name == "bodies"]
    assert [(check.level, words in check.text) for check in found] == [(level, True)]
    told = CliRunner().invoke(app, ["inspect", str(path)])
    assert told.exit_code == 0
    assert words in told.stdout
    assert f"volume mm3           {CASES[name][1]:.9g}" in told.stdout


def test_too_many_to_unite_is_said(monkeypatch, tmp_path):
    monkeypatch.setattr("ebamcheck.mesh.bodies.MOST_CUT_FACETS", 10)
    part = dataclasses.replace(CASES["overlap"][0])
    found = inspect(part)
    assert not found.union_known
    assert found.volume_mm3 == pytest.approx(64000)
    checks = ready(ebamcheck.save(part, tmp_path / "part.stl"), Config()).preflight.checks
    assert any("is the sum of all of them" in check.text for check in checks if check.level == "warning")


def test_more_metal_than_the_box_holds_is_not_sound():
    """Of 300 copies of one cube nobody compares all pairs; the sum of their volumes is told, but not as a sound part."""
    cube = ((0, 0, 0), (10, 10, 10), OUT)
    many = inspect(boxes(*[cube] * 300))
    assert not many.union_known
    assert (many.verdict, many.passed) == ("overlapping", False)
    assert "300000 mm3 in a box of 1000 mm3" in many.why
    assert inspect(boxes(cube)).verdict == "sound"
    assert inspect(boxes(cube, cube)).verdict == "sound"


# -- bodies that touch --------------------------------------------------------------------------------


EXACT = ("planecut", "manifold")
HEIGHTS = np.array([3.1, 9.7, 16.3])


def touching(*bodies):
    return welded(join(*bodies))


def ring(low_rad, high_rad, outer=32.0, inner=26.0, chords=96):
    """A piece of a pipe's section; its ends lie on radii."""
    angle = np.linspace(low_rad, high_rad, chords + 1)
    round_ = np.column_stack([np.cos(angle), np.sin(angle)])
    round_[np.abs(round_) < 1e-12] = 0.0
    return shapely.Polygon(np.concatenate([outer * round_, inner * round_[::-1]]))


PIPE = [prism(ring(low, low + np.pi), 0.0, 20.0) for low in (0.0, np.pi)]
BLOCK = box((0, 0, 0), (40, 40, 20))
TOUCHING = {
    "part of a face": (touching(BLOCK, box((40, 10, 0), (80, 30, 20))), 1, 2400.0),
    "a whole face": (touching(BLOCK, box((40, 0, 0), (80, 40, 20))), 1, 3200.0),
    "two halves of a pipe": (touching(*PIPE), 2, 2 * ring(0.0, np.pi).area),
    "an edge": (touching(BLOCK, box((40, 40, 0), (80, 80, 20))), 2, 3200.0),
    "one on the other": (touching(box((0, 0, 0), (40, 40, 10)), box((0, 0, 10), (40, 40, 20))), 1, 1600.0),
    "a gap of 0.001 mm": (touching(BLOCK, box((40.001, 0, 0), (80, 40, 20))), 2, 3199.96),
    "a face and an overlap": (
        touching(BLOCK, box((40, 0, 0), (80, 40, 20)), box((30, 30, 0), (50, 60, 20))), 1, 3600.0
    ),
}  # fmt: skip


@pytest.mark.parametrize("backend", EXACT)
@pytest.mark.parametrize("name", TOUCHING)
def test_touching_bodies_are_one_region(name, backend):
    part, rings, area = TOUCHING[name]
    layers = ebamcheck.slice(part, HEIGHTS, backend)
    assert layers.ring_counts().tolist() == [rings] * 3
    assert layers.areas() == pytest.approx([area] * 3, rel=1e-9)
    for k in range(3):
        region = shapely.union_all(layers.polygons(k))
        assert region.length == pytest.approx(float(layers.perimeters()[k]), rel=1e-12)  # no spur


@pytest.mark.parametrize(("share", "rings"), [(1 / 1.2, 1), (1.2, 2)])
def test_a_gap_is_kept_from_the_bound_on(share, rings):
    bound = 4.0 * np.spacing(80.0)
    step = np.spacing(40.0)
    gap = step * (np.floor(share * bound / step) if rings == 1 else np.ceil(share * bound / step))
    part = join(BLOCK, box((40.0 + gap, 0, 0), (80, 40, 20)))
    assert ebamcheck.slice(part, HEIGHTS, "planecut").ring_counts().tolist() == [rings] * 3


def grooved():
    """A block with a V-groove along x, 5 mm deep: its ground lies at y = 20, z = 10."""
    outline = shapely.Polygon([(0, 0), (40, 0), (40, 15), (30, 15), (20, 10), (10, 15), (0, 15)])
    return mapped(prism(outline, 0.0, 40.0), np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))


@pytest.mark.parametrize("beside", [False, True])
def test_a_groove_of_one_body_is_kept_however_narrow(beside):
    """Bodies touch within the bound; the sides of one body do not, even beside another one."""
    part = grooved()
    if beside:
        part = join(part, box((0, 40, 0), (40, 60, 20)))
    heights = [np.nextafter(10.0, 0.0), np.nextafter(10.0, 20.0), 12.0]
    assert ebamcheck.slice(part, heights, "planecut").ring_counts().tolist() == [1, 2, 2]


def test_a_seam_that_rounding_opens_does_not_hide_what_is_solid():
    """The place within the united face at which its winding is found lies on the seam."""
    part = mapped(join(BLOCK, box((40, 0, 0), (80, 40, 20))), turn(59.0), (7.0, -3.0, 0.0))
    assert ebamcheck.slice(part, HEIGHTS, "planecut").areas() == pytest.approx([3200.0] * 3, rel=1e-11)


@pytest.mark.parametrize(("limit_mm", "agrees", "aside"), [(0.0006, True, 1), (0.0001, False, 0)])
def test_the_comparison_says_how_many_rings_it_sets_aside(limit_mm, agrees, aside):
    exact = ebamcheck.slice(TOUCHING["a gap of 0.001 mm"][0], HEIGHTS, "planecut")
    closed = ebamcheck.slice(box((0, 0, 0), (80, 40, 20)), HEIGHTS, "planecut")
    table = ebamcheck.compare(exact, closed, tolerance_mm=limit_mm, check_part=False)
    assert table["topology_agrees"].tolist() == [agrees] * 3
    assert table["set_aside"].tolist() == [aside] * 3
    told = list(set_aside_findings(table.assign(a="planecut", b="embree")))
    assert len(told) == int(agrees)
    assert all("on 3 layers they agree once up to 1 rings" in finding.text for finding in told)
