"""Tables of differences of a pair, features that are thin, and the classes of layers."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from comparison_stacks import COLUMNS, SQUARE, box, shifted, stack

from ebamcheck.comparison import compare, layer_classes
from ebamcheck.errors import SettingsError
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


@pytest.mark.parametrize("width", [0.13, 0.2, 0.23, 0.5])
def test_a_fin_thicker_than_twice_the_limit_may_not_be_gone(width):
    block = shapely.box(-10, -5, 0, 5)
    fin = shapely.box(2, -width / 2, 20, width / 2)
    for lost in (block, block.union(shapely.clip_by_rect(fin, 5, -1, 9, 1))):
        rows = compare(from_polygons([0.0], [[block.union(fin)]]), from_polygons([0.0], [[lost]]), tolerance_mm=0.06)
        assert not rows.loc[0, "agrees"]


# -- classes -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_layer_classes_are_those_of_a_plain_search(seed):
    rng = np.random.default_rng(seed)
    part = from_arrays(np.round(rng.uniform(0, 9, (40, 3))), rng.integers(0, 40, (60, 3)))
    heights, margin = np.round(rng.uniform(-1, 10, 60), 1), float(rng.choice([0.0, 0.1, 0.6]))
    z = part.vertices[part.faces][:, :, 2]
    for height, found in zip(heights, layer_classes(part, heights, margin), strict=True):
        near = (z >= height - margin) & (z <= height + margin)
        expected = "face-on-plane" if near.all(axis=1).any() else "vertex-on-plane" if near.any() else "generic"
        assert found == expected
