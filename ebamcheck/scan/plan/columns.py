"""The plan of a stack: islands, the order in which they are scanned, every line of the beam; in Parquet files with one row a layer.

The schema's metadata hold ``ebamcheck`` (JSON: format, settings). Every number comes back in the same bits.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.columns_file import (
    Column,
    ReadTable,
    arrow_columns,
    open_table,
    readable,
    starts_of,
    write_table,
)
from ebamcheck.curves.columns import Curves
from ebamcheck.errors import InputError
from ebamcheck.json_values import parsed_json
from ebamcheck.kernels import Floats, Ints
from ebamcheck.metal import Surface
from ebamcheck.scan.filling.schedule import follows
from ebamcheck.showing import short_text
from ebamcheck.showing.columns import LayerColumns

# Columns of :attr:`ScanPlan.metrics` and what they are
METRICS = {
    "layer": "index of the layer",
    "height_mm": "absolute height",
    "side_mm": "side of the hexagons (or of those as wide as the squares or stripes), NaN without a solid",
    "islands": "islands",
    "area_mm2": "area of the section",
    "covered_fraction": "share of it within half a bead width of a contour bead or a line",
    "widest_gap_mm": "diameter of the largest circle that they leave bare, but for specks of 2 % of a squared bead width or 0.2 % of a part",
    "laid_share": "length of all beads times their spacing, over the area: above 1 they overlap more than is set",
    "contour_length_mm": "length of the contour beads",
    "hatch_length_mm": "length of the lines",
    "turn_length_mm": "length of the turns between lines, beam and wire on",
    "travel_mm": "jumps between lines, beam off",
    "starts": "wire starts: lines to which the beam jumps",
    "time_s": "lines and turns at travel speed and jumps at rapid speed, without the contour beads",
    "interval_p10_s": "time between the ends of neighbouring islands, shortest tenth; NaN without any",
    "interval_min_s": "the same, least",
    "body_mean_k": "mean temperature rise of the body under it when it begins; NaN where no heat model was asked",
    "entry_max_k": "greatest mean temperature rise of a contour or an island when the beam enters it; NaN likewise",
    "wait_s": "wait before the layer",
    "ring_wait_s": "wait before each further contour of it",
    "power_share": "share of the beam's power",
    "enter_k": "temperature of the surface when the layer begins, absolute; NaN likewise",
    "leave_k": "the same when it is done, at most the boiling point, the end of the model's range, as the other temperatures",
}

NAME, VERSION = "ebamcheck scan plan", 3  # in the metadata of the file; a reader refuses any other version
HEADER_KEY = b"ebamcheck"
LINE_COLUMNS = ("x0", "y0", "x1", "y1", "angle")
_OF_LAYER = ("height_mm", "section", "metrics")
_NUMBER, _NUMBERS, _COUNTS = pa.float64(), pa.large_list(pa.float64()), pa.large_list(pa.int64())
_REGION = pa.large_binary()
_OF_ISLAND = {
    "island_rank": _COUNTS,  # place of each island in the layer's order, from 0
    "island_kind": pa.large_list(pa.string()),  # hexagon, square, stripe, whole, thin wall or gap
    "island_polygon": pa.large_list(_REGION),  # well-known binary
    "island_area_mm2": _NUMBERS,
    "island_x_mm": _NUMBERS,  # centroid
    "island_y_mm": _NUMBERS,
    "island_wait_s": _NUMBERS,  # wait before it
    "island_inner_wait_s": _NUMBERS,  # wait before each further bead of it
    "island_lines": _COUNTS,  # how many it has
}
# Ends of all lines, island by island, each in its sequence; directions of travel, degrees counter-clockwise from +X
_OF_LINE = dict.fromkeys(LINE_COLUMNS, _NUMBERS)
# Pairs of islands of the layer that have a common border, and its length
_OF_BORDER = {"border_first": _COUNTS, "border_second": _COUNTS, "border_mm": _NUMBERS}


@dataclass(frozen=True, eq=False, repr=False)
class Island:
    """One island: a region that is filled with parallel lines before the beam goes to the next."""

    plan: ScanPlan
    index: int  # number of the island in the plan
    rank: int  # its place in the order of its layer, from 0
    layer: int  # index of its layer
    kind: str  # ``hexagon``, ``square``, ``stripe``, ``whole``, ``thin wall`` or ``gap``
    area_mm2: float
    centre_mm: tuple[float, float]  # centroid
    polygon: BaseGeometry
    wait_s: float  # wait before it

    @property
    def lines(self) -> pd.DataFrame:
        """Hatch lines in the order of the beam: ``x0, y0, x1, y1`` in mm, and ``angle`` in degrees."""
        lines = self.plan.vectors_of(self.layer)
        return lines[lines["island"] == self.index].reset_index(drop=True)

    def __repr__(self) -> str:
        x, y = self.centre_mm
        return short_text.line(
            f"Island {self.index}",
            self.kind,
            f"layer [{self.layer}]",
            f"rank {self.rank}",
            f"{self.area_mm2:.6g} mm2",
            f"at ({x:.3f}, {y:.3f}) mm",
            f"after {self.wait_s:.3g} s" if self.wait_s else "",
        )


@dataclass(frozen=True, eq=False, repr=False)
class PlannedLayer:
    """One layer of a plan; iterating over it gives its islands in the order in which they are scanned."""

    plan: ScanPlan
    index: int

    @property
    def height_mm(self) -> float:
        """Absolute z."""
        return float(self.plan.heights[self.index])

    @property
    def islands(self) -> tuple[Island, ...]:
        """Islands in scan order."""
        plan = self.plan
        waits_s = plan.island_wait_s if len(plan.island_wait_s) else np.zeros(len(plan.islands))
        columns = (plan.island_kind, plan.island_area_mm2, plan.island_centroid, plan.islands, waits_s)
        order = plan.islands_of(self.index)
        rows = zip(order.tolist(), *(column[order].tolist() for column in columns), strict=True)
        return tuple(
            Island(plan, k, rank, self.index, kind, area_mm2, (x, y), polygon, wait_s)
            for rank, (k, kind, area_mm2, (x, y), polygon, wait_s) in enumerate(rows)
        )

    @property
    def contours(self) -> Any:
        """Region whose borders are the centre lines of the contour beads."""
        return self.plan.contours[self.index]

    @property
    def metrics(self) -> dict[str, float]:
        """Figures of the layer, by the names of :data:`METRICS`."""
        return {str(name): float(value) for name, value in self.plan.metrics.iloc[self.index].items()}

    def __iter__(self) -> Iterator[Island]:
        """Go through the islands in scan order."""
        return iter(self.islands)

    def __len__(self) -> int:
        """Return the number of islands."""
        return len(self.plan.islands_of(self.index))

    def plot(self, ax: Any = None) -> Any:
        """Draw the islands on matplotlib axes in the colours of their order, with their lines and the contour beads."""
        from ebamcheck.showing.plotting import Lines, plot_areas

        parts = [(island.rank, part) for island in self for part in shapely.get_parts(island.polygon)]
        parts = [(rank, part) for rank, part in parts if part.geom_type == "Polygon"]
        areas = [shapely.get_coordinates(part.exterior) for _, part in parts]
        ends = self.plan.vectors_of(self.index)[["x0", "y0", "x1", "y1"]].to_numpy()
        borders = shapely.get_parts(shapely.boundary(self.contours))
        contours = [shapely.get_coordinates(border) for border in borders]
        lines = [Lines(list(ends.reshape(-1, 2, 2)), "#555555", 0.5), Lines(contours, "#d55e00")]
        title = f"layer {self.index + 1}, {short_text.counted(len(self), 'island')}"
        return plot_areas(areas, [rank for rank, _ in parts], lines, title, ax)

    def __repr__(self) -> str:
        covered = self.metrics.get("covered_fraction", float("nan"))
        return short_text.line(
            f"PlannedLayer [{self.index}]",
            f"z = {self.height_mm:.6g} mm",
            short_text.counted(len(self), "island"),
            short_text.counted(len(self.plan.vectors_of(self.index)), "line"),
            f"{100.0 * covered:.2f} % covered" if covered == covered else "",
        )


@dataclass(frozen=True, eq=False, repr=False)
class ScanPlan(LayerColumns[PlannedLayer]):
    """How a stack of layers is scanned, as columns. Islands are numbered through the stack; those of a layer do not overlap."""

    heights: Floats  # (L,) absolute z of each layer, mm
    contours: NDArray[np.object_]  # (L,) shapely regions bordered by the centre lines of the contour beads
    islands: NDArray[np.object_]  # (I,) shapely polygons, sorted by layer
    island_layer: Ints  # (I,) layer of each
    # (I,) ``hexagon``, ``square``, ``stripe``, ``whole`` (a solid not divided), ``thin wall``, ``gap`` (what all others leave bare)
    island_kind: NDArray[np.str_]
    island_area_mm2: Floats  # (I,)
    island_centroid: Floats  # (I, 2) mm
    neighbours: Ints  # (P, 2) pairs of islands with a common border, the lesser first
    border_mm: Floats  # (P,) its length
    order: Ints  # (I,) islands in scan order, layer by layer
    # Lines in scan order: `island, x0, y0, x1, y1` (mm) and `angle`, of travel, degrees counter-clockwise from +X, in [0, 360)
    vectors: pd.DataFrame
    metrics: pd.DataFrame  # one row a layer, columns as in :data:`METRICS`
    settings: dict[str, Any] = field(default_factory=dict)  # name of the order, seed, what shaped the plan
    island_wait_s: Floats = field(default_factory=lambda: np.zeros(0))  # (I,) wait before each; empty: none
    # (L,) shapely regions that are to be metal, by which every bead gets its wire; None: each gets the wire of a bead by itself
    sections: NDArray[np.object_] | None = None
    # (I,) wait before each further bead of an island, which begins where its lines lie apart; empty: none
    inner_wait_s: Floats = field(default_factory=lambda: np.zeros(0))
    # No file holds these: the surface that the beads of the lowest layer mend (None: level), the section under it where that is preheated
    # (None: the base plate), and the curves along the contour beads (None: not known)
    stands: Surface | None = None
    under: BaseGeometry | None = None
    beads: Curves | None = None

    def _item(self, index: int) -> PlannedLayer:
        return PlannedLayer(self, index)

    def _facts(self) -> dict[str, int | str]:
        counts = {"islands": len(self.islands), "lines": len(self.vectors)}
        return {**self._heights(), **counts, "order": str(self.settings.get("order", ""))}

    def plot(self, layer: int, ax: Any = None) -> Any:
        """Draw one layer of the plan on matplotlib axes."""
        return self[layer].plot(ax)

    def islands_of(self, layer: int) -> Ints:
        """Islands of a layer in scan order."""
        a, b = np.searchsorted(self.island_layer, [layer, layer + 1])
        return self.order[a:b]

    def vectors_of(self, layer: int) -> pd.DataFrame:
        """Lines of a layer in scan order."""
        on_layer = self.island_layer[self.vectors["island"].to_numpy()]
        a, b = np.searchsorted(on_layer, [layer, layer + 1])
        return self.vectors.iloc[a:b]

    def further_beads(self) -> Ints:
        """Island of each bead that is not the first of its island, in scan order."""
        island = self.vectors["island"].to_numpy()
        start, end = (self.vectors[list(at)].to_numpy(np.float64) for at in (("x0", "y0"), ("x1", "y1")))
        spacing_mm = self.settings["bead_width_mm"] * self.settings["bead_spacing"]
        begins = island[~follows(island, start, end, spacing_mm)]
        return np.asarray(begins[1:][np.diff(begins) == 0], np.int64)

    def to_parquet(self, path: str | Path) -> None:
        """Write one row a layer; the file appears whole or not at all. Raises SettingsError if it cannot be written."""
        header = json.dumps({"format": f"{NAME} {VERSION}", "settings": self.settings}, sort_keys=True)
        table = pa.table(_columns(self)).replace_schema_metadata({HEADER_KEY: header.encode()})
        write_table(table, Path(path), use_dictionary=["island_kind.list.element"])

    @classmethod
    def from_parquet(cls, path: str | Path) -> ScanPlan:
        """Read a plan; raises InputError for a file that is missing, damaged, no plan, one of another version, or does not
        match."""
        path = Path(path)
        table, settings = _table(path, None)
        layers = _layers(table)
        islands, (starts,) = table.alike(_OF_ISLAND)
        island_layer = np.repeat(np.arange(len(layers.heights)), np.diff(starts)).astype(np.int64)
        rank = _ranks(islands["island_rank"], starts, island_layer, path)
        neighbours, border_mm = _borders(table, starts)
        return cls(
            heights=layers.heights,
            contours=_regions(table.plain("contour", _REGION), path),
            islands=_regions(islands["island_polygon"], path),
            island_layer=island_layer,
            island_kind=np.asarray(islands["island_kind"].tolist(), np.str_),
            island_area_mm2=islands["island_area_mm2"].copy(),
            island_centroid=np.column_stack([islands["island_x_mm"], islands["island_y_mm"]]),
            neighbours=neighbours,
            border_mm=border_mm,
            order=np.argsort(rank, kind="stable").astype(np.int64),
            vectors=_vectors(table, islands["island_lines"], starts, rank),
            metrics=layers.metrics,
            settings=settings,
            island_wait_s=islands["island_wait_s"].copy(),
            inner_wait_s=islands["island_inner_wait_s"].copy(),
            sections=layers.sections,
        )


@dataclass(frozen=True, eq=False)
class PlanOfLayers:
    """What a plan knows of its layers, without islands and lines; columns as in :class:`ScanPlan`."""

    heights: Floats
    metrics: pd.DataFrame
    sections: NDArray[np.object_] | None

    @classmethod
    def from_parquet(cls, path: str | Path) -> PlanOfLayers:
        """Read it from the file of a plan; raises :class:`InputError` where the file is not one."""
        table, _ = _table(Path(path), _OF_LAYER)
        return _layers(table)


# -- columns of a plan -------------------------------------------------------------------------------


def _columns(plan: ScanPlan) -> dict[str, pa.Array]:
    """Columns of the table, by name."""
    count = len(plan.islands)
    starts = np.searchsorted(plan.island_layer, np.arange(len(plan) + 1)).astype(np.int64)
    rank = np.empty(count, np.int64)
    rank[plan.order] = np.arange(count)
    # Lines are in scan order; sorted by island (stably) they keep their sequence within it.
    island = plan.vectors["island"].to_numpy()
    by_island = np.argsort(island, kind="stable")
    lines = np.bincount(island, minlength=count)
    line_starts = starts_of(lines)[starts]
    pair_layer = plan.island_layer[plan.neighbours[:, 0]]
    pair_starts = np.searchsorted(pair_layer, np.arange(len(plan) + 1)).astype(np.int64)
    pairs = plan.neighbours - starts[pair_layer][:, None]
    of_island = {
        "rank": rank - starts[plan.island_layer],
        "kind": pa.array(plan.island_kind.tolist(), pa.string()),
        "polygon": _well_known(plan.islands),
        "area_mm2": plan.island_area_mm2,
        "x_mm": plan.island_centroid[:, 0],
        "y_mm": plan.island_centroid[:, 1],
        "wait_s": plan.island_wait_s if len(plan.island_wait_s) else np.zeros(count),
        "inner_wait_s": plan.inner_wait_s if len(plan.inner_wait_s) else np.zeros(count),
        "lines": lines,
    }
    metrics = {name: pa.array(plan.metrics[name].to_numpy()) for name in plan.metrics.columns}
    columns = {"height_mm": pa.array(plan.heights), "contour": _well_known(plan.contours)}
    columns["metrics"] = pa.StructArray.from_arrays(list(metrics.values()), list(metrics))
    if plan.sections is not None:
        columns["section"] = _well_known(plan.sections)
    lists: dict[str, Column] = {f"island_{name}": (values, starts) for name, values in of_island.items()}
    lists |= {name: (plan.vectors[name].to_numpy()[by_island], line_starts) for name in LINE_COLUMNS}
    borders = (pairs[:, 0], pairs[:, 1], plan.border_mm)
    lists |= {name: (values, pair_starts) for name, values in zip(_OF_BORDER, borders, strict=True)}
    return columns | arrow_columns(lists, {**_OF_ISLAND, **_OF_LINE, **_OF_BORDER})


def _well_known(regions: NDArray[np.object_]) -> pa.LargeBinaryArray:
    return pa.array(list(shapely.to_wkb(regions)), _REGION)


# -- columns of a table ------------------------------------------------------------------------------


def _table(path: Path, names: Sequence[str] | None) -> tuple[ReadTable, dict[str, Any]]:
    """Columns of a file, all of them or those of `names` that it has, and the plan's settings."""
    with readable(path, "a scan plan"), open_table(path) as file:
        settings = _settings(path, file.schema_arrow.metadata or {})
        there = [name for name in file.schema_arrow.names if names is None or name in names]
        return ReadTable(file.read(there), path), settings


