"""Contours as a table of points: CSV, and the columns that other formats of points come to.

The columns of the CSV are ``layer`` (from 1), ``height_mm``, ``ring`` (from 0 in each layer), ``closed`` (0 or 1), ``x_mm`` and
``y_mm``; a layer without a contour has one row, whose last four fields are empty. Numbers have the shortest digits that read back to
the same bits. Outer rings run counter-clockwise, holes clockwise.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
from numpy.typing import NDArray

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import InputError
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.numeric.rings import Floats, Ints

TYPES = {
    "layer": pa.int64(),
    "height_mm": pa.float64(),
    "ring": pa.int64(),
    "closed": pa.int64(),
    "x_mm": pa.float64(),
    "y_mm": pa.float64(),
}


def stack_of_rings(
    heights: Floats, ring_layer: Ints, sizes: Ints, closed: NDArray[np.bool_], points: Floats
) -> Layers:
    """Stack of the rings of a file, in any order.

    Parameters
    ----------
    heights
        (L,) heights, mm.
    ring_layer, sizes, closed
        (R,) layer of each ring, its number of points, and whether it is closed.
    points
        (N, 2) points of all rings, one after the other, mm.
    """
    order = np.argsort(ring_layer, kind="stable")
    starts = np.concatenate([[0], np.cumsum(sizes)])
    rows = np.concatenate(
        [np.arange(starts[r], starts[r + 1]) for r in order.tolist()] or [np.zeros(0, np.int64)]
    )
    layer_starts = np.concatenate([[0], np.cumsum(np.bincount(ring_layer, minlength=len(heights)))])
    ring_starts = np.concatenate([[0], np.cumsum(sizes[order])])
    return canonical(heights, points[rows], ring_starts, layer_starts, closed[order])


def write_stack(layers: Layers, path: str | Path) -> None:
    """Write the contours as CSV."""
    sizes = np.diff(layers.ring_starts)
    first = layers.layer_starts[layers.ring_layer]
    ring = np.repeat(np.arange(len(sizes)) - first, sizes)
    layer = np.repeat(layers.ring_layer, sizes)
    empty = np.flatnonzero(np.diff(layers.layer_starts) == 0)
    where = np.concatenate([layer, empty])
    order = np.argsort(where, kind="stable")
    closed = np.repeat(layers.closed, sizes)
    columns: dict[str, NDArray[Any]] = {"layer": where + 1, "height_mm": layers.heights[where]}
    blank = np.zeros(len(empty))
    for name, values in (
        ("ring", ring),
        ("closed", closed),
        ("x_mm", layers.points[:, 0]),
        ("y_mm", layers.points[:, 1]),
    ):
        columns[name] = np.concatenate([values, blank])
    holds_none = np.arange(len(where)) >= len(layer)
    table = pa.table(
        {
            name: pa.array(
                values[order],
                TYPES[name],
                mask=None if name in ("layer", "height_mm") else holds_none[order],
                safe=False,
            )
            for name, values in columns.items()
        }
    )
    with replacing(path) as temporary:
        pc.write_csv(table, temporary)


def read_stack(path: str | Path) -> Layers:
    """Read contours from CSV.

    Raises
    ------
    InputError
        If the file is missing, lacks a column, or holds what is no number.
    """
    try:
        table = pc.read_csv(
            path, convert_options=pc.ConvertOptions(column_types=TYPES, include_columns=list(TYPES))
        )
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (pa.ArrowInvalid, pa.ArrowKeyError) as error:
        raise InputError(
            f"{path}: is no table of contours with the columns {', '.join(TYPES)}: {error}"
        ) from None
    held = {name: table[name].to_numpy() for name in ("layer", "height_mm")}
    layer, first = np.unique(held["layer"], return_index=True)
    if not np.array_equal(layer, np.arange(1, len(layer) + 1)):
        raise InputError(f"{path}: the layers are not numbered 1, 2, 3, ...: number all of them")
    heights = held["height_mm"][first]
    if not np.array_equal(heights[held["layer"] - 1], held["height_mm"]):
        raise InputError(f"{path}: the points of one layer have several heights: give each layer one")
    rows = table.filter(table["ring"].is_valid())
    if any(rows[name].null_count for name in TYPES):
        raise InputError(
            f"{path}: a point lacks a number: fill in all fields, or leave `ring` to `y_mm` empty"
        )
    of_layer, ring, closed = (rows[name].to_numpy() for name in ("layer", "ring", "closed"))
    points = np.column_stack([rows["x_mm"].to_numpy(), rows["y_mm"].to_numpy()])
    begins = np.flatnonzero(
        np.diff(of_layer, prepend=0).astype(bool) | np.diff(ring, prepend=-1).astype(bool)
    )
    sizes = np.diff(np.append(begins, len(ring)))
    return stack_of_rings(heights, of_layer[begins] - 1, sizes, closed[begins] != 0, points)
