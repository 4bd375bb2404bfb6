"""The main job: part in, validated program and report out."""

from ebamcheck.pipeline.gates import Gate as Gate
from ebamcheck.pipeline.job import RunResult as RunResult
from ebamcheck.pipeline.job import check_job as check_job
from ebamcheck.pipeline.job import run_job as run_job
from ebamcheck.pipeline.work import Observer as Observer

__all__ = ["Gate", "Observer", "RunResult", "check_job", "run_job"]
