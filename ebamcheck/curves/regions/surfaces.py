"""Surfaces of a part: its regions put together, with what a least-squares fit says of them.

Strips that go over into each other are one surface: a cylinder where their vertices lie on one to the tolerance, a cone
where all rulings meet in its tip, else a ruled surface. Freely curved facets are a sphere or a freeform patch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ebamcheck.curves.regions.segmentation import FREEFORM, PLANE, STRIP, Regions, find_regions
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index, edge_groups, twins
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.settings.curves import CurveSettings

SPARE = 3
"""Places beyond the unknowns of a fit, from which it is evidence: three points lie on one circle always."""

FIT = 3.0
"""Tolerances of a plane within which the vertices lie on a fitted surface; its own place and size take their share."""


KINDS = ("plane", "cylinder", "cone", "ruled", "sphere", "freeform")


@dataclass(frozen=True)
class Surface:
    """One surface of a part.

    Parameters
    ----------
    kind
        ``plane``, ``cylinder``, ``cone``, ``ruled``, ``sphere`` or ``freeform``.
    facets
        (n,) its facets.
    area_mm2
        Their area.
    size_mm
        Extents of its box.
    figure
        What the fit says: ``"radius 5 mm"``; empty without one.
    """

    kind: str
    facets: Ints
    area_mm2: float
    size_mm: tuple[float, float, float]
    figure: str = ""

    def as_dict(self) -> dict[str, Any]:
        """All but the list of facets, for JSON."""
        return {
            "kind": self.kind,
            "facets": len(self.facets),
            "area_mm2": self.area_mm2,
            "size_mm": self.size_mm,
            "figure": self.figure,
        }


MOST_LISTED = 40
"""Surfaces listed one by one; the rest is counted."""


def table(found: list[Surface]) -> str:
    """List surfaces by kind, then one by one, the largest first."""
    total = sum(s.area_mm2 for s in found)
    lines = []
    for kind in KINDS:
        of_kind = [s for s in found if s.kind == kind]
        if of_kind:
            area = sum(s.area_mm2 for s in of_kind)
            share = 100.0 * area / max(total, 1e-300)
            lines.append(f"{kind:10} {len(of_kind):6} regions {area:14.6g} mm2 {share:6.1f} %")
    lines.append("")
    for s in found[:MOST_LISTED]:
        size = " x ".join(f"{x:.4g}" for x in s.size_mm)
        lines.append(
            f"{s.kind:10} {s.area_mm2:12.6g} mm2 {len(s.facets):8} facets  {size} mm  {s.figure}".rstrip()
        )
    if len(found) > MOST_LISTED:
        lines.append(f"and {len(found) - MOST_LISTED} smaller ones")
    return "\n".join(lines)


def surfaces(part: Part, settings: CurveSettings) -> list[Surface]:
    """Find the surfaces of a part, the largest first."""
    groups = edge_groups(part.faces, len(part.vertices))
    twin = twins(part.vertices, part.faces, groups.half_edges, groups.starts)
    regions = find_regions(part, twin, settings)
    label = _connected(twin, regions)
    order = np.argsort(label, kind="stable")
    found = [
        _surface(part, regions, twin, facets)
        for facets in np.split(order, np.cumsum(np.bincount(label))[:-1])
        if len(facets)
    ]
    return sorted(found, key=lambda s: (-s.area_mm2, int(s.facets[0])))


def _connected(twin: Index, regions: Regions) -> Ints:
    """Number (F,) of the surface of each facet."""
    label, kind = regions.groups.label, regions.kind
    half = np.flatnonzero(twin != NO_TWIN)
    a, b = half // 3, twin[half] // 3
    joined = (label[a] == label[b]) | ((kind[label[a]] == kind[label[b]]) & (kind[label[a]] != PLANE))
    links = coo_matrix((np.ones(joined.sum()), (a[joined], b[joined])), (len(label), len(label)))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)


def _surface(part: Part, regions: Regions, twin: Index, facets: Ints) -> Surface:
    corners = part.vertices[part.faces[facets]]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    points = np.unique(corners.reshape(-1, 3), axis=0)
    x, y, z = np.ptp(points, axis=0).tolist()
    kind = regions.kind[regions.groups.label[facets[0]]]
    name, figure = "plane", ""
    if kind == FREEFORM:
        name, figure = _curved(points, FIT * regions.tolerance_mm)
    elif kind == STRIP:
        name, figure = _ruled(part, regions, twin, facets, points)
    return Surface(name, facets, float(area.sum()), (x, y, z), figure)


def _curved(points: Floats, allowed_mm: float) -> tuple[str, str]:
    """Sphere or freeform patch, by least squares."""
    if len(points) >= 4 + SPARE:
        middle = points.mean(axis=0)
        off = points - middle
        rows = np.column_stack([2.0 * off, np.ones(len(off))])
        solution = np.linalg.lstsq(rows, (off * off).sum(axis=1), rcond=None)[0]
        radii = np.linalg.norm(off - solution[:3], axis=1)
        if np.abs(radii - radii.mean()).max() <= allowed_mm:
            return "sphere", f"radius {radii.mean():.6g} mm"
    return "freeform", ""


def _rulings(part: Part, regions: Regions, twin: Index, facets: Ints) -> tuple[Floats, Floats]:
    """Starts and unit directions (n, 3) of the edges between two strips of a surface."""
    half = (3 * facets[:, None] + np.arange(3)).reshape(-1)
    half = half[twin[half] != NO_TWIN]
    label, kind = regions.groups.label, regions.kind
    a, b = label[half // 3], label[twin[half] // 3]
    half = half[(a != b) & (kind[a] == STRIP) & (kind[b] == STRIP)]
    start = part.vertices[part.faces[half // 3, half % 3]]
    along = part.vertices[part.faces[half // 3, (half % 3 + 1) % 3]] - start
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return start, along


def _ruled(part: Part, regions: Regions, twin: Index, facets: Ints, points: Floats) -> tuple[str, str]:
    """Cylinder, cone or another ruled surface."""
    allowed = FIT * regions.tolerance_mm
    start, along = _rulings(part, regions, twin, facets)
    if len(along) < 2:
        return "ruled", ""
    spread = np.linalg.svd(along)[2]
    axis = spread[0]
    reach = float(np.ptp(points, axis=0).max())
    if np.linalg.norm(np.cross(along, axis), axis=1).max() * reach <= 2.0 * allowed:
        across = np.unique(np.round(points @ spread[1:].T, 6), axis=0)
        radius, off = _circle(across)
        if len(across) >= 3 + SPARE and off <= allowed:
            return "cylinder", f"radius {radius:.6g} mm"
        return "ruled", ""
    # The tip is nearest to the lines of all rulings.
    projector = np.eye(3) - along[:, :, None] * along[:, None, :]
    tip = np.linalg.lstsq(projector.sum(axis=0), np.einsum("nij,nj->i", projector, start), rcond=None)[0]
    away = np.linalg.norm(np.einsum("nij,nj->ni", projector, start - tip), axis=1)
    outward = np.where(((start - tip) * along).sum(axis=1)[:, None] < 0.0, -along, along)
    normal = np.linalg.svd(outward - outward.mean(axis=0))[2][2]
    slope = np.abs(outward @ normal)
    far = np.linalg.norm(points - tip, axis=1).max()
    if len(along) >= 3 + SPARE and away.max() <= allowed and np.ptp(slope) * far <= 2.0 * allowed:
        return "cone", f"half angle {np.degrees(np.arccos(min(slope.mean(), 1.0))):.4g} degrees"
    return "ruled", ""


def _circle(points: Floats) -> tuple[float, float]:
    """Radius of the circle through points (n, 2) by least squares, and the farthest that one lies from it, mm."""
    off = points - points.mean(axis=0)
    rows = np.column_stack([2.0 * off, np.ones(len(off))])
    solution = np.linalg.lstsq(rows, (off * off).sum(axis=1), rcond=None)[0]
    radii = np.linalg.norm(off - solution[:2], axis=1)
    return float(radii.mean()), float(np.abs(radii - radii.mean()).max())
