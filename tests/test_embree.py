"""The ray-casting backend: rings, winding, blocks, and parts that are not whole."""

from __future__ import annotations

import logging

import numpy as np
import pytest
import shapely
from embree_parts import PARTS, SLICER, cut, heights_in, region, same
from parts import box, join, moved, sphere
from section_oracle import depth_beyond, exact_section, prism

from ebamcheck.errors import BackendFailed, SettingsError
from ebamcheck.layers.stack import concatenate
from ebamcheck.mesh.part import from_arrays
from ebamcheck_embree import scene
from ebamcheck_embree.crossings import borders
from ebamcheck_embree.grid import automatic_cell_mm, grid_over
from ebamcheck_embree.scene import Mesh, Scene


@pytest.mark.parametrize("name", PARTS)
def test_in_plane_knots_lie_on_the_section(name):
    part = PARTS[name]
    layers = cut(part, heights_in(part), grid_mm=0.21)
    for k, z in enumerate(layers.heights):
        points = np.concatenate([layers.ring(r) for r in layers.rings_of(k)])
        off = shapely.distance(shapely.points(points), exact_section(part, z).boundary)
        assert off.max() < 1e-9


def test_rings_are_simple_and_oriented():
    part = PARTS["plate with hole"]
    layers = cut(part, [1.7], grid_mm=0.2)
    assert layers.outer_counts().tolist() == [1]
    assert layers.hole_counts().tolist() == [1]
    assert all(shapely.Polygon(layers.ring(r)).is_valid for r in layers.rings_of(0))


def test_vertices_and_faces_on_grid_lines():
    """An outline whose vertices are nodes and whose sides are rows and columns, to the last bit or one off."""
    cell_mm = 0.25
    frame = box((-8, -8, 0), (8, 8, 1))
    grid = grid_over(frame, cell_mm)
    x, y = grid.column_x_mm, grid.row_y_mm
    notch = shapely.box(x[20], y[17], x[40], y[31])
    slant = shapely.Polygon([(x[45], y[45]), (x[55], y[45]), (x[50], y[50])])
    outline = shapely.box(-8, -8, 8, 8).difference(notch).difference(slant)
    for nudge in (0.0, 1e-13, -1e-13, 1e-7, -1e-7):
        part = prism(outline, 0.0, 1.0)
        inner = (np.abs(part.vertices[:, :2]) < 8).all(axis=1)
        part.vertices[inner, :2] += nudge
        layers = cut(part, [0.5], grid_mm=cell_mm)
        bound = SLICER.error_bound_mm(part, SLICER.Settings(grid_mm=cell_mm))
        assert depth_beyond(region(layers), exact_section(part, 0.5), bound * 1.0005) == 0.0
        assert layers.ring_counts().tolist() == [3]
        assert layers.areas()[0] == pytest.approx(outline.area, abs=4 * cell_mm**2)


def test_winding_rule():
    two = join(box(), moved(box(), shift=(1, 1, 0.5)))
    assert cut(two, [0.2, 1.0, 2.2], grid_mm=0.01).areas() == pytest.approx([4.0, 7.0, 4.0], abs=0.02)
    assert cut(two, [1.0], grid_mm=0.01).ring_counts().tolist() == [1]
    cavity = join(box((0, 0, 0), (9, 9, 9)), box((2, 2, 2), (4, 4, 4)).reversed())
    assert cut(cavity, [3.0], grid_mm=0.01).areas() == pytest.approx([77.0], abs=0.1)
    inverted = cut(box().reversed(), [0.5, 1.5], grid_mm=0.01)
    assert inverted.ring_counts().tolist() == [0, 0]
    beside = join(box(), moved(box().reversed(), shift=(5, 0, 0)))
    assert cut(beside, [1.0], grid_mm=0.01).areas() == pytest.approx([4.0], abs=0.03)


