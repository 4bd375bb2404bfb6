"""Roles of motions by their geometry: contours, islands, turns, layers, preheating. What comments say of them counts for nothing.

A bead that comes back to its start is a contour, any other is hatch. Who knows more of the part or of its plan gives better roles:
:func:`by_section` and :func:`ebamcheck.checks.matching.matched`."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.codes import FOCUS
from ebamcheck.nc.files import layer_of_preheat
from ebamcheck.nc.motions import RAPID, STRAIGHT, Beads, NCProgram
from ebamcheck.nc.timeline import PAUSE
from ebamcheck.threads import run_blocks

CLOSED_MM = 1e-3  # A bead this near to its start has come back: the decimals of a program, at their coarsest
PARALLEL = 1e-3  # Sine of the angle between lines of one direction
JOINT_MM = 2e-5  # Where the power changes along a line, its joint is off by the rounding of six decimals
STEP_MM = 0.5  # Of the places along beads, and along sides, where depths are looked at
FEWEST = 4  # Stretches of the shortest side: of a side of a small circle only the middle has the depth
TURN_RAD = np.pi / 96.0  # Between the places around an inward corner: chords keep the depth within OFF_MM
OFF_MM = 1e-3  # By how much less deep a place may be
HALVINGS = 8  # Halvings of the stretch in which a line ends
MOST = 0.5  # Share of a bead's length at the depth of contours from which on it is a contour


def by_shape(nc: NCProgram) -> NCProgram:
    """Give every bead its role by its shape alone: a contour comes back to its start, other beads are hatch."""
    return with_contours(nc, nc.beads, _comes_back(nc, nc.beads))


def by_section(nc: NCProgram, layers: Layers, z_of: Floats, offset_mm: float, near_mm: float) -> NCProgram:
    """Give every bead its role by the sections of a part: contours run within `near_mm` of the depth `offset_mm` for most of their
    length. The `layers` lie at `z_of` (L,) in the program. In a layer where no bead does, those that come back to their start are
    contours."""
    beads = nc.beads
    contour, back = np.zeros(len(beads), np.bool_), _comes_back(nc, beads)
    layer = nearest_layer(nc.end[beads.first, 2], z_of)
    pieces = np.zeros(len(nc), np.int64)

    def work(start: int, stop: int) -> None:
        for k in range(start, stop):
            mine = np.flatnonzero(layer == k)
            border = depth_lines(layers.section(k), offset_mm) if mine.size else np.zeros((0, 4))
            if not len(border):
                continue
            row, at = nc.samples(beads.rows[np.isin(beads.bead, mine)], STEP_MM)
            # Under a beam that is switched on too early there are places that no block has given.
            known = np.isfinite(at).all(axis=1)
            row, at = row[known], at[known]
            near = distances(np.ascontiguousarray(at), border) <= near_mm
            # Each sample stands for its share of the motion.
            np.add.at(pieces, row, 1)
            weight = np.nan_to_num(nc.lengths[row]) / pieces[row]
            bead = np.searchsorted(beads.first, row, side="right") - 1
            whole = np.bincount(bead, weight, minlength=len(beads))[mine]
            contour[mine] = np.bincount(bead, weight * near, minlength=len(beads))[mine] >= MOST * whole
            if not contour[mine].any():
                contour[mine] = back[mine]

    run_blocks(work, len(layers))
    return with_contours(nc, beads, contour)


def with_contours(nc: NCProgram, beads: Beads, contour: Bools) -> NCProgram:
    """Return the program with roles, where some of the beads (P,) are contours and the others hatch."""
    ring, island = np.cumsum(contour) - 1, np.cumsum(_begins_island(nc, beads, contour)) - 1
    rings = beads.spread(np.where(contour, ring, -1), len(nc))
    islands = beads.spread(np.where(contour, -1, island), len(nc))
    turn, goes_on = _turns(nc, beads, contour)
    return replace(nc, ring=rings, island=islands, turn=turn, goes_on=goes_on)


def _comes_back(nc: NCProgram, beads: Beads) -> Bools:
    """Beads (P,) that come back to their start, around something."""
    rows, bead = beads.rows, beads.bead
    away = np.abs(nc.end[rows, :2] - nc.start[beads.first, :2][bead]).max(axis=1, initial=0.0)
    back = (away <= CLOSED_MM) & (nc.lengths[rows] > CLOSED_MM)
    several = np.bincount(bead, minlength=len(beads)) > 2
    return np.asarray(beads.any(back) & (beads.any(nc.kind[rows] > STRAIGHT) | several))


def _begins_island(nc: NCProgram, beads: Beads, contour: Bools) -> Bools:
    """Hatch beads (P,) that begin an island."""
    # The others follow the bead before at its height, or from above in the same direction: islands that touch never share one. After a
    # wait an island begins in any case.
    if not len(beads):
        return np.zeros(0, np.bool_)
    waits = nc.events.row[nc.events.named(PAUSE)]
    rises = np.concatenate([[0], np.cumsum(nc.end[:, 2] != nc.start[:, 2])])
    before, after = beads.last[:-1], beads.first[1:]
    way = nc.end[:, :2] - nc.start[:, :2]
    length = np.hypot(way[before, 0], way[before, 1]) * np.hypot(way[after, 0], way[after, 1])
    turned = ~(np.abs(_cross(way[before], way[after])) <= PARALLEL * length)
    waited = np.searchsorted(waits, before, side="right") != np.searchsorted(waits, after, side="right")
    begins = np.ones(len(beads), np.bool_)
    begins[1:] = (turned & (rises[after] != rises[before + 1])) | waited
    begins[1:] |= contour[:-1] | (nc.end[after, 2] != nc.end[before, 2])
    return begins & ~contour


def _turns(nc: NCProgram, beads: Beads, contour: Bools) -> tuple[Bools, Bools]:
    """Turns between lines driven to and fro, and further parts of a line at another power or wire, (B,) both."""
    turn, goes_on = np.zeros(len(nc), np.bool_), np.zeros(len(nc), np.bool_)
    hatch = ~contour[beads.bead] & (nc.kind[beads.rows] <= STRAIGHT) & (nc.lengths[beads.rows] > 0.0)
    rows, bead = beads.rows[hatch], beads.bead[hatch]
    if rows.size < 2:
        return turn, goes_on
    follows = (np.diff(rows) == 1) & (np.diff(bead) == 0)
    changes = (np.diff(nc.power_w[rows]) != 0.0) | (np.diff(nc.wire_mm_s[rows]) != 0.0)
    a, joint, b = nc.start[rows[:-1], :2], nc.end[rows[:-1], :2], nc.end[rows[1:], :2]
    whole = np.hypot(*(b - a).T)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.abs(_cross(b - a, joint - a)) / whole
    ahead = ((joint - a) * (b - joint)).sum(axis=1) > 0.0
    further = np.append(False, follows & changes & ahead & (off <= JOINT_MM))
    goes_on[rows[further]] = True
    lines = np.flatnonzero(~further)
    end = rows[np.append(lines[1:], rows.size) - 1]
    turn[_between_opposite(nc, rows[lines], end, bead[lines], rows)] = True
    return turn, goes_on & ~turn


def _between_opposite(nc: NCProgram, first: Ints, last: Ints, bead: Ints, rows: Ints) -> Ints:
    """Motions of lines that lie between two of opposite directions, and across them."""
    if first.size < 3:
        return first[:0]
    way = nc.end[last, :2] - nc.start[first, :2]
    unit = way / np.maximum(np.hypot(way[:, 0], way[:, 1]), np.finfo(float).tiny)[:, None]
    before, middle, after = unit[:-2], unit[1:-1], unit[2:]
    opposite = (np.abs(_cross(before, after)) <= PARALLEL) & ((before * after).sum(axis=1) < 0.0)
    found = opposite & (np.abs(_cross(before, middle)) > PARALLEL) & (bead[:-2] == bead[2:])
    a, b = (np.searchsorted(rows, ends[1:-1][found]) for ends in (first, last))
    marks = np.zeros(rows.size + 1, np.int64)
    np.add.at(marks, a, 1)
    np.add.at(marks, b + 1, -1)
    return rows[np.cumsum(marks[:-1]) > 0]


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def nearest_layer(z: Floats, z_of: Floats) -> Ints:
    """Index of the layer (n,) whose height is nearest to each Z."""
    return np.asarray(np.searchsorted(0.5 * (z_of[1:] + z_of[:-1]), z), np.int64)


def by_height(nc: NCProgram, z_of: Floats) -> NCProgram:
    """Return the program with each motion in the layer whose Z, `z_of` (L,) rising, it works at; travel in the one that it leads
    to."""
    if not z_of.size:
        return nc
    metal = np.flatnonzero((nc.beam | nc.wire) & (nc.kind != RAPID))
    layer = np.full(len(nc), -1, np.int64)
    layer[metal] = nearest_layer(nc.end[metal, 2], z_of)
    known, first = np.unique(layer[metal], return_index=True)
    files = [nc.files[0].name] * z_of.size
    for k, row in zip(known.tolist(), metal[first].tolist(), strict=True):
        files[k] = nc.files[int(nc.file[row])].name
    return replace(nc, layer=with_travel(layer), layer_files=tuple(files))


def with_travel(layer: Ints) -> Ints:
    """Layers of all motions (B,) from those of metal, -1 for travel: it is of the layer that it leads to.
    Its first motion away from a layer is still of that layer, and what follows the last bead is of the last layer."""
    metal = np.flatnonzero(layer >= 0)
    if not metal.size:
        return layer
    ahead = np.searchsorted(metal, np.arange(layer.size))
    result = layer[metal[np.minimum(ahead, metal.size - 1)]]
    leaves = np.flatnonzero(layer[:-1] >= 0) + 1
    leaves = leaves[layer[leaves] < 0]
    result[leaves] = layer[leaves - 1]
    return np.asarray(result, np.int64)


OFF = ("beam_off", "wire_stop")  # Commands that come before a scan
OF_MOTIONS = (
    "file", "line", "layer", "kind", "start", "end", "coefficients", "arc", "feed_mm_min", "beam", "wire", "power_w",
    "wire_mm_s", "ring", "island", "turn", "goes_on",
)  # fmt: skip


def without_preheating(nc: NCProgram, in_layers: bool = False) -> NCProgram:
    """Return a program with the motions and events of its preheating scans apart. A scan is told by the file that it stands in, or,
    where scans stand `in_layers`, by the focus, with the commands right before it that switch beam and wire off. Positions of the
    rest begin where the scan before left the tool."""
    e, stem = nc.events, nc.files[0].name.rpartition(".")[0]
    of_file = [layer_of_preheat(stem, file.name.rpartition(".")[0]) for file in nc.files]
    layer = np.array([-1 if found is None else found for found in of_file], np.int64)
    motions, events = layer[nc.file] >= 0, layer[e.file] >= 0
    if in_layers:
        focus = e.named(FOCUS)
        out = focus & (e.value != 0.0)
        within = e.since(out, focus & ~out)
        # What comes next, but for the commands that switch off.
        others = np.flatnonzero(~e.named(*OFF))
        ahead = np.append(others, len(e) - 1)[np.searchsorted(others, np.arange(len(e)))]
        before = e.named(*OFF) & (out & ~within[:-1])[ahead] & (e.file == e.file[ahead])
        events = before | out | within[:-1]
        motions = within[np.searchsorted(e.row, np.arange(len(nc)), side="right")]
    if not (events if in_layers else layer >= 0).any():
        return nc
    scans = replace(rows_of(nc, motions, events), layer_files=())
    scans = scans if in_layers else replace(scans, layer=layer[scans.file])
    return replace(rows_of(nc, ~motions, ~events), preheating=scans)


def rows_of(nc: NCProgram, motions: Bools, events: Bools) -> NCProgram:
    """Some motions and some events of a program, each event before the motion that it came before."""
    assert {field.name for field in fields(nc)} >= set(OF_MOTIONS)
    kept = {name: getattr(nc, name)[motions] for name in OF_MOTIONS}
    before: Ints = np.concatenate([[0], np.cumsum(motions)]).astype(np.int64)
    found = nc.events.chosen(events)
    found = replace(found, row=before[found.row])
    table = None if nc.table is None else nc.table.rows(motions)
    return replace(nc, events=found, table=table, **kept)


# Who plans and writes contours takes them from an inset. Who reads and checks a program works out where they must lie in another way:
# places straight in from every side, and around every inward corner, of which those count that no other side is nearer to.


def depth_lines(section: BaseGeometry, depth_mm: float) -> Floats:
    """Sides (n, 4) of the lines along which a section is `depth_mm` deep: x0, y0, x1, y1, at most :data:`STEP_MM` apart along
    sides. Lines of neighbouring sides may lie on one another for a stretch, within :data:`OFF_MM`."""
    if section.is_empty or depth_mm <= 0.0:
        return np.zeros((0, 4))
    sides = segments_of(shapely.boundary(section))
    clear_mm = depth_mm - OFF_MM
    # Places (n, 2) at a distance from each side and inward corner, in order, and the line that each belongs to.
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(section)))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    side = np.flatnonzero((ring[1:] == ring[:-1]) & (points[1:] != points[:-1]).any(axis=1))
    foot, way, ring = points[side], points[side + 1] - points[side], ring[side]
    length = np.hypot(way[:, 0], way[:, 1])
    normal = np.column_stack([-way[:, 1], way[:, 0]]) / length[:, None]
    row, share = _shares(np.maximum(np.ceil(length / STEP_MM).astype(np.int64), FEWEST))
    along = foot[row] + share[:, None] * way[row] + depth_mm * normal[row]
    # The side before each: of the first of a ring it is its last.
    before = np.arange(side.size) - 1
    first = np.flatnonzero(np.append(True, ring[1:] != ring[:-1]))
    before[first] = np.append(first[1:], side.size) - 1
    sine = normal[before, 0] * normal[:, 1] - normal[before, 1] * normal[:, 0]
    turn = np.arctan2(sine, (normal[before] * normal).sum(axis=1))
    inward = np.flatnonzero(turn < 0.0)
    corner, share = _shares(np.ceil(-turn[inward] / TURN_RAD).astype(np.int64))
    of = inward[corner]
    angle = np.arctan2(normal[before[of], 1], normal[before[of], 0]) + share * turn[of]
    around = foot[of] + depth_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    places, line = np.concatenate([along, around]), np.concatenate([row, side.size + corner])
    away = distances(places, sides)
    good = (away >= clear_mm) & inside(section, places, away)
    follows = line[1:] == line[:-1]
    a, b = places[:-1][follows], places[1:][follows]
    at_a, at_b = good[:-1][follows], good[1:][follows]
    ends = at_a != at_b
    inner = np.where(at_a[ends, None], a[ends], b[ends])
    outer = np.where(at_a[ends, None], b[ends], a[ends])
    start, apart = inner, np.hypot(*(outer - inner).T) >= 2.0 * clear_mm
    for _ in range(HALVINGS):
        middle = 0.5 * (inner + outer)
        held = distances(middle, sides) >= clear_mm
        held[apart] &= shapely.intersects_xy(section, middle[apart, 0], middle[apart, 1])
        inner, outer = np.where(held[:, None], middle, inner), np.where(held[:, None], outer, middle)
    whole = at_a & at_b
    return np.concatenate([np.hstack([a[whole], b[whole]]), np.hstack([start, inner])])


def inside(region: BaseGeometry, places: Floats, away: Floats) -> Bools:
    """Whether places (n, 2) lie in a region, whose border is `away` (n,) from each."""
    # The border passes nowhere between two places that are nearer to one another than both together are to it: one of a run tells
    # of all. Two places opposite each other are just as far apart, up to rounding: so a run ends well before that.
    apart = np.hypot(*np.diff(places, axis=0).T)
    begins = np.append(True, ~(apart < 0.9 * (away[1:] + away[:-1])))[: len(places)]
    first = np.flatnonzero(begins)
    shapely.prepare(region)
    within = shapely.intersects_xy(region, places[first, 0], places[first, 1])
    return np.asarray(within[np.cumsum(begins) - 1])


def _shares(count: Ints) -> tuple[Ints, Floats]:
    """Row of each of ``count + 1`` places a row, and where along it they are, from 0 to 1."""
    row = np.repeat(np.arange(count.size), count + 1)
    at = np.arange(row.size) - np.repeat(np.cumsum(count + 1) - count - 1, count + 1)
    return row, at / count[row]
