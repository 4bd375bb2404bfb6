"""Tools that all checks share: a check from faults or the worst of many values, tolerances that no setting changes, remedies."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.motions import NCProgram, SourceFile
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.threads import run_in_order

PLACE_MM = 1e-3  # Places and heights nearer than this are one: three decimals are the fewest of a program
TWO_PLACES_MM = 2.0 * PLACE_MM  # Distance of two places of which each is rounded to the decimals of a program
VALUE_SHARE = 1e-3  # Share by which a printed value may be off: volts, milliamperes, feeds, wire speeds
WINDOW_SHARE = 1e-5  # The same at the border of a window: process values have six decimals in a program
PRINTED = 1e-6  # Last decimal of a process value, of a wait, and of heights in comments
PATH_TOLERANCE_MM = 1e-3  # Path read back against the fitted curve: a tenth of what a slicer agrees to
SECTION_TOLERANCE_MM = 0.05  # Contours against the section: fit of curves, and round corners of insets
WIRE_TOLERANCE = 0.01  # Metal of a bead over what is asked for: the decimals of wire speed and feed
SAME_LINE_MM = 0.01  # Lines nearer than this, along one another, are one laid twice: far under a spacing
COLLINEAR_MM = 1e-3  # Points nearer to the chord of their neighbours are made by facets that were cut
SLIT_MM = 1e-3  # Width up to which a slit is what rounding left of a face that two bodies share
DIRECTION_ROUNDING_DEG = 0.01  # Of a line of a few tenths of a millimetre whose ends are rounded to decimals
LIMIT_ROUNDING_MM = 1e-9  # Rounding of a curve's extreme
SAME_SIZE = 1e-4  # Share of its size by which a part may be off: coordinates of an STL file have seven digits
SAME_AREA = 1e-3  # Share of the greatest section by which mesh and slicer differ only where bodies overlap
WIRE_PLACE_MM = 0.2  # Shift of a change of wire that curve forms and rounded ends of blocks cause

# What to do about a check that fails: texts that several checks, and findings, have in common.
AGAIN = "make the program again (ebamcheck run); a text that was edited by hand is checked with ebamcheck verify"
PROFILE = "set the machine's own codes in the templates (ebamcheck config, section machine)"
NARROWER = (
    "use a narrower bead (process.bead_width_mm, with layers.layer_height_mm as it is and a process.current_ma that goes with "
    "the square of the width)"
)
COARSE = (
    f"allow for machining (process.machining_allowance_mm), {NARROWER}, or build in another direction (part.direction)"
)
# Of a wall that no bead of the process is narrow enough for.
TOO_THIN = (
    "allow for machining (process.machining_allowance_mm), make the wall thicker in the model, or build in another direction "
    "(part.direction)"
)
FIT = "fit more closely (curves.tolerance_mm, curves.method), or export the mesh more finely"
HATCH = "change the spacing (process.bead_spacing), the side of the cells (scan.hexagon_side_mm) or scan.gap_width"
HOLE = f"machine the hole afterwards and close it in the model, or {NARROWER}"
FLAT = (
    "machine it afterwards and close it in the model, or lay thinner layers (layers.layer_height_mm), build in another direction "
    "(part.direction), or set a least width under it (process.least_hole_mm, least_wall_mm)"
)
LEVELS = (
    "choose layers.layer_height_mm so that level faces fall on borders of layers, move those faces in the model, or, for metal "
    "that is too much, allow for machining (process.machining_allowance_mm)"
)
COOL = 'wait and lower the power (process.interpass = "both"), or raise process.interpass_limit_k'
MISTAKE = (
    "no setting mends it: this program has a mistake in reading, slicing, layers or heat model; report it with the part"
)
OFF_MESH = f"mend the mesh, or the slicer, where the gate input or agreement is shut; where both are open, {MISTAKE}"
WINDOW = "bring wire, feed, power and layer height into the process window (section process)"
LEVEL = f"give layers of one height (layers.layer_height_mm), then {AGAIN}"
# Of a check that a plugin brought.
OTHERWISE = "look at that line of the program, and at the settings that the text names"

Faults = list[tuple[str, str]]  # Where (``FILE:line``), and what


def smooth_tolerance_mm(config: Config) -> float:
    """Tolerance of the path against a smooth section that was sliced, cleaned and fitted anew, as the bead's path was, too."""
    curves = config.curves
    return SECTION_TOLERANCE_MM + 2.0 * curves.tolerance_mm + curves.near_point_mm + curves.collinear_mm


