"""What a post does to a closed contour bead: where it starts, how it overlaps its start, how the beam ramps.

Pure geometry on one track of lines, cubics and arcs; every cut is exact, so that the path stays the same curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import SettingsError
from ebamcheck.program.circles import circles
from ebamcheck.program.segments import CIRCULAR, CUBIC, STRAIGHT
from ebamcheck.rings import Floats

SNAP_MM = 1e-9
"""A cut this near to the end of a segment is made there: what it would leave is rounding."""

HALVINGS = 52
"""Bisections of the parameter of a cubic at a length: the bits of a number."""

NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)


@dataclass(frozen=True, eq=False)
class Track:
    """Segments of one track, end to end.

    Parameters
    ----------
    kind
        (n,) ``STRAIGHT``, ``CUBIC`` or ``CIRCULAR`` of :mod:`ebamcheck.program.segments`.
    points
        (n, 4, 2) control points of a cubic; start, start, end, end of a line; start, middle, middle, end of an
        arc of under half a circle, the middle half-way. mm.
    """

    kind: NDArray[np.uint8]
    points: Floats

    @cached_property
    def lengths(self) -> Floats:
        """(n,) mm; cubics by 16-point Gauss quadrature."""
        result: Floats = np.asarray(np.linalg.norm(self.points[:, 3] - self.points[:, 0], axis=1))
        for k in np.flatnonzero(self.kind == CUBIC):
            result[k] = _cubic_length(self.points[k], 1.0)
        arcs = np.flatnonzero(self.kind == CIRCULAR)
        start, middle, end = (self.points[arcs, j] for j in (0, 1, 3))
        found = circles(start, middle, end)
        result[arcs] = found.sweep_rad * np.linalg.norm(start - found.centre, axis=1)
        return result

    @property
    def length_mm(self) -> float:
        """Length of the whole track."""
        return float(self.lengths.sum())

    @property
    def is_closed(self) -> bool:
        """Whether the track ends where it starts."""
        return bool(len(self.kind)) and bool((self.points[0, 0] == self.points[-1, 3]).all())


def joined(*tracks: Track) -> Track:
    """One track after the other."""
    kinds = [np.zeros(0, np.uint8), *(t.kind for t in tracks)]
    return Track(np.concatenate(kinds), np.concatenate([np.zeros((0, 4, 2)), *(t.points for t in tracks)]))


def cut(track: Track, at_mm: float) -> tuple[Track, Track]:
    """The track up to a length along it, and what follows; one of them is empty at the ends."""
    ends = np.cumsum(track.lengths)
    if not -SNAP_MM <= at_mm <= (ends[-1] if ends.size else 0.0) + SNAP_MM:
        raise SettingsError(f"a track of {track.length_mm:.6g} mm cannot be cut at {at_mm:.6g} mm")
    k = int(np.searchsorted(ends, at_mm - SNAP_MM, side="left"))
    rest = at_mm - (float(ends[k - 1]) if k else 0.0)
    whole = float(track.lengths[k]) if k < len(ends) else 0.0
    if rest <= SNAP_MM or rest >= whole - SNAP_MM:
        k += k < len(ends) and rest > SNAP_MM
        return Track(track.kind[:k], track.points[:k]), Track(track.kind[k:], track.points[k:])
    first, second = _cut_segment(int(track.kind[k]), track.points[k], rest, whole)
    before = Track(track.kind[: k + 1], np.concatenate([track.points[:k], first[None]]))
    return before, Track(track.kind[k:], np.concatenate([second[None], track.points[k + 1 :]]))


def shifted(track: Track, by_mm: float) -> Track:
    """A closed track that starts `by_mm` further along itself; the same curve."""
    if not track.is_closed:
        raise SettingsError("only a closed contour can start elsewhere: this one is open")
    before, after = cut(track, by_mm % track.length_mm)
    return joined(after, before)


def overlapped(track: Track, by_mm: float) -> Track:
    """A closed track that runs on over its own start for `by_mm`, at most once around."""
    if not track.is_closed:
        raise SettingsError("only a closed contour can overlap its start: this one is open")
    return joined(track, cut(track, min(by_mm, track.length_mm))[0])


def ramped(track: Track, up_mm: float, down_mm: float, share: float, steps: int) -> list[tuple[Track, float]]:
    """Pieces of a track with the share of the beam power along each: steps up at the start, down at the end.

    Each step has the share in its middle of a straight ramp from `share` to 1; ramps that together are longer
    than the track are shortened alike.
    """
    whole = track.length_mm
    scale = min(1.0, whole / (up_mm + down_mm)) if up_mm + down_mm > 0.0 else 1.0
    up, down = scale * up_mm, scale * down_mm
    rise = share + (1.0 - share) * (np.arange(steps) + 0.5) / steps
    lengths, shares = [whole - up - down], [1.0]
    if up > 0.0:
        lengths, shares = [up / steps] * steps + lengths, rise.tolist() + shares
    if down > 0.0:
        lengths, shares = lengths + [down / steps] * steps, shares + rise[::-1].tolist()
    pieces = []
    for length, power in zip(lengths[:-1], shares[:-1], strict=True):
        piece, track = cut(track, min(max(length, 0.0), track.length_mm))
        pieces.append((piece, power))
    return [(piece, power) for piece, power in [*pieces, (track, shares[-1])] if len(piece.kind)]


# -- segments ----------------------------------------------------------------------------------------


def _cut_segment(kind: int, points: Floats, at_mm: float, whole_mm: float) -> tuple[Floats, Floats]:
    if kind == STRAIGHT:
        place = points[0] + (points[3] - points[0]) * (at_mm / whole_mm)
        return np.array([points[0], points[0], place, place]), np.array([place, place, points[3], points[3]])
    if kind == CIRCULAR:
        share = at_mm / whole_mm
        first, place, second = (_on_arc(points, s) for s in (0.5 * share, share, 0.5 + 0.5 * share))
        return np.array([points[0], first, first, place]), np.array([place, second, second, points[3]])
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _cubic_length(points, middle) < at_mm else (low, middle)
    return _split_cubic(points, 0.5 * (low + high))


def _on_arc(points: Floats, share: float) -> Floats:
    found = circles(points[None, 0], points[None, 1], points[None, 3])
    turn = share * float(found.sweep_rad[0]) * (1.0 if found.counter_clockwise[0] else -1.0)
    x, y = points[0] - found.centre[0]
    cos, sin = np.cos(turn), np.sin(turn)
    return np.asarray(found.centre[0] + np.array([cos * x - sin * y, sin * x + cos * y]))


def _split_cubic(points: Floats, t: float) -> tuple[Floats, Floats]:
    """Both halves by de Casteljau's construction."""
    a = points[:-1] + t * np.diff(points, axis=0)
    b = a[:-1] + t * np.diff(a, axis=0)
    c = b[0] + t * (b[1] - b[0])
    return np.array([points[0], a[0], b[0], c]), np.array([c, b[1], a[2], points[3]])


def _cubic_length(points: Floats, t: float) -> float:
    """Length of a cubic from 0 to t."""
    u = 0.5 * t * (NODES + 1.0)[:, None]
    d = 3.0 * np.diff(points, axis=0)
    speed = (1 - u) ** 2 * d[0] + 2 * (1 - u) * u * d[1] + u**2 * d[2]
    return float(0.5 * t * (WEIGHTS @ np.hypot(speed[:, 0], speed[:, 1])))