def _settings(path: Path, metadata: Mapping[bytes, bytes]) -> dict[str, Any]:
    """Settings that stand in the metadata of a plan; refuses what is none, or of another version."""
    try:
        header = parsed_json(metadata.get(HEADER_KEY, b"{}"))
        said, settings = str(header.get("format", "")), dict(header.get("settings", {}))
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is not a scan plan: its header cannot be read: {error}") from None
    if found := re.fullmatch(rf"{NAME} (\d{{1,9}})", said):
        version = int(found[1])
        if version == VERSION:
            return settings
        age = "an earlier" if version < VERSION else "a later"
        raise InputError(
            f"{path}: is a scan plan of format {version}, of {age} version of this program, which reads format {VERSION}: "
            "make the plan, or the run that it belongs to, again"
        )
    raise InputError(f"{path}: is not a scan plan (format {said[:40]!r}, expected '{NAME} {VERSION}')")


def _layers(table: ReadTable) -> PlanOfLayers:
    """What a plan knows of its layers."""
    sections = None
    if "section" in table.table.schema.names:
        sections = _regions(table.plain("section", _REGION), table.where)
    return PlanOfLayers(table.plain("height_mm", _NUMBER), _metrics(table), sections)


def _metrics(found: ReadTable) -> pd.DataFrame:
    """Figures of the layers: those of :data:`METRICS`, then what a plan has beside them."""
    table = found.table
    fields: dict[str, pa.Array] = {}
    if "metrics" in table.schema.names and pa.types.is_struct(table.schema.field("metrics").type):
        metrics = table.column("metrics").combine_chunks()
        fields = {field.name: metrics.field(field.name) for field in metrics.type}
    if missing := [name for name in METRICS if name not in fields]:
        raise InputError(f"{found.where}: its metrics lack {', '.join(missing)}")
    columns = {name: values.to_numpy(zero_copy_only=False) for name, values in fields.items()}
    return pd.DataFrame(columns, columns=[*METRICS, *(name for name in fields if name not in METRICS)])


