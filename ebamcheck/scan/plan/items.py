"""A scan plan, one layer and one island at a time: small values to look at, iterate over and draw."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.layers.items import index_of
from ebamcheck.showing import short_text

if TYPE_CHECKING:
    from ebamcheck.scan.plan.columns import ScanPlan

LINE, CONTOUR = "#555555", "#d55e00"
"""Colours of hatch lines and contour beads."""


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
        """Figures of the layer, by the names of :data:`ebamcheck.scan.plan.columns.METRICS`."""
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


# -- what ScanPlan itself gets of them ---------------------------------------------------------------


def plan_iterator(plan: ScanPlan) -> Iterator[PlannedLayer]:
    """Go through the layers, from the bottom up."""
    return (PlannedLayer(plan, k) for k in range(len(plan)))


def plan_item(plan: ScanPlan, which: int) -> PlannedLayer:
    """One layer by its index; a negative one counts from the top."""
    return PlannedLayer(plan, index_of(which, len(plan)))


def plan_line(plan: ScanPlan) -> str:
    """Write a plan as one line."""
    return short_text.line(
        "ScanPlan",
        short_text.counted(len(plan), "layer"),
        short_text.heights(plan.heights),
        short_text.counted(len(plan.islands), "island"),
        short_text.counted(len(plan.vectors), "line"),
        str(plan.settings.get("order", "")),
    )


def plan_html(plan: ScanPlan) -> str:
    """Show a plan in a notebook."""
    facts = {
        "layers": len(plan),
        "heights": short_text.heights(plan.heights),
        "islands": len(plan.islands),
        "lines": len(plan.vectors),
        "order": plan.settings.get("order", "not named"),
    }
    return short_text.html("ScanPlan", facts)


def plan_plot(plan: ScanPlan, layer: int, ax: Any = None) -> Any:
    """Draw one layer of the plan on matplotlib axes."""
    return plan_item(plan, layer).plot(ax)
