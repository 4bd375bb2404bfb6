"""Inspection of a part slab by slab: every facet, edge and vertex is counted in the slab of its lowest point.

All facets at a vertex reach into the slab of that vertex, so the counts are those of the whole mesh. Bodies
are joined from their pieces in neighbouring slabs by the facets that reach into both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ebamcheck.mesh.bodies import ASIDE, NO_VOLUME, boxes_meeting, outermost
from ebamcheck.mesh.inspection import Inspection, judged
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.slabs import Slab
from ebamcheck.mesh.topology import body_labels, direction_balance, duplicates, edge_groups
from ebamcheck.numeric.kernels import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Index = NDArray[np.int32]


class _Measured(NamedTuple):
    """Measures of the facets of a slab, by body."""

    volumes: Floats
    """(B,) mm3, of the facets counted in the slab, about the middle of the part's box."""
    lower: Floats
    upper: Floats
    """(B, 3) corners of the box of all facets."""
    flat: int
    """Number of facets counted in the slab that have three distinct vertices and no area."""


@dataclass(frozen=True)
class _Pieces:
    """Pieces of bodies in one slab; their numbers continue those of the slabs below."""

    volumes: Floats
    """(P,) mm3, of the facets counted in the slab."""
    lower: Floats
    upper: Floats
    """(P, 3) corners of their boxes."""
    is_open: Bools
    """(P,) whether they have an open edge that is counted in the slab."""
    links: Ints
    """(N, 2) pieces of the slab below and of this one that share a facet."""


COUNTS = (
    "vertices",
    "open_edges",
    "nonmanifold_edges",
    "inconsistent_edges",
    "unpaired_edges",
    "duplicate_facets",
    "degenerate_facets",
    "zero_area_facets",
)
"""Figures that are added up over the slabs."""


class SlabInspection:
    """Figures of :func:`~ebamcheck.mesh.inspection.inspect`, added up over the slabs from the lowest to the highest.

    Parameters
    ----------
    outline
        The part's box and names.
    facets
        Number of facets of the whole part.
    """

    def __init__(self, outline: Part, facets: int) -> None:
        self._outline = outline
        self._facets = facets
        self._counts = dict.fromkeys(COUNTS, 0)
        self._pieces: list[_Pieces] = []
        self._known = 0
        # Facets that may reach into the next slab, and the piece of each.
        self._carried = np.zeros(0, np.int32), np.zeros(0, np.int64)

    def add(self, slab: Slab) -> None:
        """Add the next slab, from the bottom up."""
        part = slab.own
        groups = edge_groups(part.faces, len(part.vertices))
        z = np.ascontiguousarray(part.vertices[:, 2])
        half_edge = groups.half_edges[groups.starts[:-1]]
        ends = (
            part.faces[half_edge // 3, half_edge % 3],
            part.faces[half_edge // 3, (half_edge % 3 + 1) % 3],
        )
        edge_told = _told(slab, np.minimum(z[ends[0]], z[ends[1]]))
        facets_at_edge, balance = np.diff(groups.starts), direction_balance(part.faces, groups)
        corners = [z[part.faces[:, k]] for k in range(3)]
        lowest, highest = (
            compare(compare(corners[0], corners[1]), corners[2]) for compare in (np.minimum, np.maximum)
        )
        facet_told = _told(slab, lowest)
        body = body_labels(part.faces, groups)
        measured = _measured(part.vertices, part.faces, body, facet_told, self._outline.bounds.mean(axis=0))
        repeated = body < 0
        is_open = edge_told & (facets_at_edge == 1)
        self._count(
            vertices=int(_told(slab, z).sum()),
            open_edges=int(is_open.sum()),
            nonmanifold_edges=int((edge_told & (facets_at_edge > 2)).sum()),
            inconsistent_edges=int((edge_told & (facets_at_edge == 2) & (balance != 0)).sum()),
            unpaired_edges=int((edge_told & (facets_at_edge > 2) & (balance != 0)).sum()),
            duplicate_facets=duplicates(part.faces[facet_told & ~repeated]),
            degenerate_facets=int((facet_told & repeated).sum()),
            zero_area_facets=measured.flat,
        )
        self._add_pieces(slab, body, measured, half_edge[is_open] // 3, carried=highest >= slab.next_from_mm)

    def _count(self, **more: int) -> None:
        for name in COUNTS:
            self._counts[name] += more[name]

    def _add_pieces(
        self, slab: Slab, body: Index, measured: _Measured, open_facets: Index, carried: Bools
    ) -> None:
        is_open = np.zeros(measured.volumes.size, np.bool_)
        is_open[body[open_facets]] = True
        used = body >= 0
        numbers, pieces = slab.numbers[used], body[used].astype(np.int64) + self._known
        links = _links(*self._carried, numbers, pieces)
        self._pieces.append(_Pieces(measured.volumes, measured.lower, measured.upper, is_open, links))
        self._known += is_open.size
        self._carried = numbers[carried[used]], pieces[carried[used]]

    def found(self) -> Inspection:
        """Result for the slabs added so far."""
        volumes, lower, upper, is_open = self._bodies()
        size = self._outline.size
        negative = volumes < -NO_VOLUME * float(size.max(initial=0.0)) ** 3
        inside_out = outermost(negative, volumes, lower, upper) & ~is_open
        counts = dict(self._counts)
        unpaired = counts.pop("unpaired_edges")
        x, y, z = (float(v) for v in size)
        x0, y0, z0 = (float(v) for v in self._outline.bounds[0])
        found = Inspection(
            name=self._outline.name,
            facets=self._facets,
            bodies=volumes.size,
            size_mm=(x, y, z),
            lower_mm=(x0, y0, z0),
            units=self._outline.units,
            units_from=self._outline.units_from,
            volume_mm3=float(volumes.sum()),
            inside_out_bodies=int(inside_out.sum()),
            open_bodies=int(is_open.sum()),
            relations=(),
            related_bodies=0,
            union_known=not len(boxes_meeting(lower, upper, ASIDE * float(np.linalg.norm(size)))),
            notes=self._outline.notes,
            verdict="sound",
            why="closed, consistently oriented, volume positive",
            **counts,
        )
        verdict, why = judged(found, unpaired, float(np.abs(volumes).sum()))
        return replace(found, verdict=verdict, why=why)

    def _bodies(self) -> tuple[Floats, Floats, Floats, Bools]:
        """Volumes (B,), lower and upper corners of the boxes (B, 3), and whether open (B,), of the bodies."""
        if not self._known:
            return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.bool_)
        links = np.concatenate([piece.links for piece in self._pieces])
        graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), (self._known, self._known))
        count, body = connected_components(graph, directed=False)
        volumes: Floats = np.zeros(count)
        np.add.at(volumes, body, np.concatenate([p.volumes for p in self._pieces]))
        lower, upper = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
        np.minimum.at(lower, body, np.concatenate([p.lower for p in self._pieces]))
        np.maximum.at(upper, body, np.concatenate([p.upper for p in self._pieces]))
        is_open: Bools = np.zeros(count, np.bool_)
        np.logical_or.at(is_open, body, np.concatenate([p.is_open for p in self._pieces]))
        return volumes, lower, upper, is_open


