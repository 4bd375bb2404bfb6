"""Tables of nested numpy columns in Parquet files, one row a layer: written as Arrow lists, and read back in the same bits."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ebamcheck.atomic_file import COMPRESSION, regular_file, replacing
from ebamcheck.errors import InputError
from ebamcheck.json_values import parsed_json
from ebamcheck.kernels import Ints

if TYPE_CHECKING:
    # Loaded only where a file is opened: it takes longer than the rest of Arrow.
    import pyarrow.parquet as pq

# How Parquet holds numbers: coordinates hardly repeat, so that a dictionary would only cost time; checksums find flipped bits
NUMBERS = {
    "compression": COMPRESSION,
    "use_dictionary": False,
    "write_statistics": False,
    "write_page_checksum": True,
}
# Flat values, and the starts of the lists of each level with the end of the last list, outermost level first
Column = tuple[NDArray[Any] | pa.Array, *tuple[Ints, ...]]


def starts_of(sizes: NDArray[Any]) -> Ints:
    """Return where each of (N,) lists starts in their flat column, and where the last one ends, (N + 1,)."""
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


# -- writing -----------------------------------------------------------------------------------------


def arrow_columns(columns: Mapping[str, Column], kinds: Mapping[str, pa.DataType]) -> dict[str, pa.Array]:
    """Arrow arrays of numpy columns, of the types that `kinds` gives their names."""
    return {name: _arrow(kinds[name], *column) for name, column in columns.items()}


def _arrow(kind: pa.DataType, values: NDArray[Any] | pa.Array, *starts: Ints) -> pa.Array:
    if not starts:
        return _flat(values) if isinstance(values, np.ndarray) else values
    large = pa.types.is_large_list(kind)
    offsets = _flat(starts[0].astype(np.int64 if large else np.int32, copy=False))
    items = _arrow(kind.value_type, values, *starts[1:])
    return (pa.LargeListArray if large else pa.ListArray).from_arrays(offsets, items)


def _flat(column: NDArray[Any]) -> pa.Array:
    """An Arrow array over a column's own memory (``pa.array`` would first import pandas, which takes a second)."""
    if column.dtype == np.bool_:
        bits = np.packbits(column, bitorder="little")
        return pa.Array.from_buffers(pa.bool_(), column.size, [None, pa.py_buffer(bits)])
    column = np.ascontiguousarray(column)
    return pa.Array.from_buffers(pa.from_numpy_dtype(column.dtype), column.size, [None, pa.py_buffer(column)])


def labelled(value: Any, what: str, version: str, names: tuple[str, ...]) -> dict[bytes, bytes]:
    """Metadata of a table of layers or curves (`what`): its version, and the named attributes of a value as JSON."""
    labels = json.dumps({name: getattr(value, name) for name in names}, sort_keys=True, default=dict)
    return {_key(what, "version"): version.encode(), _key(what, "labels"): labels.encode()}


def write_table(table: pa.Table, path: Path, **changed: Any) -> None:
    """Write a Parquet file as :data:`NUMBERS` says, with options changed; it appears whole or not at all."""
    import pyarrow.parquet as pq

    with replacing(path) as temporary:
        pq.write_table(table, temporary, **{**NUMBERS, **changed})


# -- reading -----------------------------------------------------------------------------------------


@contextmanager
def readable(path: Path, what: str = "Parquet") -> Iterator[None]:
    """Turn an error of reading a file into an :class:`InputError` that names the file and `what` it should be."""
    try:
        yield
    except (OSError, pa.ArrowException) as error:
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: cannot be read as {what}: {line}") from None


def open_table(path: Path) -> pq.ParquetFile:
    """Open a Parquet file whose pages are checked as they are read; the caller closes it, and reads within :func:`readable`."""
    import pyarrow.parquet as pq

    return pq.ParquetFile(regular_file(path), page_checksum_verification=True)


def labels_of(schema: pa.Schema, what: str, version: str, names: tuple[str, ...], where: str) -> dict[str, Any]:
    """Labels that :func:`labelled` wrote; ``direction`` is a tuple, ``settings`` a dictionary, any other a text."""
    metadata = schema.metadata or {}
    found = metadata.get(_key(what, "version"), b"").decode("utf-8", "replace")
    if found != version:
        said = f"version {found[:40]!r}" if found else "no version"
        raise InputError(
            f"{where}: has {said} under {_key(what, 'version').decode()!r}: "
            f"this program reads {what} of version {version!r}"
        )
    try:
        values = parsed_json(metadata[_key(what, "labels")])
        forms: Mapping[str, Callable[[Any], Any]] = {
            "direction": lambda given: tuple(map(float, given)),
            "settings": dict,
        }
        return {name: forms.get(name, str)(values[name]) for name in names}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{where}: its labels cannot be read: {type(error).__name__}: {error}") from None


def _key(what: str, name: str) -> bytes:
    return f"ebamcheck.{what}.{name}".encode()


class ReadTable(NamedTuple):
    """A table that is read column by column, and what messages call it; every method raises :class:`InputError`."""

    table: pa.Table | pa.RecordBatch
    where: str | Path

    def plain(self, name: str, kind: pa.DataType) -> NDArray[Any]:
        """Values of a column without lists, one a row, writable: numba would compile kernels again for others."""
        return _values(self._column(name, kind)).copy()

    def nested(self, name: str, kind: pa.DataType) -> tuple[NDArray[Any], list[Ints]]:
        """Flat values of a column of lists, those of the table where it has them as numpy does, and the starts of the lists of each
        level."""
        items, starts, empty = self._column(name, kind), [], 0
        while isinstance(items, pa.ListArray | pa.LargeListArray):
            offsets = np.from_dlpack(items.offsets).astype(np.int64)
            starts.append(offsets - offsets[0])
            items = items.flatten()
            empty += items.null_count
        if empty:
            raise InputError(f"{self.where}: column {name!r} has {empty} empty items")
        return _values(items), starts

    def alike(
        self,
        kinds: Mapping[str, pa.DataType],
        unlike: str = "columns {first!r} and {name!r} differ in length in a layer",
    ) -> tuple[dict[str, NDArray[Any]], list[Ints]]:
        """Columns whose lists are equally long in every row, as :meth:`nested` returns them; `unlike` words the refusal."""
        values: dict[str, NDArray[Any]] = {}
        starts: list[Ints] = []
        for name, kind in kinds.items():
            values[name], its = self.nested(name, kind)
            starts = starts or its
            if not all(map(np.array_equal, its, starts)):
                raise InputError(f"{self.where}: {unlike.format(first=next(iter(kinds)), name=name)}")
        return values, starts

    def _column(self, name: str, kind: pa.DataType) -> pa.Array:
        """A column, checked to have the given type and no empty cells."""
        names = self.table.schema.names
        if name not in names:
            raise InputError(f"{self.where}: column {name!r} is missing; there are {', '.join(names)}")
        column = self.table.column(name)
        if column.type != kind:
            raise InputError(f"{self.where}: column {name!r} is {column.type}, it should be {kind}")
        if column.null_count:
            raise InputError(f"{self.where}: column {name!r} has {column.null_count} empty cells")
        return column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column


def _values(column: pa.Array) -> NDArray[Any]:
    """Values of a column in the table's own memory, where numpy has its type."""
    if pa.types.is_boolean(column.type):
        return np.from_dlpack(column.cast(pa.uint8())).astype(np.bool_)
    if pa.types.is_primitive(column.type):
        return np.from_dlpack(column)  # pyarrow's ``to_numpy`` would import pandas
    return np.asarray(column.to_numpy(zero_copy_only=False))
