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
import pyarrow.parquet as pq
import shapely
from numpy.typing import NDArray

from ebamcheck.atomic_file import COMPRESSION, replacing
from ebamcheck.errors import InputError
from ebamcheck.json_values import parsed_json
from ebamcheck.list_columns import flat_column, list_column, plain_column, starts_of
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.regular_file import regular_file
from ebamcheck.scan.plan.columns import METRICS, VECTOR_COLUMNS, PlanOfLayers, ScanPlan

NAME, VERSION = "ebamcheck scan plan", 3
"""What the metadata tell of the file; a reader refuses any other version."""

HEADER_KEY = b"ebamcheck"
LINE_COLUMNS = VECTOR_COLUMNS[1:]

_OF_LAYER = ("height_mm", "section", "metrics")
_OF_ISLAND = {
    "island_rank": pa.int64(),
    "island_kind": pa.string(),
    "island_polygon": pa.large_binary(),
    "island_area_mm2": pa.float64(),
    "island_x_mm": pa.float64(),
    "island_y_mm": pa.float64(),
    "island_wait_s": pa.float64(),
    "island_inner_wait_s": pa.float64(),
    "island_lines": pa.int64(),
}
_OF_LINE = dict.fromkeys(LINE_COLUMNS, pa.float64())
_OF_BORDER = {"border_first": pa.int64(), "border_second": pa.int64(), "border_mm": pa.float64()}


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
    with replacing(path) as temporary:
        # Coordinates hardly repeat, so a dictionary would only cost time; checksums find flipped bits.
        pq.write_table(
            table,
            temporary,
            version="2.6",
            compression=COMPRESSION,
            use_dictionary=["island_kind.list.element"],
            write_statistics=False,
            write_page_checksum=True,
        )


def read(path: Path) -> ScanPlan:
    """Read a plan, every number in the bits it was written with.

    Raises
    ------
    InputError
        If the file is missing, damaged, not Parquet, no plan or one of another version, or its columns do not match.
    """
    table, settings = _table(path, None)
    layers = _layers(table, path)
    islands, starts = _flat_columns(table, _OF_ISLAND, path)
    island_layer = np.repeat(np.arange(table.num_rows), np.diff(starts)).astype(np.int64)
    rank = _ranks(islands["island_rank"], starts, island_layer, path)
    neighbours, border_mm = _borders(table, starts, path)
    return ScanPlan(
        heights=layers.heights,
        contours=_regions(plain_column(table, "contour", pa.large_binary(), path).to_pylist(), path),
        islands=_regions(islands["island_polygon"], path),
        island_layer=island_layer,
        island_kind=np.asarray(islands["island_kind"].tolist(), np.str_),
        island_area_mm2=islands["island_area_mm2"],
        island_centroid=np.column_stack([islands["island_x_mm"], islands["island_y_mm"]]),
        neighbours=neighbours,
        border_mm=border_mm,
        order=np.argsort(rank, kind="stable").astype(np.int64),
        vectors=_vectors(table, islands["island_lines"], starts, rank, path),
        metrics=layers.metrics,
        settings=settings,
        island_wait_s=islands["island_wait_s"],
        inner_wait_s=islands["island_inner_wait_s"],
        sections=layers.sections,
    )


def read_layers(path: Path) -> PlanOfLayers:
    """Read what a plan knows of its layers, and nothing else of the file; raises as :func:`read`."""
    table, _ = _table(path, _OF_LAYER)
    return _layers(table, path)


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
    columns |= {f"island_{name}": list_column(starts, values) for name, values in of_island.items()}
    for name in LINE_COLUMNS:
        columns[name] = list_column(line_starts, plan.vectors[name].to_numpy()[by_island])
    columns["border_first"] = list_column(pair_starts, pairs[:, 0])
    columns["border_second"] = list_column(pair_starts, pairs[:, 1])
    columns["border_mm"] = list_column(pair_starts, plan.border_mm)
    return columns


def _well_known(regions: NDArray[np.object_]) -> pa.LargeBinaryArray:
    """Regions in well-known binary."""
    return pa.array(list(shapely.to_wkb(regions)), pa.large_binary())


# -- columns of a table ------------------------------------------------------------------------------


