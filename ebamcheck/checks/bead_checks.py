"""Checks of the beads that a program lays: nothing left bare, no line missing, none laid twice; and the form of the hatch.

A line with a wrong end, or a missing block, mostly leaves the metal of a layer within its limits, because a pool is wider than the
slip. The form of the hatch shows the slip: lines to and fro are parallel and evenly apart. Beads that follow a wall have no such
form."""

from __future__ import annotations

import math
import re
from itertools import pairwise

import numpy as np
import shapely
from scipy import ndimage
from scipy.spatial import cKDTree
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from ebamcheck.checks.checks import (
    SAME_LINE_MM,
    TWO_PLACES_MM,
    count_check,
    limit_check,
    lines_of,
    row_faults,
)
from ebamcheck.checks.matching import APART_MM
from ebamcheck.checks.subject import Subject
from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.geometry.raster import bare_samples, covered_fraction
from ebamcheck.geometry.regions import ground, valid_polygons
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.motions import RAPID, STRAIGHT, NCProgram
from ebamcheck.nc.roles import nearest_layer
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import TURN_SPACINGS
from ebamcheck.threads import run_each

LINES, CROSSINGS = "hatch lines", "crossings"  # Names of the checks
CHORD_MM = 0.5  # Chords of curved beads
PARALLEL = 1e-3  # Sine of the angle between lines of one direction
TO_AND_FRO = 1.0 / 3.0  # Least share of a bead's length along one direction for lines to and fro
WIDEST_SPACINGS = 1.3  # Of neighbouring lines to and fro; a bead that comes back further away follows a wall
LEAST_TURN = -math.cos(math.radians(15.0))  # Of a bead that turns back on its track, 15 degrees; sound turns have 26
# Least cosine of a joint that is a bend, and number of bends in a row that follow a wall: a misplaced line has two.
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
    """Join parts at different power or wire to lines of straight hatch beads: first line of each bead (P + 1,), first motion
    (n,) and way (n, 2) of each line."""
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
    """Form (P,) of each bead, one of FINE, SKEW, UNEVEN and BACK, and its line at fault (P,), 0 for none."""
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
    """Mark the lines (m, n) that turn back on the line before."""
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
    room_mm = 2.0 * TWO_PLACES_MM + PARALLEL * mains_mm
    return np.asarray(beside & (last >= 0) & (np.abs(step - pitch) > room_mm))


def _before(which: Bools) -> Ints:
    """Index (m, n) of the last one before each that is true; -1 for none."""
    index = np.maximum.accumulate(np.where(which, np.arange(which.shape[1]), -1), axis=1)
    return np.concatenate([np.full((len(which), 1), -1), index[:, :-1]], axis=1)


def _crossed(nc: NCProgram, rows: Ints, bead: Ints, pool_mm: float) -> list[int]:
    """Later motion of each crossing pair in which at least one is hatch; `bead` (B,) is the bead of each motion."""
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
        float(shapely.distance(shapely.points(shapely.get_coordinates(piece.segmentize(CHORD_MM))), other).max())
        for low, high in pairwise([0.0, *cuts.tolist(), one.length])
        if high > low
        for piece in [substring(one, low, high)]
    ]
    return any(min(before, after) > pool_mm for before, after in pairwise(away))


def _apart(one: Floats, other: Floats) -> Bools:
    """Mark the pairs of segments (n, 4) that cross farther from all their ends than the rounding of the ends."""
    if not len(one):
        return np.zeros(0, np.bool_)
    lines = [np.asarray(shapely.linestrings(s.reshape(-1, 2, 2)), dtype=np.object_) for s in (one, other)]
    at = shapely.intersection(lines[0], lines[1])
    result = np.ones(len(one), np.bool_)
    for segments in (one, other):
        for end in (segments[:, :2], segments[:, 2:]):
            result &= np.asarray(shapely.distance(at, shapely.points(end))) > TWO_PLACES_MM
    return result


CRUMB = 0.25  # Bare pieces under this times the squared bead width are corners that a round bead never fills
SPACING_SHARE = 1.5  # Largest distance of neighbouring lines, in spacings; a missing line makes it two
PARALLEL_RAD = 1e-3  # Lines of an island whose directions differ by more follow a wall, and have no spacing
WIDEST_GAP = 0.95  # Largest gap between beads, over the gap that a missing line leaves
# Shares of the bead's width: how much wider than planned a gap may be, one sample of the plan's grid; and the gap that
# sound plans leave where three islands meet, however near to one another their lines lie.
GAP_MARGIN, LEAST_GAP_LIMIT = 0.05, 0.15
MARGIN = 2  # Samples added around the box of a patch: its bare area reaches to the next samples
_NUMBERED = re.compile(rb"\s*(?:/\d?\s*)?(?:[N:]\s*\d+)?", re.IGNORECASE)


