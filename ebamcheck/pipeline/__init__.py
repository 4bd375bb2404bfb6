"""The main job: part in, validated program and report out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ebamcheck.names_on_demand import on_demand

if TYPE_CHECKING:
    from ebamcheck.pipeline.job import Observer as Observer
    from ebamcheck.pipeline.job import RunResult as RunResult
    from ebamcheck.pipeline.run import check_job as check_job
    from ebamcheck.pipeline.run import run_job as run_job

__all__ = ["Observer", "RunResult", "check_job", "run_job"]
# They load when they are first used: who opens a run folder waits for no planning and no program
_HOMES = {"Observer": "job", "RunResult": "job", "check_job": "run", "run_job": "run"}
__getattr__ = on_demand(__name__, _HOMES)
