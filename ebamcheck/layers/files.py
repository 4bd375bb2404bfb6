"""Layers in files: one format a suffix, of which Parquet keeps every number bit for bit, in blocks, one row a layer."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ebamcheck.atomic_file import replacing
from ebamcheck.columns_file import (
    NUMBERS,
    Column,
    ReadTable,
    arrow_columns,
    labelled,
    labels_of,
    open_table,
    readable,
    starts_of,
)
from ebamcheck.errors import EbamcheckError, InputError, SettingsError
from ebamcheck.layers import contour_files, svg
from ebamcheck.layers.common_layer_interface import read_cli, write_cli
from ebamcheck.layers.stack import Layers, concatenate

Writer = Callable[[Layers, str | Path], None]
Reader = Callable[[str | Path], Layers]

VERSION = "1"  # version of the table; a reader refuses any other
LABELS = ("part", "direction", "backend", "settings")
# Arrow's lists count their items in 32 bits; a longer stack is written as several blocks
LARGEST_LIST = 2**31 - 1

_NUMBERS = pa.list_(pa.list_(pa.float64()))
_VERTICES = pa.list_(pa.list_(pa.int32()))
_POINTS = {"x": _NUMBERS, "y": _NUMBERS}
_EDGES = {"edge_low": _VERTICES, "edge_high": _VERTICES, "edge_t": _NUMBERS}
_PLAIN = {"height_mm": pa.float64(), "dropped": pa.int64(), "closed": pa.list_(pa.bool_())}
_KINDS = _PLAIN | _POINTS | _EDGES


def to_arrow(layers: Layers) -> pa.RecordBatch:
    """Layers as a record batch, one row per layer; edge parameters are not copied, and too many points are refused."""
    if len(layers.points) > LARGEST_LIST:
        raise SettingsError(
            f"{len(layers.points)} points are too many for one Arrow batch (limit {LARGEST_LIST}): "
            "write the stack in blocks of layers"
        )
    nested = (layers.layer_starts, layers.ring_starts)
    x, y = np.ascontiguousarray(layers.points.T)
    columns: dict[str, Column] = {
        "height_mm": (layers.heights,),
        "dropped": (layers.dropped,),
        "x": (x, *nested),
        "y": (y, *nested),
        "closed": (layers.closed, layers.layer_starts),
    }
    if layers.edge is not None and layers.edge_t is not None:
        low, high = np.ascontiguousarray(layers.edge.T)
        edges = {"edge_low": low, "edge_high": high, "edge_t": layers.edge_t}
        columns |= {name: (values, *nested) for name, values in edges.items()}
    metadata = labelled(layers, "layers", VERSION, LABELS)
    return pa.record_batch(arrow_columns(columns, _KINDS)).replace_schema_metadata(metadata)


def from_arrow(batch: pa.RecordBatch | pa.Table, where: str = "record batch") -> Layers:
    """Layers from a record batch, which may be a slice of a longer one, or a table; `where` is the source's name for messages."""
    labels = labels_of(batch.schema, "layers", VERSION, LABELS, where)
    table = ReadTable(batch, where)
    with_edges = any(name in batch.schema.names for name in _EDGES)
    differs = "column {name!r} does not have the rings and points of column {first!r}"
    columns, (layer_starts, ring_starts) = table.alike(_POINTS | (_EDGES if with_edges else {}), differs)
    points = np.empty((columns["x"].size, 2))
    points[:, 0], points[:, 1] = columns["x"], columns["y"]
    closed, (starts,) = table.nested("closed", _KINDS["closed"])
    if not np.array_equal(starts, layer_starts):
        raise InputError(f"{where}: column 'closed' does not have one entry for each ring of 'x'")
    heights = table.plain("height_mm", _KINDS["height_mm"])
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


