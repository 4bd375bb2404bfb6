"""Normals by region: planes keep theirs, strips get theirs from the turns at their rulings, and jets give the others.

No normal is averaged across the border of a plane or strip; a surface that meets a plane smoothly has the plane's normal there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index, split_corners
from ebamcheck.surface.jets import corners_by, jets
from ebamcheck.surface.regions import FREEFORM, LIKE, PLANE, STRIP, Borders, Regions


class RegionNormals(NamedTuple):
    """Normals at the corners of facets."""

    rows: Index  # (F, 3) row, in normals, of each corner of each facet
    normals: Floats  # (rows, 3) unit normals
    noise: Floats  # (rows,) residual of the jet at the vertices about, mm; NaN in planes and strips
    fans: Index  # (F, 3) smooth fan of each corner


def region_normals(part: Part, twin: Index, regions: Regions) -> RegionNormals:
    """Find the normals at all corners of facets; `twin` is -1 at creases."""
    vertices, faces = part.vertices, part.faces
    label, kind = regions.groups.label, regions.kind
    seen = kind[label] != PLANE
    sectors = split_corners(faces, twin)
    count = int(sectors.max(initial=-1)) + 1
    facet_normals = regions.groups.normals[label]
    means = _means(vertices, faces, facet_normals, seen, sectors, count)
    corner = np.repeat(seen, 3)
    cosines = np.einsum("ij,ij->i", np.repeat(facet_normals, 3, axis=0), means[sectors.reshape(-1)])
    least = np.ones(count)
    np.minimum.at(least, sectors.reshape(-1)[corner], cosines[corner])
    found = jets(corners_by(vertices, faces, sectors, seen), means, least)
    a, b = np.repeat(label, 3), label[twin // 3]
    inner = (twin != NO_TWIN) & ((a == b) | ((kind[a] == FREEFORM) & (kind[b] == FREEFORM)))
    rows = split_corners(faces, np.where(inner, twin, NO_TWIN).astype(twin.dtype))
    row_count = int(rows.max(initial=-1)) + 1
    strips = _strip_normals(twin, regions, found.normals[sectors], rows, row_count)
    normals = _put_together(regions, sectors, found.normals, rows, strips, count)
    noise = np.full(row_count, np.nan)
    free = np.repeat(kind[label] == FREEFORM, 3)
    noise[rows.reshape(-1)[free]] = found.noise[sectors.reshape(-1)[free]]
    return RegionNormals(rows, normals, noise, sectors)


def _means(vertices: Floats, faces: Index, facet_normals: Floats, seen: Bools, sectors: Index, count: int) -> Floats:
    """Mean normals (S, 3) of the facets that are of no plane, weighed by angle; 0 where there are none."""
    corners = vertices[faces]
    p, q = np.roll(corners, -1, axis=1) - corners, np.roll(corners, -2, axis=1) - corners
    angle = np.arctan2(np.linalg.norm(np.cross(p, q), axis=2), (p * q).sum(axis=2)) * seen[:, None]
    weighed = angle[:, :, None] * facet_normals[:, None]
    return _unit(_summed(sectors.reshape(-1), weighed.reshape(-1, 3), count))


def _summed(rows: Index, vectors: Floats, count: int) -> Floats:
    """Sums (count, 3) of vectors by row."""
    return np.stack([np.bincount(rows, vectors[:, axis], minlength=count) for axis in range(3)], axis=1)


def _unit(vectors: Floats) -> Floats:
    """Unit vectors; 0 stays."""
    lengths = np.linalg.norm(vectors, axis=1)
    return np.asarray(vectors / np.where(lengths > 0.0, lengths, 1.0)[:, None])


def _between(n: Floats, m: Floats, share: Floats) -> Floats:
    """Unit normals turned from n towards m (each (k, 3)) by a share of the angle between them; backward where it is negative."""
    angle = np.arccos(np.clip((n * m).sum(axis=1), -1.0, 1.0))
    sine = np.sin(np.maximum(angle, 1e-7))
    turned = (np.sin((1.0 - share) * angle) / sine)[:, None] * n + (np.sin(share * angle) / sine)[:, None] * m
    return np.where((angle < 1e-7)[:, None], n, _unit(turned))


def _across(normals: Floats, along: Floats) -> Floats:
    """Normals less their part along unit vectors."""
    return np.asarray(normals - (normals * along).sum(axis=1)[:, None] * along)


def _strip_normals(twin: Index, regions: Regions, curved: Floats, rows: Index, row_count: int) -> Floats:
    """Sums of normals (rows, 3) at the corners of strips, by their rulings; 0 elsewhere. `curved` (F, 3, 3) are the jets'.

    Between two strips of a circle the normal turns by the share of each in their width. At a sharp border along the
    rulings it goes on as it came. Corners that lie on no ruling take the jet's normal, less its part along the rulings.
    """
    groups, borders, kind = regions.groups, regions.borders, regions.kind
    label, width, normals, direction = groups.label, borders.width, groups.normals, borders.along
    mine, other = np.repeat(label, 3), label[twin // 3]
    link = (twin != NO_TWIN) & (mine != other) & (width < LIKE * width[twin])
    kinds = kind[mine], kind[other]
    share = np.where(kinds[1] == PLANE, 1.0, width / np.maximum(width + width[twin], 1e-300))
    ruled = np.flatnonzero(link & (kinds[0] == STRIP) & (kinds[1] != FREEFORM))
    ends = _between(normals[mine[ruled]], normals[other[ruled]], share[ruled])
    free = np.flatnonzero(link & (kinds[0] == STRIP) & (kinds[1] == FREEFORM))
    sharp = np.flatnonzero((twin == NO_TWIN) & (kinds[0] == STRIP))
    beyond = _ruling_along(sharp, mine, link, borders)
    sharp, beyond = sharp[beyond >= 0], beyond[beyond >= 0]
    known = kinds[1][beyond] != FREEFORM
    sharp, beyond = sharp[known], beyond[known]
    goes_on = _between(normals[mine[sharp]], normals[other[beyond]], -share[beyond])
    flat, jet = rows.reshape(-1), curved.reshape(-1, 3)
    following = 3 * (np.arange(flat.size) // 3) + (np.arange(flat.size) + 1) % 3
    places = [ruled, following[ruled], sharp, following[sharp], free, following[free]]
    vectors = [ends, ends, goes_on, goes_on]
    vectors += [_across(jet[corner], direction[free]) for corner in places[4:]]
    sums = _summed(flat[np.concatenate(places)], np.concatenate(vectors), row_count)
    bare = np.flatnonzero((kinds[0] == STRIP) & (sums[flat] == 0.0).all(axis=1))
    links = borders.half_edges[link[borders.half_edges]]
    of_group = np.full(len(kind), -1)
    of_group[mine[links][::-1]] = links[::-1]
    first = of_group[mine[bare]]
    sums[flat[bare]] = np.where((first >= 0)[:, None], _across(jet[bare], direction[first]), jet[bare])
    return sums


def _ruling_along(sharp: Ints, mine: Index, link: Bools, borders: Borders) -> Ints:
    """The first ruling of its strip along each sharp half-edge; -1 for none."""
    edge, ruling = borders.of_groups(mine[sharp])
    # Within 26 degrees of the rulings a border runs along these, else across them.
    along = np.abs((borders.along[sharp[edge]] * borders.along[ruling]).sum(axis=1)) >= 0.9
    fits = np.flatnonzero(along & link[ruling])[::-1]
    found = np.full(sharp.size, -1, np.int64)
    found[edge[fits]] = ruling[fits]
    return found


def _put_together(regions: Regions, sectors: Index, curved: Floats, rows: Index, strips: Floats, count: int) -> Floats:
    """Normals of all rows: of planes and strips their own, of other facets those of what they touch, or else the jets'."""
    label, kind = regions.groups.label, regions.kind
    sector, row, group = sectors.reshape(-1), rows.reshape(-1), np.repeat(label, 3)
    flat, ruled = kind[group] == PLANE, kind[group] == STRIP
    low, high = np.full(count, len(kind)), np.full(count, -1)
    np.minimum.at(low, sector[flat], group[flat])
    np.maximum.at(high, sector[flat], group[flat])
    of_strip, agree = np.zeros((count, 3)), np.ones(count, np.bool_)
    unit = _unit(strips)
    of_strip[sector[ruled]] = unit[row[ruled]]
    # If the normals of rulings that meet at a vertex differ by more than 5 degrees the jet decides.
    apart = (unit[row[ruled]] * of_strip[sector[ruled]]).sum(axis=1) < 0.996
    agree[sector[ruled][apart]] = False
    agree &= (of_strip != 0.0).any(axis=1)
    of_sector = np.where(agree[:, None], of_strip, curved)
    one_plane = low == high
    of_sector[one_plane] = regions.groups.normals[low[one_plane]]
    normals = np.zeros((len(strips), 3))
    normals[row] = of_sector[sector]
    normals[row[ruled]] = unit[row[ruled]]
    normals[row[flat]] = regions.groups.normals[group[flat]]
    return _unit(normals)
