"""Checks of where and how beads start and end: power along ramps and their time, overlap of contours, wire drawn back, gaps
ahead."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree

from ebamcheck.checks.checks import PLACE_MM, VALUE_SHARE, count_check, limit_check, worst_check
from ebamcheck.checks.metal import STEP_SHARE, wanted_region
from ebamcheck.checks.state_checks import retract_check
from ebamcheck.checks.value_checks import own_shares
from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.conventions import power_slack_w
from ebamcheck.nc.inputs import SHORTEST_BLOCK_MM
from ebamcheck.nc.motions import NCProgram
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.threads import run_each

# By so much a ramp is shorter or longer: it ends with a block that is near.
ROUNDING_MM = 2.0 * SHORTEST_BLOCK_MM
# Gap ahead of many ends on average, in spacings. A line stops 0.3 of one before the border of its island, which its pool covers; beyond
# it, a contour or a line along the border lies half a spacing away, the end of another line 0.3 of one: 0.8 or 0.6 in all.
MEAN_SPACINGS = 0.75
# Gap straight ahead of a single end, in bead widths: a line beside its own, which may fill what the end leaves, comes within 30 degrees
# at 1.44 of them, at the default spacing. Of an end that faces the border of the part: its round end reaches half a width, and to a
# border that it meets at an angle it is nearer than straight ahead.
SINGLE_BEADS, BORDER_BEADS = 1.5, 0.8
LEAST_BEADS = 0.5  # Length in bead widths under which a bead fills a spot, and its ends have no direction
REACH_BEADS = 2.5  # Distance, in bead widths, within which the next metal is looked for
# Places within 60 degrees of an end's direction are ahead of it.
AHEAD, STRAIGHT = math.tan(math.radians(60.0)), math.tan(math.radians(30.0))


def bead_end_checks(nc: NCProgram, config: Config, shares: Floats) -> list[Check]:
    """Check power, overlap and wire at the ends of all beads; `shares` (L,) of the power are those of the layers."""
    # Length by which each closed contour runs on over its start, against the one set or once around.
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0))
    beads, over, length = nc.beads.among(rows), nc.overlap[rows], nc.lengths[rows]
    driven, whole = beads.total(np.where(over, length, 0.0)), beads.total(np.where(over, 0.0, length))
    closed = (nc.end[beads.last, :2] == nc.start[beads.first, :2]).all(axis=1) | (driven > 0.0)
    off = np.where(closed, np.abs(driven - np.minimum(config.process.overlap_mm, whole)), 0.0)
    what = f"off {config.process.overlap_mm:g} mm of overlap of {int(closed.sum())} closed contours"
    checks = [
        _power(nc, config, shares),
        worst_check("overlap of contours", nc, beads.last, off, 2.0 * SHORTEST_BLOCK_MM, "mm", what),
    ]
    if config.process.wire_retract_mm > 0.0:
        checks.append(retract_check(nc, config))
    if nc.goes_on.any():
        # Distance of the places where hatch lines change their power from the straight line.
        rows = np.flatnonzero(nc.goes_on)
        vectors = nc.vectors()
        owner = np.searchsorted(vectors["row"].to_numpy(), rows, side="right") - 1
        a, b = vectors[["x0", "y0"]].to_numpy()[owner], vectors[["x1", "y1"]].to_numpy()[owner]
        way, place = b - a, nc.start[rows, :2] - a
        whole = np.hypot(way[:, 0], way[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (place * way).sum(axis=1) / whole
            away = np.abs(way[:, 0] * place[:, 1] - way[:, 1] * place[:, 0]) / whole
        # A part on its own, on a ring, or beyond the line's ends is none.
        sound = (owner >= 0) & (nc.island[rows] >= 0) & nc.deposit[rows] & nc.deposit[rows - 1]
        sound &= (nc.island[rows] == nc.island[rows - 1]) & (along >= 0.0) & (along <= whole)
        what = "distance of their parts from the line"
        off = np.where(sound, away, np.inf)
        checks.append(worst_check("parts of hatch lines", nc, rows, off, PLACE_MM, "mm", what))
    return checks


def _power(nc: NCProgram, config: Config, shares: Floats) -> Check:
    """Power of every deposit against that of its layer, or what its wire needs; on ramps against the straight ramp, within half a
    step."""
    process = config.process
    rows = np.flatnonzero(nc.deposit)
    share = nc.power_w[rows] / process.power_w
    wanted, step = ramp_power(nc, rows, config)
    # A program may have layers that the plan does not know.
    known = (nc.layer[rows] >= 0) & (nc.layer[rows] < shares.size)
    of_layer = np.ones(rows.size)
    of_layer[known] = shares[nc.layer[rows[known]]]
    of_layer = np.maximum(of_layer, own_shares(nc, rows, config))
    slack_w = power_slack_w(config.machine, process.voltage_kv, process.current_ma)
    off = np.abs(share - wanted * of_layer) - (step * of_layer + slack_w / process.power_w)
    off = np.where(np.isnan(share), np.nan, np.maximum(off, 0.0))
    found = worst_check("power", nc, rows, off, VALUE_SHARE, "of the power set", "")
    highest = float(np.nanmax(nc.power_w[rows], initial=0.0))
    within = highest <= process.voltage_kv * process.current_max_ma * (1.0 + VALUE_SHARE) + slack_w
    text = f"{highest:g} W in the program, {process.power_w:g} W set"
    if (shares < 1.0).any():
        text += f", {np.nanmin(shares) * process.power_w:g} W in the layer of the least"
    if process.ramps_beam:
        lowest = float(np.nanmin(nc.power_w[rows], initial=highest))
        text += f", ramps from {lowest:g} W over {process.ramp_up_mm:g} mm and to it over {process.crater_fill_mm:g} mm"
    return replace(found, passed=found.passed and bool(within), text=text)


def ramp_power(nc: NCProgram, rows: Ints, config: Config) -> tuple[Floats, Floats]:
    """Share of the full power in the middle of each motion, and how far a step of the ramp may be from it."""
    process = config.process
    if not process.ramps_beam:
        return np.ones(rows.size), np.zeros(rows.size)
    beads = nc.beads.among(rows)
    middle, whole = beads.middles(nc.lengths[rows])
    # Written anew here: a fault of the writer's ramps would else confirm itself.
    share = np.minimum(1.0, whole / (process.ramp_up_mm + process.crater_fill_mm))[beads.bead]
    up, down = share * process.ramp_up_mm, share * process.crater_fill_mm
    to_end = whole[beads.bead] - middle
    wanted = np.ones(rows.size)
    for along, length in ((middle, up), (to_end, down)):
        with np.errstate(divide="ignore", invalid="ignore"):
            risen = process.ramp_power + (1.0 - process.ramp_power) * along / length
        wanted = np.where(along < length, np.minimum(wanted, risen), wanted)
    # A motion may be shorter than a step, anywhere on it, and a step may begin at the end of a block that is near.
    on_ramp = (middle < up + SHORTEST_BLOCK_MM) & (up > 0.0)
    on_ramp |= (to_end < down + SHORTEST_BLOCK_MM) & (down > 0.0)
    rise = 1.0 - process.ramp_power
    shortest = np.minimum(np.where(up > 0.0, up, np.inf), np.where(down > 0.0, down, np.inf))
    allowed = rise * (0.5 / process.ramp_steps + np.minimum(SHORTEST_BLOCK_MM / shortest, 1.0))
    return wanted, np.where(on_ramp, allowed, 0.0)


def ramp_check(nc: NCProgram, config: Config) -> Check:
    """Check how long the beam of each bead rises and falls, by feed and length of its blocks, against the windows of the
    process."""
    process, rows = config.process, np.flatnonzero(nc.deposit)
    beads, power_w = nc.beads.among(rows), nc.power_w[rows]
    if not rows.size:
        return count_check("ramps in time", [], "nothing is laid")
    with np.errstate(divide="ignore", invalid="ignore"):
        time_s = np.nan_to_num(60.0 * nc.lengths[rows] / nc.feed_mm_min[rows], posinf=0.0)
    # Seconds (P,) of each bead before its first motion at full power, and after the last one.
    bead, numbers = beads.bead, np.arange(len(beads))
    first, stop = (np.searchsorted(bead, numbers, side=side) for side in ("left", "right"))
    full = np.flatnonzero(power_w >= np.fmax.reduceat(power_w, first)[bead] * (1.0 - VALUE_SHARE))
    begins, ends = first.copy(), stop - 1
    begins[bead[full][::-1]] = full[::-1]
    ends[bead[full]] = full
    sums = np.concatenate([[0.0], np.cumsum(time_s)])
    rise, fall = sums[begins] - sums[first], sums[stop] - sums[ends + 1]
    long = beads.total(nc.lengths[rows]) >= process.ramp_up_mm + process.crater_fill_mm
    slack_s = ROUNDING_MM / process.travel_speed_mm_s
    faults = []
    for row, times_s, window_s, what in (
        (beads.first, rise, process.ramp_up_window_s, "the beam rises to its full power in"),
        (beads.last, fall, process.crater_fill_window_s, "the beam falls to the end of its bead in"),
    ):
        if window_s is not None:
            low, high = window_s
            # A bead that is shorter than both ramps may take less.
            bad = (times_s > high + slack_s) | (long & (times_s < low - slack_s))
            each = zip(row[bad].tolist(), times_s[bad].tolist(), strict=True)
            said = f"{what} {{:.3g}} s, allowed are {low:g} .. {high:g} s"
            faults += [(at, said.format(t)) for at, t in each]
    faults.sort(key=lambda fault: fault[0])
    good = (
        f"the beam rises in {rise.min():.3g} .. {rise.max():.3g} s and falls in {fall.min():.3g} .. {fall.max():.3g} s"
    )
    return count_check("ramps in time", [(nc.where(row), what) for row, what in faults], good)


def end_gaps_check(nc: NCProgram, config: Config, layers: Layers) -> Check:
    """Check that hatch beads start and end next to other metal, or at the border of the part, each of them and on average."""
    bead_mm = config.process.bead_width_mm
    ends = _ends(nc, config, layers)
    if not len(ends):
        return Check("ends of beads", True, 0.0, SINGLE_BEADS * bead_mm, "mm", "", "no hatch bead has ends")
    most = np.where(ends["free"], BORDER_BEADS, SINGLE_BEADS) * bead_mm
    single = (ends["straight_mm"] / most).to_numpy()
    k = int(np.argmax(single))
    at, limit = ends.iloc[k], float(most[k])
    row, layer, gap = int(at["row"]), int(at["layer"]), float(at["straight_mm"])
    what = "the border of the part" if at["free"] else "other metal"
    text = f"a bead {'starts' if at['start'] else 'ends'} {gap:.4g} mm before {what}"
    # Mean gaps of the starts and of the ends that face metal, of each layer and of all (-1), with the widest one's motion.
    facing = ends[~ends["free"]].sort_values("gap_mm", ascending=False, kind="stable")
    groups = pd.concat([facing, facing.assign(layer=-1)]).groupby(["layer", "start"])
    means = groups.agg(gap_mm=("gap_mm", "mean"), count=("row", "size"), row=("row", "first")).reset_index()
    # Ends in one layer meet the borders of the same few islands, and corners of these come together.
    independent = np.where(means["layer"] < 0, means["count"], np.sqrt(means["count"]))
    over = means["gap_mm"] / (limits := most_on_average_mm(independent, config))
    if len(means) and over.max() > single[k]:
        n = int(np.argmax(over))
        worst = means.iloc[n]
        gap, limit, row = float(worst["gap_mm"]), float(limits[n]), int(worst["row"])
        layer = int(nc.layer[row])
        text = f"{int(worst['count'])} beads {'start' if worst['start'] else 'end'} {gap:.4g} mm before other metal on average"
    at = ends.loc[ends["row"] == row].iloc[0]
    place = at["x_mm"], at["y_mm"]
    return limit_check("ends of beads", gap, limit, "mm", text, nc.where(row), layer, place)


def most_on_average_mm(count: Floats, config: Config) -> Floats:
    """Gap that so many independent ends may have on average, mm: that of a single one, and less the more there are."""
    mean_mm = MEAN_SPACINGS * config.process.hatch_spacing_mm
    return np.asarray(mean_mm + (SINGLE_BEADS * config.process.bead_width_mm - mean_mm) / count, np.float64)


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
        pairs = cKDTree(at).sparse_distance_matrix(cKDTree(place[mine]), reach_mm, output_type="ndarray")
        end, other = pairs["i"], mine[pairs["j"]]
        to = place[other] - at[end]
        ahead = (to * way[end]).sum(axis=1)
        own = (bead[other] == bead[owner[end]]) & (np.abs(along[other] - along[owner[end]]) < bead_mm)
        others = ~own & (ahead > 0.0)
        end, to, ahead = end[others], to[others], ahead[others]
        across, away = np.abs(to[:, 0] * way[end, 1] - to[:, 1] * way[end, 0]), np.hypot(to[:, 0], to[:, 1])
        # Distance to the nearest of the places that lie ahead, and straight ahead; endless without any.
        gap = np.full((2, len(at)), np.inf)
        for nearest, slope in zip(gap, (AHEAD, STRAIGHT), strict=True):
            within = across <= slope * ahead
            np.minimum.at(nearest, end[within], away[within])
        # Distance straight ahead to the border of the part: none beyond it.
        section = wanted_region(layers.section(k), config)
        rays = np.asarray(shapely.linestrings(np.stack([at, at + reach_mm * way], axis=1)))
        met = shapely.intersection(rays, shapely.boundary(section))
        border = np.nan_to_num(shapely.distance(shapely.points(at), met), nan=reach_mm)
        border = np.where(shapely.intersects_xy(section, at[:, 0], at[:, 1]), border, 0.0)
        return pd.DataFrame({
            "gap_mm": np.minimum(gap[0], reach_mm), "straight_mm": np.minimum(gap[1], border), "free": border < gap[1],
            "start": np.arange(owner.size) < ends.size, "row": row[owner], "layer": np.full(owner.size, k),
            "x_mm": at[:, 0], "y_mm": at[:, 1],
        })  # fmt: skip

    found = [layer for layer in run_each(of_layer, range(len(layers))) if layer is not None]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame()
