"""Layers in files and between processes: Parquet, Arrow IPC, and the choice of a format by suffix.

The table has one row a layer:

====================  ======================  ======================================================
column                type                    meaning
====================  ======================  ======================================================
``height_mm``         double                  absolute z of the layer
``dropped``           int64                   rings without area that were left out
``x``, ``y``          list<list<double>>      points of each ring, mm
``closed``            list<bool>              false for an open path
``edge_low``          list<list<int32>>       lower mesh vertex of the edge cut at each point (optional)
``edge_high``         list<list<int32>>       upper mesh vertex (optional)
``edge_t``            list<list<double>>      place of the point on that edge (optional)
====================  ======================  ======================================================

The schema's metadata hold ``ebamcheck.layers.version`` and ``ebamcheck.layers.labels`` (JSON: part,
direction, backend, settings). Rings stand in the canonical form of :class:`~ebamcheck.layers.Layers`;
every number comes back in the same bits.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ebamcheck import common_layer_interface, layer_svg
from ebamcheck.atomic_file import replacing
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers import Layers, concatenate
from ebamcheck.rings import Ints

VERSION = "1"
"""Version of the table; a reader refuses any other."""

VERSION_KEY = b"ebamcheck.layers.version"
LABELS_KEY = b"ebamcheck.layers.labels"

LARGEST_LIST = 2**31 - 1
"""Arrow's lists count their items in 32 bits; a longer stack is written as several blocks."""

END_OF_STREAM = b"\xff\xff\xff\xff\x00\x00\x00\x00"
"""What a whole Arrow IPC stream ends with (Arrow columnar format, "IPC Streaming Format")."""

_NUMBERS = pa.list_(pa.list_(pa.float64()))
_VERTICES = pa.list_(pa.list_(pa.int32()))
_REQUIRED = {
    "height_mm": pa.float64(),
    "dropped": pa.int64(),
    "x": _NUMBERS,
    "y": _NUMBERS,
    "closed": pa.list_(pa.bool_()),
}
_EDGES = {"edge_low": _VERTICES, "edge_high": _VERTICES, "edge_t": _NUMBERS}

# -- by suffix -------------------------------------------------------------------------------------


def write_layers(layers: Layers, path: str | Path) -> None:
    """Write layers in the format that the suffix names: ``.parquet``, ``.cli`` (ASCII) or ``.svg``.

    Raises
    ------
    SettingsError
        If the suffix is another one, or the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".parquet":
        write_parquet(layers, path)
    elif suffix == ".cli":
        common_layer_interface.write_cli(layers, path)
    elif suffix == ".svg":
        with replacing(path) as temporary:
            temporary.write_text(layer_svg.sheet_svg(layers), encoding="utf-8")
    else:
        raise SettingsError(f"{path}: unknown slice format {suffix!r}: use .parquet, .cli or .svg")


def read_layers(path: str | Path) -> Layers:
    """Read layers from a ``.parquet`` or ``.cli`` file, told apart by suffix.

    Raises
    ------
    InputError
        If the file is missing or not what its suffix says.
    SettingsError
        If the suffix is neither of the two.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".parquet":
        return read_parquet(path)
    if suffix == ".cli":
        return common_layer_interface.read_cli(path)
    raise SettingsError(f"{path}: cannot read layers from {suffix!r}: give a .parquet or .cli file")


# -- Parquet ---------------------------------------------------------------------------------------


def write_parquet(layers: Layers, path: str | Path) -> None:
    """Write layers as one Parquet table; the file appears whole or not at all.

    Raises
    ------
    SettingsError
        If the file cannot be written.
    """
    batch = to_arrow(layers)
    with replacing(path) as temporary:
        # Coordinates hardly repeat, so a dictionary would only cost time; checksums find flipped bits.
        pq.write_table(
            pa.Table.from_batches([batch]),
            temporary,
            compression="lz4",
            use_dictionary=False,
            write_statistics=False,
            write_page_checksum=True,
        )


def read_parquet(path: str | Path) -> Layers:
    """Read layers from Parquet, every number in the bits it was written with.

    Raises
    ------
    InputError
        If the file is missing, truncated, not Parquet, of another version, or lacks a column.
    """
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            table = file.read()
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read as Parquet: {_first_line(error)}") from None
    return _joined(table.to_batches() or [_no_rows(table.schema)], str(path))


# -- Arrow IPC -------------------------------------------------------------------------------------


