"""Even-odd rule, for slicers whose rings have no direction: a point is solid if an odd number of rings encloses it."""

from __future__ import annotations

import numpy as np

from ebamcheck.errors import BackendFailed
from ebamcheck.kernels import Ints
from ebamcheck.layers.stack import Layers, canonical

INSIDE_RULE = "odd"  # inside rule that such a slicer declares


def directed_by_nesting(layers: Layers, tolerance_mm: float, name: str) -> Layers:
    """Orient rings by nesting; rings that cross by more than a tolerance are refused, as they do not show the solid."""
    _refuse_crossing(layers, tolerance_mm, name)
    return oriented_by_nesting(layers)


def oriented_by_nesting(layers: Layers) -> Layers:
    """Orient rings so that outer ones run counter-clockwise, those within them clockwise, and so on inwards; open paths stay."""
    odd = np.zeros(layers.closed.size, np.bool_)
    above = layers.parents.copy()
    while (above >= 0).any():
        odd ^= above >= 0
        above = np.where(above >= 0, layers.parents[above], -1)
    wrong = layers.closed & ((layers.ring_areas > 0.0) == odd)
    if not wrong.any():
        return layers
    sizes = np.diff(layers.ring_starts)
    rows = np.arange(len(layers.points))
    mirrored = np.repeat(layers.ring_starts[:-1] + layers.ring_starts[1:] - 1, sizes) - rows
    points = layers.points[np.where(np.repeat(wrong, sizes), mirrored, rows)]
    labels = {name: getattr(layers, name) for name in ("part", "direction", "backend", "settings")}
    return canonical(layers.heights, points, layers.ring_starts, layers.layer_starts, layers.closed, **labels)


def _refuse_crossing(layers: Layers, tolerance_mm: float, name: str) -> None:
    """Raise :class:`BackendFailed` if rings of a layer cross by more than a tolerance."""
    first, second = _near_pairs(layers)
    if not first.size:
        return
    import shapely

    used, index = np.unique(np.concatenate([first, second]), return_inverse=True)
    sizes = np.diff(layers.ring_starts)[used]
    ring = np.repeat(np.arange(used.size), sizes)
    start = np.cumsum(sizes) - sizes
    rows = np.arange(ring.size) - np.repeat(start, sizes) + np.repeat(layers.ring_starts[used], sizes)
    polygons = shapely.polygons(shapely.linearrings(layers.points[rows], indices=ring))
    shapely.prepare(polygons)
    a, b = polygons[index[: first.size]], polygons[index[first.size :]]
    crossing = shapely.overlaps(a, b)
    a, b = shapely.make_valid(a[crossing]), shapely.make_valid(b[crossing])
    allowed = tolerance_mm * np.minimum(shapely.length(a), shapely.length(b))
    common = shapely.area(shapely.intersection(a, b))
    deep = np.minimum(common, np.minimum(shapely.area(a), shapely.area(b)) - common) > allowed
    if deep.any():
        where = int(layers.ring_layer[first[np.flatnonzero(crossing)[deep][0]]])
        raise BackendFailed(
            f"{name}: rings cross at z = {layers.heights[where]:.9g} mm, where shells of the part overlap, and it does "
            "not tell which side of a ring is solid; unite the shells or use another backend"
        )


def _near_pairs(layers: Layers) -> tuple[Ints, Ints]:
    """Pairs of closed rings of one layer whose boxes overlap."""
    boxes, layer = layers.ring_bounds, layers.ring_layer
    most = int(np.diff(layers.layer_starts).max(initial=0))
    found: list[Ints] = [np.zeros((2, 0), np.int64)]
    for apart in range(1, most):
        r = np.flatnonzero(layer[apart:] == layer[:-apart])
        s = r + apart
        near = (boxes[r, :2] < boxes[s, 2:]).all(axis=1) & (boxes[s, :2] < boxes[r, 2:]).all(axis=1)
        near &= layers.closed[r] & layers.closed[s]
        found.append(np.stack([r[near], s[near]]))
    first, second = np.concatenate(found, axis=1)
    return first, second