def _told(slab: Slab, lowest_mm: Floats) -> Bools:
    """Whether items with these lowest heights are counted in this slab."""
    return (lowest_mm >= slab.lower_mm) & (lowest_mm < slab.upper_mm)


def _measured(vertices: Floats, faces: Index, body: Index, told: Bools, middle: Floats) -> _Measured:
    """Measure the facets of a slab; `body` is -1 for a facet that repeats a vertex."""
    count = int(body.max(initial=-1)) + 1
    volumes, lower, upper = np.zeros(count), np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    flat = _measure(vertices, faces, body, told, middle, volumes, lower, upper)
    return _Measured(volumes / 6.0, lower, upper, flat)


@kernel
def _measure(
    vertices: Floats,
    faces: Index,
    body: Index,
    told: Bools,
    middle: Floats,
    sixfold: Floats,
    lower: Floats,
    upper: Floats,
) -> int:
    """Add six times the volumes of some facets up and widen the boxes of all; returns how many of some are without area."""
    flat = 0
    across, p, q = np.empty(3), np.empty(3), np.empty(3)
    for f in range(faces.shape[0]):
        b = body[f]
        if b < 0:
            continue
        for c in range(3):
            first = vertices[faces[f, 0], c]
            p[c], q[c] = vertices[faces[f, 1], c] - first, vertices[faces[f, 2], c] - first
            lower[b, c] = min(lower[b, c], first, vertices[faces[f, 1], c], vertices[faces[f, 2], c])
            upper[b, c] = max(upper[b, c], first, vertices[faces[f, 1], c], vertices[faces[f, 2], c])
        if not told[f]:
            continue
        for c in range(3):
            u, v = (c + 1) % 3, (c + 2) % 3
            across[c] = p[u] * q[v] - p[v] * q[u]
        if across[0] == 0.0 and across[1] == 0.0 and across[2] == 0.0:
            flat += 1
        for c in range(3):
            sixfold[b] += (vertices[faces[f, 0], c] - middle[c]) * across[c]
    return flat


def _links(below: NDArray[np.int32], below_pieces: Ints, numbers: NDArray[np.int32], pieces: Ints) -> Ints:
    """Pieces (N, 2) of two slabs that share a facet, from the ascending numbers of their facets."""
    _, first, second = np.intersect1d(below, numbers, assume_unique=True, return_indices=True)
    pairs = np.stack([below_pieces[first], pieces[second]], axis=1)
    return np.unique(pairs, axis=0) if len(pairs) else pairs.reshape(0, 2)
