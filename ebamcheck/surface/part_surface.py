"""The surface that a mesh stands for: its regions, normals at the corners of facets, sagittas, and exact surfaces.

A *sector* is a set of facet corners about one vertex that no crease separates: a smooth vertex has one, a
vertex on a sharp edge two, the corner of a cube three. Each sector has a normal of its own, by the regions of the mesh
(:mod:`ebamcheck.surface.normals`).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, NamedTuple, TypeVar
from weakref import WeakKeyDictionary, WeakSet

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Bools, Floats
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index, edge_groups, twins
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.surface.exact_surfaces import ExactSurfaces, exact_surfaces
from ebamcheck.surface.normals import region_normals
from ebamcheck.surface.offsets import Offsets, vertex_offsets
from ebamcheck.surface.regions import FREEFORM, PLANE, find_regions


class Sagittas(NamedTuple):
    """How far facets are from the surface, by their dihedral angles, mm; infinite where nothing is known."""

    mean: Floats  # (V,) mean over the edges at a vertex, weighted by their lengths
    largest: Floats  # (V,) largest at a vertex
    typical: float  # Median over the facets outside of planes, weighted by area


class PartSurface(NamedTuple):
    """A mesh with what is known of the smooth surface that it approximates."""

    vertices: Floats
    faces: Index
    across: Index  # (3 F,) half-edge across each, at creases too
    twin: Index  # (3 F,) half-edge across each where the surface continues without a crease; else NO_TWIN
    sectors: Index  # (F, 3) row of the normal of each corner of each facet
    normals: Floats  # (S, 3) unit normals
    noise: Floats  # (S,) residual of the fitted surface at the vertices about, mm; NaN where it is unknown
    fans: Index  # (F, 3) smooth fan about the vertex that each corner belongs to, whatever the regions in it
    kind: NDArray[np.uint8]  # (F,) kind of region of the facet
    region: Index  # (F,) planar group of the facet
    facet_normals: Floats  # (F, 3) unit normals of the facets' groups
    sagittas: Sagittas
    offsets: Offsets  # Whether the vertices lie on the surface
    exact: ExactSurfaces  # Surfaces that are known by formula

    @property
    def smooth(self) -> Bools:
        """(3 F,) whether the surface continues across each half-edge without a crease."""
        return np.asarray(self.twin != NO_TWIN)


# -- what is computed from a mesh alone, kept for parts whose layers are fitted one after the other ---------------

_Found = TypeVar("_Found")
_Key = TypeVar("_Key", bound=Hashable)

_kept: WeakSet[Part] = WeakSet()
_memories: list[WeakKeyDictionary[Part, Any]] = []  # Last key and result of each decorated function, by part


def keep_surface_of(part: Part) -> None:
    """Keep what is computed from a part's mesh for as long as the part exists: some 100 bytes per facet."""
    _kept.add(part)


@contextmanager
def surface_kept(part: Part) -> Iterator[None]:
    """Keep what is computed from a part's mesh within the block, in which several fits need the same."""
    if part in _kept:
        yield
        return
    _kept.add(part)
    try:
        yield
    finally:
        _kept.discard(part)
        for memory in _memories:
            memory.pop(part, None)


def once_a_part(function: Callable[[Part, _Key], _Found]) -> Callable[[Part, _Key], _Found]:
    """Decorate a function of a part and a key, such as settings, so that its last result is kept.

    It is kept only for parts named by :func:`keep_surface_of` or :func:`surface_kept`. Callers must not modify it.
    """
    known: WeakKeyDictionary[Part, tuple[_Key, _Found]] = WeakKeyDictionary()
    _memories.append(known)

    @wraps(function)
    def kept(part: Part, key: _Key) -> _Found:
        if part not in _kept:
            return function(part, key)
        if part not in known or known[part][0] != key:
            known[part] = key, function(part, key)
        return known[part][1]

    return kept


@once_a_part
def surface_of(part: Part, settings: CurveSettings) -> PartSurface:
    """Find the surface that a mesh approximates.

    Edges whose facets' normals differ by at least the crease angle are sharp; so are edges with only one facet, or with
    facets that do not run in opposite directions along it, and every bend between two planes.
    """
    vertices, faces = part.vertices, part.faces
    groups = edge_groups(faces, len(vertices))
    across = twins(vertices, faces, groups.half_edges, groups.starts)
    twin = across.copy()
    regions = find_regions(part, twin, settings)
    label = regions.groups.label
    kind, facet_normals = regions.kind[label], regions.groups.normals[label]
    normals = region_normals(part, twin, regions)
    sagittas = mesh_sagittas(vertices, faces, twin, facet_normals, kind)
    offsets = vertex_offsets(vertices, faces, twin != NO_TWIN, normals.fans, kind == FREEFORM)
    exact = exact_surfaces(part, twin, across, regions, sagittas.typical)
    mesh = vertices, faces, across, twin
    return PartSurface(*mesh, *normals, kind, label, facet_normals, sagittas, offsets, exact)


def mesh_sagittas(vertices: Floats, faces: Index, twin: Index, normals: Floats, kind: NDArray[np.uint8]) -> Sagittas:
    """Sagittas across edges that are no crease: of an arc over the lower of the two facets that turns by what they turn."""
    count, heads = len(vertices), np.roll(faces, -1, axis=1)
    edges = vertices[heads] - vertices[faces]
    lengths = np.linalg.norm(edges, axis=2)
    areas = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    heights = (2.0 * areas[:, None] / np.maximum(lengths, 1e-300)).reshape(-1)
    h = np.flatnonzero(twin != NO_TWIN)
    g = twin[h]
    turn = 2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(normals[h // 3] - normals[g // 3], axis=1), 1.0))
    edge = np.zeros(twin.size)
    edge[h] = turn * np.minimum(heights[h], heights[g]) / 8.0
    of_facet = edge.reshape(-1, 3).max(axis=1, initial=0.0)
    # The median leaves out planes and facets that are as good as flat.
    told = np.flatnonzero((kind != PLANE) & (of_facet > 1e-6))
    if not told.size:
        return Sagittas(np.full(count, np.inf), np.full(count, np.inf), np.inf)
    order = told[np.argsort(of_facet[told], kind="stable")]
    below = np.cumsum(areas[order])
    typical = float(of_facet[order][np.searchsorted(below, 0.5 * below[-1])])
    ends = np.concatenate([faces.reshape(-1)[h], heads.reshape(-1)[h]])
    long, both = np.tile(lengths.reshape(-1)[h], 2), np.tile(edge[h], 2)
    weights = np.bincount(ends, long, minlength=count)
    mean = np.bincount(ends, long * both, minlength=count) / np.where(weights > 0.0, weights, 1.0)
    largest = np.zeros(count)
    np.maximum.at(largest, ends, both)
    return Sagittas(mean, largest, typical)
