"""Where the solid that manifold3d builds differs from the mesh that it was given.

manifold3d repairs what it takes for degenerate: it swaps the common edge of two facets, and leaves out facets without area
and pairs of facets back to back. It does not report this and has no option against it. Sections there may be wrong by far more
than rounding, so the places are declared as doubtful.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.mesh.part import Part

if TYPE_CHECKING:
    from manifold3d import Manifold

MOST_REGIONS = 16  # most boxes declared; further ones are merged with their neighbours in height
# Least horizontal part of a group's unit normal: sections of a flatter group may move too far to be bounded
LEAST_SLOPE = 0.05
BOUND_MARGIN = 1.01  # factor on a bound, for rounding and the ends of the slab

Floats = NDArray[np.float64]
Keys = NDArray[np.uint64]


def doubtful_regions(
    vertices_mm: Floats, faces: NDArray[np.int32], placement: Placement, manifold: Manifold
) -> list[dict[str, Any]]:
    """Boxes around the facets that manifold3d changed, of those that it was given, as placed in the part.

    Of each ``box_mm``: xmin, ymin, zmin, xmax, ymax, zmax; ``why``: one line; ``bound_mm``: largest error of a contour
    there, if known.
    """
    mesh = manifold.to_mesh64()
    held, held_faces = np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts)
    given_keys = _facet_keys(_vertex_keys(placement.apply(vertices_mm)), faces)
    held_keys = _facet_keys(_vertex_keys(held), held_faces)
    if _totals(given_keys) == _totals(held_keys):
        return []
    lost, gained = ~np.isin(given_keys, held_keys), ~np.isin(held_keys, given_keys)
    if not (lost.any() or gained.any()):
        return []
    lost_mm = vertices_mm[faces[lost]]
    gained_mm = held[held_faces[gained].astype(np.int64)] / placement.scale + placement.shift_mm
    old = np.arange(len(lost_mm) + len(gained_mm)) < len(lost_mm)
    return _boxes(np.concatenate([lost_mm, gained_mm]), old)


def _totals(keys: Keys) -> tuple[int, int, int]:
    """Count, sum and parity of keys: the same for equal sets in any order, and for hardly any others."""
    return keys.size, int(keys.sum(dtype=np.uint64)), int(np.bitwise_xor.reduce(keys))


def _vertex_keys(vertices: Floats) -> Keys:
    """Key of each vertex (V,): the bits of its coordinates, spread by the finalizer of MurmurHash3 (public domain)."""
    x, y, z = np.ascontiguousarray(vertices + 0.0).view(np.uint64).T  # -0.0 and 0.0 are one number
    keys: Keys = x
    for bits in (y, z, np.uint64(0)):
        keys = (keys ^ (keys >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
        keys = (keys ^ (keys >> np.uint64(33))) * np.uint64(0xC4CEB9FE1A85EC53) + bits
    keys ^= keys >> np.uint64(33)
    return keys


def _facet_keys(vertex_keys: Keys, faces: NDArray[Any]) -> Keys:
    """Key of each facet (F,): its corners in their order, whichever comes first."""
    swapped = (vertex_keys >> np.uint64(32)) | (vertex_keys << np.uint64(32))
    a, b, c = faces.T
    keys: Keys = vertex_keys[a] * swapped[b]
    keys += vertex_keys[b] * swapped[c]
    keys += vertex_keys[c] * swapped[a]
    return keys


def _boxes(triangles: Floats, old: NDArray[np.bool_]) -> list[dict[str, Any]]:
    """Boxes around facets that share corners, from low to high; `old` marks those of the mesh given."""
    # Few parts get here, only those that the library changed; the import takes longer than most of them.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(triangles)
    _, corner = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    facet = np.repeat(np.arange(count), 3)
    nodes = count + int(corner.max()) + 1
    links = coo_array((np.ones(3 * count), (facet, count + corner.ravel())), shape=(nodes, nodes))
    group = connected_components(links, directed=False)[1][:count]
    lowest = np.full(nodes, np.inf)
    np.minimum.at(lowest, group, triangles[:, :, 2].min(axis=1))
    order = np.unique(np.stack([lowest[group], group], axis=1), axis=0)[:, 1].astype(np.int64)
    place = np.empty(nodes, np.int64)
    place[order] = np.arange(len(order)) * min(len(order), MOST_REGIONS) // len(order)
    region = place[group]
    bounds = _bounds(triangles, group)
    found = []
    for k in np.unique(region):
        here = region == k
        corners = triangles[here].reshape(-1, 3)
        changed = int(max(np.count_nonzero(here & old), np.count_nonzero(here & ~old)))
        found.append(
            {
                "box_mm": [*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()],
                "why": f"manifold3d changed {changed} facet{'s' * (changed > 1)} here when it built the solid",
                **_known_bound(bounds[here]),
            }
        )
    return found


def _bounds(triangles: Floats, group: NDArray[Any]) -> Floats:
    """Largest error of a section at each facet (F,), mm: the horizontal width of the slab that its group fills.

    The facets given and those that replace them have the same border. So both lie in the convex hull of their corners, and
    thus in a slab perpendicular to their common normal.
    """
    bounds = np.full(len(triangles), np.inf)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    for k in np.unique(group):
        here = group == k
        normal = normals[here].sum(axis=0)
        length = float(np.linalg.norm(normal))
        flat = float(np.hypot(normal[0], normal[1]))
        if length > 0.0 and flat > LEAST_SLOPE * length:
            along = triangles[here].reshape(-1, 3) @ (normal / length)
            bounds[here] = float(np.ptp(along)) * length / flat
    return bounds


def _known_bound(bounds: Floats) -> dict[str, float]:
    """The greatest bound, with a margin for rounding; empty unless every facet has a bound."""
    most = float(bounds.max())
    return {"bound_mm": most * BOUND_MARGIN} if np.isfinite(most) and most > 0.0 else {}


# -- Placement near the origin and at a size at which manifold3d loses no digits -------------------------------
#
# manifold3d merges vertices within 1e-12 of the largest *coordinate* and rounds contours to 1e-8, whatever the size of the part.
# A part far from the origin or a small one is therefore moved and scaled first, by operations that are exact in floating point,
# so that `min <= h < max` stays the same comparison.


# Parts smaller than 2**10 mm are scaled to lie between half that size and that size
WORKING_SIZE_EXPONENT = 10


@dataclass(frozen=True)
class Placement:
    """Map from part to working coordinates, those that manifold3d gets: ``(x - shift_mm) * scale``."""

    shift_mm: Floats
    scale: float

    def apply(self, points: Floats) -> Floats:
        """Move and scale points (..., 3), exactly."""
        return np.ascontiguousarray((points - self.shift_mm) * self.scale)

    def height(self, z_mm: float) -> float:
        """Height of a plane in working coordinates."""
        return (z_mm - float(self.shift_mm[2])) * self.scale

    def undo(self, points: Floats) -> Floats:
        """Return contour points (N, 2) of working coordinates in mm, as placed."""
        placed = points / self.scale
        # Column by column: ten times faster than adding a row of two to each row.
        placed[:, 0] += self.shift_mm[0]
        placed[:, 1] += self.shift_mm[1]
        return placed


def exact_placement(part: Part) -> Placement:
    """Choose a shift and a power of two for the scale, so that no coordinate is rounded."""
    least, greatest = part.bounds
    size = float((greatest - least).max())
    exponent = WORKING_SIZE_EXPONENT - math.frexp(size)[1] if size > 0.0 else 0
    shift = [_exact_shift(float(a), float(b)) for a, b in zip(least, greatest, strict=True)]
    return Placement(np.array(shift), math.ldexp(1.0, min(max(0, exponent), 200)))


def _exact_shift(least: float, greatest: float) -> float:
    """Return the end nearer to 0 if all differences to it are exact (Sterbenz's lemma), else 0."""
    if least > 0.0 and greatest <= 2.0 * least:
        return least
    if greatest < 0.0 and least >= 2.0 * greatest:
        return greatest
    return 0.0
