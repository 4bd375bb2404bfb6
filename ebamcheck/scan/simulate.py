"""When each island is scanned: the scan order driven at the speeds of the process and the machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from ebamcheck.config import Config
from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.path import jumps_mm

if TYPE_CHECKING:
    from ebamcheck.scan.plan import ScanPlan

EARLY = 0.1
"""Quantile of the intervals between neighbours that is reported: the tenth that is the most rushed."""


def simulate_order(plan: ScanPlan, profile: Config) -> pd.DataFrame:
    """Drive a plan: lines at travel speed, jumps at rapid speed, every layer from time 0.

    Contour beads and the pause between layers are not part of it.

    Returns
    -------
    DataFrame
        One row an island, in scan order: ``island``, ``layer``, ``rank`` in its layer, ``start_s`` (beam
        on its first line), ``end_s``, ``travel_mm`` (jump before it), ``inner_travel_mm`` (jumps
        between its own lines), ``length_mm`` of its lines and ``starts`` of the wire. An island without
        lines has NaN times.
    """
    table = plan.vectors
    island = table["island"].to_numpy()
    start = table[["x0", "y0"]].to_numpy()
    end = table[["x1", "y1"]].to_numpy()
    length = np.hypot(*(end - start).T)
    layer = plan.island_layer[island]
    new_layer = np.diff(layer, prepend=-1) != 0
    new_island = np.diff(island, prepend=-1) != 0
    jump = jumps_mm(start, end, new_layer)
    begins, ends = _clock(length, jump, new_layer, profile)

    count = len(plan.order)
    first = np.flatnonzero(new_island)
    last = np.flatnonzero(np.diff(island, append=-1) != 0)
    start_s, end_s, before = np.full(count, np.nan), np.full(count, np.nan), np.zeros(count)
    start_s[island[first]], end_s[island[first]] = begins[first], ends[last]
    before[island[first]] = jump[first]
    inner = np.bincount(island, np.where(new_island, 0.0, jump), minlength=count)
    starts = np.bincount(island, (jump > 0) | new_layer, minlength=count)
    total = np.bincount(island, length, minlength=count)
    order = plan.order
    return pd.DataFrame(
        {
            "island": order,
            "layer": plan.island_layer[order],
            "rank": np.arange(count) - np.searchsorted(plan.island_layer, plan.island_layer[order]),
            "start_s": start_s[order],
            "end_s": end_s[order],
            "travel_mm": before[order],
            "inner_travel_mm": inner[order],
            "length_mm": total[order],
            "starts": starts[order].astype(np.int64),
        }
    )


def line_times(plan: ScanPlan, profile: Config) -> tuple[Floats, Floats]:
    """Time at which the beam is at the begin and at the end of each line of a plan, (V,) s, from 0 in every layer."""
    table = plan.vectors
    start, end = table[["x0", "y0"]].to_numpy(), table[["x1", "y1"]].to_numpy()
    layer = plan.island_layer[table["island"].to_numpy()]
    new_layer = np.diff(layer, prepend=-1) != 0
    return _clock(np.hypot(*(end - start).T), jumps_mm(start, end, new_layer), new_layer, profile)


def _clock(length: Floats, jump: Floats, new_layer: np.ndarray, profile: Config) -> tuple[Floats, Floats]:
    """Time at which each line begins and ends, from 0 in every layer, s."""
    drive = length / profile.process.travel_speed_mm_s
    total = np.cumsum(drive + jump / profile.machine.rapid_mm_s)
    group = np.cumsum(new_layer) - 1
    offset = (total - drive)[new_layer][group] if len(length) else total
    ends = total - offset
    return ends - drive, ends


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
