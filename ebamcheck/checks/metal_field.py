"""The metal of one layer as a field of cells, and its file in a run folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from ebamcheck.columns_file import open_table, write_table
from ebamcheck.errors import InputError
from ebamcheck.json_values import parsed_json
from ebamcheck.metal import Target
from ebamcheck.numeric.rings import Floats

FIELD_FILE = "deposit_worst.parquet"
"""Name of the field of the worst layer in a run folder."""

FORMAT = 1


@dataclass(frozen=True, eq=False)
class LayerField:
    """The metal of one layer in the cells of its target, (rows, columns).

    Parameters
    ----------
    target
        Cells, and the share of each that lies in the section.
    laid_mm
        Height of the metal that the layer lays.
    over_mm
        Height of the surface over that of the layer when it is done; 0 without metal.
    """

    target: Target
    laid_mm: Floats
    over_mm: Floats


def write_field(table: pa.Table, path: Path) -> None:
    """Write the table of a field."""
    # Many cells are alike, and a field is looked at, not computed with.
    write_table(table, path, use_dictionary=True, write_statistics=True, write_page_checksum=False)


def field_table(field: LayerField, layer: int, thickness_mm: float) -> pa.Table:
    """Table of the field of a layer, one row a cell, in single precision."""
    header = {
        "format": FORMAT,
        "layer": layer,
        "thickness_mm": thickness_mm,
        "shape": field.laid_mm.shape,
        "origin_mm": field.target.origin.tolist(),
        "step_mm": field.target.step_mm,
    }
    columns = {"share": field.target.share, "laid_mm": field.laid_mm, "over_mm": field.over_mm}
    table = pa.table({name: pa.array(cells.ravel().astype(np.float32)) for name, cells in columns.items()})
    return table.replace_schema_metadata({"ebamcheck": json.dumps(header, sort_keys=True)})


def read_field(path: Path) -> tuple[LayerField, int, float]:
    """Field, layer and the height that the layer is to have, mm.

    Raises
    ------
    InputError
        If the file is none that :func:`write_field` wrote.
    """
    try:
        with open_table(path) as file:
            table = file.read()
        header = parsed_json((table.schema.metadata or {})[b"ebamcheck"])
        shape = tuple(header["shape"])
        share, laid, over = (
            table.column(name).to_numpy().astype(np.float64).reshape(shape)
            for name in ("share", "laid_mm", "over_mm")
        )
        target = Target(np.array(header["origin_mm"]), float(header["step_mm"]), share)
        return LayerField(target, laid, over), int(header["layer"]), float(header["thickness_mm"])
    except (OSError, pa.ArrowException, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: is no field of metal: {error}; run the part again") from error
