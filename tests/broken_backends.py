"""Slicers that are wrong in one way each, made from honest ones; the kit must find every one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import shapely
from pydantic import ConfigDict

from ebamcheck.backend import BackendSettings
from ebamcheck.layers.stack import Layers, canonical, from_polygons
from ebamcheck.mesh.part import Part
from ebamcheck_embree import Embree
from ebamcheck_planecut import PlaneCut
from ebamcheck_stencil import Stencil

Cut = Callable[[np.ndarray], Layers]
Spoil = Callable[[Part, Cut, np.ndarray], Layers]
"""From a part, its honest slicer and heights to wrong layers."""


class Fault(NamedTuple):
    """A broken slicer, and the check that must find it."""

    slicer: type
    check: str


def broken(base: type, name: str, spoil: Spoil | None = None, **overrides: Any) -> type:
    """Class of slicer `base` whose layers are spoiled, or some of whose attributes are others."""

    class Prepared:
        def __init__(self, honest: Any, part: Part) -> None:
            self.honest, self.part = honest, part

        def __enter__(self):
            self.honest.__enter__()
            return self

        def __exit__(self, kind, error, trace):
            return self.honest.__exit__(kind, error, trace)

        def slice(self, heights, progress=None):
            if progress is not None:
                progress(len(heights))
            return spoil(self.part, self.honest.slice, heights).labelled(backend=name)

    def prepare(self, part: Part, settings: BackendSettings):
        honest = base.prepare(self, part, settings)
        return honest if spoil is None else Prepared(honest, part)

    return type(f"Broken_{name}", (base,), {"name": name, "prepare": prepare, **overrides})


# -- ways to spoil layers ------------------------------------------------------------------------------


def rebuilt(layers: Layers, keep=None, change=None, turn_round=False) -> Layers:
    """Layers with rings left out (`keep`: a mask), their points changed, or their direction turned round."""
    rings = [r for r in range(layers.closed.size) if keep is None or keep[r]]
    points = [layers.ring(r)[:: -1 if turn_round else 1] for r in rings]
    if change is not None:
        points = [change(p) for p in points]
    counts = np.bincount(layers.ring_layer[rings], minlength=len(layers)) if rings else np.zeros(len(layers))
    return canonical(
        layers.heights,
        np.concatenate([np.zeros((0, 2)), *points]),
        np.cumsum([0, *(len(p) for p in points)]),
        np.concatenate([[0], np.cumsum(counts)]),
        layers.closed[rings],
        part=layers.part,
        direction=layers.direction,
        settings=layers.settings,
    )


def by_shapely(layers: Layers, change: Callable[[Any], Any]) -> Layers:
    changed = [[change(shapely.union_all(layers.polygons(k)))] for k in range(len(layers))]
    return from_polygons(
        layers.heights, changed, part=layers.part, direction=layers.direction, settings=layers.settings
    )


def off_by_one(part, cut, heights):
    """Each layer is the one above it: a step over the whole stack of forty layers."""
    step = part.size[2] / 40
    return replace(cut(heights + step), heights=heights)


def mirrored_axis(part, cut, heights):
    middle = part.bounds[:, 0].sum()
    return rebuilt(cut(heights), change=lambda p: [middle, 0] + p * [-1, 1], turn_round=True)


def lost_hole(part, cut, heights):
    """The smallest hole of every layer is forgotten."""
    layers = cut(heights)
    keep = np.ones(layers.closed.size, bool)
    for k in range(len(layers)):
        holes = [r for r in layers.rings_of(k) if layers.ring_areas[r] < 0]
        if holes:
            keep[max(holes, key=lambda r: layers.ring_areas[r])] = False
    return rebuilt(layers, keep)


def shifted(pixels):
    def spoil(part, cut, heights):
        layers = cut(heights)
        step = layers.settings.get("pixel_mm") or layers.settings["grid_mm"]
        return rebuilt(layers, change=lambda p: p + np.array([pixels * step, 0.0]))

    return spoil


def dropped_tiny(part, cut, heights):
    """Rings of less than 0.001 mm2 are dropped."""
    layers = cut(heights)
    return rebuilt(layers, np.abs(layers.ring_areas) >= 0.001)


def other_half_open(part, cut, heights):
    return replace(cut(np.nextafter(heights, -np.inf)), heights=heights)


def closed_rule(part, cut, heights):
    """min <= h <= max: what touches the plane from below counts as well."""
    above, under = cut(heights), other_half_open(part, cut, heights)
    both = [
        [shapely.union_all([*above.polygons(k), *under.polygons(k)])]
        if not np.array_equal(above.block(k, k + 1).points, under.block(k, k + 1).points)
        else above.polygons(k)
        for k in range(len(heights))
    ]
    return from_polygons(heights, both, part=above.part, direction=above.direction, settings=above.settings)


def closed_gaps(part, cut, heights):
    """Gaps under 0.098 mm close, as by the slice closing radius of desktop slicers (0.049 mm)."""
    grown = {"join_style": "mitre", "mitre_limit": 100.0}
    return by_shapely(cut(heights), lambda region: region.buffer(0.049, **grown).buffer(-0.049, **grown))


def reversed_rings(part, cut, heights):
    return rebuilt(cut(heights), turn_round=True)


def rotated_start(part, cut, heights):
    layers = cut(heights)
    points = layers.points.copy()
    for r in range(layers.closed.size):
        rows = slice(layers.ring_starts[r], layers.ring_starts[r + 1])
        points[rows] = np.roll(points[rows], 1, axis=0)
    return replace(layers, points=points, edge=None, edge_t=None)


def single_precision(part, cut, heights):
    return rebuilt(cut(heights), change=lambda p: p.astype(np.float32).astype(np.float64))


def rounded(part, cut, heights):
    """Coordinates in hundredths of a millimetre."""
    return rebuilt(cut(heights), change=lambda p: np.round(p, 2))


def dropped_open_paths(part, cut, heights):
    layers = cut(heights)
    return rebuilt(layers, layers.closed)


def neighbours_matter(part, cut, heights):
    """Layers after the first of a block are moved by a little that the block's first height decides."""
    layers = cut(heights)
    first = heights[0] if len(heights) else 0.0
    return rebuilt(layers, change=lambda p: p + 1e-9 * first)


