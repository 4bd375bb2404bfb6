"""The main job: part in, validated program and report out."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ebamcheck.pipeline.gates import Gate as Gate
    from ebamcheck.pipeline.job import RunResult as RunResult
    from ebamcheck.pipeline.job import check_job as check_job
    from ebamcheck.pipeline.job import run_job as run_job
    from ebamcheck.pipeline.work import Observer as Observer

__all__ = ["Gate", "Observer", "RunResult", "check_job", "run_job"]

_HOMES = {"Gate": "gates", "Observer": "work", "RunResult": "job", "check_job": "job", "run_job": "job"}
"""Names and where they live; they load when first used: who opens a run folder, a stranger's report writer in a process of
its own, waits for no planning and no program."""


def __getattr__(name: str) -> Any:
    """Load a name from its module when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module 'ebamcheck.pipeline' has no attribute {name!r}")
    return getattr(import_module(f"ebamcheck.pipeline.{_HOMES[name]}"), name)
