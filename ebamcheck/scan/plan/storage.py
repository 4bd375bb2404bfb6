"""Scan plans in Parquet files, one row a layer.

=============================  ==============  ========================================================
column                         type            meaning
=============================  ==============  ========================================================
``height_mm``                  double          absolute z of the layer
``contour``, ``section``       binary          regions of the contour beads, and those that are to be
                                               metal, in well-known binary; ``section`` may be missing
``metrics``                    struct          figures of the layer, as ``scan.csv`` has them
``island_rank``                list<int64>     place of each island in the layer's order, from 0
``island_kind``                list<string>    hexagon, square, stripe, whole, thin wall or gap
``island_polygon``             list<binary>    well-known binary
``island_area_mm2``            list<double>    area
``island_x_mm``, ``_y_mm``     list<double>    centroid
``island_wait_s``              list<double>    wait before it
``island_inner_wait_s``        list<double>    wait before each further bead of it
``island_lines``               list<int64>     lines of each island
``x0``, ``y0``, ``x1``, ``y1`` list<double>    ends of all lines, island by island, each in its sequence
``angle``                      list<double>    directions of travel, degrees counter-clockwise from +X
``border_first``, ``_second``  list<int64>     pairs of islands of the layer that have a common border
``border_mm``                  list<double>    its length
=============================  ==============  ========================================================

The schema's metadata hold ``ebamcheck`` (JSON: format, settings). Every number comes back in the same bits.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import shapely
from numpy.typing import NDArray

from ebamcheck.columns_file import (
    Column,
    ReadTable,
    arrow_columns,
    open_table,
    readable,
    starts_of,
    write_table,
)
from ebamcheck.errors import InputError
from ebamcheck.json_values import parsed_json
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.plan.columns import METRICS, VECTOR_COLUMNS, PlanOfLayers, ScanPlan

NAME, VERSION = "ebamcheck scan plan", 3
"""What the metadata tell of the file; a reader refuses any other version."""

HEADER_KEY = b"ebamcheck"
LINE_COLUMNS = VECTOR_COLUMNS[1:]

_OF_LAYER = ("height_mm", "section", "metrics")
_NUMBER, _NUMBERS, _COUNTS = pa.float64(), pa.large_list(pa.float64()), pa.large_list(pa.int64())
_REGION = pa.large_binary()
_OF_ISLAND = {
    "island_rank": _COUNTS,
    "island_kind": pa.large_list(pa.string()),
    "island_polygon": pa.large_list(_REGION),
    "island_area_mm2": _NUMBERS,
    "island_x_mm": _NUMBERS,
    "island_y_mm": _NUMBERS,
    "island_wait_s": _NUMBERS,
    "island_inner_wait_s": _NUMBERS,
    "island_lines": _COUNTS,
}
_OF_LINE = dict.fromkeys(LINE_COLUMNS, _NUMBERS)
_OF_BORDER = {"border_first": _COUNTS, "border_second": _COUNTS, "border_mm": _NUMBERS}
_LISTS = {**_OF_ISLAND, **_OF_LINE, **_OF_BORDER}


def write(plan: ScanPlan, path: Path) -> None:
    """Write a plan as one Parquet table; the file appears whole or not at all.

    Raises
    ------
    SettingsError
        If the file cannot be written.
    """
    header = {"format": f"{NAME} {VERSION}", "settings": plan.settings}
    table = pa.table(_columns(plan)).replace_schema_metadata(
        {HEADER_KEY: json.dumps(header, sort_keys=True).encode()}
    )
    write_table(table, path, use_dictionary=["island_kind.list.element"])


def read(path: Path) -> ScanPlan:
    """Read a plan, every number in the bits it was written with.

    Raises
    ------
    InputError
        If the file is missing, damaged, not Parquet, no plan or one of another version, or its columns do not match.
    """
    table, settings = _table(path, None)
    layers = _layers(table)
    islands, (starts,) = table.alike(_OF_ISLAND)
    island_layer = np.repeat(np.arange(len(layers.heights)), np.diff(starts)).astype(np.int64)
    rank = _ranks(islands["island_rank"], starts, island_layer, path)
    neighbours, border_mm = _borders(table, starts)
    return ScanPlan(
        heights=layers.heights,
        contours=_regions(table.plain("contour", _REGION), path),
        islands=_regions(islands["island_polygon"], path),
        island_layer=island_layer,
        island_kind=np.asarray(islands["island_kind"].tolist(), np.str_),
        island_area_mm2=islands["island_area_mm2"].copy(),
        island_centroid=np.column_stack([islands["island_x_mm"], islands["island_y_mm"]]),
        neighbours=neighbours,
        border_mm=border_mm,
        order=np.argsort(rank, kind="stable").astype(np.int64),
        vectors=_vectors(table, islands["island_lines"], starts, rank),
        metrics=layers.metrics,
        settings=settings,
        island_wait_s=islands["island_wait_s"].copy(),
        inner_wait_s=islands["island_inner_wait_s"].copy(),
        sections=layers.sections,
    )


def read_layers(path: Path) -> PlanOfLayers:
    """Read what a plan knows of its layers, and nothing else of the file; raises as :func:`read`."""
    table, _ = _table(path, _OF_LAYER)
    return _layers(table)


# -- columns of a plan -------------------------------------------------------------------------------


def _columns(plan: ScanPlan) -> dict[str, pa.Array]:
    """Columns of the table, by name."""
    count = len(plan.islands)
    starts = np.searchsorted(plan.island_layer, np.arange(len(plan) + 1)).astype(np.int64)
    rank = np.empty(count, np.int64)
    rank[plan.order] = np.arange(count)
    # Lines are in scan order; sorted by island (stably) they keep their sequence within it.
    island = plan.vectors["island"].to_numpy()
    by_island = np.argsort(island, kind="stable")
    lines = np.bincount(island, minlength=count)
    line_starts = starts_of(lines)[starts]
    pair_layer = plan.island_layer[plan.neighbours[:, 0]]
    pair_starts = np.searchsorted(pair_layer, np.arange(len(plan) + 1)).astype(np.int64)
    pairs = plan.neighbours - starts[pair_layer][:, None]
    of_island = {
        "rank": rank - starts[plan.island_layer],
        "kind": pa.array(plan.island_kind.tolist(), pa.string()),
        "polygon": _well_known(plan.islands),
        "area_mm2": plan.island_area_mm2,
        "x_mm": plan.island_centroid[:, 0],
        "y_mm": plan.island_centroid[:, 1],
        "wait_s": plan.island_wait_s if len(plan.island_wait_s) else np.zeros(count),
        "inner_wait_s": plan.inner_wait_s if len(plan.inner_wait_s) else np.zeros(count),
        "lines": lines,
    }
    metrics = {name: pa.array(plan.metrics[name].to_numpy()) for name in plan.metrics.columns}
    columns = {
        "height_mm": pa.array(plan.heights),
        "contour": _well_known(plan.contours),
        "metrics": pa.StructArray.from_arrays(list(metrics.values()), list(metrics)),
    }
    if plan.sections is not None:
        columns["section"] = _well_known(plan.sections)
    lists: dict[str, Column] = {f"island_{name}": (values, starts) for name, values in of_island.items()}
    lists |= {name: (plan.vectors[name].to_numpy()[by_island], line_starts) for name in LINE_COLUMNS}
    borders = (pairs[:, 0], pairs[:, 1], plan.border_mm)
    lists |= {name: (values, pair_starts) for name, values in zip(_OF_BORDER, borders, strict=True)}
    return columns | arrow_columns(lists, _LISTS)


def _well_known(regions: NDArray[np.object_]) -> pa.LargeBinaryArray:
    """Regions in well-known binary."""
    return pa.array(list(shapely.to_wkb(regions)), pa.large_binary())


# -- columns of a table ------------------------------------------------------------------------------


def _table(path: Path, names: Sequence[str] | None) -> tuple[ReadTable, dict[str, Any]]:
    """Columns of a file, all of them or those of `names` that it has, and the plan's settings."""
    with readable(path, "a scan plan"), open_table(path) as file:
        settings = _settings(path, file.schema_arrow.metadata or {})
        there = [name for name in file.schema_arrow.names if names is None or name in names]
        return ReadTable(file.read(there), path), settings


