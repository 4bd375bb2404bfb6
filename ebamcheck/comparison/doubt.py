"""Declared doubt: inside a box for which a slicer declares an error bound, it may differ by that bound, up to a cap.

A layer on which two slicers agree only thanks to a declared doubt is reported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import shapely

from ebamcheck.comparison.pairwise import Pair, compare
from ebamcheck.comparison.sources import LayerSource, Reader
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers, from_polygons

# Column of a pair's table: how much declared doubt added to the limit of a layer that agrees only by it; else 0
DOUBT = "doubt_mm"


class Doubt(NamedTuple):
    """One place that a slicer declares doubtful."""

    low: Floats  # (3,) lower corner of its box, mm; `high` is the upper one
    high: Floats
    bound_mm: float  # largest error of a contour there


def doubts_of(settings: Mapping[str, Any]) -> list[Doubt]:
    """Places that a slicer has declared with a bound; places without one are only named as causes, and change no verdict."""
    doubts = []
    for place in settings.get("doubtful_regions", ()):
        bound = place.get("bound_mm")
        if isinstance(bound, int | float) and np.isfinite(bound) and bound > 0.0:
            low, high = np.asarray(place["box_mm"], np.float64).reshape(2, 3)
            doubts.append(Doubt(low, high, float(bound)))
    return doubts


def allow_doubt(
    stacks: Sequence[LayerSource], pairs: Sequence[Pair], tables: Sequence[pd.DataFrame], most_mm: float
) -> None:
    """Let layers agree that differ by no more than a declared doubt, and only within its boxes; changes `tables` in place.

    A doubt that would add more than `most_mm` to a limit changes nothing.
    """
    declared = [doubts_of(stack.settings) for stack in stacks]
    readers = [Reader(stack) for stack in stacks]
    for pair, rows in zip(pairs, tables, strict=True):
        doubts = [d for d in (*declared[pair.a], *declared[pair.b]) if d.bound_mm <= most_mm]
        allowed = np.zeros(len(rows))
        agrees = rows["agrees"].to_numpy().copy()
        for layer in np.flatnonzero(~agrees & rows["gated"].to_numpy()).tolist():
            z, depth_mm = (float(rows[name].iloc[layer]) for name in ("height_mm", "depth_mm"))
            here = [d for d in doubts if d.low[2] - most_mm <= z <= d.high[2] + most_mm]
            added = max((d.bound_mm for d in here), default=0.0)
            if not here or depth_mm > pair.limit_mm + added:
                continue
            a, b = readers[pair.a].layer(layer), readers[pair.b].layer(layer)
            if _agrees_beside(pair, a, b, here, added):
                agrees[layer], allowed[layer] = True, added
        rows["agrees"] = agrees
        rows[DOUBT] = allowed


def _agrees_beside(pair: Pair, a: Layers, b: Layers, doubts: Sequence[Doubt], added_mm: float) -> bool:
    """Whether a layer agrees within the wider limit everywhere, topology included, and within its own outside the boxes."""
    rectangles = [shapely.box(*(d.low[:2] - d.bound_mm), *(d.high[:2] + d.bound_mm)) for d in doubts]
    boxes = shapely.union_all(rectangles)

    def agree(a: Layers, b: Layers, limit_mm: float) -> bool:
        table = compare(a, b, tolerance_mm=limit_mm, exact_a=pair.exact_a, exact_b=pair.exact_b, check_part=False)
        return bool(table["agrees"].all())

    def outside(layers: Layers) -> Layers:
        left = shapely.get_parts(shapely.difference(layers.section(0), boxes))
        polygons = [part for part in left if part.geom_type == "Polygon" and part.area > 0.0]
        return from_polygons(layers.heights, [polygons])

    return agree(a, b, pair.limit_mm + added_mm) and agree(outside(a), outside(b), pair.limit_mm)


def doubted_layers(pairs: pd.DataFrame) -> Iterator[tuple[str, str, list[int], float, float]]:
    """Pairs that agree on some layers only by declared doubt: names, these layers, greatest depth and greatest addition, mm."""
    if DOUBT not in pairs:
        return
    for (a, b), rows in pairs[pairs[DOUBT] > 0.0].groupby(["a", "b"], sort=True):
        most = float(rows["depth_mm"].max()), float(rows[DOUBT].max())
        yield str(a), str(b), [int(k) for k in rows["layer"]], *most