def test_shells_that_touch_unite():
    touching = join(box((0, 0, 0), (2, 2, 2)), box((2, 0, 0), (4, 2, 2)))
    layers = cut(touching, [1.0])
    assert layers.ring_counts().tolist() == [1]
    assert layers.areas() == pytest.approx([8.0])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_walls_in_one_place_hide_no_shell(axis):
    """Of facets in one place Embree names one: here it would lose an exit at 5 and an entry at 10."""
    row = join(*(box(np.roll([k * 5.0, 0, 0], axis), np.roll([k * 5.0 + 5.0, 6, 7], axis)) for k in range(3)))
    widths = np.roll([15.0, 6.0, 7.0], axis)
    for z in (0.3 * widths[2], 0.5 * widths[2], 0.9 * widths[2]):
        layers = cut(row, [z], grid_mm=0.05)
        assert layers.ring_counts().tolist() == [1]
        assert layers.areas() == pytest.approx(widths[0] * widths[1], abs=0.05 * 2 * widths[:2].sum())


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("seed", range(12))
def test_shells_that_abut_and_overlap_on_a_lattice(seed, caplog):
    """Boxes with whole-numbered corners: walls coincide in twos and threes, facing alike and opposite."""
    rng = np.random.default_rng(seed)
    low = rng.integers(0, 5, (14, 3))
    high = low + rng.integers(1, 4, (14, 3))
    shells = join(*(box(a, b) for a, b in zip(low, high, strict=True)))
    cell_mm = 0.05
    bound_mm = SLICER.error_bound_mm(shells, SLICER.Settings(grid_mm=cell_mm))
    heights = np.arange(8) + 0.5
    layers = cut(shells, heights, grid_mm=cell_mm)
    assert not caplog.records
    for k, z in enumerate(heights):
        inside = (low[:, 2] < z) & (z < high[:, 2])
        exact = shapely.union_all(
            [shapely.box(*a[:2], *b[:2]) for a, b in zip(low[inside], high[inside], strict=True)]
        )
        assert depth_beyond(region(layers, k), exact, bound_mm * 1.0005) < 1e-9


def test_planes_through_faces_and_outside():
    layers = cut(box((0, 0, 0), (4, 4, 2)), [-1.0, 0.0, 1e-3, 1.0, 2.0, 5.0])
    assert layers.ring_counts().tolist() == [0, 1, 1, 1, 0, 0]
    assert layers.areas()[1:4] == pytest.approx([16.0] * 3, abs=0.05)


def test_planes_through_vertices():
    """The rule there is called undefined, but contours close and in-plane rays take z = h + 0 all the same."""
    part = sphere()
    heights = np.unique(part.vertices[:, 2])[1:-1]
    layers = cut(part, heights, grid_mm=0.2)
    assert layers.ring_counts().tolist() == [1] * len(heights)
    bound = SLICER.error_bound_mm(part, SLICER.Settings(grid_mm=0.2))
    for k, z in enumerate(heights):
        assert depth_beyond(region(layers, k), exact_section(part, z), bound * 1.0005) == 0.0


def test_a_layer_does_not_depend_on_the_others_nor_on_threads(monkeypatch):
    part = PARTS["tilted comb"]
    rng = np.random.default_rng(5)
    heights = np.unique(rng.uniform(*part.bounds[:, 2], 37))
    monkeypatch.setenv("EBAMCHECK_THREADS", "1")
    whole = cut(part, heights, grid_mm=0.2)
    monkeypatch.setenv("EBAMCHECK_THREADS", "2")
    assert same(whole, cut(part, heights, grid_mm=0.2))
    assert same(whole, cut(part, heights, grid_mm=0.2, rays_per_call=1024))
    pieces = [cut(part, heights[a:b], grid_mm=0.2) for a, b in ((0, 1), (1, 20), (20, 37))]
    assert same(whole, concatenate(pieces))
    done = []
    cut(part, heights, done.append, grid_mm=0.2)
    assert sum(done) == len(heights)