def _ranks(of_layer: Ints, starts: Ints, island_layer: Ints, path: Path) -> Ints:
    """Place of each island in the order of the stack, from those within its layer."""
    rank = starts[island_layer] + of_layer
    sizes = np.diff(starts)[island_layer]
    if ((of_layer < 0) | (of_layer >= sizes)).any() or np.unique(rank).size < rank.size:
        raise InputError(f"{path}: the ranks of the islands of a layer are not those from 0 on, each once")
    return rank


def _vectors(table: ReadTable, lines: Ints, starts: Ints, rank: Ints) -> pd.DataFrame:
    """Lines in scan order."""
    found, (line_starts,) = table.alike(_OF_LINE)
    if (lines < 0).any() or not np.array_equal(starts_of(lines)[starts], line_starts):
        raise InputError(f"{table.where}: a layer has other lines than its islands")
    island = np.repeat(np.arange(rank.size), lines).astype(np.int64)
    scanned = np.argsort(rank[island], kind="stable")
    return pd.DataFrame({"island": island[scanned], **{n: found[n][scanned] for n in LINE_COLUMNS}})


def _borders(table: ReadTable, starts: Ints) -> tuple[Ints, Floats]:
    """(P, 2) pairs of islands with a common border, and its length."""
    found, (pair_starts,) = table.alike(_OF_BORDER)
    layer = np.repeat(np.arange(len(pair_starts) - 1), np.diff(pair_starts))
    pairs = np.column_stack([found["border_first"], found["border_second"]])
    if ((pairs < 0) | (pairs >= np.diff(starts)[layer][:, None])).any():
        raise InputError(f"{table.where}: a common border is one of islands that its layer does not have")
    return pairs + starts[layer][:, None], found["border_mm"].copy()


def _regions(well_known: NDArray[np.object_], path: str | Path) -> NDArray[np.object_]:
    """Regions of well-known binary."""
    found = np.empty(len(well_known), object)
    try:
        found[:] = shapely.from_wkb(well_known)
    except (shapely.errors.ShapelyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: holds a region that cannot be read: {error}") from None
    return found
