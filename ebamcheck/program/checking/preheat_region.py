"""What a preheating scan is to go over, and whether its lines leave none of it out, by code of its own.

Plan and writer take region and lines from one place: a mistake there would be in the program and in what it is held against.
"""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.regions import eroded
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config

ROUND_SHARE = 2e-3
"""Share of the spot by which a rounding of chords may lie beside its circle."""

WIDEST = 1.5
"""Lines lie evenly between the ends of the region: at most so many spacings apart, where one more would lie nearer than one."""

SLIVER_MM = 0.1
"""Lines across a narrower place may be left out."""

ALONG_MM = 1e-3
"""A line along an axis leaves it by no more: the decimals of a program, at their coarsest."""


def wanted_region(
    sections: list[BaseGeometry], k: int, z_mm: float, config: Config, under: BaseGeometry | None
) -> BaseGeometry:
    """Region that the beam's middle may go over before layer `k`, whose bottom lies at `z_mm`.

    On the plate: as far as `preheat.margin_mm` around the box of the lowest section, half a spot within the plate. On what stands, `under`
    or the layer below: half a spot within its section. Nowhere nearer to a clamp that is higher than half a spot.
    """
    half_mm = (0.5 - ROUND_SHARE) * config.preheat.spot_mm
    below = under if k == 0 else sections[k - 1]
    region: BaseGeometry
    if below is not None:
        region = eroded(below, half_mm)
    else:
        (x0, y0), (x1, y1) = np.reshape(shapely.bounds(sections[0]), (2, 2)).tolist()
        margin_mm = config.preheat.margin_mm
        region = shapely.box(x0 - margin_mm, y0 - margin_mm, x1 + margin_mm, y1 + margin_mm)
        low, high = config.machine.base_plate_min_mm, config.machine.base_plate_max_mm
        if low is not None and high is not None:
            spot_mm = 0.5 * config.preheat.spot_mm
            plate = shapely.box(low[0] + spot_mm, low[1] + spot_mm, high[0] - spot_mm, high[1] - spot_mm)
            region = shapely.intersection(region, plate)
    floor_mm = 0.0 if below is None else z_mm
    for place in config.process.keep_out:
        if place.z_mm[1] > floor_mm:
            clamp = shapely.buffer(shapely.Polygon(place.outline_mm), half_mm)
            region = shapely.difference(region, clamp)
    return region


def widest_gap_mm(region: BaseGeometry, start: Floats, end: Floats, config: Config) -> float:
    """Greatest distance between two lines of the beam, (n, 2) each, that run across the region side by side, and from its ends to the next.

    A line counts where all of it within the region is driven. Lines along X are asked for, and along Y where there are any.
    """
    way = np.abs(end - start)
    along, across = (way[:, 1] <= ALONG_MM), (way[:, 0] <= ALONG_MM)
    gap_mm = _gap_mm(region, start[along], end[along])
    # Shorter ones join two lines along X.
    if way[across, 1].max(initial=0.0) > 2.0 * WIDEST * config.preheat.spacing_mm:
        swapped = shapely.transform(region, lambda places: places[:, ::-1])
        gap_mm = max(gap_mm, _gap_mm(swapped, start[across, ::-1], end[across, ::-1]))
    return gap_mm


def _gap_mm(region: BaseGeometry, start: Floats, end: Floats) -> float:
    """The same of lines along X."""
    row = np.round(start[:, 1] / ALONG_MM).astype(np.int64)
    driven = {y * ALONG_MM: shapely.union_all(shapely.linestrings(np.stack([start[row == y], end[row == y]], axis=1)))
              for y in np.unique(row).tolist()}  # fmt: skip
    worst = 0.0
    for part in shapely.get_parts(eroded(region, 0.6 * SLIVER_MM)):
        x0, y0, x1, y1 = shapely.bounds(part).tolist()
        places = [y0]
        for y, lines in driven.items():
            if y0 < y < y1:
                whole = shapely.intersection(part, shapely.LineString([(x0 - 1.0, y), (x1 + 1.0, y)]))
                near = shapely.buffer(lines, SLIVER_MM)
                left = shapely.get_parts(shapely.difference(whole, near))
                if shapely.length(left).max(initial=0.0) <= SLIVER_MM:
                    places.append(y)
        worst = max(worst, float(np.diff([*places, y1]).max()))
    return worst
