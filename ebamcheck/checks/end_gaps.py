"""Check of where hatch beads start and end, by the text and the sections alone: how far ahead of an end the next metal lies.

A line stops before the border of its island, where its pool still runs on, and the next bead lies beyond it: a contour or a line
along that border half a spacing away, or the end of another line. One end may lie in a corner, further away; many do not. So what
holds for the mean of the ends of a layer, and of a program, is less than what holds for a single one.
"""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree

from ebamcheck.checks.checks import Check
from ebamcheck.checks.metal import STEP_SHARE, wanted_region
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.kernels import run_each
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config

NAME = "ends of beads"

MEAN_SPACINGS = 0.75
"""Gap ahead of many ends on average, in spacings. A line stops 0.3 of one before the border of its island, which its pool covers; beyond
it, a contour or a line along the border lies half a spacing away, the end of another line 0.3 of one: 0.8 or 0.6 in all."""

SINGLE_BEADS = 1.5
"""Gap straight ahead of a single end, in bead widths: a line beside its own, which may fill what the end leaves, comes within 30 degrees
at 1.44 of them, at the default spacing."""

BORDER_BEADS = 0.8
"""Distance straight ahead of an end that faces the border of the part, in bead widths: its round end reaches half of one, and to a
border that it meets at an angle it is nearer than straight ahead."""

LEAST_BEADS = 0.5
"""Length of a bead, in bead widths, under which it fills a spot, and its ends have no direction."""

AHEAD, STRAIGHT = math.tan(math.radians(60.0)), math.tan(math.radians(30.0))
"""Places within 60 degrees of the direction of an end lie ahead of it; within 30 degrees there is no line beside its own."""

REACH_BEADS = 2.5
"""Distance, in bead widths, within which the next metal is looked for."""

START, END, STARTS, ENDS = "a bead starts", "a bead ends", "beads start", "beads end"


def end_gaps_check(nc: NCProgram, config: Config, layers: Layers) -> Check:
    """Check that hatch beads start and end next to other metal, or at the border of the part."""
    bead_mm = config.process.bead_width_mm
    ends = _ends(nc, config, layers)
    if not len(ends):
        return Check(NAME, True, 0.0, SINGLE_BEADS * bead_mm, "mm", "", "no hatch bead has ends")
    most = np.where(ends["free"], BORDER_BEADS, SINGLE_BEADS) * bead_mm
    single = (ends["straight_mm"] / most).to_numpy()
    k = int(np.argmax(single))
    row, layer, gap, limit = (
        int(ends["row"].iloc[k]),
        int(ends["layer"].iloc[k]),
        float(ends["straight_mm"].iloc[k]),
        float(most[k]),
    )
    what = "the border of the part" if ends["free"].iloc[k] else "other metal"
    text = f"{START if ends['start'].iloc[k] else END} {gap:.4g} mm before {what}"
    groups = _means(ends, config)
    worst = groups.iloc[int(np.argmax(groups["gap_mm"] / groups["limit_mm"]))]
    if worst["gap_mm"] / worst["limit_mm"] > single[k]:
        gap, limit, row = float(worst["gap_mm"]), float(worst["limit_mm"]), int(worst["row"])
        layer = int(nc.layer[row])
        text = f"{int(worst['count'])} {STARTS if worst['start'] else ENDS} {gap:.4g} mm before other metal on average"
    at = ends.loc[ends["row"] == row].iloc[0]
    return Check(
        NAME, gap <= limit, gap, limit, "mm", nc.where(row), text, layer, float(at["x_mm"]), float(at["y_mm"])
    )  # fmt: skip


def most_on_average_mm(count: Floats, config: Config) -> Floats:
    """Gap that so many independent ends may have on average, mm: that of a single one, and less the more there are.

    Examples
    --------
    >>> most_on_average_mm(np.array([1.0, 4.0, 400.0]), Config()).round(3).tolist()
    [9.0, 4.68, 3.254]
    """
    mean_mm = MEAN_SPACINGS * config.process.hatch_spacing_mm
    return np.asarray(mean_mm + (SINGLE_BEADS * config.process.bead_width_mm - mean_mm) / count, np.float64)


def _means(ends: pd.DataFrame, config: Config) -> pd.DataFrame:
    """Mean gaps of the starts and of the ends that face metal, of each layer and of all: count, limit, and the widest one's motion."""
    facing = ends[~ends["free"]].sort_values("gap_mm", ascending=False, kind="stable")
    every = pd.concat([facing, facing.assign(layer=-1)])
    found = every.groupby(["layer", "start"]).agg(
        gap_mm=("gap_mm", "mean"), count=("row", "size"), row=("row", "first")
    )
    found = found.reset_index()
    # Ends in one layer meet the borders of the same few islands, and corners of these come together.
    independent = np.where(found["layer"] < 0, found["count"], np.sqrt(found["count"]))
    found["limit_mm"] = most_on_average_mm(independent, config)
    if not len(found):
        found.loc[0] = [-1, True, 0.0, 0, int(ends["row"].iloc[0]), 1.0]
    return found


