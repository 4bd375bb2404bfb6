"""Slicers that come to grief in one way each once they slice; what their tests install as a stranger's distribution."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from typing import ClassVar

import numpy as np

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
