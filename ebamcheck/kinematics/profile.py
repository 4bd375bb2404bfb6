"""The feed profile of a path: what speed the axes really have along it, and what that does to the bead."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.kinematics.limits import Cells, DrivenPath, cells_of, polyline_path, program_path
from ebamcheck.layers.stack import Layers
from ebamcheck.program import NCProgram
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import PARABOLA


@dataclass(frozen=True, eq=False)
class FeedProfile:
    """Speed along a path, cell by cell (C,): a rise from `entry` to `top`, a plateau, a fall to `exit`, mm/s."""

    path: DrivenPath
    cells: Cells
    entry: Floats
    top: Floats
    exit: Floats
    time_s: Floats
    dip_share: float
    bead_mm2: float
    places: tuple[str, ...] = ()  # ``FILE:line`` of each motion; empty for a path that no program wrote

    @property
    def total_s(self) -> float:
        """Time of the whole path, s: motions alone, without the waits of switches."""
        return float(self.time_s.sum())

    @cached_property
    def slow(self) -> pd.DataFrame:
        """Stretches of deposits under `dip_share` of the feed programmed, in the order of the path.

        Columns `sort` (``start`` and ``end`` of a track, or ``dip``), `layer`, `ring`, `where`, `time_s`, `length_mm`,
        `least_mm_s`, `feed_mm_s`, `excess_mm3` and `metal_per_mm`: the metal of a millimetre over that at the feed programmed, at
        its worst; infinite where the axes stop."""
        cells, path = self.cells, self.path
        feed = path.feed_mm_s[cells.motion]
        speeds, limits = (self.entry, self.top, self.exit), (cells.acceleration_mm_s2, cells.jerk_mm_s3)
        columns = np.column_stack([cells.length_mm, *speeds, *limits])
        sort, cell, time, length, least = slow_stretches(columns, self.dip_share * feed, cells.first)
        motion, feed = cells.motion[cell], feed[cell]
        with np.errstate(divide="ignore"):
            growth = feed / least
        # The wire runs at its own speed, so that a stretch of length l that takes the time t gets A (v_set t - l) of metal too much, and
        # at the speed v the bead has v_set / v of its section.
        table = pd.DataFrame(
            {
                "sort": np.array(["start", "dip", "end"])[sort],
                "layer": path.layer[motion],
                "ring": path.ring[motion],
                "where": [self.places[m] if self.places else "" for m in motion],
                "time_s": time,
                "length_mm": length,
                "least_mm_s": least,
                "feed_mm_s": feed,
                "excess_mm3": np.maximum(self.bead_mm2 * (feed * time - length), 0.0),
                "metal_per_mm": growth,
            }
        )
        deposits: pd.DataFrame = table[path.deposit[motion]].reset_index(drop=True)
        return deposits

    @property
    def dips(self) -> pd.DataFrame:
        """Slow stretches but for the starts and ends of tracks."""
        return self.slow[self.slow["sort"] == "dip"].reset_index(drop=True)

    def layer_table(self) -> pd.DataFrame:
        """One row a layer: times, dips, and the metal that dips and ends of tracks get too much."""
        motion = self.cells.motion
        layer = self.path.layer[motion]
        count = int(layer.max(initial=-1)) + 1
        inside = layer >= 0
        deposit = self.path.deposit[motion] & inside

        def total(which: Bools, values: Floats) -> Floats:
            return np.bincount(layer[which], values[which], minlength=count).astype(np.float64)

        constant = self.cells.length_mm / self.path.feed_mm_s[motion]
        table = pd.DataFrame({"layer": np.arange(count), "time_s": total(inside, self.time_s)})
        table["deposit_s"], table["constant_feed_s"] = total(deposit, self.time_s), total(deposit, constant)
        dips, ends = self.dips, self.slow[self.slow["sort"] != "dip"]
        table["dips"] = np.bincount(dips["layer"], minlength=count)
        for name, rows in (("dip", dips), ("track_end", ends)):
            for figure in ("time_s", "excess_mm3"):
                table[f"{name}_{figure}"] = np.bincount(rows["layer"], rows[figure], minlength=count)
        least = np.ones(count)
        np.minimum.at(least, dips["layer"].to_numpy(), (dips["least_mm_s"] / dips["feed_mm_s"]).to_numpy())
        table["least_share"] = least
        return table


def feed_profile(nc: NCProgram, config: Config) -> FeedProfile:
    """Work out the feed along a program's path, with the limits of the axes and look-ahead; raises SettingsError if a motion has no
    feed.

    The axes stand still at rapids and where beam or wire switch. Within a run, corners and curvature limit the speed as
    :mod:`ebamcheck.kinematics.limits` says, and ramps with limited acceleration and jerk join what is left."""
    path = program_path(nc, config)
    return _profile(path, config, tuple(nc.where(int(row)) for row in path.row))


def polyline_profile(layers: Layers, config: Config) -> FeedProfile:
    """Feed along contours of which every point is a straight block (G1), to set beside a program's."""
    return _profile(polyline_path(layers, config.process.travel_speed_mm_s), config, ())


