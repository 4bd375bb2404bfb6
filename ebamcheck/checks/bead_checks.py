"""Checks of the beads that a program lays: nothing left bare, no line missing, none laid twice."""

from __future__ import annotations

import math
import re

import numpy as np
import shapely
from scipy import ndimage
from scipy.spatial import cKDTree
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import SAME_LINE_MM, count_check, limit_check, lines_of, row_faults
from ebamcheck.checks.hatch_form import form_checks
from ebamcheck.checks.matching import APART_MM
from ebamcheck.checks.subject import Subject
from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.geometry.raster import bare_samples, covered_fraction
from ebamcheck.geometry.regions import ground, valid_polygons
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.motions import STRAIGHT, NCProgram
from ebamcheck.nc.roles import nearest_layer
from ebamcheck.result import Check
from ebamcheck.threads import run_each

CRUMB = 0.25  # Bare pieces under this times the squared bead width are corners that a round bead never fills
SPACING_SHARE = 1.5  # Neighbouring lines of an island in spacings, at most; where one is missing, it is two
PARALLEL_RAD = 1e-3  # Lines of an island whose directions differ by more follow a wall, and have no spacing
WIDEST_GAP = 0.95  # Width of a gap between beads over that of the one which a missing line leaves
# Of the bead's width: by how much a gap may be wider than the plan leaves them, whose grid has samples of that size; and what sound
# plans leave where three islands meet, however near to one another their lines lie.
GAP_MARGIN, LEAST_GAP_LIMIT = 0.05, 0.15
MARGIN = 2  # Samples by which the box around a patch is wider: what is bare to the next ones
_NUMBERED = re.compile(rb"\s*(?:/\d?\s*)?(?:[N:]\s*\d+)?", re.IGNORECASE)


def line_checks(subject: Subject) -> list[Check]:
    """Check the lines of the hatch by the text alone: their spacing, that none is laid twice, and their form."""
    return [_spacing(subject), _once(subject.nc), *form_checks(subject.nc, subject.config)]


def _spacing(subject: Subject) -> Check:
    """Distance between neighbouring parallel lines that are driven one after the other, where nothing else covers what lies between."""
    nc, config = subject.nc, subject.config
    moves = (nc.end[:, :2] != nc.start[:, :2]).any(axis=1)
    rows = np.flatnonzero(nc.deposit & (nc.island >= 0) & ~nc.turn & moves & (nc.lengths > 0.0))
    limit = SPACING_SHARE * config.process.hatch_spacing_mm
    # Group (n,) of lines of one direction that follow each other, offset (n,) mm across the longest, and whether parallel to it.
    way = (nc.end - nc.start)[rows, :2]
    unit = way / np.hypot(way[:, 0], way[:, 1])[:, None]
    turned = np.abs(unit[1:, 0] * unit[:-1, 1] - unit[1:, 1] * unit[:-1, 0]) > PARALLEL_RAD
    group = np.cumsum(np.append(False, turned | (np.diff(nc.layer[rows]) != 0))[: rows.size])
    longest = np.zeros(int(group.max(initial=-1)) + 1, np.int64)
    by_length = np.argsort(nc.lengths[rows], kind="stable")
    longest[group[by_length]] = by_length
    along = unit[longest[group]]
    middle = 0.5 * (nc.start + nc.end)[rows, :2]
    across = along[:, 0] * middle[:, 1] - along[:, 1] * middle[:, 0]
    parallel = np.abs(along[:, 0] * unit[:, 1] - along[:, 1] * unit[:, 0]) <= PARALLEL_RAD
    group, offset, parallel = group, across, parallel
    order = np.lexsort((offset, group))
    step = np.diff(offset[order])
    same = (np.diff(group[order]) == 0) & parallel[order[1:]] & parallel[order[:-1]]
    wide = np.flatnonzero(same & (step > limit))
    if wide.size:
        wide = wide[_is_bare(subject, np.stack([rows[order[wide]], rows[order[wide + 1]]], axis=1))]
    worst = float(step[wide if wide.size else same & (step <= limit)].max(initial=0.0))
    if not wide.size:
        text = f"{rows.size} lines, neighbours at most {worst:.6g} mm apart"
        return Check("hatch spacing", True, worst, limit, "mm", "", text)
    # The later of both lines stands where the missing one should have come before.
    row = int(np.maximum(rows[order[wide]], rows[order[wide + 1]]).min())
    text = f"neighbouring lines lie {worst:.6g} mm apart: one is missing between"
    return Check("hatch spacing", False, worst, limit, "mm", nc.where(row), text)


