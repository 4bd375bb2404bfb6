"""Settings of partition, filling and order."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import field_validator

from ebamcheck.installed import entry_points
from ebamcheck.settings.base import Angle, Between, Length, Section, Share

ORDERS = "ebamcheck.orders"
"""Entry point group of scan orders."""


def order_names() -> list[str]:
    """Names of the scan orders that are installed, sorted; none is loaded."""
    return sorted({point.name for point in entry_points(group=ORDERS)})


class ScanSettings(Section):
    """Partition, filling and order."""

    partition: Literal["hexagons", "squares", "stripes", "whole"] = "hexagons"
    """Islands of a layer: hexagons (the paper), squares (a chessboard) or stripes of their width, or solids undivided."""
    hexagon_side_mm: Annotated[float, Between(0.5, 1000.0)] | None = None
    """Side of the hexagons; None: planned from layer area, wall thickness and bead width. Squares and stripes are as
    wide as these hexagons."""
    rectangle: Literal["paper", "exact"] = "exact"
    """Enclosing rectangle: rotations in steps of pi/10 (paper, equation 11), or the exact minimum."""
    lattice_angle_deg: Angle = 37.0
    """Turn of the cells from layer to layer, so that their borders do not lie over each other: near 60 times the golden
    section, which keeps the hexagons of any few layers apart. The lowest layer lies as in the paper; 0: all do."""
    lattice_shift: bool = True
    """Shift the cells from layer to layer, too, each time by another share of a cell."""
    first_angle_deg: Angle = 0.0
    """Direction of the hatch in the lowest layer, counter-clockwise from +X."""
    layer_angle_deg: Angle = 15.0
    """Turn of the hatch from layer to layer (paper, section 1, after Jia et al.)."""
    island_angle_deg: Angle = 60.0
    """Turn of the hatch from island to island, by one of three colours of hexagons (two of squares and stripes). Islands
    that touch all the same with one colour take another multiple, or one halfway between, so that neighbours differ by
    15 degrees at least (a quarter of this angle, where that is less); but two that are narrower than the spacing, each
    of which is filled along its long side. 0: all islands of a layer have one direction."""
    order: str = "thermal"
    """Scan order of the islands of a layer: thermal (coolest first by a heat model, at a price on travel), nearest
    (the paper's rule, section 4.2; nearest-any by its full name), nearest-last, nearest-sum, farthest, raster,
    stride, random, least-heat, or one that is installed."""
    seed: Annotated[int, Between(0, 2**32 - 1)] = 0
    """Seed of all random choices: each layer's first island, the order `random`, the annealing of `thermal`."""
    stride: Annotated[int, Between(2, 1_000_000)] = 7
    """The order `stride` takes every so many islands of the raster."""
    travel_share: Annotated[float, Between(0.001, 100.0)] = 0.5
    """The order `thermal` travels at most this share of what `farthest` does; more only where an island would else follow
    one that it touches."""
    start_travel_mm: Length = 10.0
    """Travel that weighs as much as one start of the wire, for `thermal`."""
    annealing_steps: Annotated[int, Between(0, 10_000_000)] = 40000
    """Moves of islands that `thermal` tries at the end, keeping those that help: at most 800 an island and 30,000, none over 500 islands."""
    carry_heat: bool = True
    """Orders by heat begin each layer with what those under it have left; off: each layer on a cold part."""
    least_coverage: Share = 0.98
    """Gate of the coverage: fraction of each layer's area that the beads must cover."""
    gap_width: Annotated[float, Between(0.001, 10.0)] = 0.2
    """Bare spots this wide, over the bead width, get a bead of their own; narrower ones (corners of 90 degrees: 0.17)
    only while a layer is covered less than least_coverage, for every bead is a start of the wire."""
    contour_offset_mm: Annotated[float, Between(0.0, 100.0)] | None = None
    """Inset of the contour bead's centre line from the contour; None: half a bead width."""

    @field_validator("order")
    @classmethod
    def _known_order(cls, value: str) -> str:
        if value not in (known := order_names()):
            raise ValueError(f"unknown order: choose one of {', '.join(known)}")
        return value