def checks_of(groups: Sequence[Callable[[], Sequence[Check]]]) -> list[Check]:
    """Make all groups of checks, on all threads; results come in the order of the groups."""
    last = len(groups) - 1
    found = list(run_in_order(lambda k, _: groups[last - k](), range(len(groups) + 1)))
    return [check for group in reversed(found) for check in group]


def count_check(name: str, places: Faults, good: str) -> Check:
    """Check that there is no fault; `places` are the faults, in order."""
    if not places:
        return Check(name, True, 0.0, 0.0, "faults", "", good)
    where, what = places[0]
    more = f" (and {len(places) - 1} more)" if len(places) > 1 else ""
    return Check(name, False, float(len(places)), 0.0, "faults", where, what + more)


def limit_check(
    name: str, value: float, limit: float, unit: str, text: str, where: str = "", layer: int | None = None,
    at: Sequence[float] | Floats = (), remedy: str = "",
) -> Check:  # fmt: skip
    """Check that the worst value, found at X and Y `at`, is not over its limit; NaN counts as over it."""
    x_mm, y_mm = (float(at[0]), float(at[1])) if len(at) else (None, None)
    passed, value = bool(value <= limit), float(value)
    return Check(name, passed, value, limit, unit, where, text, layer, x_mm, y_mm, remedy=remedy)


def worst_check(name: str, nc: NCProgram, rows: Ints, values: ArrayLike, limit: float, unit: str, what: str) -> Check:
    """Check that no value is over the limit; NaN counts as infinite."""
    values = np.asarray(values, dtype=np.float64)
    if not values.size:
        return Check(name, True, 0.0, limit, unit, "", f"{what}: nothing to check")
    known = np.where(np.isnan(values), np.inf, values)
    worst = int(np.argmax(known))
    told = f"at most {known[worst]:.6g} {unit}" if np.isfinite(known[worst]) else "not known"
    return limit_check(name, known[worst], limit, unit, f"{what}: {told}", nc.where(int(rows[worst])))


def row_faults(nc: NCProgram, rows: Bools | Ints, what: str, *values: ArrayLike) -> Faults:
    """Faults of motions that are wrong for the same reason `what`, which is filled with their `values`, (n,) each."""
    index = np.flatnonzero(rows) if np.asarray(rows).dtype == np.bool_ else np.asarray(rows)
    each = zip(index.tolist(), *(np.asarray(column).tolist() for column in values), strict=True)
    return [(nc.where(row), what.format(*filled)) for row, *filled in each]


def event_faults(nc: NCProgram, *rules: tuple[Bools, str | Callable[[int], str]]) -> Faults:
    """Events (E,) that break rules, in their order; of one that breaks several the first rule is named first. A rule's text is
    filled with their ``name``, ``value`` and what they ``said`` behind their begin, or is a function of the event."""
    found = sorted((i, n) for n, (which, _) in enumerate(rules) for i in np.flatnonzero(which).tolist())
    e, faults = nc.events, []
    for i, n in found:
        text = rules[n][1]
        what = text(i) if callable(text) else text.format(name=e.name[i], value=e.value[i], said=e.said(i))
        faults.append((nc.where_event(i), what))
    return faults


def place_of(file: SourceFile, offset: int) -> str:
    """``FILE:line`` of a byte of a file."""
    line = file.data.count(b"\n", 0, offset) + 1
    return f"{file.name}:{line}"


def lines_of(nc: NCProgram, rows: Ints) -> list[tuple[int, int]]:
    """File and line, from 1, of motions: each once, in the order of the text."""
    lines = 1 + int(nc.line[rows].max(initial=0))
    file, line = np.divmod(np.unique(nc.file[rows].astype(np.int64) * lines + nc.line[rows]), lines)
    return list(zip(file.tolist(), line.tolist(), strict=True))
