"""The exact plane cut: what its points know of their edges, unions, planes through faces, and parts that are turned again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose
from parts import box, join, moved, sphere, tilted, torus, turn_z
from section_oracle import simple_sections

import ebamcheck
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck_planecut import PlaneCut


def cut(part: Part, heights, **settings):
    return ebamcheck.slice(part, heights, backend="planecut", **settings)


LIDLESS = Part(box().vertices, np.delete(box().faces, [4, 5], axis=0))
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
        *(tilted_about_z(box(a, b), angle) for a, b, angle in zip(lower, upper, rng.uniform(0, 90, 12), strict=True))
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


def test_inside_out_is_empty_and_open_paths_are_kept():
    assert cut(box().reversed(), [1.0]).areas().tolist() == [0.0]
    layers = cut(LIDLESS, [1.0, 2.0])
    assert layers.open_counts().tolist() == [1, 0]
    assert layers.ring_counts().tolist() == [0, 0]
    assert layers.ring(0).tolist()[0] != layers.ring(0).tolist()[-1]
    assert layers.ring_lengths[0] == pytest.approx(6.0)


def test_a_flipped_facet_does_not_break_its_ring():
    part = tilted(box((0, 0, 0), (7, 5, 3)))
    flipped = part.faces.copy()
    flipped[3] = flipped[3, ::-1]
    heights = ebamcheck.layer_heights(part, 0.3)
    assert_allclose(cut(Part(part.vertices, flipped), heights).areas(), cut(part, heights).areas(), rtol=1e-12)


def test_empty_stacks_and_heights_outside():
    layers = cut(box(), [])
    assert len(layers) == 0
    assert layers.areas().tolist() == []
    assert cut(box(), [-5, 99]).ring_counts().tolist() == [0, 0]


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 0, -1), (1, 2, 3), (-0.3, 0.1, -0.9)])
def test_any_slicing_direction_keeps_the_volume(direction):
    part = torus().along(direction)
    assert part.volume == pytest.approx(torus().volume, rel=1e-12)
    axis = np.asarray(direction, float) / np.linalg.norm(direction)
    assert_allclose(part.bounds[:, 2], [(torus().vertices @ axis).min(), (torus().vertices @ axis).max()], atol=1e-12)
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


# -- short cuts against the long way round ---------------------------------------------------------------------


COLUMNS = ("heights", "points", "ring_starts", "layer_starts", "closed", "edge", "edge_t", "dropped")

PAGES = Part(  # three pages of a book: an edge with three facets
    np.array([(0, 0, 0), (0, 0, 4), (3, 0, 2), (-1, 2, 1), (-1, -2, 3)], float),
    np.array([(0, 1, 2), (1, 0, 3), (0, 1, 4)], np.int32),
)
FLIPPED = Part(
    sphere().vertices,
    np.where(np.arange(len(sphere().faces))[:, None] % 7, sphere().faces, sphere().faces[:, ::-1]),
)
ODD_PARTS = {
    "torus": tilted(torus()),
    "box": box(),
    "bodies that touch": join(box((0, 0, 0), (1, 1, 1)), box((1, 1, 0), (2, 2, 1))),
    "shells that cross": join(sphere(), moved(sphere(), turn_z(10.0), (0.4, 0.1, 0.3))),
    "pages": PAGES,
    "open": LIDLESS,
    "flipped": FLIPPED,
}


def prepared(part, **settings):
    return PlaneCut().prepare(part, PlaneCut.Settings(**settings))


def same(a, b):
    for column in COLUMNS:
        x, y = getattr(a, column), getattr(b, column)
        assert x.dtype == y.dtype, column
        assert x.tobytes() == y.tobytes(), column


def planes(part):
    """Heights between vertices, through them, and outside."""
    z = np.unique(part.vertices[:, 2])
    return np.unique(np.concatenate([z, (z[1:] + z[:-1]) / 2, [z[0] - 1, z[-1] + 1], np.linspace(z[0], z[-1], 97)]))


@pytest.mark.parametrize("faces", [[], [(0, 1, 1), (2, 2, 2)]])
def test_a_part_without_a_facet_that_has_area_gives_empty_layers(faces):
    part = Part(box().vertices, np.array(faces, np.int32).reshape(-1, 3))
    ready = prepared(part)
    for one in (ready, ready.turned(part.along((0, 1, 1)))):
        layers = one.slice(np.linspace(-1, 3, 60))
        assert (len(layers), len(layers.points), layers.closed.size) == (60, 0, 0)


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", ODD_PARTS)
def test_a_part_that_is_turned_again_is_cut_as_if_it_were_new(name):
    part = ODD_PARTS[name]
    first = prepared(part)
    for direction in ((1, 2, 3), (0, 0, -1), (1, 0, 0)):
        turned = part.along(direction)
        again, anew = first.turned(turned), prepared(turned)
        heights = planes(turned)[::3]
        for k in range(0, len(heights), 7):  # single layers, for which not all facets are sorted
            same(first.turned(turned).slice(heights[k : k + 1]), anew.slice(heights[k : k + 1]))
        same(again.slice(heights), anew.slice(heights))
        back = again.turned(part)
        same(back.slice(planes(part)[::5]), first.slice(planes(part)[::5]))
