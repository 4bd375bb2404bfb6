"""Layers as Arrow record batches, the form in which files hold them.

The table has one row per layer:

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
direction, backend, settings). Rings are in the canonical form of :class:`~ebamcheck.layers.stack.Layers`;
numbers are restored bit for bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import parsed_json
from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.kernels import run_blocks
from ebamcheck.numeric.rings import Ints

VERSION = "1"
"""Version of the table; a reader refuses any other."""

VERSION_KEY = b"ebamcheck.layers.version"
LABELS_KEY = b"ebamcheck.layers.labels"

LARGEST_LIST = 2**31 - 1
"""Arrow's lists count their items in 32 bits; a longer stack is written as several blocks."""

SMALLEST_BLOCK = 65536
"""Fewest points worth a thread that copies them."""

_NUMBERS = pa.list_(pa.list_(pa.float64()))
_VERTICES = pa.list_(pa.list_(pa.int32()))
_REQUIRED = {
    "height_mm": pa.float64(),
    "dropped": pa.int64(),
    "x": _NUMBERS,
    "y": _NUMBERS,
    "closed": pa.list_(pa.bool_()),
}
CONTOUR_COLUMNS = list(_REQUIRED)
"""Columns that every table of contours must have."""

_EDGES = {"edge_low": _VERTICES, "edge_high": _VERTICES, "edge_t": _NUMBERS}


def to_arrow(layers: Layers) -> pa.RecordBatch:
    """Layers as a record batch, one row per layer; offsets and edge parameters are not copied twice.

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

    x, y = _apart(layers.points)
    columns = {
        "height_mm": _flat(layers.heights),
        "dropped": _flat(layers.dropped),
        "x": nested(x),
        "y": nested(y),
        "closed": pa.ListArray.from_arrays(layer_offsets, _flat(layers.closed)),
    }
    if layers.edge is not None and layers.edge_t is not None:
        low, high = _apart(layers.edge)
        columns["edge_low"] = nested(low)
        columns["edge_high"] = nested(high)
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
    labels = labels_of(batch.schema, where)
    layer_starts, ring_starts, x = _nested(batch, "x", where)
    points = np.empty((x.size, 2))
    points[:, 0] = x
    points[:, 1] = _matching(batch, "y", where, layer_starts, ring_starts)
    closed_list = _column(batch, "closed", _REQUIRED["closed"], where)
    if not np.array_equal(_offsets(closed_list), layer_starts):
        raise InputError(f"{where}: column 'closed' does not have one entry for each ring of 'x'")
    heights = column_of(batch, "height_mm", where)
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
        dropped=column_of(batch, "dropped", where),
        **labels,
    )


def _flat(column: NDArray[Any]) -> pa.Array:
    """An Arrow array over a column's own memory (``pa.array`` would first import pandas, which takes a second)."""
    if column.dtype == np.bool_:
        bits = np.packbits(column, bitorder="little")
        return pa.Array.from_buffers(pa.bool_(), column.size, [None, pa.py_buffer(bits)])
    column = np.ascontiguousarray(column)
    return pa.Array.from_buffers(pa.from_numpy_dtype(column.dtype), column.size, [None, pa.py_buffer(column)])


def _apart(pairs: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """The two columns of (N, 2) `pairs`, (N,) each, copied in parallel."""
    first, second = np.empty(len(pairs), pairs.dtype), np.empty(len(pairs), pairs.dtype)

    def copy(start: int, stop: int) -> None:
        first[start:stop] = pairs[start:stop, 0]
        second[start:stop] = pairs[start:stop, 1]

    run_blocks(copy, len(pairs), SMALLEST_BLOCK)
    return first, second


def _own(column: pa.Array) -> NDArray[Any]:
    """A column as a writable numpy array: numba would compile kernels again for a read-only one.

    (By DLPack, because pyarrow's ``to_numpy`` would import pandas, too.)
    """
    return np.from_dlpack(column).copy()


def labels_of(schema: pa.Schema, where: str) -> dict[str, Any]:
    """Labels in a schema's metadata; raises :class:`InputError` if their version is not :data:`VERSION`."""
    metadata = schema.metadata or {}
    version = metadata.get(VERSION_KEY, b"").decode("utf-8", "replace")
    if version != VERSION:
        said = f"version {version[:40]!r}" if version else "no version"
        raise InputError(
            f"{where}: has {said} under {VERSION_KEY.decode()!r}: this program reads layers of version {VERSION!r}"
        )
    try:
        values = parsed_json(metadata[LABELS_KEY])
        return {
            "part": str(values["part"]),
            "direction": tuple(float(v) for v in values["direction"]),
            "backend": str(values["backend"]),
            "settings": dict(values["settings"]),
        }
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{where}: its labels cannot be read: {type(error).__name__}: {error}") from None


def _column(batch: pa.RecordBatch, name: str, kind: pa.DataType, where: str) -> Any:
    """A column, checked to have the given type and no nulls."""
    if name not in batch.schema.names:
        raise InputError(f"{where}: column {name!r} is missing; there are {', '.join(batch.schema.names)}")
    column = batch.column(name)
    if column.type != kind:
        raise InputError(f"{where}: column {name!r} is {column.type}, it should be {kind}")
    if column.null_count:
        raise InputError(f"{where}: column {name!r} has {column.null_count} empty cells")
    return column


def column_of(batch: pa.RecordBatch, name: str, where: str) -> NDArray[Any]:
    """A plain column as an array; raises :class:`InputError` where it is missing or of another type."""
    return _own(_column(batch, name, _REQUIRED[name], where))


def _offsets(column: pa.ListArray) -> Ints:
    """Start of each list, counted from 0, and end of the last one."""
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
        raise InputError(f"{where}: height of layer {layer + 1} is {heights[layer]}: it must be finite")
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise InputError(f"{where}: point {row} is {points[row].tolist()}: coordinates must be finite")
