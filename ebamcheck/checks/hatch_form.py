"""Checks of the form of a hatch, from the text alone: lines driven to and fro are parallel and evenly apart, and no bead crosses another.

A line that ends where it should not, a block that is missing, or two that changed places leave the metal of a layer within its
limits more often than not: a pool is wider than the slip. The form of the hatch shows them. Beads that follow a wall have none
and are left out.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import shapely
from shapely.ops import substring

from ebamcheck.checks.checks import Check, count_check
from ebamcheck.checks.tolerances import TWO_PLACES_MM
from ebamcheck.nc.motions import RAPID, STRAIGHT, NCProgram
from ebamcheck.numeric.kernels import kernel, run_each
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import TURN_SPACINGS

LINES, CROSSINGS = "hatch lines", "crossings"
"""Names of the checks."""

CHORD_MM = 0.5
"""Chords of curved beads."""

PARALLEL = 1e-3
"""Sine of the angle between lines of one direction."""

TO_AND_FRO = 1.0 / 3.0
"""Share of a bead's length along one direction from which on it is taken for lines to and fro."""

WIDEST_SPACINGS = 1.3
"""Neighbouring lines to and fro are at most this many spacings apart; a bead that comes back further away follows a wall."""

LEAST_TURN = -math.cos(math.radians(15.0))
"""Cosine of the angle between two motions of a bead from which on it turns back on its own track. A turn of 1.5 spacings between
lines that are two thirds of a spacing apart, the least that a plan leaves, comes to 26 degrees."""

GENTLE, MANY = 0.5, 3
"""Cosine of the angle of a joint that is a bend, not a turn, and how many of them in a row show that a bead follows a wall: a line
that is out of its place has two."""

FINE, SKEW, UNEVEN, BACK = 0, 1, 2, 3


