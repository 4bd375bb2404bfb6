"""A stranger's report writer in a process of its own: ``python -m ebamcheck.pipeline.report_process NAME VALUE FOLDER PARENT``."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib.metadata import EntryPoint
from pathlib import Path

from ebamcheck.plugins.processes import die_with, one_line

DONE = "done"
"""File beside the copy that says that the writer has come back."""


def main(arguments: Sequence[str]) -> int:
    """Entry point: what to load, and the folder, a copy of the run, into which it writes."""
    name, value, folder, parent = arguments
    die_with(int(parent))
    from ebamcheck.record.run_folder import RunFolder

    try:
        EntryPoint(name, value, "ebamcheck.reports").load()(RunFolder(Path(folder)))
    except Exception as error:
        sys.stderr.write(f"{type(error).__name__}: {one_line(str(error))}\n")
        return 1
    # A writer that ends the process with code 0 does not come here.
    (Path(folder).parent / DONE).touch()
    return 0


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stderr.flush()
    os._exit(code)
