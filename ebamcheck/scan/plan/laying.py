"""One layer before its islands are put in order: section -> regions -> islands -> lines."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.filling.fill import fill_layer
from ebamcheck.scan.filling.hatch import Vectors
from ebamcheck.scan.filling.schedule import island_schedule
from ebamcheck.scan.islands import clipping as cells
from ebamcheck.scan.islands.clipping import shared_borders
from ebamcheck.scan.islands.lattice import LATTICES, layer_place, planned_side_mm
from ebamcheck.scan.islands.regions import Regions, layer_regions
from ebamcheck.scan.order.orders import LayerIslands
from ebamcheck.settings.config import Config


@dataclass(frozen=True, eq=False)
class LaidLayer:
    """One layer before its islands are put in order: islands numbered from 0, and their lines sorted by island."""

    layer: int
    height_mm: float
    side_mm: float
    regions: Regions
    islands: NDArray[np.object_]
    kind: NDArray[np.str_]
    centroid: Floats
    neighbours: Ints
    border_mm: Floats
    lines: Vectors
    chained: Bools
    covered: float
    widest_gap_mm: float

    def choices(self, config: Config, seed: int, plate_mm: float = 0.0) -> LayerIslands:
        """What an order may know of the layer; `plate_mm` is the height of the base plate."""
        return LayerIslands(
            centroid=self.centroid,
            area_mm2=np.asarray(shapely.area(self.islands), np.float64),
            neighbours=self.neighbours,
            layer=self.layer,
            seed=seed,
            config=config,
            height_mm=self.height_mm - plate_mm,
            section=self.regions.section,
            polygons=self.islands,
            schedule=island_schedule(self.lines, self.chained, config),
            lines=self.lines,
        )


def lay_islands(section: BaseGeometry, config: Config, layer: int, height_mm: float) -> LaidLayer:
    """Divide one valid section into islands and fill them."""
    regions = layer_regions(section, config)
    side = _side_mm(regions, config)
    found = _partition(regions, side, config, layer)
    filled = fill_layer(regions, found, config, layer)
    neighbours, border = shared_borders(filled.islands)
    return LaidLayer(
        layer=layer,
        height_mm=height_mm,
        side_mm=side,
        regions=regions,
        islands=filled.islands,
        kind=filled.kind,
        centroid=cells.centroids(filled.islands),
        neighbours=neighbours,
        border_mm=border,
        lines=filled.lines,
        chained=filled.chained,
        covered=filled.covered,
        widest_gap_mm=filled.widest_gap_mm,
    )


def _side_mm(regions: Regions, config: Config) -> float:
    """Side of the hexagons: the one set, else planned from the solids; NaN without a solid."""
    if not regions.solids:
        return math.nan
    if config.scan.hexagon_side_mm is not None:
        return config.scan.hexagon_side_mm
    area, border = float(shapely.area(regions.solids).sum()), float(shapely.length(regions.solids).sum())
    return planned_side_mm(area, border, config.process.hatch_spacing_mm)


def _partition(regions: Regions, side_mm: float, config: Config, layer: int) -> cells.Cells:
    """Lay the cells of the partition over the section and clip them to its solids."""
    if config.scan.partition == "whole" or not regions.solids:
        return cells.undivided(regions.solids)
    place = layer_place(shapely.get_coordinates(regions.section), side_mm, config, layer)
    lattice = LATTICES[config.scan.partition](place, side_mm)
    return cells.partition(
        regions.solids, lattice, config.process.bead_width_mm, config.process.hatch_spacing_mm
    )
