"""Tables of nested columns: what Arrow itself reads of them are the lists they were made of, every bit comes back, and what is wrong is named."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pyarrow as pa
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
from ebamcheck.errors import InputError

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


def test_values_without_lists_are_writable_and_the_callers_own():
    table = pa.table({"z": pa.array([1.0, 2.0])})
    read = ReadTable(table, "here").plain("z", pa.float64())
    read[0] = 5.0
    assert table["z"].to_pylist() == [1.0, 2.0]


NUMBERS = pa.list_(pa.float64())


@pytest.mark.parametrize(
    ("column", "told"),
    [
        (None, "here: column 'a' is missing; there are b"),
        (pa.array([["x"]]), "column 'a' is list<item: string>, it should be list<item: double>"),
        (pa.array([None], NUMBERS), "column 'a' has 1 empty cells"),
        (pa.array([[1.0, None]], NUMBERS), "column 'a' has 1 empty items"),
        (pa.array([[1.0]], NUMBERS), "columns 'b' and 'a' differ in length in a layer"),
    ],
)
def test_what_is_wrong_is_named(column, told):
    columns = {"b": pa.array([[1.0, 2.0]], NUMBERS)} | ({} if column is None else {"a": column})
    table = ReadTable(pa.table(columns), "here")
    with pytest.raises(InputError) as caught:
        table.alike({"b": NUMBERS, "a": NUMBERS})
    assert told in str(caught.value)


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