def skips_empty_layers(part, cut, heights):
    layers = cut(heights)
    return layers.take(np.flatnonzero(layers.ring_counts() > 0))


def unlabelled(part, cut, heights):
    return cut(heights).labelled(part="")


def own_bound(base, factor):
    return {"error_bound_mm": lambda self, part, settings: factor * base.error_bound_mm(self, part, settings)}


class EntersAsAnother(PlaneCut):
    name = "enters-as-another"

    def prepare(self, part, settings):
        honest = super().prepare(part, settings)
        return type(
            "Prepared",
            (),
            {"__enter__": lambda self: honest, "__exit__": honest.__exit__, "slice": honest.slice},
        )()


class TrustsTheFacetOrder(PlaneCut):
    """Leaves out the last facet."""

    name = "trusts-the-facet-order"

    def prepare(self, part, settings):
        return super().prepare(replace(part, faces=part.faces[:-1]), settings)


class TrustsTheVertexOrder(PlaneCut):
    """Moves the first vertex by a little."""

    name = "trusts-the-vertex-order"

    def prepare(self, part, settings):
        vertices = part.vertices.copy()
        vertices[0, 0] += 0.01
        return super().prepare(replace(part, vertices=vertices), settings)


class LooseSettings(BackendSettings):
    model_config = ConfigDict(extra="ignore")
    overlaps: str = "unite"


def raising_probe(self):
    raise OSError("libEGL.so.1: cannot open shared object file")


