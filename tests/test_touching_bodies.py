"""Bodies that touch are one region, a gap wider than the bound is kept, and the comparison says what it sets aside."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from parts import box, join

import ebamcheck
from ebamcheck.errors import BackendFailed
from ebamcheck.mesh.part import from_arrays
from ebamcheck.mesh.topology import weld
from ebamcheck.pipeline.findings import set_aside_findings
from ebamcheck.testing.solids import mapped, prism, turn

EXACT = ("planecut", "manifold")
HEIGHTS = np.array([3.1, 9.7, 16.3])


def welded(*bodies):
    return from_arrays(*weld(join(*bodies).triangles))


def ring(low_rad, high_rad, outer=32.0, inner=26.0, chords=96):
    """A piece of a pipe's section; its ends lie on radii."""
    angle = np.linspace(low_rad, high_rad, chords + 1)
    round_ = np.column_stack([np.cos(angle), np.sin(angle)])
    round_[np.abs(round_) < 1e-12] = 0.0
    return shapely.Polygon(np.concatenate([outer * round_, inner * round_[::-1]]))


PIPE = [prism(ring(low, low + np.pi), 0.0, 20.0) for low in (0.0, np.pi)]
BLOCK = box((0, 0, 0), (40, 40, 20))
CASES = {
    "part of a face": (welded(BLOCK, box((40, 10, 0), (80, 30, 20))), 1, 2400.0),
    "a whole face": (welded(BLOCK, box((40, 0, 0), (80, 40, 20))), 1, 3200.0),
    "two halves of a pipe": (welded(*PIPE), 2, 2 * ring(0.0, np.pi).area),
    "an edge": (welded(BLOCK, box((40, 40, 0), (80, 80, 20))), 2, 3200.0),
    "one on the other": (welded(box((0, 0, 0), (40, 40, 10)), box((0, 0, 10), (40, 40, 20))), 1, 1600.0),
    "a gap of 0.001 mm": (welded(BLOCK, box((40.001, 0, 0), (80, 40, 20))), 2, 3199.96),
    "a face and an overlap": (
        welded(BLOCK, box((40, 0, 0), (80, 40, 20)), box((30, 30, 0), (50, 60, 20))), 1, 3600.0
    ),
}  # fmt: skip


@pytest.mark.parametrize("backend", EXACT)
@pytest.mark.parametrize("name", CASES)
def test_touching_bodies_are_one_region(name, backend):
    part, rings, area = CASES[name]
    layers = ebamcheck.slice(part, HEIGHTS, backend)
    assert layers.ring_counts().tolist() == [rings] * 3
    assert layers.areas() == pytest.approx([area] * 3, rel=1e-9)
    for k in range(3):
        region = shapely.union_all(layers.polygons(k))
        assert region.length == pytest.approx(float(layers.perimeters()[k]), rel=1e-12)  # no spur


@pytest.mark.parametrize("seed", range(4))
def test_chains_of_bodies_turned_any_way_are_one_region(seed):
    rng = np.random.default_rng(seed)
    for tilted in (False, True) * 4:
        bodies, x, y, before = [], 0.0, 0.0, 0.0
        for _ in range(rng.integers(2, 5)):
            width, height = rng.uniform(3, 20, 2)
            y += rng.uniform(-0.9 * height, 0.9 * before) if bodies else 0.0
            bodies.append(box((x, y, 0), (x + width, y + height, 20)))
            x, before = x + width, height
        matrix = turn(rng.uniform(0, 360))
        if tilted:
            matrix = turn(rng.uniform(-3, 3), "x") @ turn(rng.uniform(-3, 3), "y") @ matrix
        move = (*rng.uniform(-200, 200, 2), 0.0)
        layers = ebamcheck.slice(mapped(join(*bodies), matrix, move), HEIGHTS, "planecut")
        alone = [ebamcheck.slice(mapped(body, matrix, move), HEIGHTS, "planecut").areas() for body in bodies]
        assert layers.ring_counts().tolist() == [1, 1, 1]
        assert layers.areas() == pytest.approx(np.sum(alone, axis=0), rel=1e-11)


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


@pytest.mark.parametrize(
    "name", ["part of a face", "a whole face", "two halves of a pipe", "a face and an overlap"]
)
@pytest.mark.parametrize("angle_deg", [17.0, 59.0, 211.0])
def test_welded_bodies_that_touch_are_one_region_when_turned(name, angle_deg):
    part, rings, area = CASES[name]
    layers = ebamcheck.slice(mapped(part, turn(angle_deg), (7.0, -3.0, 0.0)), HEIGHTS, "planecut")
    assert layers.ring_counts().tolist() == [rings] * 3
    assert layers.areas() == pytest.approx([area] * 3, rel=1e-9)


def test_a_seam_that_rounding_opens_does_not_hide_what_is_solid():
    """The place within the united face at which its winding is found lies on the seam."""
    part = mapped(join(BLOCK, box((40, 0, 0), (80, 40, 20))), turn(59.0), (7.0, -3.0, 0.0))
    assert ebamcheck.slice(part, HEIGHTS, "planecut").areas() == pytest.approx([3200.0] * 3, rel=1e-11)


@pytest.mark.parametrize("name", ["part of a face", "a whole face", "two halves of a pipe"])
def test_trimesh_says_that_it_cannot_cut_touching_bodies(name):
    with pytest.raises(BackendFailed, match=r"touch at z = 3\.1 mm"):
        ebamcheck.slice(CASES[name][0], HEIGHTS, "trimesh")


def test_trimesh_cuts_bodies_with_a_gap():
    assert (
        ebamcheck.slice(CASES["a gap of 0.001 mm"][0], HEIGHTS, "trimesh").ring_counts().tolist() == [2] * 3
    )


@pytest.mark.parametrize(("limit_mm", "agrees", "aside"), [(0.0006, True, 1), (0.0001, False, 0)])
def test_the_comparison_says_how_many_rings_it_sets_aside(limit_mm, agrees, aside):
    exact = ebamcheck.slice(CASES["a gap of 0.001 mm"][0], HEIGHTS, "planecut")
    closed = ebamcheck.slice(box((0, 0, 0), (80, 40, 20)), HEIGHTS, "planecut")
    table = ebamcheck.compare(exact, closed, tolerance_mm=limit_mm, check_part=False)
    assert table["topology_agrees"].tolist() == [agrees] * 3
    assert table["set_aside"].tolist() == [aside] * 3
    told = list(set_aside_findings(table.assign(a="planecut", b="embree")))
    assert len(told) == int(agrees)
    assert all("on 3 layers they agree once up to 1 rings" in finding.text for finding in told)
