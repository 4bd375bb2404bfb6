"""Checks of the form of a hatch, from the text alone: lines driven to and fro are parallel and evenly apart, and no bead crosses another."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import shapely
from shapely.ops import substring

from ebamcheck.checks.checks import TWO_PLACES_MM, count_check
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.motions import RAPID, STRAIGHT, NCProgram
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import TURN_SPACINGS
from ebamcheck.threads import run_each

LINES, CROSSINGS = "hatch lines", "crossings"  # Names of the checks
CHORD_MM = 0.5  # Chords of curved beads
PARALLEL = 1e-3  # Sine of the angle between lines of one direction
TO_AND_FRO = 1.0 / 3.0  # Share of a bead's length along one direction from which on it is lines to and fro
WIDEST_SPACINGS = 1.3  # Of neighbouring lines to and fro; a bead that comes back further away follows a wall
LEAST_TURN = -math.cos(math.radians(15.0))  # Of a bead that turns back on its track; sound turns have 26
# Cosine of a joint that is a bend, and bends in a row that follow a wall: a line out of place has two.
GENTLE, MANY = 0.5, 3
FINE, SKEW, UNEVEN, BACK = 0, 1, 2, 3
AT_ONCE = 1_000_000  # Pairs of lines that are held at once


def form_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check the form of all hatch beads, and that no bead crosses itself or another of its layer."""
    # Lines of beads driven to and fro: each parallel to the others, joined by one turn, all the same distance apart.
    spacing = config.process.hatch_spacing_mm
    first, starts, way = _whole_lines(nc)
    state, at = form_of(first, nc.start[starts, :2], way, spacing)
    known = np.flatnonzero(state != FINE)
    said = {SKEW: "is neither parallel to the lines of its bead nor a turn between two of them",
            UNEVEN: "lies nearer to the line before than the others of its bead, or further away",
            BACK: "turns back on the track of the one before"}  # fmt: skip
    faults = [(nc.where(int(starts[at[i]])), f"this motion {said[int(state[i])]}") for i in known.tolist()]
    good = f"{first.size - 1} beads of hatch: lines to and fro are parallel and evenly apart"
    # Where a hatch bead runs across another it lays metal on metal. One that ends or turns within half its width of another does so in
    # the pool of that, and does not cross it.
    placed = np.isfinite(nc.start).all(axis=1) & np.isfinite(nc.end).all(axis=1)
    rows = np.flatnonzero(nc.deposit & (nc.kind != RAPID) & placed & (nc.layer >= 0))
    bead, pool_mm = nc.beads.group, 0.5 * config.process.bead_width_mm
    layers = range(len(nc.layer_files)) if rows.size else ()
    crossed = run_each(lambda k: _crossed(nc, rows[nc.layer[rows] == k], bead, pool_mm), layers)
    found = sorted({row for layer in crossed for row in layer})
    crossings = [(nc.where(row), "runs across a bead of its own layer") for row in found]
    return [
        count_check(LINES, faults, good),
        count_check(CROSSINGS, crossings, "no bead runs across another of its layer"),
    ]


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


