"""Differences of two stacks, layer by layer, and whether they agree."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.comparison.measure import Figures, measure
from ebamcheck.comparison.outline import outline
from ebamcheck.comparison.sources import LayerSource
from ebamcheck.errors import SettingsError
from ebamcheck.geometry.regions import eroded
from ebamcheck.geometry.rings import EPSILON
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.threads import run_blocks

SAME_HEIGHT_MM = 1e-6  # heights closer than this are the same: finer than any slice file writes them
SMALLEST_BLOCK = 16  # fewest layers of a task, so that starting it costs little in comparison
TASKS_A_THREAD = 32  # tasks per thread of a block of layers: all threads finish at about the same time


class Pair(NamedTuple):
    """Two stacks to be measured against each other, by their indices in a list."""

    a: int
    b: int
    limit_mm: float
    exact_a: bool
    exact_b: bool


def compare(
    a: Layers,
    b: Layers,
    *,
    tolerance_mm: float = 0.001,
    bound_a_mm: float = 0.0,
    bound_b_mm: float = 0.0,
    exact_a: bool = False,
    exact_b: bool = False,
    part: Part | None = None,
    plane_margin_mm: float = 0.0,
    check_part: bool = True,
) -> pd.DataFrame:
    """Compare two stacks of layers.

    Parameters
    ----------
    a, b
        Stacks of the same part at the same heights.
    tolerance_mm, bound_a_mm, bound_b_mm
        The stacks agree where no point of the symmetric difference is deeper than the sum of these three.
    exact_a, exact_b
        Whether the contours are those of the mesh to rounding. Depth is measured from the exact ones: the lesser of both depths
        if both are exact, from the nearer contour at each point if neither is.
    part, plane_margin_mm
        The part sliced, for the column `class` (``unknown`` without it), and the margin of the classes.
    check_part
        Refuse stacks that carry the hashes of two different parts.

    Returns
    -------
    pandas.DataFrame
        One row per layer: ``layer``, ``height_mm``, ``class``; ``area_a_mm2``, ``area_b_mm2`` (winding number
        > 0), ``area_difference_mm2`` (a - b), ``symmetric_difference_mm2``, ``iou``; Hausdorff distances
        ``hausdorff_ab_mm`` (from a to b), ``hausdorff_ba_mm``, ``hausdorff_mm`` and 95th percentiles
        ``p95_ab_mm``, ``p95_ba_mm`` over the length of all contours, open paths included; ``depth_mm`` at
        ``depth_x_mm``, ``depth_y_mm``; ``rings_a``, ``rings_b`` (outer and inner together), ``holes_a``,
        ``holes_b``, ``open_a``, ``open_b``; ``topology_agrees``, and ``set_aside`` (outer rings and holes that one has and the
        other lacks, where they agree without features thinner than the limit); ``limit_mm``; ``agrees``.

        Two empty layers have an overlap of 1 and distances of 0; where one is empty the overlap is 0, the
        distances are infinite and the depth is the inscribed radius of the other. Hausdorff distances are
        right to 1e-7 mm. Depths are right to 1e-6 mm or 1 % of the limit, whichever is more, and to 5 % of
        the limit where they stay under it.

    Raises
    ------
    SettingsError
        If the heights or the parts differ, or a bound is negative or not finite.

    Examples
    --------
    >>> from ebamcheck.layers.stack import from_rings
    >>> square = [(0, 0), (2, 0), (2, 2), (0, 2)]
    >>> wider = [(0, 0), (2.5, 0), (2.5, 2), (0, 2)]
    >>> table = compare(from_rings([1.0], [[square]]), from_rings([1.0], [[wider]]))
    >>> bool(table["agrees"][0]), float(table["symmetric_difference_mm2"][0]), float(table["hausdorff_mm"][0])
    (False, 1.0, 0.5)
    """
    check_comparable({"a": a, "b": b}, check_part)
    limit = tolerance_mm + bound_a_mm + bound_b_mm
    if not (np.isfinite(limit) and min(tolerance_mm, bound_a_mm, bound_b_mm) >= 0.0):
        raise SettingsError(
            f"tolerance {tolerance_mm} mm with bounds {bound_a_mm} and {bound_b_mm} mm: give numbers from 0 up"
        )
    classes = np.full(len(a), UNKNOWN) if part is None else layer_classes(part, a.heights, plane_margin_mm)
    origin = shared_origin([a, b])
    (figures,) = measure_stacks([a, b], [Pair(0, 1, limit, exact_a, exact_b)], origin)
    return table(a, b, figures, limit, classes, origin)


def check_comparable(stacks: Mapping[str, LayerSource], check_part: bool = True) -> None:
    """Refuse stacks of different heights or of different parts; an empty hash matches any."""
    (one, first), *others = stacks.items()
    for name, other in others:
        if len(first) != len(other):
            raise SettingsError(
                f"{one!r} has {len(first)} layers and {name!r} has {len(other)}: compare the same heights"
            )
        apart = np.abs(first.heights - other.heights)
        differ = np.flatnonzero(~(apart <= SAME_HEIGHT_MM + 4.0 * EPSILON * np.abs(first.heights)))
        if differ.size:
            k = int(differ[0])
            raise SettingsError(
                f"layer {k + 1} is at z = {first.heights[k]} mm in {one!r} and at {other.heights[k]} mm in {name!r}: "
                "compare the same heights"
            )
    known: dict[str, str] = {}
    for name, stack in stacks.items():
        if stack.part:
            known.setdefault(stack.part, name)
    if check_part and len(known) > 1:
        (hash_a, name_a), (hash_b, name_b) = list(known.items())[:2]
        raise SettingsError(
            f"{name_a!r} is of part {hash_a[:12]} and {name_b!r} of part {hash_b[:12]}: compare the same part, "
            "or pass check_part=False"
        )


def measure_stacks(
    stacks: Sequence[Layers],
    pairs: Sequence[Pair],
    origin_mm: tuple[float, float],
    progress: Callable[[int], None] | None = None,
) -> Floats:
    """Figures of all pairs on all layers, (P, L, F) in the order of :class:`Figures`, in coordinates from an origin."""

    def work(start: int, stop: int) -> Floats:
        figures = measure_block(stacks, pairs, origin_mm, start, stop)
        if progress is not None:
            progress(stop - start)
        return figures

    return np.concatenate(run_blocks(work, len(stacks[0]), SMALLEST_BLOCK, TASKS_A_THREAD), axis=1)


def measure_block(
    stacks: Sequence[Layers], pairs: Sequence[Pair], origin_mm: tuple[float, float], start: int, stop: int
) -> Floats:
    """Figures of all pairs on layers ``start .. stop - 1``, (P, stop - start, F); each layer is prepared once for all its pairs."""
    figures = np.empty((len(pairs), stop - start, len(Figures._fields)))
    for layer in range(start, stop):
        outlines = [outline(stack, layer, origin_mm) for stack in stacks]
        for p, pair in enumerate(pairs):
            found = measure(outlines[pair.a], outlines[pair.b], pair.limit_mm, pair.exact_a, pair.exact_b)
            if not found.sound:
                found = _by_shapely(stacks[pair.a], stacks[pair.b], layer, found)
            figures[p, layer - start] = found
    return figures


def shared_origin(stacks: Sequence[Layers]) -> tuple[float, float]:
    """Middle of all points of all stacks, mm: coordinates from there lose no digits to a far origin."""
    boxes = np.array([stack.bounds() for stack in stacks if len(stack.points)]).reshape(-1, 4)
    if not len(boxes):
        return (0.0, 0.0)
    low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    x, y = 0.5 * (low + high)
    return float(x), float(y)


def _by_shapely(a: Layers, b: Layers, layer: int, found: Figures) -> Figures:
    """Areas and depth by shapely, for a layer on which the sweep met too many crossings."""
    region_a, region_b = a.section(layer), b.section(layer)
    difference = shapely.symmetric_difference(region_a, region_b)
    radius, x, y = 0.0, np.nan, np.nan
    for polygon in shapely.get_parts(difference):
        if polygon.geom_type == "Polygon" and not polygon.is_empty:
            circle = shapely.maximum_inscribed_circle(polygon)
            if circle.length > radius:
                radius, (x, y) = float(circle.length), circle.coords[0]
    return found._replace(
        area_a=float(region_a.area), area_b=float(region_b.area),
        symmetric_difference=float(difference.area), depth=radius, depth_x=x, depth_y=y,
    )  # fmt: skip


def table(
    a: Layers, b: Layers, figures: Floats, limit_mm: float, classes: NDArray[np.str_], origin_mm: tuple[float, float]
) -> pd.DataFrame:  # fmt: skip
    """Figures of one pair (L, F), measured from an origin, as a table with counts and verdicts."""
    column = dict(zip(Figures._fields, figures.T, strict=True))
    symmetric = column["symmetric_difference"]
    union = 0.5 * (column["area_a"] + column["area_b"] + symmetric)
    overlap, empty = union - symmetric, union <= 0.0
    rings_a, rings_b, holes_a, holes_b = a.ring_counts(), b.ring_counts(), a.hole_counts(), b.hole_counts()
    # Outer rings and holes that one has and the other lacks; where there are such, the regions are examined.
    differing = np.abs((rings_a - holes_a) - (rings_b - holes_b)) + np.abs(holes_a - holes_b)
    topology = differing == 0
    for layer in np.flatnonzero(~topology).tolist():
        topology[layer] = regions_agree(a.section(layer), b.section(layer), limit_mm)
    columns: dict[str, Any] = {
        "layer": np.arange(len(a)),
        "height_mm": a.heights,
        "class": classes.astype(object),
        "area_a_mm2": column["area_a"],
        "area_b_mm2": column["area_b"],
        "area_difference_mm2": column["area_a"] - column["area_b"],
        "symmetric_difference_mm2": symmetric,
        "iou": np.where(empty, 1.0, np.clip(overlap, 0.0, None) / np.where(empty, 1.0, union)),
        "hausdorff_ab_mm": column["hausdorff_ab"],
        "hausdorff_ba_mm": column["hausdorff_ba"],
        "hausdorff_mm": np.maximum(column["hausdorff_ab"], column["hausdorff_ba"]),
        "p95_ab_mm": column["p95_ab"],
        "p95_ba_mm": column["p95_ba"],
        "depth_mm": column["depth"],
        "depth_x_mm": column["depth_x"] + origin_mm[0],
        "depth_y_mm": column["depth_y"] + origin_mm[1],
        "rings_a": rings_a,
        "rings_b": rings_b,
        "holes_a": holes_a,
        "holes_b": holes_b,
        "open_a": a.open_counts(),
        "open_b": b.open_counts(),
        "topology_agrees": topology,
        "set_aside": np.where(topology, differing, 0),
        "limit_mm": np.full(len(a), limit_mm),
        "agrees": topology & (column["depth"] <= limit_mm),
    }
    return pd.DataFrame(columns)


# -- Layer classes: whether a plane passes through vertices or faces of the part, where slicers differ by definition

GENERIC = "generic"
VERTEX_ON_PLANE = "vertex-on-plane"
FACE_ON_PLANE = "face-on-plane"
UNKNOWN = "unknown"  # class of a layer if no part is given


def layer_classes(part: Part, heights: ArrayLike, margin_mm: float) -> NDArray[np.str_]:
    """Class of each layer (L,) at absolute heights (L,).

    ``face-on-plane`` where a whole facet lies within the margin of the plane (a level facet, or one too small to be told from it),
    else ``vertex-on-plane`` where a vertex of a facet does, else ``generic``.
    """
    planes = np.asarray(heights, dtype=np.float64).reshape(-1)
    classes = np.full(planes.shape, GENERIC, dtype=f"<U{len(VERTEX_ON_PLANE)}")
    if not len(part.faces):
        return classes
    used = np.zeros(len(part.vertices), np.bool_)
    used[part.faces] = True
    levels = np.sort(part.vertices[used, 2])
    below = np.searchsorted(levels, planes - margin_mm, side="left")
    classes[np.searchsorted(levels, planes + margin_mm, side="right") > below] = VERTEX_ON_PLANE
    a, b, c = part.vertices[:, 2][part.faces.T]
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    flat = high - low <= 2.0 * margin_mm
    if not flat.any():
        return classes
    order = np.argsort(low[flat])
    low, high = low[flat][order], high[flat][order]
    # Least upper end among the flat facets that start at or above each place, in one sweep from the top.
    least_high = np.append(np.minimum.accumulate(high[::-1])[::-1], np.inf)
    top = least_high[np.searchsorted(low, planes - margin_mm, side="left")]
    classes[top <= planes + margin_mm] = FACE_ON_PLANE
    return classes


# -- Whether two regions have the same outer rings and holes once thin features are set aside ------------------
#
# A feature thinner than twice the limit (a sliver, a neck, a slit, a pore) may rightly be in one region and not in the other. So each
# region is counted with its thin features and without: as it is, without the pieces and holes that are thin throughout, opened by the
# limit (thin solids gone), closed by it (thin gaps gone), and both in either order. The two agree if their ranges of the number of
# outer rings overlap, and their ranges of the number of holes too.
#
# A piece of a wedge that is just thinner than that in one region may be up to twice as thick in the other, cut off from it by necks
# that are gone. Regions that do not agree are therefore counted once more at twice the limit. No fault hides there: a feature thicker
# than ``2 r`` that one of two regions lacks has a depth of more than `r`, which has a limit of its own.

ARC_SEGMENTS = 4  # segments a quarter circle in the offsets: their radius is right to 2 %


def regions_agree(a: BaseGeometry, b: BaseGeometry, limit_mm: float) -> bool:
    """Whether two regions within a limit of each other have the same outer rings and holes once thin features are set aside.

    Examples
    --------
    >>> block = shapely.box(-9, -5, 0, 5)
    >>> fin = block.union(shapely.box(0, -0.55, 20, 0.55))
    >>> broken = block.union(shapely.box(10, -0.65, 14, 0.65))
    >>> regions_agree(fin, broken, 0.6), regions_agree(fin, broken, 0.3)
    (True, False)
    """
    for radius_mm in (limit_mm, 2.0 * limit_mm):
        ranges = zip(thin_counts(a, radius_mm), thin_counts(b, radius_mm), strict=True)
        if all(one.start < other.stop and other.start < one.stop for one, other in ranges):
            return True
    return False


def thin_counts(solid: BaseGeometry, limit_mm: float) -> list[range]:
    """Ranges of the number of outer rings and of holes, with thin features kept or set aside."""
    variants = [solid]
    if limit_mm > 0.0 and not solid.is_empty:
        opened, closed = _closed(solid, -limit_mm), _closed(solid, limit_mm)
        variants += [opened, closed, _closed(opened, limit_mm), _closed(closed, -limit_mm)]
    counts = [*map(_counts, variants), _counts(solid, limit_mm)]
    return [range(min(numbers), max(numbers) + 1) for numbers in zip(*counts, strict=True)]


def _closed(solid: BaseGeometry, by_mm: float) -> BaseGeometry:
    """Region closed by a distance, or opened where it is negative."""
    if by_mm < 0.0:
        return eroded(solid, -by_mm, ARC_SEGMENTS).buffer(-by_mm, quad_segs=ARC_SEGMENTS)
    return eroded(solid.buffer(by_mm, quad_segs=ARC_SEGMENTS), by_mm, ARC_SEGMENTS)


def _counts(solid: BaseGeometry, thin_mm: float = 0.0) -> tuple[int, int]:
    """Polygons and holes of a region, without those that a circle of radius `thin_mm` fits into nowhere."""
    polygons = [p for p in shapely.get_parts(solid) if p.geom_type == "Polygon" and not p.is_empty]
    holes = [shapely.Polygon(ring) for polygon in polygons for ring in polygon.interiors]
    if thin_mm > 0.0:
        shapes = polygons, holes
        polygons, holes = ([p for p in some if not eroded(p, thin_mm, ARC_SEGMENTS).is_empty] for some in shapes)
    return len(polygons), len(holes)
