"""Verification of a program: from its text alone, and against what it was made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.header_checks import Truth
from ebamcheck.checks.matching import Matching, matched
from ebamcheck.checks.metal import Deposit
from ebamcheck.checks.rules import checks_on
from ebamcheck.checks.state_checks import far_away
from ebamcheck.checks.subject import Subject
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
    """Check a program that was read; every check is made that its inputs allow.

    Parameters
    ----------
    config
        Machine and process: limits, modes, power, templates.
    curves, plan
        What the program was made from: path, islands, vectors are compared with them.
    match
        Which bead follows which track of both, where that is known already; `nc` then has the roles of the plan.
    part
        The part as placed: where the metal is checked, its layers are held against the mesh, too, and that against its file.
    layers
        Sections by a slicer, best by one that did not make the program; compared with the contour path.
    smooth
        The same sections with the curves that their chords stand for: the path has to lie near them where the
        chords alone leave it room.
    beads
        Check the beads themselves, too, by the text and the `layers` alone: spacing, lines laid twice, the form of the hatch,
        coverage, gaps, wire.
    metal
        Lay the metal of the program over the `layers`, and check its mass and where it lies.
    laid
        Gives that metal, where it is laid elsewhere; with what its places ask for, where `beads` are checked.
    heat
        Work out a balance of the part's heat from the times, waits and power of the text, and check each bead's entry.
    before
        Heat of what stands when the program begins; None: the cold plate.
    under
        Section of what stands when the program begins, where that is preheated; None: the plate, or not known.
    heights
        (L,) heights of the cuts; None: those of `curves`, `plan` or `layers`.
    sha256
        Recorded hash of each file by name, as :class:`ProgramFiles` gives it.
    truth
        What is known of the program from elsewhere, against which its header is held.

    Returns
    -------
    list of Check
        In a fixed order; one that fails names the file and line of the first or worst place.
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
