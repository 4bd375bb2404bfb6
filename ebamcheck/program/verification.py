"""Verification of a program: from its text alone, and against what it was made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.matching import Matching, matched
from ebamcheck.checks.metal import Deposit
from ebamcheck.checks.rules import checks_on
from ebamcheck.checks.state_checks import far_away
from ebamcheck.checks.subject import Subject
from ebamcheck.checks.text_checks import Truth
from ebamcheck.errors import InputError
from ebamcheck.heat.balance import HeatColumn
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.nc.inputs import CurveColumns, ScanColumns
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.reader import read_program
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import planned_path


def verify_program(
    nc: NCProgram,
    *,
    config: Config,
    curves: CurveColumns | None = None,
    plan: ScanColumns | None = None,
    match: Matching | None = None,
    part: Part | None = None,
    layers: Layers | None = None,
    smooth: Layers | None = None,
    beads: bool = False,
    metal: bool = False,
    laid: Callable[[], Deposit] | None = None,
    heat: bool = False,
    before: HeatColumn | None = None,
    under: BaseGeometry | None = None,
    heights: ArrayLike | None = None,
    sha256: Mapping[str, str] | None = None,
    truth: Truth | None = None,
) -> list[Check]:
    """Check a program that was read; every check is made that its inputs allow, in a fixed order.

    `curves` and `plan` are what it was made from, and `match` says which bead follows which track of both. `layers` are sections
    by a slicer, best by one that did not make the program, and `smooth` the same with the curves that their chords stand for.
    `beads` judges the beads themselves; `metal` lays the metal over the `layers`, or takes it from `laid`, and `part` has them held
    against its mesh and file; `heat` works out a balance, from the heat `before` and the section `under` the program. `heights`
    (L,) are those of the cuts, `sha256` the recorded hash of each file, `truth` what its header is held against. A check that
    fails names the file and line of the first or worst place.
    """
    if match is None and curves is not None and plan is not None:
        nc, match = matched(nc, planned_path(curves, plan, config))
    asked = {"beads": beads, "metal": metal, "heat": heat}
    subject = Subject(
        nc,
        config,
        curves=curves,
        plan=plan,
        match=match,
        part=part,
        layers=layers,
        smooth=smooth,
        cuts=None if heights is None else np.asarray(heights, np.float64),
        before=before,
        under=under,
        sha256=sha256,
        truth=truth or Truth(),
        laid=laid,
        asked=frozenset(name for name, wanted in asked.items() if wanted),
    )
    return checks_on(subject)


def verify_file(path: str | Path, *, config: Config, **given: object) -> list[Check]:
    """Read and check a program; one that cannot be read is a failed check named ``readable``.

    Takes what :func:`verify_program` takes, and the same `path` as :func:`read_program`.
    """
    nc, readable = read_checked(path, config)
    if nc is None:
        return [readable]
    return [readable, *verify_program(nc, config=config, **given)]  # type: ignore[arg-type]


def read_checked(path: str | Path, config: Config) -> tuple[NCProgram | None, Check]:
    """Read a program, with the check ``readable``; None, and a check that has failed, where it cannot be read or leads out of all bounds."""
    try:
        nc = read_program(path, config)
    except InputError as error:
        where, _, text = str(error).partition(": ")
        return None, Check("readable", False, 1.0, 0.0, "faults", where, text)
    if (far := far_away(nc, config)) is not None:
        return None, far
    return nc, Check("readable", True, 0.0, 0.0, "faults", "", f"{len(nc)} motions in {len(nc.files)} files")
