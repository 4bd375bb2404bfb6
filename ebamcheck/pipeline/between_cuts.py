"""What lies between two cuts: openings and metal of the part that neither of the layers beside them has.

A layer is what its cut shows. A bore that lies on its side, a crack or a rim between two cuts is in no layer, and nothing that looks
at sections alone can miss it. So the mesh is cut once more wherever it turns from floor to roof between two cuts, and that
section is held against those below and above.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import Check
from ebamcheck.checks.metal_rules import BETWEEN
from ebamcheck.geometry.regions import mean_width_mm, valid_polygons
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import edge_groups
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.settings.config import Config
from ebamcheck.showing.short_text import counted
from ebamcheck.slicers.slicing import slice_part

LEAST_MM2 = 0.05
"""Area, seen from above, of the floor and of the roof of what is looked at: over the rounding of upright walls."""

MOST_SPANS = 4
"""Most heights between two cuts at which the mesh is cut once more."""

FINEST = 1e-6
"""Share of the part's size by which heights differ that are the same."""


class Lost(NamedTuple):
    """An opening, or metal, that no layer has: the cut below it (-1: the bottom of the part), height and width, and where it is, mm."""

    is_wall: bool
    below: int
    high_mm: float
    wide_mm: float
    z_mm: float
    x_mm: float
    y_mm: float


def between_check(part: Part, layers: Layers, config: Config) -> Check:
    """Check that no opening and no metal is lost between two cuts that is smaller than a least that is set; of others it tells.

    Parameters
    ----------
    part
        The part as placed.
    layers
        Its sections by a slicer.
    """
    if config.layers.heights_mm or config.base_mm > 0.0:
        return Check(BETWEEN, True, 0.0, 0.0, "features", "", "the settings say which layers there are")
    found = sorted(lost_features(part, layers, config), key=lambda lost: min(lost.high_mm, lost.wide_mm))
    if not found:
        return Check(
            BETWEEN, True, 0.0, 0.0, "features", "", "no opening and no metal lies between two cuts alone"
        )
    process = config.process
    least = {False: process.least_hole_mm, True: process.least_wall_mm}
    broken = [f for f in found if min(f.high_mm, f.wide_mm) < (least[f.is_wall] or 0.0)]
    first = (broken or found)[0]
    what, made = ("metal", "and is not built") if first.is_wall else ("an opening", "and is filled")
    text = (
        f"{counted(len(broken or found), 'feature')} of the part in no layer: first {what} {first.high_mm:.2g} mm high and {first.wide_mm:.3g} mm wide "
        f"at z = {first.z_mm:.3f} mm, ({first.x_mm:.1f}, {first.y_mm:.1f}), that lies between two cuts {made}"
    )
    if broken:
        text += f"; {'process.least_wall_mm' if first.is_wall else 'process.least_hole_mm'} allows none under {least[first.is_wall]:.3g} mm"
    layer = max(first.below, 0)
    return Check(
        BETWEEN,
        not broken,
        float(len(broken or found)),
        0.0,
        "features",
        "",
        text,
        layer,
        first.x_mm,
        first.y_mm,
    )


def lost_features(part: Part, layers: Layers, config: Config) -> Iterator[Lost]:
    """Find what lies between two cuts and reaches farther into a section, or out of it, than its sides are uneven as built."""
    cuts, shallow_mm = np.asarray(layers.heights), config.process.outside_reach_mm
    turning = dict(_turning(part, cuts))
    bottom, top = (float(z) for z in part.bounds[:, 2])
    near = FINEST * (top - bottom)
    cut_at = np.unique(
        [bottom + near, top - near, *(0.5 * (a + b) for spans in turning.values() for a, b in spans)]
    )
    cut = dict(zip(cut_at.tolist(), _sections(slice_part(part, cut_at)), strict=True)) if turning else {}
    # The part's own bottom and top are no cuts, but tell what is open there.
    sections = [cut[bottom + near], *_sections(layers), cut[top - near]] if turning else []
    for below, spans in turning.items():
        beside = sections[below + 1 : below + 3]
        # Sections that touch share lines, too, and no inset of a sliver may end a run.
        both = shapely.MultiPolygon(valid_polygons(shapely.intersection_all(beside)))
        within = shapely.difference(both, shapely.buffer(both.boundary, shallow_mm))
        around = shapely.buffer(shapely.union_all(beside), shallow_mm, join_style="mitre")
        known: dict[bool, BaseGeometry] = {False: shapely.Polygon(), True: shapely.Polygon()}
        for low_mm, high_mm in spans:
            z_mm = 0.5 * (low_mm + high_mm)
            regions = {
                False: shapely.difference(within, cut[z_mm]),
                True: shapely.difference(cut[z_mm], around),
            }
            for is_wall, region in regions.items():
                for piece in shapely.get_parts(region):
                    if piece.area <= LEAST_MM2 or shapely.intersects(piece, known[is_wall]):
                        continue
                    known[is_wall] = shapely.union(known[is_wall], piece)
                    x, y = shapely.get_coordinates(shapely.point_on_surface(piece))[0].tolist()
                    yield Lost(is_wall, below, high_mm - low_mm, mean_width_mm(piece), z_mm, x, y)


def _sections(layers: Layers) -> list[BaseGeometry]:
    return [layers.section(k) for k in range(len(layers))]


def _turning(part: Part, cuts: Floats) -> Iterator[tuple[int, list[tuple[float, float]]]]:
    """Cuts over which the mesh has both a floor and a roof before the next one, and spans of Z between these, the longest first."""
    corners = part.vertices[part.faces]
    low, high = corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1)
    below = np.searchsorted(cuts, low, side="left") - 1
    (ax, ay), (bx, by) = ((corners[:, k, :2] - corners[:, 0, :2]).T for k in (1, 2))
    across = ax * by - ay * bx
    rows = np.flatnonzero(below == np.searchsorted(cuts, high, side="right") - 1)
    floor, roof = (
        np.bincount(below[rows] + 1, np.maximum(0.5 * sign * across[rows], 0.0), cuts.size + 1)
        for sign in (1.0, -1.0)
    )
    rows = rows[(np.minimum(floor, roof) > LEAST_MM2)[below[rows] + 1]]
    if not rows.size:
        return
    label = _runs(part.faces[rows], len(part.vertices))
    lowest, highest = np.full(label.max() + 1, np.inf), np.full(label.max() + 1, -np.inf)
    np.minimum.at(lowest, label, low[rows])
    np.maximum.at(highest, label, high[rows])
    level = np.zeros(lowest.size, np.int64)
    level[label] = below[rows]
    same_mm = FINEST * float(np.linalg.norm(part.size))
    for k in np.unique(level).tolist():
        ends = np.unique(np.concatenate([lowest[level == k], highest[level == k]]))
        longest = np.argsort(ends[:-1] - ends[1:], kind="stable")[:MOST_SPANS]
        spans = [(float(ends[n]), float(ends[n + 1])) for n in longest if ends[n + 1] - ends[n] > same_mm]
        if spans:
            yield k, spans


def _runs(faces: NDArray[np.int32], count: int) -> Ints:
    """Number (F,) of the run of facets, joined by edges, that each belongs to."""
    groups = edge_groups(np.ascontiguousarray(faces), count)
    facet = groups.half_edges // 3
    first = np.repeat(facet[groups.starts[:-1]], np.diff(groups.starts))
    graph = coo_array((np.ones(len(facet)), (first, facet)), shape=(len(faces), len(faces)))
    _, label = connected_components(graph, directed=False)
    return np.asarray(label, np.int64)
