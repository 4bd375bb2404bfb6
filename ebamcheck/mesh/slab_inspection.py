"""Inspection of a part slab by slab: every facet, edge and vertex is told of by the slab of its lowest point.

All facets at a vertex reach into the slab of that vertex, so what is told there is what the whole mesh would tell. Bodies
are put together from their pieces in neighbouring slabs by the facets that reach into both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ebamcheck.mesh.inspection import (
    NO_VOLUME,
    Inspection,
    body_boxes,
    body_labels,
    degenerate,
    direction_balance,
    duplicates,
    judged,
    outermost,
)
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.slabs import Slab
from ebamcheck.mesh.topology import edge_groups

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class _Pieces:
    """Pieces of bodies in one slab, numbered on from those of the slabs below."""

    volumes: Floats
    """(P,) mm3, of the facets that the slab tells of."""
    lower: Floats
    upper: Floats
    """(P, 3) corners of their boxes."""
    is_open: Bools
    """(P,) whether an open edge that the slab tells of is theirs."""
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
"""What is counted slab by slab."""


class SlabInspection:
    """Figures of :func:`~ebamcheck.mesh.inspection.inspect`, added up over the slabs from the lowest to the highest.

    Parameters
    ----------
    outline
        The part's box and names.
    facets
        Facets of the whole part.
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
        """Take the next slab up."""
        part = slab.own
        groups = edge_groups(part.faces, len(part.vertices))
        z = part.vertices[:, 2]
        half_edge = groups.half_edges[groups.starts[:-1]]
        ends = (
            part.faces[half_edge // 3, half_edge % 3],
            part.faces[half_edge // 3, (half_edge % 3 + 1) % 3],
        )
        edge_told = _told(slab, np.minimum(z[ends[0]], z[ends[1]]))
        facets_at_edge, balance = np.diff(groups.starts), direction_balance(part.faces, groups)
        lowest = np.minimum(np.minimum(z[part.faces[:, 0]], z[part.faces[:, 1]]), z[part.faces[:, 2]])
        facet_told = _told(slab, lowest)
        repeated, zero_area = degenerate(part)
        is_open = edge_told & (facets_at_edge == 1)
        self._count(
            vertices=int(_told(slab, z).sum()),
            open_edges=int(is_open.sum()),
            nonmanifold_edges=int((edge_told & (facets_at_edge > 2)).sum()),
            inconsistent_edges=int((edge_told & (facets_at_edge == 2) & (balance != 0)).sum()),
            unpaired_edges=int((edge_told & (facets_at_edge > 2) & (balance != 0)).sum()),
            duplicate_facets=duplicates(part.faces[facet_told & ~repeated]),
            degenerate_facets=int((facet_told & repeated).sum()),
            zero_area_facets=int((facet_told & zero_area & ~repeated).sum()),
        )
        body = body_labels(part, groups)
        self._add_pieces(slab, part, body, facet_told, half_edge[is_open] // 3)

    def _count(self, **more: int) -> None:
        for name in COUNTS:
            self._counts[name] += more[name]

    def _add_pieces(
        self, slab: Slab, part: Part, body: NDArray[np.int32], told: Bools, open_facets: NDArray[np.int32]
    ) -> None:
        count = int(body.max(initial=-1)) + 1
        lower, upper = body_boxes(part, body, count)
        is_open = np.zeros(count, np.bool_)
        is_open[body[open_facets]] = True
        used = body >= 0
        numbers, pieces = slab.numbers[used], body[used].astype(np.int64) + self._known
        self._pieces.append(
            _Pieces(
                self._volumes(part, body, told & used, count),
                lower,
                upper,
                is_open,
                _links(*self._carried, numbers, pieces),
            )
        )
        self._known += count
        z = part.vertices[:, 2]
        highest = np.maximum(np.maximum(z[part.faces[:, 0]], z[part.faces[:, 1]]), z[part.faces[:, 2]])[used]
        # The next slab begins no more than a reach under this one's border, and has what is above that.
        carried = highest >= slab.next_from_mm
        self._carried = numbers[carried], pieces[carried]

    def _volumes(self, part: Part, body: NDArray[np.int32], told: Bools, count: int) -> Floats:
        """Signed volumes that some facets give to the pieces that they are of, about the middle of the part's box."""
        middle = self._outline.bounds.mean(axis=0)
        a, b, c = (part.vertices[part.faces[told, k]] - middle for k in range(3))
        sixfold = np.bincount(body[told], np.einsum("ij,ij->i", a, np.cross(b, c)), minlength=count)
        return sixfold.astype(np.float64) / 6.0

    def found(self) -> Inspection:
        """What was found in the slabs so far."""
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
            volume_mm3=float(volumes.sum()),
            inside_out_bodies=int(inside_out.sum()),
            open_bodies=int(is_open.sum()),
            notes=self._outline.notes,
            verdict="sound",
            why="closed, consistently oriented, volume positive",
            **counts,
        )
        verdict, why = judged(found, unpaired, float(np.abs(volumes).sum()))
        return replace(found, verdict=verdict, why=why)

    def _bodies(self) -> tuple[Floats, Floats, Floats, Bools]:
        """Volumes (B,), corners of the boxes (B, 3) twice, and whether open, of the bodies that the pieces make."""
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
    """Of what has its lowest points there, what this slab tells of."""
    return (lowest_mm >= slab.lower_mm) & (lowest_mm < slab.upper_mm)


def _links(below: NDArray[np.int32], below_pieces: Ints, numbers: NDArray[np.int32], pieces: Ints) -> Ints:
    """Pieces (N, 2) of two slabs that share a facet, from the numbers of their facets, which rise."""
    _, first, second = np.intersect1d(below, numbers, assume_unique=True, return_indices=True)
    pairs = np.stack([below_pieces[first], pieces[second]], axis=1)
    return np.unique(pairs, axis=0) if len(pairs) else pairs.reshape(0, 2)
