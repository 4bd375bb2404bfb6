"""Checks of the path that a program's text commands: contours against fitted curves, hatch against the plan, layers against Z."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ebamcheck.checks.checks import PATH_TOLERANCE_MM, PLACE_MM, count_check, row_faults, worst_check
from ebamcheck.checks.matching import shape_distance
from ebamcheck.checks.subject import Subject
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc import motions
from ebamcheck.nc.inputs import ARC, LINE, SPLINE, CurveColumns
from ebamcheck.nc.motions import POLYNOMIAL, SPLINE_SPAN, STRAIGHT, NCProgram
from ebamcheck.nc.timeline import Kind
from ebamcheck.result import Check
from ebamcheck.threads import run_blocks

SAMPLES = 9  # Places on each span where programmed and fitted curve are compared at the same parameter
CHORD_SHARE = 0.02  # Of the limit: the error of chords between samples where shapes are compared
DEGREE = 3  # Of every spline piece
FLAT_ARC = 1e-12  # Sine of half the turn of an arc that is straight for numbers of 16 digits


@dataclass(frozen=True, eq=False)
class FittedSpans:
    """Every straight segment, arc and knot span of the fitted rings; a program block is expected for each."""

    ring: Ints  # (E,)
    kind: Ints  # (E,) of the piece: line, spline or arc
    powers: Floats  # (E, 4, 2) of the parameter from 0 to 1; of an arc its start alone
    centre: Floats  # (E, 2) of an arc
    sweep: Floats  # (E,) of an arc; 0 for others

    def at(self, span: Ints, t: Floats) -> Floats:
        """Points (n, 2) of spans (n,) at parameters (n,)."""
        c, t = self.powers[span], t[:, None]
        points = ((c[:, 3] * t + c[:, 2]) * t + c[:, 1]) * t + c[:, 0]
        turned = np.flatnonzero(self.sweep[span])
        mine = span[turned]
        spoke, turn = (c[turned, 0] - self.centre[mine]).T, self.sweep[mine] * t[turned, 0]
        cos, sin = np.cos(turn), np.sin(turn)
        x, y = cos * spoke[0] - sin * spoke[1], sin * spoke[0] + cos * spoke[1]
        points[turned] = self.centre[mine] + np.column_stack([x, y])
        return np.asarray(points)


def fitted_spans(curves: CurveColumns, decimals: int) -> FittedSpans:
    """All curves, span by span; segments that vanish at the decimals of the program are left out."""
    ring_of = np.repeat(np.arange(len(curves.closed)), np.diff(curves.ring_starts))
    # A cubic is known by four points.
    t = np.linspace(0.0, 1.0, DEGREE + 1)
    to_powers = np.linalg.inv(np.vander(t, increasing=True))
    of_piece, powers = [np.zeros(0, np.int64)], [np.zeros((0, DEGREE + 1, 2))]
    for k in range(len(curves.kind)):
        control = curves.control[curves.control_starts[k] : curves.control_starts[k + 1]]
        if curves.kind[k] == SPLINE:
            knots = curves.knots[curves.knot_starts[k] : curves.knot_starts[k + 1]]
            breaks = np.unique(knots)
            at = breaks[:-1, None] + t * np.diff(breaks)[:, None]
            found = to_powers @ spline_points(knots, control, at)
        elif curves.kind[k] == ARC:
            found = np.append(control, control[:1], axis=0)[None]
        else:
            rounded = np.round(control, decimals)
            moves = (rounded[1:] != rounded[:-1]).any(axis=1)
            ends = control[:-1][moves], np.diff(control, axis=0)[moves]
            found = np.stack([*ends, np.zeros_like(ends[0]), np.zeros_like(ends[0])], axis=1)
        of_piece.append(np.full(len(found), k))
        powers.append(found)
    piece, columns = np.concatenate(of_piece), np.concatenate(powers)
    kind = np.asarray(curves.kind, np.int64)[piece]
    centre, sweep = np.zeros((piece.size, 2)), np.zeros(piece.size)
    arcs = np.flatnonzero(kind == ARC)
    # Arcs go through three points each, the second half-way: the centre is where the bisectors of both halves meet; straight ones do not turn.
    first, middle, last = (columns[arcs, n] for n in range(3))
    one, other = middle - first, last - middle
    across = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    turned = np.abs(across) > FLAT_ARC * (one * one).sum(axis=1)
    a, b = 0.5 * ((middle + first) * one).sum(axis=1), 0.5 * ((last + middle) * other).sum(axis=1)
    whole = np.where(turned, across, 1.0)[:, None]
    centre[arcs] = np.column_stack([a * other[:, 1] - b * one[:, 1], b * one[:, 0] - a * other[:, 0]]) / whole
    spoke, side = first - centre[arcs], middle - centre[arcs]
    half = np.arctan2(spoke[:, 0] * side[:, 1] - spoke[:, 1] * side[:, 0], (spoke * side).sum(axis=1))
    sweep[arcs] = np.where(turned, 2.0 * half, 0.0)
    columns[arcs[sweep[arcs] != 0.0], 1:] = 0.0
    flat = arcs[sweep[arcs] == 0.0]
    columns[flat, 1], columns[flat, 2:] = columns[flat, 2] - columns[flat, 0], 0.0
    return FittedSpans(ring_of[piece], kind, columns, centre, sweep)


def spline_points(knots: Floats, control: Floats, at: Floats) -> Floats:
    """Points (S, n, 2) of a clamped cubic B-spline; row s of parameters `at` (S, n) lies in the s-th span between two different
    knots. C. de Boor, "On calculating with B-splines", J. Approx. Theory 6 (1972) 50."""
    span = np.flatnonzero(knots[1:] > knots[:-1])
    first = span - DEGREE
    place = [np.asarray(control)[first + k][:, None] for k in range(DEGREE + 1)]
    for r in range(1, DEGREE + 1):
        for k in range(DEGREE, r - 1, -1):
            low, high = knots[first + k][:, None], knots[span + 1 + k - r][:, None]
            share = ((at - low) / (high - low))[..., None]
            place[k] = (1.0 - share) * place[k - 1] + share * place[k]
    return np.asarray(place[DEGREE], np.float64)


def closure_check(nc: NCProgram, curves: CurveColumns | None) -> Check:
    """Check that every contour ring ends where it starts; open paths are known from `curves` alone."""
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0) & ~nc.overlap)
    ring, first = np.unique(nc.ring[rows], return_index=True)
    last = rows.size - 1 - np.unique(nc.ring[rows][::-1], return_index=True)[1] if rows.size else first
    if curves is not None:
        known = ring < len(curves.closed)
        closed = known & np.asarray(curves.closed)[np.where(known, ring, 0)] if len(curves.closed) else known
        first, last = first[closed], last[closed]
    gap = np.linalg.norm(nc.start[rows[first], :2] - nc.end[rows[last], :2], axis=1)
    what = f"gap of {gap.size} rings"
    return worst_check("contours close", nc, rows[last], gap, PATH_TOLERANCE_MM, "mm", what)


def contour_checks(subject: Subject) -> list[Check]:
    """Compare the contour motions with the fitted curves, both ways.
    Where the program has one block for each span, both are evaluated at the same parameters; other rings are compared as shapes."""
    nc, curves, config = subject.nc, subject.curves, subject.config
    assert curves is not None
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0))
    count = len(curves.closed)
    breaks, filled = np.diff(rows, prepend=-2) > 1, np.flatnonzero(np.diff(curves.ring_starts) > 0)
    z_of = subject.z_of[np.repeat(np.arange(len(curves.heights)), np.diff(curves.layer_starts))]
    faults = _group_faults(nc, rows, nc.ring, breaks, "contour ring", z_of, filled)
    rows = rows[nc.ring[rows] < count]
    spans = fitted_spans(curves, config.machine.printed_decimals)
    t = np.linspace(0.0, 1.0, SAMPLES)
    sampled = spans.at(np.repeat(np.arange(spans.ring.size), SAMPLES), np.tile(t, spans.ring.size))
    sampled = sampled.reshape(-1, SAMPLES, 2)
    driven = nc.evaluate(rows, t[None])
    # Closed rings that are driven the other way than planned: as a shape they are the same.
    once = ~nc.overlap[rows]
    driven_mm2 = np.bincount(nc.ring[rows[once]], _left_mm2(driven[once]), minlength=count)
    planned_mm2 = np.bincount(spans.ring, _left_mm2(sampled), minlength=count)
    turned = np.flatnonzero(np.asarray(curves.closed) & (driven_mm2 * planned_mm2 < 0.0))
    first = [int(rows[once][np.argmax(nc.ring[rows[once]] == k)]) for k in turned]
    faults += [(nc.where(row), f"contour ring {nc.ring[row]} is driven the other way") for row in first]
    distance, alike = _same_parameters(nc, rows, driven, spans, sampled, count)
    # Splines were written as lines or arcs by the settings, or because the control has nothing else.
    carried = np.isin(nc.kind[rows], (POLYNOMIAL, SPLINE_SPAN)).any()
    chords = not carried and (np.asarray(curves.kind) == SPLINE).any()
    chords = chords or config.machine.curve_form in ("lines", "arcs")
    limit = PATH_TOLERANCE_MM + (config.machine.line_tolerance_mm if chords else 0.0)
    rings = np.flatnonzero(~alike & (np.bincount(nc.ring[rows], minlength=count) > 0))
    motions_of, spans_of = _grouped(nc.ring[rows], count), _grouped(spans.ring, count)
    pieces, wanted_pieces = (_chord_counts(at, CHORD_SHARE * limit) for at in (driven, sampled))

    def work(start: int, stop: int) -> None:
        for ring in rings[start:stop]:
            mine, others = motions_of[ring], spans_of[ring]
            motion, at = _along(pieces[mine])
            span, place = _along(wanted_pieces[others])
            way, fitted = nc.evaluate(rows[mine][motion], at), spans.at(others[span], place)
            distance[mine] = shape_distance(way, motion, fitted) if len(fitted) else np.inf

    run_blocks(work, len(rings))
    what = "distance from the fitted curve, both ways"
    return [
        count_check("contour rings", faults, f"{count} rings, each once, in its layer and in its direction"),
        # The joint of two motions lies as far off by either: rounded, the first of them is named.
        worst_check("contour path", nc, rows, np.round(distance, 9), limit, "mm", what),
    ]


def _chord_counts(points: Floats, most_mm: float) -> Ints:
    """Number of chords (n,) that keep curves, (n, m, 2) at equal steps of their parameter, within a distance: chords err by the
    second difference over 8."""
    bend = np.linalg.norm(np.diff(points, n=2, axis=1), axis=2).max(axis=1, initial=0.0) / 8.0
    return 1 + np.asarray((points.shape[1] - 1) * np.sqrt(np.nan_to_num(bend) / most_mm), np.int64)


def _along(chords: Ints) -> tuple[Ints, Floats]:
    """Curve and parameter of each chord end, in order, for curves of `chords` (n,) chords."""
    index = np.repeat(np.arange(chords.size), chords + 1)
    return index, (np.arange(index.size) - (np.cumsum(chords + 1) - chords - 1)[index]) / chords[index]


def _grouped(ring: Ints, count: int) -> list[Ints]:
    """Rising indices of each ring's rows in a column."""
    return np.split(np.argsort(ring, kind="stable"), np.cumsum(np.bincount(ring, minlength=count))[:-1])


