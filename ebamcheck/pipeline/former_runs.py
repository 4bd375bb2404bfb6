"""Finished runs that stand where a new one is to go: they are never removed, only moved to a name with their date."""

from __future__ import annotations

import json
import os
import re
import time
from pathlib import Path

TIMINGS = "timings.json"
"""Times and dates of a run, which are all that differs from one run of the same input to the next."""

_DATE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d")


def finished_at(run: Path, record: str) -> str:
    """When a finished run came to its end, UTC, as ``2026-11-22T14:15:00``; by its own record where that can be read.

    Parameters
    ----------
    run
        The run folder.
    record
        Name of its record, whose date counts where it names no time.
    """
    for name in (TIMINGS, record):
        try:
            told = json.loads((run / name).read_text(encoding="utf-8"))
            found = _DATE.match(str((told if name == TIMINGS else told["timings"])["finished"]))
        except (OSError, ValueError, KeyError, TypeError):
            continue
        if found:
            return found[0]
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime((run / record).stat().st_mtime))


def dated_name(target: Path, finished: str) -> Path:
    """Free name beside `target` for the run that stood there: ``RUN.2026-11-22T141500``, numbered where that is taken."""
    plain = target.with_name(f"{target.name}.{finished.replace(':', '')}")
    name, number = plain, 1
    while os.path.lexists(name):
        number += 1
        name = plain.with_name(f"{plain.name}-{number}")
    return name
