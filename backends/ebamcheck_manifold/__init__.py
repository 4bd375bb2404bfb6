"""The plane cut of manifold3d, and where the solid that it builds differs from the mesh that it was given.

manifold3d swaps the common edge of two facets, and leaves out facets without area and facets back to back, without a word.
Sections there may be wrong by far more than rounding, so the places are declared as doubtful.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import BackendSettings, CoplanarRule, Probe, Progress, installed, labels_of
from ebamcheck.errors import BackendFailed
from ebamcheck.kernels import Bools, Floats, ShortInts
from ebamcheck.layers.stack import Layers, canonical, stacked
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import components, direction_balance, edge_groups, split_corners, twins

if TYPE_CHECKING:
    from manifold3d import Manifold

CONTOUR_ROUNDING = 1e-8  # resolution of a cross-section's coordinates, in working units: eight decimals
MERGE_TOLERANCE = 1e-12  # distance within which manifold3d merges vertices, over the largest coordinate
LAYERS_AT_ONCE = 64  # layers brought into canonical form together: their points stay in the processor's cache


class ManifoldSettings(BackendSettings):
    """manifold3d has no settings: a cut is exact."""


class ManifoldCut:
    """Exact cut by manifold3d, only of meshes whose facets pair up at every edge; a body that is inside out has no section."""

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
        return installed("manifold3d", "manifold3d")

    def error_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the rounding of contours, of merged vertices and of the coordinates themselves, mm."""
        # Twice each: a corner of a union is the rounded crossing of two rounded edges.
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
        declared = {"doubtful_regions": changed} if changed else {}
        self._labels = labels_of(part, ManifoldCut.name, {**settings.model_dump(), **declared})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._manifold = None

    def slice(self, heights: Floats, progress: Progress | None = None) -> Layers:
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
            **self._labels,
        )


def build(part: Part, placement: Placement) -> Manifold:
    """Build the manifold of a part; raises :class:`BackendFailed` if manifold3d refuses it."""
    from manifold3d import Error, Manifold, Mesh64

    vertices, faces = _with_bodies_apart(part.vertices, _facets_with_three_vertices(part.faces))
    mesh = Mesh64(placement.apply(vertices), np.ascontiguousarray(faces, dtype=np.uint64))
    manifold = Manifold(mesh)
    status = manifold.status()
    if status != Error.NoError:
        unpaired = np.count_nonzero(direction_balance(faces, edge_groups(faces, len(vertices))))
        where = f": at {unpaired} edges the facets do not pair" if unpaired else ""
        raise BackendFailed(
            f"manifold: part {part.name!r} ({len(part.faces)} facets) is refused, status {status.name}{where}; "
            "mend the mesh or slice it with another backend"
        )
    return manifold


def _with_bodies_apart(vertices: Floats, faces: ShortInts) -> tuple[Floats, ShortInts]:
    """Give bodies that touch along an edge separate vertices, or manifold3d pairs the four facets there in its own way."""
    groups = edge_groups(faces, len(vertices))
    sizes = np.diff(groups.starts)
    if not (sizes > 2).any() or (sizes % 2).any():
        return vertices, faces
    corners = split_corners(faces, twins(vertices, faces, groups.half_edges, groups.starts))
    source = np.empty(int(corners.max()) + 1, np.int32)
    source[corners.ravel()] = faces.ravel()
    return vertices[source], corners


def _facets_with_three_vertices(faces: ShortInts) -> ShortInts:
    """Leave out facets that repeat a vertex: they have no section, and manifold3d would refuse them."""
    a, b, c = faces.T
    kept = (a != b) & (b != c) & (c != a)
    return faces if kept.all() else faces[kept]


def _reach_mm(part: Part) -> float:
    """Largest coordinate as manifold3d gets it, in mm."""
    return float(np.abs(part.bounds - exact_placement(part).shift_mm).max())


MOST_REGIONS = 16  # most boxes declared; further ones are merged with their neighbours in height
# Least horizontal part of a group's unit normal: sections of a flatter group may move too far to be bounded
LEAST_SLOPE = 0.05

Keys = NDArray[np.uint64]


def doubtful_regions(
    vertices_mm: Floats, faces: ShortInts, placement: Placement, manifold: Manifold
) -> list[dict[str, Any]]:
    """Boxes in the part around the facets that manifold3d changed, as :meth:`ebamcheck.backend.Prepared.slice` declares them."""
    mesh = manifold.to_mesh64()
    held, held_faces = np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts)
    given_keys = _facet_keys(_vertex_keys(placement.apply(vertices_mm)), faces)
    held_keys = _facet_keys(_vertex_keys(held), held_faces)
    if _totals(given_keys) == _totals(held_keys):
        return []
    lost, gained = ~np.isin(given_keys, held_keys), ~np.isin(held_keys, given_keys)
    if not (lost.any() or gained.any()):
        return []
    lost_mm = vertices_mm[faces[lost]]
    gained_mm = held[held_faces[gained].astype(np.int64)] / placement.scale + placement.shift_mm
    old = np.arange(len(lost_mm) + len(gained_mm)) < len(lost_mm)
    return _boxes(np.concatenate([lost_mm, gained_mm]), old)


def _totals(keys: Keys) -> tuple[int, int, int]:
    """Count, sum and parity of keys: the same for equal sets in any order, and for hardly any others."""
    return keys.size, int(keys.sum(dtype=np.uint64)), int(np.bitwise_xor.reduce(keys))


