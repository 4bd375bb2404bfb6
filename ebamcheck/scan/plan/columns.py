"""The plan of a stack: islands, the order in which they are scanned, and every line of the beam."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.atomic_file import COMPRESSION
from ebamcheck.errors import InputError
from ebamcheck.metal import Surface
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.filling.turns import follows
from ebamcheck.scan.plan import items as plan_items

FORMAT = "ebamcheck scan plan 2"
"""Name and version of the file format."""

VECTOR_COLUMNS = ("island", "x0", "y0", "x1", "y1", "angle")

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
"""Columns of :attr:`ScanPlan.metrics` and what they are."""


def empty_vectors() -> pd.DataFrame:
    """Return a table of no lines, with its columns and types."""
    columns = {name: np.zeros(0, np.float64) for name in VECTOR_COLUMNS}
    return pd.DataFrame({**columns, "island": np.zeros(0, np.int64)})


@dataclass(frozen=True, eq=False)
class ScanPlan:
    """How a stack of layers is scanned, as columns. Islands are numbered through the stack.

    Parameters
    ----------
    heights
        (L,) absolute z of each layer, mm.
    contours
        (L,) shapely regions whose borders are the centre lines of the contour beads.
    islands
        (I,) shapely polygons, sorted by layer; the islands of a layer do not overlap.
    island_layer
        (I,) layer of each.
    island_kind
        (I,) ``"hexagon"``, ``"square"`` or ``"stripe"``, ``"whole"`` (a solid that is not divided),
        ``"thin wall"``, or ``"gap"`` (a spot that all others leave bare).
    island_area_mm2, island_centroid
        (I,) and (I, 2) mm.
    neighbours, border_mm
        (P, 2) pairs of islands with a common border, the lesser first; (P,) its length.
    order
        (I,) islands in scan order, layer by layer.
    vectors
        Lines in scan order: ``island, x0, y0, x1, y1`` (mm) and ``angle``, the direction of travel
        in degrees counter-clockwise from +X, in [0, 360).
    metrics
        One row a layer, columns as in :data:`METRICS`.
    settings
        Name of the order, seed and the settings that shaped the plan.
    island_wait_s
        (I,) wait before each island; empty: none.
    inner_wait_s
        (I,) wait before each further bead of an island, which begins where its lines lie apart; empty: none.
    sections
        (L,) shapely regions that are to be metal, by which every bead gets its wire; None: not known, and every bead
        gets the wire of a bead by itself.
    stands
        Surface of what the lowest layer lies on, which its beads mend; None: level. No file holds it.
    under
        Section of what the lowest layer lies on, where that is preheated; None: the base plate. No file holds it.
    """

    heights: Floats
    contours: NDArray[np.object_]
    islands: NDArray[np.object_]
    island_layer: Ints
    island_kind: NDArray[np.str_]
    island_area_mm2: Floats
    island_centroid: Floats
    neighbours: Ints
    border_mm: Floats
    order: Ints
    vectors: pd.DataFrame
    metrics: pd.DataFrame
    settings: dict[str, Any] = field(default_factory=dict)
    island_wait_s: Floats = field(default_factory=lambda: np.zeros(0))
    sections: NDArray[np.object_] | None = None
    inner_wait_s: Floats = field(default_factory=lambda: np.zeros(0))
    stands: Surface | None = None
    under: BaseGeometry | None = None

    def __len__(self) -> int:
        """Return the number of layers."""
        return int(self.heights.size)

    # How a plan shows itself, layer by layer.
    __iter__ = plan_items.plan_iterator
    __getitem__ = plan_items.plan_item
    __repr__ = plan_items.plan_line
    _repr_html_ = plan_items.plan_html
    plot = plan_items.plan_plot

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
        """Write one row an island (in the order of `islands`), with its lines as nested columns."""
        pq.write_table(_to_table(self), path, version="2.6", compression=COMPRESSION)

    @classmethod
    def from_parquet(cls, path: str | Path) -> ScanPlan:
        """Read a plan back; raises :class:`InputError` where the file is not one."""
        try:
            table = pq.read_table(path)
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"{path}: cannot be read as a scan plan: {error}") from None
        return _from_table(table, _header(path, table.schema))


@dataclass(frozen=True, eq=False)
class PlanOfLayers:
    """What a plan knows of its layers, without islands and lines; columns as in :class:`ScanPlan`."""

    heights: Floats
    metrics: pd.DataFrame
    sections: NDArray[np.object_] | None

    @classmethod
    def from_parquet(cls, path: str | Path) -> PlanOfLayers:
        """Read it from the file of a plan; raises :class:`InputError` where the file is not one."""
        try:
            header = _header(path, pq.read_schema(path))
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"{path}: cannot be read as a scan plan: {error}") from None
        further = [name for name in header["metrics"] if name not in METRICS]
        return cls(
            np.asarray(header["heights"], np.float64),
            pd.DataFrame(header["metrics"], columns=[*METRICS, *further]),
            _regions(header["sections"]) if "sections" in header else None,
        )


def _header(path: str | Path, schema: pa.Schema) -> dict[str, Any]:
    """What stands beside the table of a plan."""
    header: dict[str, Any] = json.loads((schema.metadata or {}).get(b"ebamcheck", b"{}"))
    if header.get("format") != FORMAT:
        raise InputError(f"{path}: is not a scan plan (format {header.get('format')!r}, expected {FORMAT!r})")
    return header


def _to_table(plan: ScanPlan) -> pa.Table:
    """Islands as rows; heights, metrics and settings as metadata."""
    count = len(plan.islands)
    rank = np.empty(count, np.int64)
    rank[plan.order] = np.arange(count)
    # Lines are in scan order; sorted by island (stably) they keep their sequence within it.
    island = plan.vectors["island"].to_numpy()
    by_island = np.argsort(island, kind="stable")
    columns: dict[str, Any] = {
        "layer": plan.island_layer,
        "rank": rank,
        "kind": plan.island_kind.astype(object),
        "polygon": pa.array(list(shapely.to_wkb(plan.islands)), pa.binary()),
        "area_mm2": plan.island_area_mm2,
        "x_mm": plan.island_centroid[:, 0],
        "y_mm": plan.island_centroid[:, 1],
        "wait_s": plan.island_wait_s if len(plan.island_wait_s) else np.zeros(count),
        "inner_wait_s": plan.inner_wait_s if len(plan.inner_wait_s) else np.zeros(count),
    }
    for name in VECTOR_COLUMNS[1:]:
        columns[name] = _nested(plan.vectors[name].to_numpy()[by_island], island, count)
    columns["neighbours"] = _nested(plan.neighbours[:, 1], plan.neighbours[:, 0], count)
    columns["border_mm"] = _nested(plan.border_mm, plan.neighbours[:, 0], count)
    header = {
        "format": FORMAT,
        "heights": plan.heights.tolist(),
        "contours": [shapely.to_wkb(region, hex=True) for region in plan.contours],
        "metrics": {name: plan.metrics[name].tolist() for name in plan.metrics.columns},
        "settings": plan.settings,
    }
    if plan.sections is not None:
        header["sections"] = [shapely.to_wkb(region, hex=True) for region in plan.sections]
    table = pa.table({name: pa.array(c) if isinstance(c, np.ndarray) else c for name, c in columns.items()})
    return table.replace_schema_metadata({"ebamcheck": json.dumps(header, sort_keys=True)})


def _nested(values: NDArray[Any], owner: Ints, count: int) -> pa.ListArray:
    """Values, sorted by owner, as one list an owner."""
    offsets = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=count))]).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values))


def _from_table(table: pa.Table, header: dict[str, Any]) -> ScanPlan:
    columns = {name: table.column(name).combine_chunks() for name in table.column_names}
    plain = {
        n: columns[n].to_numpy(zero_copy_only=False) for n in ("layer", "rank", "area_mm2", "x_mm", "y_mm")
    }
    order = np.argsort(plain["rank"], kind="stable").astype(np.int64)
    vectors = pd.DataFrame({"island": _owners(columns["x0"])})
    for name in VECTOR_COLUMNS[1:]:
        vectors[name] = columns[name].flatten().to_numpy(zero_copy_only=False)
    scanned = np.argsort(plain["rank"][vectors["island"].to_numpy()], kind="stable")
    neighbours = np.column_stack([_owners(columns["neighbours"]), columns["neighbours"].flatten().to_numpy()])
    polygons = np.asarray(shapely.from_wkb(columns["polygon"].to_numpy(zero_copy_only=False)), object)
    metrics = pd.DataFrame(header["metrics"], columns=list(METRICS))
    return ScanPlan(
        heights=np.asarray(header["heights"], np.float64),
        contours=_regions(header["contours"]),
        islands=polygons.reshape(-1),
        island_layer=plain["layer"],
        island_kind=np.asarray(columns["kind"].to_pylist(), np.str_),
        island_area_mm2=plain["area_mm2"],
        island_centroid=np.column_stack([plain["x_mm"], plain["y_mm"]]),
        neighbours=neighbours.astype(np.int64),
        border_mm=columns["border_mm"].flatten().to_numpy(zero_copy_only=False),
        order=order,
        vectors=vectors.iloc[scanned].reset_index(drop=True),
        metrics=metrics,
        settings=header["settings"],
        island_wait_s=_waits(columns, "wait_s"),
        inner_wait_s=_waits(columns, "inner_wait_s"),
        sections=_regions(header["sections"]) if "sections" in header else None,
    )


def _waits(columns: dict[str, Any], name: str) -> Floats:
    """Waits of islands; none in plans of before there were any."""
    return np.asarray(columns[name].to_numpy(zero_copy_only=False) if name in columns else (), np.float64)


def _regions(hexadecimal: list[str]) -> NDArray[np.object_]:
    """Regions of well-known binary in hexadecimal digits."""
    return np.asarray(shapely.from_wkb(np.array(hexadecimal, object)), object).reshape(-1)


def _owners(nested: pa.ListArray) -> Ints:
    """Row of every value of a nested column."""
    sizes = np.diff(nested.offsets.to_numpy())
    return np.repeat(np.arange(len(nested)), sizes).astype(np.int64)