def form_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check the form of all hatch beads, and that no bead crosses itself or another of its layer."""
    return [_lines(nc, config), _crossings(nc, 0.5 * config.process.bead_width_mm)]


# -- lines to and fro -------------------------------------------------------------------------------


def _lines(nc: NCProgram, config: Config) -> Check:
    """Lines of beads driven to and fro: each parallel to the others, joined by one turn, all the same distance apart."""
    spacing = config.process.hatch_spacing_mm
    first, starts, way = _whole_lines(nc)
    state, at = form_of(first, nc.start[starts, :2], way, spacing)
    known = np.flatnonzero(state != FINE)
    said = {SKEW: "is neither parallel to the lines of its bead nor a turn between two of them",
            UNEVEN: "lies nearer to the line before than the others of its bead, or further away",
            BACK: "turns back on the track of the one before"}  # fmt: skip
    faults = [(nc.where(int(starts[at[i]])), f"this motion {said[int(state[i])]}") for i in known.tolist()]
    return count_check(
        LINES, faults, f"{first.size - 1} beads of hatch: lines to and fro are parallel and evenly apart"
    )


def _whole_lines(nc: NCProgram) -> tuple[Ints, Ints, Floats]:
    """Lines of straight hatch beads, parts at other power or wire taken together: first of each bead (P + 1,), first motion (n,), way (n, 2)."""
    beads = nc.beads
    curved = beads.any(nc.kind[beads.rows] != STRAIGHT)
    mine = ~curved[beads.bead] & (nc.island[beads.rows] >= 0)
    rows, bead = beads.rows[mine], beads.bead[mine]
    begins = ~nc.goes_on[rows]
    begins[:1] = True
    begins[1:] |= np.diff(bead) != 0
    at = np.flatnonzero(begins)
    last = rows[np.append(at[1:], rows.size) - 1] if rows.size else rows
    row, bead = rows[at], bead[at]
    way = nc.end[last, :2] - nc.start[row, :2]
    moves = np.hypot(way[:, 0], way[:, 1]) > 0.0
    row, way, bead = row[moves], way[moves], bead[moves]
    first = np.append(np.flatnonzero(np.diff(bead, prepend=-1)), bead.size)
    return first.astype(np.int64), row, np.ascontiguousarray(way)


@kernel
def _parallel(way: Floats, length: Floats, i: int, j: int) -> bool:
    """Whether two lines have one direction, as far as their rounded ends can tell."""
    across = abs(way[i, 0] * way[j, 1] - way[i, 1] * way[j, 0])
    slack = PARALLEL * length[i] * length[j] + TWO_PLACES_MM * max(length[i], length[j])
    return bool(across <= slack)


@kernel
def _offset(start: Floats, way: Floats, length: Floats, j: int, i: int) -> float:
    """Distance of the start of line i across line j."""
    dx, dy = start[i, 0] - start[j, 0], start[i, 1] - start[j, 1]
    return float((way[j, 0] * dy - way[j, 1] * dx) / length[j])


@kernel
def _turned_back(way: Floats, length: Floats, a: int, b: int) -> int:
    """First line of a bead that goes back on the one before; -1 for none."""
    for i in range(a + 1, b):
        along = way[i - 1, 0] * way[i, 0] + way[i - 1, 1] * way[i, 1]
        known = min(length[i - 1], length[i]) > 10.0 * TWO_PLACES_MM
        if known and along < LEAST_TURN * length[i - 1] * length[i]:
            return i
    return -1


@kernel
def _main_line(way: Floats, length: Floats, a: int, b: int) -> int:
    """Longest line of the direction that most of a bead has; -1 where no direction has enough of it."""
    best, most = a, 0.0
    for i in range(a, b):
        along = 0.0
        for k in range(a, b):
            along += length[k] if _parallel(way, length, i, k) else 0.0
        if along > most or (along == most and length[i] > length[best]):
            best, most = i, along
    return best if most >= TO_AND_FRO * length[a:b].sum() else -1


@kernel
def _goes_to_and_fro(
    start: Floats, way: Floats, length: Floats, a: int, b: int, j: int, spacing: float
) -> bool:
    """Whether two lines along line j follow each other with one turn between, in opposite directions and side by side."""
    for i in range(a + 2, b):
        turn = length[i - 1] <= TURN_SPACINGS * spacing + TWO_PLACES_MM and not _parallel(
            way, length, j, i - 1
        )
        if turn and _parallel(way, length, j, i) and _parallel(way, length, j, i - 2):
            opposite = way[i, 0] * way[i - 2, 0] + way[i, 1] * way[i - 2, 1] < 0.0
            step = abs(_offset(start, way, length, j, i) - _offset(start, way, length, j, i - 2))
            if opposite and TWO_PLACES_MM < step <= WIDEST_SPACINGS * spacing:
                return True
    return False


@kernel
def _skew(way: Floats, length: Floats, a: int, b: int, j: int, spacing: float) -> int:
    """First line of a bead that is neither along line j, nor along any other, nor a turn between two; -1 for none.

    Short motions before the first line along j and behind the last one follow a wall or fill a bare spot, and lie as that
    does; but a single one that goes half a spacing aside is a turn whose line is missing.
    """
    longest = TURN_SPACINGS * spacing + TWO_PLACES_MM
    low, high = j, j
    for i in range(a, b):
        if _parallel(way, length, j, i):
            low, high = min(low, i), max(high, i)
    straight = True
    for i in range(a, b):
        if _parallel(way, length, j, i):
            straight = True
            continue
        short = length[i] <= longest
        mate = straight and low < i < high and short
        if short and not low < i < high:
            alone = i + 1 == low == a + 1 or i == high + 1 == b - 1
            aside = abs(way[j, 0] * way[i, 1] - way[j, 1] * way[i, 0]) / length[j]
            if alone and aside >= 0.5 * spacing:
                return i
            mate = True
        for k in range(a, b):
            mate = mate or (k != i and _parallel(way, length, i, k))
        if not mate:
            return i
        straight = False
    return -1


@kernel
def _follows_wall(way: Floats, length: Floats, a: int, b: int) -> bool:
    """Whether a bead bends gently at several joints one after the other, as along a wall."""
    bends = 0
    for i in range(a + 1, b):
        along = way[i - 1, 0] * way[i, 0] + way[i - 1, 1] * way[i, 1]
        gentle = along >= GENTLE * length[i - 1] * length[i] and not _parallel(way, length, i - 1, i)
        bends = bends + 1 if gentle else 0
        if bends == MANY:
            return True
    return False


@kernel
def _uneven(start: Floats, way: Floats, length: Floats, a: int, b: int, j: int) -> int:
    """First line along line j whose distance from the one before is another than that of those before; -1 for none."""
    before, pitch = -1, 0.0
    for i in range(a, b):
        if not _parallel(way, length, j, i):
            continue
        if 0 <= before < i - 1:
            step = abs(_offset(start, way, length, j, i) - _offset(start, way, length, j, before))
            if step > 2.0 * TWO_PLACES_MM:
                if pitch > 0.0 and abs(step - pitch) > 2.0 * TWO_PLACES_MM + PARALLEL * length[j]:
                    return i
                pitch = step
        before = i
    return -1


@kernel
def form_of(first: Ints, start: Floats, way: Floats, spacing: float) -> tuple[Ints, Ints]:
    """Form of each bead: whether its lines are to and fro and evenly so, (P,), and the line where they are not (P,)."""
    count = first.size - 1
    state, at = np.zeros(count, np.int64), np.zeros(count, np.int64)
    length = np.sqrt(way[:, 0] ** 2 + way[:, 1] ** 2)
    for bead in range(count):
        a, b = first[bead], first[bead + 1]
        kind, place = BACK, _turned_back(way, length, a, b)
        if place < 0 and b - a >= 3:
            j = _main_line(way, length, a, b)
            if j >= 0 and _goes_to_and_fro(start, way, length, a, b, j, spacing):
                kind, place = SKEW, _skew(way, length, a, b, j, spacing)
                if place < 0 or _follows_wall(way, length, a, b):
                    kind, place = UNEVEN, _uneven(start, way, length, a, b, j)
        if place >= 0:
            state[bead], at[bead] = kind, place
    return state, at


# -- crossings ----------------------------------------------------------------------------------------


def _crossings(nc: NCProgram, pool_mm: float) -> Check:
    """Places where a hatch bead runs across itself or another of its layer: metal on metal.

    A bead that ends or turns within half its width of another one does so in the pool of that, and does not cross it.
    """
    metal = (
        nc.deposit & (nc.kind != RAPID) & np.isfinite(nc.start).all(axis=1) & np.isfinite(nc.end).all(axis=1)
    )
    rows = np.flatnonzero(metal & (nc.layer >= 0))
    bead = nc.beads.group

    layers = range(len(nc.layer_files)) if rows.size else ()
    crossed = run_each(lambda k: _crossed(nc, rows[nc.layer[rows] == k], bead, pool_mm), layers)
    found = sorted({row for layer in crossed for row in layer})
    faults = [(nc.where(row), "runs across a bead of its own layer") for row in found]
    return count_check(CROSSINGS, faults, "no bead runs across another of its layer")


def _crossed(nc: NCProgram, rows: Ints, bead: Ints, pool_mm: float) -> list[int]:
    """Later motion of each pair that crosses, hatch at least one of them; `bead` (B,) is that of each motion."""
    owner, segments = _chords(nc, rows)
    if len(owner) < 2:
        return []
    lines = np.asarray(shapely.linestrings(segments.reshape(-1, 2, 2)), dtype=np.object_)
    mine = np.flatnonzero(nc.island[owner] >= 0)
    one, other = shapely.STRtree(lines).query(lines[mine], predicate="crosses")
    one = mine[one]
    apart = _apart(segments[one], segments[other])
    one, other = one[apart], other[apart]
    whole: dict[int, shapely.LineString] = {}
    for k in np.unique(bead[owner[np.concatenate([one, other])]]).tolist():
        chords = segments[bead[owner] == k]
        whole[k] = shapely.LineString(np.vstack([chords[:1, :2], chords[:, 2:]]))
    ends = bead[owner[np.column_stack([one, other])]].reshape(-1, 2).tolist()
    across = [i == j or _runs_across(whole[i], whole[j], pool_mm) for i, j in ends]
    return [int(row) for row in owner[np.maximum(one, other)][np.array(across, np.bool_)]]


def _runs_across(one: shapely.LineString, other: shapely.LineString, pool_mm: float) -> bool:
    """Whether each of two beads gets farther than a pool from the other on both sides of a place where they meet."""
    return _passes(one, other, pool_mm) and _passes(other, one, pool_mm)


def _passes(one: shapely.LineString, other: shapely.LineString, pool_mm: float) -> bool:
    """Whether one bead gets farther than a pool from the other both before and behind a place where they meet."""
    met = shapely.points(shapely.get_coordinates(shapely.intersection(one, other)))
    cuts = np.sort(shapely.line_locate_point(one, met))
    away = [
        float(
            shapely.distance(shapely.points(shapely.get_coordinates(piece.segmentize(CHORD_MM))), other).max()
        )
        for low, high in pairwise([0.0, *cuts.tolist(), one.length])
        if high > low
        for piece in [substring(one, low, high)]
    ]
    return any(min(before, after) > pool_mm for before, after in pairwise(away))


def _apart(one: Floats, other: Floats) -> Bools:
    """Pairs of segments (n, 4) that cross further from all their ends than what these are rounded by."""
    if not len(one):
        return np.zeros(0, np.bool_)
    lines = [np.asarray(shapely.linestrings(s.reshape(-1, 2, 2)), dtype=np.object_) for s in (one, other)]
    at = shapely.intersection(lines[0], lines[1])
    result = np.ones(len(one), np.bool_)
    for segments in (one, other):
        for end in (segments[:, :2], segments[:, 2:]):
            result &= np.asarray(shapely.distance(at, shapely.points(end))) > TWO_PLACES_MM
    return result


def _chords(nc: NCProgram, rows: Ints) -> tuple[Ints, Floats]:
    """Motion of each chord (S,), and its ends (S, 4): one for a straight motion, several for a curve."""
    curved = nc.kind[rows] != STRAIGHT
    straight = rows[~curved]
    owner, bent = nc.chords(rows[curved], CHORD_MM)
    segments = np.vstack([np.hstack([nc.start[straight, :2], nc.end[straight, :2]]), bent])
    every = np.concatenate([straight, owner])
    order = np.argsort(every, kind="stable")
    moves = (segments[order, :2] != segments[order, 2:]).any(axis=1)
    return every[order][moves], segments[order][moves]
