"""Check that the tool waits and stops over the part, not at the height of a bead.

Where it stands at work height with beam off, the tip of the wire freezes into the pool that it has just left, and the head
takes the heat of the part for as long as the wait is.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.program.checking.checks import Check, count_check, event_place
from ebamcheck.program.checking.machine_state import WAITS
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.settings.config import Config

NAME = "waits over the part"

STOPS = (*WAITS, "M0", "M1")
"""Events at which the tool stands."""

PLACE_MM = 2e-3
"""Heights are rounded to the decimals of a program, at their coarsest."""


def wait_height_check(nc: NCProgram, config: Config) -> Check:
    """Check that the tip is clear of all that has been laid, by the clearance of the machine, wherever the program waits."""
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
        if row <= 0 or not np.isfinite(top):
            continue  # Nothing is laid that the tool could stand over.
        z = float(nc.end[row - 1, 2])
        if not z >= top + clear_mm - PLACE_MM:
            what = f"waits or stops at Z {z:g} mm, {z - top:.4g} mm over what is laid, {clear_mm:g} mm is clear of it"
            faults.append((event_place(nc, i), what))
    return count_check(
        NAME, faults, f"{count} waits and stops, all {clear_mm:g} mm or more over what is laid"
    )
