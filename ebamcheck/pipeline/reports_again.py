"""Reports that say nothing but what the record of a run says, made again from it."""

from __future__ import annotations

import shutil
import tempfile
from importlib import import_module
from pathlib import Path

from ebamcheck.errors import EbamcheckError, InputError
from ebamcheck.pipeline.former_runs import TIMINGS
from ebamcheck.pipeline.run_folder import MANIFEST, RunFolder
from ebamcheck.plugins import registry
from ebamcheck.plugins.points import is_house

OF_RECORD = "OF_RECORD"
"""Name of the tuple in which a package of ours tells which of its report writers read the record of a run alone."""


def reports_again(run: RunFolder) -> dict[str, bytes]:
    """Files that the house's writers of such reports make of the record of a run, by name.

    They are given a folder with the record and no other file of the run: what they write depends on nothing else.

    Raises
    ------
    InputError
        If one of them cannot be made from this record.
    """
    found: dict[str, bytes] = {}
    for name, point in registry.points(registry.REPORTS).items():
        if not is_house(point) or name not in _of_record(point.module.partition(".")[0]):
            continue
        with tempfile.TemporaryDirectory(prefix="ebamcheck-", ignore_cleanup_errors=True) as temporary:
            bare = RunFolder(Path(temporary))
            for file in (MANIFEST, TIMINGS):
                if (run.path / file).is_file():
                    shutil.copyfile(run.path / file, bare.path / file)
            try:
                written = registry.load(point)(bare)
            except EbamcheckError:
                raise
            except Exception as error:  # A record that was tampered with may hold anything.
                why = f"{type(error).__name__}: {error}"
                raise InputError(
                    f"{run.path / MANIFEST}: report {name!r} cannot be made from it: {why}"
                ) from None
            found |= {file: (bare.path / file).read_bytes() for file in written}
    return found


def _of_record(package: str) -> tuple[str, ...]:
    """Names of such writers of a package."""
    return tuple(getattr(import_module(package), OF_RECORD, ()))