def _left_mm2(points: Floats) -> Floats:
    """Twice the area (n,) between the origin and paths (n, m, 2), positive where it lies on their left."""
    x, y = points[..., 0], points[..., 1]
    return np.asarray((x[:, :-1] * y[:, 1:] - x[:, 1:] * y[:, :-1]).sum(axis=1), np.float64)


def _group_faults(
    nc: NCProgram, rows: Ints, group: Ints, breaks: Bools, what: str, z_of: Floats, wanted: Ints
) -> list[tuple[str, str]]:
    """Rings or islands that are missing, come twice, are unknown, or lie at another Z than expected."""
    # `breaks` (n,) is true where a motion begins a new group even if the one before has the same number.
    ids = group[rows]
    begins = np.flatnonzero(breaks | (np.diff(ids, prepend=-1) != 0))
    found = ids[begins]
    faults = []
    seen: set[int] = set()
    for number, row in zip(found.tolist(), rows[begins], strict=True):
        if number >= z_of.size:
            faults.append((nc.where(row), f"{what} {number} is not known"))
        elif number in seen:
            faults.append((nc.where(row), f"{what} {number} comes a second time"))
        elif not abs(nc.end[row, 2] - z_of[number]) <= PLACE_MM:
            at = f"Z {nc.end[row, 2]:g} in place of {z_of[number]:g}"
            faults.append((nc.where(row), f"{what} {number} at {at}"))
        seen.add(number)
    for number in sorted(set(wanted.tolist()) - seen):
        after = rows[begins][found < number]
        where = nc.where(int(after[-1])) if after.size else f"{nc.files[0].name}:1"
        faults.append((where, f"{what} {number} is missing"))
    return faults


