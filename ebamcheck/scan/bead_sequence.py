"""The beads of a layer in the sequence in which they are laid: contours, then islands; and the time that each takes."""

from __future__ import annotations

import numpy as np
import shapely

from ebamcheck.config import Config
from ebamcheck.heat import HeatModel
from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.driving import clocked
from ebamcheck.scan.laying import LaidLayer
from ebamcheck.scan.order import LayerIslands
from ebamcheck.scan.part_heat import Beads, uneven

PIECE_BEADS = 1.0
"""Length of the pieces in which contours are heated, over the width of a bead: no mode changes within less."""

NEAR_SPACINGS = 2.0
"""A move with the beam off of at most this many bead spacings stays at the layer's height; a longer one rises, as the
program has it."""


def bead_sequence(laid: LaidLayer, islands: LayerIslands, order: Ints) -> tuple[Beads, float]:
    """Put contours and islands in sequence.

    Parameters
    ----------
    order
        Islands in scan order; without any, the contours alone are taken.

    Returns
    -------
    beads, travel_mm
        And the jumps between islands.
    """
    profile = islands.profile
    process, rapid = profile.process, profile.machine.rapid_mm_s
    rise_s = 2.0 * profile.machine.safe_height_mm / rapid
    rings = _rings(laid)
    count = np.array([_pieces(ring.length, profile) for ring in rings], np.int64)
    ring_s = np.repeat(
        [ring.length / process.travel_speed_mm_s / n for ring, n in zip(rings, count, strict=True)], count
    )
    model = islands.cold_heat.model if len(islands) else None
    columns, times, shares = [_along(rings, count, model)], [ring_s], [np.ones(ring_s.size)]
    moves, travel_mm = [np.full(len(rings), rise_s)], 0.0
    if len(order):
        drive = islands.driven
        start_s, end_s, travel_mm = clocked(order, drive.entry, drive.leave, drive.time_s, rapid)
        move_s = start_s[order] - np.concatenate([[0.0], end_s[order][:-1]])
        rises = move_s * rapid > NEAR_SPACINGS * process.hatch_spacing_mm
        rises[0] = True
        time_s = drive.time_s[order]
        columns.append(uneven(islands.cold_heat.mean[:, order], islands.cold_heat.model))
        times.append(time_s)
        shares.append(np.divide(drive.beam_s[order], time_s, out=np.zeros_like(time_s), where=time_s > 0.0))
        moves.append(move_s + rise_s * rises)
    sizes = np.concatenate([count, np.ones(len(order), np.int64)])
    return Beads(
        pieces=np.ascontiguousarray(np.concatenate(columns, axis=1)),
        first=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        move_s=np.concatenate(moves),
        time_s=np.concatenate(times),
        on=np.concatenate(shares),
        rings=len(rings),
    ), float(travel_mm)


def _rings(laid: LaidLayer) -> list[shapely.LinearRing]:
    """Centre lines of the contour beads."""
    return [
        ring for part in shapely.get_parts(laid.regions.contour) for ring in (part.exterior, *part.interiors)
    ]


def _pieces(length_mm: float, profile: Config) -> int:
    return max(1, round(length_mm / (PIECE_BEADS * profile.process.bead_width_mm)))


def _along(rings: list[shapely.LinearRing], count: Ints, model: HeatModel | None) -> Floats:
    """Modes (K, P) in the middles of the pieces of rings, less their means over the section."""
    if model is None:
        return np.zeros((0, int(count.sum())))
    places = [
        shapely.line_interpolate_point(ring, (np.arange(n) + 0.5) / n, normalized=True)
        for ring, n in zip(rings, count, strict=True)
    ]
    if not places:
        return np.zeros((len(model.plane.eigenvalue), 0))
    return uneven(model.plane.at(shapely.get_coordinates(np.concatenate(places))).T, model)