def form_of(first: Ints, start: Floats, way: Floats, spacing: float) -> tuple[Ints, Ints]:
    """Form of each bead: whether its lines are to and fro and evenly so, (P,), and the line where they are not (P,)."""
    sizes = np.diff(first)
    state, at = np.zeros(sizes.size, np.int64), np.zeros(sizes.size, np.int64)
    for size in np.unique(sizes[sizes > 1]).tolist():
        alike, many = np.flatnonzero(sizes == size), max(AT_ONCE // size**2, 1)
        for some in np.split(alike, range(many, alike.size, many)):
            lines = first[some][:, None] + np.arange(size)
            state[some], place = _forms(start[lines], way[lines], spacing)
            at[some] = np.where(place >= 0, lines[:, 0] + place, 0)
    return state, at


def _forms(start: Floats, way: Floats, spacing: float) -> tuple[Ints, Ints]:
    """Form (m,) of beads of as many lines (m, n, 2) each, and the line at fault (m,), -1 for none."""
    length = np.sqrt(way[..., 0] ** 2 + way[..., 1] ** 2)
    back = _first(_turned_back(way, length))
    if way.shape[1] < 3:
        return np.where(back >= 0, BACK, FINE), back
    # Whether lines i and k (m, n, n) of a bead have one direction, as far as their rounded ends can tell.
    x, y, one, other = way[..., 0], way[..., 1], length[:, :, None], length[:, None, :]
    across = np.abs(x[:, :, None] * y[:, None, :] - y[:, :, None] * x[:, None, :])
    parallel = np.asarray(across <= PARALLEL * one * other + TWO_PLACES_MM * np.maximum(one, other))
    # The longest line of the direction that most of a bead has, and how much of it that is, mm.
    share = np.cumsum(np.where(parallel, length[:, None, :], 0.0), axis=2)[..., -1]
    most = share.max(axis=1)
    main = np.where(share == most[:, None], length, -1.0).argmax(axis=1)
    bead = np.arange(main.size)
    along, longest = parallel[bead, main], TURN_SPACINGS * spacing + TWO_PLACES_MM
    to = start - start[bead, main][:, None]
    ahead, mains_mm = way[bead, main][:, None], length[bead, main][:, None]
    offset = (ahead[..., 0] * to[..., 1] - ahead[..., 1] * to[..., 0]) / mains_mm
    aside = np.abs(ahead[..., 0] * way[..., 1] - ahead[..., 1] * way[..., 0]) / mains_mm
    # Two lines follow each other with one turn between, in opposite directions and side by side.
    step = np.abs(offset[:, 2:] - offset[:, :-2])
    fro = (way[:, 2:] * way[:, :-2]).sum(axis=2) < 0.0
    turn = (length[:, 1:-1] <= longest) & ~along[:, 1:-1] & along[:, 2:] & along[:, :-2]
    to_and_fro = (turn & fro & (step > TWO_PLACES_MM) & (step <= WIDEST_SPACINGS * spacing)).any(axis=1)
    judged = (back < 0) & to_and_fro & (most >= TO_AND_FRO * np.cumsum(length, axis=1)[:, -1])
    skew = _first(_skew(parallel, along, length <= longest, aside >= 0.5 * spacing))
    uneven = _first(_uneven(along, offset, mains_mm))
    index = np.arange(length.shape[1] - 1)
    gentle = (way[:, :-1] * way[:, 1:]).sum(axis=2) >= GENTLE * length[:, :-1] * length[:, 1:]
    bends = np.cumsum(gentle & ~parallel[:, index, index + 1], axis=1)
    before = np.concatenate([np.zeros((len(bends), 1), bends.dtype), bends], axis=1)
    lie = judged & ((skew < 0) | np.asarray((before[:, MANY:] - before[:, :-MANY] == MANY).any(axis=1)))
    state = np.where(back >= 0, BACK, np.where(lie, UNEVEN, np.where(judged, SKEW, FINE)))
    place = np.where(back >= 0, back, np.where(lie, uneven, np.where(judged, skew, -1)))
    return np.where(place >= 0, state, FINE), place


def _first(which: Bools) -> Ints:
    """Index (m,) of the first that is true of each row (m, n); -1 for none."""
    return np.where(which.any(axis=1), which.argmax(axis=1), -1)


def _turned_back(way: Floats, length: Floats) -> Bools:
    """Lines (m, n) that go back on the one before."""
    back = np.zeros(length.shape, np.bool_)
    known = np.minimum(length[:, :-1], length[:, 1:]) > 10.0 * TWO_PLACES_MM
    along = (way[:, :-1] * way[:, 1:]).sum(axis=2)
    back[:, 1:] = known & (along < LEAST_TURN * length[:, :-1] * length[:, 1:])
    return back


def _skew(parallel: Bools, along: Bools, short: Bools, aside: Bools) -> Bools:
    """Lines (m, n) that are neither along the main line, nor along any other, nor a turn between two."""
    # Short motions before the first line along it and behind the last one follow a wall or fill a bare spot, and lie as that does; but a
    # single one that goes half a spacing aside is a turn whose line is missing.
    count = along.shape[1]
    index, low = np.arange(count), along.argmax(axis=1)[:, None]
    high = count - 1 - along[:, ::-1].argmax(axis=1)[:, None]
    inside, alone = (low < index) & (index < high), (index == 0) & (low == 1)
    alone |= (index == count - 1) & (high == count - 2)
    behind = np.ones(along.shape, np.bool_)
    behind[:, 1:] = along[:, :-1]
    mated = (behind & inside & short) | (parallel.sum(axis=2) > parallel[:, index, index])
    return np.asarray(~along & np.where(short & ~inside, alone & aside, ~mated))


def _uneven(along: Bools, offset: Floats, mains_mm: Floats) -> Bools:
    """Lines (m, n) along the main one whose distance from the line before differs from that of the lines before."""
    before = _before(along)
    step = np.abs(offset - np.take_along_axis(offset, np.maximum(before, 0), axis=1))
    beside = along & (before >= 0) & (before < np.arange(along.shape[1]) - 1) & (step > 2.0 * TWO_PLACES_MM)
    last = _before(beside)
    pitch = np.take_along_axis(step, np.maximum(last, 0), axis=1)
    return np.asarray(
        beside & (last >= 0) & (np.abs(step - pitch) > 2.0 * TWO_PLACES_MM + PARALLEL * mains_mm)
    )


def _before(which: Bools) -> Ints:
    """Index (m, n) of the last one before each that is true; -1 for none."""
    index = np.maximum.accumulate(np.where(which, np.arange(which.shape[1]), -1), axis=1)
    return np.concatenate([np.full((len(which), 1), -1), index[:, :-1]], axis=1)


def _crossed(nc: NCProgram, rows: Ints, bead: Ints, pool_mm: float) -> list[int]:
    """Later motion of each pair that crosses, hatch at least one of them; `bead` (B,) is that of each motion."""
    owner, segments = nc.chords(rows, CHORD_MM)
    moves = (segments[:, :2] != segments[:, 2:]).any(axis=1)
    owner, segments = owner[moves], segments[moves]
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
