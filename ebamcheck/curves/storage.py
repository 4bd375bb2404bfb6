"""Curves in Parquet files, one row a layer.

==================  ================  ==========================================================
column              type              meaning
==================  ================  ==========================================================
``height_mm``       double            absolute z of the layer
``ring_pieces``     list<int64>       pieces of each ring
``ring_closed``     list<bool>        false for an open path
``piece_kind``      list<uint8>       0 polyline, 1 cubic B-spline, 2 arc by three points
``piece_control``   list<int64>       control points of each piece
``x``, ``y``        list<double>      control points of all pieces, mm
``knot``            list<double>      knots of all splines, mm: four more than control points
==================  ================  ==========================================================

The schema's metadata hold ``ebamcheck.curves.version`` and ``ebamcheck.curves.labels`` (JSON: method,
settings, part, direction, backend). Every number comes back in the same bits.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from ebamcheck.columns_file import (
    Column,
    ReadTable,
    arrow_columns,
    labelled,
    labels_of,
    open_table,
    readable,
    starts_of,
    write_table,
)
from ebamcheck.curves.columns import Curves
from ebamcheck.curves.splitting import ARC, LINE, SPLINE
from ebamcheck.errors import InputError
from ebamcheck.numeric.rings import Ints

VERSION = "1"
"""Version of the table; a reader refuses any other."""

LABELS = ("method", "settings", "part", "direction", "backend")

LAYERS_A_ROW_GROUP = 1024

_OF_RING = {"ring_pieces": pa.large_list(pa.int64()), "ring_closed": pa.large_list(pa.bool_())}
_OF_PIECE = {"piece_kind": pa.large_list(pa.uint8()), "piece_control": pa.large_list(pa.int64())}
_OF_CONTROL = {"x": pa.large_list(pa.float64()), "y": pa.large_list(pa.float64())}
_OF_KNOT = {"knot": pa.large_list(pa.float64())}
_KINDS = {"height_mm": pa.float64(), **_OF_RING, **_OF_PIECE, **_OF_CONTROL, **_OF_KNOT}
_UNLIKE = "its columns do not have the same rings and pieces in every layer"


def write(curves: Curves, path: Path) -> None:
    """Write curves as one Parquet table; the file appears whole or not at all.

    Raises
    ------
    SettingsError
        If the file cannot be written.
    """
    write_table(table_of(curves), path, row_group_size=LAYERS_A_ROW_GROUP)


def table_of(curves: Curves) -> pa.Table:
    """Table of curves, one row a layer, as it is written."""
    rings = curves.layer_starts
    pieces = curves.ring_starts[rings]
    control, knots = curves.control_starts[pieces], curves.knot_starts[pieces]
    columns: dict[str, Column] = {
        "height_mm": (curves.heights,),
        "ring_pieces": (np.diff(curves.ring_starts), rings),
        "ring_closed": (curves.closed, rings),
        "piece_kind": (curves.kind, pieces),
        "piece_control": (np.diff(curves.control_starts), pieces),
        "x": (curves.control[:, 0], control),
        "y": (curves.control[:, 1], control),
        "knot": (curves.knots, knots),
    }
    table = pa.table(arrow_columns(columns, _KINDS))
    return table.replace_schema_metadata(labelled(curves, "curves", VERSION, LABELS))


def read(path: Path) -> Curves:
    """Read curves, every number in the bits it was written with.

    Raises
    ------
    InputError
        If the file is missing, damaged, not Parquet, of another version, or its columns do not match.
    """
    with readable(path), open_table(path) as file:
        table = ReadTable(file.read(), path)
    labels = labels_of(table.table.schema, "curves", VERSION, LABELS, str(path))
    heights = table.plain("height_mm", _KINDS["height_mm"])
    ring, (layer_starts,) = table.alike(_OF_RING, _UNLIKE)
    piece, (pieces,) = table.alike(_OF_PIECE, _UNLIKE)
    control, (controls,) = table.alike(_OF_CONTROL, _UNLIKE)
    knot, (knots,) = table.alike(_OF_KNOT)
    curves = Curves(
        heights=heights,
        layer_starts=layer_starts,
        ring_starts=starts_of(ring["ring_pieces"]),
        closed=ring["ring_closed"],
        kind=piece["piece_kind"].copy(),
        control_starts=starts_of(piece["piece_control"]),
        control=np.column_stack([control["x"], control["y"]]),
        knot_starts=starts_of(np.where(piece["piece_kind"] == SPLINE, piece["piece_control"] + 4, 0)),
        knots=knot["knot"].copy(),
        **labels,
    )
    _check(curves, pieces, controls, knots, path)
    return curves


def _check(curves: Curves, pieces: Ints, controls: Ints, knots: Ints, path: Path) -> None:
    """Refuse columns that contradict each other, before they are used as indices; (L + 1,) starts of each layer in each level."""
    known = np.isin(curves.kind, (LINE, SPLINE, ARC))
    if not known.all():
        raise InputError(f"{path}: piece kind {int(curves.kind[~known][0])} is unknown: 0, 1 and 2 are")
    sizes = np.diff(curves.control_starts)
    if (np.diff(curves.ring_starts) < 0).any() or (sizes < np.array([2, 4, 3])[curves.kind]).any():
        raise InputError(f"{path}: a piece has too few control points: 2 for a line, 4 for a spline")
    whole = (
        curves.ring_starts[-1] == curves.kind.size
        and curves.control_starts[-1] == len(curves.control)
        and curves.knot_starts[-1] == curves.knots.size
    )
    if not whole or not (
        np.array_equal(curves.ring_starts[curves.layer_starts], pieces)
        and np.array_equal(curves.control_starts[pieces], controls)
        and np.array_equal(curves.knot_starts[pieces], knots)
    ):
        raise InputError(f"{path}: {_UNLIKE}")
    if not (
        np.isfinite(curves.control).all()
        and np.isfinite(curves.knots).all()
        and np.isfinite(curves.heights).all()
    ):
        raise InputError(f"{path}: holds a number that is not finite")
    inner = np.ones(max(curves.knots.size - 1, 0), dtype=bool)
    inner[
        curves.knot_starts[1:-1][
            (curves.knot_starts[1:-1] > 0) & (curves.knot_starts[1:-1] < curves.knots.size)
        ]
        - 1
    ] = False
    if (np.diff(curves.knots)[inner] < 0).any():
        raise InputError(f"{path}: the knots of a spline decrease")
