"""Starts and ends of beads: seams that move on, contours that overlap their start, and a beam that ramps.

Each track is cut into parts along itself, every cut exactly, so that the path stays the same curve.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ebamcheck.config import Config
from ebamcheck.program.cuts import segment_lengths, segment_parts
from ebamcheck.program.inputs import CurveColumns, ScanColumns
from ebamcheck.program.seams import seam_shifts
from ebamcheck.program.segments import CIRCULAR, CUBIC, Form
from ebamcheck.program.toolpath import Toolpath, cleaned, rounded, toolpath
from ebamcheck.rings import Bools, Floats, Ints
from ebamcheck.settings.process import ProcessSettings

SHORTEST_BLOCK_MM = 0.05
"""A cut nearer than this to the end of a block is made there: shorter blocks make a control stutter."""

ROUNDING_MM = 1e-7
"""Rounding of a length along a whole stack."""


def driven_path(
    curves: CurveColumns, plan: ScanColumns, config: Config, decimals: int, form: Form, tolerance_mm: float
) -> Toolpath:
    """Lay out the tracks of a stack as :func:`~ebamcheck.program.toolpath.toolpath` does, with their starts and ends."""
    path = toolpath(curves, plan, config, decimals, form, tolerance_mm)
    return with_bead_ends(path, config.process, decimals)


def with_bead_ends(path: Toolpath, process: ProcessSettings, decimals: int) -> Toolpath:
    """Start, overlap and ramp the beads of a path as the process asks.

    A closed contour starts ``process.seam_shift_mm`` along itself from the seam below, and runs on over its start
    for ``process.overlap_mm``, at most once around. Along the first ``process.ramp_up_mm`` of every bead the power
    rises in steps, along the last ``process.crater_fill_mm`` it falls; where a bead is shorter than both, they
    shrink alike.
    """
    if not (process.shapes_bead_ends and path.kind.size):
        return path
    points = _points(path)
    lengths = segment_lengths(path.kind, points)
    tracks = _Tracks.of(path, lengths)
    seams = np.zeros(path.ring.size)
    if process.seam_shift_mm > 0.0:
        seams = seam_shifts(
            path.layer_starts, path.track_starts, tracks.closed, points, lengths, process.seam_shift_mm
        )
    return _cut(path, points, lengths, _parts(tracks, _stretches(tracks, seams, process)), decimals)


@dataclass(frozen=True, eq=False)
class _Tracks:
    """Lengths along a stack, mm: each track lies behind the one before."""

    closed: Bools
    """(T,) contours that end where they start."""
    low: Floats
    """(T,) where each track begins."""
    length: Floats
    """(T,)"""
    ends: Floats
    """(N,) where each segment ends."""

    @classmethod
    def of(cls, path: Toolpath, lengths: Floats) -> _Tracks:
        ends = np.cumsum(lengths)
        bounds = np.concatenate([[0.0], ends])[path.track_starts]
        some = np.diff(path.track_starts) > 0
        closed = np.zeros(some.size, np.bool_)
        last = path.end[path.track_starts[1:][some] - 1]
        closed[some] = (path.ring[some] >= 0) & (path.start[some] == last).all(axis=1)
        return cls(closed, bounds[:-1], np.diff(bounds), ends)


@dataclass(frozen=True, eq=False)
class _Stretches:
    """Stretches of tracks (n,) of one power, in the order in which they are driven."""

    track: Ints
    low: Floats
    """mm along the stack"""
    high: Floats
    lap: Ints
    """How often the track's end was passed before."""
    power: Floats


def _stretches(tracks: _Tracks, seams: Floats, process: ProcessSettings) -> _Stretches:
    """Cut every track where it starts, closes, ends, and where the power changes."""
    every, whole = np.arange(seams.size), tracks.length
    shift = _snapped(tracks, every, seams)
    shift[shift > whole - SHORTEST_BLOCK_MM] = 0.0
    total = whole + np.where(tracks.closed, np.minimum(process.overlap_mm, whole), 0.0)
    up, down = ramp_lengths(total, process)
    # Places along what is driven of a track, which begins at its shift.
    steps = np.arange(process.ramp_steps + 1) / process.ramp_steps
    places = [np.zeros(whole.size), whole - shift, 2.0 * whole - shift, whole, total]
    places += [up * s for s in steps] if process.ramp_up_mm > 0.0 else []
    places += [total - down * s for s in steps] if process.crater_fill_mm > 0.0 else []
    at = np.sort(np.minimum(np.stack(places, axis=1), total[:, None]), axis=1)
    track = np.repeat(every, at.shape[1] - 1)
    low, high = at[:, :-1].ravel(), at[:, 1:].ravel()
    middle = 0.5 * (low + high)
    power = ramp_power(middle, total[track] - middle, up[track], down[track], process)
    low, high = (_snapped(tracks, track, place + shift[track]) for place in (low, high))
    lap = np.floor(0.5 * (low + high) / np.maximum(whole[track], SHORTEST_BLOCK_MM)).astype(np.int64)
    first = tracks.low[track] - lap * whole[track]
    kept = high - low > ROUNDING_MM
    return _Stretches(track[kept], (first + low)[kept], (first + high)[kept], lap[kept], power[kept])


def ramp_lengths(bead_mm: Floats, process: ProcessSettings) -> tuple[Floats, Floats]:
    """Lengths (n,) of the ramps at the start and at the end of beads: those set, less where a bead is shorter."""
    ramps = process.ramp_up_mm + process.crater_fill_mm
    share = np.minimum(1.0, bead_mm / ramps) if ramps > 0.0 else np.zeros(bead_mm.size)
    return share * process.ramp_up_mm, share * process.crater_fill_mm