def line_checks(subject: Subject) -> list[Check]:
    """Check the lines of the hatch by the text alone: their spacing, that none is laid twice, and their form."""
    return [_spacing(subject), _once(subject.nc), *form_checks(subject.nc, subject.config)]


def _spacing(subject: Subject) -> Check:
    """Distance between neighbouring parallel lines that are driven one after the other, where nothing else covers what lies
    between."""
    nc, config = subject.nc, subject.config
    moves = (nc.end[:, :2] != nc.start[:, :2]).any(axis=1)
    rows = np.flatnonzero(nc.deposit & (nc.island >= 0) & ~nc.turn & moves & (nc.lengths > 0.0))
    limit = SPACING_SHARE * config.process.hatch_spacing_mm
    # Groups of lines of one direction that follow each other, their offset across the longest, mm, and whether they are parallel to it.
    way = (nc.end - nc.start)[rows, :2]
    unit = way / np.hypot(way[:, 0], way[:, 1])[:, None]
    turned = np.abs(unit[1:, 0] * unit[:-1, 1] - unit[1:, 1] * unit[:-1, 0]) > PARALLEL_RAD
    group = np.cumsum(np.append(False, turned | (np.diff(nc.layer[rows]) != 0))[: rows.size])
    longest = np.zeros(int(group.max(initial=-1)) + 1, np.int64)
    by_length = np.argsort(nc.lengths[rows], kind="stable")
    longest[group[by_length]] = by_length
    along = unit[longest[group]]
    middle = 0.5 * (nc.start + nc.end)[rows, :2]
    offset = along[:, 0] * middle[:, 1] - along[:, 1] * middle[:, 0]
    parallel = np.abs(along[:, 0] * unit[:, 1] - along[:, 1] * unit[:, 0]) <= PARALLEL_RAD
    order = np.lexsort((offset, group))
    step = np.diff(offset[order])
    same = (np.diff(group[order]) == 0) & parallel[order[1:]] & parallel[order[:-1]]
    wide = np.flatnonzero(same & (step > limit))
    if wide.size:
        wide = wide[_is_bare(subject, np.stack([rows[order[wide]], rows[order[wide + 1]]], axis=1))]
    worst = float(step[wide if wide.size else same & (step <= limit)].max(initial=0.0))
    if not wide.size:
        text = f"{rows.size} lines, neighbours at most {worst:.6g} mm apart"
        return Check("hatch spacing", True, worst, limit, "mm", "", text)
    # The later of both lines stands where the missing one should have come before.
    row = int(np.maximum(rows[order[wide]], rows[order[wide + 1]]).min())
    text = f"neighbouring lines lie {worst:.6g} mm apart: one is missing between"
    return Check("hatch spacing", False, worst, limit, "mm", nc.where(row), text)


def _is_bare(subject: Subject, pairs: Ints) -> Bools:
    """Pairs (n, 2) of lines between which the place half-way is in the section, and under no bead of the layer."""
    # Nothing lies between two lines of which one begins where the other has long ended: they are of two islands.
    nc, room = subject.nc, 0.5 * subject.config.process.bead_width_mm
    pairs = np.take_along_axis(pairs, np.argsort(nc.lengths[pairs], axis=1, kind="stable"), axis=1)
    shorter, other = pairs.T
    middle = 0.5 * (nc.start + nc.end)[shorter, :2]
    way = (nc.end - nc.start)[other, :2] / nc.lengths[other, None]
    from_other = middle - nc.start[other, :2]
    along = (from_other * way).sum(axis=1)
    place = middle - 0.5 * (from_other - along[:, None] * way)
    bare = (-room <= along) & (along <= nc.lengths[other] + room)
    layer = nearest_layer(nc.end[shorter, 2], subject.z_of)
    for k in np.unique(layer[bare]).tolist():
        mine = np.flatnonzero(bare & (layer == k))
        if subject.witness_sections is not None:
            bare[mine] = shapely.intersects_xy(subject.witness_sections[k], place[mine, 0], place[mine, 1])
        bare[mine] &= distances(place[mine], subject.chords(k)) > room
    return np.asarray(bare)


