"""Which bead of a program is which of a plan: found by where they lie and in which order they come.

Beads and planned tracks of one layer with the same start and end are the same; what is left on both sides between two such pairs is
taken together in its order, and then by nearness. A bead without a track is one that nobody planned."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.spatial import cKDTree

from ebamcheck.checks.checks import PATH_TOLERANCE_MM, TWO_PLACES_MM, count_check, worst_check
from ebamcheck.geometry.nearest import nearest_segment, tree_over
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.nc.inputs import TrackColumns
from ebamcheck.nc.motions import Beads, NCProgram
from ebamcheck.nc.roles import nearest_layer
from ebamcheck.result import Check

APART_MM = 1e6  # Of layers in the space in which ends are compared: no bead is like one of another


@dataclass(frozen=True, eq=False)
class Matching:
    """Beads (P,) of a program, the track of a plan that each follows, and whether another bead follows it already."""

    beads: Beads
    track: Ints
    again: Bools
    path: TrackColumns


def matched(nc: NCProgram, path: TrackColumns) -> tuple[NCProgram, Matching]:
    """Give every bead the role of the track that it follows: its ring or island, turns and further parts of lines; none to one not
    planned."""
    beads = nc.beads
    known = np.flatnonzero(np.diff(path.track_starts) > 0)
    layer = np.repeat(np.arange(len(path.z)), np.diff(path.layer_starts))[known]
    ends = np.hstack([path.start[known], path.end[path.track_starts[known + 1] - 1]])
    found = np.hstack([nc.start[beads.first, :2], nc.end[beads.last, :2]])
    none = np.zeros(len(beads), np.int64)
    found_layer = nearest_layer(nc.end[beads.first, 2], path.z) if path.z.size else none
    alike = len(found) == len(ends) and (layer == found_layer).all()
    if alike and (np.abs(found - ends) <= TWO_PLACES_MM).all():
        pick, again = np.arange(len(ends)), np.zeros(len(ends), np.bool_)
    else:
        # Ends as points that are far apart in different layers.
        placed = (np.column_stack([found, APART_MM * found_layer]), np.column_stack([ends, APART_MM * layer]))
        pick, again = _pairs(*(np.nan_to_num(places, nan=-APART_MM) for places in placed))
    track = np.where(pick >= 0, np.append(known, -1)[pick], -1)
    result = Matching(beads, track, again, path)
    turn, goes_on = _marks(nc, result)
    ring, island = (beads.spread(np.append(of, -1)[track], len(nc)) for of in (path.ring, path.island))
    return replace(nc, ring=ring, island=island, turn=turn, goes_on=goes_on), result


def _pairs(found: Floats, wanted: Floats) -> tuple[Ints, Bools]:
    """Track (P,) of each bead, or -1; and the beads whose track is taken by one before."""
    pick, again = np.full(len(found), -1, np.int64), np.zeros(len(found), np.bool_)
    if not len(wanted) or not len(found):
        return pick, again
    taken = np.zeros(len(wanted), np.bool_)
    tree = cKDTree(wanted)
    for i, place in enumerate(found):
        near = np.sort(np.asarray(tree.query_ball_point(place, TWO_PLACES_MM, p=np.inf), np.int64)).tolist()
        free = [t for t in near if not taken[t]]
        if free:
            pick[i] = free[0]
            taken[free[0]] = True
        elif near:
            pick[i], again[i] = near[0], True
    # What is left between two pairs of neighbours is taken together, where it is as many beads as tracks.
    left, index = np.flatnonzero(pick < 0), np.arange(pick.size)
    before = np.maximum.accumulate(np.where(pick >= 0, index, -1))[left]
    after = np.minimum.accumulate(np.where(pick >= 0, index, pick.size)[::-1])[::-1][left]
    for low, high in dict.fromkeys(zip(before.tolist(), after.tolist(), strict=True)):
        mine = left[(before == low) & (after == high)]
        a = int(pick[low]) + 1 if low >= 0 else 0
        b = int(pick[high]) if high < pick.size else len(wanted)
        open_ = np.arange(a, max(a, b))
        open_ = open_[~taken[open_]]
        if open_.size == mine.size and (wanted[open_, 4] == found[mine, 4]).all():
            pick[mine], taken[open_] = open_, True
    # Each bead that is left is taken with the free track of its layer that starts or ends where it does.
    for i in np.flatnonzero(pick < 0).tolist():
        mine = np.flatnonzero(~taken & (wanted[:, 4] == found[i, 4]))
        apart = np.abs(wanted[mine, :4] - found[i, :4])
        away = np.minimum(apart[:, :2].max(axis=1, initial=0.0), apart[:, 2:].max(axis=1, initial=0.0))
        if mine.size and away.min() <= TWO_PLACES_MM:
            pick[i] = mine[np.argmin(away)]
            taken[pick[i]] = True
    return pick, again


def _marks(nc: NCProgram, match: Matching) -> tuple[Bools, Bools]:
    """Turns and further parts of lines, (B,) both: those of the segments that motions follow."""
    turn, goes_on = np.zeros(len(nc), np.bool_), np.zeros(len(nc), np.bool_)
    beads, path = match.beads, match.path
    one_by_one, rows, segment = _one_by_one(match)
    turn[rows], goes_on[rows] = path.turn[segment], path.goes_on[segment]
    other = np.flatnonzero(~one_by_one & (match.track >= 0))
    for i in other[np.append(path.island, -1)[match.track[other]] >= 0].tolist():
        mine = np.arange(beads.first[i], beads.last[i] + 1)
        a, b = (int(n) for n in path.track_starts[match.track[i] : match.track[i] + 2])
        begins = np.append(np.flatnonzero(~path.goes_on[a:b]), b - a) + a
        # Line (n,) from which the start, the middle and the end of each motion are least away in all.
        ends = np.stack([path.segment_start[begins[:-1]], path.end[begins[1:] - 1]], axis=1)
        lines = np.asarray(shapely.linestrings(ends), object)
        away = np.zeros((mine.size, lines.size))
        for place in (nc.start, 0.5 * (nc.start + nc.end), nc.end):
            points = np.asarray(shapely.points(np.nan_to_num(place[mine, :2])), object)
            away += np.asarray(shapely.distance(points[:, None], lines[None, :]))
        line = np.asarray(away.argmin(axis=1), np.int64)
        turn[mine] = path.turn[begins[line]]
        goes_on[mine] = (np.diff(line, prepend=-1) == 0) & ~turn[mine]
    return turn, goes_on


def _one_by_one(match: Matching) -> tuple[Bools, Ints, Ints]:
    """Beads (P,) with a motion for each segment of their track; these motions (n,) and the segments of each."""
    beads, path = match.beads, match.path
    count = np.bincount(beads.bead, minlength=len(beads))
    sizes = np.append(np.diff(path.track_starts), -1)[match.track]
    alike = count == sizes
    chosen = alike[beads.bead]
    rows, bead = beads.rows[chosen], beads.bead[chosen]
    first = np.append(path.track_starts[:-1], 0)[match.track]
    return alike, rows, first[bead] + rows - beads.first[bead]


def matching_checks(nc: NCProgram, match: Matching) -> list[Check]:
    """Check that every bead was planned, that none is missing or comes twice or too early, and that all hatch keeps to its
    track."""
    beads, track, path = match.beads, match.track, match.path
    known = np.flatnonzero(np.diff(path.track_starts) > 0)
    faults = [(int(beads.first[i]), "a bead that nobody planned") for i in np.flatnonzero(track < 0).tolist()]
    again = np.flatnonzero(match.again).tolist()
    faults += [(int(beads.first[i]), f"{_named(path, int(track[i]))} is laid a second time") for i in again]
    once = np.flatnonzero((track >= 0) & ~match.again)
    wrong = np.flatnonzero(track[once] != np.sort(track[once]))
    if wrong.size:
        i = int(once[wrong[0]])
        faults.append((int(beads.first[i]), f"{_named(path, int(track[i]))} comes out of its order"))
    for t in np.setdiff1d(known, track[once]).tolist():
        before = once[track[once] < t]
        row = int(beads.last[before[np.argmax(track[before])]]) if before.size else 0
        faults.append((row, f"{_named(path, t)} is missing"))
    faults.sort(key=lambda fault: fault[0])
    places = [(nc.where(row) if len(nc) else f"{nc.files[0].name}:1", what) for row, what in faults]
    good = f"{known.size} beads, each once and in its order"
    # Distance of the motions of hatch beads, turns among them, from their tracks, both ways.
    beads, path = match.beads, match.path
    alike, rows, segment = _one_by_one(match)
    hatch = path.island[np.searchsorted(path.track_starts, segment, side="right") - 1] >= 0
    rows, segment = rows[hatch], segment[hatch]
    away = np.full(len(nc), -1.0)
    for driven, wanted in ((nc.start, path.segment_start), (nc.end, path.end)):
        apart = np.hypot(*(driven[rows, :2] - wanted[segment]).T)
        away[rows] = np.maximum(away[rows], np.where(nc.kind[rows] > 1, np.inf, apart))
    other = np.flatnonzero(~alike & (match.track >= 0))
    for i in other[np.append(path.island, -1)[match.track[other]] >= 0].tolist():
        mine = np.arange(beads.first[i], beads.last[i] + 1)
        a, b = path.track_starts[match.track[i] : match.track[i] + 2]
        driven = np.stack([nc.start[mine, :2], nc.end[mine, :2]], axis=1).reshape(-1, 2)
        wanted = np.stack([path.segment_start[a:b], path.end[a:b]], axis=1).reshape(-1, 2)
        away[mine] = shape_distance(driven, np.repeat(np.arange(mine.size), 2), wanted)
    found = np.flatnonzero(away >= 0.0)
    what = "distance of hatch and turns from their plan"
    return [
        count_check("beads as planned", places, good),
        worst_check("hatch path", nc, found, away[found], PATH_TOLERANCE_MM, "mm", what),
    ]


def _named(path: TrackColumns, track: int) -> str:
    ring = int(path.ring[track])
    return f"contour ring {ring}" if ring >= 0 else f"a bead of island {int(path.island[track])}"


@kernel
def nearest_each(places: Floats, segments: Floats) -> tuple[Ints, Floats]:
    """Nearest of segments (m, 4) to each of places (n, 2), and its distance (n,); the quicker the nearer a place is to the one
    before."""
    tree, guess = tree_over(segments), 0
    index, away = np.empty(len(places), np.int64), np.empty(len(places))
    for n in range(len(places)):
        square, guess = nearest_segment(tree, places[n, 0], places[n, 1], guess)
        index[n], away[n] = guess, math.sqrt(square)
    return index, away


def shape_distance(driven: Floats, motion: Ints, wanted: Floats) -> Floats:
    """Largest distance of paths, (n, 2) and (m, 2) points, as shapes, both ways, at each motion of the first; `motion` (n,) is that
    of its points."""
    path, target = (np.hstack([at[:-1], at[1:]]) if len(at) > 1 else np.hstack([at, at]) for at in (driven, wanted))
    result = np.zeros(int(motion.max()) + 1)
    np.maximum.at(result, motion, nearest_each(driven, target)[1])
    segment, missed = nearest_each(wanted, path)
    np.maximum.at(result, motion[segment], missed)
    return result
