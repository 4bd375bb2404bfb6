"""Checks that are yes or no by nature: a sound program passes each, and the fault that is planted here fails it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from limit_cases import Subject, cube, program_of
from limits_of_heat import preheated
from limits_of_path import hatch_row
from limits_of_text import FIRST, MAIN

from ebamcheck.checks.text_checks import Truth


def edited(name: str, begins: str, change: Callable[[str], str | None]) -> Subject:
    """The cube with one of its lines changed, or left out."""

    def edit(lines):
        i = next(i for i, line in enumerate(lines[name]) if begins in line)
        lines[name][i : i + 1] = [] if (line := change(lines[name][i])) is None else [line]

    return cube().with_text(edit)


def without_a_bead() -> Subject:
    rows = cube().of_layer(1)
    bead = cube().nc.beads.among(rows).bead
    return cube().with_columns(rows[bead == bead[-1]], beam=False, wire=False)


def without_y() -> Subject:
    return edited(FIRST, "G1 X27.000000 Y15", lambda line: line.split(" Y")[0])


def lifted() -> Subject:
    row = int(cube().of_layer(1)[9])
    return cube().with_columns((row, 2), end=3.36)


def crossed() -> Subject:
    return program_of([[[(0.0, 0.0), (40.0, 0.0)], [(20.0, -20.0), (20.0, 20.0)]]])


def unknown_start() -> Subject:
    return cube().with_columns(hatch_row(), start=np.nan)


def wait_under_the_beam() -> Subject:
    return cube().with_event(int(cube().metal[2]), "layer_pause_s", 1.0)


def retracted() -> Subject:
    """Settings that ask for a wire that is drawn back, of a program that draws none."""
    return cube().by(process={"wire_retract_mm": 3.0})


def other_passes() -> Subject:
    passes = int(preheated().checks("layers")["preheat count"].text.split()[0])
    return preheated().by(preheat={"passes": passes + 2})


FAULTY: dict[str, tuple[Callable[[], Subject], tuple[str, ...]]] = {
    "line ends": (lambda: edited(FIRST, "G17", lambda line: line + "\r"), ()),
    "unchanged": (lambda: cube().given(sha256={MAIN: "0"}), ("sha256",)),
    "status": (lambda: cube().given(truth=Truth(validated=True)), ("truth",)),
    "start state": (lambda: edited(MAIN, "M61", lambda line: None), ()),
    "order of events": (wait_under_the_beam, ()),
    "start of path": (unknown_start, ()),
    "words of motions": (without_y, ()),
    "flat layers": (lifted, ("curves", "plan")),
    "beads as planned": (without_a_bead, ("curves", "plan")),
    "crossings": (crossed, ("heights", "beads")),
    "wire retract": (retracted, ()),
    "preheat calls": (lambda: preheated().by(preheat={"when": "off"}), ("layers",)),
    "preheat count": (other_passes, ("layers",)),
}
"""By name of the check: what is planted, and what the check has to know."""
