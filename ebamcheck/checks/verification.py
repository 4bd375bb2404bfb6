"""Verification of a program: from its text alone, and against what it was made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import ArrayLike
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.bead_checks import bead_checks, repeated_blocks
from ebamcheck.checks.bead_end_checks import bead_end_checks, ramp_check
from ebamcheck.checks.checks import Check, CheckGroup, checks_of
from ebamcheck.checks.clearance import clearance_checks
from ebamcheck.checks.consumables import consumables_checks
from ebamcheck.checks.event_checks import (
    increment_check,
    released_checks,
    value_check,
    wait_height_check,
)
from ebamcheck.checks.header_checks import Truth, header_checks
from ebamcheck.checks.interpass_checks import (
    heat_checks,
    layer_shares,
    scheduled_shares,
    shares_of_text,
    wait_check,
)
from ebamcheck.checks.matching import Matching, matched, matching_checks, tracks_known
from ebamcheck.checks.metal import Deposit, deposit
from ebamcheck.checks.metal_rules import deposit_checks, overfill_check
from ebamcheck.checks.outside_check import outside_check
from ebamcheck.checks.path_checks import (
    closure_check,
    contour_checks,
    hatch_checks,
    layer_checks,
)
from ebamcheck.checks.plugged import plugged_checks
from ebamcheck.checks.preheating import preheat_checks
from ebamcheck.checks.process_checks import process_checks
from ebamcheck.checks.section_check import Evidence, section_check
from ebamcheck.checks.state_checks import far_away, state_checks
from ebamcheck.checks.table import tilt_checks
from ebamcheck.checks.text_checks import text_checks
from ebamcheck.checks.text_heat import known_sections
from ebamcheck.checks.window_checks import window_check
from ebamcheck.checks.wire_checks import wire_check
from ebamcheck.checks.word_checks import words_check
from ebamcheck.curves import LIFTED
from ebamcheck.errors import InputError
from ebamcheck.heat.balance import HeatColumn
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.reader import read_program
from ebamcheck.nc.roles import by_height, by_section
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.scan.filling.turns import TURN_SPACINGS
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import planned_path
from ebamcheck.writing.inputs import (
    CurveColumns,
    ScanColumns,
    deposition_heights,
    interpass_of,
)
from ebamcheck.writing.tracks import Toolpath

PATH_TOLERANCE_MM = 1e-3
"""Path read back against the fitted curve, after decimal rounding: a tenth of what a slicer agrees to."""

SECTION_TOLERANCE_MM = 0.05
"""Contour path against the section: the fit of the curves and the roundness of the inset's corners."""

CONTOUR_SHARE = 0.125
"""Of the bead's width: a bead that runs this near to the inset of the section is a contour."""


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
    laid: Callable[[], Deposit] | None = None,
    heat: bool = False,
    before: HeatColumn | None = None,
    under: BaseGeometry | None = None,
    heights: ArrayLike | None = None,
    sha256: Mapping[str, str] | None = None,
    truth: Truth | None = None,
    contour_offset_mm: float | None = None,
    tolerance_mm: float = PATH_TOLERANCE_MM,
    section_tolerance_mm: float | None = None,
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
    contour_offset_mm
        Inset of the contour path from the section; None: that of the settings.
    tolerance_mm
        Largest distance of the path from the fitted curve.
    section_tolerance_mm
        Largest distance of the path from the inset section, whatever the evidence for it; None: that of the settings.

    Returns
    -------
    list of Check
        In a fixed order; one that fails names the file and line of the first or worst place.
    """
    known = heights
    if known is None:
        known = next((x.heights for x in (curves, plan, layers) if x is not None), None)
    cuts = np.asarray(() if known is None else known, np.float64)
    z_of = deposition_heights(cuts, config.layer_height_mm, config.base_mm)
    offset = config.contour_offset_mm if contour_offset_mm is None else contour_offset_mm
    if path is None and curves is not None and plan is not None:
        path = planned_path(curves, plan, config)
    tracks = path or tracks_known(curves, plan, config)
    nc, match = _with_roles(nc, tracks, layers, z_of, offset, config)
    planned = None if plan is None else interpass_of(plan, config)
    sections = known_sections(plan, smooth, layers)
    shares = _power_shares(nc, config, known, sections, heat) if plan is None else _planned_shares(plan)
    groups: list[CheckGroup] = [
        lambda: text_checks(nc, config, sha256),
        lambda: header_checks(nc, config, truth or Truth(), known),
        lambda: state_checks(nc, config, TURN_SPACINGS * config.process.hatch_spacing_mm),
        lambda: [wire_check(nc, config, path), *bead_end_checks(nc, config, shares)],
        lambda: [closure_check(nc, curves, tolerance_mm), *_block_checks(nc, config)],
        lambda: [wait_check(nc, config, planned), wait_height_check(nc, config)],
        lambda: consumables_checks(nc, config),
    ]
    if heat:
        groups.append(lambda: heat_checks(nc, config, sections, before, known_sections(None, layers)))
    groups += [
        lambda: preheat_checks(nc, config, sections, before, under),
        lambda: [*tilt_checks(nc, config), *released_checks(nc, config)],
        lambda: clearance_checks(nc, z_of, config, layers),
        lambda: plugged_checks(nc, config),
    ]
    if known is not None:
        groups.append(lambda: layer_checks(nc, z_of, _filled(tracks, layers, len(z_of))))
        if match is not None and path is not None:
            # A plan of contours or of islands alone knows nothing of the other beads.
            groups.append(lambda: matching_checks(nc, match, tolerance_mm))
        if curves is not None:
            groups.append(lambda: contour_checks(nc, curves, config, tolerance_mm, z_of))
        if plan is not None:
            groups.append(lambda: hatch_checks(nc, plan, config, tolerance_mm, z_of))
        if layers is not None:
            most = (
                config.curves.section_tolerance_mm if section_tolerance_mm is None else section_tolerance_mm
            )
            groups.append(lambda: _section_checks(nc, layers, smooth, z_of, offset, config, most))
            laid = laid or _once(lambda: deposit(nc, layers, z_of, config, asked=beads))
            if metal:
                groups.append(lambda: deposit_checks(nc, laid(), config))
            if path is None:
                groups.append(lambda: [overfill_check(nc, z_of, config, layers)])
        if beads:
            groups += bead_checks(nc, config, z_of, layers, laid)
    return checks_of(groups)


def _once(make: Callable[[], Deposit]) -> Callable[[], Deposit]:
    """Lay the metal at the first call, whichever check asks for it, and give it back at each further one."""
    lock, made = Lock(), list[Deposit]()

    def found() -> Deposit:
        with lock:
            if not made:
                made.append(make())
            return made[0]

    return found


def _planned_shares(plan: ScanColumns) -> Floats:
    """Share of the beam's power in each layer (L,) of a plan, by its own table; full where it has none."""
    metrics = getattr(plan, "metrics", {})
    found = np.asarray(metrics.get("power_share", np.nan), np.float64)
    return np.where(np.isnan(found), 1.0, found) * np.ones(len(plan.heights))


