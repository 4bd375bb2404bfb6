"""``section_multiplane`` of trimesh behind the slicer protocol."""

from __future__ import annotations

import math
from importlib.metadata import PackageNotFoundError, version
from typing import Any, ClassVar, Self

import numpy as np

from ebamcheck.backend import BackendSettings, CoplanarRule, Probe, Progress, labels_of
from ebamcheck.errors import BackendFailed
from ebamcheck.geometry.rings import EPSILON
from ebamcheck.kernels import Bools, Floats
from ebamcheck.layers.even_odd import INSIDE_RULE, directed_by_nesting
from ebamcheck.layers.stack import Layers, from_paths
from ebamcheck.mesh.part import Part

# Distance within which trimesh merges vertices, and takes a vertex as on the plane (`tol.merge`), in working units
MERGE = 1e-8
# Parts are scaled to a size between 2**9 and 2**10, against which `MERGE` is negligible
WORKING_SIZE_EXPONENT = 10
ALONG = 100.0  # rings touch along a line, not in a point, from so many error bounds of it on
BLOCK = 64  # layers that trimesh cuts at a time, to report progress and bound memory


class TrimeshSettings(BackendSettings):
    """trimesh has no settings: a cut is exact."""


class TrimeshSections:
    """Exact cut by trimesh: paths have no direction, so parts whose shells cross or touch along a line are refused."""

    name: ClassVar[str] = "trimesh"
    summary: ClassVar[str] = (
        "witness: exact plane cut by trimesh (section_multiplane), slow; no crossing or touching shells"
    )
    exact: ClassVar[bool] = True
    priority: ClassVar[int] = -10
    coplanar_rule: ClassVar[CoplanarRule] = "undefined"
    inside_rule: ClassVar[str] = INSIDE_RULE
    Settings: ClassVar[type[BackendSettings]] = TrimeshSettings

    def probe(self) -> Probe:
        """Whether trimesh is installed; it is not imported, which takes half a second."""
        try:
            found = version("trimesh")
        except PackageNotFoundError as error:
            return Probe(False, why=f"trimesh is not installed: {error}", hint="pip install trimesh")
        return Probe(True, versions={"trimesh": found})

    def error_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the error by merging of points plus the rounding of coordinates, mm."""
        largest = float(np.abs(part.bounds).max())
        return 2.0 * MERGE / _scale(part) + 4.0 * EPSILON * largest

    def height_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the distance at which trimesh takes a vertex as on the plane, plus the rounding, mm."""
        largest = float(np.abs(part.bounds).max())
        return MERGE / _scale(part) + 4.0 * EPSILON * largest

    def prepare(self, part: Part, settings: BackendSettings) -> PreparedSections:
        """Place the part at the origin, at a size at which trimesh loses no digits."""
        return PreparedSections(part, settings)


def _scale(part: Part) -> float:
    """Power of two by which the part is scaled once its least corner is at the origin."""
    size = float(part.size.max())
    exponent = WORKING_SIZE_EXPONENT - math.frexp(size)[1] if size > 0.0 else 0
    return math.ldexp(1.0, max(-200, min(200, exponent)))


class PreparedSections:
    """A part as a trimesh mesh, ready to be cut."""

    def __init__(self, part: Part, settings: BackendSettings) -> None:
        import trimesh

        self.part = part
        self._corner_mm, self._scale = part.bounds[0], _scale(part)
        self._settings = settings
        vertices = (part.vertices - self._corner_mm) * self._scale
        self._mesh: Any = trimesh.Trimesh(vertices, part.faces, process=False, validate=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._mesh = None

    def slice(self, heights: Floats, progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), mm; one thread."""
        if self._mesh is None:
            raise BackendFailed(f"trimesh: part {self.part.name!r} was released: prepare it again")
        least, greatest = self.part.bounds[:, 2]
        within = (least < heights) & (heights < greatest)
        paths: list[list[tuple[Floats, bool]]] = []
        for first in range(0, heights.size, BLOCK):
            block = slice(first, min(first + BLOCK, heights.size))
            paths += self._paths(heights[block], within[block])
            if progress is not None:
                progress(block.stop - first)
        labels = labels_of(self.part, TrimeshSections.name, self._settings.model_dump())
        raw = from_paths(heights, paths, **labels)
        bound_mm = TrimeshSections().error_bound_mm(self.part, self._settings)
        _refuse_touching(raw, bound_mm)
        return directed_by_nesting(raw, bound_mm, TrimeshSections.name)

    def _paths(self, heights: Floats, within: Bools) -> list[list[tuple[Floats, bool]]]:
        """Paths of each layer, mm, and whether each is closed: such a one repeats its first point at the end."""
        paths: list[list[tuple[Floats, bool]]] = [[] for _ in range(heights.size)]
        if not within.any():
            return paths
        planes = (heights[within] - self._corner_mm[2]) * self._scale
        sections = self._mesh.section_multiplane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], planes)
        for k, section in zip(np.flatnonzero(within), sections, strict=True):
            if section is None:
                continue
            matrix = np.asarray(section.metadata["to_3D"])
            loose = [section.entities[e].discrete(section.vertices) for e in section.dangling]
            for points in [*section.discrete, *loose]:
                placed = np.asarray(points, np.float64) @ matrix[:2, :2].T + matrix[:2, 3]
                placed = placed / self._scale + self._corner_mm[:2]
                paths[k].append((placed, bool((placed[0] == placed[-1]).all())))
        return paths


def _refuse_touching(layers: Layers, reach_mm: float) -> None:
    """Raise :class:`BackendFailed` where paths of a layer touch along a line, or one itself: there trimesh joins any two
    segments."""
    import shapely

    for k in range(len(layers)):
        lines = (shapely.LineString, shapely.LinearRing)
        made = [lines[int(layers.closed[r])](layers.ring(r)) for r in layers.rings_of(k)]
        paths = np.array(made, dtype=object)
        first, second = shapely.STRtree(paths).query(paths, predicate="dwithin", distance=reach_mm)
        one, other = (paths[rows[first < second]] for rows in (first, second))
        along = shapely.length(shapely.intersection(shapely.buffer(one, 2.0 * reach_mm), other))
        if (along > ALONG * reach_mm).any() or not shapely.is_simple(paths).all():
            raise BackendFailed(
                f"{TrimeshSections.name}: rings touch at z = {layers.heights[k]:.9g} mm, where bodies of the part touch, and it "
                "does not tell whose segments are whose; unite the bodies or use another backend"
            )