def write_ipc(blocks: Iterable[Layers], path: str | Path) -> int:
    """Write consecutive blocks of one stack as an Arrow IPC stream, one record batch a block.

    Parameters
    ----------
    blocks
        At least one; all of one slicer, all with cut edges or all without.
    path
        The file; it appears when the stream is whole.

    Returns
    -------
    int
        Layers written.

    Raises
    ------
    SettingsError
        If there is no block, the blocks differ in columns, or the file cannot be written.
    """
    remaining = iter(blocks)
    first = next(remaining, None)
    if first is None:
        raise SettingsError(f"{path}: no layers to write: give at least one block")
    count = 0
    schema = to_arrow(first.block(0, 0)).schema
    with replacing(path) as temporary, pa.ipc.new_stream(str(temporary), schema) as stream:
        for block in chain([first], remaining):
            if (block.edge is None) != (first.edge is None):
                raise SettingsError(f"{path}: block at layer {count} differs from the first in its columns")
            stream.write_batch(to_arrow(block).replace_schema_metadata(schema.metadata))
            count += len(block)
    return count


def read_ipc(path: str | Path) -> Layers:
    """Read a whole Arrow IPC stream as one stack; raises :class:`InputError` as :func:`iterate_ipc` does."""
    blocks = list(iterate_ipc(path))
    if not blocks:
        raise InputError(f"{path}: an Arrow stream without layers")
    return blocks[0] if len(blocks) == 1 else concatenate(blocks)


def iterate_ipc(path: str | Path) -> Iterator[Layers]:
    """Yield the blocks of an Arrow IPC stream one after the other.

    Raises
    ------
    InputError
        If the file is missing, not an Arrow stream, cut off, of another version, or lacks a column.
    """
    try:
        with pa.memory_map(str(path)) as source:
            _check_end(source, path)
            with pa.ipc.open_stream(source) as stream:
                for batch in stream:
                    yield from_arrow(batch, str(path))
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read as an Arrow stream: {_first_line(error)}") from None


def _check_end(source: Any, path: str | Path) -> None:
    """Refuse a stream without its end mark: Arrow itself takes one cut between batches for whole."""
    size = source.size()
    source.seek(max(0, size - len(END_OF_STREAM)))
    if source.read() != END_OF_STREAM:
        raise InputError(f"{path}: an Arrow stream cut off after {size} bytes: its writer did not finish")
    source.seek(0)


# -- record batches --------------------------------------------------------------------------------


def to_arrow(layers: Layers) -> pa.RecordBatch:
    """Layers as a record batch, one row a layer; offsets and edge parameters are not copied twice.

    Raises
    ------
    SettingsError
        If the stack has more than :data:`LARGEST_LIST` points: write it as blocks.
    """
    if len(layers.points) > LARGEST_LIST:
        raise SettingsError(
            f"{len(layers.points)} points are too many for one Arrow batch (limit {LARGEST_LIST}): "
            "write the stack in blocks of layers"
        )
    ring_offsets = _flat(layers.ring_starts.astype(np.int32))
    layer_offsets = _flat(layers.layer_starts.astype(np.int32))

    def nested(column: NDArray[Any]) -> pa.ListArray:
        return pa.ListArray.from_arrays(layer_offsets, pa.ListArray.from_arrays(ring_offsets, _flat(column)))

    columns = {
        "height_mm": _flat(layers.heights),
        "dropped": _flat(layers.dropped),
        "x": nested(layers.points[:, 0]),
        "y": nested(layers.points[:, 1]),
        "closed": pa.ListArray.from_arrays(layer_offsets, _flat(layers.closed)),
    }
    if layers.edge is not None and layers.edge_t is not None:
        columns["edge_low"] = nested(layers.edge[:, 0])
        columns["edge_high"] = nested(layers.edge[:, 1])
        columns["edge_t"] = nested(layers.edge_t)
    metadata = {VERSION_KEY: VERSION, LABELS_KEY: layers.labels_json()}
    return pa.record_batch(columns).replace_schema_metadata(metadata)


def from_arrow(batch: pa.RecordBatch, where: str = "record batch") -> Layers:
    """Layers from a record batch as :func:`to_arrow` makes it.

    Parameters
    ----------
    batch
        Rows are layers; it may be a slice of a longer one.
    where
        What to call the source in error messages.

    Raises
    ------
    InputError
        If the version is another one, a column is missing or of another type, the columns do not match
        each other, or a number is not finite.
    """
    labels = _labels(batch.schema, where)
    layer_starts, ring_starts, x = _nested(batch, "x", where)
    points = np.empty((x.size, 2))
    points[:, 0] = x
    points[:, 1] = _matching(batch, "y", where, layer_starts, ring_starts)
    closed_list = _column(batch, "closed", _REQUIRED["closed"], where)
    if not np.array_equal(_offsets(closed_list), layer_starts):
        raise InputError(f"{where}: column 'closed' does not have one entry for each ring of 'x'")
    heights = _own(_column(batch, "height_mm", pa.float64(), where))
    _check_finite(heights, points, where)
    edge = edge_t = None
    if any(name in batch.schema.names for name in _EDGES):
        low, high = (
            _matching(batch, name, where, layer_starts, ring_starts) for name in ("edge_low", "edge_high")
        )
        edge = np.stack([low, high], axis=1).astype(np.int32, copy=False)
        edge_t = _matching(batch, "edge_t", where, layer_starts, ring_starts).copy()
    return Layers(
        heights=heights,
        points=points,
        ring_starts=ring_starts,
        layer_starts=layer_starts,
        closed=_own(closed_list.flatten().cast(pa.uint8())).astype(np.bool_),
        edge=edge,
        edge_t=edge_t,
        dropped=_own(_column(batch, "dropped", pa.int64(), where)),
        **labels,
    )


