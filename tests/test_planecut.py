"""The exact plane cut against laws, exact rational areas and closed forms."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import shapely
from corpus_sections import simple_sections
from numpy.testing import assert_allclose
from parts import box, join, moved, sphere, tilted, torus, turn_z, welded

import ebamcheck
from ebamcheck.mesh.part import Part, from_arrays


def cut(part: Part, heights, **settings):
    return ebamcheck.slice(part, heights, backend="planecut", **settings)


def exact_signed_area(part: Part, height: float) -> Fraction:
    """Area of the section at h + 0 in rational arithmetic: the sum over facets, no tracing at all."""
    h = Fraction(height)
    vertices = [[Fraction(c) for c in v] for v in part.vertices.tolist()]
    double = Fraction(0)
    for face in part.faces.tolist():
        ends = {}
        for tail, head in zip(face, face[1:] + face[:1], strict=True):
            p, q = vertices[tail], vertices[head]
            if (p[2] > h) != (q[2] > h):
                t = (h - p[2]) / (q[2] - p[2])
                ends[q[2] > h] = (p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1]))
        if ends:
            (x0, y0), (x1, y1) = ends[False], ends[True]
            double += x0 * y1 - x1 * y0
    return double / 2


PARTS = {
    "box": box(),
    "sphere": sphere(),
    "torus": torus(),
    "tilted box": tilted(box((0, 0, 0), (7, 5, 3))),
    "tilted torus": tilted(torus()),
    "two boxes": join(box(), box((5, 5, 1), (6, 6, 3))),
    "box with a cavity": join(box((0, 0, 0), (4, 4, 4)), box((1, 1, 1), (3, 3, 3)).reversed()),
}


@pytest.mark.parametrize("name", PARTS)
def test_areas_are_those_of_rational_arithmetic_at_every_kind_of_plane(name):
    part = PARTS[name]
    low, high = part.bounds[:, 2]
    through_vertices = np.unique(part.vertices[:, 2])[:40]
    heights = np.unique(np.concatenate([np.linspace(low - 0.1, high + 0.1, 23), through_vertices]))
    areas = cut(part, heights).areas()
    exact = [float(exact_signed_area(part, h)) for h in heights]
    assert_allclose(areas, exact, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", PARTS)
def test_every_point_lies_where_its_edge_says(name):
    part = PARTS[name]
    layers = cut(part, ebamcheck.layer_heights(part, 0.37))
    low, high = part.vertices[layers.edge[:, 0]], part.vertices[layers.edge[:, 1]]
    layer = np.repeat(layers.ring_layer, np.diff(layers.ring_starts))
    on_edge = low + layers.edge_t[:, None] * (high - low)
    assert_allclose(on_edge[:, :2], layers.points, atol=1e-12)
    assert_allclose(on_edge[:, 2], layers.heights[layer], atol=1e-12)
    assert ((layers.edge_t >= 0) & (layers.edge_t < 1)).all()


@pytest.mark.parametrize("name", PARTS)
def test_volume_is_the_integral_of_areas(name):
    part = PARTS[name]
    step = part.size[2] / 4000
    heights = part.bounds[0, 2] + (np.arange(4000) + 0.5) * step
    assert cut(part, heights).areas().sum() * step == pytest.approx(part.volume, rel=1e-3)


def same_rings(a, b, atol=1e-9):
    assert a.ring_counts().tolist() == b.ring_counts().tolist()
    assert_allclose(a.areas(), b.areas(), rtol=1e-11, atol=atol)
    for k in range(len(a)):
        difference = shapely.symmetric_difference(
            shapely.union_all(a.polygons(k)), shapely.union_all(b.polygons(k))
        )
        assert difference.area <= atol * max(a.perimeters()[k], 1)


MAPS = {
    "translation": (np.eye(3), (3.25, -7.5, 11.0)),
    "large offset": (np.eye(3), (2.0**20, -(2.0**21), 2.0**18)),
    "rotation": (turn_z(37.0), (0, 0, 0)),
    "mirror": (np.diag([-1.0, 1, 1]), (0, 0, 0)),
    "scale": (np.eye(3) * 2.5, (0, 0, 0)),
}


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("kind", MAPS)
def test_maps_of_the_part_map_its_sections(name, kind):
    matrix, shift = MAPS[kind]
    part = PARTS[name]
    heights = ebamcheck.layer_heights(part, part.size[2] / 9.3)
    image = cut(moved(part, matrix, shift), heights * matrix[2, 2] + shift[2])
    original = cut(part, heights)
    flat = np.asarray(matrix, float)[:2, :2]
    expected = ebamcheck.layers.stack.from_polygons(
        heights,
        [
            [
                shapely.transform(p, lambda xy: xy @ flat.T + np.asarray(shift[:2], float))
                for p in original.polygons(k)
            ]
            for k in range(len(heights))
        ],
    )
    same_rings(image, expected, atol=1e-8 if kind != "large offset" else 1e-6)


@pytest.mark.parametrize("name", PARTS)
def test_bits_do_not_depend_on_facet_order_corner_order_or_threads(name, monkeypatch):
    part = PARTS[name]
    heights = ebamcheck.layer_heights(part, part.size[2] / 53)
    expected = cut(part, heights)
    rng = np.random.default_rng(5)
    order = rng.permutation(len(part.faces))
    turned = np.stack([np.roll(f, rng.integers(3)) for f in part.faces[order]])
    monkeypatch.setenv("EBAMCHECK_THREADS", "1")
    for other in (cut(Part(part.vertices, turned), heights), cut(part, heights)):
        assert np.array_equal(other.points, expected.points)
        assert np.array_equal(other.ring_starts, expected.ring_starts)
        assert np.array_equal(other.layer_starts, expected.layer_starts)


def test_a_layer_does_not_depend_on_the_others():
    part = tilted(torus())
    heights = ebamcheck.layer_heights(part, 0.11)
    whole = cut(part, heights)
    for k in (0, 17, len(heights) - 1):
        assert np.array_equal(cut(part, heights[k]).points, whole.block(k, k + 1).points)
    mixed = cut(part, [heights[5], heights[2], heights[5]])
    assert mixed.areas().tolist() == whole.areas()[[5, 2, 5]].tolist()


def test_planes_through_faces_follow_the_half_open_rule():
    layers = cut(box((0, 0, 0), (2, 2, 2)), [-1e-12, 0.0, 1.0, 2.0 - 1e-12, 2.0])
    assert layers.areas().tolist() == [0, 4, 4, 4, 0]
    steps = join(box((0, 0, 0), (4, 4, 1)), box((1, 1, 1), (2, 2, 2)))
    assert cut(steps, [0.5, 1.0, 1.5]).areas().tolist() == [16, 1, 1]


def test_overlapping_shells_unite():
    two = join(box((0, 0, 0), (2, 2, 2)), box((1, 1, 0), (3, 3, 2)))
    layers = cut(two, [0.75])
    assert layers.areas().tolist() == [7.0]
    assert layers.ring_counts().tolist() == [1]
    assert (layers.edge[:, 0] < 0).sum() == 2
    assert np.isnan(layers.edge_t[layers.edge[:, 0] < 0]).all()
    kept = cut(two, [1.0], overlaps="keep")
    assert kept.areas().tolist() == [8.0]
    inside = join(box((0, 0, 0), (4, 4, 4)), box((1, 1, 1), (3, 3, 3)))
    assert cut(inside, [2.0]).areas().tolist() == [16.0]
    flush = join(box((0, 0, 0), (2, 2, 2)), box((1, 0, 0), (3, 2, 2)))
    assert cut(flush, [1.0]).areas().tolist() == [6.0]
    twice = join(box(), box())
    assert cut(twice, [1.0]).areas().tolist() == [4.0]


@pytest.mark.parametrize("seed", range(6))
def test_union_of_random_boxes_is_that_of_shapely(seed):
    rng = np.random.default_rng(seed)
    lower = rng.uniform(0, 8, (12, 3))
    upper = lower + rng.uniform(0.5, 4, (12, 3))
    lower[:, 2], upper[:, 2] = 0, 1
    part = join(
        *(
            tilted_about_z(box(a, b), angle)
            for a, b, angle in zip(lower, upper, rng.uniform(0, 90, 12), strict=True)
        )
    )
    layers = cut(part, [0.5])
    footprints = [shapely.union_all(cut(welded_body(part, i), [0.5]).polygons(0)) for i in range(12)]
    expected = shapely.union_all(footprints)
    assert layers.areas()[0] == pytest.approx(expected.area, rel=1e-12)
    assert layers.ring_counts()[0] == sum(1 + len(p.interiors) for p in shapely.get_parts(expected))


def tilted_about_z(part, degrees):
    return moved(part, turn_z(degrees))


def welded_body(part, i):
    return from_arrays(part.vertices[8 * i : 8 * i + 8], part.faces[12 * i : 12 * i + 12] - 8 * i)


def test_bodies_that_touch_along_an_edge_stay_apart():
    touching = welded(join(box((0, 0, 0), (1, 1, 1)), box((1, 1, 0), (2, 2, 1))))
    assert len(touching.vertices) == 14
    layers = cut(touching, [0.5])
    assert layers.ring_counts().tolist() == [2]
    assert layers.areas().tolist() == [2.0]
    face_to_face = welded(join(box((0, 0, 0), (1, 1, 1)), box((1, 0, 0), (2, 1, 1))))
    assert cut(face_to_face, [0.5]).areas().tolist() == [2.0]


def test_inside_out_is_empty_and_open_paths_are_kept():
    assert cut(box().reversed(), [1.0]).areas().tolist() == [0.0]
    lidless = Part(box().vertices, np.delete(box().faces, [4, 5], axis=0))
    layers = cut(lidless, [1.0, 2.0])
    assert layers.open_counts().tolist() == [1, 0]
    assert layers.ring_counts().tolist() == [0, 0]
    assert layers.ring(0).tolist()[0] != layers.ring(0).tolist()[-1]
    assert layers.ring_lengths[0] == pytest.approx(6.0)


def test_a_flipped_facet_does_not_break_its_ring():
    part = tilted(box((0, 0, 0), (7, 5, 3)))
    flipped = part.faces.copy()
    flipped[3] = flipped[3, ::-1]
    heights = ebamcheck.layer_heights(part, 0.3)
    assert_allclose(
        cut(Part(part.vertices, flipped), heights).areas(), cut(part, heights).areas(), rtol=1e-12
    )


def test_empty_stacks_and_heights_outside():
    layers = cut(box(), [])
    assert len(layers) == 0
    assert layers.areas().tolist() == []
    assert cut(box(), [-5, 99]).ring_counts().tolist() == [0, 0]


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 0, -1), (1, 2, 3), (-0.3, 0.1, -0.9)])
def test_any_slicing_direction_keeps_the_volume(direction):
    part = torus().along(direction)
    axis = np.asarray(direction, float) / np.linalg.norm(direction)
    assert_allclose(
        part.bounds[:, 2], [(torus().vertices @ axis).min(), (torus().vertices @ axis).max()], atol=1e-12
    )
    heights = ebamcheck.layer_heights(part, part.size[2] / 700)
    layers = cut(part, heights)
    assert layers.areas().sum() * np.diff(heights)[0] == pytest.approx(part.volume, rel=2e-3)
    assert layers.direction == pytest.approx(tuple(axis))


@pytest.mark.corpus
def test_reference_rows_of_the_corpus(corpus: Path):
    rows = simple_sections(corpus)
    assert sum(map(len, rows.values())) > 100
    for name, here in sorted(rows.items()):
        layers = cut(ebamcheck.load(corpus / name), [float(row["z"]) for row in here])
        assert layers.ring_counts().tolist() == [int(row["n_loops"]) for row in here], name
        # The reference prints twelve digits.
        assert_allclose(layers.areas(), [float(row["signed_area"]) for row in here], rtol=1e-9, err_msg=name)
        # The reference adds up every segment; the union takes those inside of other shells away (gears: 2e-4 mm).
        kept = cut(ebamcheck.load(corpus / name), [float(row["z"]) for row in here], overlaps="keep")
        assert_allclose(kept.perimeters(), [float(row["perimeter"]) for row in here], rtol=1e-8, err_msg=name)