def _same_parameters(
    nc: NCProgram, rows: Ints, driven: Floats, spans: FittedSpans, fitted: Floats, count: int
) -> tuple[Floats, Bools]:
    """Largest distance of each motion from its span (n,), and whether each ring (R,) has one block per span."""
    kind = np.full(rows.size, -1)
    for piece, names in ((LINE, [STRAIGHT]), (SPLINE, [POLYNOMIAL, SPLINE_SPAN]), (ARC, [motions.ARC])):
        kind[np.isin(nc.kind[rows], names)] = piece
    order = np.argsort(nc.ring[rows], kind="stable")
    row_count = np.bincount(nc.ring[rows], minlength=count)
    span_count = np.bincount(spans.ring, minlength=count)
    alike = row_count == span_count
    # Rings start where the fitted ones do.
    ring, row = np.unique(nc.ring[rows], return_index=True)
    wanted, span = np.unique(spans.ring, return_index=True)
    both, i, j = np.intersect1d(ring, wanted, assume_unique=True, return_indices=True)
    apart = np.abs(nc.start[rows[row[i]], :2] - fitted[span[j], 0])
    alike &= np.isin(np.arange(count), both[apart.max(axis=1, initial=0.0) <= PLACE_MM])
    pick, span_pick = order[alike[nc.ring[rows[order]]]], np.flatnonzero(alike[spans.ring])
    same_kind = kind[pick] == spans.kind[span_pick]
    alike[spans.ring[span_pick][~same_kind]] = False
    distance = np.full(rows.size, np.nan)
    distance[pick] = np.linalg.norm(driven[pick] - fitted[span_pick], axis=2).max(axis=1, initial=0.0)
    return distance, alike


