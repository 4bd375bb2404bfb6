"""Exact surfaces of a mesh: facets whose vertices lie on one quadric or torus, to the rounding of their file.

Where one is found, the part's surface between the vertices is known by formula, however the mesh divides it, and need not be
estimated from normals.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, kernel
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index, split_corners
from ebamcheck.surface.exact_forms import (
    FLAT,
    SIDE,
    SIZE,
    form_row,
    signed_distance,
    signed_distances,
    told_forms,
)
from ebamcheck.surface.planes import connected
from ebamcheck.surface.regions import PLANE, STRIP, Regions

NO_SURFACE = -1


class ExactSurfaces(NamedTuple):
    """Exact surfaces of a mesh, and the planes beside them."""

    label: Index  # (F,) surface of each facet; NO_SURFACE for none
    rows: Floats  # (S, SIZE) surfaces, in the layout of exact_forms


def exact_surfaces(part: Part, twin: Index, across: Index, regions: Regions, typical: float) -> ExactSurfaces:
    """Find the exact surfaces of a mesh, and the planes beside them.

    `twin` (3 F,) is the half-edge across each, -1 at creases; `across` the same at creases, too; `typical` the median sagitta of
    the mesh, from its dihedral angles, mm.
    """
    # Long facets of scattered points are as far as 25 sagittas from their surface.
    return _Search(part, twin, across, regions, 25.0 * typical).run()


class _Search:
    """State of the search for exact surfaces: what is found, and the planar groups that it has taken."""

    def __init__(self, part: Part, twin: Index, across: Index, regions: Regions, largest_mm: float) -> None:
        groups, vertices, faces = regions.groups, part.vertices, part.faces
        told = told_corners(vertices, faces, groups.label, split_corners(faces, twin), regions.tolerance_mm)
        of_groups = groups.label, groups.starts, groups.facets, groups.normals
        self.ground = _Ground(vertices, faces, twin, *of_groups, told)
        self.across, self.kind, self.areas = across, regions.kind, groups.areas
        # Errors of a fitted position and size add to those of the vertices.
        self.tolerance_mm, self.largest_mm = 3.0 * regions.tolerance_mm, largest_mm
        self.middles: Floats = vertices[faces].mean(axis=1)
        self.taken: Bools = np.zeros(len(groups.normals), np.bool_)
        self.of_group = np.full(len(groups.normals), NO_SURFACE, np.int32)
        self.rows: list[Floats] = []
        self.sagittas: list[float] = []

    def run(self) -> ExactSurfaces:
        """Try each smooth piece of one kind; slivers beside a surface, whose normals say nothing, join it."""
        failed = 0
        for piece in self._pieces():
            failed += not self._try(piece)
            if failed >= 1000:  # a noisy mesh has very many
                break
        label = self.of_group[self.ground.label]
        rows = np.array(self.rows).reshape(-1, SIZE)
        while self._absorb(label, rows):
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
            middle = ground.vertices[np.unique(ground.faces[facets])].mean(axis=0)
            row = form_row(FLAT, middle, ground.normals[group])
            row[SIDE] = 1.0
            label[facets] = number
            found.append(row[None])
        return ExactSurfaces(label, np.concatenate(found))

    def _pieces(self) -> Iterator[Index]:
        """Smooth pieces of groups of one kind, the largest first."""
        ground = self.ground
        half = np.flatnonzero(ground.twin != NO_TWIN)
        a, b = ground.label[half // 3], ground.label[ground.twin[half] // 3]
        joined = (self.kind[a] == self.kind[b]) & (self.kind[a] != PLANE) & (a != b)
        piece = connected(a[joined], b[joined], len(self.kind))
        area = np.bincount(piece, self.areas)
        order = np.argsort(piece, kind="stable").astype(np.int32)
        pieces = np.split(order, np.cumsum(np.bincount(piece))[:-1])
        for number in np.argsort(-area, kind="stable"):
            groups = pieces[number]
            if len(groups) > 1 and self.kind[groups[0]] != PLANE and not self.taken[groups[0]]:
                yield groups

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
        """Forms fitted to the told vertices of groups (:mod:`ebamcheck.surface.exact_surfaces`), with their sides set."""
        ground = self.ground
        group, place = each_of(ground.starts[groups + 1] - ground.starts[groups])
        facets = ground.facets[ground.starts[groups][group] + place].astype(np.int64)
        corners = np.unique(ground.faces[facets][ground.told[facets]])
        normals = ground.normals[ground.label[facets]]
        places = self.middles[facets]
        straight = bool((self.kind[groups] == STRIP).all())
        vertices = ground.vertices[corners]
        for row in told_forms(vertices, places, normals, self.tolerance_mm, straight):
            gradients = signed_distances(row[None], places)[:, 1:]
            row[SIDE] = np.sign((gradients * normals).sum(axis=1).mean())
            if row[SIDE] != 0.0:
                yield row

    def _grown(self, row: Floats, groups: Index) -> tuple[Floats, Index, float] | None:
        """Grow a surface and refit it until it takes no more groups; return surface, groups and greatest sagitta.

        None where a fit or a check fails.
        """
        sagittas = np.empty(len(self.taken))
        before = 0
        for _ in range(6):  # it usually stops growing after two or three
            tolerance_mm, largest_mm = self.tolerance_mm, self.largest_mm
            if _grown_from(self.ground, groups, self.taken, row, tolerance_mm, largest_mm, sagittas) < 2:
                return None
            largest = _without_flat_sides(sagittas[sagittas >= 0.0])
            if np.isfinite(largest):
                seeds = groups[sagittas[groups] >= 0.0]
                _grown_from(self.ground, seeds, self.taken, row, self.tolerance_mm, largest, sagittas)
            groups = np.flatnonzero(sagittas >= 0.0).astype(np.int32)
            if len(groups) <= before:
                return row, groups, float(sagittas.max())
            before = len(groups)
            refitted = next(self._forms(groups), None)
            if refitted is None or refitted[0] != row[0]:
                return None
            row = refitted
        return None

    def _absorb(self, label: Index, rows: Floats) -> int:
        """Give facets beside a surface to it that stand off no farther than its own; how many were given."""
        ground = self.ground
        free = (label == NO_SURFACE) & (self.kind[ground.label] != PLANE)
        half = np.flatnonzero(free.repeat(3) & (self.across != NO_TWIN))
        half = half[label[self.across[half] // 3] != NO_SURFACE]
        if not half.size:
            return 0
        facet, surface = half // 3, label[self.across[half] // 3]
        corners = ground.vertices[ground.faces[facet]]
        middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
        places = np.concatenate([corners, middles, self.middles[facet][:, None]], axis=1)
        off = signed_distances(np.repeat(rows[surface], 7, axis=0), places.reshape(-1, 3))[:, 0]
        largest = np.array(self.sagittas)[surface][:, None]
        most = np.where(ground.told[facet], self.tolerance_mm, largest)
        off = np.abs(off).reshape(-1, 7)
        taken = (off[:, :3] <= most).all(axis=1) & (off[:, 3:] <= largest).all(axis=1)
        facet, first = np.unique(facet[taken], return_index=True)
        label[facet] = surface[taken][first]
        return len(facet)


def _without_flat_sides(sagittas: Floats) -> float:
    """Largest distance of a group from the surface, mm: that below the first fourfold leap in the upper half, if any.

    Groups beyond it are flat sides that only end on the surface.
    """
    upper = np.sort(sagittas)[len(sagittas) // 2 :]
    leaps = np.flatnonzero(upper[1:] > 4.0 * np.maximum(upper[:-1], 1e-9))
    return float(1.01 * upper[leaps[0]]) if leaps.size else np.inf


# -- growing: from some planar groups of facets on a surface to all connected groups that lie on it ---------------


class _Ground(NamedTuple):
    """A mesh and its planar groups, in the form that growth reads."""

    vertices: Floats
    faces: Index
    twin: Index  # (3 F,) opposite half-edge where the surface continues smoothly; else -1
    label: Index  # (F,) group of each facet
    starts: Index  # (G + 1,) first facet of each group in facets
    facets: Index
    normals: Floats  # (G, 3) unit normals
    told: Bools  # (F, 3) corners that lie on the surface for certain (exact_surfaces)


@kernel
def _grown_from(
    ground: _Ground,
    seeds: Index,
    taken: Bools,
    row: Floats,
    tolerance: float,
    largest: float,
    sagittas: Floats,
) -> int:
    """Count the groups on the surface `row` that are reached from seed groups over groups on it.

    Groups that are `taken` (G,) belong to other surfaces. Told corners may lie off the surface by `tolerance`, and facets stand
    off it by `largest`, mm; `sagittas` (G,) takes how far each group that is found stands off, -1 for others.
    """
    sagittas[:] = -1.0
    stack = np.empty(len(taken), np.int32)
    seen = taken.copy()
    depth = count = 0
    for group in seeds:
        if not seen[group]:
            seen[group] = True
            stack[depth] = group
            depth += 1
    place = np.empty(3)
    while depth > 0:
        depth -= 1
        group = stack[depth]
        told = 0
        off = 0.0
        first, last = ground.starts[group], ground.starts[group + 1]
        for at in range(first, last):
            f = ground.facets[at]
            # Of each facet the corners, the middles of its edges, and its own.
            for k in range(7):
                a, b = ground.faces[f, k % 3], ground.faces[f, (k + 1) % 3]
                for axis in range(3):
                    p, q = ground.vertices[a, axis], ground.vertices[b, axis]
                    place[axis] = p if k < 3 else 0.5 * (p + q)
                    if k == 6:
                        place[axis] = (p + q + ground.vertices[ground.faces[f, 2], axis]) / 3.0
                found = signed_distance(row, place[0], place[1], place[2])
                away = abs(found[0])
                if k < 3 and ground.told[f, k]:
                    told += 1
                    away = away if away <= tolerance else np.inf
                elif k == 6:
                    n = ground.normals[group]
                    facing = (found[1] * n[0] + found[2] * n[1] + found[3] * n[2]) * row[SIDE]
                    away = away if facing >= 0.7 else np.inf  # some 45 degrees, about the crease angle
                off = max(off, away)
            if not off <= largest:
                break
        # Three corners of a group must be told, of a single facet two.
        if not off <= largest or off == np.inf or told < (3 if last - first > 1 else 2):
            continue
        sagittas[group] = off
        count += 1
        for at in range(first, last):
            for k in range(3):
                h = ground.twin[3 * ground.facets[at] + k]
                if h != NO_TWIN and not seen[ground.label[h // 3]]:
                    seen[ground.label[h // 3]] = True
                    stack[depth] = ground.label[h // 3]
                    depth += 1
    return count


# -- Told corners: vertices that lie on the surface that a mesh approximates, as far as its facets can tell ----
#
# Only vertices at which several planar groups meet smoothly lie on the surface for certain. A vertex inside
# one group, or at the outer border of only one, lies in that group's plane, and may be as far from the
# surface as the facet is: Boolean operations on meshes leave such vertices. So may a vertex on the line
# between two of its neighbours, which merely splits an edge.


def told_corners(vertices: Floats, faces: Index, label: Index, sectors: Index, tolerance_mm: float) -> Bools:
    """Corners of facets (F, 3) whose vertices lie on the surface: `label` (F,) is each facet's planar group, `sectors` (F, 3) each
    corner's fan.

    A vertex within `tolerance_mm` of the line of two neighbours is on it.
    """
    count = int(sectors.max(initial=-1)) + 1
    flat, groups = sectors.reshape(-1), np.repeat(label, 3)
    low, high = np.full(count, np.iinfo(np.int64).max), np.full(count, -1)
    np.minimum.at(low, flat, groups)
    np.maximum.at(high, flat, groups)
    return np.asarray((high > low)[sectors] & ~_split_edges(vertices, faces, tolerance_mm)[faces])


def _split_edges(vertices: Floats, faces: Index, tolerance: float) -> Bools:
    """Vertices (V,) that lie on the line between two of their neighbours."""
    corners = faces.reshape(-1)
    ahead = np.roll(faces, -1, axis=1).reshape(-1)
    order = np.argsort(corners, kind="stable")
    sizes = np.bincount(corners, minlength=len(vertices))
    split = np.zeros(len(vertices), np.bool_)
    place = each_of(sizes)[1]
    # Each neighbour with the one `step` places before it, for all vertices at once.
    for step in range(1, int(sizes.max(initial=0))):
        k = np.flatnonzero((place >= step) & ~split[corners[order]])
        i = corners[order[k]]
        u = vertices[ahead[order[k]]] - vertices[i]
        v = vertices[ahead[order[k - step]]] - vertices[i]
        to, away, along = (np.einsum("ij,ij->i", a, b) for a, b in ((u, u), (v, v), (u, v)))
        # Two edges may be one line if the cosine of the angle between them is less than -0.99.
        straight = (along < 0.0) & (along * along >= 0.99 * 0.99 * to * away)
        across = np.cross(u, v)
        off = np.einsum("ij,ij->i", across, across)
        split[i[straight & (off <= tolerance * tolerance * (to + away - 2.0 * along))]] = True
    return split
