"""Normals by region: planes keep theirs, strips get theirs from the turns at their rulings, and jets give the others.

No normal is averaged across the border of a plane or strip; a surface that meets a plane smoothly has the plane's normal there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.regions.borders import Borders, edge_direction
from ebamcheck.curves.regions.jets import Corners, jets
from ebamcheck.curves.regions.planes import PlanarGroups
from ebamcheck.curves.regions.segmentation import FREEFORM, PLANE, STRIP, Kinds, Regions, is_link
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index, split_corners
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats

ALONG_COSINE = 0.9
"""Least cosine between a sharp border of a strip and its rulings for the border to run along these; else it runs across them."""

AGREE_COSINE = 0.996
"""Least cosine between the normals of rulings that meet at a vertex, 5 degrees; if they differ more, the jet decides."""


class RegionNormals(NamedTuple):
    """Normals at the corners of facets."""

    rows: Index
    """(F, 3) row, in `normals`, of each corner of each facet."""
    normals: Floats
    """(rows, 3) unit normals."""
    noise: Floats
    """(rows,) residual of the jet at the vertices about, mm; NaN in planes and strips."""
    fans: Index
    """(F, 3) smooth fan of each corner."""


class _Mesh(NamedTuple):
    """A mesh with its regions."""

    vertices: Floats
    faces: Index
    twin: Index
    groups: PlanarGroups
    borders: Borders
    kind: Kinds


def region_normals(part: Part, twin: Index, regions: Regions) -> RegionNormals:
    """Find the normals at all corners of facets; `twin` is -1 at creases."""
    vertices, faces = part.vertices, part.faces
    label, kind = regions.groups.label, regions.kind
    seen = kind[label] != PLANE
    sectors = split_corners(faces, twin)
    count = int(sectors.max(initial=-1)) + 1
    facet_normals = regions.groups.normals[label]
    means = _means(vertices, faces, facet_normals, seen, sectors, count)
    found = jets(
        vertices,
        faces,
        _corners(sectors, count, seen),
        means,
        _least_cosines(facet_normals, seen, sectors, means),
    )
    rows = split_corners(faces, _inner_twins(twin, label, kind))
    row_count = int(rows.max(initial=-1)) + 1
    strips = _strip_normals(
        _Mesh(vertices, faces, twin, regions.groups, regions.borders, kind),
        sectors,
        found.normals,
        rows,
        row_count,
    )
    normals = _put_together(regions.groups, kind, sectors, found.normals, rows, strips, count)
    noise = np.full(row_count, np.nan)
    curved = (kind[label] == FREEFORM)[:, None] & np.ones((1, 3), np.bool_)
    noise[rows[curved]] = found.noise[sectors[curved]]
    return RegionNormals(rows, normals, noise, sectors)


def _corners(sectors: Index, count: int, seen: Bools) -> Corners:
    flat = sectors.reshape(-1)
    starts = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=count))]).astype(np.int32)
    order = np.argsort(flat, kind="stable").astype(np.int32)
    return Corners(sectors, starts, order, seen)


@kernel
def _inner_twins(twin: Index, label: Index, kind: Kinds) -> Index:
    """Twins within one group, and between freely curved facets."""
    result = twin.copy()
    for h in range(twin.size):
        if twin[h] == NO_TWIN:
            continue
        a, b = label[h // 3], label[twin[h] // 3]
        if a != b and not (kind[a] == FREEFORM and kind[b] == FREEFORM):
            result[h] = NO_TWIN
    return result


@kernel
def _means(
    vertices: Floats, faces: Index, facet_normals: Floats, seen: Bools, sectors: Index, count: int
) -> Floats:
    """Mean normals (S, 3) of the facets that are of no plane, weighed by angle; 0 where there are none."""
    means = np.zeros((count, 3))
    for f in range(len(faces)):
        if not seen[f]:
            continue
        for k in range(3):
            a, b, c = vertices[faces[f, k]], vertices[faces[f, (k + 1) % 3]], vertices[faces[f, (k + 2) % 3]]
            px, py, pz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            qx, qy, qz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
            x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
            angle = np.arctan2(np.sqrt(x * x + y * y + z * z), px * qx + py * qy + pz * qz)
            for axis in range(3):
                means[sectors[f, k], axis] += angle * facet_normals[f, axis]
    for s in range(count):
        length = np.sqrt(np.sum(means[s] * means[s]))
        if length > 0.0:
            means[s] /= length
    return means


@kernel
def _least_cosines(facet_normals: Floats, seen: Bools, sectors: Index, means: Floats) -> Floats:
    """Cosine of the greatest angle between a sector's mean normal and that of one of its facets, (S,)."""
    result = np.ones(len(means))
    for f in range(len(sectors)):
        if seen[f]:
            for k in range(3):
                s = sectors[f, k]
                result[s] = min(result[s], _dot(facet_normals[f], means[s]))
    return result


