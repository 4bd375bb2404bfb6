"""Whether the sections that a program is judged by are those of the mesh: by lines across both, and by the part's own heights.

All slicers agree on what they share: the form of rings, the nesting of holes, the polygons made of these, the heights at which they cut.
What goes wrong there goes wrong for all of them, and for the program and its witness alike. So each section is crossed by lines,
and where these run in metal is held against the mesh itself: facets that a plane cuts, and the winding number along the line.
No ring, no polygon and no slicer comes into that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import Check
from ebamcheck.checks.metal_rules import HEIGHTS, SECTIONS
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config
from ebamcheck.showing.short_text import counted
from ebamcheck.writing.inputs import deposition_heights

LINES_PER_BEAD = 2.0
"""Lines over the width of a bead: two or more cross every hole and every wall that may be built."""

MOST_LINES = 400
"""Lines of one direction across a part at most: over 200 beads of width they lie farther apart than that."""

OFF_GRID = 0.381966
"""Share of their distance by which lines lie beside whole ones: sides of parts lie at round numbers."""

AT_ONCE = 2_000_000
"""Cut facets that are held at once."""

HEIGHT_MM = 1e-3
"""Heights nearer than this are one: the decimals of a program, at their coarsest."""

ON_WHAT_STANDS = "list the middles of the layers (layers.heights_mm), absolute: the lowest half a layer over what stands (layers.base_mm)"
"""Remedy where listed layers do not begin on what stands."""


class _Crossings(NamedTuple):
    """Where lines cross borders, (n,) each: layer, line, place along it, and by how much the number of solids around it changes."""

    layer: Ints
    line: Ints
    place: Floats
    change: Ints


class _Facets(NamedTuple):
    """Facets of a part, and Z of the lowest and the highest corner of each, (F,) mm: looked at for every block of layers and either axis."""

    part: Part
    low_mm: Floats
    high_mm: Floats

    @classmethod
    def of(cls, part: Part) -> _Facets:
        a, b, c = (part.vertices[part.faces[:, k], 2] for k in range(3))
        return cls(part, np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c))


def sections_check(part: Part, layers: Layers, config: Config) -> Check:
    """Check sections against the mesh, along lines in X and in Y across every layer.

    Where there is metal in one and none in the other, the border of the one lies beside that of the other: by no more than
    `curves.section_tolerance_mm`. Lines that graze a side have long pieces whose ends lie on both.

    Parameters
    ----------
    part
        The part as placed.
    layers
        Its sections by a slicer.
    """
    limit = config.curves.section_tolerance_mm
    sections = [layers.section(k) for k in range(len(layers))]
    step = config.process.bead_width_mm / LINES_PER_BEAD
    worst, layer, x_mm, y_mm = 0.0, -1, np.nan, np.nan
    facets = _Facets.of(part)
    for axis in (0, 1):
        for k, at in _different(facets, np.asarray(layers.heights), sections, axis, step, limit):
            depth = float(shapely.distance(shapely.Point(at), sections[k].boundary))
            # Without any border the section is empty, and all of the mesh is missing.
            depth = np.inf if np.isnan(depth) else depth
            if depth > worst:
                worst, layer, (x_mm, y_mm) = depth, k, at
    if layer < 0:
        text = "lines across every section run in metal where they do in the mesh"
        return Check(SECTIONS, True, 0.0, limit, "mm", "", text)
    text = f"section of layer {layer + 1} and mesh differ at ({x_mm:.3f}, {y_mm:.3f})"
    if np.isfinite(worst):
        text += f", {worst:.4g} mm from the border of the section"
    return Check(SECTIONS, worst <= limit, worst, limit, "mm", "", text, layer, float(x_mm), float(y_mm))


def heights_check(part: Part, cuts: Floats, config: Config) -> Check:
    """Check that the layers reach from the bottom of the part to within half a layer of its top, each as high as it is set.

    Of layers on what stands, the lowest has to lie there. Of listed heights, the user says which they are.
    """
    if config.base_mm > 0.0 and len(cuts) and not _is_uneven(cuts):
        first = float(cuts[1] - cuts[0]) if len(cuts) > 1 else config.layer_height_mm
        check = layer_check(part, float(cuts[0]), config.base_mm, first)
        by_user = bool(config.layers.heights_mm) and not check.passed
        return replace(check, remedy=ON_WHAT_STANDS) if by_user else check
    if config.layers.heights_mm or config.base_mm > 0.0:
        return Check(HEIGHTS, True, 0.0, HEIGHT_MM, "mm", "", "the settings say which layers there are")
    low_mm, top_mm = part.bounds[:, 2].tolist()
    high = config.layer_height_mm
    tops = deposition_heights(cuts, high)
    off = {
        "a layer is not as high as the settings say": float(np.abs(np.diff(tops, prepend=0.0) - high).max())
    }
    if len(cuts) > 1:
        middles = np.abs(cuts - low_mm - (np.arange(len(cuts)) + 0.5) * high)
        ends = abs(low_mm + float(tops[-1]) - top_mm) - 0.5 * high
        off |= {
            "a layer is not cut at its middle": float(middles.max()),
            f"the last layer ends beside the top of the part, at {top_mm - low_mm:.3f} mm, by more than half a layer": ends,
        }
    what = max(off, key=lambda name: off[name])
    value = max(off[what], 0.0)
    good = f"{counted(len(cuts), 'layer')} of {high:.4g} mm from the bottom of the part to its top"
    text = good if value <= HEIGHT_MM else f"{what}: {value:.4g} mm"
    return Check(HEIGHTS, value <= HEIGHT_MM, value, HEIGHT_MM, "mm", "", text)


def _is_uneven(cuts: Floats) -> bool:
    """Whether cuts (L,) are of layers of several heights: those do not tell where each of them begins."""
    return len(cuts) > 2 and bool(np.ptp(np.diff(cuts)) > HEIGHT_MM)


def layer_check(part: Part, cut_mm: float, base_mm: float, thickness_mm: float) -> Check:
    """Check that a layer on what stands is cut at its middle, and does not begin over the top of the part.

    Parameters
    ----------
    cut_mm
        Absolute height of its cut.
    base_mm, thickness_mm
        Z of what it lies on, over the lowest point of the part; and its height.
    """
    low_mm, top_mm = part.bounds[:, 2].tolist()
    off = {
        "the layer is not cut at its middle": abs(cut_mm - low_mm - base_mm - 0.5 * thickness_mm),
        f"the layer begins over the top of the part, at {top_mm - low_mm:.3f} mm": base_mm
        - (top_mm - low_mm),
    }
    if math.isnan(cut_mm):
        off = {"the layer has no cut of its own": np.inf}
    what = max(off, key=lambda name: off[name])
    value = max(off[what], 0.0)
    good = f"a layer of {thickness_mm:.4g} mm on {base_mm:.4g} mm, cut at its middle"
    text = good if value <= HEIGHT_MM else f"{what}: {value:.4g} mm"
    return Check(HEIGHTS, value <= HEIGHT_MM, value, HEIGHT_MM, "mm", "", text)


# -- lines -------------------------------------------------------------------------------------------


def _different(
    facets: _Facets, heights: Floats, sections: list[BaseGeometry], axis: int, step_mm: float, least_mm: float
) -> Iterator[tuple[int, tuple[float, float]]]:
    """Ends of the pieces of lines along an axis that lie in one of mesh and sections and not in the other: layer, and place."""
    low, high = facets.part.bounds[:, 1 - axis].tolist()
    step = max(step_mm, (high - low) / MOST_LINES)
    lines = low + (np.arange(int((high - low) / step) + 1) + OFF_GRID) * step
    for some in _blocks(facets, heights):
        mesh = _of_mesh(facets, heights, some, axis, lines)
        ours = [_of_section(sections[k], k, axis, lines) for k in range(some.start, some.stop)]
        layer, line, place = (
            np.concatenate([getattr(c, name) for c in (mesh, *ours)]) for name in ("layer", "line", "place")
        )
        solid = np.concatenate([mesh.change, *(np.zeros_like(c.change) for c in ours)])
        drawn = np.concatenate([np.zeros_like(mesh.change), *(c.change for c in ours)])
        order = np.lexsort((place, line, layer))
        layer, line, place = layer[order], line[order], place[order]
        begins = np.diff(layer, prepend=-1) + np.diff(line, prepend=-1) != 0
        begins |= np.diff(layer, prepend=-1) != 0
        inside = _winding(solid[order], begins) > 0
        differ = inside != (_winding(drawn[order], begins) > 0)
        piece = np.diff(place, append=np.inf)
        piece[np.append(begins[1:], True)[: piece.size]] = 0.0
        for n in np.flatnonzero(differ & (piece > least_mm)).tolist():
            across = float(lines[line[n]])
            for along in (float(place[n]), float(place[n] + piece[n])):
                yield int(layer[n]), (along, across) if axis == 0 else (across, along)


def _winding(change: Ints, begins: Bools) -> Ints:
    """Number of solids (n,) around a line behind each crossing of it; every line begins outside of all."""
    total = np.cumsum(change)
    before = np.where(begins, total - change, 0)
    first = np.maximum.accumulate(np.where(begins, np.arange(change.size), 0))
    return np.asarray(total - before[first], np.int64)


def _blocks(facets: _Facets, heights: Floats) -> Iterator[range]:
    """Layers one after the other, as many at once as cut :data:`AT_ONCE` facets."""
    first, last = (np.searchsorted(heights, side) for side in (facets.low_mm, facets.high_mm))
    count = np.bincount(first, minlength=len(heights) + 1) - np.bincount(last, minlength=len(heights) + 1)
    block = np.cumsum(np.cumsum(count)[: len(heights)]) // AT_ONCE
    for number in np.unique(block).tolist():
        rows = np.flatnonzero(block == number)
        yield range(int(rows[0]), int(rows[-1]) + 1)


def _of_mesh(facets: _Facets, heights: Floats, some: range, axis: int, lines: Floats) -> _Crossings:
    """Crossings of lines with the sections of facets: a facet is left by its rising edge and entered by its falling one."""
    part, own = facets.part, heights[some.start : some.stop]
    first, last = (np.searchsorted(own, side) for side in (facets.low_mm, facets.high_mm))
    cut = np.flatnonzero(last > first)
    count = (last - first)[cut]
    corners = part.vertices[part.faces[np.repeat(cut, count)]]
    layer = (
        np.arange(len(corners)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first[cut], count)
    )
    begin, end = np.zeros((len(corners), 2)), np.zeros((len(corners), 2))
    for k in range(3):
        p, q = corners[:, k], corners[:, (k + 1) % 3]
        under, over = p[:, 2] <= own[layer], q[:, 2] <= own[layer]
        rise = np.where(under != over, q[:, 2] - p[:, 2], 1.0)
        share = ((own[layer] - p[:, 2]) / rise)[:, None]
        at = p[:, :2] + share * (q[:, :2] - p[:, :2])
        rising, falling = under & ~over, over & ~under
        end[rising], begin[falling] = at[rising], at[falling]
    return _crossed(begin, end, layer + some.start, axis, lines)


def _of_section(section: BaseGeometry, layer: int, axis: int, lines: Floats) -> _Crossings:
    """Crossings of lines with the border of a section, solid to its left."""
    oriented = shapely.orient_polygons(shapely.get_parts(section))
    rings, ring = shapely.get_coordinates(shapely.get_rings(oriented), return_index=True)
    same = np.diff(ring) == 0 if len(ring) else np.zeros(0, np.bool_)
    begin, end = rings[:-1][same], rings[1:][same]
    return _crossed(begin, end, np.full(len(begin), layer), axis, lines)


def _crossed(begin: Floats, end: Floats, layer: Ints, axis: int, lines: Floats) -> _Crossings:
    """Crossings of lines along an axis with segments (n, 2) that have the solid to their left."""
    a, b = begin[:, 1 - axis], end[:, 1 - axis]
    first, last = np.searchsorted(lines, np.minimum(a, b)), np.searchsorted(lines, np.maximum(a, b))
    count = last - first
    segment = np.repeat(np.arange(len(begin)), count)
    line = np.arange(segment.size) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)
    a, b = a[segment], b[segment]
    share = (lines[line] - a) / (b - a)
    place = begin[segment, axis] + share * (end[segment, axis] - begin[segment, axis])
    # Along X the solid begins where its border goes down, along Y where it goes to the right.
    change = np.where((b < a) if axis == 0 else (b > a), 1, -1)
    return _Crossings(layer[segment], line, place, change)
