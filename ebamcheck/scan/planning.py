"""Plan layers: section -> regions -> islands -> lines -> order -> path."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.backend import Progress
from ebamcheck.config import Config
from ebamcheck.heat.one_blas_thread import one_blas_thread
from ebamcheck.kernels import run_blocks
from ebamcheck.layers import Layers
from ebamcheck.rings import Bools, Floats, Ints
from ebamcheck.scan import islands as cells
from ebamcheck.scan.borders import shared_borders
from ebamcheck.scan.drive import island_drive
from ebamcheck.scan.filling import fill_layer
from ebamcheck.scan.hatch import Vectors
from ebamcheck.scan.lattice import LATTICES, planned_side_mm
from ebamcheck.scan.order import LayerIslands, scan_order
from ebamcheck.scan.path import enter_nearest
from ebamcheck.scan.placement import layer_place
from ebamcheck.scan.plan import METRICS, ScanPlan, empty_vectors
from ebamcheck.scan.regions import Regions, layer_regions, layer_section
from ebamcheck.scan.simulate import EARLY, neighbour_intervals_s, simulate_order


def plan_scan(
    polygons: BaseGeometry | Iterable[BaseGeometry],
    profile: Config | None = None,
    order: str | None = None,
    seed: int | None = None,
    layer: int = 0,
    height_mm: float = 0.0,
) -> ScanPlan:
    """Plan one layer: divide it into islands, fill them and put them in order.

    Parameters
    ----------
    polygons
        Solid regions of the layer as shapely geometries, mm; overlapping ones unite, invalid ones are
        made valid. No polygon gives a plan without islands.
    profile
        Settings; the default ones if None.
    order, seed
        Name of the order (see :data:`ebamcheck.scan.ORDERS`) and seed of its random choices; those of
        the profile if None.
    layer
        Index of the layer, which turns and shifts the hatch and the cells, and seeds the start.
    height_mm
        Its height over the base plate.

    Raises
    ------
    SettingsError
        If the order is unknown, or the hexagons are far too small for the layer.
    GeometryError
        If a coordinate is not finite.

    Examples
    --------
    >>> plan = plan_scan(shapely.box(0, 0, 200, 80))
    >>> sorted(plan.order.tolist()) == list(range(len(plan.islands)))
    True
    """
    profile = profile or Config()
    name, number = order or profile.scan.order, profile.scan.seed if seed is None else seed
    planned = plan_layer(layer_section(polygons), profile, name, number, layer, float(height_mm))
    return stack_plans([planned], profile, name, number)


def plan_stack(
    layers: Layers,
    profile: Config | None = None,
    progress: Progress | None = None,
    order: str | None = None,
    seed: int | None = None,
) -> ScanPlan:
    """Plan a stack of layers, each as :func:`plan_scan` does, on all threads.

    Parameters
    ----------
    layers
        Contours; open paths bound no region and are not filled.
    progress
        Called with the number of layers done since the last call.
    profile, order, seed
        As for :func:`plan_scan`.
    """
    profile = profile or Config()
    name, number = order or profile.scan.order, profile.scan.seed if seed is None else seed
    sections = [layer_section(layers.polygons(k)) for k in range(len(layers))]
    # Layers are cut at half their height: the part stands on the plate half a layer under the lowest cut.
    plate_mm = float(layers.heights.min(initial=np.inf)) - 0.5 * profile.layer_height_mm
    reporting = Lock()

    def work(start: int, stop: int) -> list[LayerPlan]:
        done = []
        for k in range(start, stop):
            height_mm = float(layers.heights[k])
            done.append(plan_layer(sections[k], profile, name, number, k, height_mm, plate_mm))
            if progress is not None:
                with reporting:
                    progress(1)
        return done

    blocks = run_blocks(work, len(layers)) if len(layers) else []
    return stack_plans([p for block in blocks for p in block], profile, name, number)


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

    def choices(self, profile: Config, seed: int, plate_mm: float = 0.0) -> LayerIslands:
        """What an order may know of the layer; `plate_mm` is the height of the base plate."""
        return LayerIslands(
            centroid=self.centroid,
            area_mm2=np.asarray(shapely.area(self.islands), np.float64),
            neighbours=self.neighbours,
            layer=self.layer,
            seed=seed,
            profile=profile,
            height_mm=self.height_mm - plate_mm,
            section=self.regions.section,
            polygons=self.islands,
            drive=island_drive(self.lines, self.chained, profile),
        )


@dataclass(frozen=True, eq=False)
class LayerPlan:
    """One layer of a :class:`ScanPlan`: its islands, the order in which they are scanned, and the lines in it."""

    laid: LaidLayer
    order: Ints
    vectors: Vectors


@one_blas_thread()
def plan_layer(
    section: BaseGeometry,
    profile: Config,
    order: str,
    seed: int,
    layer: int,
    height_mm: float,
    plate_mm: float = 0.0,
) -> LayerPlan:
    """Plan one valid section."""
    laid = lay_islands(section, profile, layer, height_mm)
    return in_order(laid, scan_order(order, laid.choices(profile, seed, plate_mm)))


def in_order(laid: LaidLayer, order: Ints) -> LayerPlan:
    """Scan the islands of a layer in a given order (I,)."""
    return LayerPlan(laid, order, _driven(laid.lines, order, laid.chained))


def lay_islands(section: BaseGeometry, profile: Config, layer: int, height_mm: float) -> LaidLayer:
    """Divide one valid section into islands and fill them."""
    regions = layer_regions(section, profile)
    side = _side_mm(regions, profile)
    found = _partition(regions, side, profile, layer)
    filled = fill_layer(regions, found, profile, layer)
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


def _side_mm(regions: Regions, profile: Config) -> float:
    """Side of the hexagons: the one set, else planned from the solids; NaN without a solid."""
    if not regions.solids:
        return math.nan
    if profile.scan.hexagon_side_mm is not None:
        return profile.scan.hexagon_side_mm
    area, border = float(shapely.area(regions.solids).sum()), float(shapely.length(regions.solids).sum())
    return planned_side_mm(area, border, profile.process.hatch_spacing_mm)


def _partition(regions: Regions, side_mm: float, profile: Config, layer: int) -> cells.Cells:
    """Lay the cells of the partition over the section and clip them to its solids."""
    if profile.scan.partition == "whole" or not regions.solids:
        return cells.undivided(regions.solids)
    place = layer_place(shapely.get_coordinates(regions.section), side_mm, profile, layer)
    lattice = LATTICES[profile.scan.partition](place, side_mm)
    return cells.partition(
        regions.solids, lattice, profile.process.bead_width_mm, profile.process.hatch_spacing_mm
    )


def _driven(vectors: Vectors, order: Ints, chained: Bools) -> Vectors:
    """Lines in scan order, every island entered from its nearest corner."""
    first = np.concatenate([[0], np.cumsum(np.bincount(vectors.island, minlength=order.size))])
    rows, turned = enter_nearest(vectors.start, vectors.end, first.astype(np.int64), order, chained)
    a, b = vectors.start[rows], vectors.end[rows]
    swap = turned[:, None]
    return Vectors(vectors.island[rows], np.where(swap, b, a), np.where(swap, a, b))


def stack_plans(planned: Sequence[LayerPlan], profile: Config, order: str, seed: int) -> ScanPlan:
    """Join layers into one plan and measure it."""
    base = np.cumsum([0] + [len(p.laid.islands) for p in planned])
    islands = _joined([p.laid.islands for p in planned], np.zeros(0, object))
    by_layer = list(zip(planned, base[:-1], strict=True))
    plan = ScanPlan(
        heights=np.array([p.laid.height_mm for p in planned], np.float64),
        contours=cells.column([p.laid.regions.contour for p in planned]),
        islands=islands,
        # A plan of one layer is layer 0 of its own stack, whatever its index in the part.
        island_layer=np.repeat(np.arange(len(planned)), np.diff(base)).astype(np.int64),
        island_kind=_joined([p.laid.kind for p in planned], np.zeros(0, np.str_)),
        island_area_mm2=np.asarray(shapely.area(islands), np.float64),
        island_centroid=_joined([p.laid.centroid for p in planned], np.zeros((0, 2))),
        neighbours=_joined([p.laid.neighbours + b for p, b in by_layer], np.zeros((0, 2), np.int64)),
        border_mm=_joined([p.laid.border_mm for p in planned], np.zeros(0)),
        order=_joined([p.order + b for p, b in by_layer], np.zeros(0, np.int64)),
        vectors=_vector_table(by_layer),
        metrics=pd.DataFrame(columns=list(METRICS)),
        settings=_settings(profile, order, seed),
    )
    return replace(plan, metrics=_measured(plan, planned, profile))


def _joined(columns: Sequence[NDArray[Any]], empty: NDArray[Any]) -> NDArray[Any]:
    return np.concatenate(columns) if columns else empty


def _vector_table(by_layer: Sequence[tuple[LayerPlan, Any]]) -> pd.DataFrame:
    if not by_layer:
        return empty_vectors()
    start = np.concatenate([p.vectors.start for p, _ in by_layer])
    end = np.concatenate([p.vectors.end for p, _ in by_layer])
    way = end - start
    return pd.DataFrame(
        {
            "island": np.concatenate([p.vectors.island + b for p, b in by_layer]),
            "x0": start[:, 0],
            "y0": start[:, 1],
            "x1": end[:, 0],
            "y1": end[:, 1],
            "angle": np.degrees(np.arctan2(way[:, 1], way[:, 0])) % 360.0,
        }
    )


def _settings(profile: Config, order: str, seed: int) -> dict[str, Any]:
    """What shaped the plan."""
    return {
        "order": order,
        "seed": seed,
        "scan": profile.scan.model_dump(mode="json", exclude={"order", "seed"}),
        "bead_width_mm": profile.process.bead_width_mm,
        "bead_spacing": profile.process.bead_spacing,
        "travel_speed_mm_s": profile.process.travel_speed_mm_s,
        "rapid_mm_s": profile.machine.rapid_mm_s,
    }


def _measured(plan: ScanPlan, planned: Sequence[LayerPlan], profile: Config) -> pd.DataFrame:
    """One row a layer, as :data:`METRICS` says."""
    driven = simulate_order(plan, profile)
    end = np.full(len(plan.islands), np.nan)
    end[driven["island"]] = driven["end_s"]
    interval = neighbour_intervals_s(end, plan.neighbours)
    pair_layer = plan.island_layer[plan.neighbours[:, 0]]
    of_layer = driven["layer"].to_numpy()

    def total(values: pd.Series) -> Floats:
        return np.bincount(of_layer, values.to_numpy(np.float64), minlength=len(planned)).astype(np.float64)

    length, travel = total(driven["length_mm"]), total(driven["travel_mm"] + driven["inner_travel_mm"])
    spread = [interval[pair_layer == k] for k in range(len(planned))]
    spread = [values[np.isfinite(values)] for values in spread]
    area = np.array([p.laid.regions.section.area for p in planned], np.float64)
    contour = np.array([p.laid.regions.contour.length for p in planned], np.float64)
    laid_mm2 = (contour + length) * profile.process.hatch_spacing_mm
    values: dict[str, Any] = {
        "layer": [p.laid.layer for p in planned],
        "height_mm": plan.heights,
        "side_mm": [p.laid.side_mm for p in planned],
        "islands": [len(p.laid.islands) for p in planned],
        "area_mm2": area,
        "covered_fraction": [p.laid.covered for p in planned],
        "widest_gap_mm": [p.laid.widest_gap_mm for p in planned],
        "laid_share": np.divide(laid_mm2, area, out=np.zeros_like(area), where=area > 0),
        "contour_length_mm": contour,
        "hatch_length_mm": length,
        "travel_mm": travel,
        "starts": total(driven["starts"]).astype(np.int64),
        "time_s": length / profile.process.travel_speed_mm_s + travel / profile.machine.rapid_mm_s,
        "interval_p10_s": [float(np.quantile(v, EARLY)) if v.size else math.nan for v in spread],
        "interval_min_s": [float(v.min()) if v.size else math.nan for v in spread],
    }
    return pd.DataFrame(values, columns=list(METRICS))