@kernel
def _dot(a: Floats, b: Floats) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@kernel
def _between(n: Floats, m: Floats, share: float) -> Floats:
    """Unit normal turned from n towards m by a share of the angle between them; backward where it is negative."""
    angle = np.arccos(min(max(_dot(n, m), -1.0), 1.0))
    if angle < 1e-7:
        return n.copy()
    result = (np.sin((1.0 - share) * angle) * n + np.sin(share * angle) * m) / np.sin(angle)
    return np.asarray(result / np.sqrt(_dot(result, result)))


@kernel
def _strip_normals(
    mesh: _Mesh,
    sectors: Index,
    curved: Floats,
    rows: Index,
    row_count: int,
) -> Floats:
    """Sums of normals (rows, 3) at the corners of strips, by their rulings; 0 elsewhere.

    Between two strips of a circle the normal turns by the share of each in their width. At a sharp border along the
    rulings it goes on as it came.
    """
    vertices, faces, twin = mesh.vertices, mesh.faces, mesh.twin
    groups, borders, kind = mesh.groups, mesh.borders, mesh.kind
    sums = np.zeros((row_count, 3))
    for h in range(twin.size):
        f, k = h // 3, h % 3
        a = groups.label[f]
        if kind[a] != STRIP:
            continue
        if is_link(twin, groups.label, borders, h):
            g = twin[h]
            b = groups.label[g // 3]
            if kind[b] == FREEFORM:
                x, y, z = edge_direction(vertices, faces, h)
                for corner in (k, (k + 1) % 3):
                    n = curved[sectors[f, corner]]
                    along = n[0] * x + n[1] * y + n[2] * z
                    sums[rows[f, corner], 0] += n[0] - along * x
                    sums[rows[f, corner], 1] += n[1] - along * y
                    sums[rows[f, corner], 2] += n[2] - along * z
                continue
            share = 1.0 if kind[b] == PLANE else borders.width[h] / (borders.width[h] + borders.width[g])
            n = _between(groups.normals[a], groups.normals[b], share)
        elif twin[h] == NO_TWIN:
            n = _beyond(mesh, h)
            if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
                continue
        else:
            continue
        sums[rows[f, k]] += n
        sums[rows[f, (k + 1) % 3]] += n
    _fill_ends(mesh, sectors, curved, rows, sums)
    return sums


@kernel
def _beyond(mesh: _Mesh, h: int) -> Floats:
    """Normal of a strip at a sharp border along its rulings, by how it turns at the ruling on its other side; else 0."""
    vertices, faces, twin = mesh.vertices, mesh.faces, mesh.twin
    groups, borders, kind = mesh.groups, mesh.borders, mesh.kind
    group = groups.label[h // 3]
    x, y, z = edge_direction(vertices, faces, h)
    for place in range(borders.starts[group], borders.starts[group + 1]):
        k = borders.half_edges[place]
        if not is_link(twin, groups.label, borders, k):
            continue
        u, v, w = edge_direction(vertices, faces, k)
        if abs(x * u + y * v + z * w) < ALONG_COSINE:
            continue
        other = groups.label[twin[k] // 3]
        if kind[other] == FREEFORM:
            break
        mine, theirs = borders.width[k], borders.width[twin[k]]
        share = 1.0 if kind[other] == PLANE else mine / (mine + theirs)
        return _between(groups.normals[group], groups.normals[other], -share)
    return np.zeros(3)


@kernel
def _fill_ends(
    mesh: _Mesh,
    sectors: Index,
    curved: Floats,
    rows: Index,
    sums: Floats,
) -> None:
    """Corners of strips that lie on no ruling take the jet's normal, less its part along the rulings."""
    vertices, faces, twin = mesh.vertices, mesh.faces, mesh.twin
    groups, borders, kind = mesh.groups, mesh.borders, mesh.kind
    for f in range(len(faces)):
        group = groups.label[f]
        if kind[group] != STRIP:
            continue
        for k in range(3):
            if sums[rows[f, k], 0] != 0.0 or sums[rows[f, k], 1] != 0.0 or sums[rows[f, k], 2] != 0.0:
                continue
            n = curved[sectors[f, k]].copy()
            for place in range(borders.starts[group], borders.starts[group + 1]):
                h = borders.half_edges[place]
                if is_link(twin, groups.label, borders, h):
                    x, y, z = edge_direction(vertices, faces, h)
                    along = n[0] * x + n[1] * y + n[2] * z
                    n[0] -= along * x
                    n[1] -= along * y
                    n[2] -= along * z
                    break
            sums[rows[f, k]] = n


@kernel
def _put_together(
    groups: PlanarGroups,
    kind: Kinds,
    sectors: Index,
    curved: Floats,
    rows: Index,
    strips: Floats,
    count: int,
) -> Floats:
    """Normals of all rows."""
    plane = np.full(count, -1, np.int32)
    ruled, agree = np.zeros((count, 3)), np.ones(count, np.bool_)
    for f in range(len(sectors)):
        group = groups.label[f]
        for k in range(3):
            s = sectors[f, k]
            if kind[group] == PLANE:
                plane[s] = group if plane[s] < 0 or plane[s] == group else len(kind)
            elif kind[group] == STRIP:
                n = strips[rows[f, k]]
                length = max(np.sqrt(_dot(n, n)), 1e-300)
                if _dot(ruled[s], ruled[s]) > 0.0 and _dot(n, ruled[s]) < AGREE_COSINE * length:
                    agree[s] = False
                ruled[s] = n / length
    normals = np.zeros((len(strips), 3))
    for f in range(len(sectors)):
        group = groups.label[f]
        for k in range(3):
            s, row = sectors[f, k], rows[f, k]
            if kind[group] == PLANE:
                normals[row] = groups.normals[group]
            elif kind[group] == STRIP:
                normals[row] = strips[row]
            elif 0 <= plane[s] < len(kind):
                normals[row] = groups.normals[plane[s]]
            elif agree[s] and _dot(ruled[s], ruled[s]) > 0.0:
                normals[row] = ruled[s]
            else:
                normals[row] = curved[s]
    for row in range(len(normals)):
        length = np.sqrt(_dot(normals[row], normals[row]))
        if length > 0.0:
            normals[row] /= length
    return normals


# -- Noise of a mesh: whether its vertices are farther from the surface than lifting could gain ----------------


ROUGH = 1.5
"""Ratio of the noise to the sagitta of the edges about from which no lift gains anything. Vertices with an error s leave a
contour point two thirds of s off; their normals lift it by about a quarter of s to a wrong place, and demand such sagittas even
where there are none."""


def rough_rows(vertices: Floats, faces: Index, found: RegionNormals) -> Bools:
    """Rows of normals (rows,) whose noise exceeds what lifting could gain: all of a mesh, or none.

    Medians over the freely curved facets decide: a single residual of few degrees of freedom tells little, and the noise of a
    mesh comes from one scanner.
    """
    told = np.isfinite(found.noise)
    rough = False
    if told.any():
        sagitta = _sagittas(vertices, faces, found.rows, found.normals)[told]
        rough = bool(np.median(found.noise[told]) > ROUGH * np.median(sagitta))
    return np.full(len(found.noise), rough)


@kernel
def _sagittas(vertices: Floats, faces: Index, rows: Index, normals: Floats) -> Floats:
    """Mean sagitta (rows,) of the edges that end at a row, as its normal asks for them, mm."""
    total, count = np.zeros(len(normals)), np.zeros(len(normals))
    for f in range(len(faces)):
        for k in range(3):
            row = rows[f, k]
            for step in (1, 2):
                p, q = vertices[faces[f, (k + step) % 3]], vertices[faces[f, k]]
                off = 0.0
                for axis in range(3):
                    off += (p[axis] - q[axis]) * normals[row, axis]
                total[row] += 0.25 * abs(off)
                count[row] += 1.0
    return total / np.maximum(count, 1.0)