def _flat(column: NDArray[Any]) -> pa.Array:
    """An Arrow array over a column's own memory (``pa.array`` would import pandas first, for a second)."""
    if column.dtype == np.bool_:
        bits = np.packbits(column, bitorder="little")
        return pa.Array.from_buffers(pa.bool_(), column.size, [None, pa.py_buffer(bits)])
    column = np.ascontiguousarray(column)
    return pa.Array.from_buffers(pa.from_numpy_dtype(column.dtype), column.size, [None, pa.py_buffer(column)])


def _own(column: pa.Array) -> NDArray[Any]:
    """A column as a numpy array of its own: numba compiles anew for one that is read-only.

    (By DLPack, because pyarrow's ``to_numpy`` would import pandas first, too.)
    """
    return np.from_dlpack(column).copy()


def _labels(schema: pa.Schema, where: str) -> dict[str, Any]:
    """Labels in the metadata, once their version is known to be ours."""
    metadata = schema.metadata or {}
    version = metadata.get(VERSION_KEY, b"").decode("utf-8", "replace")
    if version != VERSION:
        said = f"version {version!r}" if version else "no version"
        raise InputError(
            f"{where}: has {said} under {VERSION_KEY.decode()!r}: this program reads layers of version {VERSION!r}"
        )
    try:
        values = json.loads(metadata[LABELS_KEY])
        return {
            "part": str(values["part"]),
            "direction": tuple(float(v) for v in values["direction"]),
            "backend": str(values["backend"]),
            "settings": dict(values["settings"]),
        }
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{where}: its labels cannot be read: {type(error).__name__}: {error}") from None


def _column(batch: pa.RecordBatch, name: str, kind: pa.DataType, where: str) -> Any:
    """A column of the type it should have, without nulls."""
    if name not in batch.schema.names:
        raise InputError(f"{where}: column {name!r} is missing; there are {', '.join(batch.schema.names)}")
    column = batch.column(name)
    if column.type != kind:
        raise InputError(f"{where}: column {name!r} is {column.type}, it should be {kind}")
    if column.null_count:
        raise InputError(f"{where}: column {name!r} has {column.null_count} empty cells")
    return column


def _offsets(column: pa.ListArray) -> Ints:
    """Where each list starts, from 0, and where the last one ends."""
    offsets = np.from_dlpack(column.offsets).astype(np.int64)
    starts: Ints = offsets - offsets[0]
    return starts


def _nested(batch: pa.RecordBatch, name: str, where: str) -> tuple[Ints, Ints, NDArray[Any]]:
    """Starts of layers in rings, of rings in points, and the items of a nested column."""
    column = _column(batch, name, _EDGES.get(name, _NUMBERS), where)
    inner = column.flatten()
    items = inner.flatten()
    if inner.null_count or items.null_count:
        raise InputError(f"{where}: column {name!r} has {inner.null_count + items.null_count} empty items")
    return _offsets(column), _offsets(inner), np.from_dlpack(items)


def _matching(
    batch: pa.RecordBatch, name: str, where: str, layer_starts: Ints, ring_starts: Ints
) -> NDArray[Any]:
    """Items of a nested column that has the same rings as column x."""
    layers, rings, items = _nested(batch, name, where)
    if not (np.array_equal(layers, layer_starts) and np.array_equal(rings, ring_starts)):
        raise InputError(f"{where}: column {name!r} does not have the rings and points of column 'x'")
    return items


def _check_finite(heights: NDArray[np.float64], points: NDArray[np.float64], where: str) -> None:
    if not np.isfinite(heights).all():
        layer = int(np.flatnonzero(~np.isfinite(heights))[0])
        raise InputError(f"{where}: height of layer {layer} is {heights[layer]}: it must be finite")
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise InputError(f"{where}: point {row} is {points[row].tolist()}: coordinates must be finite")


def _joined(batches: list[pa.RecordBatch], where: str) -> Layers:
    blocks = [from_arrow(batch, where) for batch in batches]
    return blocks[0] if len(blocks) == 1 else concatenate(blocks)


def _no_rows(schema: pa.Schema) -> pa.RecordBatch:
    return pa.RecordBatch.from_pylist([], schema=schema)


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
