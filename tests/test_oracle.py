"""Exact slicers against rational arithmetic: any mesh, any plane, degenerate ones first; sampled ones in their bound."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import oracle
import pytest
from parts import box, join, moved, tilted
from scipy.spatial import ConvexHull, cKDTree

import ebamcheck
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.plugins import registry
from ebamcheck.testing.solids import revolved, sphere, steps, torus

EXACT = ("planecut", "manifold")


def usable(name):
    if not registry.probe(name).available:
        pytest.skip(registry.probe(name).why)
    return registry.slicer(name)


def hull(seed, count=14, size=4):
    """Convex hull of integer points: many planes through vertices, edges and faces."""
    points = np.random.default_rng(seed).integers(-size, size + 1, (count, 3)).astype(float)
    found = ConvexHull(points)
    faces = found.simplices.copy()
    a, b, c = points[faces].transpose(1, 0, 2)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), found.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    used, index = np.unique(faces, return_inverse=True)
    return from_arrays(points[used], index.reshape(-1, 3), f"hull {seed}")


def terrain(seed, side=5):
    """A block under a landscape of whole heights: level facets, ridges and pits in many planes."""
    height = np.random.default_rng(seed).integers(1, 5, (side, side)).astype(float)
    x, y = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    top = np.stack([x, y, height], -1).reshape(-1, 3)
    bottom = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    index = np.arange(side * side).reshape(side, side)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    lid = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    border = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    i, j, n = border, np.roll(border, -1), side * side
    walls = [np.column_stack([i + n, j + n, j]), np.column_stack([i + n, j, i])]
    faces = np.concatenate([lid, lid[:, ::-1] + n, *walls])
    return from_arrays(np.concatenate([top, bottom]), faces, f"terrain {seed}")


def spiked():
    """A ring of teeth whose tips and valleys lie in a few common planes."""
    return revolved([(0.0, 0.0), (3.0, 0.0), (2.0, 1.0), (3.0, 2.0), (1.0, 1.5), (0.0, 3.0)], 6, closed=False)


LEAST_AREA_MM2 = 1e-9
"""Rings smaller than this are a hair beside a vertex or an edge, where rounding decides whether they are kept."""

NEAR_MM = 1e-6

SOLIDS = {
    "box": box(),
    "tilted box": tilted(box((0, 0, 0), (7, 5, 3))),
    "steps": steps(),
    "sphere": sphere(3.0, 6, 8),
    "torus": torus(5.0, 2.0, 8, 6),
    "torus on its rim": moved(torus(5.0, 2.0, 8, 6), [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "spiked": spiked(),
    "cavity": join(box((0, 0, 0), (4, 4, 4)), box((1, 1, 1), (3, 3, 3)).reversed()),
    "far away": moved(hull(3), shift=(2.0**20, -(2.0**21), 2.0**12)),
    **{f"hull {seed}": hull(seed) for seed in range(8)},
    **{f"terrain {seed}": terrain(seed) for seed in range(5)},
}
"""Meshes in which two facets meet at every edge."""

OVERLAPPING = {
    "two boxes": join(box((0, 0, 0), (4, 4, 4)), box((2, 1, 1), (6, 3, 5))),
    "box in a box": join(box((0, 0, 0), (4, 4, 4)), box((1, 1, 1), (3, 3, 3))),
    "twice the same": join(box(), box()),
    "flush": join(box((0, 0, 0), (2, 2, 2)), box((2, 0, 0), (4, 2, 2)), box((1, 1, 1), (3, 3, 3))),
    **{f"hulls {seed}": join(hull(seed), moved(hull(seed + 50), shift=(1, 1, 0))) for seed in range(4)},
}


def heights_of(part: Part, seed=0):
    """Planes through vertices, a hair beside them, between them, and beyond the part."""
    levels = np.unique(part.vertices[:, 2])
    levels = levels[:: max(1, len(levels) // 6)]
    low, high = part.bounds[:, 2]
    between = np.random.default_rng(seed).uniform(low, high, 3)
    beside = [np.nextafter(levels[:3], -np.inf), np.nextafter(levels[:3], np.inf)]
    return np.unique(np.concatenate([levels, *beside, between, [low - 1.0, high, high + 1.0]]))


def apart(rings):
    """Least distance of corners of different rings, mm, and of corners that one ring visits twice."""
    points = np.array([(float(x), float(y)) for r in rings for x, y in dict.fromkeys(r)]).reshape(-1, 2)
    return min(cKDTree(points).query(points, k=2)[0][:, 1], default=np.inf) if len(points) > 1 else np.inf


def rational_points(part, count, seed):
    rng = np.random.default_rng(seed)
    low, high = part.bounds[:, :2]
    return low + (high - low) * rng.integers(0, 1025, (count, 2)) / 1024.0


def membership(layers, k, points):
    """Whether points have a positive winding number in the rings of a layer, and their distance from these."""
    rings = [layers.ring(r) for r in layers.rings_of(k)]
    start = np.concatenate([np.zeros((0, 2)), *rings])
    end = np.concatenate([np.zeros((0, 2)), *(np.roll(r, -1, axis=0) for r in rings)])
    along, to = end - start, points[:, None, :] - start
    side = along[:, 0] * to[..., 1] - along[:, 1] * to[..., 0]
    y, y0, y1 = points[:, None, 1], start[:, 1], end[:, 1]
    counts = ((y0 <= y) & (y < y1) & (side > 0)).sum(axis=1) - ((y1 <= y) & (y < y0) & (side < 0)).sum(axis=1)
    square = np.maximum((along**2).sum(axis=1), 1e-300)
    t = np.clip((to * along).sum(axis=2) / square, 0.0, 1.0)
    off = np.linalg.norm(to - t[..., None] * along, axis=2).min(axis=1, initial=np.inf)
    return counts > 0, off


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("backend", EXACT)
@pytest.mark.parametrize("name", SOLIDS)
def test_areas_rings_and_membership_are_exact_at_every_kind_of_plane(name, backend):
    part = SOLIDS[name]
    usable(backend)
    bound = registry.slicer(backend).error_bound_mm(part, registry.slicer_settings(backend, {}))
    heights = heights_of(part)
    layers = ebamcheck.slice(part, heights, backend=backend)
    points = rational_points(part, 12, seed=1)
    for k, z in enumerate(heights):
        cut = oracle.section(part.vertices, part.faces, z)
        area = oracle.signed_area(cut)
        length = sum(math.dist(*(map(float, p) for p in s[:2])) for s in cut)
        assert layers.areas()[k] == pytest.approx(float(area), rel=1e-12, abs=bound * length), z
        rings = [r for r in oracle.rings(cut) if abs(oracle.ring_area(r)) > LEAST_AREA_MM2]
        # A library that works on eight decimals joins rings that come nearer than that.
        if backend == "planecut" or apart(rings) > NEAR_MM:
            large = np.abs(layers.ring_areas[list(layers.rings_of(k))]) > LEAST_AREA_MM2
            assert int(large.sum()) == len(rings), z
        inside, off = membership(layers, k, points)
        for (x, y), found, distance in zip(points.tolist(), inside, off, strict=True):
            wanted = oracle.inside(cut, x, y)
            if wanted is not None and distance > 1e-6:
                assert found == wanted, (z, x, y)


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("backend", EXACT)
@pytest.mark.parametrize("name", OVERLAPPING)
def test_overlapping_shells_are_solid_where_the_exact_winding_number_is_positive(name, backend):
    part = OVERLAPPING[name]
    usable(backend)
    heights = heights_of(part, seed=2)
    layers = ebamcheck.slice(part, heights, backend=backend)
    points = rational_points(part, 60, seed=3)
    checked = 0
    for k, z in enumerate(heights):
        cut = oracle.section(part.vertices, part.faces, z)
        inside, off = membership(layers, k, points)
        for (x, y), found, distance in zip(points.tolist(), inside, off, strict=True):
            wanted = oracle.inside(cut, x, y)
            if wanted is not None and not distance <= 1e-6:
                checked += 1
                assert found == wanted, (z, x, y)
    assert checked > 100


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("backend", EXACT)
@pytest.mark.parametrize("name", ["tilted box", "hull 1", "far away", "torus on its rim", "terrain 2"])
def test_points_lie_within_the_bound_of_the_exact_contours(name, backend):
    """Measured in rational arithmetic, so that nothing but the slicer rounds."""
    part = SOLIDS[name]
    slicer = usable(backend)
    settings = registry.slicer_settings(backend, {})
    bound = Fraction(slicer.error_bound_mm(part, settings))
    heights = heights_of(part, seed=4)
    layers = ebamcheck.slice(part, heights, backend=backend)
    row_layer = np.repeat(layers.ring_layer, np.diff(layers.ring_starts))
    for k, z in enumerate(heights):
        cut = oracle.section(part.vertices, part.faces, z)
        for x, y in layers.points[row_layer == k][:40]:
            assert oracle.square_distance(cut, x, y) <= bound**2, (z, x, y)


def test_polygons_of_an_outline_and_the_same_hole():
    """Torus with an 8-gon for a circle, cut at its lowest vertices, z = -1.7798653643474056: area 0, one disc."""
    part = SOLIDS["torus"]
    layers = ebamcheck.slice(part, [-1.7798653643474056], backend="planecut")
    assert layers.areas()[0] == pytest.approx(0.0, abs=1e-12)
    assert sum(p.area for p in layers.polygons(0)) == pytest.approx(0.0, abs=1e-9)
