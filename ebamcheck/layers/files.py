"""Layers in files: the choice of a format by suffix, and Parquet written and read in blocks of layers.

A Parquet file has the columns of :mod:`ebamcheck.layers.batches`, one row per layer, and one row group per block
of layers that was written at once. A stack that does not fit in memory is written and read block by block.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ebamcheck.atomic_file import replacing
from ebamcheck.columns_file import NUMBERS, open_table, readable, starts_of
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers import common_layer_interface, contour_table, dxf, slices_3mf, svg, vtp
from ebamcheck.layers.batches import CONTOUR_COLUMNS, from_arrow, heights_of, layer_labels, to_arrow
from ebamcheck.layers.stack import Layers, concatenate
from ebamcheck.numeric.rings import Ints

# -- by suffix -------------------------------------------------------------------------------------


def write_layers(layers: Layers, path: str | Path) -> None:
    """Write layers in the format that the suffix names, one of :data:`FORMATS`.

    Raises
    ------
    SettingsError
        If the suffix is another one, or the file cannot be written.
    """
    format_of(path).write(layers, path)


def read_layers(path: str | Path) -> Layers:
    """Read layers in the format that the suffix names, one of :data:`FORMATS`.

    Parquet has the stack bit for bit; the other formats have its contours and heights, in the precision that the format's module
    states.

    Raises
    ------
    InputError
        If the file is missing or not what its suffix says.
    SettingsError
        If the suffix is another one.
    """
    layers = format_of(path).read(path)
    if not (np.isfinite(layers.points).all() and np.isfinite(layers.heights).all()):
        raise InputError(f"{path}: a coordinate or a height is not finite")
    return layers


def format_of(path: str | Path) -> LayerFormat:
    """Format that the suffix of a file names.

    Raises
    ------
    SettingsError
        If there is none of that suffix.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        raise SettingsError(
            f"{path}: no format of layers has the suffix {suffix!r}: use {', '.join(FORMATS)}"
        )
    return FORMATS[suffix]


# -- Parquet ---------------------------------------------------------------------------------------


def write_parquet(layers: Layers, path: str | Path) -> None:
    """Write layers as one Parquet table; the file appears whole or not at all.

    Raises
    ------
    SettingsError
        If the file cannot be written.
    """
    write_blocks([layers], path)


def write_blocks(blocks: Iterable[Layers], path: str | Path) -> int:
    """Write consecutive blocks of one stack to a Parquet file, which appears when the last one is written.

    Parameters
    ----------
    blocks
        At least one; all of one slicer, and all with cut edges or all without. While one is made, another thread writes
        the previous one, so two are in memory at a time.
    path
        The file.

    Returns
    -------
    int
        Number of layers written.

    Raises
    ------
    SettingsError
        If there is no block, the blocks differ in labels or columns, or the file cannot be written.
    """
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
                raise SettingsError(
                    f"{path}: block at layer {count + 1} differs from the first in labels or columns"
                )
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
    """Read layers from Parquet, every number bit for bit.

    Raises
    ------
    InputError
        If the file is missing, truncated, not Parquet, of another version, or lacks a column.
    """
    with LayerFile(path) as file:
        return file.read()


class LayerFile:
    """A stack of layers in a Parquet file; only the requested blocks are read.

    Parameters
    ----------
    path
        The file; held open until :meth:`close`.
    edges
        Whether to read the cut edges; contours alone are half the work.

    Raises
    ------
    InputError
        If the file is missing, truncated, not Parquet or of another version; also from every method, if
        a column is missing or its pages are damaged.
    """

    def __init__(self, path: str | Path, edges: bool = True) -> None:
        self.path = Path(path)
        self._columns = None if edges else CONTOUR_COLUMNS
        with readable(self.path):
            self._file = open_table(self.path)
        self._labels = layer_labels(self._file.schema_arrow, str(self.path))
        groups = self._file.metadata
        sizes = [groups.row_group(i).num_rows for i in range(groups.num_row_groups)]
        self._starts = starts_of(np.array(sizes, np.int64))

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __len__(self) -> int:
        """Return the number of layers."""
        return int(self._starts[-1])

    @property
    def borders(self) -> Ints:
        """First layer of each block that was written at once, and the number of layers."""
        return self._starts

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
        return heights_of(table, str(self.path))

    def read(self) -> Layers:
        """Read the whole stack."""
        return self.block(0, len(self))

    def block(self, start: int, stop: int) -> Layers:
        """Read layers ``start .. stop - 1``."""
        first = max(0, int(np.searchsorted(self._starts, start, side="right")) - 1)
        past = int(np.searchsorted(self._starts, stop, side="left"))
        with readable(self.path):
            table = self._file.read_row_groups(list(range(first, past)), columns=self._columns)
        blocks = [from_arrow(batch, str(self.path)) for batch in table.to_batches()]
        if not blocks:
            return from_arrow(table, str(self.path))
        joined = blocks[0] if len(blocks) == 1 else concatenate(blocks)
        begin = int(self._starts[first])
        return joined if len(joined) == stop - start else joined.block(start - begin, stop - begin)


class LayerFormat(NamedTuple):
    """How layers are written in a format, and read back."""

    write: Callable[[Layers, str | Path], None]
    read: Callable[[str | Path], Layers]


FORMATS: Mapping[str, LayerFormat] = {
    ".parquet": LayerFormat(write_parquet, read_parquet),
    ".cli": LayerFormat(common_layer_interface.write_cli, common_layer_interface.read_cli),
    ".svg": LayerFormat(svg.write_stack, svg.read_stack),
    ".dxf": LayerFormat(dxf.write_stack, dxf.read_stack),
    ".vtp": LayerFormat(vtp.write_stack, vtp.read_stack),
    ".3mf": LayerFormat(slices_3mf.write_stack, slices_3mf.read_stack),
    ".csv": LayerFormat(contour_table.write_stack, contour_table.read_stack),
}
"""Formats of layers, by suffix."""