def _settings(path: Path, metadata: Mapping[bytes, bytes]) -> dict[str, Any]:
    """Settings that stand in the metadata of a plan; refuses what is none, or of another version."""
    try:
        header = parsed_json(metadata.get(HEADER_KEY, b"{}"))
        said, settings = str(header.get("format", "")), dict(header.get("settings", {}))
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is not a scan plan: its header cannot be read: {error}") from None
    if said == f"{NAME} {VERSION}":
        return settings
    if re.fullmatch(rf"{NAME} \d{{1,9}}", said):
        version = int(said.removeprefix(NAME))
        age = "an earlier" if version < VERSION else "a later"
        raise InputError(
            f"{path}: is a scan plan of format {version}, of {age} version of this program, which reads format {VERSION}: "
            "make the plan, or the run that it belongs to, again"
        )
    raise InputError(f"{path}: is not a scan plan (format {said[:40]!r}, expected '{NAME} {VERSION}')")


def _layers(table: ReadTable) -> PlanOfLayers:
    """What a plan knows of its layers."""
    sections = None
    if "section" in table.table.schema.names:
        sections = _regions(table.plain("section", _REGION), table.where)
    return PlanOfLayers(table.plain("height_mm", _NUMBER), _metrics(table), sections)


def _metrics(found: ReadTable) -> pd.DataFrame:
    """Figures of the layers: those of :data:`METRICS`, then what a plan has beside them."""
    table = found.table
    fields: dict[str, pa.Array] = {}
    if "metrics" in table.schema.names and pa.types.is_struct(table.schema.field("metrics").type):
        metrics = table.column("metrics").combine_chunks()
        fields = {field.name: metrics.field(field.name) for field in metrics.type}
    if missing := [name for name in METRICS if name not in fields]:
        raise InputError(f"{found.where}: its metrics lack {', '.join(missing)}")
    columns = {name: values.to_numpy(zero_copy_only=False) for name, values in fields.items()}
    return pd.DataFrame(columns, columns=[*METRICS, *(name for name in fields if name not in METRICS)])


