"""When each island is scanned: the scan order at the speeds of the process and the machine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.filling.turns import follows
from ebamcheck.scan.order.entries import jumps_mm
from ebamcheck.settings.config import Config

if TYPE_CHECKING:
    from ebamcheck.scan.plan.columns import ScanPlan

EARLY = 0.1
"""Quantile of the intervals between neighbours that is reported: the tenth that is the most rushed."""


@dataclass(frozen=True, eq=False)
class _Schedule:
    """Lines of a plan as they are driven, (V,) each: `turn` and `jump` before a line with the beam on and off, mm."""

    island: Ints
    start: Floats
    end: Floats
    length: Floats
    turn: Floats
    jump: Floats
    new_layer: Bools
    begin_s: Floats
    end_s: Floats


def _scheduled(plan: ScanPlan, config: Config) -> _Schedule:
    table = plan.vectors
    island = table["island"].to_numpy()
    start, end = table[["x0", "y0"]].to_numpy(), table[["x1", "y1"]].to_numpy()
    length = np.hypot(*(end - start).T)
    new_layer = np.diff(plan.island_layer[island], prepend=-1) != 0
    option = jumps_mm(start, end, new_layer)
    on = follows(island, start, end, config.process.hatch_spacing_mm)
    turn, jump = np.where(on, option, 0.0), np.where(on, 0.0, option)
    laying = length / config.process.travel_speed_mm_s
    to_it = turn / config.process.travel_speed_mm_s + jump / config.machine.rapid_mm_s
    total = np.cumsum(laying + to_it)
    group = np.cumsum(new_layer) - 1
    offset = (total - laying)[new_layer][group] if len(length) else total
    ends = total - offset
    return _Schedule(island, start, end, length, turn, jump, new_layer, ends - laying, ends)


def simulate_order(plan: ScanPlan, config: Config) -> pd.DataFrame:
    """Simulate a plan: lines and turns at travel speed, jumps at rapid speed, every layer from time 0.

    Contour beads and the pause between layers are not part of it.

    Returns
    -------
    DataFrame
        One row an island, in scan order: ``island``, ``layer``, ``rank`` in its layer, ``start_s`` (beam
        on its first line), ``end_s``, ``travel_mm`` (jump before it), ``inner_travel_mm`` (jumps
        between its own lines), ``length_mm`` of its lines, ``turn_mm`` of the turns between them and
        ``starts`` of the wire. An island without lines has NaN times.
    """
    scheduled = _scheduled(plan, config)
    island, jump = scheduled.island, scheduled.jump
    new_island = np.diff(island, prepend=-1) != 0

    count = len(plan.order)
    first = np.flatnonzero(new_island)
    last = np.flatnonzero(np.diff(island, append=-1) != 0)
    start_s, end_s, before = np.full(count, np.nan), np.full(count, np.nan), np.zeros(count)
    start_s[island[first]], end_s[island[first]] = scheduled.begin_s[first], scheduled.end_s[last]
    before[island[first]] = jump[first]
    by_island = {
        "inner_travel_mm": np.where(new_island, 0.0, jump),
        "length_mm": scheduled.length,
        "turn_mm": scheduled.turn,
        "starts": (jump > 0) | scheduled.new_layer,
    }
    order = plan.order
    totals = {name: np.bincount(island, values, minlength=count)[order] for name, values in by_island.items()}
    return pd.DataFrame(
        {
            "island": order,
            "layer": plan.island_layer[order],
            "rank": np.arange(count) - np.searchsorted(plan.island_layer, plan.island_layer[order]),
            "start_s": start_s[order],
            "end_s": end_s[order],
            "travel_mm": before[order],
            **totals,
            "starts": totals["starts"].astype(np.int64),
        }
    )


def beam_lines(plan: ScanPlan, config: Config) -> tuple[Floats, Floats, Floats]:
    """Straight lines that the beam heats, in the order in which it does: lines and the turns to them.

    Returns
    -------
    ends
        (n, 4) x0, y0, x1, y1, mm.
    begin_s, end_s
        (n,) from 0 in every layer.
    """
    scheduled = _scheduled(plan, config)
    turn = np.flatnonzero(scheduled.turn > 0.0)
    turn_s = scheduled.turn[turn] / config.process.travel_speed_mm_s
    ends = np.vstack(
        [
            np.hstack([scheduled.start, scheduled.end]),
            np.hstack([scheduled.end[turn - 1], scheduled.start[turn]]),
        ]
    )
    begin = np.concatenate([scheduled.begin_s, scheduled.begin_s[turn] - turn_s])
    end = np.concatenate([scheduled.end_s, scheduled.begin_s[turn]])
    # A turn is driven before the line that it leads to.
    order = np.argsort(np.concatenate([np.arange(len(scheduled.length)), turn - 0.5]), kind="stable")
    return ends[order], begin[order], end[order]


def neighbour_intervals_s(end_s: Floats, neighbours: Ints) -> Floats:
    """Time between the ends of every two neighbouring islands, (P,) s.

    Parameters
    ----------
    end_s
        (I,) by island.
    neighbours
        (P, 2) pairs of islands.
    """
    return np.asarray(np.abs(end_s[neighbours[:, 0]] - end_s[neighbours[:, 1]]), np.float64)