def _vertex_keys(vertices: Floats) -> Keys:
    """Key of each vertex (V,): the bits of its coordinates, spread by the finalizer of MurmurHash3 (public domain)."""
    x, y, z = np.ascontiguousarray(vertices + 0.0).view(np.uint64).T  # -0.0 and 0.0 are one number
    keys: Keys = x
    for bits in (y, z, np.uint64(0)):
        keys = (keys ^ (keys >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
        keys = (keys ^ (keys >> np.uint64(33))) * np.uint64(0xC4CEB9FE1A85EC53) + bits
    keys ^= keys >> np.uint64(33)
    return keys


def _facet_keys(vertex_keys: Keys, faces: NDArray[Any]) -> Keys:
    """Key of each facet (F,): its corners in their order, whichever comes first."""
    swapped = (vertex_keys >> np.uint64(32)) | (vertex_keys << np.uint64(32))
    a, b, c = faces.T
    keys: Keys = vertex_keys[a] * swapped[b]
    keys += vertex_keys[b] * swapped[c]
    keys += vertex_keys[c] * swapped[a]
    return keys


def _boxes(triangles: Floats, old: Bools) -> list[dict[str, Any]]:
    """Boxes around facets that share corners, from low to high; `old` marks those of the mesh given."""
    count = len(triangles)
    _, corner = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    facet = np.repeat(np.arange(count), 3)
    nodes = count + int(corner.max()) + 1
    group = components(nodes, facet, count + corner.ravel())[:count]
    lowest = np.full(nodes, np.inf)
    np.minimum.at(lowest, group, triangles[:, :, 2].min(axis=1))
    order = np.unique(np.stack([lowest[group], group], axis=1), axis=0)[:, 1].astype(np.int64)
    place = np.empty(nodes, np.int64)
    place[order] = np.arange(len(order)) * min(len(order), MOST_REGIONS) // len(order)
    region = place[group]
    bounds = _bounds(triangles, group)
    boxes: list[dict[str, Any]] = []
    for k in np.unique(region):
        here = region == k
        corners = triangles[here].reshape(-1, 3)
        changed = int(max(np.count_nonzero(here & old), np.count_nonzero(here & ~old)))
        why = f"manifold3d changed {changed} facet{'s' * (changed > 1)} here when it built the solid"
        boxes.append({"box_mm": [*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()], "why": why})
        # A factor for rounding and the ends of the slab.
        if np.isfinite(bounds[here]).all() and bounds[here].max() > 0.0:
            boxes[-1]["bound_mm"] = 1.01 * float(bounds[here].max())
    return boxes


def _bounds(triangles: Floats, group: NDArray[Any]) -> Floats:
    """Largest error of a section at each facet (F,), mm: the horizontal width of the slab that its group fills.

    The facets given and those that replace them have one border, and lie in a slab perpendicular to their common normal.
    """
    bounds = np.full(len(triangles), np.inf)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    for k in np.unique(group):
        here = group == k
        normal = normals[here].sum(axis=0)
        length = float(np.linalg.norm(normal))
        flat = float(np.hypot(normal[0], normal[1]))
        if length > 0.0 and flat > LEAST_SLOPE * length:
            along = triangles[here].reshape(-1, 3) @ (normal / length)
            bounds[here] = float(np.ptp(along)) * length / flat
    return bounds


# Parts smaller than 2**10 mm are scaled to lie between half that size and that size
WORKING_SIZE_EXPONENT = 10


@dataclass(frozen=True)
class Placement:
    """Map from part to the coordinates that manifold3d gets: ``(x - shift_mm) * scale``, exact in floating point.

    manifold3d merges vertices within 1e-12 of the largest *coordinate* and rounds contours to 1e-8, whatever the part's size.
    """

    shift_mm: Floats
    scale: float

    def apply(self, points: Floats) -> Floats:
        """Move and scale points (..., 3), exactly."""
        return np.ascontiguousarray((points - self.shift_mm) * self.scale)

    def height(self, z_mm: float) -> float:
        """Height of a plane in working coordinates."""
        return (z_mm - float(self.shift_mm[2])) * self.scale

    def undo(self, points: Floats) -> Floats:
        """Return contour points (N, 2) of working coordinates in mm, as placed."""
        placed = points / self.scale
        # Column by column: ten times faster than adding a row of two to each row.
        placed[:, 0] += self.shift_mm[0]
        placed[:, 1] += self.shift_mm[1]
        return placed


def exact_placement(part: Part) -> Placement:
    """Choose a shift and a power of two for the scale, so that no coordinate is rounded."""
    least, greatest = part.bounds
    size = float((greatest - least).max())
    exponent = WORKING_SIZE_EXPONENT - math.frexp(size)[1] if size > 0.0 else 0
    shift = [_exact_shift(float(a), float(b)) for a, b in zip(least, greatest, strict=True)]
    return Placement(np.array(shift), math.ldexp(1.0, min(max(0, exponent), 200)))


def _exact_shift(least: float, greatest: float) -> float:
    """Return the end nearer to 0 if all differences to it are exact (Sterbenz's lemma), else 0."""
    if least > 0.0 and greatest <= 2.0 * least:
        return least
    if greatest < 0.0 and least >= 2.0 * greatest:
        return greatest
    return 0.0
