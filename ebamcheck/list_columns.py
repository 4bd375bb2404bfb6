"""List columns of Parquet tables: one list a row over a flat column, written and read with what is wrong named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ebamcheck.errors import InputError


def starts_of(sizes: NDArray[Any]) -> NDArray[np.int64]:
    """Return where each of (N,) lists starts in their flat column, and where the last one ends, (N + 1,)."""
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


def list_column(starts: NDArray[np.int64], values: NDArray[Any] | pa.Array) -> pa.LargeListArray:
    """One list a row over a flat column; large lists, as a stack may hold over 2^31 numbers."""
    flat = pa.array(np.ascontiguousarray(values)) if isinstance(values, np.ndarray) else values
    return pa.LargeListArray.from_arrays(pa.array(starts), flat)


def plain_column(table: pa.Table, name: str, kind: pa.DataType, path: Path) -> Any:
    """Return a column of a table as one array.

    Raises
    ------
    InputError
        If it is missing, of another type, or has empty cells.
    """
    if name not in table.schema.names:
        raise InputError(f"{path}: column {name!r} is missing; there are {', '.join(table.schema.names)}")
    column = table.column(name).combine_chunks()
    if column.type != kind:
        raise InputError(f"{path}: column {name!r} is {column.type}, it should be {kind}")
    if column.null_count:
        raise InputError(f"{path}: column {name!r} has {column.null_count} empty cells")
    return column


def flat_column(
    table: pa.Table, name: str, kind: pa.DataType, path: Path
) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Items of a list column as one writable array, and where the list of each row starts.

    Raises
    ------
    InputError
        If the column is missing, of another type, or has empty cells or items.
    """
    column = plain_column(table, name, pa.large_list(kind), path)
    items = column.flatten()
    if items.null_count:
        raise InputError(f"{path}: column {name!r} has {items.null_count} empty items")
    sizes = column.value_lengths().to_numpy(zero_copy_only=False)
    return items.to_numpy(zero_copy_only=False).copy(), starts_of(sizes)
