"""Check of the words of the motions that lay metal: a program that names X and Y in every block names them in each.

An axis that is left out stays where it was: a word that was lost leaves a motion that every control drives, to a wrong place.
Programs of another form, in which blocks name what changes, show no such loss and are left out.
"""

from __future__ import annotations

import re

import numpy as np

from ebamcheck.program.checking.checks import Check, count_check
from ebamcheck.program.reading.motions import RAPID, NCProgram

NAME = "words of motions"

_ASIDE = re.compile(rb"\([^)]*\)|;.*")
"""Comments, and the lists of a polynomial, whose axis stands before them."""

MOST_WHOLE = 0.9
"""Share of the blocks with metal that name both axes from which on it is the form of the program to do so."""


def words_check(nc: NCProgram) -> Check:
    """Check that no block of a bead lacks an axis that nearly all others name."""
    metal = np.flatnonzero(nc.deposit & (nc.kind != RAPID))
    places = sorted(set(zip(nc.file[metal].tolist(), nc.line[metal].tolist(), strict=True)))
    lines = [file.data.split(b"\n") for file in nc.files]
    lacking = []
    for file, line in places:
        code = _ASIDE.sub(b"", lines[file][line - 1]).upper()
        absent = [axis for axis in "XY" if axis.encode() not in code]
        if absent:
            lacking.append((f"{nc.files[file].name}:{line}", f"names no {' and no '.join(absent)}"))
    whole = len(places) - len(lacking)
    if whole < MOST_WHOLE * len(places):
        return count_check(
            NAME, [], f"{whole} of {len(places)} blocks of beads name X and Y: no form of the program"
        )
    faults = [(where, f"{what}, as the {whole} other blocks of beads do") for where, what in lacking]
    return count_check(NAME, faults, f"{len(places)} blocks of beads name X and Y")
