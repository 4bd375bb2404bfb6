"""Cuts of the stencil backend beside exact sections, for its tests."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck_stencil import Stencil
from ebamcheck_stencil.crossings import empty_bitmap, flip, flips_by_layer
from ebamcheck_stencil.literal import LiteralSlices

PROBE = Stencil().probe()
gl = [pytest.mark.gl, pytest.mark.skipif(not PROBE.available, reason=f"stencil: {PROBE.why}")]
BOTH_MODES = pytest.mark.parametrize("mode", ["draw-once", "literal"])


def cut(mesh, heights, **settings) -> Layers:
    part = mesh if isinstance(mesh, Part) else from_arrays(*mesh)
    with Stencil().prepare(part, Stencil.Settings(**settings)) as prepared:
        return prepared.slice(np.asarray(heights, float))


def as_image(bitmap, view):
    """The bitmap as an image (height, width), row 0 at the least y."""
    bits = np.unpackbits(bitmap.astype("<u8").view(np.uint8), bitorder="little")
    return bits.reshape(view.height_px, view.stride_px)[:, : view.width_px].astype(np.bool_)


def image_at(prepared, height_mm):
    """Image (height, width) of the section of a prepared part at a height, row 0 at the least y."""
    height = np.array([float(height_mm)])
    bitmap = empty_bitmap(prepared._view)
    if isinstance(prepared, LiteralSlices):
        assert sum(prepared._draw(height, bitmap[None, :])) == 1
    else:
        flip(bitmap, flips_by_layer(prepared._crossings, height).pixels)
    return as_image(bitmap, prepared._view)


def bound(mesh, **settings) -> float:
    return Stencil().error_bound_mm(from_arrays(*mesh), Stencil.Settings(**settings))


def exact_section(mesh, height):
    """Section of one closed body by polygonising the exact cuts of its facets at a generic height."""
    vertices, faces = mesh
    segments = []
    for face in faces:
        cuts = []
        for a, b in zip(face, np.roll(face, -1), strict=True):
            low, high = sorted((a, b))
            za, zb = vertices[low, 2], vertices[high, 2]
            if (za <= height) != (zb <= height):
                t = (height - za) / (zb - za)
                cuts.append(tuple(vertices[low, :2] + t * (vertices[high, :2] - vertices[low, :2])))
        if cuts:
            segments.append(cuts)
    region = shapely.Polygon()
    for polygon in shapely.get_parts(shapely.polygonize([shapely.LineString(s) for s in segments])):
        region = region.symmetric_difference(shapely.Polygon(polygon.exterior))
    return region


def region_of(layers: Layers, k: int):
    return shapely.union_all(layers.polygons(k))


def breach(found, exact, r) -> float:
    """Area, mm2, by which two regions differ deeper than `r`: 0 where the promise is kept."""
    arcs = {"quad_segs": 64}
    return (
        exact.buffer(-1.001 * r, **arcs).difference(found).area
        + found.difference(exact.buffer(1.001 * r, **arcs)).area
    )


def same(a: Layers, b: Layers) -> bool:
    columns = ("heights", "points", "ring_starts", "layer_starts", "closed")
    return all(np.array_equal(getattr(a, c), getattr(b, c)) for c in columns)


def _fine_points(region):
    return shapely.get_coordinates(shapely.segmentize(region.boundary, 0.01))
