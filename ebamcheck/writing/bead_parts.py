"""Tracks cut along themselves into parts of one power and one width, every cut exactly, so that the path stays the same."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ebamcheck.heat.medium import own_power_shares
from ebamcheck.heat.part_heat import BeadPower
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.inputs import SHORTEST_BLOCK_MM, Interpass
from ebamcheck.settings.config import Config
from ebamcheck.writing.segments import CIRCULAR, CUBIC, segment_parts
from ebamcheck.writing.tracks import Toolpath, cleaned, rounded

ROUNDING_MM = 1e-7  # Rounding of a length along a whole stack


@dataclass(frozen=True, eq=False)
class Tracks:
    """Lengths along a stack, mm: each track lies behind the one before."""

    closed: Bools  # (T,) contours that end where they start
    low: Floats  # (T,) where each track begins
    length: Floats  # (T,)
    ends: Floats  # (N,) where each segment ends

    @classmethod
    def of(cls, path: Toolpath) -> Tracks:
        """Lay the tracks of a path one behind the other."""
        ends = np.cumsum(path.lengths)
        bounds = np.concatenate([[0.0], ends])[path.track_starts]
        some = np.diff(path.track_starts) > 0
        closed = np.zeros(some.size, np.bool_)
        last = path.end[path.track_starts[1:][some] - 1]
        closed[some] = (path.ring[some] >= 0) & (path.start[some] == last).all(axis=1)
        return cls(closed, bounds[:-1], np.diff(bounds), ends)


def snapped(tracks: Tracks, track: Ints, along: Floats) -> Floats:
    """Lengths (n,) along tracks, which may go round more than once, moved to the end of a segment that is near."""
    begin, whole = tracks.low[track], tracks.length[track]
    lap = np.floor(np.divide(along, whole, out=np.zeros_like(along), where=whole > 0.0))
    place = begin + along - lap * whole
    after = np.minimum(np.searchsorted(tracks.ends, place), tracks.ends.size - 1)
    ends = np.stack([begin, begin + whole, tracks.ends[after], tracks.ends[np.maximum(after - 1, 0)]])
    away = np.where((begin <= ends) & (ends <= begin + whole), np.abs(ends - place), np.inf)
    nearest = away.argmin(axis=0)[None]
    end, near = (np.take_along_axis(column, nearest, axis=0)[0] for column in (ends, away))
    return np.asarray(np.where(near <= SHORTEST_BLOCK_MM, end - begin + lap * whole, along))


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of tracks (n,), in the order in which they are driven."""

    track: Ints
    low: Floats  # mm along the stack
    high: Floats
    lap: Ints  # How often the track's end was passed before
    power: Floats | None = None  # Share of the full power; None: that of the path
    width: Floats | None = None  # Metal that is laid, mm; None: that of the path


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of segments (n,) in the order in which they are driven."""

    track: Ints
    segment: Ints
    low: Floats  # mm along the segment
    high: Floats
    lap: Ints
    power: Floats
    width: Floats


def parts_of(path: Toolpath, tracks: Tracks, stretches: Stretches) -> Parts:
    """Parts of the segments that lie in stretches."""
    first = np.searchsorted(tracks.ends, stretches.low + ROUNDING_MM)
    last = np.minimum(np.searchsorted(tracks.ends, stretches.high - ROUNDING_MM), tracks.ends.size - 1)
    count = last - first + 1
    owner = np.repeat(np.arange(count.size), count)
    segment = first[owner] + np.arange(owner.size) - np.repeat(np.cumsum(count) - count, count)
    start = np.concatenate([[0.0], tracks.ends[:-1]])[segment]
    length = tracks.ends[segment] - start
    low, high = stretches.low[owner] - start, stretches.high[owner] - start
    low = np.where(low <= ROUNDING_MM, 0.0, low)
    high = np.where(high >= length - ROUNDING_MM, length, high)
    power = path.power[segment] if stretches.power is None else stretches.power[owner]
    width = path.width[segment] if stretches.width is None else stretches.width[owner]
    return Parts(stretches.track[owner], segment, low, high, stretches.lap[owner], power, width)


def cut(path: Toolpath, parts: Parts, decimals: int) -> Toolpath:
    """Return the path of the parts, rounded."""
    segment, lengths = parts.segment, path.lengths
    whole = (parts.low == 0.0) & (parts.high >= lengths[segment] - ROUNDING_MM)
    kind, made_points = path.kind[segment], path.points[segment]
    some = np.flatnonzero(~whole)
    length, low = lengths[segment[some]], parts.low[some]
    high = np.minimum(parts.high[some], length)
    made_points[some] = segment_parts(kind[some], made_points[some], length, low, high)
    end = np.where(whole[:, None], path.end[segment], rounded(made_points[:, 3], decimals))
    sizes = np.bincount(parts.track, minlength=path.ring.size)
    track_starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    start = path.start.copy()
    moved = np.flatnonzero(sizes > 0)
    first = track_starts[moved]
    whole_start, cut_start = path.segment_start[segment[first]], rounded(made_points[first, 0], decimals)
    start[moved] = np.where((parts.low[first] == 0.0)[:, None], whole_start, cut_start)
    # A ring comes back to where it started to the last digit, however the place was rounded.
    ring = (path.ring >= 0)[parts.track]
    back = ring & (np.abs(end - start[parts.track]).max(axis=1) <= 2.0 * 10.0**-decimals)
    end[back] = start[parts.track[back]]
    goes_on = path.goes_on[segment]
    goes_on[1:] |= (np.diff(segment) == 0) & (parts.low[1:] > 0.0) & ~(ring | path.turn[segment])[1:]
    made = replace(
        path, track_starts=track_starts, start=start, kind=kind, end=end, turn=path.turn[segment],
        piece=np.where(_in_whole_pieces(path, parts, whole), path.piece[segment], -1),
        bezier=made_points[kind == CUBIC], middle=made_points[kind == CIRCULAR, 1], power=parts.power,
        width=parts.width, goes_on=goes_on,
    )  # fmt: skip
    return cleaned(made, decimals)


def _in_whole_pieces(path: Toolpath, parts: Parts, whole: Bools) -> Bools:
    """Parts (n,) of pieces of the curves that are driven whole, at one power and width, the first time around."""
    piece, segment = path.piece[parts.segment], parts.segment
    new = np.ones(segment.size, np.bool_)
    new[1:] = np.diff(segment) != 1
    for column in (piece, parts.power, parts.width, parts.track):
        new[1:] |= np.diff(column) != 0
    run = np.cumsum(new) - 1
    found = np.bincount(run, whole & (parts.lap == 0))
    wanted = np.bincount(path.piece[path.piece >= 0], minlength=1)[np.maximum(piece[new], 0)]
    return np.asarray((found == wanted)[run] & (piece >= 0))


def layer_power(path: Toolpath, layer: int, rows: slice, share: float, config: Config) -> Floats:
    """Share of the full power along segments `rows` of one layer, which has a share of it."""
    own = own_power_shares(config, path.width[rows], float(path.thickness[layer]))
    return np.asarray(path.power[rows] * np.maximum(share, own), np.float64)


def power_shares(path: Toolpath, heat: Interpass, config: Config) -> Floats:
    """Share of the full power along every segment of a path, (N,)."""
    ends = path.track_starts[path.layer_starts].tolist()
    shares = heat.power_share.tolist()
    each = [layer_power(path, k, slice(*ends[k : k + 2]), s, config) for k, s in enumerate(shares)]
    return np.concatenate([np.zeros(0), *each])


def along_beads(parts: Parts, tracks: int, thickness_mm: float, config: Config) -> BeadPower:
    """Power along the tracks of one layer by the parts of their segments, for the heat of its plan."""
    length = parts.high - parts.low
    whole = np.bincount(parts.track, length, minlength=tracks)
    own = own_power_shares(config, parts.width, thickness_mm)
    return BeadPower(parts.track, parts.power * length / whole[parts.track], own)
