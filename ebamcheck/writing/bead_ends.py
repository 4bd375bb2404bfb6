"""Starts and ends of beads: shifts seams from layer to layer, overlaps the start of contours, and ramps the beam, by cuts that keep
the curve."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ebamcheck.kernels import Floats
from ebamcheck.nc.control import control
from ebamcheck.nc.inputs import SHORTEST_BLOCK_MM, CurveColumns, ScanColumns
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings
from ebamcheck.settings.process import ProcessSettings
from ebamcheck.writing.bead_parts import ROUNDING_MM, Stretches, Tracks, cut, parts_of, snapped
from ebamcheck.writing.segments import Form, bezier_places
from ebamcheck.writing.tracks import Toolpath, toolpath
from ebamcheck.writing.wire import with_wire

# Places to try, each a shift further along: the first apart from the seams below is taken, else the farthest.
TRIES = 8
NO_SEAMS: Floats = np.zeros((0, 2))  # Seams under the lowest layer of a part


def driven_path(
    curves: CurveColumns, plan: ScanColumns, config: Config, decimals: int, form: Form, tolerance_mm: float
) -> Toolpath:
    """Lay out the tracks of a stack as :func:`~ebamcheck.writing.tracks.toolpath` does, with starts, ends and wire of its beads."""
    path = toolpath(curves, plan, config, decimals, form, tolerance_mm)
    return with_wire(with_bead_ends(path, config.process, decimals), plan, config, decimals)


def planned_path(curves: CurveColumns, plan: ScanColumns, config: Config) -> Toolpath:
    """Lay out the tracks of a stack in the form of curves that the control gets; lengths and places of wire differ a little between
    forms."""
    machine = config.machine
    form = written_form(machine)
    return driven_path(curves, plan, config, machine.printed_decimals, form, machine.line_tolerance_mm)


def written_form(machine: MachineSettings) -> Form:
    """Form in which the program of a control carries splines."""
    forms: dict[str, Form] = {"arcs": "arcs", "lines": "chords"}
    return forms.get(machine.curve_form) or control(machine.control).splines


def with_bead_ends(path: Toolpath, process: ProcessSettings, decimals: int, below: Floats = NO_SEAMS) -> Toolpath:
    """Start, overlap and ramp the beads of a path as the process asks; `below` (n, 2) are the seams under the lowest layer.

    A closed contour starts ``process.seam_shift_mm`` along itself from the seam below, and runs on over its start for
    ``process.overlap_mm``, at most once around. Power rises in steps along ``process.ramp_up_mm`` and falls along
    ``process.crater_fill_mm``; where a bead is shorter than both, they shrink alike.
    """
    if not (process.shapes_bead_ends and path.kind.size):
        return path
    tracks = Tracks.of(path)
    seams, _ = _seams(path, process, tracks, below)
    return cut(path, parts_of(path, tracks, _stretches(tracks, seams, process)), decimals)


def uppermost_seams(path: Toolpath, process: ProcessSettings, below: Floats) -> Floats:
    """Seams (n, 2) of the uppermost layer of a path that has no bead ends yet; `below` is that of :func:`with_bead_ends`."""
    if process.seam_shift_mm <= 0.0 or not path.kind.size:
        return below
    return _seams(path, process, Tracks.of(path), below)[1]


def _stretches(tracks: Tracks, seams: Floats, process: ProcessSettings) -> Stretches:
    """Cut every track where it starts, closes, ends, and where the power changes."""
    every, whole = np.arange(seams.size), tracks.length
    shift = snapped(tracks, every, seams)
    shift[shift > whole - SHORTEST_BLOCK_MM] = 0.0
    total = whole + np.where(tracks.closed, np.minimum(process.overlap_mm, whole), 0.0)
    # Ramps are shorter where a bead is shorter than both.
    ramps = process.ramp_up_mm + process.crater_fill_mm
    share = np.minimum(1.0, total / ramps) if ramps > 0.0 else np.zeros(total.size)
    up, down = share * process.ramp_up_mm, share * process.crater_fill_mm
    # Places along the driven length of a track, which begins at its shift.
    steps = np.arange(process.ramp_steps + 1) / process.ramp_steps
    places = [np.zeros(whole.size), whole - shift, 2.0 * whole - shift, whole, total]
    places += [up * s for s in steps] if process.ramp_up_mm > 0.0 else []
    places += [total - down * s for s in steps] if process.crater_fill_mm > 0.0 else []
    at = np.sort(np.minimum(np.stack(places, axis=1), total[:, None]), axis=1)
    track = np.repeat(every, at.shape[1] - 1)
    low, high = at[:, :-1].ravel(), at[:, 1:].ravel()
    middle = 0.5 * (low + high)
    power = ramp_power(middle, total[track] - middle, up[track], down[track], process)
    low, high = (snapped(tracks, track, place + shift[track]) for place in (low, high))
    lap = np.floor(0.5 * (low + high) / np.maximum(whole[track], SHORTEST_BLOCK_MM)).astype(np.int64)
    first = tracks.low[track] - lap * whole[track]
    kept = high - low > ROUNDING_MM
    return Stretches(track[kept], (first + low)[kept], (first + high)[kept], lap[kept], power[kept])


def ramp_power(from_start: Floats, to_end: Floats, up_mm: Floats, down_mm: Floats, process: ProcessSettings) -> Floats:
    """Share of the full power (n,) at places on beads, by their distance from the start and to the end, mm: a ramp step has the
    power of its middle."""
    power = np.ones(from_start.size)
    for along, length in ((from_start, up_mm), (to_end, down_mm)):
        share = np.divide(along, length, out=np.ones_like(along), where=length > 0.0)
        middle = (np.floor(share * process.ramp_steps) + 0.5) / process.ramp_steps
        risen = process.ramp_power + (1.0 - process.ramp_power) * middle
        power = np.where(along < length, np.minimum(power, risen), power)
    return power


def _seams(path: Toolpath, process: ProcessSettings, tracks: Tracks, below: Floats) -> tuple[Floats, Floats]:
    """Lengths along tracks at which they are to start, (T,) mm, and the uppermost seams, (n, 2); `below` (n, 2) are those under the
    lowest layer.

    A closed contour starts a shift further along itself than its place next to the seam below; others start where they do.
    """
    shifts = np.zeros(path.ring.size)
    if process.seam_shift_mm <= 0.0:
        return shifts, below
    for first, last in pairwise(path.layer_starts.tolist()):
        seams = []
        for t in range(first, last):
            a, b = path.track_starts[t : t + 2].tolist()
            if tracks.closed[t] and b > a:
                along, places = _places(path.points[a:b], path.lengths[a:b])
                whole_mm = float(path.lengths[a:b].sum())
                chosen = _chosen(along, places, whole_mm, below, process.seam_shift_mm)
                shifts[t] = along[chosen]
                seams.append(places[chosen])
        below = np.array(seams) if seams else below
    return shifts, below


def _places(points: Floats, lengths: Floats) -> tuple[Floats, Floats]:
    """Lengths (n,) along a track, at least one a millimetre, and their places (n, 2); a curve counts as evenly parametrised."""
    count = np.maximum(np.ceil(lengths).astype(np.int64), 1)
    segment = np.repeat(np.arange(lengths.size), count)
    t = (np.arange(segment.size) - np.repeat(np.cumsum(count) - count, count)) / count[segment]
    along = (np.cumsum(lengths) - lengths)[segment] + t * lengths[segment]
    return along, bezier_places(points[segment], t)


def _chosen(along: Floats, places: Floats, whole_mm: float, below: Floats, shift_mm: float) -> int:
    """Index of the place at which a contour starts."""
    if not len(below):
        return 0
    away = np.hypot(places[:, :1] - below[:, 0], places[:, 1:] - below[:, 1])
    nearest = along[int(away.min(axis=1).argmin())]
    tried = (nearest + shift_mm * np.arange(1, TRIES + 1)) % whole_mm
    index = np.searchsorted(along, tried, side="right") - 1
    apart = away[index].min(axis=1)
    # Around a bend the way is longer than the distance.
    first = np.flatnonzero(apart >= 0.5 * shift_mm)
    return int(index[first[0] if first.size else apart.argmax()])