class KeepsOverlaps(PlaneCut):
    """Leaves the rings of overlapping shells as they are."""

    name = "kept-overlaps"

    def prepare(self, part, settings):
        return super().prepare(part, PlaneCut.Settings(overlaps="keep"))


class KeepsTouchingApart(KeepsOverlaps):
    """Leaves the rings of bodies that touch as they are."""

    name = "kept-touching"


class SwallowsArguments(PlaneCut):
    name = "swallows-arguments"

    def prepare(self, *args, **kwargs):
        return super().prepare(*args, **kwargs)


class DoubleProgress(PlaneCut):
    name = "double-progress"

    def prepare(self, part, settings):
        honest = super().prepare(part, settings)
        cut = honest.slice

        def slice(heights, progress=None):
            if progress is not None:
                progress(len(heights))
            return cut(heights, progress)

        honest.slice = slice
        return honest


def _fault(base: type, name: str, check: str, spoil: Spoil | None = None, **overrides: Any) -> Fault:
    return Fault(broken(base, name, spoil, **overrides), check)


FAULTS: dict[str, Fault] = {
    fault.slicer.name: fault
    for fault in (
        _fault(PlaneCut, "off-by-one-layer", "bound held", off_by_one),
        _fault(PlaneCut, "mirrored-axis", "bound held", mirrored_axis),
        _fault(PlaneCut, "lost-hole", "topology", lost_hole),
        _fault(Stencil, "half-pixel-shift", "bound attacked", shifted(0.5)),
        _fault(Embree, "half-cell-shift", "no shift", shifted(0.5)),
        _fault(PlaneCut, "dropped-tiny-loop", "topology", dropped_tiny),
        _fault(PlaneCut, "closed-plane-rule", "coplanar planes", closed_rule),
        _fault(PlaneCut, "other-half-open-rule", "coplanar planes", other_half_open),
        _fault(PlaneCut, "closed-gap", "bound held", closed_gaps),
        _fault(PlaneCut, "reversed-orientation", "orientation", reversed_rings),
        _fault(PlaneCut, "rotated-start", "canonical form", rotated_start),
        _fault(PlaneCut, "single-precision", "points on contours", single_precision),
        _fault(PlaneCut, "rounded-to-hundredths", "points on contours", rounded),
        _fault(PlaneCut, "dropped-open-paths", "open surfaces", dropped_open_paths),
        _fault(PlaneCut, "neighbours-matter", "blocks", neighbours_matter),
        _fault(PlaneCut, "skips-empty-layers", "out of range", skips_empty_layers),
        _fault(PlaneCut, "unlabelled", "labels", unlabelled),
        _fault(Stencil, "bound-four-times-too-loose", "bound not idle", **own_bound(Stencil, 4.0)),
        _fault(Stencil, "bound-too-tight", "bound attacked", **own_bound(Stencil, 0.8)),
        _fault(PlaneCut, "exact-in-name-only", "declared bound", **own_bound(PlaneCut, 1e12)),
        _fault(PlaneCut, "loose-settings", "settings", Settings=LooseSettings),
        _fault(PlaneCut, "raising-probe", "probe", probe=raising_probe),
        _fault(PlaneCut, "odd-rule-in-name-only", "inside rule", inside_rule="odd"),
        _fault(PlaneCut, "nameless-rule", "attributes", inside_rule="as usual"),
        Fault(KeepsOverlaps, "inside rule"),
        Fault(KeepsTouchingApart, "touching bodies"),
        Fault(SwallowsArguments, "signatures"),
        Fault(DoubleProgress, "progress"),
        Fault(EntersAsAnother, "context"),
        Fault(TrustsTheFacetOrder, "facet order"),
        Fault(TrustsTheVertexOrder, "vertex order"),
        _fault(Stencil, "shifted-by-a-pixel-and-a-half", "bound held", shifted(1.5)),
    )
}
"""Broken slicers by name."""
