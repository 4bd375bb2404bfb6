"""Check that every process value of a program is a multiple of the step in which its control takes it.

A control rounds what lies between, or refuses the block: then it drives other values than those that were proved.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.rings import Floats
from ebamcheck.program.checking.checks import Check, count_check, event_place
from ebamcheck.program.language.increments import increments_of
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.settings.config import Config

NAME = "increments"

PRINTED = 1e-6
"""Decimals of a process value."""


def increment_check(nc: NCProgram, config: Config) -> Check:
    """Check values that are set, and feeds along beads, against the increments of the machine profile."""
    steps = increments_of(config.machine)
    faults = []
    names = np.array(nc.events.name, dtype=np.str_)
    for name, step in steps.items():
        if name == "feed_mm_min":
            continue
        at = np.flatnonzero(names == name) if names.size else np.zeros(0, np.int64)
        for i in at[_between(nc.events.value[at], step)].tolist():
            said = f"{name} {float(nc.events.value[i]):g} is no multiple of {step:g}"
            faults.append((int(nc.events.row[i]), event_place(nc, i), said))
    if "feed_mm_min" in steps:
        rows = np.flatnonzero(nc.deposit)
        step = steps["feed_mm_min"]
        for row in rows[_between(nc.feed_mm_min[rows], step)].tolist():
            said = f"feed {nc.feed_mm_min[row]:g} mm/min is no multiple of {step:g}"
            faults.append((row, nc.where(row), said))
    faults.sort(key=lambda fault: fault[0])
    known = ", ".join(f"{name} {step:g}" for name, step in steps.items())
    good = f"values are multiples of {known}" if known else "the profile names none (machine.*_increment_*)"
    return count_check(NAME, [(where, what) for _, where, what in faults], good)


def _between(values: Floats, step: float) -> np.ndarray:
    """Which values (n,) lie between two multiples of a step, or are not known."""
    off = np.abs(values - np.round(values / step) * step)
    return np.asarray(~(off <= PRINTED), np.bool_)