@pytest.mark.parametrize("block", [1, 16, 50])
def test_consecutive_blocks_of_one_prepared_part_are_the_whole_stack(block):
    part = PARTS["overlapping"]
    heights = np.linspace(*part.bounds[:, 2], 100)
    with SLICER.prepare(part, SLICER.Settings(grid_mm=0.3)) as prepared:
        whole = prepared.slice(heights)
        blocks = [prepared.slice(heights[a : a + block]) for a in range(0, len(heights), block)]
    assert whole.ring_counts().any()
    assert same(whole, concatenate(blocks))


def test_no_ray_is_cast_that_crosses_nothing_nor_after_its_last_crossing(monkeypatch):
    """Embree is asked once for each crossing of a convex part, and not for what lies beside it."""
    casts = []

    def counted(self, rays, origins, axis, take, follow=Scene.follow):
        def taken(met, distance, under_way):
            casts.append(len(met))
            return take(met, distance, under_way)

        follow(self, rays, origins, axis, taken)

    monkeypatch.setattr(Scene, "follow", counted)
    part = join(box((0, 0, 0), (10, 10, 4)), box((20, 0, 0), (30, 10, 2)))
    cut(part, [3.0], grid_mm=1.0)
    assert sum(casts) == 2 * (10 + 10)


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("name", PARTS)
def test_layers_do_not_depend_on_the_slabs_of_the_part(name, monkeypatch):
    """Trees of a few facets each name the same candidates as one of the whole part."""
    part = PARTS[name]
    heights = np.linspace(*part.bounds[:, 2], 60)
    whole = cut(part, heights, grid_mm=0.3)
    monkeypatch.setattr(scene, "FACETS_A_SLAB", 1)
    monkeypatch.setattr(scene, "FACETS_THROUGH_A_SLAB", 0.1)
    assert same(cut(part, heights, grid_mm=0.3), whole)


def test_every_facet_that_reaches_a_place_is_in_its_slab(monkeypatch):
    monkeypatch.setattr(scene, "FACETS_A_SLAB", 4)
    monkeypatch.setattr(scene, "FACETS_THROUGH_A_SLAB", 1.0)
    part = sphere()
    mesh = Mesh(part.vertices, part.faces.astype(np.int32))
    divided = scene.Slabs(mesh)
    z = part.vertices[part.faces, 2]
    places = np.linspace(*part.bounds[:, 2], 97)
    assert len(set(divided.of(places).tolist())) > scene.SLABS_KEPT  # some are made again
    for place, slab in zip(places, divided.of(places), strict=True):
        found = divided[slab].mesh
        assert len(found.faces) == divided.facets_in(slab) < len(part.faces)
        corners = {facet.tobytes() for facet in found.vertices[found.faces]}
        reaching = (z.min(axis=1) <= place) & (place <= z.max(axis=1))
        assert corners >= {facet.tobytes() for facet in part.vertices[part.faces[reaching]]}


@pytest.mark.parametrize(
    "fault",
    [
        lambda facets: np.full_like(facets, -1),
        lambda facets: facets ^ 1,
        lambda facets: facets ^ (1 << 29),
    ],
    ids=["none", "neighbour", "no facet of the part"],
)
def test_what_embree_misses_is_found_all_the_same(fault, monkeypatch):
    """Embree only names candidates: where it names no facet, another one or one that is not there, the layers are the same."""
    part = PARTS["tilted torus"]
    sound = cut(part, heights_in(part), grid_mm=0.3)

    class Faulty:
        def __init__(self, scene):
            self.scene = scene

        def run(self, *arguments, **options):
            met = self.scene.run(*arguments, **options)
            met["primID"] = np.where(met["primID"] < 0, -1, fault(met["primID"])).astype(np.int32)
            return met

    def build(self, vertices, faces, init=Scene.__init__):
        init(self, vertices, faces)
        self._scene = Faulty(self._scene)

    monkeypatch.setattr(Scene, "__init__", build)
    assert same(cut(part, heights_in(part), grid_mm=0.3), sound)


