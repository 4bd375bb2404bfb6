"""Exact areas of two regions and of their symmetric difference, by a slab sweep.

Between two neighbouring vertex levels all edges are straight; ordered by x they cut the slab into
trapezoids, each wholly inside or outside either region (winding number > 0). Where edges cross inside the
slab, the few that do are split at their crossings. An order that rounding gets wrong costs the area between
edges that coincide within rounding, so the result is sound for shared edges and touching rings too.

On the way the sweep hands on the trapezoids of the symmetric difference that may be deep; all others are
ruled out by a bound that costs two distances (see :mod:`ebamcheck.comparison.depth`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.comparison.outline import Outline, distance_to_segment
from ebamcheck.kernels import kernel
from ebamcheck.rings import Bools, Floats, Ints

MOST_SPLITS = 20_000_000
"""Work on crossings (edges times crossings) in one sweep; beyond it the caller uses shapely instead."""


class Deepest(NamedTuple):
    """Greatest depth found so far, and where."""

    depth_mm: float
    x_mm: float
    y_mm: float


class Overlap(NamedTuple):
    """What a sweep over two outlines finds."""

    area_a_mm2: float
    area_b_mm2: float
    symmetric_difference_mm2: float
    suspects: Floats
    """(T, 7) trapezoids of the symmetric difference that may be deeper than what is known: y of the lower and
    of the upper side, x of the left side at both, x of the right side at both, upper bound of the depth."""
    sound: bool
    """False where the crossings were too many to be split."""


@kernel
def overlap(a: Outline, b: Outline, from_a: bool, from_b: bool, enough: float) -> Overlap:
    """Sweep over two outlines.

    Parameters
    ----------
    from_a, from_b
        Contours from which depth is measured; with both, depth is the distance from the nearer one.
    enough
        Only trapezoids that may be deeper than this, mm, are handed on.
    """
    edges, steps, of_a = _merged_edges(a, b)
    levels = _merged_levels(a.levels, b.levels)
    count = len(edges)
    active = np.empty(count, np.int64)
    waiting = np.empty(count, np.int64)
    bottom = np.empty(count)
    top = np.empty(count)
    mixed = np.empty(count, np.bool_)
    least = np.empty(count)
    order = np.empty(count, np.int64)
    cuts = np.empty(64)
    slopes = np.empty(count)
    for e in range(count):
        slopes[e] = (edges[e, 2] - edges[e, 0]) / (edges[e, 3] - edges[e, 1])
    counts = np.where(of_a, from_a, from_b)
    areas = np.zeros(3)
    suspects = np.empty((64, 7))
    found = 0
    splits = 0
    n = 0
    following = 0
    for level in range(levels.size - 1):
        y0, y1 = levels[level], levels[level + 1]
        entered = following
        while following < count and edges[following, 1] == y0:
            following += 1
        n = _enter(active, top, waiting, bottom, edges, n, entered, following)
        active, waiting = waiting, active
        if n == 0:
            continue
        crossed = _cross_slab(edges, slopes, active, bottom, top, n, y1)
        if crossed:
            _mark_mixed(top, mixed, least, n)
        winding_a = 0
        winding_b = 0
        k = 0
        while k < n:
            e = active[k]
            if crossed and k < n - 1 and mixed[k]:
                stop = k + 1
                while stop < n - 1 and mixed[stop]:
                    stop += 1
                size = stop - k + 1
                cuts, cut_count = _cuts(bottom, top, k, stop, cuts)
                splits += size * cut_count
                if splits > MOST_SPLITS:
                    return Overlap(0.0, 0.0, 0.0, suspects[:0], False)
                for m in range(size):
                    order[m] = k + m
                for c in range(cut_count - 1):
                    t0, t1 = cuts[c], cuts[c + 1]
                    if t0 == t1:
                        continue
                    _sort_between(order, size, bottom, top, 0.5 * (t0 + t1))
                    wa, wb = winding_a, winding_b
                    za, zb = y0 + t0 * (y1 - y0), y0 + t1 * (y1 - y0)
                    for m in range(size - 1):
                        p, q = order[m], order[m + 1]
                        if of_a[active[p]]:
                            wa += steps[active[p]]
                        else:
                            wb += steps[active[p]]
                        l0, l1 = _between(bottom[p], top[p], t0), _between(bottom[p], top[p], t1)
                        r0, r1 = _between(bottom[q], top[q], t0), _between(bottom[q], top[q], t1)
                        _add(areas, wa, wb, 0.5 * ((r0 - l0) + (r1 - l1)) * (zb - za))
                        if (wa > 0) != (wb > 0):
                            e, f = active[p], active[q]
                            high = _ceiling(za, zb, l0, l1, r0, r1, edges, e, f, counts[e], counts[f], enough)
                            if high > enough:
                                suspects = _kept(suspects, found, za, zb, l0, l1, r0, r1, high)
                                found += 1
                # The windings right of the block's last edge come from that edge itself, next.
                for m in range(k, stop):
                    if of_a[active[m]]:
                        winding_a += steps[active[m]]
                    else:
                        winding_b += steps[active[m]]
                k = stop
                if k < n - 1 and mixed[k]:
                    continue
                e = active[k]
            if of_a[e]:
                winding_a += steps[e]
            else:
                winding_b += steps[e]
            if k < n - 1:
                in_a, in_b = winding_a > 0, winding_b > 0
                if in_a or in_b:
                    l0, l1, r0, r1 = bottom[k], top[k], bottom[k + 1], top[k + 1]
                    _add(areas, winding_a, winding_b, 0.5 * ((r0 - l0) + (r1 - l1)) * (y1 - y0))
                    if in_a != in_b:
                        f = active[k + 1]
                        high = _ceiling(y0, y1, l0, l1, r0, r1, edges, e, f, counts[e], counts[f], enough)
                        if high > enough:
                            suspects = _kept(suspects, found, y0, y1, l0, l1, r0, r1, high)
                            found += 1
            k += 1
        if winding_a != 0 or winding_b != 0:
            return Overlap(0.0, 0.0, 0.0, suspects[:0], False)
        n = _leave(edges, active, top, n, y1)
    return Overlap(areas[0], areas[1], areas[2], suspects[:found].copy(), True)


@kernel
def _merged_edges(a: Outline, b: Outline) -> tuple[Floats, Ints, Bools]:
    """Edges of both outlines in one order, their steps, and which are of `a`."""
    count = len(a.edges) + len(b.edges)
    edges = np.empty((count, 4))
    steps = np.empty(count, np.int64)
    of_a = np.empty(count, np.bool_)
    i = 0
    j = 0
    for n in range(count):
        take_a = j == len(b.edges)
        if i < len(a.edges) and not take_a:
            ya, yb = a.edges[i, 1], b.edges[j, 1]
            take_a = ya < yb or (ya == yb and a.edges[i, 0] <= b.edges[j, 0])
        of_a[n] = take_a
        if take_a:
            edges[n], steps[n] = a.edges[i], a.steps[i]
            i += 1
        else:
            edges[n], steps[n] = b.edges[j], b.steps[j]
            j += 1
    return edges, steps, of_a


@kernel
def _merged_levels(a: Floats, b: Floats) -> Floats:
    """All levels of two outlines, each once, strictly increasing like those of each."""
    levels = np.empty(a.size + b.size)
    i = 0
    j = 0
    count = 0
    while i < a.size or j < b.size:
        if j == b.size or (i < a.size and a[i] <= b[j]):
            y = a[i]
            i += 1
        else:
            y = b[j]
            j += 1
        if count == 0 or y != levels[count - 1]:
            levels[count] = y
            count += 1
    return levels[:count]


@kernel
def _enter(
    active: Ints,
    top: Floats,
    merged: Ints,
    bottom: Floats,
    edges: Floats,
    n: int,
    entered: int,
    following: int,
) -> int:
    """Merge the edges that start at a level into those that go on, by their x there; new count."""
    k = 0
    count = 0
    while k < n or entered < following:
        if entered == following or (k < n and top[k] <= edges[entered, 0]):
            merged[count], bottom[count] = active[k], top[k]
            k += 1
        else:
            merged[count], bottom[count] = entered, edges[entered, 0]
            entered += 1
        count += 1
    return count


@kernel
def _cross_slab(
    edges: Floats, slopes: Floats, active: Ints, bottom: Floats, top: Floats, n: int, y: float
) -> bool:
    """Find x of every edge at the upper side of a slab; whether any two cross on the way there.

    Edges that share a point below are ordered by where they go.
    """
    crossed = False
    for k in range(n):
        e, x0 = active[k], bottom[k]
        x1 = _x_at(edges, slopes, e, y)
        j = k
        while j > 0 and bottom[j - 1] == x0 and top[j - 1] > x1:
            active[j], top[j] = active[j - 1], top[j - 1]
            j -= 1
        active[j], top[j] = e, x1
        crossed = crossed or (j > 0 and top[j - 1] > x1)
    return crossed


@kernel
def _x_at(edges: Floats, slopes: Floats, e: int, y: float) -> float:
    """x of an edge at a level above its lower end; exact at its upper end."""
    if y == edges[e, 3]:
        return float(edges[e, 2])
    x = edges[e, 0] + (y - edges[e, 1]) * slopes[e]
    return float(min(max(x, min(edges[e, 0], edges[e, 2])), max(edges[e, 0], edges[e, 2])))


@kernel
def _mark_mixed(top: Floats, mixed: Bools, least: Floats, n: int) -> None:
    """Mark the gaps (k, k + 1) that lie between edges that cross, or next to an edge that crosses."""
    least[n - 1] = top[n - 1]
    for k in range(n - 2, -1, -1):
        least[k] = min(top[k], least[k + 1])
    greatest = -np.inf
    before = False
    for k in range(n - 1):
        greatest = max(greatest, top[k])
        here = greatest > least[k + 1]
        mixed[k] = here or before
        if here and k > 0:
            mixed[k - 1] = True
        before = here


@kernel
def _cuts(bottom: Floats, top: Floats, first: int, last: int, cuts: Floats) -> tuple[Floats, int]:
    """Heights within a slab, as shares of it, at which edges `first .. last` cross, with 0 and 1, sorted."""
    cuts[0], cuts[1] = 0.0, 1.0
    count = 2
    for p in range(first, last):
        for q in range(p + 1, last + 1):
            below, above = bottom[q] - bottom[p], top[p] - top[q]
            if above > 0.0 and below > 0.0:
                if count == cuts.size:
                    larger = np.empty(2 * count)
                    larger[:count] = cuts
                    cuts = larger
                cuts[count] = below / (below + above)
                count += 1
    if count == 3:
        cuts[1], cuts[2] = cuts[2], 1.0
    elif count > 3:
        cuts[:count].sort()
    return cuts, count


@kernel
def _between(x0: float, x1: float, t: float) -> float:
    """x at share `t` of a slab; exact at both ends."""
    return x1 if t == 1.0 else x0 + t * (x1 - x0)


@kernel
def _sort_between(order: Ints, size: int, bottom: Floats, top: Floats, t: float) -> None:
    """Sort edges by x at share `t` of a slab (they are nearly sorted)."""
    for k in range(1, size):
        e = order[k]
        x = _between(bottom[e], top[e], t)
        j = k
        while j > 0 and _between(bottom[order[j - 1]], top[order[j - 1]], t) > x:
            order[j] = order[j - 1]
            j -= 1
        order[j] = e


@kernel
def _add(areas: Floats, winding_a: int, winding_b: int, area: float) -> None:
    """Add the area of a trapezoid to the sums it belongs to."""
    in_a, in_b = winding_a > 0, winding_b > 0
    if in_a:
        areas[0] += area
    if in_b:
        areas[1] += area
    if in_a != in_b:
        areas[2] += max(area, 0.0)


@kernel
def _leave(edges: Floats, active: Ints, top: Floats, n: int, y: float) -> int:
    """Drop the edges that end at a level and order the rest by x there; new count."""
    count = 0
    for k in range(n):
        e, x = active[k], top[k]
        if edges[e, 3] == y:
            continue
        j = count
        while j > 0 and top[j - 1] > x:
            active[j], top[j] = active[j - 1], top[j - 1]
            j -= 1
        active[j], top[j] = e, x
        count += 1
    return count


@kernel
def _ceiling(
    y0: float, y1: float, l0: float, l1: float, r0: float, r1: float,
    edges: Floats, left: int, right: int, left_counts: bool, right_counts: bool, enough_mm: float,
) -> float:  # fmt: skip
    """No point of a trapezoid between edges `left` and `right` is deeper than this.

    The distance from a fixed segment is convex, so over a trapezoid it is greatest at a corner; and where
    both sides count, the mean of the two distances bounds the lesser. A first answer within `enough_mm`
    will do.
    """
    if not (left_counts or right_counts):
        return np.inf
    share = 0.5 if left_counts and right_counts else 1.0
    ceiling = share * max(r0 - l0, r1 - l1)
    if ceiling <= enough_mm:
        return ceiling
    ceiling = 0.0
    if left_counts:
        ceiling = max(distance_to_segment(r0, y0, edges, left), distance_to_segment(r1, y1, edges, left))
    if right_counts:
        ceiling = max(
            ceiling, distance_to_segment(l0, y0, edges, right), distance_to_segment(l1, y1, edges, right)
        )
    return float(share * ceiling)


@kernel
def _kept(
    suspects: Floats,
    found: int,
    y0: float,
    y1: float,
    l0: float,
    l1: float,
    r0: float,
    r1: float,
    high: float,
) -> Floats:
    """Add a trapezoid to the suspects, which grow as needed."""
    if found == len(suspects):
        larger = np.empty((2 * found, 7))
        larger[:found] = suspects
        suspects = larger
    suspects[found, 0], suspects[found, 1] = y0, y1
    suspects[found, 2], suspects[found, 3] = l0, l1
    suspects[found, 4], suspects[found, 5] = r0, r1
    suspects[found, 6] = high
    return suspects
