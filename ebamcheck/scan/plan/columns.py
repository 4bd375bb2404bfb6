"""The plan of a stack: islands, the order in which they are scanned, and every line of the beam."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.metal import Surface
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.filling.turns import follows
from ebamcheck.showing import short_text
from ebamcheck.showing.columns import LayerColumns

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

LINE, CONTOUR = "#555555", "#d55e00"
"""Colours of hatch lines and contour beads."""


def empty_vectors() -> pd.DataFrame:
    """Return a table of no lines, with its columns and types."""
    columns = {name: np.zeros(0, np.float64) for name in VECTOR_COLUMNS}
    return pd.DataFrame({**columns, "island": np.zeros(0, np.int64)})


@dataclass(frozen=True, eq=False, repr=False)
class Island:
    """One island: a region that is filled with parallel lines before the beam goes to the next."""

    plan: ScanPlan
    index: int
    """Number of the island in the plan."""
    rank: int
    """Its place in the order of its layer, from 0."""

    @property
    def layer(self) -> int:
        """Index of its layer."""
        return int(self.plan.island_layer[self.index])

    @property
    def kind(self) -> str:
        """What it is: ``hexagon``, ``square``, ``stripe``, ``whole``, ``thin wall`` or ``gap``."""
        return str(self.plan.island_kind[self.index])

    @property
    def area_mm2(self) -> float:
        """Area."""
        return float(self.plan.island_area_mm2[self.index])

    @property
    def centre_mm(self) -> tuple[float, float]:
        """Centroid, X and Y."""
        x, y = self.plan.island_centroid[self.index].tolist()
        return x, y

    @property
    def polygon(self) -> BaseGeometry:
        """Outline as a shapely polygon."""
        found: BaseGeometry = self.plan.islands[self.index]
        return found

    @property
    def wait_s(self) -> float:
        """Wait before it."""
        waits = self.plan.island_wait_s
        return float(waits[self.index]) if len(waits) else 0.0

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
        return tuple(
            Island(self.plan, island, rank)
            for rank, island in enumerate(self.plan.islands_of(self.index).tolist())
        )

    @property
    def contours(self) -> BaseGeometry:
        """Region whose borders are the centre lines of the contour beads."""
        found: BaseGeometry = self.plan.contours[self.index]
        return found

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

        parts = [
            (i.rank, part)
            for i in self
            for part in shapely.get_parts(i.polygon)
            if part.geom_type == "Polygon"
        ]
        ends = self.plan.vectors_of(self.index)[["x0", "y0", "x1", "y1"]].to_numpy()
        borders = shapely.get_parts(shapely.boundary(self.contours))
        return plot_areas(
            [shapely.get_coordinates(part.exterior) for _, part in parts],
            [rank for rank, _ in parts],
            [
                Lines(list(ends.reshape(-1, 2, 2)), LINE, 0.5),
                Lines([shapely.get_coordinates(border) for border in borders], CONTOUR),
            ],
            f"layer {self.index + 1}, {short_text.counted(len(self), 'island')}",
            ax,
        )

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
        """Write one row a layer, with its islands and lines as list columns; the file appears whole or not at all."""
        from ebamcheck.scan.plan import storage  # which builds on this module

        storage.write(self, Path(path))

    @classmethod
    def from_parquet(cls, path: str | Path) -> ScanPlan:
        """Read a plan back; raises :class:`InputError` where the file is not one."""
        from ebamcheck.scan.plan import storage

        return storage.read(Path(path))


@dataclass(frozen=True, eq=False)
class PlanOfLayers:
    """What a plan knows of its layers, without islands and lines; columns as in :class:`ScanPlan`."""

    heights: Floats
    metrics: pd.DataFrame
    sections: NDArray[np.object_] | None

    @classmethod
    def from_parquet(cls, path: str | Path) -> PlanOfLayers:
        """Read it from the file of a plan; raises :class:`InputError` where the file is not one."""
        from ebamcheck.scan.plan import storage

        return storage.read_layers(Path(path))