def test_open_part_is_mended_and_reported(caplog):
    whole = sphere(10.0)
    low = whole.vertices[whole.faces].mean(axis=1)
    hole = (low[:, 0] > 9.0) & (np.abs(low[:, 1]) < 3) & (np.abs(low[:, 2]) < 2)
    assert hole.any()
    part = from_arrays(whole.vertices, whole.faces[~hole], "holed")
    with caplog.at_level(logging.WARNING, "ebamcheck_embree"):
        layers = cut(part, [0.3, 7.1], grid_mm=0.1)
    assert "'holed' is open" in caplog.text
    assert layers.ring_counts().tolist() == [1, 1]
    assert layers.areas() == pytest.approx(cut(whole, [0.3, 7.1], grid_mm=0.1).areas(), rel=0.02)


def test_a_facet_turned_over_is_reported_and_does_not_empty_the_part(caplog):
    whole = box((0, 0, 0), (4, 4, 4))
    for turned in range(len(whole.faces)):
        faces = whole.faces.copy()
        faces[turned] = faces[turned, ::-1]
        with caplog.at_level(logging.WARNING, "ebamcheck_embree"):
            layers = cut(from_arrays(whole.vertices, faces), [1.1, 2.9], grid_mm=0.1)
        assert layers.areas() == pytest.approx([16.0, 16.0], abs=0.2)
    assert "do not pair" in caplog.text


def test_soup_gives_closed_rings():
    rng = np.random.default_rng(2)
    part = from_arrays(rng.uniform(0, 10, (300, 3)), np.arange(300).reshape(-1, 3))
    layers = cut(part, np.linspace(1, 9, 9), grid_mm=0.2)
    assert len(layers) == 9
    assert layers.closed.all()
    assert np.isfinite(layers.points).all()


def test_parts_without_extent():
    flat = from_arrays([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    upright = from_arrays([(0, 0, 0), (0, 0, 1), (0, 0, 2)], [(0, 1, 2)])
    nothing = from_arrays(np.zeros((0, 3)), np.zeros((0, 3)))
    for part in (flat, upright, nothing):
        assert cut(part, [0.0, 0.5], grid_mm=0.01).ring_counts().tolist() == [0, 0]
        assert len(cut(part, [], grid_mm=0.01)) == 0


def test_automatic_grid():
    assert automatic_cell_mm(box((0, 0, 0), (200, 10, 5))) == 0.1
    assert automatic_cell_mm(box((0, 0, 0), (20, 10, 5))) == pytest.approx(20 / 1024)
    assert automatic_cell_mm(box((0, 0, 0), (10, 1000, 5))) == pytest.approx(1000 / 4096)
    layers = cut(box(), [1.0])
    assert layers.settings == {"grid_mm": 2 / 1024, "rays_per_call": 16_384}


def test_a_grid_that_does_not_fit_is_refused():
    with pytest.raises(SettingsError, match="grid_mm"):
        SLICER.prepare(box(), SLICER.Settings(grid_mm=1e-6))


def test_released_part_is_not_sliced():
    with SLICER.prepare(box(), SLICER.Settings(grid_mm=0.1)) as prepared:
        pass
    with pytest.raises(BackendFailed, match="prepare it again"):
        prepared.slice(np.array([1.0]))


def test_borders_of_many_overlapping_shells_by_counting():
    """Borders of random intervals are those of their union, however they come in."""
    rng = np.random.default_rng(11)
    for size in (1, 7, 200):
        low = rng.integers(0, 400, size).astype(float)
        high = low + rng.integers(1, 30, size)
        along = np.concatenate([low, high])
        sign = np.repeat([1, -1], size)
        order = rng.permutation(2 * size)
        found = borders(np.array([0, 2 * size]), along[order], sign[order], np.zeros(2 * size, np.int32))
        inside = np.zeros(500, bool)
        for a, b in zip(low.astype(int), high.astype(int), strict=True):
            inside[a:b] = True
        assert found[1].tolist() == (np.flatnonzero(np.diff(inside, prepend=False)) * 1.0).tolist()
        assert found[3].all()
        assert found[4].all()