def _ranks(of_layer: Ints, starts: Ints, island_layer: Ints, path: Path) -> Ints:
    """Place of each island in the order of the stack, from those within its layer."""
    rank = starts[island_layer] + of_layer
    sizes = np.diff(starts)[island_layer]
    if ((of_layer < 0) | (of_layer >= sizes)).any() or np.bincount(rank, minlength=rank.size).max(
        initial=0
    ) > 1:
        raise InputError(f"{path}: the ranks of the islands of a layer are not those from 0 on, each once")
    return rank


def _vectors(table: ReadTable, lines: Ints, starts: Ints, rank: Ints) -> pd.DataFrame:
    """Lines in scan order."""
    found, (line_starts,) = table.alike(_OF_LINE)
    if (lines < 0).any() or not np.array_equal(starts_of(lines)[starts], line_starts):
        raise InputError(f"{table.where}: a layer has other lines than its islands")
    island = np.repeat(np.arange(rank.size), lines).astype(np.int64)
    scanned = np.argsort(rank[island], kind="stable")
    return pd.DataFrame({"island": island[scanned], **{n: found[n][scanned] for n in LINE_COLUMNS}})


def _borders(table: ReadTable, starts: Ints) -> tuple[Ints, Floats]:
    """(P, 2) pairs of islands with a common border, and its length."""
    found, (pair_starts,) = table.alike(_OF_BORDER)
    layer = np.repeat(np.arange(len(pair_starts) - 1), np.diff(pair_starts))
    pairs = np.column_stack([found["border_first"], found["border_second"]])
    if ((pairs < 0) | (pairs >= np.diff(starts)[layer][:, None])).any():
        raise InputError(f"{table.where}: a common border is one of islands that its layer does not have")
    return pairs + starts[layer][:, None], found["border_mm"].copy()


def _regions(well_known: NDArray[np.object_], path: str | Path) -> NDArray[np.object_]:
    """Regions of well-known binary."""
    found = np.empty(len(well_known), object)
    try:
        found[:] = shapely.from_wkb(well_known)
    except (shapely.errors.ShapelyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: holds a region that cannot be read: {error}") from None
    return found
