"""What each island leaves in each other one, over the time since: the heat model of a layer as one table.

An order is tried thousands of times when it is improved; with the table, the temperature at which an island is
entered is a sum over the islands before it, whatever the number of modes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.heat.field import falling
from ebamcheck.heat.island_heat import IslandHeat
from ebamcheck.heat.near_field import FAR, OPTIONS, NearField, at_root, young_mean
from ebamcheck.kernels import Bools, Floats, ShortInts, kernel
from ebamcheck.threads import run_blocks

# Times of the table; :data:`YOUNG_NODES` of them until the horizon of young heat. Node m after the
# horizon lies at m^2.
NODES = 96
LEAST_RATE = 1e-9  # decay, 1/s, that an amplitude has at least: nothing within any layer, but there is an inverse of it
FALLEN = 25.0  # decays in which a mode falls to nothing beside the rounding of the table: 1e-11
FEWER = 4.0  # times of the table go together until so many times fewer modes are left
MOST_ISLANDS = 500  # beyond, the table is too large: 500 islands take 96 MB
SOURCES = 16  # islands whose part of the table a thread is worth
AT_ONCE = 8  # sources whose rises come from one product of matrices: one by one they take a third longer


class Sources(NamedTuple):
    """Islands that heat K modes of the section times N of the depth."""

    scale: Floats  # (K, I) by which each heats the section's modes, K/s
    weight: Floats  # (K, N) to which heating by 1 K/s comes in the end, in the layer
    across: Floats  # (K, I) left of the section's modes after the time in which each island is scanned
    through: Floats  # (N, I) the same of the depth's
    time_s: Floats  # (I,) that time


class Times(NamedTuple):
    """Times of the table side by side, all of them under the horizon or none."""

    start: int  # first of them in the table
    stop: int  # the one after the last
    over_s: Floats  # (Q,) by how much they are over the horizon
    across: Floats  # (M, Q) left then of those modes of the section that have not died out
    through: Floats  # (N, Q) the same of the depth's


class Influence(NamedTuple):
    """Temperature rises by islands and times."""

    # (I, I + 1, Q) mean rise of an island by another one that was scanned from cold, a time after its end; the last column is what the
    # layer's first temperature leaves, a time after the beginning
    rise_k: Table
    nodes_per_root_s: float  # a time t after the horizon lies so many sqrt(t) nodes after the node of the horizon
    fresh: FreshTable  # what entries have beyond the means


def influence(heat: IslandHeat, time_s: Floats, longest_s: float) -> Influence:
    """Tabulate the heat model of a layer: old heat by its modes, young heat as in :mod:`ebamcheck.heat.near_field`.

    `time_s`: (I,) time in which each island is scanned; `longest_s`: longest time between two islands.
    """
    near, count, young = heat.fresh, len(time_s), YOUNG_NODES - 1
    spacing = max(longest_s - near.horizon_s, 0.0) / (NODES - YOUNG_NODES) ** 2
    since = np.concatenate([
        near.horizon_s * (np.arange(young) / young) ** 2,
        near.horizon_s + spacing * np.arange(NODES - young) ** 2,
    ])  # fmt: skip
    rise = np.empty((count, count + 1, NODES), np.float32)
    # Whole products in every thread: what they round depends on which sources are in one.
    run_blocks(
        lambda a, b: old_heat(heat, time_s, near.horizon_s, since, rise, range(a * AT_ONCE, min(b * AT_ONCE, count))),
        math.ceil(count / AT_ONCE),
        SOURCES // AT_ONCE,
    )
    rise[:, count] = first_heat(heat, since)
    fresh = near, heat.modes.source_k_s, time_s, since[:YOUNG_NODES]
    add_young_heat(*fresh, rise)
    per_root = spacing**-0.5 if spacing > 0.0 else 0.0
    return Influence(rise, per_root, fresh_table(*fresh))


def first_heat(heat: IslandHeat, since_s: Floats) -> Floats:
    """Rises (I, Q) by what the layer begins with, at times (Q,) after its beginning."""
    across = np.exp(-np.multiply.outer(heat.modes.plane_rate, since_s))
    through = np.exp(-np.multiply.outer(np.maximum(heat.modes.depth_rate, LEAST_RATE), since_s))
    return np.asarray(heat.modes.mean.T @ (across * ((heat.start_k * heat.modes.in_layer) @ through)))


def old_heat(heat: IslandHeat, time_s: Floats, horizon_s: float, since_s: Floats, rise: Table, sources: range) -> None:
    """Write the rises :attr:`Influence.rise_k` by heat of sources older than the horizon, at times (Q,) after their end."""
    modes, depth_rate = heat.modes, np.maximum(heat.modes.depth_rate, LEAST_RATE)
    rate = np.add.outer(modes.plane_rate, depth_rate)
    weight = modes.in_layer**2 / rate
    heating = Sources(
        modes.source_k_s * modes.mean,
        weight,
        np.exp(-np.multiply.outer(modes.plane_rate, time_s)),
        np.exp(-np.multiply.outer(depth_rate, time_s)),
        time_s,
    )
    at_horizon = (weight * np.exp(-rate * horizon_s)).sum(axis=1)
    # Until then all heat of every source is young.
    nothing = int(np.searchsorted(since_s + time_s.max(), horizon_s, side="right"))
    spans = [
        Times(
            start, stop, since_s[start:stop] - horizon_s,
            np.exp(-np.multiply.outer(modes.plane_rate[:count], since_s[start:stop])),
            np.exp(-np.multiply.outer(depth_rate, since_s[start:stop])),
        )
        for count, start, stop in _spans(modes.plane_rate, since_s, horizon_s, nothing)
    ]  # fmt: skip
    mean = np.asarray(modes.mean, np.float32)
    rise[:, sources.start : sources.stop, :nothing] = 0.0
    for begin in range(sources.start, sources.stop, AT_ONCE):
        end = min(begin + AT_ONCE, sources.stop)
        for times in spans:
            left = left_by_sources(heating, times, at_horizon, begin, end)
            rises = mean[: len(left)].T @ left.reshape(len(left), -1)
            rise[:, begin:end, times.start : times.stop] = rises.reshape(len(rises), *left.shape[1:])


@kernel
def left_by_sources(heating: Sources, times: Times, at_horizon: Floats, begin: int, end: int) -> Table:
    """Amplitudes (M, S, Q) in the layer that some sources have left in modes by heat that is older than the horizon.

    Of a source that ended less than a horizon ago only what it began with is old; `at_horizon` (K,) is all that it comes to.
    """
    # Taken out of their tuples once: each column that is taken out is counted as one more in use.
    over, across, through, time = times.over_s, times.across, times.through, heating.time_s
    scale, weight = heating.scale, heating.weight
    scanned_across, scanned_through = heating.across, heating.through
    modes, count = across.shape
    young, held = over[0] < 0.0, np.empty(count)
    result = np.empty((modes, end - begin, count), np.float32)
    for k in range(modes):
        for j in range(begin, end):
            held[:] = 0.0
            for n in range(len(through)):
                begun = weight[k, n] * (scanned_across[k, j] * scanned_through[n, j])
                part = begun if young else weight[k, n] - begun
                for q in range(count):
                    held[q] += part * through[n, q]
            for q in range(count):
                left = across[k, q] * held[q]
                if young:
                    left = at_horizon[k] - left if over[q] + time[j] > 0.0 else 0.0
                result[k, j - begin, q] = scale[k, j] * left
    return result


def _spans(plane_rate: Floats, since_s: Floats, horizon_s: float, start: int) -> list[tuple[int, int, int]]:
    """Times (Q,), rising, from one on in spans on one side of the horizon: modes left, whose decays rise, first and end of each."""
    left = np.maximum(np.searchsorted(plane_rate, FALLEN / np.maximum(since_s, horizon_s)), 1)
    spans, young = [], int(np.searchsorted(since_s, horizon_s))
    while start < len(left):
        stop = max(start + 1, int(np.searchsorted(-left, -left[start] / FEWER)))
        stop = min(stop, young) if start < young else stop
        spans.append((int(left[start]), start, stop))
        start = stop
    return spans


def add_young_heat(near: NearField, source: Floats, time_s: Floats, since_s: Floats, rise: Table) -> None:
    """Add the young heat of islands to the rises of the means at the first times (N,); after the horizon it is nothing."""
    source_of = np.repeat(np.arange(len(time_s)), np.diff(near.first))
    apart = np.flatnonzero(source_of != near.other)
    j, i, exact = source_of[apart], near.other[apart], near.exact[near.pair[apart]]

    def up_to(age_s: Floats) -> Floats:
        """Rises (P, N) by heat of up to ages (P, N), over K mm^3/s: as :func:`~ebamcheck.heat.near_field.at_root`."""
        place = np.sqrt(np.clip(age_s / near.horizon_s, 0.0, 1.0)) * (exact.shape[1] - 1)
        node = np.minimum(place.astype(np.int64), exact.shape[1] - 2)
        low, high = (np.take_along_axis(exact, at, axis=1) for at in (node, node + 1))
        return np.asarray(low + (high - low) * (place - node), np.float64)

    young = up_to(np.add.outer(time_s[j], since_s)) - up_to(np.broadcast_to(since_s, (len(j), len(since_s))))
    rise[i, j, : len(since_s)] += source[j, None] * young


@kernel
def table_place(since: float, nodes: float, horizon: float, columns: int) -> tuple[np.int32, float]:
    """Node before a time since the end of a source, and how far it is to the next one; without branches, for several times at
    once."""
    young = since < horizon
    root = np.sqrt(max(since, 0.0) / horizon if young else since - horizon)
    place = (YOUNG_NODES - 1.0) * root if young else (YOUNG_NODES - 1.0) + nodes * root
    node = np.int32(min(place, columns - 2.0))
    return node, min(place - node, 1.0)


# -- What young heat does to entries beyond the means of islands: worked out where it is asked for. Of all the ways in which one island
# of a large layer may follow another near it, a search tries one in a hundred.

# Times until the horizon of young heat. Their spacing grows with the time, as heat changes ever more slowly: node n of N lies at
# horizon (n / (N - 1))^2.
YOUNG_NODES = 12
Table = NDArray[np.float32]


class FreshTable(NamedTuple):
    """What young heat does to entries beyond the rises of islands that are near each other, and what that is worked out from."""

    near: NearField
    source_k_s: Floats  # (I,) as in :class:`~ebamcheck.heat.field.Modes`
    time_s: Floats  # (I,) time in which each island is scanned
    since_s: Floats  # (N,) times of the table; after the last, the horizon, it is nothing
    slot: ShortInts  # (I, I) row of the next tables for an island and the source, or -1
    known: Bools  # (P, 4) whether it is worked out, by the entry option of the source
    excess_k: Table  # (P, 4, 4, N) temperature of the entry over the island's mean, by its entry option and that of the source


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
    count = len(since)
    root, strength, inverse = np.empty(count), np.empty(count), np.empty(count)
    limit, held = np.empty(count), np.empty(count)
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
                dense = strength[n] * falling(inverse[n] * away) / held[n]
                entry_k[w, n] += 0.0 if away > limit[n] else dense
    for n in range(len(since)):
        mean = young_mean(near, near.pair[row], since[n], time)
        for w in range(OPTIONS):
            table.excess_k[row, w, left_by, n] = table.source_k_s[source] * (entry_k[w, n] * time - mean)
    table.known[row, left_by] = True
