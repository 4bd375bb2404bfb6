"""Sections of closed meshes by plain means, as an oracle for slicers: segments, polygonize, winding by hand."""

from __future__ import annotations

import numpy as np
import shapely

from ebamcheck.mesh.part import Part, from_arrays


def prism(outline: shapely.Polygon, low: float, high: float) -> Part:
    """Draw a polygon with holes out along z."""
    outline = shapely.orient_polygons(outline)
    rings = [shapely.get_coordinates(r)[:-1] for r in (outline.exterior, *outline.interiors)]
    flat = np.concatenate(rings)
    index = {tuple(p): k for k, p in enumerate(flat.tolist())}
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(outline))
    corners = [shapely.get_coordinates(shapely.orient_polygons(t))[:3] for t in triangles]
    lid = np.array([[index[tuple(p)] for p in c.tolist()] for c in corners])
    n = len(flat)
    faces = [lid[:, ::-1], lid + n]
    base = 0
    for ring in rings:
        i = base + np.arange(len(ring))
        j = base + (np.arange(len(ring)) + 1) % len(ring)
        faces += [np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)]
        base += len(ring)
    vertices = np.concatenate([np.column_stack([flat, np.full(n, z)]) for z in (low, high)])
    return from_arrays(vertices, np.concatenate(faces), "prism")


def segments(part: Part, z: float) -> np.ndarray:
    """Directed segments (S, 2, 2) of the plane z = h + 0, material on the left."""
    found = []
    for triangle in part.triangles:
        below = triangle[:, 2] <= z
        if below.all() or not below.any():
            continue
        ends = {}
        for k in range(3):
            a, b = triangle[k], triangle[(k + 1) % 3]
            if below[k] != below[(k + 1) % 3]:
                low, high = (a, b) if below[k] else (b, a)
                t = (z - low[2]) / (high[2] - low[2])
                ends[bool(below[k])] = low[:2] + t * (high[:2] - low[:2])
        found.append((ends[False], ends[True]))
    return np.array(found).reshape(-1, 2, 2)


def winding(cut: np.ndarray, x: float, y: float) -> int:
    """Winding number of a closed set of directed segments about a point."""
    (x0, y0), (x1, y1) = cut[:, 0].T, cut[:, 1].T
    side = (x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)
    return int(((y0 <= y) & (y1 > y) & (side > 0)).sum() - ((y1 <= y) & (y0 > y) & (side < 0)).sum())


def exact_section(part: Part, z: float) -> shapely.Geometry:
    """Region of positive winding in the plane z = h + 0."""
    cut = segments(part, z)
    if not len(cut):
        return shapely.Polygon()
    lines = shapely.node(shapely.multilinestrings(shapely.linestrings(cut)))
    cells = shapely.get_parts(shapely.polygonize([lines]))
    inside = [c for c in cells if winding(cut, *shapely.get_coordinates(c.representative_point())[0]) > 0]
    return shapely.union_all(inside)


def depth_beyond(found: shapely.Geometry, true: shapely.Geometry, bound_mm: float) -> float:
    """Area by which `found` breaks its promise: true eroded lies in found, found in true dilated."""
    lost = true.buffer(-bound_mm, quad_segs=32).difference(found)
    gained = found.difference(true.buffer(bound_mm, quad_segs=32))
    return float(lost.area + gained.area)
