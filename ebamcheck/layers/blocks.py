"""Blocks of layers that are kept while a slicer runs, so that a killed run need not cut them again.

Each is a file of its own beside the file that is being written, and appears whole or not at all. The format is Arrow's own,
uncompressed: writing costs little more than a copy in memory, and numbers are restored bit for bit. Of a slicer that cuts
hardly slower than a block is written, only the first two blocks are kept: the time of the first includes loading.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import EbamcheckError, InputError
from ebamcheck.layers.batches import from_arrow, to_arrow
from ebamcheck.layers.stack import Layers

SUFFIX, BLOCK = ".blocks", ".arrow"
"""Suffixes of the folder of one stack's blocks, and of the file of one block."""

WORTH = 5.0
"""Least ratio of the time to cut a block to that to write it for it to be kept: keeping costs at most a fifth of the slicing."""


class KeptBlocks:
    """Blocks of one stack, in a folder beside its file.

    Parameters
    ----------
    file
        File to which the whole stack will be written.
    part
        Hash of the part.
    backend
        Name of the slicer.
    """

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
        """Whether a block that took `cut_s` to cut is worth keeping, given how long the last one took to write."""
        return cut_s >= WORTH * self._write_s

    def write(self, layers: Layers) -> None:
        """Keep a block; if there is no room on the disk, do nothing: it can be cut again."""
        is_first = not self.folder.is_dir()
        start = time.perf_counter()
        batch = to_arrow(layers)
        with contextlib.suppress(OSError, EbamcheckError):
            self.folder.mkdir(exist_ok=True)
            self._write(layers, batch)
        self._write_s = 0.0 if is_first else time.perf_counter() - start

    def _write(self, layers: Layers, batch: pa.RecordBatch) -> None:
        with (
            replacing(self._path(layers.heights)) as temporary,
            pa.OSFile(str(temporary), "wb") as file,
            pa.ipc.new_file(file, batch.schema) as writer,
        ):
            writer.write_batch(batch)

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
