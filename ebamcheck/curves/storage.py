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

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ebamcheck.atomic_file import replacing
from ebamcheck.curves.columns import Curves
from ebamcheck.curves.splitting import ARC, LINE, SPLINE
from ebamcheck.errors import InputError
from ebamcheck.json_values import parsed_json
from ebamcheck.list_columns import flat_column, list_column, plain_column, starts_of
from ebamcheck.numeric.rings import Ints
from ebamcheck.regular_file import regular_file

VERSION = "1"
"""Version of the table; a reader refuses any other."""

VERSION_KEY = b"ebamcheck.curves.version"
LABELS_KEY = b"ebamcheck.curves.labels"
LABELS = ("method", "settings", "part", "direction", "backend")

LAYERS_A_ROW_GROUP = 1024

_LISTS = {
    "ring_pieces": pa.int64(),
    "ring_closed": pa.bool_(),
    "piece_kind": pa.uint8(),
    "piece_control": pa.int64(),
    "x": pa.float64(),
    "y": pa.float64(),
    "knot": pa.float64(),
}


def write(curves: Curves, path: Path) -> None:
    """Write curves as one Parquet table; the file appears whole or not at all.

    Raises
    ------
    SettingsError
        If the file cannot be written.
    """
    table = table_of(curves)
    with replacing(path) as temporary:
        # Coordinates hardly repeat: a dictionary would only cost time. Checksums find flipped bits.
        pq.write_table(
            table,
            temporary,
            compression="lz4",
            use_dictionary=False,
            write_statistics=False,
            write_page_checksum=True,
            row_group_size=LAYERS_A_ROW_GROUP,
        )


def table_of(curves: Curves) -> pa.Table:
    """Table of curves, one row a layer, as it is written."""
    of_layer = {"ring": curves.layer_starts}
    of_layer["piece"] = curves.ring_starts[of_layer["ring"]]
    of_layer["control"] = curves.control_starts[of_layer["piece"]]
    of_layer["knot"] = curves.knot_starts[of_layer["piece"]]
    columns = {
        "height_mm": pa.array(curves.heights),
        "ring_pieces": list_column(of_layer["ring"], np.diff(curves.ring_starts)),
        "ring_closed": list_column(of_layer["ring"], curves.closed),
        "piece_kind": list_column(of_layer["piece"], curves.kind),
        "piece_control": list_column(of_layer["piece"], np.diff(curves.control_starts)),
        "x": list_column(of_layer["control"], curves.control[:, 0]),
        "y": list_column(of_layer["control"], curves.control[:, 1]),
        "knot": list_column(of_layer["knot"], curves.knots),
    }
    labels = {name: getattr(curves, name) for name in LABELS} | {"settings": dict(curves.settings)}
    metadata = {VERSION_KEY: VERSION.encode(), LABELS_KEY: json.dumps(labels, sort_keys=True).encode()}
    return pa.table(columns).replace_schema_metadata(metadata)


def read(path: Path) -> Curves:
    """Read curves, every number in the bits it was written with.

    Raises
    ------
    InputError
        If the file is missing, damaged, not Parquet, of another version, or its columns do not match.
    """
    try:
        table = pq.read_table(regular_file(path), page_checksum_verification=True, partitioning=None)
    except (OSError, pa.ArrowException) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: cannot be read as Parquet: {reason}") from None
    labels = _labels(table.schema, path)
    heights = plain_column(table, "height_mm", pa.float64(), path).to_numpy().astype(np.float64)
    found = {name: flat_column(table, name, kind, path) for name, kind in _LISTS.items()}
    values = {name: column for name, (column, _) in found.items()}
    curved = values["piece_kind"] == SPLINE
    curves = Curves(
        heights=heights,
        layer_starts=found["ring_closed"][1],
        ring_starts=starts_of(values["ring_pieces"]),
        closed=values["ring_closed"],
        kind=values["piece_kind"],
        control_starts=starts_of(values["piece_control"]),
        control=np.column_stack([values["x"], values["y"]])
        if values["x"].size == values["y"].size
        else np.zeros((0, 2)),
        knot_starts=starts_of(np.where(curved, values["piece_control"] + 4, 0)),
        knots=values["knot"],
        **labels,
    )
    _check(curves, {name: starts for name, (_, starts) in found.items()}, path)
    return curves


def _labels(schema: pa.Schema, path: Path) -> dict[str, Any]:
    metadata = schema.metadata or {}
    version = metadata.get(VERSION_KEY, b"").decode("utf-8", "replace")
    if version != VERSION:
        said = f"version {version[:40]!r}" if version else "no version"
        raise InputError(
            f"{path}: has {said} under {VERSION_KEY.decode()!r}: this program reads curves of version {VERSION!r}"
        )
    try:
        values = parsed_json(metadata[LABELS_KEY])
        labels = {name: values[name] for name in LABELS}
        labels["direction"] = tuple(float(v) for v in labels["direction"])
        labels["settings"] = dict(labels["settings"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: its labels cannot be read: {type(error).__name__}: {error}") from None
    return labels


def _check(curves: Curves, starts: dict[str, Ints], path: Path) -> None:
    """Refuse columns that contradict each other, before they are used as indices."""
    sizes = np.diff(curves.control_starts)
    known = np.isin(curves.kind, (LINE, SPLINE, ARC))
    if not known.all():
        raise InputError(f"{path}: piece kind {int(curves.kind[~known][0])} is unknown: 0, 1 and 2 are")
    if (np.diff(curves.ring_starts) < 0).any() or (sizes < np.array([2, 4, 3])[curves.kind]).any():
        raise InputError(f"{path}: a piece has too few control points: 2 for a line, 4 for a spline")
    matching = (
        np.array_equal(starts["ring_pieces"], starts["ring_closed"])
        and np.array_equal(starts["piece_kind"], starts["piece_control"])
        and np.array_equal(starts["x"], starts["y"])
        and curves.ring_starts[-1] == curves.kind.size
        and curves.control_starts[-1] == len(curves.control)
        and curves.knot_starts[-1] == curves.knots.size
    )
    layers = curves.layer_starts
    if not matching or not (
        np.array_equal(curves.ring_starts[layers], starts["piece_kind"])
        and np.array_equal(curves.control_starts[starts["piece_kind"]], starts["x"])
        and np.array_equal(curves.knot_starts[starts["piece_kind"]], starts["knot"])
    ):
        raise InputError(f"{path}: its columns do not have the same rings and pieces in every layer")
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
