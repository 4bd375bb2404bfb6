"""Where a preheating scan goes: the region that is scanned, and the lines of each pass over it."""

from __future__ import annotations

import itertools
import math

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.regions import eroded
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.settings.config import Config

LEAST_LINE_MM = 0.1
"""Shorter lines are left out."""

JOINED_SPACINGS = 1.6
"""Ends of lines nearer than this, over the spacing, are joined under the beam, where the way lies within the region."""

WITHIN_MM = 1e-6
"""Rounding of a way within a region."""


def plate_of(section: BaseGeometry, config: Config) -> BaseGeometry:
    """Base plate of the settings; where they have none, the box around the lowest section and the margin."""
    low, high = config.machine.base_plate_min_mm, config.machine.base_plate_max_mm
    if low is not None and high is not None:
        return shapely.box(*low, *high)
    return _grown_box(section, config)


def plate_region(section: BaseGeometry, config: Config) -> BaseGeometry:
    """Region of the base plate that is scanned: around the lowest section, and half a spot within the plate."""
    room_mm = 0.5 * config.preheat.spot_mm
    plate = plate_of(section, config)
    if config.machine.base_plate_min_mm is not None:
        plate = eroded(plate, room_mm)
    return _free(shapely.intersection(plate, _grown_box(section, config)), 0.0, config)


def layer_region(section: BaseGeometry, top_mm: float, config: Config) -> BaseGeometry:
    """Region of what stands that is scanned: half a spot within its section. It may be empty."""
    return _free(eroded(section, 0.5 * config.preheat.spot_mm), top_mm, config)


def _grown_box(section: BaseGeometry, config: Config) -> BaseGeometry:
    x0, y0, x1, y1 = shapely.bounds(section)
    margin_mm = config.preheat.margin_mm
    box: BaseGeometry = shapely.box(x0 - margin_mm, y0 - margin_mm, x1 + margin_mm, y1 + margin_mm)
    return box


def _free(region: BaseGeometry, z_mm: float, config: Config) -> BaseGeometry:
    """Region without clamps that stand over a height, and half a spot around them."""
    for place in config.process.keep_out:
        if place.z_mm[1] > z_mm:
            around = shapely.buffer(shapely.Polygon(place.outline_mm), 0.5 * config.preheat.spot_mm)
            region = shapely.difference(region, around)
    return region


def pass_lines(region: BaseGeometry, config: Config, number: int) -> tuple[Floats, Bools]:
    """Lines of one pass, in order, back and forth.

    Parameters
    ----------
    number
        Of the pass, from 0: every second one lies across (crossed), or half a spacing aside (lines).

    Returns
    -------
    lines
        (n, 4) x, y of the start and of the end of each.
    joined
        (n,) whether the beam stays on from the line before.

    Examples
    --------
    >>> lines, joined = pass_lines(shapely.box(0, 0, 60, 20), Config(), 0)
    >>> lines[:, 1].tolist(), joined.tolist()
    ([5.0, 15.0], [False, True])
    """
    settings = config.preheat
    across = settings.pattern == "crossed" and number % 2 == 1
    turned = _swapped(region) if across else region
    aside = number // 2 % 2 if settings.pattern == "crossed" else number % 2
    lines = _rows(turned, settings.spacing_mm, 0.5 * settings.spacing_mm * aside)
    if across:
        lines = lines[:, [1, 0, 3, 2]]
    joined = np.zeros(len(lines), np.bool_)
    near = shapely.buffer(region, WITHIN_MM)
    for n, (a, b) in enumerate(itertools.pairwise(lines), 1):
        way = shapely.LineString([a[2:], b[:2]])
        joined[n] = way.length <= JOINED_SPACINGS * settings.spacing_mm and near.covers(way)
    return lines, joined


def _rows(region: BaseGeometry, spacing_mm: float, shift_mm: float) -> Floats:
    """Lines along X (n, 4) over a region, row by row, every second row the other way; rows lie evenly between its ends."""
    if region.is_empty:
        return np.zeros((0, 4))
    x0, y0, x1, y1 = shapely.bounds(region)
    count = max(1, round((y1 - y0) / spacing_mm))
    step = (y1 - y0) / count
    rows = y0 + (np.arange(count) + 0.5) * step + shift_mm
    found: list[Floats] = []
    for k, y in enumerate(rows[rows < y1].tolist()):
        cut = shapely.intersection(region, shapely.LineString([(x0 - 1.0, y), (x1 + 1.0, y)]))
        parts = [p for p in shapely.get_parts(cut) if p.length > LEAST_LINE_MM]
        ends = np.array([[*p.coords[0], *p.coords[-1]] for p in parts], np.float64).reshape(-1, 4)
        ends = ends[np.argsort(ends[:, 0])]
        found.append(ends if k % 2 == 0 else ends[::-1][:, [2, 3, 0, 1]])
    return np.concatenate(found) if found else np.zeros((0, 4))


def _swapped(region: BaseGeometry) -> BaseGeometry:
    found: BaseGeometry = shapely.transform(region, lambda points: points[:, ::-1])
    return found


def pass_length_mm(lines: Floats, joined: Bools) -> float:
    """Way of the beam in a pass, with what joins its lines."""
    own = np.hypot(lines[:, 2] - lines[:, 0], lines[:, 3] - lines[:, 1]).sum()
    between = sum(
        math.dist(a[2:], b[:2])
        for (a, b), on in zip(itertools.pairwise(lines), joined[1:], strict=True)
        if on
    )
    return float(own + between)