def _power_shares(
    nc: NCProgram,
    config: Config,
    heights: ArrayLike | None,
    sections: Sequence[BaseGeometry] | None,
    heat: bool,
) -> Floats:
    """Share of the beam's power in each layer (L,) where no plan tells: by the schedule, else as the text has it."""
    scheduled = scheduled_shares(heights, config)
    if scheduled is not None:
        return scheduled
    if heat:
        return shares_of_text(nc, config, sections)
    return np.minimum(layer_shares(nc, config), 1.0)


def _block_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Checks of single blocks and of the values that they set, from the text alone."""
    return [
        repeated_blocks(nc),
        words_check(nc),
        increment_check(nc, config),
        ramp_check(nc, config),
        window_check(nc, config),
        value_check(nc, config),
        *process_checks(nc, config),
    ]


def _with_roles(
    nc: NCProgram,
    tracks: Toolpath | None,
    layers: Layers | None,
    z_of: Floats,
    offset_mm: float,
    config: Config,
) -> tuple[NCProgram, Matching | None]:
    """Layers and roles of all motions by who knows most of them: a plan, sections, or their shape alone."""
    nc = by_height(nc, z_of)
    if tracks is not None:
        return matched(nc, tracks)
    if layers is not None:
        nc = by_section(nc, layers, z_of, offset_mm, CONTOUR_SHARE * config.process.bead_width_mm)
    return nc, None


def _section_checks(
    nc: NCProgram,
    layers: Layers,
    smooth: Layers | None,
    z_of: Floats,
    offset_mm: float,
    config: Config,
    most_mm: float,
) -> list[Check]:
    """Contours against the sections, by chords and with the curves that these stand for; and all beads within them."""
    near_mm = smooth_tolerance_mm(config)
    base = SECTION_TOLERANCE_MM if smooth is None else near_mm
    if config.curves.method not in LIFTED:
        base = (
            most_mm  # An interpolating spline goes its own way between points, twice: no place tells how far.
        )
    checks = [section_check(nc, layers, z_of, offset_mm, most_mm, evidence=Evidence(base, most_mm, smooth))]
    checks.append(outside_check(nc, layers, z_of, config, most_mm))
    if smooth is not None:
        checks.append(section_check(nc, smooth, z_of, offset_mm, near_mm, "smooth section"))
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


def _filled(path: Toolpath | None, layers: Layers | None, count: int) -> Bools:
    """Which layers (L,) are to have metal, as far as is known: all of them, if nothing is."""
    if path is not None:
        ends = path.track_starts[path.layer_starts]
        return np.asarray(np.diff(ends) > 0)
    if layers is not None:
        return np.array([any(p.area > 0.0 for p in layers.polygons(k)) for k in range(count)], np.bool_)
    return np.ones(count, np.bool_)