def side_by_side(nc: NCProgram, contours: Layers, config: Config) -> pd.DataFrame:
    """Contour beads of a program beside polylines through the points of `contours`, one row each; ends of tracks are left out of
    `least_share`."""
    rows: list[dict[str, object]] = []
    for name, profile in (
        ("program", feed_profile(nc, config)),
        ("polyline", polyline_profile(contours, config)),
    ):
        path, cells = profile.path, profile.cells
        motions = path.deposit & (path.ring >= 0)
        along = motions[cells.motion]
        dips = profile.dips[profile.dips["ring"] >= 0]
        length, excess = float(cells.length_mm[along].sum()), float(dips["excess_mm3"].sum())
        rows.append(
            {
                "path": name,
                "blocks": int(motions.sum()),
                "length_mm": length,
                "time_s": float(profile.time_s[along].sum()),
                "constant_feed_s": float((cells.length_mm / path.feed_mm_s[cells.motion])[along].sum()),
                "dips": len(dips),
                "dip_s": float(dips["time_s"].sum()),
                "least_share": float((dips["least_mm_s"] / dips["feed_mm_s"]).min()) if len(dips) else 1.0,
                "excess_mm3": excess,
                "excess_mm3_per_m": 1000.0 * excess / length if length else 0.0,
            }
        )
    return pd.DataFrame(rows).set_index("path")


def _profile(path: DrivenPath, config: Config, places: tuple[str, ...]) -> FeedProfile:
    cells = cells_of(path, config)
    limits = cells.acceleration_mm_s2, cells.jerk_mm_s3, cells.entry_mm_s
    speeds_and_time = look_ahead(cells.length_mm, cells.most_mm_s, *limits, cells.first)
    # Section of a bead of the layers' height: two thirds of width times height.
    area = PARABOLA * config.process.bead_width_mm * config.layer_height_mm
    bead_mm2 = area if math.isfinite(area) else 0.0
    return FeedProfile(path, cells, *speeds_and_time, config.kinematics.dip_share, bead_mm2, places)


# Sorts of slow stretches: from the start of a run, within it, to its end; a run that is slow throughout is a dip
START, DIP, END = range(3)


# -- Where the feed falls under the one programmed: the wire runs on, and the bead grows (paper, Figure 6) -----


@kernel
def slow_stretches(cells: Floats, slow: Floats, first: Bools) -> tuple[Ints, Ints, Floats, Floats, Floats]:
    """Stretches of each run that are slower than a threshold (C,), by the cells (C, 6): length, entry, peak and exit speed,
    acceleration, jerk.

    Returns `sort`, `cell`, `time`, `length`, `least`: (D,) each: :data:`START`, :data:`DIP` or :data:`END`, cell of the least
    speed, s, mm, mm/s."""
    count = len(cells)
    sort, where = np.zeros(2 * count + 1, np.int64), np.zeros(2 * count + 1, np.int64)
    time, length, least = np.zeros(2 * count + 1), np.zeros(2 * count + 1), np.zeros(2 * count + 1)
    found, under = 0, False
    for c in range(count):
        if first[c]:
            under = False
        last = c + 1 == count or first[c + 1]
        begin, top, end, a, j = cells[c, 1], cells[c, 2], cells[c, 3], cells[c, 4], cells[c, 5]
        whole = top < slow[c]
        if begin < slow[c] or whole:
            if whole:
                up, down, path = ramp_time(begin, top, a, j), ramp_time(top, end, a, j), cells[c, 0]
                ramps = 0.5 * (begin + top) * up + 0.5 * (top + end) * down
                took = up + down + (max(path - ramps, 0.0) / top if top > 0.0 else 0.0)
            else:
                took, path = time_to(begin, top, slow[c], a, j)
            if not under:
                sort[found], where[found], least[found] = (START if first[c] else DIP), c, begin
                time[found], length[found] = 0.0, 0.0
                found += 1
            time[found - 1] += took
            length[found - 1] += path
            if begin < least[found - 1]:
                least[found - 1], where[found - 1] = begin, c
            under = whole
        else:
            under = False
        if whole:
            if end < least[found - 1]:
                least[found - 1], where[found - 1] = end, c
            if last:
                sort[found - 1] = DIP if sort[found - 1] == START else END
        elif end < slow[c]:
            sort[found], where[found], least[found] = (END if last else DIP), c, end
            time[found], length[found] = time_to(end, top, slow[c], a, j)
            found += 1
            under = True
    return sort[:found], where[:found], time[:found], length[:found], least[:found]


