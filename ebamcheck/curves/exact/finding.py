"""Exact surfaces of a mesh: facets whose vertices lie on one quadric or torus, to the rounding of their file.

Where one is found, the part's surface between the vertices is known by formula, however the mesh divides it, and need not be
estimated from normals.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ebamcheck.curves.exact.fitting import told_forms
from ebamcheck.curves.exact.forms import FLAT, KIND, OWN, PLACE, SIDE, SIZE, distances, signed_distance
from ebamcheck.curves.exact.growing import Ground, absorb, grown, touching
from ebamcheck.curves.plausible import OF_ROUNDING
from ebamcheck.curves.regions.borders import LIKE
from ebamcheck.curves.regions.segmentation import INWARD, OUTWARD, PLANE, STRIP, Regions
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index, split_corners
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats

FIT = 3.0
"""Tolerance of a fitted surface, over that of a plane: errors of the fitted position and size add to those of the vertices."""

NO_SURFACE = -1

GAP = 4.0
"""A group this many times farther from the surface than the next nearer one is a flat side that only ends on the surface."""

MOST_OF_TYPICAL = 25.0
"""Largest distance of a facet from an exact surface, over the mesh's median sagitta: long facets of scattered points are so far."""

PATCHES = (48, 16)
"""Sizes, in groups, of the patches about a seed from which a surface is tried, in this order."""

MOST_PIECES = 1000
"""Pieces that may fail before the search stops, the largest first: a noisy mesh has very many."""

MOST_SEEDS = 240
"""Patches that may fail before the search stops: on a mesh of free forms alone this bounds the work."""

MOST_ROUNDS = 6
"""Rounds of growing and fitting for one surface; it usually stops growing after two or three."""

TANGENT_COSINE = np.cos(np.deg2rad(0.6))
"""Cosine of the largest angle at which two surfaces count as tangent along their border, given the rounding of a file."""

TANGENT = 0.9
"""Of the border edges beyond which a surface is known, the least share at which the two must be tangent."""

BESIDE = 0.4
"""Least share of a surface's smooth border edges beyond which something is known: about one of two rims."""

LEAST_BESIDE = 6
"""Least number of such edges."""


class ExactSurfaces(NamedTuple):
    """Exact surfaces of a mesh, and the planes beside them."""

    label: Index
    """(F,) surface of each facet; :data:`NO_SURFACE` for none."""
    rows: Floats
    """(S, SIZE) surfaces, in the layout of :mod:`ebamcheck.curves.exact.forms`."""


def no_surfaces(facet_count: int) -> ExactSurfaces:
    """Exact surfaces of a mesh on which none is known."""
    return ExactSurfaces(np.full(facet_count, NO_SURFACE, np.int32), np.zeros((0, SIZE)))


def exact_surfaces(
    part: Part, twin: Index, across: Index, regions: Regions, rims: Floats, typical_mm: float
) -> ExactSurfaces:
    """Find the exact surfaces of a mesh, and the planes beside them.

    Parameters
    ----------
    part
        The mesh.
    twin
        (3 F,) half-edge across each; -1 at creases.
    across
        (3 F,) the same, at creases too.
    regions
        Regions of the mesh.
    rims
        (G, 2) how far a surface would stand off the strip of each group, inward and outward, mm, if the bends at its sides
        were those of a rounding.
    typical_mm
        Median sagitta of the mesh, from its dihedral angles.
    """
    return _Search(part, twin, across, regions, rims, typical_mm).run()


