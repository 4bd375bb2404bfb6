"""An example of a slicer: it looks along rows, and makes each solid span as thick as a row.

A row at y stands for all points within half a pitch of it. Where such a point is put on the wrong side, the
point of the row beside it is on the right one, so a contour runs between the two: half a pitch is the bound.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
import shapely
from pydantic import Field

from ebamcheck.backend import BackendSettings, CoplanarRule, Prepared, Probe, Progress
from ebamcheck.errors import BackendFailed
from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.mesh.part import Part


class RowSettings(BackendSettings):
    pitch_mm: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 0.15
    """Distance of the rows."""


class Rows:
    """Crossings of rows with the cut facets, each span as thick as a row."""

    name: ClassVar[str] = "rows"
    summary: ClassVar[str] = "example plugin: spans along rows"
    exact: ClassVar[bool] = False
    priority: ClassVar[int] = 0
    coplanar_rule: ClassVar[CoplanarRule] = "half-open"
    inside_rule: ClassVar[str] = "winding > 0"
    Settings: ClassVar[type[BackendSettings]] = RowSettings

    def probe(self) -> Probe:
        return Probe(True, versions={"shapely": shapely.__version__})

    def error_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        rounding_mm = 1e-12 * float(np.abs(part.bounds).max())
        return 0.5 * RowSettings.model_validate(settings.model_dump()).pitch_mm + rounding_mm

    def height_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        return 0.0

    def prepare(self, part: Part, settings: BackendSettings) -> Prepared:
        edges = part.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        if not np.array_equal(_sorted(edges), _sorted(edges[:, ::-1])):
            raise BackendFailed(f"rows: part {part.name!r} is open: mend it or take another backend")
        return PreparedRows(part, RowSettings.model_validate(settings.model_dump()))


class PreparedRows:
    def __init__(self, part: Part, settings: RowSettings) -> None:
        self.part, self.settings = part, settings

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace) -> None:
        pass

    def slice(self, heights: np.ndarray, progress: Progress | None = None) -> Layers:
        layers = []
        for height in heights.tolist():
            layers.append([self._region(height)])
            if progress is not None:
                progress(1)
        return from_polygons(
            heights, layers, part=self.part.sha256, direction=self.part.direction, backend=Rows.name,
            settings=self.settings.model_dump(),
        )  # fmt: skip

    def _region(self, height: float) -> shapely.Geometry:
        start, end = _cut(self.part.triangles, height)
        pitch, bottom = self.settings.pitch_mm, self.part.bounds[0, 1]
        spans = []
        for row in range(int(np.ceil(self.part.size[1] / pitch))):
            y = bottom + (row + 0.5) * pitch
            rising, falling = (start[:, 1] <= y) & (end[:, 1] > y), (end[:, 1] <= y) & (start[:, 1] > y)
            met = rising | falling
            t = (y - start[met, 1]) / (end[met, 1] - start[met, 1])
            x = start[met, 0] + t * (end[met, 0] - start[met, 0])
            order = np.argsort(x, kind="stable")
            # A segment that falls has the solid on its right: there the winding number goes up.
            winding = np.cumsum(np.where(falling[met], 1, -1)[order])
            x = x[order]
            solid = np.flatnonzero(winding[:-1] > 0)
            low, high = bottom + row * pitch, bottom + (row + 1) * pitch
            spans.append(shapely.box(x[solid], low, x[solid + 1], high))
        return shapely.union_all(np.concatenate(spans)) if spans else shapely.Polygon()


def _sorted(edges: np.ndarray) -> np.ndarray:
    return edges[np.lexsort(edges.T)]


def _cut(triangles: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Ends (S, 2) of the segments of the plane z = height + 0, the solid on their left."""
    above = triangles[:, :, 2] > height
    crossing = above.any(axis=1) & ~above.all(axis=1)
    triangles, above = triangles[crossing], above[crossing]
    ends = np.zeros((2, len(triangles), 2))
    for i, j in ((0, 1), (1, 2), (2, 0)):
        for upward, tail_above in ((1, False), (0, True)):
            rows = (above[:, i] == tail_above) & (above[:, j] != tail_above)
            a, b = triangles[rows, i], triangles[rows, j]
            t = (height - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
            ends[upward, rows] = a[:, :2] + t * (b[:, :2] - a[:, :2])
    return ends[0], ends[1]