def _check_finite(heights: NDArray[np.float64], points: NDArray[np.float64], where: str) -> None:
    layers, rows = np.flatnonzero(~np.isfinite(heights)), np.flatnonzero(~np.isfinite(points).all(axis=1))
    if layers.size:
        k = int(layers[0])
        raise InputError(f"{where}: height of layer {k + 1} is {heights[k]}: it must be finite")
    if rows.size:
        told = f"point {rows[0]} is {points[rows[0]].tolist()}: coordinates must be finite"
        raise InputError(f"{where}: {told}")


def write_layers(layers: Layers, path: str | Path) -> None:
    """Write layers in the format that the suffix names, one of :data:`FORMATS`."""
    write, _ = format_of(path)
    write(layers, path)


def read_layers(path: str | Path) -> Layers:
    """Read layers in the format that the suffix names, one of :data:`FORMATS`; Parquet alone has the stack bit for bit."""
    _, read = format_of(path)
    layers = read(path)
    _check_finite(layers.heights, layers.points, str(path))
    return layers


def format_of(path: str | Path) -> tuple[Writer, Reader]:
    """Format that the suffix of a file names."""
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        known = ", ".join(FORMATS)
        raise SettingsError(f"{path}: no format of layers has the suffix {suffix!r}: use {known}")
    return FORMATS[suffix]


def write_parquet(layers: Layers, path: str | Path) -> None:
    """Write layers as one Parquet table; the file appears whole or not at all."""
    write_blocks([layers], path)


def write_blocks(blocks: Iterable[Layers], path: str | Path) -> int:
    """Write blocks of one stack to a Parquet file, which appears when the last is written; returns the number of layers."""
    count = 0
    with replacing(path) as temporary, ExitStack() as opened:
        file: pq.ParquetWriter | None = None
        writing: Future[None] | None = None
        for block in blocks:
            batch = to_arrow(block)
            rows = len(block)
            del block  # the batch that is written has its own columns
            if file is None:
                file = opened.enter_context(pq.ParquetWriter(temporary, batch.schema, **NUMBERS))
                aside = opened.enter_context(ThreadPoolExecutor(1))
            elif not batch.schema.equals(file.schema, check_metadata=True):
                raise SettingsError(f"{path}: block at layer {count + 1} differs from the first in labels or columns")
            if writing is not None:
                writing.result()
            writing = aside.submit(file.write_batch, batch, max(1, rows))
            count += rows
            del batch
        if file is None or writing is None:
            raise SettingsError(f"{path}: no layers to write: give at least one block")
        writing.result()
    return count


def read_parquet(path: str | Path) -> Layers:
    """Read layers from Parquet, every number bit for bit."""
    with LayerFile(path) as file:
        return file.read()


