"""Layers in Parquet, whole and in blocks: every bit comes back, and damaged files are refused by name."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ebamcheck.columns_file import (
    ReadTable,
    arrow_columns,
    labelled,
    labels_of,
    open_table,
    readable,
    starts_of,
    write_table,
)
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers import files as layer_files
from ebamcheck.layers.stack import Layers, canonical, from_rings

COLUMNS = ("heights", "points", "ring_starts", "layer_starts", "closed", "edge", "edge_t", "dropped")


def random_layers(seed: int = 0, count: int = 7, edges: bool = True, base: float = 0.0) -> Layers:
    """Random rings and open paths, empty layers among them, with numbers of every magnitude."""
    rng = np.random.default_rng(seed)
    per_layer = rng.integers(0, 4, count)
    sizes = rng.integers(3, 12, per_layer.sum())
    scale = np.repeat(10.0 ** rng.uniform(-3, 6, sizes.size), sizes)
    points = rng.normal(size=(sizes.sum(), 2)) * scale[:, None]
    edge = rng.integers(-1, 1000, (len(points), 2)).astype(np.int32) if edges else None
    return canonical(
        base + np.cumsum(rng.uniform(0.1, 1, count)),
        points,
        np.concatenate([[0], np.cumsum(sizes)]),
        np.concatenate([[0], np.cumsum(per_layer)]),
        rng.random(sizes.size) < 0.8,
        edge=edge,
        edge_t=rng.random(len(points)) if edges else None,
        part="f00d",
        direction=(0.6, 0.0, 0.8),
        backend="planecut",
        settings={"pixel_mm": 0.1, "mode": "literal"},
    )


def assert_same(a: Layers, b: Layers) -> None:
    for name in COLUMNS:
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) == (y is None), name
        if x is not None:
            assert x.dtype == y.dtype, name
            assert x.shape == y.shape, name
            assert x.tobytes() == y.tobytes(), name
    assert a.labels_json() == b.labels_json()


@pytest.mark.parametrize("edges", [True, False])
@pytest.mark.parametrize("count", [0, 1, 40])
def test_parquet_gives_every_bit_back(tmp_path, count, edges):
    layers = random_layers(count, count, edges)
    layer_files.write_layers(layers, tmp_path / "a.parquet")
    assert_same(layer_files.read_layers(tmp_path / "a.parquet"), layers)


@pytest.mark.parametrize("edges", [True, False])
def test_blocks_of_a_file_join_to_the_stack(tmp_path, edges):
    layers = random_layers(5, 30)
    borders = [0, 6, 7, 7, 19, 30]
    blocks = (layers.block(a, b) for a, b in itertools.pairwise(borders))
    assert layer_files.write_blocks(blocks, tmp_path / "a.parquet") == 30
    assert_same(layer_files.read_parquet(tmp_path / "a.parquet"), layers)
    wanted = layers if edges else replace(layers, edge=None, edge_t=None)
    with layer_files.LayerFile(tmp_path / "a.parquet", edges=edges) as file:
        assert (len(file), file.part, file.settings) == (30, layers.part, layers.settings)
        assert file.heights.tobytes() == layers.heights.tobytes()
        for a, b in itertools.combinations(range(31), 2):
            assert_same(file.block(a, b), wanted.block(a, b))
        for k in (0, 7, 30):
            assert_same(file.block(k, k), wanted.block(k, k))


def test_same_layers_same_bytes(tmp_path):
    layers = random_layers(9, 12)
    for name in ("a.parquet", "b.parquet"):
        layer_files.write_parquet(layers, tmp_path / name)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()


def test_every_truncation_of_a_file_is_refused_and_named(tmp_path):
    layer_files.write_parquet(random_layers(1, 4), tmp_path / "a.parquet")
    whole = (tmp_path / "a.parquet").read_bytes()
    for size in [*range(0, len(whole), max(1, len(whole) // 40)), len(whole) - 8, len(whole) - 1]:
        (tmp_path / "cut").write_bytes(whole[:size])
        with pytest.raises(InputError, match="cut"):
            layer_files.read_parquet(tmp_path / "cut")


def damaged(tmp_path, change):
    batch = change(layer_files.to_arrow(random_layers(1, 5)))
    pq.write_table(pa.Table.from_batches([batch]), tmp_path / "bad.parquet")
    return tmp_path / "bad.parquet"


def with_column(batch, name, column):
    return batch.set_column(batch.schema.get_field_index(name), name, column)


def with_nan(batch):
    heights = batch.column("height_mm").to_pylist()
    heights[2] = float("nan")
    return with_column(batch, "height_mm", pa.array(heights))


CASES = {
    "version '2'": lambda b: b.replace_schema_metadata({**b.schema.metadata, b"ebamcheck.layers.version": b"2"}),
    "no version": lambda b: b.replace_schema_metadata(None),
    "labels": lambda b: b.replace_schema_metadata({b"ebamcheck.layers.version": b"1"}),
    "'closed' is missing": lambda b: b.drop_columns(["closed"]),
    "'edge_t' is missing": lambda b: b.drop_columns(["edge_t"]),
    "'height_mm' is string": lambda b: with_column(b, "height_mm", pa.array(list("abcde"))),
    "height of layer 3 is nan": with_nan,
    "column 'y' does not have the rings": lambda b: with_column(b, "y", pa.array([[]] * 5, b["y"].type)),
    "empty cells": lambda b: with_column(b, "x", pa.array([None] * 5, b["x"].type)),
    "'closed' does not have one entry": lambda b: with_column(b, "closed", pa.array([[]] * 5, b["closed"].type)),
}


@pytest.mark.parametrize("says", CASES)
def test_a_wrong_table_is_refused_and_the_message_says_why(tmp_path, says):
    with pytest.raises(InputError, match=says) as caught:
        layer_files.read_parquet(damaged(tmp_path, CASES[says]))
    assert "bad.parquet" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_suffixes_and_folders_are_refused(tmp_path):
    layers = random_layers(1, 2)
    with pytest.raises(SettingsError, match=r"'\.foo'.*\.parquet, \.cli, \.svg, \.dxf, \.vtp, \.3mf, \.csv"):
        layer_files.write_layers(layers, tmp_path / "a.foo")
    with pytest.raises(SettingsError, match=r"'\.foo'"):
        layer_files.read_layers(tmp_path / "a.foo")
    with pytest.raises(SettingsError, match="cannot be written"):
        layer_files.write_layers(layers, tmp_path / "nowhere" / "a.parquet")


def test_blocks_that_do_not_fit_and_no_blocks_are_refused_and_leave_nothing(tmp_path):
    with pytest.raises(SettingsError, match="at least one"):
        layer_files.write_blocks([], tmp_path / "s")
    whole = random_layers(1, 3)
    for other in (random_layers(1, 3, edges=False), whole.labelled(backend="another")):
        with pytest.raises(SettingsError, match="layer 4 differs"):
            layer_files.write_blocks([whole, other], tmp_path / "s")
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_fails_keeps_the_file_that_was_there(tmp_path):
    layer_files.write_blocks([random_layers(1, 3)], tmp_path / "s")
    before = (tmp_path / "s").read_bytes()

    def broken():
        yield random_layers(2, 3)
        raise RuntimeError("the slicer died")

    with pytest.raises(RuntimeError, match="died"):
        layer_files.write_blocks(broken(), tmp_path / "s")
    assert (tmp_path / "s").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def plain_layers() -> Layers:
    """Layers with holes, an open path and an empty layer, whose numbers every format holds."""
    square = np.array([(0.0, 0.0), (8.0, 0.0), (8.0, 8.0), (0.0, 8.0)])
    ring, hole = square + 0.125, (square[::-1] * 0.5) + 2.25
    return from_rings([0.25, 0.75, 1.25, 1.75], [[ring, hole], [], [ring], [ring + 10.0, ring]])


EXACT = (".parquet", ".cli", ".svg", ".vtp", ".csv")


@pytest.mark.parametrize("suffix", layer_files.FORMATS)
def test_what_a_format_writes_it_reads(tmp_path, suffix):
    file = tmp_path / f"A{suffix.upper()}"
    layers = plain_layers()
    layer_files.write_layers(layers, file)
    assert_same(layer_files.read_layers(file), layers)
    layers = from_rings([0.5], [[]], [[[(0.0, 0.0), (1.0, 0.5), (2.0, 0.0)]]])
    if suffix == ".3mf":
        return  # slices are closed, and one height has no thickness
    layer_files.write_layers(layers, file)
    assert_same(layer_files.read_layers(file), layers)


@pytest.mark.parametrize("suffix", EXACT)
def test_a_format_with_every_digit_gives_every_bit_back(tmp_path, suffix):
    layers = random_layers(1, 4, edges=False)
    assert layers.closed.size > 3
    layer_files.write_layers(layers, tmp_path / f"a{suffix}")
    back = layer_files.read_layers(tmp_path / f"a{suffix}")
    labels = {name: getattr(layers, name) for name in ("part", "direction", "backend", "settings")}
    assert_same(replace(back, **labels), layers)


@pytest.mark.parametrize("suffix", [".svg", ".dxf", ".vtp", ".3mf", ".csv"])
@pytest.mark.parametrize(
    "content", [b"", b"nothing of the kind\n", b"<svg/>", b"layer,height_mm\n0,1\n", b"\xff\x00\n1\n"]
)
def test_a_file_that_is_not_what_its_suffix_says_is_named(tmp_path, suffix, content):
    file = tmp_path / f"a{suffix}"
    file.write_bytes(content)
    with pytest.raises(InputError, match=rf"a\{suffix}: "):
        layer_files.read_layers(file)
    file.unlink()
    with pytest.raises(InputError, match=rf"a\{suffix}: cannot be read"):
        layer_files.read_layers(file)


def test_a_drawing_of_a_cad_system_is_read_in_its_units(tmp_path):
    import ezdxf

    drawing = ezdxf.new("R2010", units=1)
    space = drawing.modelspace()
    corners = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)]
    space.add_lwpolyline(corners, close=True, dxfattribs={"elevation": 1.0})
    space.add_polyline3d([(x, y, 2.0) for x, y in corners], close=True)
    drawing.saveas(tmp_path / "a.dxf")
    back = layer_files.read_layers(tmp_path / "a.dxf")
    assert back.heights.tolist() == [25.4, 50.8]
    assert back.areas() == pytest.approx([2 * 25.4**2] * 2)
    space.add_lwpolyline([(0, 0, 0, 0, 1.0), (1, 0), (1, 1)], close=True)
    drawing.saveas(tmp_path / "a.dxf")
    with pytest.raises(InputError, match="bulges"):
        layer_files.read_layers(tmp_path / "a.dxf")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("1,0.25,0,1,0.125,0.125", "1,0.25,0,1,,0.125"), "lacks a number"),
        (("1,0.25,0,1,0.125,0.125", "1,0.25,0,1,inf,0.125"), "must be finite"),
        (("1,0.25,0,1,0.125,0.125", "1,0.3,0,1,0.125,0.125"), "several heights"),
        (("1,0.25,0,1,0.125,0.125", "1,0.25,0,1,x,0.125"), "no table"),
        (("1,0.25,0,1,0.125,0.125", "0,0.25,0,1,0.125,0.125"), "not numbered 1, 2, 3"),
    ],
)
def test_a_table_of_contours_with_a_wrong_row_is_refused(tmp_path, change, said):
    file = tmp_path / "a.csv"
    layer_files.write_layers(plain_layers(), file)
    text = file.read_text()
    assert change[0] in text
    file.write_text(text.replace(*change))
    with pytest.raises(InputError, match=said):
        layer_files.read_layers(file)


# -- tables of nested columns ---------------------------------------------------------------------------------


ITEMS = {np.float64: pa.float64(), np.int32: pa.int32(), np.uint8: pa.uint8(), np.bool_: pa.bool_()}
LISTS = st.lists(st.sampled_from([pa.list_, pa.large_list]), max_size=3)


def split(values: list, starts: list) -> list:
    """Lists of a flat column, by Python's own slices."""
    for level in reversed(starts):
        values = [values[a:b] for a, b in zip(level[:-1].tolist(), level[1:].tolist(), strict=True)]
    return values


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rows=st.integers(0, 6),
    lists=LISTS,
    item=st.sampled_from(sorted(ITEMS, key=str)),
)
def test_arrow_reads_the_lists_and_every_bit_comes_back(seed, rows, lists, item):
    rng = np.random.default_rng(seed)
    kind = ITEMS[item]
    starts, count = [], rows
    for level in lists:
        kind = level(kind)
        starts.append(starts_of(rng.integers(0, 4, count)))
        count = int(starts[-1][-1])
    values = (1000.0 * rng.normal(size=count)).astype(item)
    arrays = arrow_columns({"c": (values, *starts)}, {"c": kind})
    assert arrays["c"].type == kind
    assert arrays["c"].to_pylist() == split(values.tolist(), starts)
    for table in (pa.table(arrays), pa.concat_tables([pa.table(arrays).slice(k, 1) for k in range(rows)] or [pa.table(arrays)])):  # fmt: skip
        read, found = ReadTable(table, "here").nested("c", kind)
        assert read.dtype == values.dtype
        assert read.tobytes() == values.tobytes()
        assert [f.tolist() for f in found] == [s.tolist() for s in starts]


def test_labels_come_back_and_another_version_or_label_is_refused(tmp_path):
    value = SimpleNamespace(part="p", direction=(0.0, 0.6, 0.8), settings={"a": [1, "b"]})
    names = ("part", "direction", "settings")
    table = pa.table({"z": pa.array([1.0])}).replace_schema_metadata(labelled(value, "layers", "1", names))
    write_table(table, tmp_path / "t.parquet")
    with readable(tmp_path / "t.parquet"), open_table(tmp_path / "t.parquet") as file:
        schema = file.schema_arrow
    assert labels_of(schema, "layers", "1", names, "t") == vars(value)
    with pytest.raises(InputError, match=r"has version '1' under .*reads layers of version '2'"):
        labels_of(schema, "layers", "2", names, "t")
    with pytest.raises(InputError, match=r"t: has no version under 'ebamcheck\.curves\.version'"):
        labels_of(schema, "curves", "1", names, "t")
    with pytest.raises(InputError, match="labels cannot be read: KeyError: 'method'"):
        labels_of(schema, "layers", "1", ("method",), "t")