# -- Changes of speed with limited acceleration and jerk, in closed form --------------------------------------
# A ramp begins and ends without acceleration. Its jerk is that of the axes at once, so that a change of speed d takes 2 sqrt(d / j), or
# d / a + a / j where it reaches the acceleration a (d >= a^2 / j); by its symmetry it covers the mean of both speeds times that time.


@kernel
def ramp_time(first: float, last: float, acceleration: float, jerk: float) -> float:
    """Time of a change of speed, s."""
    change = abs(last - first)
    if change * jerk < acceleration * acceleration:
        return float(2.0 * np.sqrt(change / jerk))
    return change / acceleration + acceleration / jerk if change > 0.0 else 0.0


@kernel
def fastest(
    first: float, last: float, falls: bool, length: float, most: float, acceleration: float, jerk: float
) -> float:
    """Greatest speed up to `most` within `length` mm after the speed `first`; and before the speed `last`, if it `falls` to it."""
    low, high, speed = max(first, last) if falls else first, most, most
    if low >= high:
        return low if falls else most
    # By bisections, beyond the precision of its bits.
    for turn in range(61):
        way = 0.5 * (first + speed) * ramp_time(first, speed, acceleration, jerk)
        if falls:
            way += 0.5 * (speed + last) * ramp_time(speed, last, acceleration, jerk)
        if way <= length:
            if turn == 0:
                return most
            low = speed
        else:
            high = speed
        speed = 0.5 * (low + high)
    return low


@kernel
def time_to(first: float, last: float, speed: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """Time in which a ramp from `first` up to `last` reaches a speed, s, and the path until then, mm."""
    change, whole = last - first, ramp_time(first, last, acceleration, jerk)
    gained = min(max(speed - first, 0.0), change)
    if change <= 0.0:
        return 0.0, 0.0
    # The second half mirrors the first.
    late = gained > 0.5 * change
    rest = change - gained if late else gained
    bend = min(acceleration / jerk, 0.5 * whole)
    at_bend = 0.5 * jerk * bend**2
    if rest <= at_bend:
        time = float(np.sqrt(2.0 * rest / jerk))
        path = jerk * time**3 / 6.0
    else:
        straight = (rest - at_bend) / (jerk * bend)
        time = bend + straight
        path = jerk * bend**3 / 6.0 + at_bend * straight + 0.5 * jerk * bend * straight**2
    if late:
        return whole - time, 0.5 * (first + last) * whole - (last * time - path)
    return time, first * time + path


@kernel
def look_ahead(
    length: Floats, most: Floats, acceleration: Floats, jerk: Floats, entry: Floats, first: Bools
) -> tuple[Floats, Floats, Floats, Floats]:
    """Entry, peak and exit speed of each cell, and its time, all (C,): the greatest speeds that keep every limit and ramp without
    acceleration at the borders of cells. A pass backwards lowers each to one that can still be braked from, a pass forwards to one
    that can be reached."""
    count = length.size
    begin, end, top, time = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    for c in range(count):
        if not first[c]:
            begin[c] = min(entry[c], most[c], most[c - 1])
    for c in range(count - 1, -1, -1):
        after = 0.0 if c + 1 == count or first[c + 1] else begin[c + 1]
        highest = max(begin[c], after)
        begin[c] = min(begin[c], fastest(after, 0.0, False, length[c], highest, acceleration[c], jerk[c]))
    for c in range(1, count):
        if not first[c]:
            last, highest = begin[c - 1], max(begin[c], begin[c - 1])
            got = fastest(last, 0.0, False, length[c - 1], highest, acceleration[c - 1], jerk[c - 1])
            begin[c] = min(begin[c], got)
    for c in range(count):
        a, j = acceleration[c], jerk[c]
        end[c] = 0.0 if c + 1 == count or first[c + 1] else begin[c + 1]
        top[c] = fastest(begin[c], end[c], True, length[c], most[c], a, j)
        up, down = ramp_time(begin[c], top[c], a, j), ramp_time(top[c], end[c], a, j)
        time[c] = up + down
        if top[c] > 0.0:
            ramps = 0.5 * (begin[c] + top[c]) * up + 0.5 * (top[c] + end[c]) * down
            time[c] += max(length[c] - ramps, 0.0) / top[c]
    return begin, top, end, time