def hatch_checks(subject: Subject) -> list[Check]:
    """Compare islands, their order and their vectors with the plan."""
    nc, plan, config = subject.nc, subject.plan, subject.config
    assert plan is not None
    vectors = nc.vectors()
    rows = vectors["row"].to_numpy()
    driven = vectors[["x0", "y0", "x1", "y1"]].to_numpy()
    # The plan's own columns: what the writer takes of them is on trial.
    island = np.asarray(plan.vectors.island, np.int64)
    columns = [getattr(plan.vectors, name) for name in ("x0", "y0", "x1", "y1")]
    ends = np.stack([np.asarray(column, np.float64) for column in columns], axis=1)
    rounded = np.round(ends, config.machine.printed_decimals)
    kept = (rounded[:, :2] != rounded[:, 2:]).any(axis=1)
    island, ends = island[kept], ends[kept]
    new_layer = np.diff(nc.layer[rows], prepend=-1) != 0
    expected_z = subject.z_of[np.asarray(plan.island_layer, dtype=np.int64)]
    faults = _group_faults(nc, rows, nc.island, new_layer, "island", expected_z, np.unique(island))
    order = np.asarray(plan.order, dtype=np.int64)
    order = order[np.isin(order, island)]
    found = nc.island[rows][np.flatnonzero(np.diff(nc.island[rows], prepend=-1))]
    size = min(order.size, found.size)
    wrong = np.flatnonzero(order[:size] != found[:size])
    if not faults and wrong.size:
        row = int(rows[nc.island[rows] == found[wrong[0]]][0])
        faults.append((nc.where(row), f"island {found[wrong[0]]} comes in place of island {order[wrong[0]]}"))
    return [
        count_check("islands", faults, f"{np.unique(island).size} islands, each once, in the planned order"),
        _vectors(nc, rows, driven, island, ends),
    ]