def _ends(nc: NCProgram, config: Config, layers: Layers) -> pd.DataFrame:
    """Starts and ends of all hatch beads: `gap_mm`, whether the border of the part is what they face (`free`), place and motion."""
    bead_mm = config.process.bead_width_mm
    reach_mm = REACH_BEADS * bead_mm
    beads = nc.beads
    rows = beads.rows[np.isfinite(nc.start[beads.rows]).all(axis=1) & (nc.lengths[beads.rows] > 0.0)]
    row, place = nc.samples(rows, STEP_SHARE * bead_mm)
    bead = beads.group[row]
    along = np.cumsum(nc.lengths[row] / np.bincount(row, minlength=len(nc))[row])
    first = np.flatnonzero(np.diff(bead, prepend=-1))
    last = np.append(first[1:], bead.size)[: first.size] - 1
    hatch = (nc.ring[row[first]] < 0) & (along[last] - along[first] >= LEAST_BEADS * bead_mm)

    def of_layer(k: int) -> pd.DataFrame | None:
        mine, ends = np.flatnonzero(nc.layer[row] == k), np.flatnonzero(hatch & (nc.layer[row[first]] == k))
        if not ends.size:
            return None
        # A quarter of a bead tells the direction of an end, and not the rounding of its decimals.
        back = int(0.25 / STEP_SHARE)
        a, b = first[ends], last[ends]
        at = np.vstack([nc.start[row[a], :2], place[b]])
        inner = np.vstack([place[np.minimum(a + back, b)], place[np.maximum(b - back - 1, a)]])
        owner = np.concatenate([a, b])
        way = at - inner
        way /= np.maximum(np.hypot(way[:, 0], way[:, 1]), np.finfo(float).tiny)[:, None]
        near = _near(place[mine], at, reach_mm)
        other = mine[near[1]]
        own = (bead[other] == bead[owner[near[0]]]) & (np.abs(along[other] - along[owner[near[0]]]) < bead_mm)
        end, others = near[0][~own], place[other[~own]]
        gap = _ahead(at, way, end, others, AHEAD)
        straight = _ahead(at, way, end, others, STRAIGHT)
        section = wanted_region(layers.section(k), config)
        border = _border_ahead(at, way, section, reach_mm)
        return pd.DataFrame({
            "gap_mm": np.minimum(gap, reach_mm), "straight_mm": np.minimum(straight, border), "free": border < straight, "start": np.arange(owner.size) < ends.size,
            "row": row[owner], "layer": np.full(owner.size, k), "x_mm": at[:, 0], "y_mm": at[:, 1],
        })  # fmt: skip

    found = [layer for layer in run_each(of_layer, range(len(layers))) if layer is not None]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame()


def _near(places: Floats, at: Floats, reach_mm: float) -> tuple[Ints, Ints]:
    """Pairs of ends `at` (n, 2) and places within a distance."""
    pairs = cKDTree(at).sparse_distance_matrix(cKDTree(places), reach_mm, output_type="ndarray")
    return pairs["i"], pairs["j"]


def _ahead(at: Floats, way: Floats, end: Ints, place: Floats, slope: float) -> Floats:
    """Distance (n,) from ends to the nearest of the places (m, 2) ahead of each, by the slope of what counts as that; endless without any."""
    to = place - at[end]
    along = (to * way[end]).sum(axis=1)
    across = np.abs(to[:, 0] * way[end, 1] - to[:, 1] * way[end, 0])
    ahead: Bools = (along > 0.0) & (across <= slope * along)
    gap = np.full(len(at), np.inf)
    np.minimum.at(gap, end[ahead], np.hypot(to[ahead, 0], to[ahead, 1]))
    return gap


def _border_ahead(at: Floats, way: Floats, section: shapely.Geometry, reach_mm: float) -> Floats:
    """Distance (n,) from ends straight ahead to the border of a section: none beyond it, the reach where it is farther."""
    rays = np.asarray(shapely.linestrings(np.stack([at, at + reach_mm * way], axis=1)))
    met = shapely.intersection(rays, shapely.boundary(section))
    away = np.asarray(shapely.distance(shapely.points(at), met), np.float64)
    away = np.where(np.isnan(away), reach_mm, away)
    return np.where(shapely.intersects_xy(section, at[:, 0], at[:, 1]), away, 0.0)
