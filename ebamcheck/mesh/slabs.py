"""A mesh in slabs of z: the facets that reach into each slab, closed to a mesh that has the same sections there.

The facets of a slab are an open mesh. If the whole mesh is closed, the open edges of the slab's mesh lie entirely below or
above the slab, and form cycles. A cone over each cycle, from a corner of the part's box, closes the mesh without
reaching any height of the slab: sections there are those of the whole mesh, and every slicer accepts it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ebamcheck.mesh.part import Part
from ebamcheck.mesh.slab_file import FacetFile, Index, Singles
from ebamcheck.mesh.topology import direction_balance, edge_groups
from ebamcheck.mesh.welding import weld
from ebamcheck.numeric.kernels import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

COLUMN_BLOCK = 1 << 22
"""Facets processed at once, to bound the working memory."""


@dataclass(frozen=True, eq=False)
class Slab:
    """One slab of a mesh.

    Parameters
    ----------
    part
        A closed mesh with the sections of the whole one at all heights of the slab, and with the whole one's box.
    facets
        Number of facets of `part` that are from the file, which come first; the others are cones.
    points
        Number of vertices of `part` that are from the file; the last two are the corners of the box.
    numbers
        (facets,) numbers of these facets in the file, ascending.
    lower_mm, upper_mm
        The slab: an item with its lowest point at ``lower_mm <= z < upper_mm`` is counted in this slab only.
    next_from_mm
        Facets that reach up to this height are also in the next slab.
    """

    part: Part
    facets: int
    points: int
    numbers: Index
    lower_mm: float
    upper_mm: float
    next_from_mm: float

    @property
    def own(self) -> Part:
        """Open mesh of the facets from the file."""
        return replace(
            self.part, vertices=self.part.vertices[: self.points], faces=self.part.faces[: self.facets]
        )


@dataclass(frozen=True, eq=False)
class Division:
    """Facets of a file by the slabs that they reach into.

    Parameters
    ----------
    file
        The file.
    layers
        (S + 1,) first layer of each slab, and the number of layers.
    borders_mm
        (S + 1,) z between the slabs; the outermost are infinite.
    reach_mm
        Distance beyond its borders to which a slab has all facets.
    starts, numbers
        (S + 1,) and (N,): facets of slab k are ``numbers[starts[k]:starts[k + 1]]``, ascending.
    crossings
        Number of facets cut, summed over all layers: the number of points of their exact contours.
    """

    file: FacetFile
    layers: Ints
    borders_mm: Floats
    reach_mm: float
    starts: Ints
    numbers: Index
    crossings: int

    def __len__(self) -> int:
        """Return the number of slabs."""
        return len(self.layers) - 1

    @property
    def most_facets(self) -> int:
        """Number of facets of the largest slab."""
        return int(np.diff(self.starts).max())

    def slab(self, k: int) -> Slab:
        """Read one slab of the file, weld it and close it."""
        numbers = self.numbers[self.starts[k] : self.starts[k + 1]]
        vertices, faces = weld(self.file.corners(numbers))
        if self.file.millimetres != 1.0:
            vertices *= self.file.millimetres
        lower, upper = self.borders_mm[k : k + 2].tolist()
        box = self.file.outline.vertices
        cones = closing_cones(vertices, faces, lower - self.reach_mm, upper + self.reach_mm)
        part = replace(
            self.file.outline,
            vertices=np.concatenate([vertices, box]),
            faces=np.ascontiguousarray(np.concatenate([faces, cones])),
        )
        return Slab(part, len(faces), len(vertices), numbers, lower, upper, upper - self.reach_mm)


def closing_cones(vertices: Floats, faces: Index, lower_mm: float, upper_mm: float) -> Index:
    """Facets that close the open edges of a mesh entirely below `lower_mm` or above `upper_mm`.

    Parameters
    ----------
    vertices, faces
        The mesh, (V, 3) mm and (F, 3).
    lower_mm, upper_mm
        Edges between or across these heights stay as they are: an open one there is a defect of the mesh.

    Returns
    -------
    numpy.ndarray
        (C, 3) vertices; V is a point below all others, V + 1 one above.
    """
    groups = edge_groups(faces, len(vertices))
    balance = direction_balance(faces, groups)
    odd = np.flatnonzero(balance)
    half_edge = groups.half_edges[groups.starts[odd]]
    ends = np.stack([faces[half_edge // 3, half_edge % 3], faces[half_edge // 3, (half_edge % 3 + 1) % 3]])
    lesser, greater = ends.min(axis=0), ends.max(axis=0)
    z = vertices[ends, 2]
    below, above = z.max(axis=0) < lower_mm, z.min(axis=0) > upper_mm
    beyond = below | above
    apex = np.where(below, len(vertices), len(vertices) + 1)
    # As many facets in the opposite direction as one direction has in excess.
    times = np.where(beyond, np.abs(balance[odd]), 0)
    rising = balance[odd] > 0
    cones = np.stack([np.where(rising, greater, lesser), np.where(rising, lesser, greater), apex], axis=1)
    return np.repeat(cones, times, axis=0).astype(np.int32)


def divided(file: FacetFile, heights: Floats, slabs: int, reach_mm: float) -> Division:
    """Divide the layers of a part into slabs of about equal work, and assign its facets to them.

    Parameters
    ----------
    file
        The part's file.
    heights
        (L,) heights of the cuts, mm, ascending.
    slabs
        Number of slabs, at most that of layers.
    reach_mm
        Distance beyond its borders to which a slab must have all facets: as far as slicers and comparison look from a height.
    """
    begins, crossing = layer_counts(file, heights)
    layers = slab_layers(begins, crossing, min(slabs, heights.size))
    _, _, sizes = _reaching(file, heights, layers, reach_mm)
    # Layers between two bodies are joined to those below: a slab without facets would be no mesh.
    layers = np.concatenate([layers[:-1][sizes > 0], layers[-1:]])
    borders, (lower, upper), sizes = _reaching(file, heights, layers, reach_mm)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    numbers = _dealt(file.low, file.high, file.millimetres, lower, upper, starts)
    return Division(file, layers, borders, reach_mm, starts, numbers, int(crossing.sum()))


def _reaching(
    file: FacetFile, heights: Floats, layers: Ints, reach_mm: float
) -> tuple[Floats, tuple[Floats, Floats], Ints]:
    """Borders of slabs (S + 1,), lower and upper height between which each has all facets (S,), and their number (S,)."""
    between = 0.5 * (heights[layers[1:-1] - 1] + heights[layers[1:-1]])
    borders = np.concatenate([[-np.inf], between, [np.inf]])
    lower, upper = borders[:-1] - reach_mm, borders[1:] + reach_mm
    return borders, (lower, upper), _sizes(file.low, file.high, file.millimetres, lower, upper)


def layer_counts(file: FacetFile, heights: Floats) -> tuple[Ints, Ints]:
    """Numbers of facets that begin at each height and of those cut there (at z = h + 0), (L,) each."""
    size = heights.size + 1
    first, last = np.zeros(size, np.int64), np.zeros(size, np.int64)
    for start in range(0, len(file), COLUMN_BLOCK):
        for counts, column in ((first, file.low), (last, file.high)):
            z = column[start : start + COLUMN_BLOCK].astype(np.float64) * file.millimetres
            counts += np.bincount(np.searchsorted(heights, z, side="left"), minlength=size)
    return first[:-1], np.cumsum(first - last)[:-1]


def slab_layers(begins: Ints, crossing: Ints, slabs: int) -> Ints:
    """First layer of each slab, and the number of layers (S + 1,); work is half the facets that begin, half those cut.

    Examples
    --------
    >>> slab_layers(np.array([6, 0, 0, 6]), np.array([4, 4, 4, 4]), 2).tolist()
    [0, 2, 4]
    """
    layers = begins.size
    weight = begins / max(int(begins.sum()), 1) + crossing / max(int(crossing.sum()), 1) + 1e-9
    shares = np.cumsum(weight) / weight.sum()
    wanted = np.searchsorted(shares, np.arange(1, slabs) / slabs) + 1
    # Every slab has at least one layer.
    rising = np.maximum.accumulate(wanted - np.arange(1, slabs)) + np.arange(1, slabs)
    inner = np.minimum(rising, layers - slabs + np.arange(1, slabs))
    return np.concatenate([[0], inner, [layers]]).astype(np.int64)


@kernel
def _sizes(low: Singles, high: Singles, millimetres: float, lower: Floats, upper: Floats) -> Ints:
    """Facets that reach into each slab (S,), of slabs between `lower` and `upper` mm, borders included."""
    sizes = np.zeros(lower.size, np.int64)
    for f in range(low.size):
        first = np.searchsorted(upper, low[f] * millimetres)
        past = np.searchsorted(lower, high[f] * millimetres, side="right")
        for k in range(first, past):
            sizes[k] += 1
    return sizes


@kernel
def _dealt(
    low: Singles, high: Singles, millimetres: float, lower: Floats, upper: Floats, starts: Ints
) -> Index:
    """Numbers of the facets that reach into each slab, one slab after the other, rising in each."""
    numbers = np.empty(starts[-1], np.int32)
    at = starts[:-1].copy()
    for f in range(low.size):
        first = np.searchsorted(upper, low[f] * millimetres)
        past = np.searchsorted(lower, high[f] * millimetres, side="right")
        for k in range(first, past):
            numbers[at[k]] = f
            at[k] += 1
    return numbers
