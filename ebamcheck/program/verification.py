"""Verification of a program: from its text alone, and against what it was made from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.config import Config
from ebamcheck.errors import InputError
from ebamcheck.layers import Layers
from ebamcheck.program.bead_checks import bead_checks, repeated_blocks
from ebamcheck.program.bead_end_checks import bead_end_checks
from ebamcheck.program.bead_ends import planned_path
from ebamcheck.program.checks import Check
from ebamcheck.program.deposit import deposit
from ebamcheck.program.deposit_checks import deposit_checks
from ebamcheck.program.inputs import CurveColumns, ScanColumns, deposition_heights, interpass_of
from ebamcheck.program.interpass_checks import heat_checks, layer_shares, shares_of_text, wait_check
from ebamcheck.program.motions import NCProgram
from ebamcheck.program.path_checks import closure_check, contour_checks, hatch_checks, layer_checks
from ebamcheck.program.process_checks import process_checks
from ebamcheck.program.reader import read_program
from ebamcheck.program.section_check import section_check
from ebamcheck.program.state_checks import state_checks
from ebamcheck.program.text_checks import text_checks
from ebamcheck.program.text_heat import known_sections
from ebamcheck.program.toolpath import Toolpath
from ebamcheck.program.window_checks import window_check
from ebamcheck.program.wire_checks import wire_check
from ebamcheck.rings import Floats
from ebamcheck.scan.turns import TURN_SPACINGS

PATH_TOLERANCE_MM = 1e-3
"""Path read back against the fitted curve, after decimal rounding: a tenth of what a slicer agrees to."""

SECTION_TOLERANCE_MM = 0.05
"""Contour path against the section: the fit of the curves and the roundness of the inset's corners."""


def verify_program(
    nc: NCProgram,
    *,
    config: Config,
    curves: CurveColumns | None = None,
    plan: ScanColumns | None = None,
    layers: Layers | None = None,
    path: Toolpath | None = None,
    smooth: Layers | None = None,
    beads: bool = False,
    metal: bool = False,
    heat: bool = False,
    heights: ArrayLike | None = None,
    sha256: Mapping[str, str] | None = None,
    contour_offset_mm: float | None = None,
    tolerance_mm: float = PATH_TOLERANCE_MM,
    section_tolerance_mm: float | Floats = SECTION_TOLERANCE_MM,
) -> list[Check]:
    """Check a program that was read; every check is made that its inputs allow.

    Parameters
    ----------
    config
        Machine and process: limits, modes, power, templates.
    curves, plan
        What the program was made from: path, islands, vectors are compared with them.
    layers
        Sections by a slicer, best by one that did not make the program; compared with the contour path.
    path
        The tracks laid out of both, where they are there already.
    smooth
        The same sections with the curves that their chords stand for: the path has to lie near them where the
        chords alone leave it room.
    beads
        Check the beads themselves, too: spacing, lines laid twice, coverage of the `layers`. For a program whose
        plan is not known; against a plan its vectors are compared one by one.
    metal
        Lay the metal of the program over the `layers`, and check its mass and where it lies.
    heat
        Drive a balance of the part's heat by the times, waits and power of the text, and check each bead's entry.
    heights
        (L,) heights of the cuts; None: those of `curves`, `plan` or `layers`.
    sha256
        Recorded hash of each file by name, as :class:`ProgramFiles` gives it.
    contour_offset_mm
        Inset of the contour path from the section; None: that of the settings.
    tolerance_mm, section_tolerance_mm
        Largest distance of the path from the fitted curve, and from the inset section.

    Returns
    -------
    list of Check
        In a fixed order; one that fails names the file and line of the first or worst place.
    """
    turn_limit_mm = TURN_SPACINGS * config.process.hatch_spacing_mm
    checks = text_checks(nc, sha256) + state_checks(nc, config, turn_limit_mm)
    if path is None and curves is not None and plan is not None:
        path = planned_path(curves, plan, config)
    checks.append(wire_check(nc, config, path))
    planned = None if plan is None else interpass_of(plan, config)
    sections = known_sections(plan, smooth, layers)
    if planned is not None:
        shares = planned.power_share
    elif heat:
        shares = shares_of_text(nc, config, sections)
    else:
        shares = np.minimum(layer_shares(nc, config.process.power_w), 1.0)
    checks += [*bead_end_checks(nc, config, shares), closure_check(nc, curves, tolerance_mm)]
    checks += [repeated_blocks(nc), window_check(nc, config), *process_checks(nc, config)]
    checks.append(wait_check(nc, config, planned))
    if heat:
        checks += heat_checks(nc, config, sections)
    known = (
        heights
        if heights is not None
        else next((x.heights for x in (curves, plan, layers) if x is not None), None)
    )
    if known is None:
        return checks
    z_of = deposition_heights(np.asarray(known, dtype=np.float64), config.layer_height_mm)
    checks += layer_checks(nc, z_of, _where_called(nc))
    if curves is not None:
        checks += contour_checks(nc, curves, config, tolerance_mm, z_of)
    if plan is not None:
        checks += hatch_checks(nc, plan, config, tolerance_mm, z_of)
    if layers is not None:
        offset = config.contour_offset_mm if contour_offset_mm is None else contour_offset_mm
        checks.append(section_check(nc, layers, z_of, offset, section_tolerance_mm))
        if smooth is not None:
            limit = smooth_tolerance_mm(config)
            checks.append(section_check(nc, smooth, z_of, offset, limit, "smooth section"))
        if metal:
            checks += deposit_checks(nc, deposit(nc, layers, z_of, config), config)
    if beads:
        checks += bead_checks(nc, config, z_of, layers)
    return checks


def smooth_tolerance_mm(config: Config) -> float:
    """Distance of the path from a smooth section that was sliced and fitted anew.

    Both sections and the bead's path were fitted within the tolerance, and cleaned before.
    """
    curves = config.curves
    return SECTION_TOLERANCE_MM + 2.0 * curves.tolerance_mm + curves.near_point_mm + curves.collinear_mm


def verify_file(path: str | Path, *, config: Config, **given: object) -> list[Check]:
    """Read and check a program; one that cannot be read is a failed check named ``readable``.

    Takes what :func:`verify_program` takes, and the same `path` as :func:`read_program`.
    """
    try:
        nc = read_program(path, config)
    except InputError as error:
        where, _, text = str(error).partition(": ")
        return [Check("readable", False, 1.0, 0.0, "faults", where, text)]
    readable = Check("readable", True, 0.0, 0.0, "faults", "", f"{len(nc)} motions in {len(nc.files)} files")
    return [readable, *verify_program(nc, config=config, **given)]  # type: ignore[arg-type]


def _where_called(nc: NCProgram) -> NDArray[np.object_]:
    """Place of the call of each layer (L,); of its first deposit in a program without calls."""
    calls = [
        i for i, name in enumerate(nc.events.name) if name.startswith("call ") and nc.events.file[i] == 0
    ]
    if len(calls) == len(nc.layer_files):
        return np.array([f"{nc.files[0].name}:{nc.events.line[i]}" for i in calls], dtype=np.object_)
    first = [int(np.argmax(nc.layer == k)) for k in range(len(nc.layer_files))]
    return np.array([nc.where(row) for row in first], dtype=np.object_)