def _is_bare(subject: Subject, pairs: Ints) -> Bools:
    """Pairs (n, 2) of lines between which the place half-way is in the section, and under no bead of the layer."""
    # Nothing lies between two lines of which one begins where the other has long ended: they are of two islands.
    nc, room = subject.nc, 0.5 * subject.config.process.bead_width_mm
    pairs = np.take_along_axis(pairs, np.argsort(nc.lengths[pairs], axis=1, kind="stable"), axis=1)
    shorter, other = pairs.T
    middle = 0.5 * (nc.start + nc.end)[shorter, :2]
    way = (nc.end - nc.start)[other, :2] / nc.lengths[other, None]
    from_other = middle - nc.start[other, :2]
    along = (from_other * way).sum(axis=1)
    place = middle - 0.5 * (from_other - along[:, None] * way)
    bare = (-room <= along) & (along <= nc.lengths[other] + room)
    layer = nearest_layer(nc.end[shorter, 2], subject.z_of)
    for k in np.unique(layer[bare]).tolist():
        mine = np.flatnonzero(bare & (layer == k))
        if subject.witness_sections is not None:
            bare[mine] = shapely.intersects_xy(subject.witness_sections[k], place[mine, 0], place[mine, 1])
        bare[mine] &= distances(place[mine], subject.chords(k)) > room
    return np.asarray(bare)


def _once(nc: NCProgram) -> Check:
    """Whether a line, of the hatch or of a contour, lies on another of its layer; contours may overlap their start."""
    contour = (nc.ring >= 0) & (nc.kind == STRAIGHT) & ~nc.overlap
    rows = np.flatnonzero(nc.deposit & ~nc.turn & ((nc.island >= 0) | contour) & (nc.lengths > SAME_LINE_MM))
    rows = rows[np.isfinite(nc.start[rows]).all(axis=1) & np.isfinite(nc.end[rows]).all(axis=1)]
    layer = APART_MM * nc.layer[rows]
    # Each line in both directions: nothing else tells which of its ends is the first.
    start, end = nc.start[rows, :2], nc.end[rows, :2]
    ways = np.vstack([np.column_stack([start, end, layer]), np.column_stack([end, start, layer])])
    pairs = cKDTree(ways).query_pairs(SAME_LINE_MM, p=np.inf, output_type="ndarray")
    pairs = pairs % max(rows.size, 1)
    again = np.unique(pairs[pairs[:, 0] != pairs[:, 1]].max(axis=1))
    faults = row_faults(nc, rows[again], "this line has been laid before in its layer")
    return count_check("lines laid once", faults, f"{rows.size} lines, none twice")


def repeated_blocks(nc: NCProgram) -> Check:
    """Blocks with metal that repeat the line before: a motion to where the tool stands, or the same words but for their numbers."""
    still = nc.deposit & (nc.lengths == 0.0)
    faults = row_faults(nc, still, "a motion that goes nowhere: the block before says the same")
    lines = [file.data.split(b"\n") for file in nc.files]
    for file, line in lines_of(nc, np.flatnonzero(nc.deposit)):
        before, block = lines[file][line - 2 : line] if line > 1 else (b"", lines[file][line - 1])
        # Most blocks end in another word than the one before, and need not be taken into words.
        last = block.rsplit(None, 1)[-1]
        if last[:1] not in b"Nn:/" and b";" not in block + before and not before.rstrip().endswith(last):
            continue
        words = _words_of(block)
        if words and words == _words_of(before):
            faults.append((f"{nc.files[file].name}:{line}", "the same block as the one before"))
    return count_check("repeated blocks", faults, "no motion repeats the block before")


def _words_of(line: bytes) -> list[bytes]:
    """Words of a line without its number and its comment."""
    words = line.split(b";")[0].split()
    if words and words[0][:1] == b"N" and words[0][1:].isdigit():
        return words[1:]
    return _NUMBERED.sub(b"", b" ".join(words)).split()


def coverage_check(subject: Subject) -> list[Check]:
    """Check the least share of a section that the beads cover; the overlap of all, and the largest gap of the worst, are told."""
    nc, config, sections = subject.nc, subject.config, subject.witness_sections or []
    limit, width = config.scan.least_coverage, config.process.bead_width_mm
    solid = [k for k, section in enumerate(sections) if not section.is_empty]
    covered = run_each(lambda k: covered_fraction(sections[k], subject.chords(k), width), solid)
    laid = width * sum(float(np.nansum(nc.lengths[subject.bead_rows[k]])) for k in solid)
    area = sum(share * sections[k].area for share, k in zip(covered, solid, strict=True))
    worst, layer = min(zip(covered, solid, strict=True), default=(1.0, -1))
    if layer < 0:
        return [Check("coverage", True, 1.0, limit, "of the area", "", "there is no section to cover")]
    rows, where, gap = subject.bead_rows[layer], f"{nc.files[0].name}:1", "; the layer has no bead"
    if rows.size:
        lines = np.asarray(shapely.linestrings(subject.chords(layer).reshape(-1, 2, 2)), object)
        bare = shapely.get_parts(sections[layer].difference(ground(lines, width)))
        parts = [part for part in bare if part.area > CRUMB * width**2]
        where, gap = "", "; no gap"
        if parts:
            largest = max(parts, key=lambda part: float(part.area))
            centre = largest.representative_point()
            where = nc.where(_nearest(nc, rows, centre))
            at = f"({centre.x:.3f}, {centre.y:.3f})"
            gap = f"; {len(parts)} gaps, the largest of {largest.area:.4g} mm2 at {at}"
    text = f"beads cover at least {100.0 * worst:.2f} % (layer {layer + 1}), overlap {100.0 * (laid / max(area, 1e-9) - 1.0):.0f} %{gap}"
    return [Check("coverage", worst >= limit, worst, limit, "of the area", where, text)]