def _once(nc: NCProgram) -> Check:
    """Check that no hatch or contour line lies on another of its layer; a contour may overlap its start."""
    contour = (nc.ring >= 0) & (nc.kind == STRAIGHT) & ~nc.overlap
    rows = np.flatnonzero(nc.deposit & ~nc.turn & ((nc.island >= 0) | contour) & (nc.lengths > SAME_LINE_MM))
    rows = rows[np.isfinite(nc.start[rows]).all(axis=1) & np.isfinite(nc.end[rows]).all(axis=1)]
    layer = APART_MM * nc.layer[rows]
    # Each line in both directions: nothing else tells which of its ends is the first.
    start, end = nc.start[rows, :2], nc.end[rows, :2]
    ways = np.vstack([np.column_stack([start, end, layer]), np.column_stack([end, start, layer])])
    pairs = cKDTree(ways).query_pairs(SAME_LINE_MM, p=np.inf, output_type="ndarray")
    pairs = pairs % max(rows.size, 1)
    again = np.unique(pairs[pairs[:, 0] != pairs[:, 1]].max(axis=1))
    faults = row_faults(nc, rows[again], "this line has been laid before in its layer")
    return count_check("lines laid once", faults, f"{rows.size} lines, none twice")


def repeated_blocks(nc: NCProgram) -> Check:
    """Check that no block with metal repeats the one before: a motion that goes nowhere, or the same words but for the N number."""
    still = nc.deposit & (nc.lengths == 0.0)
    faults = row_faults(nc, still, "a motion that goes nowhere: the block before says the same")
    lines = [file.data.split(b"\n") for file in nc.files]
    for file, line in lines_of(nc, np.flatnonzero(nc.deposit)):
        before, block = lines[file][line - 2 : line] if line > 1 else (b"", lines[file][line - 1])
        # Most blocks end in another word than the one before, and need not be taken into words.
        last = block.rsplit(None, 1)[-1]
        if last[:1] not in b"Nn:/" and b";" not in block + before and not before.rstrip().endswith(last):
            continue
        words = _words_of(block)
        if words and words == _words_of(before):
            faults.append((f"{nc.files[file].name}:{line}", "the same block as the one before"))
    return count_check("repeated blocks", faults, "no motion repeats the block before")


def _words_of(line: bytes) -> list[bytes]:
    """Words of a line without its number and its comment."""
    words = line.split(b";")[0].split()
    if words and words[0][:1] == b"N" and words[0][1:].isdigit():
        return words[1:]
    return _NUMBERED.sub(b"", b" ".join(words)).split()


def coverage_check(subject: Subject) -> list[Check]:
    """Check the least share of a section that beads cover; the text gives the overlap of all and the worst layer's largest gap."""
    nc, config, sections = subject.nc, subject.config, subject.witness_sections or []
    limit, width = config.scan.least_coverage, config.process.bead_width_mm
    solid = [k for k, section in enumerate(sections) if not section.is_empty]
    covered = run_each(lambda k: covered_fraction(sections[k], subject.chords(k), width), solid)
    laid = width * sum(float(np.nansum(nc.lengths[subject.bead_rows[k]])) for k in solid)
    area = sum(share * sections[k].area for share, k in zip(covered, solid, strict=True))
    worst, layer = min(zip(covered, solid, strict=True), default=(1.0, -1))
    if layer < 0:
        return [Check("coverage", True, 1.0, limit, "of the area", "", "there is no section to cover")]
    rows, where, gap = subject.bead_rows[layer], f"{nc.files[0].name}:1", "; the layer has no bead"
    if rows.size:
        lines = np.asarray(shapely.linestrings(subject.chords(layer).reshape(-1, 2, 2)), object)
        bare = shapely.get_parts(sections[layer].difference(ground(lines, width)))
        parts = [part for part in bare if part.area > CRUMB * width**2]
        where, gap = "", "; no gap"
        if parts:
            largest = max(parts, key=lambda part: float(part.area))
            centre = largest.representative_point()
            where = nc.where(_nearest(nc, rows, centre))
            at = f"({centre.x:.3f}, {centre.y:.3f})"
            gap = f"; {len(parts)} gaps, the largest of {largest.area:.4g} mm2 at {at}"
    text = f"beads cover at least {100.0 * worst:.2f} % (layer {layer + 1}), overlap {100.0 * (laid / max(area, 1e-9) - 1.0):.0f} %{gap}"
    return [Check("coverage", worst >= limit, worst, limit, "of the area", where, text)]


