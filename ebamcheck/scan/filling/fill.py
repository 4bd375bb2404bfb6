"""Fill the islands of one layer: hatch lines, beads along walls, and beads over what these leave bare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.geometry.nearest import segments_of
from ebamcheck.geometry.raster import bare_samples, covered_fraction
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.scan.filling.gaps import bare_spots, gap_beads, line_rows, spots_to_close
from ebamcheck.scan.filling.hatch import Vectors, hatch, joined
from ebamcheck.scan.filling.walls import wall_lines
from ebamcheck.scan.islands import clipping as cells
from ebamcheck.scan.islands.directions import hatch_directions
from ebamcheck.scan.islands.regions import Regions
from ebamcheck.settings.config import Config

TRIM = 0.3
"""Share of the bead spacing by which a hatch line stops before the border of its island. There the turn to the next line
lies, or the round end of the bead: lines that reach the border lay a seventh more than the part has. On a square of
100 mm 0.2 to 0.4 leave the surface as flat; 0.3 needs the least spread of wire speeds."""

SHORTEST_LINE = 0.5
"""Lines are not trimmed to under this times the bead width, and not lengthened either."""


@dataclass(frozen=True, eq=False)
class FilledLayer:
    """Islands of one layer and their lines.

    Parameters
    ----------
    islands, kind
        (I,) polygons, none of which overlap, and the kind of each.
    lines
        Sorted by island.
    chained
        (I,) whether the lines of an island follow each other end to start.
    covered
        Share of the section that contour beads and lines cover.
    widest_gap_mm
        Diameter of the largest circle that they leave bare.
    """

    islands: NDArray[np.object_]
    kind: NDArray[np.str_]
    lines: Vectors
    chained: Bools
    covered: float = 1.0
    widest_gap_mm: float = 0.0


def fill_layer(regions: Regions, found: cells.Cells, config: Config, layer: int) -> FilledLayer:
    """Fill the cells of the solids and the walls of a layer, and close the gaps that are left."""
    walls = [*regions.narrow_fills, *regions.bare_walls]
    lines, chained = fill_islands(found, walls, len(regions.narrow_fills), config, layer)
    filled = FilledLayer(
        islands=np.concatenate([found.polygons, cells.column(walls)]),
        kind=np.concatenate([found.kind, np.full(len(walls), cells.THIN_WALL)]).astype(np.str_),
        lines=lines,
        chained=chained,
    )
    return close_gaps(filled, regions, config)


def fill_islands(
    found: cells.Cells, walls: Sequence[shapely.Polygon], narrow: int, config: Config, layer: int
) -> tuple[Vectors, Bools]:
    """Lines of all islands, sorted by island, and which islands' lines follow each other.

    The first `narrow` of the walls lie between contour beads, with which their beads meet; the others are bare.
    """
    width, spacing = config.process.bead_width_mm, config.process.hatch_spacing_mm
    turn = config.scan.first_angle_deg + layer * config.scan.layer_angle_deg
    angle = hatch_directions(found, spacing, turn, config.scan.island_angle_deg)
    hatched, _ = hatch(found.polygons, angle, width, spacing)
    hatched = trimmed(hatched, TRIM * spacing, SHORTEST_LINE * width)
    count = len(found.polygons)
    owner, start, end = [hatched.island], [hatched.start], [hatched.end]
    for number, wall in enumerate(walls, count):
        lines = wall_lines(wall, width, spacing, to_the_end=number < count + narrow)
        if lines:
            along = Vectors(
                np.full(sum(len(line) - 1 for line in lines), number, np.int64),
                np.concatenate([line[:-1] for line in lines]),
                np.concatenate([line[1:] for line in lines]),
            )
        else:  # too short or too crooked for a centre line
            straight, _ = hatch(cells.column([wall]), 0.0, width, spacing)
            along = Vectors(straight.island + number, straight.start, straight.end)
        owner.append(along.island)
        start.append(along.start)
        end.append(along.end)
    chained = np.arange(count + len(walls)) >= count
    return Vectors(np.concatenate(owner), np.concatenate(start), np.concatenate(end)), chained


def trimmed(lines: Vectors, by_mm: float, shortest_mm: float) -> Vectors:
    """Shorten lines at both ends, but none to under a length."""
    way = lines.end - lines.start
    length = np.hypot(way[:, 0], way[:, 1])
    cut_mm = np.clip(0.5 * (length - shortest_mm), 0.0, by_mm)
    share = np.divide(cut_mm, length, out=np.zeros_like(length), where=length > 0.0)[:, None]
    return Vectors(lines.island, lines.start + share * way, lines.end - share * way)


def close_gaps(filled: FilledLayer, regions: Regions, config: Config) -> FilledLayer:
    """Lay gap beads, see :mod:`ebamcheck.scan.filling.gaps`, and measure the coverage."""
    width, section = config.process.bead_width_mm, regions.section
    beads = _beads(regions, filled.lines)
    bare = bare_samples(section, beads, width)
    chosen, widest_mm = spots_to_close(
        bare_spots(section, bare, beads, width),
        config.scan.gap_width * width,
        section.area,
        bare.covered,
        config.scan.least_coverage,
    )
    if not chosen:
        return replace(filled, covered=bare.covered, widest_gap_mm=widest_mm)
    gaps = gap_beads(chosen, section, filled.islands, width, config.process.hatch_spacing_mm)
    added = len(gaps.polygons)
    line, start, end = line_rows(gaps.lines)
    lines = joined(filled.lines, Vectors(gaps.island[line], start, end))
    return FilledLayer(
        islands=np.concatenate([filled.islands, gaps.polygons]),
        kind=np.concatenate([filled.kind, np.full(added, cells.GAP)]).astype(np.str_),
        lines=lines,
        chained=np.concatenate([filled.chained, np.ones(added, np.bool_)]),
        covered=covered_fraction(section, _beads(regions, lines), width),
        widest_gap_mm=widest_mm,
    )


def _beads(regions: Regions, lines: Vectors) -> Floats:
    """Centre lines of all beads, (S, 4)."""
    return np.vstack([segments_of(shapely.boundary(regions.contour)), np.hstack([lines.start, lines.end])])