class LayerFile:
    """An open Parquet file of layers, read in blocks, without `edges` the contours alone."""

    def __init__(self, path: str | Path, edges: bool = True) -> None:
        self.path = Path(path)
        self._columns = None if edges else [*_PLAIN, *_POINTS]
        with readable(self.path):
            self._file = open_table(self.path)
        self._labels = labels_of(self._file.schema_arrow, "layers", VERSION, LABELS, str(self.path))
        groups = self._file.metadata
        sizes = [groups.row_group(i).num_rows for i in range(groups.num_row_groups)]
        # First layer of each block that was written at once, and the number of layers.
        self.borders = starts_of(np.array(sizes, np.int64))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __len__(self) -> int:
        return int(self.borders[-1])

    @property
    def part(self) -> str:
        """Hash of the part."""
        return str(self._labels["part"])

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the slicer, and what it declared about this part."""
        return dict(self._labels["settings"])

    @cached_property
    def heights(self) -> NDArray[np.float64]:
        """Heights of all layers, (L,) mm."""
        with readable(self.path):
            table = self._file.read(columns=["height_mm"])
        return ReadTable(table, self.path).plain("height_mm", _KINDS["height_mm"])

    def read(self) -> Layers:
        """Read the whole stack."""
        return self.block(0, len(self))

    def block(self, start: int, stop: int) -> Layers:
        """Read layers ``start .. stop - 1``."""
        first = max(0, int(np.searchsorted(self.borders, start, side="right")) - 1)
        past = int(np.searchsorted(self.borders, stop, side="left"))
        with readable(self.path):
            table = self._file.read_row_groups(list(range(first, past)), columns=self._columns)
        blocks = [from_arrow(batch, str(self.path)) for batch in table.to_batches()]
        if not blocks:
            return from_arrow(table, str(self.path))
        joined = blocks[0] if len(blocks) == 1 else concatenate(blocks)
        begin = int(self.borders[first])
        return joined if len(joined) == stop - start else joined.block(start - begin, stop - begin)


# How layers are written, and read back, by suffix
FORMATS: Mapping[str, tuple[Writer, Reader]] = {
    ".parquet": (write_parquet, read_parquet),
    ".cli": (write_cli, read_cli),
    ".svg": (svg.write_stack, svg.read_stack),
    ".dxf": (contour_files.write_dxf, contour_files.read_dxf),
    ".vtp": (contour_files.write_vtp, contour_files.read_vtp),
    ".3mf": (contour_files.write_3mf, contour_files.read_3mf),
    ".csv": (contour_files.write_csv, contour_files.read_csv),
}


# Suffixes of the folder of one stack's blocks, and of the file of one block
SUFFIX, BLOCK = ".blocks", ".arrow"


class KeptBlocks:
    """Blocks of one stack, each in a file of its own beside that of the stack, so that a killed run need not cut them again.

    The format is Arrow's own, uncompressed: writing costs little more than a copy in memory. Of a slicer that cuts hardly slower
    than a block is written, only the first two are kept: the time of the first includes loading. `part` is the part's hash."""

    def __init__(self, file: Path, part: str, backend: str) -> None:
        self.folder = _folder_of(file)
        self._labels = (part, backend)
        self._write_s = 0.0

    def read(self, heights: NDArray[np.float64]) -> Layers | None:
        """Return the block at these heights (L,), mm; None if it is missing, damaged, or of another part or slicer."""
        path = self._path(heights)
        try:
            with pa.OSFile(str(path), "rb") as file, pa.ipc.open_file(file) as reader:
                layers = from_arrow(reader.get_batch(0), str(path))
        except (OSError, pa.ArrowException, InputError):
            return None
        fits = np.array_equal(layers.heights, heights) and (layers.part, layers.backend) == self._labels
        return layers if fits else None

    def is_worth(self, cut_s: float) -> bool:
        """Whether a block that took `cut_s` to cut is worth keeping: writing the last one took at most a fifth of that."""
        return cut_s >= 5.0 * self._write_s

    def write(self, layers: Layers) -> None:
        """Keep a block; if there is no room on the disk, do nothing: it can be cut again."""
        is_first = not self.folder.is_dir()
        start = time.perf_counter()
        batch = to_arrow(layers)
        with contextlib.suppress(OSError, EbamcheckError):
            self.folder.mkdir(exist_ok=True)
            with (
                replacing(self._path(layers.heights)) as temporary,
                pa.OSFile(str(temporary), "wb") as file,
                pa.ipc.new_file(file, batch.schema) as writer,
            ):
                writer.write_batch(batch)
        self._write_s = 0.0 if is_first else time.perf_counter() - start

    def remove(self) -> None:
        """Remove all blocks."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, heights: NDArray[np.float64]) -> Path:
        return self.folder / f"{float(heights[0]).hex()}{BLOCK}"


def count_kept(file: Path) -> int:
    """Number of blocks kept for the stack of a file."""
    return sum(1 for _ in _folder_of(file).glob(f"[!.]*{BLOCK}"))


def _folder_of(file: Path) -> Path:
    return file.with_name(f".{file.name}{SUFFIX}")


def kept_blocks(folder: Path) -> list[Path]:
    """Folders with kept blocks, in a folder of layers."""
    return list(folder.glob(f".*{SUFFIX}"))


def resumable(folder: Path) -> list[Path]:
    """Files from which a run can resume, in a folder of layers: whole stacks, and folders of kept blocks."""
    return [*folder.glob("[!.]*.parquet"), *kept_blocks(folder)]
