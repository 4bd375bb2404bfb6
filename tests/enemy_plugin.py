"""Slicers that come to grief in one way each; what their tests install as a stranger's distribution, and workers load."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from typing import ClassVar

import numpy as np

from ebamcheck.backend import BackendSettings, Probe
from ebamcheck.errors import BackendFailed
from ebamcheck_planecut import PlaneCut


class _Prepared:
    def __init__(self, honest, spoil):
        self.honest, self.spoil = honest, spoil

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def slice(self, heights, progress=None):
        return self.spoil(self.honest.slice(heights, progress))


def enemy(called, spoil, **overrides):
    """A slicer whose honest layers are spoiled."""

    class Enemy(PlaneCut):
        name: ClassVar[str] = called
        priority: ClassVar[int] = 1

        def prepare(self, part, settings):
            return _Prepared(PlaneCut().prepare(part, PlaneCut.Settings()), spoil)

    for key, value in overrides.items():
        setattr(Enemy, key, value)
    return Enemy


def moved_point(value):
    def spoil(layers):
        points = layers.points.copy()
        points[0, 0] = value
        return replace(layers, points=points)

    return spoil


def tell(data):
    """Write into the pipe of events, as code that closes or guesses descriptors does."""

    def spoil(layers):
        os.write(int(sys.argv[2]), data)
        return layers

    return spoil


def flood(layers):
    while True:
        os.write(int(sys.argv[2]), b'{"done": 0}\n' * 1000)


def forks(layers):
    """Leave processes behind: in the group, and in sessions of their own."""
    for away in (False, True):
        for _ in range(3):
            subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=away)
    return layers


def gone(layers):
    """Say that it is written, and write nothing."""
    os.write(int(sys.argv[2]), b'{"written": true}\n')
    os._exit(0)


def bound(value):
    return lambda self, part, settings: value


SLICERS = {
    "fewer": (enemy("fewer", lambda layers: layers.take(np.arange(1, len(layers)))), "39 for 40 heights"),
    "higher": (enemy("higher", lambda la: replace(la, heights=la.heights + 0.01)), "layer 1 of the block is at z"),
    "nan": (enemy("nan", moved_point(np.nan)), "point 0, x is nan"),
    "huge": (enemy("huge", moved_point(1e300)), "point 0, x is 1e"),
    "single": (enemy("single", lambda la: replace(la, points=la.points.astype(np.float32))), "points is of float32"),
    "stranger-part": (enemy("stranger-part", lambda la: la.labelled(part="0" * 64)), "of part 000000000000"),
    "text": (enemy("text", lambda layers: "layers"), "it returned str, not Layers"),
    "unwritten": (enemy("unwritten", gone), "its file is not one of layers"),
    "infinite": (enemy("infinite", lambda la: la, error_bound_mm=bound(np.inf)), "an error bound of inf mm"),
    "vast": (enemy("vast", lambda la: la, error_bound_mm=bound(1e6)), "an error bound of 1e\\+06 mm on a part of 2 mm"),
    "tall": (enemy("tall", lambda la: la, height_bound_mm=bound(np.nan)), "a height bound of nan mm"),
    "no-json": (enemy("no-json", tell(b"hello\n")), "told what is no event: 'hello'"),
    "no-word": (enemy("no-word", tell(b'{"error_bound_mm": "small"}\n')), "error_bound_mm = 'small'"),
    "flood": (enemy("flood", flood), "a flood"),
    "leaver": (enemy("leaver", lambda layers: sys.exit(0)), "its process ended with code 0"),
}  # fmt: skip
"""Class, and why it is lost."""

FORKS = enemy("forks", forks)
LOOSE = enemy("loose", lambda layers: layers, error_bound_mm=bound(0.7))


def _class(name):
    return SLICERS[name][0]


for _name in SLICERS:
    globals()[_name.replace("-", "_")] = _class(_name)


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
