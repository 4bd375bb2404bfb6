"""What young heat does to entries beyond the means of islands, over the time since: worked out where it is asked for.

Of all the ways in which one island of a large layer may follow another near it, a search tries one in a hundred.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.scan.heat.falling import falling
from ebamcheck.scan.heat.near_field import FAR, NearField, at_root, young_mean
from ebamcheck.scan.heat.pieces import OPTIONS

YOUNG_NODES = 12
"""Times until the horizon of young heat. Their spacing grows with the time, as heat changes ever more slowly: node n of N
lies at horizon (n / (N - 1))^2."""

Table = NDArray[np.float32]


class FreshTable(NamedTuple):
    """What young heat does to entries beyond the rises of islands that are near each other.

    Parameters
    ----------
    near, source_k_s, time_s, since_s
        What it is worked out from: the near field, sources (I,) as in :class:`~ebamcheck.scan.heat.amplitudes.Modes`, the time
        in which each island is scanned (I,), and the times of the table (N,); after the last, the horizon, it is nothing.
    slot
        (I, I) row of the next tables for an island and the source, or -1.
    known
        (P, 4) whether it is worked out, by the entry option of the source.
    excess_k
        (P, 4, 4, N) of the temperature of its entry over its mean, by its entry option and that of the source.
    """

    near: NearField
    source_k_s: Floats
    time_s: Floats
    since_s: Floats
    slot: NDArray[np.int32]
    known: Bools
    excess_k: Table


def fresh_table(near: NearField, source_k_s: Floats, time_s: Floats, since_s: Floats) -> FreshTable:
    """Return a table in which nothing is worked out yet."""
    count, rows = len(time_s), len(near.other)
    slot = np.full((count, count), -1, np.int32)
    slot[np.repeat(np.arange(count), np.diff(near.first)), near.other] = np.arange(rows)
    excess_k = np.zeros((rows, OPTIONS, OPTIONS, YOUNG_NODES), np.float32)
    return FreshTable(near, source_k_s, time_s, since_s, slot, np.zeros((rows, OPTIONS), np.bool_), excess_k)


@kernel
def work_out(table: FreshTable, row: int, island: int, source: int, left_by: int) -> None:
    """Work out a row for one entry option of the source: all entries of the island, at all times."""
    near, since, time = table.near, table.since_s, table.time_s[source]
    depth, horizon, inside, entry = near.depth, near.horizon_s, near.inside[island], near.entry[island]
    pieces, passed, entry_k = near.pieces, near.pieces.passed[left_by], np.zeros((OPTIONS, len(since)))
    root, strength, inverse, limit, held = (
        np.empty(len(since)), np.empty(len(since)), np.empty(len(since)), np.empty(len(since)), np.empty(len(since)),
    )  # fmt: skip
    for m in range(pieces.first[source], pieces.first[source + 1]):
        used = 0
        for n in range(len(since)):
            age = since[n] + (1.0 - passed[m]) * time
            if age > horizon:
                break
            used, variance = n + 1, pieces.variance[m] + near.beam_mm2 + near.spread_mm2_s * age
            root[n] = np.sqrt(age / horizon)
            strength[n] = pieces.share[m] * at_root(depth, root[n]) / (2.0 * np.pi * variance)
            inverse[n], limit[n] = -0.5 / variance, FAR * variance
        for w in range(OPTIONS):
            away = (pieces.place[m, 0] - entry[w, 0]) ** 2 + (pieces.place[m, 1] - entry[w, 1]) ** 2
            for n in range(used):
                held[n] = at_root(inside[w], root[n])
            for n in range(used):
                dense = np.true_divide(strength[n] * falling(inverse[n] * away), held[n])
                entry_k[w, n] += 0.0 if away > limit[n] else dense
    for n in range(len(since)):
        mean = young_mean(near, near.pair[row], since[n], time)
        for w in range(OPTIONS):
            table.excess_k[row, w, left_by, n] = table.source_k_s[source] * (entry_k[w, n] * time - mean)
    table.known[row, left_by] = True


@kernel
def work_out_all(table: FreshTable, start: int, stop: int) -> None:
    """Work out the rows of some sources: all entries near one side by side, piece by piece of it."""
    near, slot, since, time, source_k_s = (
        table.near,
        table.slot,
        table.since_s,
        table.time_s,
        table.source_k_s,
    )
    first, other, most = near.first, near.other, np.diff(near.first).max()
    mean, x, y = np.empty((most, len(since))), np.empty(most * OPTIONS), np.empty(most * OPTIONS)
    inside, entry_k = np.empty((near.inside.shape[2], most * OPTIONS)), np.empty(most * OPTIONS)
    for j in range(start, stop):
        beside = other[first[j] : first[j + 1]]
        used = OPTIONS * len(beside)
        for b in range(len(beside)):
            for n in range(len(since)):
                mean[b, n] = young_mean(near, near.pair[first[j] + b], since[n], time[j])
            for option in range(OPTIONS):
                e, i = OPTIONS * b + option, beside[b]
                x[e], y[e] = near.entry[i, option, 0], near.entry[i, option, 1]
                inside[:, e] = near.inside[i, option]
        for left_by in range(OPTIONS):
            for n in range(len(since)):
                entry_k[:used] = 0.0
                _add_pieces(near, j, left_by, since[n], time[j], x[:used], y[:used], inside, entry_k)
                for b in range(len(beside)):
                    row = slot[beside[b], j]
                    for option in range(OPTIONS):
                        rest = entry_k[OPTIONS * b + option] * time[j] - mean[b, n]
                        if beside[b] != j:
                            table.excess_k[row, option, left_by, n] = source_k_s[j] * rest
        table.known[first[j] : first[j + 1]] = True


@kernel
def _add_pieces(
    near: NearField,
    source: int,
    left_by: int,
    since: float,
    time: float,
    x: Floats,
    y: Floats,
    inside: Floats,
    rise: Floats,
) -> None:
    """Add to the rises (E,) at entries what :func:`~ebamcheck.scan.heat.near_field.entry_rise` has for one second of heating.

    Parameters
    ----------
    x, y
        (E,) the entries, mm.
    inside
        (Q + 1, E) share of the heat around each that is in the section, by ages.
    """
    pieces, depth, horizon, columns = near.pieces, near.depth, near.horizon_s, len(inside) - 1
    place, passed, variances, share = pieces.place, pieces.passed[left_by], pieces.variance, pieces.share
    for m in range(pieces.first[source], pieces.first[source + 1]):
        age = since + (1.0 - passed[m]) * time
        if age > horizon:
            continue
        variance = variances[m] + near.beam_mm2 + near.spread_mm2_s * age
        root = np.sqrt(age / horizon)
        strength = share[m] * at_root(depth, root) / (2.0 * np.pi * variance)
        node = min(int(root * columns), columns - 1)
        between, inverse, limit = root * columns - node, -0.5 / variance, FAR * variance
        low, high, px, py = inside[node], inside[node + 1], place[m, 0], place[m, 1]
        for e in range(len(x)):
            away = (px - x[e]) ** 2 + (py - y[e]) ** 2
            dense = np.true_divide(strength * falling(inverse * away), low[e] + (high[e] - low[e]) * between)
            rise[e] += 0.0 if away > limit else dense
