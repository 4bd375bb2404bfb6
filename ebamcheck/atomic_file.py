"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from ebamcheck.errors import SettingsError
from ebamcheck.scratch import owned_file, sweep_parts

COMPRESSION: Final = (
    "lz4"  # compression of the Parquet files of a run: coordinates hardly get smaller by a slower one
)


def made_folder(path: Path) -> Path:
    """Make a folder where there is none, and return it."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SettingsError(f"{path}: cannot be made: {error.strerror}") from None
    return path


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a temporary name in the folder of `path`; the file written there takes its place at the end.

    Where the block raises, the temporary file goes and what stood at `path` stays as it was; what a killed process
    left in that folder goes, too.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with replacing(Path(folder, "a.txt")) as temporary:
    ...         _ = temporary.write_text("whole")
    ...     Path(folder, "a.txt").read_text()
    'whole'
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise SettingsError(f"{path}: cannot be written: there is no folder {path.parent}: make it first")
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.part")
    sweep_parts(path.parent)
    try:
        with owned_file(temporary):
            yield temporary
            os.replace(temporary, path)
    except OSError as error:
        raise SettingsError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        temporary.unlink(missing_ok=True)
