"""The pieces of fitted contours as segments that a machine can drive: straight, cubic or circular."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.nc.inputs import ARC, LINE, SPLINE, CurveColumns
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.writing.biarcs import spline_arcs
from ebamcheck.writing.circles import arc_chords
from ebamcheck.writing.polynomials import Spans, chords, spans

STRAIGHT, CUBIC, CIRCULAR = range(3)
"""Kinds of segments."""

Form = Literal["cubics", "arcs", "chords", "all chords"]
"""What splines become: cubics, exactly, or arcs or chords within a tolerance. Arcs stay arcs, but for "all chords"."""


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments of all pieces, in the order of travel."""

    starts: Ints
    """(P + 1,) first segment of each piece."""
    kind: NDArray[np.uint8]
    """(N,) :data:`STRAIGHT`, :data:`CUBIC` or :data:`CIRCULAR`."""
    end: Floats
    """(N, 2) mm."""
    bezier: Floats
    """(C, 4, 2) Bezier points of the cubic segments alone, in their order."""
    middle: Floats
    """(A, 2) points half-way along the circular segments alone, in their order."""


class _Made(NamedTuple):
    """Segments of the pieces of one kind."""

    sizes: Ints
    """(p,) segments of each."""
    end: Floats
    kind: int = STRAIGHT
    middle: Floats | None = None


def contour_segments(curves: CurveColumns, form: Form, tolerance_mm: float) -> Segments:
    """Turn every piece into segments; those of splines and arcs leave them by at most `tolerance_mm`."""
    piece_kind = np.asarray(curves.kind)
    control = np.asarray(curves.control, dtype=np.float64)
    first = np.asarray(curves.control_starts, dtype=np.int64)
    found = spans(curves)
    made = {
        LINE: _lines(piece_kind, first, control),
        SPLINE: _splines(found, piece_kind == SPLINE, form, tolerance_mm),
        ARC: _arcs(control, first[:-1][piece_kind == ARC], form, tolerance_mm),
    }
    count = np.zeros(piece_kind.size, np.int64)
    for which, part in made.items():
        count[piece_kind == which] = part.sizes
    starts = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    owner = np.repeat(piece_kind, count)
    kind, end, middle = np.empty(owner.size, np.uint8), np.empty((owner.size, 2)), np.empty((owner.size, 2))
    for which, part in made.items():
        rows = owner == which
        kind[rows], end[rows] = part.kind, part.end
        if part.middle is not None:
            middle[rows] = part.middle
    filled = np.flatnonzero(count > 0)
    end[starts[filled + 1] - 1] = control[first[filled + 1] - 1]  # bit for bit where the next piece starts
    bezier = found.bezier if form == "cubics" else np.zeros((0, 4, 2))
    return Segments(starts, kind, end, bezier, middle[kind == CIRCULAR])


def _lines(piece_kind: NDArray[np.uint8], first: Ints, control: Floats) -> _Made:
    sizes = np.diff(first)
    ends = np.repeat(piece_kind == LINE, sizes)
    ends[first[:-1][sizes > 0]] = False
    return _Made(np.maximum(sizes[piece_kind == LINE] - 1, 0), control[ends])


def _splines(found: Spans, which: NDArray[np.bool_], form: Form, tolerance_mm: float) -> _Made:
    if form == "cubics":
        return _Made(np.diff(found.starts)[which], found.end, CUBIC)
    if form == "arcs":
        arcs = spline_arcs(found, tolerance_mm)
        return _Made(np.diff(arcs.starts)[which], arcs.end, CIRCULAR, arcs.middle)
    starts, points = chords(found, tolerance_mm)
    return _Made(np.diff(starts)[which], points)


def _arcs(control: Floats, first: Ints, form: Form, tolerance_mm: float) -> _Made:
    if form == "all chords":
        starts, points = arc_chords(control[first], control[first + 1], control[first + 2], tolerance_mm)
        return _Made(np.diff(starts), points)
    return _Made(np.ones(first.size, np.int64), control[first + 2], CIRCULAR, control[first + 1])