class _Search:
    """State of the search for exact surfaces: what is found, and the planar groups that it has taken."""

    def __init__(
        self, part: Part, twin: Index, across: Index, regions: Regions, rims: Floats, typical_mm: float
    ) -> None:
        self.across = across
        self.rims = rims
        self.coarse_mm = OF_ROUNDING * typical_mm
        self.largest_mm = MOST_OF_TYPICAL * typical_mm
        groups = regions.groups
        vertices, faces = part.vertices, part.faces
        sectors = split_corners(faces, twin)
        told = told_corners(vertices, faces, groups.label, sectors, regions.tolerance_mm)
        self.ground = Ground(
            vertices, faces, twin, groups.label, groups.starts, groups.facets, groups.normals, told
        )
        self.kind = regions.kind
        self.areas = groups.areas
        self.tolerance_mm = FIT * regions.tolerance_mm
        self.middles: Floats = vertices[faces].mean(axis=1)
        self.taken: Bools = np.zeros(len(groups.normals), np.bool_)
        self.of_group = np.full(len(groups.normals), NO_SURFACE, np.int32)
        self.rows: list[Floats] = []
        self.sagittas: list[float] = []
        self.supported = False
        """Whether the surfaces now looked for must be confirmed by their neighbours."""

    def run(self) -> ExactSurfaces:
        """Try each smooth piece of one kind as a whole, then patches of it, then what is left between known surfaces."""
        self._try_each(self._pieces(np.inf), MOST_PIECES)
        self._try_each(
            (patch for piece in self._pieces(np.inf) for patch in self._patches(piece)), MOST_SEEDS
        )
        known = 0
        self._try_each(self._pieces(LIKE) if self.rows else (), MOST_PIECES)
        self.supported = True
        while len(self.rows) > known:
            known = len(self.rows)
            for most in (np.inf, LIKE):
                self._try_each(self._pieces(most), MOST_PIECES)
        label = self.of_group[self.ground.label]
        rows = np.array(self.rows).reshape(-1, SIZE)
        free = self.kind[self.ground.label] != PLANE
        while absorb(self.ground, self.across, free, rows, np.array(self.sagittas), self.tolerance_mm, label):
            pass
        return self._with_planes(label, rows)

    def _with_planes(self, label: Index, rows: Floats) -> ExactSurfaces:
        """Add the planes beside exact surfaces: a crease between the two lies on both."""
        ground = self.ground
        half = np.flatnonzero(self.across != NO_TWIN)
        beside = half[label[self.across[half] // 3] != NO_SURFACE] // 3
        beside = beside[(self.kind[ground.label[beside]] == PLANE) & (label[beside] == NO_SURFACE)]
        found = [rows]
        for number, group in enumerate(np.unique(ground.label[beside]).tolist(), len(rows)):
            facets = ground.facets[ground.starts[group] : ground.starts[group + 1]]
            row = np.zeros((1, SIZE))
            row[0, KIND], row[0, SIDE] = FLAT, 1.0
            row[0, PLACE : PLACE + 3] = ground.vertices[np.unique(ground.faces[facets])].mean(axis=0)
            row[0, OWN : OWN + 3] = ground.normals[group]
            label[facets] = number
            found.append(row)
        return ExactSurfaces(label, np.concatenate(found))

    def _pieces(self, most: float) -> Iterator[Index]:
        """Smooth pieces of groups of one kind that no surface has taken, the largest first.

        Neighbours in a piece differ in area by less than the factor `most`, which parts the narrow rows of a rounding from the
        wall that they touch.
        """
        ground = self.ground
        half = np.flatnonzero(ground.twin != NO_TWIN)
        a, b = ground.label[half // 3], ground.label[ground.twin[half] // 3]
        joined = (self.kind[a] == self.kind[b]) & (self.kind[a] != PLANE) & (a != b)
        joined &= ~(self.taken[a] | self.taken[b])
        joined &= np.maximum(self.areas[a], self.areas[b]) < most * np.minimum(self.areas[a], self.areas[b])
        count = len(self.kind)
        links = coo_matrix((np.ones(joined.sum()), (a[joined], b[joined])), (count, count))
        piece = connected_components(links, directed=False)[1]
        area = np.bincount(piece, self.areas)
        order = np.argsort(piece, kind="stable").astype(np.int32)
        pieces = np.split(order, np.cumsum(np.bincount(piece))[:-1])
        for number in np.argsort(-area, kind="stable"):
            groups = pieces[number]
            if len(groups) > 1 and self.kind[groups[0]] != PLANE and not self.taken[groups[0]]:
                yield groups

    def _patches(self, piece: Index) -> Iterator[Index]:
        """Patches about seeds spread evenly over the area of a piece."""
        share = np.cumsum(self.areas[piece])
        seeds = min(len(piece), 4 + int(np.sqrt(len(piece))))
        at = np.searchsorted(share, (np.arange(seeds) + 0.5) / seeds * share[-1])
        for size in PATCHES:
            if size >= len(piece):
                continue
            for seed in np.unique(piece[np.minimum(at, len(piece) - 1)]):
                if not self.taken[seed]:
                    yield _patch(self.ground, int(seed), self.taken, self.kind, size)

    def _try_each(self, pieces: Iterable[Index], most: int) -> None:
        """Look for the surface of each piece, until `most` of them have failed."""
        failed = 0
        for piece in pieces:
            failed += not self._try(piece)
            if failed >= most:
                break

    def _try(self, groups: Index) -> bool:
        """Look for a surface through some groups, and take all groups that lie on it; False if there is none."""
        groups = groups[~self.taken[groups]]
        if len(groups) < 2:
            return False
        for row in self._forms(groups):
            found = self._grown(row, groups)
            if found is not None:
                row, groups, sagitta = found
                self.sagittas.append(sagitta)
                self.taken[groups] = True
                self.of_group[groups] = len(self.rows)
                self.rows.append(row)
                return True
        return False

    def _forms(self, groups: Index) -> Iterator[Floats]:
        """Forms fitted to the told vertices of groups (:mod:`ebamcheck.curves.exact.finding`), with their sides set."""
        ground = self.ground
        facets = _facets_of(ground.starts, ground.facets, groups)
        corners = np.unique(ground.faces[facets][ground.told[facets]])
        normals = ground.normals[ground.label[facets]]
        places = self.middles[facets]
        straight = bool((self.kind[groups] == STRIP).all())
        vertices = ground.vertices[corners]
        for row in told_forms(vertices, places, normals, self.tolerance_mm, straight, self.supported):
            row[SIDE] = np.sign(_facing(row, places, normals))
            if row[SIDE] != 0.0:
                yield row

    def _grown(self, row: Floats, groups: Index) -> tuple[Floats, Index, float] | None:
        """Grow a surface and refit it until it takes no more groups; return surface, groups and greatest sagitta.

        None where a fit or a check fails.
        """
        sagittas = np.empty(len(self.taken))
        before = 0
        for _ in range(MOST_ROUNDS):
            count = grown(self.ground, groups, self.taken, row, self.tolerance_mm, self.largest_mm, sagittas)
            if count < 2:
                return None
            largest = _without_flat_sides(sagittas[sagittas >= 0.0])
            if np.isfinite(largest):
                seeds = groups[sagittas[groups] >= 0.0]
                grown(self.ground, seeds, self.taken, row, self.tolerance_mm, largest, sagittas)
            groups = np.flatnonzero(sagittas >= 0.0).astype(np.int32)
            if len(groups) <= before:
                if self.supported and not self._is_borne_out(row, groups):
                    return None
                if self._may_be_rounding(row, groups, float(sagittas.max())):
                    return None
                return row, groups, float(sagittas.max())
            before = len(groups)
            refitted = next(self._forms(groups), None)
            if refitted is None or refitted[0] != row[0]:
                return None
            row = refitted
        return None

    def _may_be_rounding(self, row: Floats, groups: Index, sagitta: float) -> bool:
        """Whether the groups may be strips of a coarse rounding, curved across them the other way by a similar sagitta.

        See :func:`ebamcheck.curves.plausible.sure_share`.
        """
        if not (self.kind[groups] == STRIP).all():
            return False
        facets = _facets_of(self.ground.starts, self.ground.facets, groups)
        off = distances(row, self.middles[facets])
        other_way = INWARD if row[SIDE] * off.mean() < 0.0 else OUTWARD
        rim = float(np.median(self.rims[groups, other_way]))
        return 0.5 * sagitta < rim <= self.coarse_mm

    def _is_borne_out(self, row: Floats, groups: Index) -> bool:
        """Whether the known surfaces and planes that continue the groups smoothly are tangent to `row` along their border."""
        rows = np.array(self.rows).reshape(-1, SIZE)
        planes = self.kind == PLANE
        found = touching(self.ground, groups, self.of_group, rows, planes, row, TANGENT_COSINE)
        return (
            found.known >= max(LEAST_BESIDE, BESIDE * found.smooth) and found.tangent >= TANGENT * found.known
        )


def _without_flat_sides(sagittas: Floats) -> float:
    """Largest distance of a group from the surface, mm: that below the first leap by :data:`GAP` in the upper half, if any."""
    upper = np.sort(sagittas)[len(sagittas) // 2 :]
    leaps = np.flatnonzero(upper[1:] > GAP * np.maximum(upper[:-1], 1e-9))
    return float(1.01 * upper[leaps[0]]) if leaps.size else np.inf


def _facing(row: Floats, places: Floats, normals: Floats) -> float:
    """Mean cosine between facet normals and the gradient of the signed distance from a surface."""
    return float(np.mean(_cosines(row, places, normals)))


@kernel
def _facets_of(starts: Index, facets: Index, groups: Index) -> Index:
    """Facets of some groups."""
    count = 0
    for group in groups:
        count += starts[group + 1] - starts[group]
    found = np.empty(count, np.int32)
    n = 0
    for group in groups:
        for place in range(starts[group], starts[group + 1]):
            found[n] = facets[place]
            n += 1
    return found


@kernel
def _cosines(row: Floats, places: Floats, normals: Floats) -> Floats:
    found = np.empty(len(places))
    for i in range(len(places)):
        _, x, y, z = signed_distance(row, places[i, 0], places[i, 1], places[i, 2])
        found[i] = x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2]
    return found


@kernel
def _patch(ground: Ground, seed: int, taken: Bools, kind: np.ndarray, size: int) -> Index:
    """Groups about a seed, of its kind: the nearest by steps."""
    queue = np.empty(size + 1, np.int32)
    queue[0] = seed
    first, last = 0, 1
    seen = taken.copy()
    seen[seed] = True
    while first < last and last < size:
        group = queue[first]
        first += 1
        for place in range(ground.starts[group], ground.starts[group + 1]):
            for k in range(3):
                h = ground.twin[3 * ground.facets[place] + k]
                if h == NO_TWIN or last >= size:
                    continue
                other = ground.label[h // 3]
                if not seen[other] and kind[other] == kind[seed]:
                    seen[other] = True
                    queue[last] = other
                    last += 1
    return queue[:last].copy()


# -- Told corners: vertices that lie on the surface that a mesh approximates, as far as its facets can tell ----
#
# Only vertices at which several planar groups meet smoothly lie on the surface for certain. A vertex inside
# one group, or at the outer border of only one, lies in that group's plane, and may be as far from the
# surface as the facet is: Boolean operations on meshes leave such vertices. So may a vertex on the line
# between two of its neighbours, which merely splits an edge.


STRAIGHT_COSINE = 0.99
"""Two edges at a vertex may be one line if the cosine of the angle between them is less than minus this."""


def told_corners(vertices: Floats, faces: Index, label: Index, sectors: Index, tolerance_mm: float) -> Bools:
    """Corners of facets (F, 3) whose vertices lie on the surface.

    Parameters
    ----------
    vertices, faces
        The mesh.
    label
        (F,) planar group of each facet.
    sectors
        (F, 3) smooth fan of each corner.
    tolerance_mm
        How far a vertex may lie from the line of two neighbours, and be on it.
    """
    count = int(sectors.max(initial=-1)) + 1
    several = _meet_groups(label, sectors, count)
    split = _split_edges(vertices, faces, tolerance_mm)
    return np.asarray(several[sectors] & ~split[faces])


@kernel
def _meet_groups(label: Index, sectors: Index, count: int) -> Bools:
    """Fans (count,) in which facets of several groups meet."""
    first = np.full(count, -1, np.int32)
    several = np.zeros(count, np.bool_)
    for f in range(len(sectors)):
        for k in range(3):
            s = sectors[f, k]
            if first[s] < 0:
                first[s] = label[f]
            elif first[s] != label[f]:
                several[s] = True
    return several


@kernel
def _split_edges(vertices: Floats, faces: Index, tolerance: float) -> Bools:
    """Vertices (V,) that lie on the line between two of their neighbours."""
    count = len(vertices)
    starts = np.zeros(count + 1, np.int64)
    for f in range(len(faces)):
        for k in range(3):
            starts[faces[f, k] + 1] += 1
    for i in range(count):
        starts[i + 1] += starts[i]
    fill = starts[:-1].copy()
    neighbours = np.empty(3 * len(faces), np.int32)
    for f in range(len(faces)):
        for k in range(3):
            i = faces[f, k]
            neighbours[fill[i]] = faces[f, (k + 1) % 3]
            fill[i] += 1
    split = np.zeros(count, np.bool_)
    for i in range(count):
        for p in range(starts[i], starts[i + 1]):
            if split[i]:
                break
            for q in range(starts[i], p):
                if _is_between(vertices, neighbours[p], i, neighbours[q], tolerance):
                    split[i] = True
                    break
    return split


@kernel
def _is_between(vertices: Floats, a: int, i: int, b: int, tolerance: float) -> bool:
    ux, uy, uz = (
        vertices[a, 0] - vertices[i, 0],
        vertices[a, 1] - vertices[i, 1],
        vertices[a, 2] - vertices[i, 2],
    )
    vx, vy, vz = (
        vertices[b, 0] - vertices[i, 0],
        vertices[b, 1] - vertices[i, 1],
        vertices[b, 2] - vertices[i, 2],
    )
    to, away = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    ahead = ux * vx + uy * vy + uz * vz
    if ahead >= 0.0 or ahead * ahead < STRAIGHT_COSINE * STRAIGHT_COSINE * to * away:
        return False
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    whole = to + away - 2.0 * ahead
    return bool(x * x + y * y + z * z <= tolerance * tolerance * whole)
