"""Which bead of a program is which of a plan: found by where they lie and in which order they come.

Beads and planned tracks of one layer with the same start and end are the same; what is left on both sides between two
such pairs is taken together in its order, and then by nearness, so that a bead that was moved is compared with the
track that it should have followed. A bead without a track is one that nobody planned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.spatial import cKDTree

from ebamcheck.checks.checks import PATH_TOLERANCE_MM, TWO_PLACES_MM, count_check, worst_check
from ebamcheck.geometry.nearest import nearest, segments_along, square_between, tree_over
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.nc.inputs import TrackColumns
from ebamcheck.nc.motions import Beads, NCProgram
from ebamcheck.nc.roles import nearest_layer
from ebamcheck.result import Check

# Distance of layers in the space in which ends are compared: no bead is like one of another layer.
APART_MM = 1e6
CLOSER = 1.0 - 1e-9  # Share of a square under which a distance is the smaller one, however both are rounded
MOST_STEPS = 16  # Segments that are walked along from one place to the next; what is farther is looked for


@dataclass(frozen=True, eq=False)
class Matching:
    """Beads (P,) of a program, the track of a plan that each follows, and whether another bead follows it already.

    A bead that nobody planned has track -1.
    """

    beads: Beads
    track: Ints
    again: Bools
    path: TrackColumns


def matched(nc: NCProgram, path: TrackColumns) -> tuple[NCProgram, Matching]:
    """Give every bead the role of the track that it follows: its ring or island, turns and further parts of lines; none to one that nobody planned."""
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
        pick, again = _pairs(_placed(found, found_layer), _placed(ends, layer))
    track = np.where(pick >= 0, np.append(known, -1)[pick], -1)
    result = Matching(beads, track, again, path)
    turn, goes_on = _marks(nc, result)
    ring, island = (beads.spread(np.append(of, -1)[track], len(nc)) for of in (path.ring, path.island))
    return replace(nc, ring=ring, island=island, turn=turn, goes_on=goes_on), result


def _placed(ends: Floats, layer: Ints) -> Floats:
    """Ends (n, 4) as points (n, 5) that are far apart in different layers."""
    return np.nan_to_num(np.column_stack([ends, APART_MM * layer]), nan=-APART_MM)


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
    _in_order(found, wanted, pick, taken)
    _by_nearness(found, wanted, pick, taken)
    return pick, again


def _in_order(found: Floats, wanted: Floats, pick: Ints, taken: Bools) -> None:
    """Take what is left between two pairs of neighbours together, where it is as many beads as tracks."""
    left = np.flatnonzero(pick < 0)
    if not left.size:
        return
    before = np.maximum.accumulate(np.where(pick >= 0, np.arange(pick.size), -1))[left]
    after = np.minimum.accumulate(np.where(pick >= 0, np.arange(pick.size), pick.size)[::-1])[::-1][left]
    for low, high in dict.fromkeys(zip(before.tolist(), after.tolist(), strict=True)):
        mine = left[(before == low) & (after == high)]
        a = int(pick[low]) + 1 if low >= 0 else 0
        b = int(pick[high]) if high < pick.size else len(wanted)
        free = np.arange(a, max(a, b))
        free = free[~taken[free]]
        if free.size == mine.size and (wanted[free, 4] == found[mine, 4]).all():
            pick[mine], taken[free] = free, True


def _by_nearness(found: Floats, wanted: Floats, pick: Ints, taken: Bools) -> None:
    """Take each bead that is left with the free track of its layer that starts or ends where it does."""
    free = np.flatnonzero(~taken)
    for i in np.flatnonzero(pick < 0).tolist():
        mine = free[~taken[free] & (wanted[free, 4] == found[i, 4])]
        apart = np.abs(wanted[mine, :4] - found[i, :4])
        near = np.minimum(apart[:, :2].max(axis=1, initial=0.0), apart[:, 2:].max(axis=1, initial=0.0))
        if mine.size and near.min() <= TWO_PLACES_MM:
            pick[i] = mine[np.argmin(near)]
            taken[pick[i]] = True


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
        line = _nearest_line(nc, mine, path.segment_start[begins[:-1]], path.end[begins[1:] - 1])
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


def _nearest_line(nc: NCProgram, rows: Ints, start: Floats, end: Floats) -> Ints:
    """Line (n,) from which the start, the middle and the end of each motion are least away in all."""
    lines = np.atleast_1d(np.asarray(shapely.linestrings(np.stack([start, end], axis=1)), dtype=np.object_))
    away = np.zeros((rows.size, lines.size))
    for place in (nc.start, 0.5 * (nc.start + nc.end), nc.end):
        points = np.atleast_1d(np.asarray(shapely.points(np.nan_to_num(place[rows, :2])), dtype=np.object_))
        away += np.asarray(shapely.distance(points[:, None], lines[None, :]))
    return np.asarray(away.argmin(axis=1), np.int64)


def matching_checks(nc: NCProgram, match: Matching) -> list[Check]:
    """Check that every bead was planned, that none is missing or comes twice or too early, and that all hatch keeps to its track."""
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
    return [count_check("beads as planned", places, good), _hatch_path(nc, match)]


def _named(path: TrackColumns, track: int) -> str:
    ring = int(path.ring[track])
    return f"contour ring {ring}" if ring >= 0 else f"a bead of island {int(path.island[track])}"


def _hatch_path(nc: NCProgram, match: Matching) -> Check:
    """Distance of the motions of hatch beads, turns among them, from their tracks, both ways."""
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
        driven = np.stack([nc.start[mine, :2], nc.end[mine, :2]], axis=1)
        away[mine] = shape_distance(driven, np.stack([path.segment_start[a:b], path.end[a:b]], axis=1))
    found = np.flatnonzero(away >= 0.0)
    what = "distance of hatch and turns from their plan"
    return worst_check("hatch path", nc, found, away[found], PATH_TOLERANCE_MM, "mm", what)


# -- distance of paths as shapes ---------------------------------------------------------------------------


@kernel
def _farthest(places: Floats, polyline: Floats, known_mm: float) -> tuple[Ints, Floats]:
    """Nearest segment (n,) of a polyline to each place and its distance (n,), for the farthest places."""
    # Both follow the same way, so that the segment near a place is a step or two from that of the place before. A place that is nearer to
    # it than another one is to the polyline, or than `known_mm`, is not the farthest: what was found of it is enough, and no nearer
    # segment is looked for.
    ring = tree_over(segments_along(polyline, False))
    segment = np.zeros(len(places), np.int64)
    away = np.empty(len(places))
    guess, most = 0, known_mm
    for i in range(len(places)):
        guess, square = _followed(polyline, guess, places[i, 0], places[i, 1])
        segment[i], away[i] = guess, math.sqrt(square)
        if square < CLOSER * most * most:
            continue
        found = nearest(ring, places[i, 0], places[i, 1], guess)
        guess = found.segment
        segment[i], away[i] = found.segment, found.distance
        most = max(most, found.distance)
    return segment, away


@kernel
def _followed(polyline: Floats, start: int, x: float, y: float) -> tuple[int, float]:
    """Segment up to which a polyline comes nearer to a place from `start` on, else down from it; square of its distance."""
    segment, square = start, _square(polyline, start, x, y)
    for step in (1, -1):
        for _ in range(MOST_STEPS):
            there = np.inf
            if 0 <= segment + step < len(polyline) - 1:
                there = _square(polyline, segment + step, x, y)
            if not there <= square:
                break
            segment, square = segment + step, there
        if segment != start:
            break
    return segment, square


@kernel
def _square(polyline: Floats, i: int, x: float, y: float) -> float:
    """Square of the distance of a place from a segment."""
    return square_between(x, y, polyline[i, 0], polyline[i, 1], polyline[i + 1, 0], polyline[i + 1, 1])


def shape_distance(driven: Floats, wanted: Floats) -> Floats:
    """Largest distance of paths (A, n, 2) and (E, m, 2) as shapes, both ways, (A,) at the motion of the first where it is.

    It is that of the motion from the other path, and of what lies nearest to the motion there: exact for the largest, and no more than
    that for the others.
    """
    path, target = np.ascontiguousarray(driven).reshape(-1, 2), np.ascontiguousarray(wanted).reshape(-1, 2)
    _, away = _farthest(path, target, 0.0)
    result = away.reshape(len(driven), -1).max(axis=1)
    segment, missed = _farthest(target, path, float(result.max(initial=0.0)))
    np.maximum.at(result, segment // driven.shape[1], missed)
    return np.asarray(result)
