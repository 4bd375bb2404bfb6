"""Check that the tool waits and stops over the part, not at the height of a bead.

Where it stands at work height with beam off, the tip of the wire freezes into the pool that it has just left, and the head
takes the heat of the part for as long as the wait is.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.program.checking.checks import Check, count_check, event_place
from ebamcheck.program.checking.machine_state import WAITS
from ebamcheck.program.language.codes import DWELL, SWITCHES
from ebamcheck.program.language.template_rules import checked_templates
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.settings.config import Config

NAME = "waits over the part"

STOPS = (*WAITS, "M0", "M1")
"""Events at which the tool stands."""

PLACE_MM = 2e-3
"""Heights are rounded to the decimals of a program, at their coarsest."""


def wait_height_check(nc: NCProgram, config: Config) -> Check:
    """Check that the tip is clear of all that has been laid, by the clearance of the machine, wherever the program waits.

    A rest that the profile's own templates hold beside a switch of beam or wire is the user's: it may be where they stand.
    """
    rests, switched = _rests(config), _rows_of_switches(nc)
    clear_mm = config.machine.clearance_mm
    laid = np.where(nc.deposit, np.fmax(nc.start[:, 2], nc.end[:, 2]), -np.inf)
    tops = np.concatenate([[-np.inf], np.fmax.accumulate(laid)]) if len(nc) else np.full(1, -np.inf)
    faults, count = [], 0
    for i, name in enumerate(nc.events.name):
        if name not in STOPS:
            continue
        row = int(nc.events.row[i])
        count += 1
        top = float(tops[min(row, len(nc))])
        if name == DWELL and float(nc.events.value[i]) in rests and row in switched:
            continue
        if row <= 0 or not np.isfinite(top):
            continue  # Nothing is laid that the tool could stand over.
        z = float(nc.end[row - 1, 2])
        if not z >= top + clear_mm - PLACE_MM:
            what = f"waits or stops at Z {z:g} mm, {z - top:.4g} mm over what is laid, {clear_mm:g} mm is clear of it"
            faults.append((event_place(nc, i), what))
    return count_check(
        NAME, faults, f"{count} waits and stops, all {clear_mm:g} mm or more over what is laid"
    )


def _rests(config: Config) -> set[float]:
    """Waits in the templates of the profile that switch beam or wire, s."""
    templates = checked_templates(config.machine, config.machine.control)
    actions = (action for name in SWITCHES for _, held in templates.get(name, ()) for action in held)
    return {float(a.number) for a in actions if a.meaning == DWELL and a.number is not None}


def _rows_of_switches(nc: NCProgram) -> set[int]:
    """Rows before which beam or wire are switched."""
    return {int(row) for row, name in zip(nc.events.row, nc.events.name, strict=True) if name in SWITCHES}
