"""The plane cut of manifold3d behind the slicer protocol."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from types import TracebackType
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import BackendSettings, CoplanarRule, Probe, Progress
from ebamcheck.errors import BackendFailed
from ebamcheck.layers.stack import Layers, canonical, stacked
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import edge_groups, split_corners, twins
from ebamcheck_manifold.changes import Floats, Placement, doubtful_regions, exact_placement

if TYPE_CHECKING:
    from manifold3d import Manifold

# Resolution of a cross-section's coordinates, in working units: manifold3d keeps eight decimals
CONTOUR_ROUNDING = 1e-8
MERGE_TOLERANCE = 1e-12  # distance within which manifold3d merges vertices, over the largest coordinate

LAYERS_AT_ONCE = 64
"""Layers whose rings are brought into canonical form together: their points stay in the processor's cache, and
little memory is needed beyond the layers themselves."""


class ManifoldSettings(BackendSettings):
    """manifold3d has no settings: a cut is exact."""


class ManifoldCut:
    """Exact cut by manifold3d, only of meshes whose facets pair up at every edge.

    manifold3d returns the regions of positive winding number of every cut, so overlapping shells unite and a body that is
    inside out has no section.
    """

    name: ClassVar[str] = "manifold"
    summary: ClassVar[str] = (
        "exact plane cut by manifold3d, double precision; refuses meshes whose facets do not pair up at every edge"
    )
    exact: ClassVar[bool] = True
    priority: ClassVar[int] = 50
    coplanar_rule: ClassVar[CoplanarRule] = "half-open"
    inside_rule: ClassVar[str] = "winding > 0"
    Settings: ClassVar[type[BackendSettings]] = ManifoldSettings

    def probe(self) -> Probe:
        """Whether manifold3d can be imported."""
        try:
            import manifold3d  # noqa: F401

            found = version("manifold3d")
        except (ImportError, OSError, PackageNotFoundError) as error:
            return Probe(False, why=f"manifold3d cannot be imported: {error}", hint="pip install manifold3d")
        return Probe(True, versions={"manifold3d": found})

    def error_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the rounding of contours, of merged vertices and of the coordinates themselves, mm.

        Twice each: a corner of a union is the rounded crossing of two rounded edges.
        """
        largest = float(np.abs(part.bounds).max())
        rounding = CONTOUR_ROUNDING / exact_placement(part).scale
        return 2.0 * (rounding + MERGE_TOLERANCE * _reach_mm(part) + np.finfo(np.float64).eps * largest)

    def height_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return how far manifold3d may move a vertex by merging, mm; the heights of planes are exact."""
        return 2.0 * MERGE_TOLERANCE * _reach_mm(part)

    def prepare(self, part: Part, settings: BackendSettings) -> PreparedManifold:
        """Build the manifold."""
        return PreparedManifold(part, exact_placement(part), settings)


class PreparedManifold:
    """A manifold to be cut any number of times; its layers declare where it differs from the mesh given."""

    def __init__(self, part: Part, placement: Placement, settings: BackendSettings) -> None:
        self.part = part
        self.placement = placement
        self._manifold: Manifold | None = build(part, placement)
        faces = _facets_with_three_vertices(part.faces)
        changed = doubtful_regions(part.vertices, faces, placement, self._manifold)
        self._labels = {**settings.model_dump(), **({"doubtful_regions": changed} if changed else {})}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._manifold = None

    def slice(self, heights: NDArray[np.float64], progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), mm, on one thread: manifold3d holds the interpreter lock."""
        if self._manifold is None:
            raise BackendFailed(f"manifold: part {self.part.name!r} was released: prepare it again")
        heights = np.ascontiguousarray(heights, dtype=np.float64)
        return stacked(self._blocks(self._manifold, heights, progress))

    def _blocks(self, manifold: Manifold, heights: Floats, progress: Progress | None) -> Iterator[Layers]:
        """Layers of a few heights at a time."""
        for first in range(0, max(1, len(heights)), LAYERS_AT_ONCE):
            block = self._layers(manifold, heights[first : first + LAYERS_AT_ONCE])
            yield block
            if progress is not None:
                progress(len(block))

    def _layers(self, manifold: Manifold, heights: Floats) -> Layers:
        """Cut at a few heights."""
        least, greatest = self.part.bounds[:, 2]
        found: list[Floats] = []
        layer_starts = np.zeros(len(heights) + 1, np.int64)
        for k, z_mm in enumerate(heights.tolist()):
            if least <= z_mm < greatest:
                section = manifold.slice(self.placement.height(z_mm))
                found.extend(section.to_polygons())
            layer_starts[k + 1] = len(found)
        sizes = np.fromiter(map(len, found), np.int64, len(found))
        return canonical(
            heights,
            self.placement.undo(np.concatenate([np.zeros((0, 2)), *found])),
            np.concatenate([[0], np.cumsum(sizes)]),
            layer_starts,
            np.ones(len(found), np.bool_),
            part=self.part.sha256,
            direction=self.part.direction,
            backend=ManifoldCut.name,
            settings=dict(self._labels),
        )


def build(part: Part, placement: Placement) -> Manifold:
    """Build the manifold of a part; raises :class:`BackendFailed` if manifold3d refuses it."""
    from manifold3d import Error, Manifold, Mesh64

    vertices, faces = _with_bodies_apart(part.vertices, _facets_with_three_vertices(part.faces))
    mesh = Mesh64(placement.apply(vertices), np.ascontiguousarray(faces, dtype=np.uint64))
    manifold = Manifold(mesh)
    status = manifold.status()
    if status != Error.NoError:
        unpaired = unpaired_edges(faces)
        where = f": at {unpaired} edges the facets do not pair" if unpaired else ""
        raise BackendFailed(
            f"manifold: part {part.name!r} ({len(part.faces)} facets) is refused, status {status.name}{where}; "
            "mend the mesh or slice it with another backend"
        )
    return manifold


def _with_bodies_apart(
    vertices: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Give bodies that touch along an edge separate vertices; a mesh without such edges stays as it is.

    Otherwise manifold3d pairs the four facets at such an edge in its own way, and may cut another body than the one given.
    """
    groups = edge_groups(faces, len(vertices))
    sizes = np.diff(groups.starts)
    if not (sizes > 2).any() or (sizes % 2).any():
        return vertices, faces
    corners = split_corners(faces, twins(vertices, faces, groups.half_edges, groups.starts))
    source = np.empty(int(corners.max()) + 1, np.int32)
    source[corners.ravel()] = faces.ravel()
    return vertices[source], corners


def unpaired_edges(faces: NDArray[np.int32]) -> int:
    """Number of edges along which facets run more often in one direction than in the other."""
    start, end = faces.ravel().astype(np.int64), np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    low, high = np.minimum(start, end), np.maximum(start, end)
    _, edge = np.unique(low * (int(high.max(initial=0)) + 1) + high, return_inverse=True)
    return int(np.count_nonzero(np.bincount(edge, np.where(start < end, 1.0, -1.0))))


def _facets_with_three_vertices(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Leave out facets that repeat a vertex: they have no section, and manifold3d would refuse them."""
    a, b, c = faces.T
    kept = (a != b) & (b != c) & (c != a)
    return faces if kept.all() else faces[kept]


def _reach_mm(part: Part) -> float:
    """Largest coordinate as manifold3d gets it, in mm."""
    return float(np.abs(part.bounds - exact_placement(part).shift_mm).max())
