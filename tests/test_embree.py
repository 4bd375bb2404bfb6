"""The ray-casting backend: rings, winding, blocks, and parts that are not whole."""

from __future__ import annotations

import logging

import numpy as np
import pytest
import shapely
from parts import box, join, moved, sphere, tilted, torus, turn_z
from scipy.spatial.transform import Rotation
from section_oracle import depth_beyond, exact_section

from ebamcheck.errors import SettingsError
from ebamcheck.layers.stack import concatenate
from ebamcheck.mesh.part import from_arrays
from ebamcheck.testing.solids import prism
from ebamcheck_embree import Embree, scene
from ebamcheck_embree.grid import automatic_cell_mm, grid_over
from ebamcheck_embree.scene import Scene

SLICER = Embree()


if not SLICER.probe().available:
    pytest.skip(SLICER.probe().why, allow_module_level=True)


def cut(part, heights, progress=None, **settings):
    with SLICER.prepare(part, SLICER.Settings(**settings)) as prepared:
        return prepared.slice(np.atleast_1d(np.asarray(heights, float)), progress)


def heights_in(part, count=4):
    low, high = part.bounds[:, 2]
    return low + (high - low) * (np.arange(count) + 0.37) / count


def region(layers, k=0):
    return shapely.union_all(layers.polygons(k))


def same(a, b):
    return all(
        np.array_equal(getattr(a, c), getattr(b, c))
        for c in ("heights", "points", "ring_starts", "layer_starts", "closed", "dropped")
    )


WEDGE = shapely.Polygon([(0, 0), (30, 0.9), (0, 1.8)])
COMB = shapely.union_all([shapely.box(0, 0, 20, 2)] + [shapely.box(x, 1, x + 0.55, 9) for x in np.arange(0, 20, 0.83)])
THIN = shapely.box(0, 0, 20, 20).difference(shapely.box(0.13, 0.13, 19.87, 19.87))
GAP = shapely.box(0, 0, 20, 10).difference(shapely.box(-1, 5, 15, 5.07))
PLATE = shapely.box(0, 0, 30, 20).difference(shapely.Point(12, 9).buffer(5))
STAR = shapely.Polygon(
    [
        ((10 if k % 2 else 1.5) * np.cos(k * np.pi / 9), (10 if k % 2 else 1.5) * np.sin(k * np.pi / 9))
        for k in range(18)
    ]
)

PARTS = {
    "box": box((0, 0, 0), (10, 7, 5)),
    "tilted box": tilted(box((0, 0, 0), (30, 7, 4))),
    "sphere": sphere(),
    "torus": torus(),
    "tilted torus": tilted(torus()),
    "cylinder": prism(shapely.Point(3, 4).buffer(8, quad_segs=24), 0.0, 5.0),
    "plate with hole": prism(PLATE, 0.0, 4.0),
    "wedge": prism(WEDGE, 0.0, 4.0),
    "turned wedge": moved(prism(WEDGE, 0.0, 4.0), turn_z(44.9)),
    "comb": prism(COMB, 0.0, 3.0),
    "turned comb": moved(prism(COMB, 0.0, 3.0), turn_z(31.0)),
    "tilted comb": tilted(prism(COMB, 0.0, 3.0)),
    "thin wall": prism(THIN, 0.0, 3.0),
    "turned thin wall": moved(prism(THIN, 0.0, 3.0), turn_z(45.0)),
    "gap": prism(GAP, 0.0, 3.0),
    "turned gap": moved(prism(GAP, 0.0, 3.0), turn_z(13.0)),
    "star": tilted(prism(STAR, 0.0, 3.0)),
    "overlapping": tilted(join(box((0, 0, 0), (10, 10, 10)), box((5, 5, 2), (16, 14, 13)))),
}


def random_solid(rng):
    """Prism of a random outline, turned anyhow, now and then with a second body through it."""
    pieces = [shapely.Polygon(rng.uniform(-10, 10, (3, 2))) for _ in range(rng.integers(1, 7))]
    outline = max(shapely.get_parts(shapely.union_all(pieces)), key=lambda piece: piece.area)
    turn = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    bodies = [moved(prism(outline, 0.0, rng.uniform(0.5, 8)), turn)]
    if rng.random() < 0.5:
        bodies.append(moved(box(rng.uniform(-5, 0, 3), rng.uniform(1, 6, 3)), turn))
    return join(*bodies)


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
        exact = shapely.union_all([shapely.box(*a[:2], *b[:2]) for a, b in zip(low[inside], high[inside], strict=True)])
        assert depth_beyond(region(layers, k), exact, bound_mm * 1.0005) < 1e-9


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


@pytest.mark.parametrize(
    "fault",
    [lambda facets: np.full_like(facets, -1), lambda facets: facets ^ 1, lambda facets: facets ^ (1 << 29)],
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


# -- the error bound ------------------------------------------------------------------------------------------


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("seed", range(40))
def test_bound_is_kept_by_random_solids(seed, caplog):
    rng = np.random.default_rng(seed)
    part = random_solid(rng)
    heights = np.sort(rng.uniform(*part.bounds[:, 2], 2))
    settings = {"grid_mm": float(rng.choice([0.1, 0.2, 0.5, 1.5]))}
    bound = SLICER.error_bound_mm(part, SLICER.Settings(**settings))
    layers = cut(part, heights, **settings)
    for k, z in enumerate(heights):
        assert depth_beyond(region(layers, k), exact_section(part, z), bound * 1.0005) < 1e-9
    assert "do not pair" not in caplog.text
