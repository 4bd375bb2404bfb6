"""Check of the words of motions: a program that names X and Y in every block of metal, or in every rapid across, names them in each.

An axis that is left out stays where it was: a word that was lost leaves a motion that every control drives, to a wrong place;
and a way that was lost leaves the tool over the last bead. Programs of another form, in which blocks name what changes, show no such loss and are left out.
"""

from __future__ import annotations

import re

import numpy as np

from ebamcheck.checks.checks import Check, count_check, lines_of
from ebamcheck.nc.motions import RAPID, NCProgram

NAME = "words of motions"

_ASIDE = re.compile(rb"\([^)]*\)|;.*")
"""Comments, and the lists of a polynomial, whose axis stands before them."""

_PLAIN = re.compile(rb"[^(;XY]*X[^(;XY]*Y")
"""The form of nearly all blocks of metal, which name both axes; of others :func:`_absent` tells what they lack."""

MOST_WHOLE = 0.9
"""Share of the blocks with metal that name both axes from which on it is the form of the program to do so."""

LEAST_WHOLE = 4
"""Rapids across for each that names one axis alone, from which on it is the form of the program to name both."""

FEW = 2
"""So many beads without a way are a loss in a program of any size."""


def words_check(nc: NCProgram) -> Check:
    """Check that no block of a bead lacks an axis that nearly all others name, and no way to a bead lacks its place or half of it."""
    lines = [file.data.split(b"\n") for file in nc.files]
    text = f"{len(nc)} motions name X and Y as the others do"
    blocks = _blocks(nc, lines)
    # Where blocks of metal name what changes, rapids may, too.
    faults = _ways(nc, lines) if blocks is None else [*blocks, *_half_ways(nc, lines), *_ways(nc, lines)]
    return count_check(NAME, faults, text)


def _blocks(nc: NCProgram, lines: list[list[bytes]]) -> list[tuple[str, str]] | None:
    """Blocks of metal that lack an axis; None of a program in which blocks name what changes."""
    metal = np.flatnonzero(nc.deposit & (nc.kind != RAPID))
    places = lines_of(nc, metal)
    lacking = [
        (file, line, absent)
        for file, line in places
        if not _PLAIN.match(block := lines[file][line - 1]) and (absent := _absent(block))
    ]
    whole = len(places) - len(lacking)
    if whole < MOST_WHOLE * len(places):
        return None
    return [
        (
            f"{nc.files[file].name}:{line}",
            f"names no {' and no '.join(absent)}, as {whole} other blocks of beads do",
        )
        for file, line, absent in lacking
    ]


def _half_ways(nc: NCProgram, lines: list[list[bytes]]) -> list[tuple[str, str]]:
    """Rapids that name one axis of the plane, where nearly all others name both: the bead behind one begins elsewhere."""
    rows = np.flatnonzero((nc.kind == RAPID) & (nc.layer >= 0))
    absent = [(place, _absent(lines[place[0]][place[1] - 1])) for place in lines_of(nc, rows)]
    across = [(place, axes) for place, axes in absent if axes != ["X", "Y"]]
    half = [(place, axes) for place, axes in across if axes]
    if len(half) > max(FEW, (1.0 - MOST_WHOLE) * len(across)) or len(across) < LEAST_WHOLE * len(half):
        return []  # A program in which blocks name what changes.
    return [
        (
            f"{nc.files[file].name}:{line}",
            f"a rapid names no {axes[0]}, as {len(across) - len(half)} others do",
        )
        for (file, line), axes in half
    ]


def _ways(nc: NCProgram, lines: list[list[bytes]]) -> list[tuple[str, str]]:
    """Beads to which the tool rises and descends without a rapid in X or Y between."""
    beads = nc.beads
    before = np.concatenate([[-1], beads.last[:-1]]) if len(beads) else beads.last
    bare, hops = [], 0
    for after, first in zip(before.tolist(), beads.first.tolist(), strict=True):
        rapids = [row for row in range(after + 1, first) if nc.kind[row] == RAPID]
        codes = [lines[nc.file[row]][nc.line[row] - 1] for row in rapids]
        hops += bool(codes)
        if codes and all(_absent(code) == ["X", "Y"] for code in codes):
            bare.append(
                (nc.where(first), "is reached by a rise and a descent on one spot: the way to it is missing")
            )
    return bare if len(bare) <= max(FEW, (1.0 - MOST_WHOLE) * hops) else []


def _absent(line: bytes) -> list[str]:
    """Axes of the plane that a block does not name."""
    if b";" in line or b"(" in line:
        line = _ASIDE.sub(b"", line)
    code = line.upper()
    if b"X" in code and b"Y" in code:
        return []
    return [axis for axis in "XY" if axis.encode() not in code]