def ramp_power(
    from_start: Floats, to_end: Floats, up_mm: Floats, down_mm: Floats, process: ProcessSettings
) -> Floats:
    """Share of the full power at places on beads, (n,): that in the middle of each of ``process.ramp_steps``.

    Parameters
    ----------
    from_start, to_end
        (n,) lengths along the bead from its start and to its end, mm.
    up_mm, down_mm
        (n,) of :func:`ramp_lengths`.
    """
    power = np.ones(from_start.size)
    for along, length in ((from_start, up_mm), (to_end, down_mm)):
        share = np.divide(along, length, out=np.ones_like(along), where=length > 0.0)
        middle = (np.floor(share * process.ramp_steps) + 0.5) / process.ramp_steps
        risen = process.ramp_power + (1.0 - process.ramp_power) * middle
        power = np.where(along < length, np.minimum(power, risen), power)
    return power


def _snapped(tracks: _Tracks, track: Ints, along: Floats) -> Floats:
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
class _Parts:
    """Parts of segments (n,) in the order in which they are driven."""

    track: Ints
    segment: Ints
    low: Floats
    """mm along the segment"""
    high: Floats
    lap: Ints
    power: Floats


def _parts(tracks: _Tracks, stretches: _Stretches) -> _Parts:
    """Parts of the segments that lie in stretches."""
    first = np.searchsorted(tracks.ends, stretches.low + ROUNDING_MM)
    last = np.minimum(np.searchsorted(tracks.ends, stretches.high - ROUNDING_MM), tracks.ends.size - 1)
    count = last - first + 1
    owner = np.repeat(np.arange(count.size), count)
    segment = first[owner] + np.arange(owner.size) - np.repeat(np.cumsum(count) - count, count)
    start = np.concatenate([[0.0], tracks.ends[:-1]])[segment]
    length = tracks.ends[segment] - start
    low, high = stretches.low[owner] - start, stretches.high[owner] - start
    return _Parts(
        stretches.track[owner],
        segment,
        np.where(low <= ROUNDING_MM, 0.0, low),
        np.where(high >= length - ROUNDING_MM, length, high),
        stretches.lap[owner],
        stretches.power[owner],
    )


# -- the path anew -----------------------------------------------------------------------------------


def _points(path: Toolpath) -> Floats:
    """Points of all segments, (N, 4, 2), as :mod:`ebamcheck.program.cuts` takes them."""
    points = np.stack([path.segment_start, path.segment_start, path.end, path.end], axis=1)
    points[path.kind == CUBIC] = path.bezier
    points[path.kind == CIRCULAR, 1:3] = path.middle[:, None]
    return points


def _cut(path: Toolpath, points: Floats, lengths: Floats, parts: _Parts, decimals: int) -> Toolpath:
    """The path of the parts, rounded."""
    segment = parts.segment
    whole = (parts.low == 0.0) & (parts.high >= lengths[segment] - ROUNDING_MM)
    kind, cut = path.kind[segment], points[segment]
    some = np.flatnonzero(~whole)
    length = lengths[segment[some]]
    cut[some] = segment_parts(
        kind[some], cut[some], length, parts.low[some], np.minimum(parts.high[some], length)
    )
    end = np.where(whole[:, None], path.end[segment], rounded(cut[:, 3], decimals))
    sizes = np.bincount(parts.track, minlength=path.ring.size)
    track_starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    start = path.start.copy()
    moved = np.flatnonzero(sizes > 0)
    first = track_starts[moved]
    start[moved] = np.where(
        (parts.low[first] == 0.0)[:, None],
        path.segment_start[segment[first]],
        rounded(cut[first, 0], decimals),
    )
    # A ring comes back to where it started to the last digit, however the place was rounded.
    ring = (path.ring >= 0)[parts.track]
    back = ring & (np.abs(end - start[parts.track]).max(axis=1) <= 2.0 * 10.0**-decimals)
    end[back] = start[parts.track[back]]
    goes_on = np.zeros(segment.size, np.bool_)
    goes_on[1:] = (np.diff(segment) == 0) & (parts.low[1:] > 0.0) & ~(ring | path.turn[segment])[1:]
    made = replace(
        path,
        track_starts=track_starts,
        start=start,
        kind=kind,
        end=end,
        turn=path.turn[segment],
        piece=np.where(_in_whole_pieces(path, parts, whole), path.piece[segment], -1),
        bezier=cut[kind == CUBIC],
        middle=cut[kind == CIRCULAR, 1],
        power=parts.power,
        goes_on=goes_on,
    )
    return cleaned(made, decimals)


def _in_whole_pieces(path: Toolpath, parts: _Parts, whole: Bools) -> Bools:
    """Parts (n,) of pieces of the curves that are driven whole, at one power, the first time around."""
    piece, segment = path.piece[parts.segment], parts.segment
    new = np.ones(segment.size, np.bool_)
    new[1:] = (
        (np.diff(piece) != 0)
        | (np.diff(parts.power) != 0.0)
        | (np.diff(segment) != 1)
        | (np.diff(parts.track) != 0)
    )
    run = np.cumsum(new) - 1
    found = np.bincount(run, whole & (parts.lap == 0))
    wanted = np.bincount(path.piece[path.piece >= 0], minlength=1)[np.maximum(piece[new], 0)]
    return np.asarray((found == wanted)[run] & (piece >= 0))
