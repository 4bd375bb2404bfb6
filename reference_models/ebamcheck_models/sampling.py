"""How densely a wall is sampled so that its mesh keeps a tolerance.

A facet between neighbouring samples of a surface S(s, z) leaves it, along its normal n, by at most

    (ds^2 |n.S_ss| + dz^2 |n.S_zz|) / 8 + ds dz |n.S_sz| / 4

(second-order Taylor bound of linear interpolation; the last term is the twist of a cell about its
diagonal). Each term gets its share of the tolerance, and samples are spread so that every step uses it.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from ebamcheck_models.model import Floats
from ebamcheck_models.outlines import Outline, Piece

ALONG_SHARE, UP_SHARE, TWIST_SHARE = 0.4, 0.3, 0.2
"""Shares of the tolerance; the rest covers what the second order leaves out."""

PROBES_ALONG, PROBES_UP = 256, 32
"""Cells of a piece, and of each law of heights, in which the second derivatives are measured."""

DIFFERENCE_STEP = 1e-3
"""Step of the second differences, in ranges of the parameter: rounding stays under 1e-6 of a curvature."""

ROUNDING = 1e-6
"""What rounding may add to a count of steps without making it one more."""

LEAST_DENSITY = 0.15
"""Density is nowhere under this part of its greatest: neighbouring steps stay alike."""


def wall_samples(outline: Outline, levels: tuple[float, ...], tolerance_mm: float) -> tuple[tuple[Floats, ...], Floats]:
    """Parameters of each piece, ends included, and heights of the rows of a wall's grid; each of its levels is a row."""
    probes = [_bends(piece, levels) for piece in outline.pieces]
    bends_up = np.max([up.max(axis=1) for _, up, _ in probes], axis=0)
    rows = _rows(levels, np.sqrt(bends_up / (8.0 * UP_SHARE * tolerance_mm)))
    row_of_probe = np.searchsorted(rows, _middles(levels, PROBES_UP), side="right") - 1
    step = np.diff(rows)[row_of_probe]
    samples = []
    for along, _, twist in probes:
        bend = np.sqrt(along.max(axis=0) / (8.0 * ALONG_SHARE * tolerance_mm))
        turn = (twist * step[:, None]).max(axis=0) / (4.0 * TWIST_SHARE * tolerance_mm)
        samples.append(_spread(np.maximum(bend, turn), outline.least))
    return tuple(samples), rows


def outline_samples(outline: Outline, z: float, tolerance_mm: float) -> tuple[Floats, ...]:
    """Parameters of each piece, ends included, for chords within the tolerance at one height."""
    found = []
    for piece in outline.pieces:
        s, h = _middles((0.0, 1.0), PROBES_ALONG), DIFFERENCE_STEP
        (x0, y0), (x1, y1), (x2, y2) = (piece(s + k * h, np.array(z)) for k in (-1, 0, 1))
        dx, dy = (x2 - x0) / (2 * h), (y2 - y0) / (2 * h)
        ddx, ddy = (x2 - 2 * x1 + x0) / h**2, (y2 - 2 * y1 + y0) / h**2
        bend = np.abs(dx * ddy - dy * ddx) / np.hypot(dx, dy)
        found.append(_spread(np.sqrt(bend / (4.0 * tolerance_mm)), outline.least))
    return tuple(found)


def _bends(piece: Piece, levels: tuple[float, ...]) -> tuple[Floats, Floats, Floats]:
    """Normal parts of the second derivatives, |n.S_ss|, |n.S_zz|, |n.S_sz|, in the middle of each cell."""
    h = DIFFERENCE_STEP
    g = DIFFERENCE_STEP * np.repeat(np.diff(levels), PROBES_UP)[:, None]
    s, z = _middles((0.0, 1.0), PROBES_ALONG)[None, :], _middles(levels, PROBES_UP)[:, None]
    at = {(a, b): np.stack(piece(s + a * h, z + b * g)) for a in (-1, 0, 1) for b in (-1, 0, 1)}
    along, up = (at[1, 0] - at[-1, 0]) / (2 * h), (at[0, 1] - at[0, -1]) / (2 * g)
    normal_z = along[0] * up[1] - along[1] * up[0]
    length = np.sqrt(along[0] ** 2 + along[1] ** 2 + normal_z**2)

    def across(second: Floats) -> Floats:
        result: Floats = np.abs(along[1] * second[0] - along[0] * second[1]) / length
        return result

    return (
        across((at[1, 0] - 2 * at[0, 0] + at[-1, 0]) / h**2),
        across((at[0, 1] - 2 * at[0, 0] + at[0, -1]) / g**2),
        across((at[1, 1] - at[1, -1] - at[-1, 1] + at[-1, -1]) / (4 * h * g)),
    )


def _middles(edges: tuple[float, ...], cells: int) -> Floats:
    """Middles of equal cells, so many between each two edges."""
    fractions = (np.arange(cells) + 0.5) / cells
    return np.concatenate([a + (b - a) * fractions for a, b in pairwise(edges)])


def _rows(levels: tuple[float, ...], density: Floats) -> Floats:
    """Heights of rows: every level, and between them as many as the density (per mm) asks."""
    found = [
        low + (high - low) * _spread((high - low) * part, 1)[:-1]
        for (low, high), part in zip(pairwise(levels), density.reshape(-1, PROBES_UP), strict=True)
    ]
    return np.concatenate([*found, levels[-1:]])


def _spread(density: Floats, least: int) -> Floats:
    """Parameters 0 .. 1 between which the integral of the density is at most 1 each."""
    padded = np.pad(density, 1, mode="edge")
    highest = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    highest = np.maximum(highest, LEAST_DENSITY * highest.max()) if highest.max() > 0 else highest + 1.0
    cumulated = np.concatenate([[0.0], np.cumsum(highest / density.size)])
    wanted = cumulated[-1] if density.max() > 0 else 0.0
    count = max(least, math.ceil(wanted - ROUNDING))
    marks = np.linspace(0.0, cumulated[-1], count + 1)
    result = np.interp(marks, cumulated, np.linspace(0.0, 1.0, cumulated.size))
    result[0], result[-1] = 0.0, 1.0
    return result
