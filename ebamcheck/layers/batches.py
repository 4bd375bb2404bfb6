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

from ebamcheck.columns_file import Column, ReadTable, arrow_columns, labelled, labels_of
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.kernels import run_blocks

VERSION = "1"
"""Version of the table; a reader refuses any other."""

LABELS = ("part", "direction", "backend", "settings")

LARGEST_LIST = 2**31 - 1
"""Arrow's lists count their items in 32 bits; a longer stack is written as several blocks."""

SMALLEST_BLOCK = 65536
"""Fewest points worth a thread that copies them."""

_NUMBERS = pa.list_(pa.list_(pa.float64()))
_VERTICES = pa.list_(pa.list_(pa.int32()))
_POINTS = {"x": _NUMBERS, "y": _NUMBERS}
_EDGES = {"edge_low": _VERTICES, "edge_high": _VERTICES, "edge_t": _NUMBERS}
_KINDS = {
    "height_mm": pa.float64(),
    "dropped": pa.int64(),
    **_POINTS,
    "closed": pa.list_(pa.bool_()),
    **_EDGES,
}
CONTOUR_COLUMNS = [name for name in _KINDS if name not in _EDGES]
"""Columns that every table of contours must have."""


def to_arrow(layers: Layers) -> pa.RecordBatch:
    """Layers as a record batch, one row per layer; edge parameters are not copied.

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
    nested = (layers.layer_starts, layers.ring_starts)
    x, y = _apart(layers.points)
    columns: dict[str, Column] = {
        "height_mm": (layers.heights,),
        "dropped": (layers.dropped,),
        "x": (x, *nested),
        "y": (y, *nested),
        "closed": (layers.closed, layers.layer_starts),
    }
    if layers.edge is not None and layers.edge_t is not None:
        low, high = _apart(layers.edge)
        columns |= {
            "edge_low": (low, *nested),
            "edge_high": (high, *nested),
            "edge_t": (layers.edge_t, *nested),
        }
    metadata = labelled(layers, "layers", VERSION, LABELS)
    return pa.record_batch(arrow_columns(columns, _KINDS)).replace_schema_metadata(metadata)


def from_arrow(batch: pa.RecordBatch | pa.Table, where: str = "record batch") -> Layers:
    """Layers from a record batch, or a table, as :func:`to_arrow` makes it.

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
    labels = layer_labels(batch.schema, where)
    table = ReadTable(batch, where)
    with_edges = any(name in batch.schema.names for name in _EDGES)
    columns, (layer_starts, ring_starts) = table.alike(
        _POINTS | (_EDGES if with_edges else {}),
        "column {name!r} does not have the rings and points of column {first!r}",
    )
    points = np.empty((columns["x"].size, 2))
    points[:, 0], points[:, 1] = columns["x"], columns["y"]
    closed, (starts,) = table.nested("closed", _KINDS["closed"])
    if not np.array_equal(starts, layer_starts):
        raise InputError(f"{where}: column 'closed' does not have one entry for each ring of 'x'")
    heights = heights_of(batch, where)
    _check_finite(heights, points, where)
    return Layers(
        heights=heights,
        points=points,
        ring_starts=ring_starts,
        layer_starts=layer_starts,
        closed=closed,
        edge=np.stack([columns["edge_low"], columns["edge_high"]], axis=1) if with_edges else None,
        edge_t=columns["edge_t"].copy() if with_edges else None,
        dropped=table.plain("dropped", _KINDS["dropped"]),
        **labels,
    )


def heights_of(batch: pa.RecordBatch | pa.Table, where: str) -> NDArray[np.float64]:
    """Heights of the layers alone, (L,) mm; raises :class:`InputError` where they are missing or of another type."""
    return ReadTable(batch, where).plain("height_mm", _KINDS["height_mm"])


def layer_labels(schema: pa.Schema, where: str) -> dict[str, Any]:
    """Labels in a schema's metadata; raises :class:`InputError` if their version is not :data:`VERSION`."""
    return labels_of(schema, "layers", VERSION, LABELS, where)


def _apart(pairs: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """The two columns of (N, 2) `pairs`, (N,) each, copied in parallel."""
    first, second = np.empty(len(pairs), pairs.dtype), np.empty(len(pairs), pairs.dtype)

    def copy(start: int, stop: int) -> None:
        first[start:stop] = pairs[start:stop, 0]
        second[start:stop] = pairs[start:stop, 1]

    run_blocks(copy, len(pairs), SMALLEST_BLOCK)
    return first, second


def _check_finite(heights: NDArray[np.float64], points: NDArray[np.float64], where: str) -> None:
    if not np.isfinite(heights).all():
        layer = int(np.flatnonzero(~np.isfinite(heights))[0])
        raise InputError(f"{where}: height of layer {layer + 1} is {heights[layer]}: it must be finite")
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise InputError(f"{where}: point {row} is {points[row].tolist()}: coordinates must be finite")
