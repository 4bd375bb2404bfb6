"""Tables of differences of a pair, features that are thin, and the classes of layers."""

from __future__ import annotations

import pickle
import threading

import numpy as np
import pytest
import shapely
from comparison_stacks import COLUMNS, SQUARE, box, shifted, stack

from ebamcheck.comparison import compare, layer_classes
from ebamcheck.comparison.pairwise import Pair, measure_block, thin_counts
from ebamcheck.comparison.sources import blocks_of
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers.stack import from_polygons, from_rings
from ebamcheck.mesh.part import from_arrays

# -- the table of a pair -------------------------------------------------------------------------------


def test_table_of_a_pair():
    a = stack(SQUARE, SQUARE, None)
    b = stack(SQUARE, SQUARE + 1.0, None)
    rows = compare(a, b, part=box())
    assert list(rows.columns) == COLUMNS
    assert rows["agrees"].tolist() == [True, False, True]
    assert rows["iou"].tolist() == pytest.approx([1.0, 81 / 119, 1.0])
    assert rows["symmetric_difference_mm2"].tolist() == pytest.approx([0.0, 38.0, 0.0])
    assert rows["area_difference_mm2"].tolist() == pytest.approx([0.0, 0.0, 0.0])
    assert rows["hausdorff_mm"].tolist() == pytest.approx([0.0, np.sqrt(2), 0.0])
    assert rows["class"].tolist() == ["generic"] * 3
    assert compare(a, b)["class"].tolist() == ["unknown"] * 3


def test_place_of_the_depth_is_in_build_coordinates():
    far = SQUARE + 1e4
    hole = from_rings([1.0], [[far, shapely.Point(10006, 10003).buffer(1).exterior.coords[:-1]]])
    rows = compare(from_rings([1.0], [[far]]), hole)
    assert rows.loc[0, "depth_x_mm"] == pytest.approx(10006, abs=0.01)
    assert rows.loc[0, "depth_y_mm"] == pytest.approx(10003, abs=0.01)
    assert rows.loc[0, "depth_mm"] == pytest.approx(1.0, abs=0.01)


def test_bounds_add_up_to_the_limit():
    a, b = stack(SQUARE, SQUARE, SQUARE), stack(SQUARE, shifted(SQUARE, 0.05), shifted(SQUARE, 0.2))
    rows = compare(a, b, tolerance_mm=0.01, bound_a_mm=0.02, bound_b_mm=0.03, exact_a=True)
    assert rows["limit_mm"].tolist() == pytest.approx([0.06] * 3)
    assert rows["depth_mm"].tolist() == pytest.approx([0.0, 0.05, 0.2], abs=1e-6)
    assert rows["agrees"].tolist() == [True, True, False]
    assert compare(a, b)["depth_mm"].tolist() == pytest.approx([0.0, 0.025, 0.1], abs=2e-5)
    with pytest.raises(SettingsError, match="-1"):
        compare(a, b, bound_a_mm=-1)


def test_heights_and_parts_must_be_the_same():
    a = stack(SQUARE, SQUARE, SQUARE, part="aa")
    with pytest.raises(SettingsError, match=r"layer 2 is at z = 2.0 mm .* 2.5"):
        compare(a, stack(SQUARE, SQUARE, SQUARE, heights=[1.0, 2.5, 3.5]))
    with pytest.raises(SettingsError, match=r"3 layers.*2"):
        compare(a, stack(SQUARE, SQUARE, heights=[1.0, 2.0]))
    other = a.labelled(part="bb")
    with pytest.raises(SettingsError, match="check_part"):
        compare(a, other)
    assert compare(a, other, check_part=False)["agrees"].all()
    assert compare(a, a.labelled(part=""))["agrees"].all()


def test_no_layers_give_an_empty_table():
    empty = from_rings([], [])
    rows = compare(empty, empty)
    assert list(rows.columns) == COLUMNS
    assert len(rows) == 0


def test_blocks_and_threads_do_not_change_a_figure(monkeypatch):
    rng = np.random.default_rng(2)
    rings = [SQUARE + rng.normal(size=(4, 2)) for _ in range(150)]
    heights = np.arange(150.0)
    a = from_rings(heights, [[r] for r in rings])
    b = from_rings(heights, [[r + rng.normal(size=(4, 2)) * 0.1] for r in rings])
    tables = []
    for threads in ("1", "3"):
        monkeypatch.setenv("EBAMCHECK_THREADS", threads)
        tables.append(compare(a, b))
    assert tables[0].equals(tables[1])
    arguments = ([a.block(3, 9), b.block(3, 9)], [Pair(0, 1, 0.001, False, False)], (5.0, 5.0), 0, 6)
    assert np.array_equal(measure_block(*pickle.loads(pickle.dumps(arguments))), measure_block(*arguments))


# -- topology ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("width", "agrees"), [(0.08, True), (0.3, False)], ids=["thinner than twice the limit", "thicker"]
)
def test_a_neck_counts_only_where_it_is_thick(width, agrees):
    lobes = shapely.union_all([shapely.box(0, 0, 10, 10), shapely.box(12, 0, 22, 10)])
    joined = lobes.union(shapely.box(9, 5 - width / 2, 13, 5 + width / 2))
    rows = compare(from_polygons([0.0], [[lobes]]), from_polygons([0.0], [[joined]]), tolerance_mm=0.05)
    assert rows.loc[0, "rings_a"] == 2
    assert rows.loc[0, "rings_b"] == 1
    assert rows.loc[0, "topology_agrees"] == agrees
    assert rows.loc[0, "agrees"] == agrees