def _table(path: Path, names: Sequence[str] | None) -> tuple[pa.Table, dict[str, Any]]:
    """Columns of a file, all of them or those of `names` that it has, and the plan's settings."""
    try:
        with pq.ParquetFile(regular_file(path), page_checksum_verification=True) as file:
            settings = _settings(path, file.schema_arrow.metadata or {})
            there = [name for name in file.schema_arrow.names if names is None or name in names]
            return file.read(there), settings
    except (OSError, pa.ArrowException) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: cannot be read as a scan plan: {reason}") from None


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


def _layers(table: pa.Table, path: Path) -> PlanOfLayers:
    """What a plan knows of its layers."""
    sections = None
    if "section" in table.schema.names:
        sections = _regions(plain_column(table, "section", pa.large_binary(), path).to_pylist(), path)
    heights = plain_column(table, "height_mm", pa.float64(), path).to_numpy(zero_copy_only=False)
    return PlanOfLayers(heights.astype(np.float64), _metrics(table, path), sections)


def _metrics(table: pa.Table, path: Path) -> pd.DataFrame:
    """Figures of the layers: those of :data:`METRICS`, then what a plan has beside them."""
    fields: dict[str, pa.Array] = {}
    if "metrics" in table.schema.names and pa.types.is_struct(table.schema.field("metrics").type):
        found = table.column("metrics").combine_chunks()
        fields = {field.name: found.field(field.name) for field in found.type}
    if missing := [name for name in METRICS if name not in fields]:
        raise InputError(f"{path}: its metrics lack {', '.join(missing)}")
    columns = {name: values.to_numpy(zero_copy_only=False) for name, values in fields.items()}
    return pd.DataFrame(columns, columns=[*METRICS, *(name for name in fields if name not in METRICS)])


def _flat_columns(
    table: pa.Table, kinds: Mapping[str, pa.DataType], path: Path
) -> tuple[dict[str, NDArray[Any]], Ints]:
    """Flat values of list columns whose lists are equally long in every row, and where each list starts."""
    found = {name: flat_column(table, name, kind, path) for name, kind in kinds.items()}
    (first, (_, starts)), *others = found.items()
    for name, (_, its) in others:
        if not np.array_equal(its, starts):
            raise InputError(f"{path}: columns {first!r} and {name!r} differ in length in a layer")
    return {name: values for name, (values, _) in found.items()}, starts


def _ranks(of_layer: Ints, starts: Ints, island_layer: Ints, path: Path) -> Ints:
    """Place of each island in the order of the stack, from those within its layer."""
    rank = starts[island_layer] + of_layer
    sizes = np.diff(starts)[island_layer]
    if ((of_layer < 0) | (of_layer >= sizes)).any() or np.bincount(rank, minlength=rank.size).max(
        initial=0
    ) > 1:
        raise InputError(f"{path}: the ranks of the islands of a layer are not those from 0 on, each once")
    return rank


def _vectors(table: pa.Table, lines: Ints, starts: Ints, rank: Ints, path: Path) -> pd.DataFrame:
    """Lines in scan order."""
    found, line_starts = _flat_columns(table, _OF_LINE, path)
    if (lines < 0).any() or not np.array_equal(starts_of(lines)[starts], line_starts):
        raise InputError(f"{path}: a layer has other lines than its islands")
    island = np.repeat(np.arange(rank.size), lines).astype(np.int64)
    scanned = np.argsort(rank[island], kind="stable")
    return pd.DataFrame({"island": island[scanned], **{n: found[n][scanned] for n in LINE_COLUMNS}})


def _borders(table: pa.Table, starts: Ints, path: Path) -> tuple[Ints, Floats]:
    """(P, 2) pairs of islands with a common border, and its length."""
    found, pair_starts = _flat_columns(table, _OF_BORDER, path)
    layer = np.repeat(np.arange(table.num_rows), np.diff(pair_starts))
    pairs = np.column_stack([found["border_first"], found["border_second"]])
    if ((pairs < 0) | (pairs >= np.diff(starts)[layer][:, None])).any():
        raise InputError(f"{path}: a common border is one of islands that its layer does not have")
    return pairs + starts[layer][:, None], found["border_mm"]


def _regions(well_known: Sequence[bytes] | NDArray[np.object_], path: Path) -> NDArray[np.object_]:
    """Regions of well-known binary."""
    found = np.empty(len(well_known), object)
    try:
        found[:] = shapely.from_wkb(np.asarray(well_known, object))
    except (shapely.errors.ShapelyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: holds a region that cannot be read: {error}") from None
    return found