def gaps_check(subject: Subject) -> list[Check]:
    """Check the widest gap within the contour beads: corners that a round bead cannot fill lie outside of their middle."""
    nc, config = subject.nc, subject.config
    width = config.process.bead_width_mm
    missing_line_mm = WIDEST_GAP * (2.0 * config.process.hatch_spacing_mm - width)
    planned_mm = (config.scan.gap_width + GAP_MARGIN) * width
    limit = max(min(missing_line_mm, planned_mm), LEAST_GAP_LIMIT * width)
    known, sections = [0.0], subject.witness_sections or []

    def widest(k: int) -> tuple[float, int, BaseGeometry] | None:
        section = sections[k]
        if section.is_empty or not subject.bead_rows[k].size:
            return None
        # As if a bead ran along the border: what is nearer to it than half a bead is a corner.
        lines = np.vstack([subject.chords(k), segments_of(section.boundary)])
        # A gap as wide as the widest so far is found, too: whichever thread comes first, the lowest one is told.
        across, bare = widest_part(section, lines, width, math.nextafter(known[0], 0.0))
        if bare is None:
            return None
        known[0] = max(known[0], across)
        return across, -k, bare

    gaps = [gap for gap in run_each(widest, range(len(sections))) if gap is not None]
    worst, where, place = 0.0, "", ""
    if gaps:
        worst, layer, bare = max(gaps, key=lambda gap: gap[:2])
        centre = bare.representative_point()
        where = nc.where(_nearest(nc, subject.bead_rows[-layer], centre))
        place = f" at ({centre.x:.3f}, {centre.y:.3f})"
    text = f"widest gap between beads{place}: {worst:.4g} mm"
    return [limit_check("gaps", worst, limit, "mm", text, where)]


def _nearest(nc: NCProgram, rows: Ints, place: BaseGeometry) -> int:
    """Motion whose chord is nearest to a place."""
    chords = np.stack([nc.start[rows, :2], nc.end[rows, :2]], axis=1)
    known = np.isfinite(chords).all(axis=(1, 2))
    if not known.any():
        return int(rows[0])
    return int(rows[known][np.argmin(shapely.distance(shapely.linestrings(chords[known]), place))])


def widest_part(
    region: BaseGeometry, segments: Floats, bead_width_mm: float, wider_than_mm: float = 0.0
) -> tuple[float, shapely.Polygon | None]:
    """Diameter of the largest circle in a region, mm, that lies further than half a bead width from every segment (S, 4), and its part.

    Where no circle is over `wider_than_mm`: that width, and None.
    """
    bare = bare_samples(region, segments, bead_width_mm)
    widest_mm, widest = wider_than_mm, None
    if bare.covered == 1.0:
        return widest_mm, widest
    # Patches of bare samples come the widest first, and beads are laid only where they reach one: a few bare spots of a layer of a
    # thousand beads cost no union of a thousand.
    labels, _ = ndimage.label(bare.grid, structure=np.ones((3, 3)))
    places = [place for place in ndimage.find_objects(labels) if place is not None]
    first = np.array([(x.start, y.start) for y, x in places], np.float64).reshape(-1, 2) - MARGIN
    stop = np.array([(x.stop, y.stop) for y, x in places], np.float64).reshape(-1, 2) + MARGIN
    boxes = np.hstack([first, stop]) * bare.step_mm + np.tile(bare.origin, 2)
    most_mm = bare.step_mm * (stop - first).min(axis=1)
    low = np.minimum(segments[:, :2], segments[:, 2:]) - 0.5 * bead_width_mm
    high = np.maximum(segments[:, :2], segments[:, 2:]) + 0.5 * bead_width_mm
    for n in np.argsort(-most_mm, kind="stable"):
        if most_mm[n] <= widest_mm:
            break
        near = (low <= boxes[n, 2:]).all(axis=1) & (high >= boxes[n, :2]).all(axis=1)
        lines = np.asarray(shapely.linestrings(segments[near].reshape(-1, 2, 2)), object)
        left = shapely.difference(shapely.clip_by_rect(region, *boxes[n]), ground(lines, bead_width_mm))
        for part in valid_polygons(left):
            across_mm = 2.0 * float(shapely.length(shapely.maximum_inscribed_circle(part)))
            if across_mm > widest_mm:
                widest_mm, widest = across_mm, part
    return widest_mm, widest