def test_a_fin_may_break_into_pieces_that_are_a_little_thicker_than_it():
    block = shapely.box(-10, -5, 0, 5)
    whole = block.union(shapely.box(0, -0.055, 20, 0.055))
    broken = block.union(shapely.box(9, -0.065, 14, 0.065))
    rows = compare(from_polygons([0.0], [[whole]]), from_polygons([0.0], [[broken]]), tolerance_mm=0.06)
    assert (rows.loc[0, "rings_a"], rows.loc[0, "rings_b"]) == (1, 2)
    assert rows.loc[0, "agrees"]


@pytest.mark.parametrize("seed", range(5))
def test_a_rim_that_thins_out_may_be_ragged(seed):
    angle, rng = np.linspace(0.0, 2.0 * np.pi, 800), np.random.default_rng(seed)
    round_ = np.column_stack([np.cos(angle), np.sin(angle)])
    thick = 0.45 + 0.42 * np.cos(angle)

    def rim(noise_mm):
        outer = 30.0 + thick + rng.uniform(-noise_mm, noise_mm, angle.size)
        inner = 30.0 - rng.uniform(-noise_mm, noise_mm, angle.size)
        return shapely.Polygon(outer[:, None] * round_).buffer(0) - shapely.Polygon(
            inner[:, None] * round_
        ).buffer(0)

    rows = compare(
        from_polygons([0.0], [[rim(0.0)]]),
        from_polygons([0.0], [list(shapely.get_parts(rim(0.055)))]),
        tolerance_mm=0.06,
    )
    assert rows.loc[0, "rings_b"] + rows.loc[0, "holes_b"] != 2
    assert rows.loc[0, "agrees"]


@pytest.mark.parametrize("width", [0.13, 0.2, 0.23, 0.5])
def test_a_fin_thicker_than_twice_the_limit_may_not_be_gone(width):
    block = shapely.box(-10, -5, 0, 5)
    fin = shapely.box(2, -width / 2, 20, width / 2)
    for lost in (block, block.union(shapely.clip_by_rect(fin, 5, -1, 9, 1))):
        rows = compare(
            from_polygons([0.0], [[block.union(fin)]]), from_polygons([0.0], [[lost]]), tolerance_mm=0.06
        )
        assert not rows.loc[0, "agrees"]


def test_ranges_of_counts_with_thin_features():
    plate = (
        shapely.box(0, 0, 10, 10).difference(shapely.box(2, 2, 2.05, 8)).difference(shapely.box(4, 4, 6, 6))
    )
    sliver = shapely.box(20, 0, 20.05, 10)
    outer, holes = thin_counts(shapely.union_all([plate, sliver]), 0.05)
    assert list(outer) == [1, 2]
    assert list(holes) == [1, 2]


def test_abutting_rings_are_one_region():
    halves = from_rings([0.0], [[SQUARE * [0.5, 1.0], shifted(SQUARE * [0.5, 1.0], 5.0)]])
    assert compare(halves, from_rings([0.0], [[SQUARE]]))["agrees"].all()


# -- classes -------------------------------------------------------------------------------------------


def test_layer_classes():
    roof = from_arrays(
        [(0, 0, 0), (10, 0, 0), (0, 10, 0), (3, 3, 5), (50, 50, 2)],
        [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)],
    )
    heights = [0.0, 1e-4, 2.0, 4.9999, 5.0, 6.0]
    assert layer_classes(roof, heights, 0.0).tolist() == [
        "face-on-plane", "generic", "generic", "generic", "vertex-on-plane", "generic",
    ]  # fmt: skip
    assert layer_classes(roof, heights, 1e-3).tolist() == [
        "face-on-plane", "face-on-plane", "generic", "vertex-on-plane", "vertex-on-plane", "generic",
    ]  # fmt: skip
    assert layer_classes(from_arrays(np.zeros((0, 3)), np.zeros((0, 3))), [1.0], 1.0).tolist() == ["generic"]


@pytest.mark.parametrize("seed", range(4))
def test_layer_classes_are_those_of_a_plain_search(seed):
    rng = np.random.default_rng(seed)
    part = from_arrays(np.round(rng.uniform(0, 9, (40, 3))), rng.integers(0, 40, (60, 3)))
    heights, margin = np.round(rng.uniform(-1, 10, 60), 1), float(rng.choice([0.0, 0.1, 0.6]))
    z = part.vertices[part.faces][:, :, 2]
    for height, found in zip(heights, layer_classes(part, heights, margin), strict=True):
        near = (z >= height - margin) & (z <= height + margin)
        expected = (
            "face-on-plane" if near.all(axis=1).any() else "vertex-on-plane" if near.any() else "generic"
        )
        assert found == expected


class Watched:
    """A stack that keeps note of the blocks that are asked for."""

    def __init__(self, layers):
        self.layers, self.asked, self.second = layers, [], threading.Event()

    def __len__(self):
        return len(self.layers)

    def block(self, start, stop):
        self.asked.append((start, stop))
        if len(self.asked) == 2:
            self.second.set()
        if start == 3:
            raise InputError("block 3 cannot be read")
        return self.layers.block(start, stop)


def test_the_next_block_is_read_while_one_is_worked_on_and_no_further():
    watched = Watched(from_rings(np.arange(4.0), [[SQUARE + k] for k in range(4)]))
    blocks = blocks_of([watched], np.array([0, 2, 3, 4]))
    first, (block,) = next(blocks)
    assert watched.second.wait(60.0)
    assert (first, len(block), watched.asked) == (0, 2, [(0, 2), (2, 3)])
    first, (block,) = next(blocks)
    assert (first, block.points.min()) == (2, 2.0)
    with pytest.raises(InputError, match="block 3"):
        next(blocks)
