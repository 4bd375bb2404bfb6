"""Whether the layers of a program have the metal of the solid, and their sections are those of the mesh: what sections alone cannot
tell.

A level face within a layer moves to one of its borders, so that layers may be more or less than the part."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import PLACE_MM, SAME_AREA, limit_check
from ebamcheck.checks.part_file import file_check
from ebamcheck.geometry.regions import mean_width_mm, valid_polygons
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.heights import LEVEL_MM, LayerRule, layer_rule, nearest_fitting, section_areas
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.bodies import volumes_between
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import PlatePart
from ebamcheck.mesh.topology import edge_groups
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.showing.short_text import counted
from ebamcheck.slicers.slicing import slice_part

CUTS_OF_A_LAYER = 16  # Sections from which the volume of a layer is summed where bodies overlap
LEAST_MM2 = 0.05  # Area from above of floor and roof of what is looked at: over the rounding of upright walls
FINEST = 1e-6  # Share of the part's size by which heights differ that are the same
LINES_PER_BEAD = 2.0  # Two or more lines cross every hole and wall that may be built
OFF_GRID = 0.381966  # Share of their distance by which lines lie beside whole ones, where sides lie
CUTS_AT_ONCE = 512  # Sections that are held at once for that
MOST_SPANS = 4  # Most heights between two cuts at which the mesh is cut once more
MOST_LINES = 400  # Of one direction across a part: over 200 beads of width they lie farther apart
AT_ONCE = 2_000_000  # Cut facets that are held at once
# Remedy where listed layers do not begin on what stands.
ON_WHAT_STANDS = "list the middles of the layers (layers.heights_mm), absolute: the lowest half a layer over what stands (layers.base_mm)"


class Solid(NamedTuple):
    """The check of the layers against the solid, and where they are furthest off."""

    check: Check
    z_mm: float  # Height in the part of the gravest level face of a check that fails; NaN without one

    def tells_of(self, z_mm: float) -> bool:
        """Whether the check has told that the metal is off at that height of the part."""
        return abs(self.z_mm - z_mm) <= LEVEL_MM


def solid_check(part: Part, layers: Layers, config: Config) -> Solid:
    """Check that the layers neither add to the solid, or to one part of a plate, nor leave out of it more than
    `process.mass_tolerance`."""
    limit, cuts = config.process.mass_tolerance, np.asarray(layers.heights)

    def solid(share: float, text: str, layer: int | None = None, z_mm: float = np.nan) -> Solid:
        check = limit_check("metal of the solid", share, limit, "of the part", text, layer=layer)
        return Solid(check, z_mm)

    if not len(cuts) or not layers.areas().any():
        return solid(np.inf, "no layer has metal")
    if len(cuts) == 1 and _of_some_layers(config):
        # A layer that is made alone, at a height that was measured, is what that height makes it.
        return solid(0.0, "one layer of the part says nothing of the solid")
    borders = layer_borders(part, cuts, config)
    parts = list(_parts(part, layers))
    found = [_rule(mesh, cuts, borders, areas, config) for mesh, areas, _ in parts]
    k = int(np.argmax([rule.share for rule in found]))
    rule, whole = found[k], max(found[k].solid_mm3, 1e-9)
    text = (
        f"layers of one section each add {100.0 * rule.added_mm3 / whole:.2f} % to the metal of the solid{parts[k][2]} "
        f"and leave {100.0 * rule.lacking_mm3 / whole:.2f} % of it out"
    )
    if rule.share <= limit:
        return solid(rule.share, text)
    layer, z_mm = None, np.nan
    if rule.faces:
        face = rule.faces[0]
        z_mm, does = face.z_mm, "goes beyond" if face.added_mm > 0.0 else "ends before"
        layer = min(int(np.searchsorted(borders, z_mm, side="right")) - 1, len(cuts) - 1)
        share = 100.0 * face.area_mm2 * abs(face.added_mm) / whole
        text += f", most at the level face of {face.area_mm2:.0f} mm2 at z = {face.z_mm:.3f} mm of the part: it lies within a layer, "
        text += f"and the metal {does} it by {abs(face.added_mm):.2f} mm, {share:.2f} %"
    # A layer height near the one that is set with which the part passes.
    if not _of_some_layers(config) and not any(_overlap(mesh, cuts, areas) for mesh, areas, _ in parts):
        near = nearest_fitting(part, config)
        if near is not None:
            share = 100.0 * near.share
            text += f"; layers of {near.height_mm:g} mm (layers.layer_height_mm) leave {share:.2f} %"
    return solid(rule.share, text, layer, z_mm)


def of_mesh(part: Part, layers: Layers, config: Config) -> list[Check]:
    """Checks of the sections and heights of the layers against the mesh, and of that against its file."""
    return [
        sections_check(part, layers, config),
        between_check(part, layers, config),
        heights_check(part, np.asarray(layers.heights), config),
        file_check(part, config),
    ]


def layer_borders(part: Part, cuts: Floats, config: Config) -> Floats:
    """Heights (L + 1,) in the part between which the layers stand, mm."""
    z_of = deposition_heights(cuts, config.layer_height_mm, config.base_mm) - config.base_mm
    bottom = float(part.bounds[0, 2])
    if config.base_mm > 0.0 or cuts[0] >= bottom + z_of[0]:
        # What the layers lie on, or listed heights leave out below them, is no part of the program.
        bottom = float(cuts[0]) - 0.5 * float(z_of[0])
    return np.concatenate([[bottom], bottom + z_of])


def _of_some_layers(config: Config) -> bool:
    """Whether the settings list the layers, or begin on what stands: they need not be all of the part."""
    return config.base_mm > 0.0 or bool(config.layers.heights_mm)


def _parts(part: Part, layers: Layers) -> Iterator[tuple[Part, Floats, str]]:
    """Each part by itself, with the areas of its sections and how it is named."""
    if not isinstance(part, PlatePart) or len(part.members) < 2:
        yield part, layers.areas(), ""
        return
    for member in part.members:
        mesh = part.member(member)
        yield mesh, slice_part(mesh, layers.heights).areas(), f" of {member.name}"


def _rule(part: Part, cuts: Floats, borders: Floats, areas: Floats, config: Config) -> LayerRule:
    process = config.process
    heights = np.append(borders, max(float(part.bounds[1, 2]), float(borders[-1])) + 1.0)
    summed = _summed_volumes if _overlap(part, cuts, areas) else volumes_between
    volumes = summed(part, heights)
    if _of_some_layers(config):
        volumes[-1] = 0.0  # Nor are these layers said to be the rest of the part.
    spot_mm2 = process.bead_width_mm**2
    return layer_rule(part, cuts, borders, areas, volumes, spot_mm2, process.machining_allowance_mm)


def _overlap(part: Part, cuts: Floats, areas: Floats) -> bool:
    """Whether the mesh encloses something else than its sections do."""
    if (np.diff(cuts) <= 0.0).any():
        return True
    most = max(float(areas.max(initial=0.0)), 1e-9)
    return bool((np.abs(section_areas(part, cuts) - areas) > SAME_AREA * most).any())


def _summed_volumes(part: Part, borders: Floats) -> Floats:
    """Volume between heights (n + 1,), (n,) mm3, from many sections."""
    steps = (np.arange(CUTS_OF_A_LAYER) + 0.5) / CUTS_OF_A_LAYER
    heights = (borders[:-1, None] + np.diff(borders)[:, None] * steps).ravel()
    blocks = (heights[k : k + CUTS_AT_ONCE] for k in range(0, heights.size, CUTS_AT_ONCE))
    areas = [slice_part(part, block).areas() for block in blocks]
    mean = np.concatenate(areas).reshape(-1, CUTS_OF_A_LAYER).mean(axis=1)
    return np.asarray(mean * np.diff(borders), np.float64)


class Lost(NamedTuple):
    """An opening, or metal, that no layer has: the cut below it (-1: the bottom of the part), height and width, and where it is,
    mm."""

    is_wall: bool
    below: int
    high_mm: float
    wide_mm: float
    z_mm: float
    x_mm: float
    y_mm: float


def between_check(part: Part, layers: Layers, config: Config) -> Check:
    """Check that no opening and no metal is lost between two cuts that is smaller than a least that is set; of others it tells."""
    name = "between the cuts"
    if _of_some_layers(config):
        return Check(name, True, 0.0, 0.0, "features", "", "the settings say which layers there are")
    found = sorted(lost_features(part, layers, config), key=lambda lost: min(lost.high_mm, lost.wide_mm))
    if not found:
        good = "no opening and no metal lies between two cuts alone"
        return Check(name, True, 0.0, 0.0, "features", "", good)
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
    count, layer = float(len(broken or found)), max(first.below, 0)
    return Check(name, not broken, count, 0.0, "features", "", text, layer, first.x_mm, first.y_mm)


def lost_features(part: Part, layers: Layers, config: Config) -> Iterator[Lost]:
    """Find what lies between two cuts and reaches farther into a section, or out of it, than its sides are uneven as built."""
    cuts, shallow_mm = np.asarray(layers.heights), config.process.outside_reach_mm
    turning = dict(_turning(part, cuts))
    bottom, top = (float(z) for z in part.bounds[:, 2])
    near = FINEST * (top - bottom)
    middles = [0.5 * (a + b) for spans in turning.values() for a, b in spans]
    cut_at = np.unique([bottom + near, top - near, *middles])
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
            regions = shapely.difference(within, cut[z_mm]), shapely.difference(cut[z_mm], around)
            for is_wall, region in zip((False, True), regions, strict=True):
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
        np.bincount(below[rows] + 1, np.maximum(0.5 * sign * across[rows], 0.0), cuts.size + 1) for sign in (1.0, -1.0)
    )
    rows = rows[(np.minimum(floor, roof) > LEAST_MM2)[below[rows] + 1]]
    if not rows.size:
        return
    # Runs of facets that are joined by edges.
    faces = part.faces[rows]
    groups = edge_groups(np.ascontiguousarray(faces), len(part.vertices))
    facet = groups.half_edges // 3
    first = np.repeat(facet[groups.starts[:-1]], np.diff(groups.starts))
    graph = coo_array((np.ones(len(facet)), (first, facet)), shape=(len(faces), len(faces)))
    label = np.asarray(connected_components(graph, directed=False)[1], np.int64)
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


# Where lines cross borders, (n,) each: layer, line, place along it, and by how much the number of solids around it changes.
_Crossings = tuple[Ints, Ints, Floats, Ints]
# A part, and Z of the lowest and the highest corner of each of its facets, (F,) mm.
_Facets = tuple[Part, Floats, Floats]


def sections_check(part: Part, layers: Layers, config: Config) -> Check:
    """Check sections against the mesh, along lines in X and in Y across every layer. Where one has metal and the other none, their
    borders lie apart: by no more than `curves.section_tolerance_mm`. Lines that graze a side have long pieces whose ends lie on
    both."""
    limit = config.curves.section_tolerance_mm
    sections = [layers.section(k) for k in range(len(layers))]
    step = config.process.bead_width_mm / LINES_PER_BEAD
    worst, layer, x_mm, y_mm = 0.0, -1, np.nan, np.nan
    z = part.vertices[part.faces, 2]
    facets = part, z.min(axis=1), z.max(axis=1)
    for axis in (0, 1):
        for k, at in _different(facets, np.asarray(layers.heights), sections, axis, step, limit):
            depth = float(shapely.distance(shapely.Point(at), sections[k].boundary))
            # Without any border the section is empty, and all of the mesh is missing.
            depth = np.inf if np.isnan(depth) else depth
            if depth > worst:
                worst, layer, (x_mm, y_mm) = depth, k, at
    if layer < 0:
        text = "lines across every section run in metal where they do in the mesh"
        return Check("sections of the mesh", True, 0.0, limit, "mm", "", text)
    text = f"section of layer {layer + 1} and mesh differ at ({x_mm:.3f}, {y_mm:.3f})"
    if np.isfinite(worst):
        text += f", {worst:.4g} mm from the border of the section"
    return limit_check("sections of the mesh", worst, limit, "mm", text, "", layer, (x_mm, y_mm))


def heights_check(part: Part, cuts: Floats, config: Config) -> Check:
    """Check that the layers reach from the bottom of the part to within half a layer of its top, each as high as it is set.
    Of layers on what stands, the lowest has to lie there. Of listed heights, the user says which they are."""
    # Cuts of layers of several heights do not tell where each of them begins.
    uneven = len(cuts) > 2 and bool(np.ptp(np.diff(cuts)) > PLACE_MM)
    if config.base_mm > 0.0 and len(cuts) and not uneven:
        first = float(cuts[1] - cuts[0]) if len(cuts) > 1 else config.layer_height_mm
        check = layer_check(part, float(cuts[0]), config.base_mm, first)
        by_user = bool(config.layers.heights_mm) and not check.passed
        return replace(check, remedy=ON_WHAT_STANDS) if by_user else check
    if _of_some_layers(config):
        good = "the settings say which layers there are"
        return Check("layers of the part", True, 0.0, PLACE_MM, "mm", "", good)
    low_mm, top_mm = part.bounds[:, 2].tolist()
    high = config.layer_height_mm
    tops = deposition_heights(cuts, high)
    heights = float(np.abs(np.diff(tops, prepend=0.0) - high).max())
    off = {"a layer is not as high as the settings say": heights}
    if len(cuts) > 1:
        middles = np.abs(cuts - low_mm - (np.arange(len(cuts)) + 0.5) * high)
        off["a layer is not cut at its middle"] = float(middles.max())
        last = f"the last layer ends beside the top of the part, at {top_mm - low_mm:.3f} mm, by more than half a layer"
        off[last] = abs(low_mm + float(tops[-1]) - top_mm) - 0.5 * high
    good = f"{counted(len(cuts), 'layer')} of {high:.4g} mm from the bottom of the part to its top"
    return _furthest_off(off, good)


def layer_check(part: Part, cut_mm: float, base_mm: float, thickness_mm: float) -> Check:
    """Check that a layer on what stands, at Z `base_mm`, is cut at its middle, and does not begin over the top of the part."""
    low_mm, top_mm = part.bounds[:, 2].tolist()
    over = f"the layer begins over the top of the part, at {top_mm - low_mm:.3f} mm"
    middle_mm = abs(cut_mm - low_mm - base_mm - 0.5 * thickness_mm)
    off = {"the layer is not cut at its middle": middle_mm, over: base_mm - (top_mm - low_mm)}
    if math.isnan(cut_mm):
        off = {"the layer has no cut of its own": np.inf}
    return _furthest_off(off, f"a layer of {thickness_mm:.4g} mm on {base_mm:.4g} mm, cut at its middle")


def _furthest_off(off_mm: dict[str, float], good: str) -> Check:
    what = max(off_mm, key=lambda name: off_mm[name])
    value = max(off_mm[what], 0.0)
    text = good if value <= PLACE_MM else f"{what}: {value:.4g} mm"
    return limit_check("layers of the part", value, PLACE_MM, "mm", text)


def _different(
    facets: _Facets, heights: Floats, sections: list[BaseGeometry], axis: int, step_mm: float, least_mm: float
) -> Iterator[tuple[int, tuple[float, float]]]:
    """Ends of the pieces of lines along an axis that lie in one of mesh and sections and not in the other: layer, and place."""
    low, high = facets[0].bounds[:, 1 - axis].tolist()
    step = max(step_mm, (high - low) / MOST_LINES)
    lines = low + (np.arange(int((high - low) / step) + 1) + OFF_GRID) * step
    for some in _blocks(facets, heights):
        mesh = _of_mesh(facets, heights, some, axis, lines)
        ours = [_of_section(sections[k], k, axis, lines) for k in range(some.start, some.stop)]
        layer, line, place, _ = (np.concatenate(column) for column in zip(mesh, *ours, strict=True))
        solid = np.concatenate([mesh[3], *(np.zeros_like(crossed[3]) for crossed in ours)])
        drawn = np.concatenate([np.zeros_like(mesh[3]), *(crossed[3] for crossed in ours)])
        order = np.lexsort((place, line, layer))
        layer, line, place = layer[order], line[order], place[order]
        begins = (np.diff(layer, prepend=-1) != 0) | (np.diff(line, prepend=-1) != 0)
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
    first, last = (np.searchsorted(heights, side) for side in facets[1:])
    count = np.bincount(first, minlength=len(heights) + 1) - np.bincount(last, minlength=len(heights) + 1)
    block = np.cumsum(np.cumsum(count)[: len(heights)]) // AT_ONCE
    for number in np.unique(block).tolist():
        rows = np.flatnonzero(block == number)
        yield range(int(rows[0]), int(rows[-1]) + 1)


def _of_mesh(facets: _Facets, heights: Floats, some: range, axis: int, lines: Floats) -> _Crossings:
    """Crossings of lines with the sections of facets: a facet is left by its rising edge and entered by its falling one."""
    (part, *ends_mm), own = facets, heights[some.start : some.stop]
    first, last = (np.searchsorted(own, side) for side in ends_mm)
    cut = np.flatnonzero(last > first)
    count = (last - first)[cut]
    corners = part.vertices[part.faces[np.repeat(cut, count)]]
    layer = np.arange(len(corners)) - np.repeat(np.cumsum(count) - count - first[cut], count)
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
    return layer[segment], line, place, change
