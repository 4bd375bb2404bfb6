"""Fallback: rings without evidence are fitted again by a more cautious method, then by the next one.

The requested method is followed by the interpolating fit by chord length, whose points stay on the contour, then by the
contour's own polyline. Points on the edges of a known mesh are mostly uneven: there the polyline follows at once. If two rings
cross, both fall back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ebamcheck.curves.allowances import Allowances
from ebamcheck.curves.cleaning import clean
from ebamcheck.curves.columns import Curves, Evidence
from ebamcheck.curves.evidence import CROSSING, evidence
from ebamcheck.curves.splitting import LINE
from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.rings import Bools, Ints

METHODS = ("", "chord", "polyline")
"""Methods in the order in which a ring falls back; "" is the requested one."""

POLYLINE = len(METHODS) - 1

MOST_ROUNDS = 6
"""Most rounds of falling back: a ring falls at most twice, but its neighbours may have to follow it."""


def with_fallback(
    curves: Curves,
    layers: Layers,
    allowed: Allowances,
    slack_mm: float,
    plane_slack_mm: float,
    chord: Callable[[Layers], Curves] | None,
) -> Curves:
    """Replace the rings that are not accepted by more cautious fits, and return all with their evidence.

    Parameters
    ----------
    curves, layers
        Curves by the requested method, and the contours that they were fitted to.
    allowed, slack_mm, plane_slack_mm
        As for :func:`ebamcheck.curves.evidence.evidence`.
    chord
        The interpolating fit; None to skip it, where it is the requested one or is not trusted.
    """
    asked = found = evidence(curves, layers, allowed, slack_mm, plane_slack_mm)
    fallen = np.zeros(curves.closed.size, np.uint8)
    for _ in range(MOST_ROUNDS):
        falling = ~found.accepted & (fallen < POLYLINE)
        if not falling.any():
            break
        asked = _with_causes_of(asked, found, falling & (fallen == 0))
        for method in range(
            POLYLINE, 0, -1
        ):  # those that fall to the last go first: none falls twice in a round
            chosen = falling & (fallen == method - 1)
            if not chosen.any():
                continue
            to = POLYLINE if chord is None else method
            some = rings_of(layers, chosen)
            refitted = chord(some) if chord is not None and to < POLYLINE else polylines(some)
            curves = with_rings(curves, refitted, chosen)
            fallen[chosen] = to
        found = evidence(curves, layers, allowed, slack_mm, plane_slack_mm)
    # A polyline is the contour itself: what is still wrong with it was wrong with the contour, not with the fit.
    accepted = found.accepted | ((fallen == POLYLINE) & (found.cause != CROSSING))
    if not accepted.all():
        accepted |= ~evidence(polylines(layers), layers, allowed, slack_mm, plane_slack_mm).accepted
    return replace(curves, evidence=replace(asked, method=fallen, accepted=accepted))


def _with_causes_of(asked: Evidence, found: Evidence, which: Bools) -> Evidence:
    """The evidence found at first, with the causes of the rings that have since had to follow others."""
    for name in ("cause", "value_mm", "limit_mm", "at"):
        getattr(asked, name)[which] = getattr(found, name)[which]
    return asked


def polylines(layers: Layers) -> Curves:
    """Contours as curves, without points that repeat or lie on the line between their neighbours."""
    cleaned = clean(np.ascontiguousarray(layers.points), layers.ring_starts, layers.closed, 0.0, 0.0)
    sizes = np.diff(cleaned.starts)
    more = sizes + (layers.closed & (sizes > 0))
    control_starts = np.concatenate([[0], np.cumsum(more)]).astype(np.int64)
    ring = np.repeat(np.arange(sizes.size), more)
    place = np.arange(control_starts[-1]) - control_starts[ring]
    rows = cleaned.rows[cleaned.starts[ring] + place % sizes[ring]]
    filled = sizes > 0
    count = int(np.count_nonzero(filled))
    return Curves(
        heights=layers.heights,
        layer_starts=layers.layer_starts,
        ring_starts=np.concatenate([[0], np.cumsum(filled)]).astype(np.int64),
        closed=layers.closed,
        kind=np.full(count, LINE, np.uint8),
        control_starts=np.concatenate([[0], np.cumsum(more[filled])]).astype(np.int64),
        control=np.ascontiguousarray(layers.points)[rows],
        knot_starts=np.zeros(count + 1, np.int64),
        knots=np.zeros(0),
    )


def rings_of(layers: Layers, which: Bools) -> Layers:
    """The layers with only some of their rings."""
    sizes = np.diff(layers.ring_starts)
    rows = np.repeat(which, sizes)
    counts = np.bincount(layers.ring_layer[which], minlength=len(layers))
    return replace(
        layers,
        points=layers.points[rows],
        ring_starts=np.concatenate([[0], np.cumsum(sizes[which])]).astype(np.int64),
        layer_starts=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        closed=layers.closed[which],
        edge=None if layers.edge is None else layers.edge[rows],
        edge_t=None if layers.edge_t is None else layers.edge_t[rows],
    )


def with_rings(curves: Curves, others: Curves, which: Bools) -> Curves:
    """Curves in which the rings marked by `which` (R,) are replaced, in order, by those of `others`."""
    count = curves.closed.size
    source = np.arange(count)
    source[which] = count + np.arange(others.closed.size)
    both = [curves, others]
    pieces, ring_starts = _chosen(_put_together([c.ring_starts for c in both]), source)
    rows, control_starts = _chosen(_put_together([c.control_starts for c in both]), pieces)
    knots, knot_starts = _chosen(_put_together([c.knot_starts for c in both]), pieces)
    return replace(
        curves,
        ring_starts=ring_starts,
        kind=np.concatenate([c.kind for c in both])[pieces],
        control_starts=control_starts,
        control=np.concatenate([c.control for c in both])[rows],
        knot_starts=knot_starts,
        knots=np.concatenate([c.knots for c in both])[knots],
    )


def _put_together(starts: list[Ints]) -> Ints:
    """Starts of several ragged columns, one after the other."""
    sizes = np.concatenate([np.diff(s) for s in starts])
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


def _chosen(starts: Ints, groups: Ints) -> tuple[Ints, Ints]:
    """Indices of the members of some groups of a ragged column, and the starts of the column that they make."""
    sizes = np.diff(starts)[groups]
    new_starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    members = np.arange(new_starts[-1]) + np.repeat(starts[:-1][groups] - new_starts[:-1], sizes)
    return members.astype(np.int64), new_starts
