"""Slicers that come to grief, as a plugin: a module of its own, so that worker processes need not import the tests."""

from __future__ import annotations

import os
import signal
import time
from typing import ClassVar

import numpy as np

from ebamcheck.backend import BackendSettings, Probe
from ebamcheck.errors import BackendFailed
from ebamcheck_planecut import PlaneCut


class Troubled(PlaneCut):
    """A real slicer that comes to grief the way its settings say."""

    name: ClassVar[str] = "troubled"
    priority: ClassVar[int] = 1

    class Settings(BackendSettings):
        trouble: str = "none"

    def prepare(self, part, settings):
        match settings.trouble:
            case "abort":
                os.abort()
            case "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            case "hang":
                time.sleep(600)
            case "memory":
                self.hoard = [np.ones(40_000_000) for _ in range(60) if time.sleep(0.02) is None]
            case "raise":
                raise RuntimeError("it broke\non two lines")
            case "refuse":
                raise BackendFailed("the mesh is not to its liking: 3 open edges")
            case "stop":
                return StopsHalfWay(PlaneCut().prepare(part, PlaneCut.Settings()))
        return PlaneCut().prepare(part, PlaneCut.Settings())


class StopsHalfWay:
    """Cuts its first block and hangs in the second."""

    def __init__(self, prepared):
        self.prepared, self.calls = prepared, 0

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        pass

    def slice(self, heights, progress=None):
        self.calls += 1
        if self.calls > 1:
            time.sleep(600)
        return self.prepared.slice(heights, progress)


class Absent(PlaneCut):
    name: ClassVar[str] = "absent"

    def probe(self):
        return Probe(False, why="no such device", hint="install one")


class Raising(PlaneCut):
    name: ClassVar[str] = "raising"

    def probe(self):
        raise OSError("driver not found")
