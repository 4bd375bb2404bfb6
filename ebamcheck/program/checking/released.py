"""Check of a layer that is called by itself: its file sets what it needs, comes from above, and leaves nothing on.

A main program that waits between layers calls one file after the other. What its own main program sets before the call, or does
after it, does not happen then: values are those that the layer below has left, and the tool stands where that one ended, for as
long as it takes until the next layer is released.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from ebamcheck.program.checking.checks import Check, count_check, event_place
from ebamcheck.program.language.codes import BEAM_VALUES
from ebamcheck.program.reading.motions import RAPID, NCProgram
from ebamcheck.settings.config import Config

NAME = "layer by itself"

RELEASED = re.compile(r"_K\d{4,}R\d+$")
"""End of the name of a layer that is made between layers."""

PLACE_MM = 2e-3
"""Heights are rounded to the decimals of a program, at their coarsest."""

NEEDS = {"beam_on": BEAM_VALUES, "wire_start": ("wire_mm_s",)}
"""Values that have to be set before a switch."""


def released_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check the files of a layer that is called by itself; nothing for a whole program."""
    if not RELEASED.search(config.machine.program_name):
        return []
    # The table's ways are none of the part.
    full = nc if nc.machine is None else nc.machine
    called = [file for file in np.unique(full.file[full.beam]).tolist() if file > 0]
    faults = [fault for file in called for fault in (*_values(full, file), *_ways(full, file, config))]
    return [
        count_check(NAME, faults, "its file sets its values, comes from above, and ends clear of it, all off")
    ]


def _values(nc: NCProgram, file: int) -> Iterator[tuple[str, str]]:
    """Switches before which the file has not set what holds then, and those that are left on at its end."""
    used = {name for name in nc.events.name if name in (*BEAM_VALUES, "wire_mm_s")}
    known, on = set[str](), dict[str, str]()
    for i, name in enumerate(nc.events.name):
        if nc.events.file[i] != file:
            continue
        known.add(name)
        lacking = [value for value in NEEDS.get(name, ()) if value in used and value not in known]
        if lacking:
            yield (
                event_place(nc, i),
                f"{name} before the file has set {lacking[0]}: the layer below has left another",
            )
        if name in NEEDS:
            on[name] = event_place(nc, i)
        elif name in ("beam_off", "wire_stop"):
            on.pop("beam_on" if name == "beam_off" else "wire_start", None)
    for name, where in on.items():
        yield where, f"{name} is not taken back within the file"


def _ways(nc: NCProgram, file: int, config: Config) -> Iterator[tuple[str, str]]:
    """A first way that does not rise by itself, and an end within the clearance over the layer."""
    rows = np.flatnonzero(nc.file == file)
    first, last = int(rows[0]), int(rows[-1])
    still = np.array_equal(nc.start[first, :2], nc.end[first, :2], equal_nan=True)
    if nc.kind[first] != RAPID or not still:
        yield (
            nc.where(first),
            "the file does not begin with a rise: the tool stands at a height that it does not know",
        )
    if nc.table is not None:
        return  # Heights are those of the axes: the checks of the table have them.
    clear_mm = config.machine.clearance_mm - PLACE_MM
    if not nc.end[first, 2] >= config.base_mm + clear_mm:
        yield (
            nc.where(first),
            f"begins at Z {nc.end[first, 2]:g} mm, on a layer that ends at {config.base_mm:g} mm",
        )
    top = float(np.fmax(nc.start[rows, 2], nc.end[rows, 2])[nc.deposit[rows]].max(initial=-np.inf))
    if not nc.end[last, 2] >= top + clear_mm:
        yield (
            nc.where(last),
            f"ends at Z {nc.end[last, 2]:g} mm, where the tool waits for the next layer: the beads end at {top:g} mm",
        )