def _vectors(nc: NCProgram, rows: Ints, driven: Floats, island: Ints, ends: Floats) -> Check:
    size = min(rows.size, len(ends))
    apart = np.abs(driven[:size] - ends[:size]).max(axis=1, initial=0.0)
    apart[nc.island[rows[:size]] != island[:size]] = np.inf
    over = np.flatnonzero(apart > PATH_TOLERANCE_MM)
    name = "hatch vectors"
    if over.size:
        row, value = int(rows[over[0]]), float(apart[over[0]])
        text = f"vector of island {nc.island[row]} leaves the plan by {value:g} mm"
        return Check(name, False, value, PATH_TOLERANCE_MM, "mm", nc.where(row), text)
    if rows.size != len(ends):
        where = nc.where(int(rows[min(size, rows.size - 1)])) if rows.size else f"{nc.files[0].name}:1"
        text = f"{rows.size} vectors in the program, {len(ends)} in the plan"
        return Check(name, False, float(abs(rows.size - len(ends))), 0.0, "vectors", where, text)
    return worst_check(name, nc, rows, apart, PATH_TOLERANCE_MM, "mm", f"{rows.size} vectors as planned")


def layer_checks(nc: NCProgram, z_of: Floats, filled: Bools) -> list[Check]:
    """Check the layers that are laid, in their order, against the Z (L,) expected and whether each is to have metal."""
    rows = np.flatnonzero(nc.deposit & (nc.layer >= 0))
    calls = nc.events.row[(nc.events.kind == Kind.CALL) & (nc.events.file == 0)]
    part = np.searchsorted(calls, rows, side="right")
    begins = rows[(np.diff(nc.layer[rows], prepend=-1) != 0) | (np.diff(part, prepend=-1) != 0)]
    laid, wanted = nc.layer[begins], np.flatnonzero(filled)
    size = min(laid.size, wanted.size)
    order = np.flatnonzero(laid[:size] != wanted[:size])
    off = np.abs(nc.end[begins, 2] - z_of[laid])
    faults = [(i, f"layer {laid[i] + 1} comes in place of layer {wanted[i] + 1}") for i in order[:1].tolist()]
    said = "layer {} at Z {:g} in place of {:g}".format
    wrong = np.flatnonzero(~(off <= PLACE_MM)).tolist()
    faults += [(i, said(laid[i] + 1, nc.end[begins[i], 2], z_of[laid[i]])) for i in wrong]
    faults.sort(key=lambda fault: fault[0])
    last = [_where_called(nc, int(begins[order[0] if order.size else -1]))] if begins.size else [""]
    count = Check(
        "layer count", laid.size == wanted.size, float(laid.size), float(wanted.size), "layers",
        "" if laid.size == wanted.size else last[0],
        f"{laid.size} layers in the program, {wanted.size} expected",
    )  # fmt: skip
    heights = [(_where_called(nc, int(begins[i])), what) for i, what in faults]
    z = nc.layer_heights[nc.layer[rows]]
    rows = rows[(nc.end[rows, 2] != z) | (nc.start[rows, 2] != z)]
    tilted = row_faults(nc, rows, "deposit at Z {:g} in a layer at another Z", nc.end[rows, 2])
    return [
        count,
        count_check("layer heights", heights, "steps of Z are those of the layers"),
        count_check("flat layers", tilted, "every deposit of a layer at its Z"),
    ]


def _where_called(nc: NCProgram, row: int) -> str:
    """Place of the call by which a motion is run; of the motion itself in a program without calls."""
    events = nc.events
    before = np.flatnonzero((events.kind == Kind.CALL) & (events.file == 0) & (events.row <= row))
    return nc.where_event(int(before[-1])) if before.size and nc.file[row] != 0 else nc.where(row)
