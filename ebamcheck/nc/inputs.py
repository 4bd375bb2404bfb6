"""What a program is made from, as who writes it and who checks it know it: columns of curves, scan plans and tracks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.settings.config import Config

# Kinds of pieces: a polyline through its control points, a clamped cubic B-spline, a circular arc of under half a circle from its first
# to its third control point through its second, which lies half-way.
LINE, SPLINE, ARC = range(3)
DEGREE = 3  # Degree of every spline piece
SHORTEST_BLOCK_MM = 0.05  # A cut nearer to the end of a block is made there: short ones make controls stutter


class CurveColumns(Protocol):
    """The fitted contours of a stack, as :class:`ebamcheck.curves.Curves` holds them."""

    @property
    def heights(self) -> Floats: ...  # (L,) height at which each layer was cut, mm
    @property
    def layer_starts(self) -> Ints: ...  # (L + 1,) first ring of each layer
    @property
    def ring_starts(self) -> Ints: ...  # (R + 1,) first piece of each ring
    @property
    def closed(self) -> Bools: ...  # (R,) false for an open path
    @property
    def kind(self) -> NDArray[np.uint8]: ...  # (P,) :data:`LINE`, :data:`SPLINE` or :data:`ARC`
    @property
    def control_starts(self) -> Ints: ...  # (P + 1,) first control point of each piece
    @property
    def control(self) -> Floats: ...  # (M, 2) control points, mm
    @property
    def knot_starts(self) -> Ints: ...  # (P + 1,) first knot of each piece; lines and arcs have none
    @property
    def knots(self) -> Floats: ...  # (K,) knots, about arc length, mm


class ScanColumns(Protocol):
    """The islands and hatch vectors of a stack, as :class:`ebamcheck.scan.ScanPlan` holds them."""

    @property
    def heights(self) -> Floats: ...  # (L,) height at which each layer was cut, mm
    @property
    def island_layer(self) -> Ints: ...  # (I,) layer of each island
    @property
    def order(self) -> Ints: ...  # (I,) islands in the order in which they are scanned, layer by layer
    @property
    def island_kind(self) -> NDArray[np.str_]: ...  # (I,) kind of each island
    @property
    def sections(self) -> NDArray[np.object_] | None: ...  # (L,) regions to be metal; None: not known
    @property
    def vectors(self) -> Any: ...  # Columns `island`, `x0`, `y0`, `x1`, `y1` (V,) in scan order


class TrackColumns(Protocol):
    """Tracks laid out of curves and plan, as :class:`ebamcheck.writing.tracks.Toolpath` holds them."""

    @property
    def z(self) -> Floats: ...  # (L,) tops of the layers
    @property
    def thickness(self) -> Floats: ...  # (L,) height of each layer, mm
    @property
    def layer_starts(self) -> Ints: ...  # (L + 1,) first track of each layer
    @property
    def track_starts(self) -> Ints: ...  # (T + 1,) first segment of each track
    @property
    def start(self) -> Floats: ...  # (T, 2) where each track starts
    @property
    def ring(self) -> Ints: ...  # (T,) number of the contour ring; -1 for hatch
    @property
    def island(self) -> Ints: ...  # (T,) number of the island; -1 for a contour
    @property
    def segment_start(self) -> Floats: ...  # (N, 2) start of each segment
    @property
    def end(self) -> Floats: ...  # (N, 2) end of each segment
    @property
    def lengths(self) -> Floats: ...  # (N,) length of each segment, mm
    @property
    def turn(self) -> Bools: ...  # (N,) a turn between two hatch lines
    @property
    def goes_on(self) -> Bools: ...  # (N,) a further part of the hatch line before
    @property
    def width(self) -> Floats: ...  # (N,) metal that is laid, in section over the height of the layer, mm


def hatch_columns(plan: ScanColumns) -> tuple[Ints, Floats]:
    """Island (V,) and end points x0, y0, x1, y1 (V, 4) of the hatch vectors, in scan order."""
    vectors = plan.vectors
    island = np.asarray(vectors.island, dtype=np.int64)
    ends = [np.asarray(getattr(vectors, name), dtype=np.float64) for name in ("x0", "y0", "x1", "y1")]
    return island, np.column_stack(ends) if island.size else np.zeros((0, 4))


@dataclass(frozen=True, eq=False)
class Interpass:
    """Waits and power of a stack."""

    wait_s: Floats  # (L,) wait before each layer, and before each further contour of it
    ring_wait_s: Floats
    island_wait_s: Floats  # (I,) wait before each island, and before each further bead of it
    inner_wait_s: Floats
    power_share: Floats  # (L,) share of the beam's power

    def before_layer_s(self, layer: int) -> float:
        """Wait before a layer; 0 for the one after the last."""
        return float(self.wait_s[layer]) if layer < len(self.wait_s) else 0.0


def interpass_of(plan: ScanColumns, config: Config) -> Interpass:
    """Waits and power of a plan; where it has none, the pause of the settings between layers, and full power."""
    layers, islands = len(plan.heights), len(plan.island_layer)
    pause_s = np.where(np.arange(layers) > 0, config.process.layer_pause_s, 0.0)
    metrics = getattr(plan, "metrics", {})

    def column(name: str, otherwise: ArrayLike) -> Floats:
        found = np.asarray(metrics[name], np.float64) if name in metrics else np.full(layers, np.nan)
        return np.asarray(np.where(np.isnan(found), otherwise, found), np.float64)

    def of_islands(name: str) -> Floats:
        waits = np.asarray(getattr(plan, name, ()), np.float64)
        return waits if waits.size == islands else np.zeros(islands)

    return Interpass(
        wait_s=column("wait_s", pause_s),
        ring_wait_s=column("ring_wait_s", 0.0),
        island_wait_s=of_islands("island_wait_s"),
        inner_wait_s=of_islands("inner_wait_s"),
        power_share=column("power_share", 1.0),
    )


def check_same_stack(curves: CurveColumns, plan: ScanColumns) -> None:
    """Refuse curves and a plan of different layers."""
    if len(curves.heights) != len(plan.heights) or not np.array_equal(curves.heights, plan.heights):
        raise SettingsError(
            f"curves of {len(curves.heights)} layers and a scan plan of {len(plan.heights)} layers differ in "
            "their heights: make both from the same stack"
        )


def deposition_heights(heights: Floats, first_layer_mm: float, base_mm: float = 0.0) -> Floats:
    """Z of each layer in the work offset, (L,) mm: the top of the layer, Z 0 under the part's lowest point. `heights` (L,) are
    those of the cuts, in the middle of the layers; the first layer, on `base_mm`, is as high as the step to the second, or
    `first_layer_mm` where there is none."""
    if not len(heights):
        return np.zeros(0)
    first = float(heights[1] - heights[0]) if len(heights) > 1 else first_layer_mm
    return np.asarray(heights - heights[0] + first + base_mm, dtype=np.float64)


def layer_thickness(deposition: Floats, base_mm: float) -> Floats:
    """Height of each layer, (L,) mm, from the tops of the layers and the Z of what the lowest lies on."""
    return np.diff(deposition, prepend=base_mm)