def gaps_check(subject: Subject) -> list[Check]:
    """Check the widest gap inside the centre lines of the contour beads; corners that a round bead cannot fill lie outside."""
    nc, config = subject.nc, subject.config
    width = config.process.bead_width_mm
    missing_line_mm = WIDEST_GAP * (2.0 * config.process.hatch_spacing_mm - width)
    planned_mm = (config.scan.gap_width + GAP_MARGIN) * width
    limit = max(min(missing_line_mm, planned_mm), LEAST_GAP_LIMIT * width)
    known, sections = [0.0], subject.witness_sections or []

    def widest(k: int) -> tuple[float, int, BaseGeometry] | None:
        section = sections[k]
        if section.is_empty or not subject.bead_rows[k].size:
            return None
        # As if a bead ran along the border: what is nearer to it than half a bead is a corner.
        lines = np.vstack([subject.chords(k), segments_of(section.boundary)])
        # A gap as wide as the widest so far is found, too: whichever thread comes first, the lowest one is told.
        across, bare = widest_part(section, lines, width, math.nextafter(known[0], 0.0))
        if bare is None:
            return None
        known[0] = max(known[0], across)
        return across, -k, bare

    gaps = [gap for gap in run_each(widest, range(len(sections))) if gap is not None]
    worst, where, place = 0.0, "", ""
    if gaps:
        worst, layer, bare = max(gaps, key=lambda gap: gap[:2])
        centre = bare.representative_point()
        where = nc.where(_nearest(nc, subject.bead_rows[-layer], centre))
        place = f" at ({centre.x:.3f}, {centre.y:.3f})"
    text = f"widest gap between beads{place}: {worst:.4g} mm"
    return [limit_check("gaps", worst, limit, "mm", text, where)]


def _nearest(nc: NCProgram, rows: Ints, place: BaseGeometry) -> int:
    chords = np.stack([nc.start[rows, :2], nc.end[rows, :2]], axis=1)
    known = np.isfinite(chords).all(axis=(1, 2))
    if not known.any():
        return int(rows[0])
    return int(rows[known][np.argmin(shapely.distance(shapely.linestrings(chords[known]), place))])


def widest_part(
    region: BaseGeometry, segments: Floats, bead_width_mm: float, wider_than_mm: float = 0.0
) -> tuple[float, shapely.Polygon | None]:
    """Diameter of the largest circle in a region, mm, that lies further than half a bead width from every segment (S, 4), and its
    part. Where no circle is over `wider_than_mm`: that width, and None."""
    bare = bare_samples(region, segments, bead_width_mm)
    widest_mm, widest = wider_than_mm, None
    if bare.covered == 1.0:
        return widest_mm, widest
    # Patches of bare samples come the widest first, and beads are laid only where they reach one: a few bare spots of a layer of a
    # thousand beads cost no union of a thousand.
    labels, _ = ndimage.label(bare.grid, structure=np.ones((3, 3)))
    places = [place for place in ndimage.find_objects(labels) if place is not None]
    first = np.array([(x.start, y.start) for y, x in places], np.float64).reshape(-1, 2) - MARGIN
    stop = np.array([(x.stop, y.stop) for y, x in places], np.float64).reshape(-1, 2) + MARGIN
    boxes = np.hstack([first, stop]) * bare.step_mm + np.tile(bare.origin, 2)
    most_mm = bare.step_mm * (stop - first).min(axis=1)
    low = np.minimum(segments[:, :2], segments[:, 2:]) - 0.5 * bead_width_mm
    high = np.maximum(segments[:, :2], segments[:, 2:]) + 0.5 * bead_width_mm
    for n in np.argsort(-most_mm, kind="stable"):
        if most_mm[n] <= widest_mm:
            break
        near = (low <= boxes[n, 2:]).all(axis=1) & (high >= boxes[n, :2]).all(axis=1)
        lines = np.asarray(shapely.linestrings(segments[near].reshape(-1, 2, 2)), object)
        left = shapely.difference(shapely.clip_by_rect(region, *boxes[n]), ground(lines, bead_width_mm))
        for part in valid_polygons(left):
            across_mm = 2.0 * float(shapely.length(shapely.maximum_inscribed_circle(part)))
            if across_mm > widest_mm:
                widest_mm, widest = across_mm, part
    return widest_mm, widest
