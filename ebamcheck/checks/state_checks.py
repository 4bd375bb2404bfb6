"""Checks of what the machine does: modes, feeds, travel, beam and wire, and power."""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.checks.checks import Check, count_check, event_faults, row_faults, worst_check
from ebamcheck.checks.event_checks import switch_faults
from ebamcheck.checks.machine_state import machine_state_checks
from ebamcheck.checks.tolerances import LIMIT_ROUNDING_MM
from ebamcheck.nc.motions import ARC, RAPID, NCProgram
from ebamcheck.nc.timeline import Kind
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import TURN_SPACINGS

LEAST_SPLINE_BLOCKS = 6
"""Spline blocks that the control wants among any 10 (NC Programming manual, BSPLINE)."""


def state_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check the state of the machine in every motion."""
    # Of a program whose table turns, what its axes do, and not what that is on the part.
    driven = nc if nc.machine is None else nc.machine
    return [
        *machine_state_checks(driven, config),
        _feed(nc, config),
        _known_positions(nc),
        _splines(nc),
        _polynomials(nc),
        _travel(driven, config),
        _beam(nc),
        _wire(nc),
        _turns(nc, TURN_SPACINGS * config.process.hatch_spacing_mm),
    ]


def _feed(nc: NCProgram, config: Config) -> Check:
    machine = config.machine
    rows = np.flatnonzero(nc.kind != RAPID)
    feed = nc.feed_mm_min[rows] / 60.0
    low, high = machine.feed_min_mm_s, machine.feed_max_mm_s
    bad = ~((feed >= low) & (feed <= high))
    faults = [
        (nc.where(int(row)), f"feed {value:g} mm/s is not within {low:g} .. {high:g} mm/s")
        for row, value in zip(rows[bad], feed[bad], strict=True)
    ]
    # A way at the feed of the beads is a bead that was not switched on, or lets the part cool longer than planned.
    idle = (nc.kind != RAPID) & ~nc.beam & ~nc.wire
    faults += row_faults(nc, idle, "a way with beam and wire off is driven at feed in place of a rapid")
    return count_check("feed", faults, f"every feed within {low:g} .. {high:g} mm/s, travel by rapids")


def _known_positions(nc: NCProgram) -> Check:
    unknown = (nc.kind != RAPID) & ~(np.isfinite(nc.start).all(axis=1) & np.isfinite(nc.end).all(axis=1))
    return count_check(
        "start of path", row_faults(nc, unknown, "feed motion from a position that is not known"), "every feed motion starts where the one before ended"
    )  # fmt: skip


def _splines(nc: NCProgram) -> Check:
    short = nc.events.named("BSPLINE") & (nc.events.value < LEAST_SPLINE_BLOCKS)
    what = f"a BSPLINE of {{value:g}} blocks: at least {LEAST_SPLINE_BLOCKS} are needed"
    good = f"every BSPLINE has at least {LEAST_SPLINE_BLOCKS} blocks"
    return count_check("spline blocks", event_faults(nc, (short, what)), good)


def _polynomials(nc: NCProgram) -> Check:
    """Parameter lengths of POLY blocks, where the header says that all are 1: a wrong one bends its span a little."""
    if not nc.header.get("POLY", "").startswith("PL=1 "):
        return count_check("polynomial blocks", [], "the header says nothing of PL in POLY blocks")
    what = "PL={value:g} in a POLY block, where the header says PL=1 in every one"
    faults = event_faults(nc, (nc.events.named("POLY"), what))
    return count_check("polynomial blocks", faults, "PL=1 in every POLY block")


def extremes(nc: NCProgram) -> tuple[Floats, Floats]:
    """Least and greatest X, Y, Z (B, 3) on each motion, exactly: roots of the derivative, quadrants of arcs."""
    low, high = np.fmin(nc.start, nc.end), np.fmax(nc.start, nc.end)
    with np.errstate(divide="ignore", invalid="ignore"):
        c1, c2, c3 = (nc.coefficients[:, :, k] for k in (1, 2, 3))
        root = np.sqrt(np.maximum(c2**2 - 3.0 * c3 * c1, 0.0))
        q = -(c2 + np.copysign(root, c2))
        for t in (q / (3.0 * c3), c1 / q):
            inside = (t > 0.0) & (t < 1.0)
            t = np.where(inside, t, 0.0)
            c0 = nc.coefficients[:, :, 0]
            value = np.where(inside, ((c3 * t + c2) * t + c1) * t + c0, nc.end[:, :2])
            low[:, :2], high[:, :2] = np.fmin(low[:, :2], value), np.fmax(high[:, :2], value)
    for row in np.flatnonzero(nc.kind == ARC):
        cx, cy, sweep = nc.arc[row]
        dx, dy = nc.start[row, 0] - cx, nc.start[row, 1] - cy
        radius, first = math.hypot(dx, dy), math.atan2(dy, dx)
        for k in range(4):
            quadrant = 0.5 * math.pi * k
            if (math.copysign(1.0, sweep) * (quadrant - first)) % (2.0 * math.pi) <= abs(sweep):
                point = (cx + radius * math.cos(quadrant), cy + radius * math.sin(quadrant))
                low[row, :2], high[row, :2] = np.fmin(low[row, :2], point), np.fmax(high[row, :2], point)
    return low, high


def far_away(nc: NCProgram, config: Config) -> Check | None:
    """Check ``travel`` of a program that goes farther beyond its limits than the machine is long; None for any other.

    A number that lost its point leads kilometres away. Nothing else can be said of such a program, and what follows its path
    would take hours and all memory.
    """
    machine = config.machine
    longest = float(np.subtract(machine.travel_max_mm, machine.travel_min_mm).max())
    for each in (nc if nc.machine is None else nc.machine, nc.preheating):
        if each is None or not len(each):
            continue
        worst = _over(each, config).max(axis=1)
        row = int(np.argmax(worst))
        if worst[row] > longest:
            text = f"{worst[row]:g} mm beyond the limits: that is over the machine's travel of {longest:g} mm, and nothing else is judged"
            return Check("travel", False, float(worst[row]), 0.0, "mm", each.where(row), text)
    return None


def _over(nc: NCProgram, config: Config) -> Floats:
    """How far each motion goes beyond the limits of each axis (B, 3), mm; negative within them."""
    low, high = extremes(nc)
    machine = config.machine
    over = np.fmax(np.array(machine.travel_min_mm) - low, high - np.array(machine.travel_max_mm))
    return np.asarray(np.nan_to_num(over, nan=-np.inf, posinf=np.inf), np.float64)


def _travel(nc: NCProgram, config: Config) -> Check:
    over = _over(nc, config)
    rows = np.arange(len(nc))
    worst = over.max(axis=1)
    found = worst_check("travel", nc, rows, worst, LIMIT_ROUNDING_MM, "mm", "beyond the travel limits")
    axis = "XYZ"[int(np.argmax(over[int(np.argmax(worst))]))] if len(nc) else ""
    margin = -found.value if found.passed else found.value
    text = f"{margin:g} mm of {axis} {'left' if found.passed else 'beyond the limits'}, on the true curve"
    return Check("travel", found.passed, found.value, 0.0, "mm", found.where, text)


def _beam(nc: NCProgram) -> Check:
    faults = row_faults(nc, nc.beam & (nc.kind == RAPID), "beam is on during a rapid motion")
    marked = (nc.ring >= 0) | (nc.island >= 0)
    faults += row_faults(nc, ~nc.beam & (nc.kind != RAPID) & marked, "beam is off along a deposit")
    faults += switch_faults(nc, Kind.BEAM_ON, Kind.BEAM_OFF, "beam")
    return count_check("beam", faults, "off in every rapid and layer change, each on has its off")


def _wire(nc: NCProgram) -> Check:
    faults = row_faults(nc, nc.wire & ~nc.beam, "wire runs while the beam is off")
    faults += row_faults(nc, nc.wire & (nc.kind == RAPID), "wire runs during a rapid motion")
    marked = (nc.ring >= 0) | (nc.island >= 0)
    faults += row_faults(nc, ~nc.wire & (nc.kind != RAPID) & marked, "wire stands along a deposit")
    faults += switch_faults(nc, Kind.WIRE_START, Kind.WIRE_STOP, "wire")
    off = (nc.events.kind == Kind.BEAM_OFF) & nc.events.wire[:-1]
    faults += event_faults(nc, (off, "beam goes off before the wire stops"))
    return count_check("wire", faults, "runs under the beam alone, stops before it")


def _turns(nc: NCProgram, limit_mm: float) -> Check:
    rows = np.flatnonzero(nc.turn & nc.deposit)
    # Positions are rounded to the program's decimals; six is the coarsest that matters here.
    return worst_check(
        "turns", nc, rows, nc.lengths[rows], limit_mm + 1e-6, "mm", "longest turn between hatch lines"
    )
