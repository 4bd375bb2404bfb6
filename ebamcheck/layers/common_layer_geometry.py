"""Layers and polylines of a Common Layer Interface slice file, gathered command by command."""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError
from ebamcheck.layers.common_layer_header import Header, place_error
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.numeric.rings import Floats, signed_areas

log = logging.getLogger(__name__)

INTERNAL, EXTERNAL, OPEN_LINE = 0, 1, 2
"""Directions of a polyline: clockwise (hole), counter-clockwise (outer), open."""


class Gathered:
    """Layers and polylines as they come out of a file."""

    def __init__(self, path: Path, data: bytes, header: Header) -> None:
        self.path = path
        self.data = data
        self.header = header
        self.commands = 0
        self.heights: list[float] = []
        self.hatches: list[int] = []
        self._layer_starts: list[int] = []
        self._points: list[Floats] = []
        self._directions: list[int] = []

    def layer(self, height: float, offset: int) -> None:
        """Begin a layer, or continue the previous one if the height is the same."""
        height *= self.header.units_mm
        self.commands += 1
        if not math.isfinite(height):
            raise self.error(offset, f"layer height {height} is not a finite number")
        if self.heights and height == self.heights[-1]:
            return
        if self.heights and height < self.heights[-1]:
            raise self.error(
                offset, f"layer at {height} mm lies below the one before, at {self.heights[-1]} mm"
            )
        self.heights.append(height)
        self.hatches.append(0)
        self._layer_starts.append(len(self._points))

    def polyline(self, direction: int, coordinates: NDArray[np.floating[Any]], offset: int) -> None:
        """Add a polyline to the layer; coordinates are x, y, x, y .. in units of the file."""
        self._check("polyline", coordinates, offset)
        if direction not in (INTERNAL, EXTERNAL, OPEN_LINE):
            raise self.error(
                offset, f"polyline of direction {direction}: it is 0 (internal), 1 (external) or 2 (open)"
            )
        self._points.append(coordinates.astype(np.float64).reshape(-1, 2) * self.header.units_mm)
        self._directions.append(direction)

    def hatch_lines(self, coordinates: NDArray[np.floating[Any]], offset: int) -> None:
        """Count hatch lines; coordinates are x, y of the start, x, y of the end .."""
        self._check("hatches", coordinates, offset)
        self.hatches[-1] += coordinates.size // 4

    @property
    def polylines(self) -> int:
        """Number of polylines so far."""
        return len(self._points)

    def layers(self) -> Layers:
        """Everything gathered, in canonical form."""
        directions = np.asarray(self._directions, dtype=np.int64)
        closed = directions != OPEN_LINE
        ring_starts = np.cumsum([0] + [len(p) for p in self._points]).astype(np.int64)
        points = np.concatenate(self._points) if self._points else np.zeros((0, 2))
        declared = np.where(directions == EXTERNAL, 1.0, -1.0)
        turned = np.flatnonzero(signed_areas(points, ring_starts, closed) * declared < 0.0)
        for r in turned:
            points[ring_starts[r] : ring_starts[r + 1]] = self._points[r][::-1]
        if turned.size:
            log.warning(
                "%s: %d of %d polylines run against their declared direction and were turned (first: %d)",
                self.path, turned.size, len(directions), turned[0],
            )  # fmt: skip
        layer_starts = np.asarray([*self._layer_starts, len(self._points)], dtype=np.int64)
        return canonical(
            np.asarray(self.heights), points, ring_starts, layer_starts, closed, **self.header.labels
        )

    def error(self, offset: int, message: str) -> InputError:
        """Make an error that names the line, or in binary data the byte."""
        return place_error(self.path, self.data, offset, message, binary=self.header.binary)

    def _check(self, what: str, coordinates: NDArray[np.floating[Any]], offset: int) -> None:
        if not self.heights:
            raise self.error(offset, f"{what} before the first layer")
        if not np.isfinite(coordinates).all():
            k = int(np.flatnonzero(~np.isfinite(coordinates))[0])
            raise self.error(offset, f"coordinate {k} of {what} is {coordinates[k]}: it must be finite")
