"""Verification of a program: from its text alone, and against what it was made from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.checks.matching import matched
from ebamcheck.checks.rules import checks_on
from ebamcheck.checks.state_checks import far_away
from ebamcheck.checks.subject import Subject
from ebamcheck.errors import InputError
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.reader import read_program
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import planned_path


def verify_program(
    nc: NCProgram,
    *,
    config: Config,
    heights: ArrayLike | None = None,
    beads: bool = False,
    metal: bool = False,
    heat: bool = False,
    **known: Any,
) -> list[Check]:
    """Check a program that was read; every check is made that its inputs allow, in a fixed order; one that fails names the first or
    worst line.

    `heights` (L,) are those of the cuts, and `known` is what a :class:`~ebamcheck.checks.subject.Subject` may know, None where it
    is not known. `beads` judges the beads themselves; `metal` lays the metal over the `layers`, or takes it from `laid`, and a
    `part` has them held against its mesh and file; `heat` works out a balance, from the heat `before` and the section `under` the
    program."""
    curves, plan = known.get("curves"), known.get("plan")
    if known.get("match") is None and curves is not None and plan is not None:
        nc, known["match"] = matched(nc, planned_path(curves, plan, config))
    wanted = {"beads": beads, "metal": metal, "heat": heat}
    asked = frozenset(name for name, is_wanted in wanted.items() if is_wanted)
    known = {name: value for name, value in known.items() if value is not None}
    cuts = None if heights is None else np.asarray(heights, np.float64)
    return checks_on(Subject(nc, config, cuts=cuts, asked=asked, **known))


def verify_file(path: str | Path, *, config: Config, **given: Any) -> list[Check]:
    """Read and check a program, with what :func:`verify_program` takes; one that cannot be read is a failed check named
    ``readable``."""
    nc, readable = read_checked(path, config)
    if nc is None:
        return [readable]
    return [readable, *verify_program(nc, config=config, **given)]


def read_checked(path: str | Path, config: Config) -> tuple[NCProgram | None, Check]:
    """Read a program, with the check ``readable``; None, and a check that has failed, where it cannot be read or leads out of all
    bounds."""
    try:
        nc = read_program(path, config)
    except InputError as error:
        where, _, text = str(error).partition(": ")
        return None, Check("readable", False, 1.0, 0.0, "faults", where, text)
    if (far := far_away(nc, config)) is not None:
        return None, far
    return nc, Check("readable", True, 0.0, 0.0, "faults", "", f"{len(nc)} motions in {len(nc.files)} files")
