"""The regions of one layer: what the contour bead takes, what is left to fill, and where walls are thin.

From the contour inwards, with bead width w, bead spacing s (times w) and contour offset c (half a bead unless set): the centre line
of the contour bead is the contour inset by c. The fill is the contour inset by c + s/2, since a bead owns half a spacing on either
side: a hatch line along the contour then lies one spacing from the contour bead, and one that ends there ends inside it, since s/2
<= w/2. A bare wall is narrower than a contour bead can go around: one bead along it. A narrow fill lies between two contour beads
with no room for a partition: beads along the wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.regions import ARC_SEGMENTS, JOIN_MM, inset, mean_width_mm, split_thin, valid_polygons
from ebamcheck.settings.config import Config

# Walls of up to so many bead widths are thin: two contour beads and a bead between them fill them
THIN_WALL_BEADS = 3.0
CRUMB = 0.25  # bare pieces under this times the squared bead width are corners that a round bead never fills
CORNER = 0.5  # narrow pieces of the fill under this times the squared opening width are corners of a solid (down to about 35 degrees), not walls
# Deviation, over the bead width, by which the border of the fill is simplified: its points serve a surface that the fill does not reach
FILL_TOLERANCE = 0.002


@dataclass(frozen=True, eq=False)
class Regions:
    """The regions of one layer, all of them inside the section."""

    section: BaseGeometry  # the solid region
    contour: BaseGeometry  # its border is the centre line of the contour bead
    solids: list[shapely.Polygon]  # fill to be partitioned
    narrow_fills: list[shapely.Polygon]  # fill between two contour beads, to be filled along the wall
    bare_walls: list[shapely.Polygon]  # parts of the section where no contour bead fits


def contour_region(section: BaseGeometry, config: Config) -> BaseGeometry:
    """Region whose border is the centre line of the contour bead of a section."""
    return inset(section, config.contour_offset_mm)


def layer_regions(section: BaseGeometry, config: Config, contour: BaseGeometry | None = None) -> Regions:
    """Split the section of a layer into contour, solids and thin walls; the contour is made unless it is known."""
    width = config.process.bead_width_mm
    spacing = config.process.hatch_spacing_mm
    offset = config.contour_offset_mm
    contour = contour_region(section, config) if contour is None else contour
    fill = shapely.simplify(inset(contour, 0.5 * spacing), FILL_TOLERANCE * width)
    narrow = max(THIN_WALL_BEADS * width - 2.0 * offset - spacing, spacing)
    solids, thin = split_thin(fill, narrow, CORNER * narrow**2)
    return Regions(
        section=section,
        contour=contour,
        solids=solids,
        # Where the two contour beads meet there is nothing left to fill.
        narrow_fills=[p for p in thin if mean_width_mm(p) > width - spacing],
        bare_walls=bare_walls(section, contour, offset, CRUMB * width**2),
    )


def bare_walls(
    section: BaseGeometry, contour: BaseGeometry, reach_mm: float, crumb_mm2: float
) -> list[shapely.Polygon]:
    """Parts of a section out of reach of its contour: too narrow for a contour bead."""
    reached = shapely.buffer(contour, reach_mm + JOIN_MM, quad_segs=ARC_SEGMENTS)
    kept = [p for p in _beside(section, reached) if p.area >= crumb_mm2]
    # A whole small island of metal is no crumb of anything: it still gets its bead.
    alone = [p for p in valid_polygons(section) if p.area < crumb_mm2]
    return kept + alone


def _beside(region: BaseGeometry, taken: BaseGeometry) -> list[shapely.Polygon]:
    """Polygons of a region less another one, part by part: at once, time grows with the square of the parts."""
    parts, others = np.asarray(valid_polygons(region), object), shapely.get_parts(taken)
    part, other = shapely.STRtree(others).query(parts)
    near = np.full(parts.size, shapely.MultiPolygon(), object)
    order = np.argsort(part, kind="stable")
    shapely.multipolygons(others[other[order]], indices=part[order], out=near)
    return [polygon for left in shapely.difference(parts, near) for polygon in valid_polygons(left)]
