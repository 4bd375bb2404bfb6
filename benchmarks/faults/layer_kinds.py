"""Faults of layers and beads as a whole: in the wrong place, at the wrong size, in another order, or of another part."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import shapely

from benchmarks.faults.kinds import Ground, NotHereError, Place, kind
from benchmarks.faults.metal_kinds import bead_end
from benchmarks.faults.motion_kinds import layer_places
from benchmarks.faults.program_text import Bead, ProgramText, end_of
from benchmarks.faults.shapes import Floats, about, bounds, centre, ends, move_lines, turn

ACROSS_MM = 0.1
"""By so much at least a line runs past another that it crosses."""

Line = tuple[tuple[float, float], tuple[float, float]]

# -- layers ------------------------------------------------------------------------------------------------


def _adjacent(ground: Ground) -> tuple[int, list[list[str]]]:
    """Number of a layer, and the lines of it and the next, of a program in one file."""
    layers = ground.text.layers()
    k = int(ground.random.integers(len(layers) - 1))
    return k, [ground.text.files[layers[n].file][layers[n].first : layers[n].end] for n in (k, k + 1)]


@kind("layers swapped", "metal")
def layers_swapped(ground: Ground) -> list[Place]:
    """Lay a layer before the one under it."""
    text = ground.text
    k, (below, above) = _adjacent(ground)
    low, high = text.layers()[k : k + 2]
    ground.what = f"layer {k + 2} is laid before layer {k + 1}"
    if text.sinumerik:
        i, j = (text.find(layer.file[:-4])[0] for layer in (low, high))
        lines = text.files[text.main]
        lines[i], lines[j] = lines[j], lines[i]
        return [
            *ground.line(text.main, i, j + 1),
            *ground.line(low.file, 0, low.end),
            *ground.line(high.file, 0, high.end),
        ]
    text.files[text.main][low.first : high.end] = above + below
    return ground.line(text.main, low.first, high.end)


@kind("layer omitted", "metal")
def layer_omitted(ground: Ground) -> list[Place]:
    """Leave a layer out, its call and its file."""
    text, layer = ground.text, ground.layer()
    ground.what = f"layer {layer.number + 1} is not laid"
    if text.sinumerik:
        call = text.find(layer.file[:-4])[0]
        text.delete(text.main, call)
        del text.files[layer.file]
        following = [n.file for n in text.layers()][layer.number : layer.number + 1]
        return ground.line(text.main, call - 1, call + 1) + [
            Place(f, 1, len(text.files[f])) for f in following
        ]
    text.delete(text.main, layer.first, layer.end)
    return ground.line(text.main, layer.first - 1, layer.first + 12)


@kind("layer twice", "metal")
def layer_twice(ground: Ground) -> list[Place]:
    """Lay a layer again."""
    text, layer = ground.text, ground.layer()
    ground.what = f"layer {layer.number + 1} is laid twice"
    if text.sinumerik:
        call = text.find(layer.file[:-4])[0]
        text.insert(text.main, call + 1, layer.file[:-4])
        return ground.line(text.main, call + 1) + ground.line(layer.file, 0, layer.end)
    lines = text.files[text.main][layer.first : layer.end]
    text.insert(text.main, layer.end, *lines)
    return ground.line(text.main, layer.end, layer.end + len(lines))


def _whole(ground: Ground, matrix: Floats, offset: Floats, what: str, least: int = 0) -> list[Place]:
    layer = ground.layer(least)
    move_lines(ground.text, layer.file, range(layer.first, layer.end), matrix, offset)
    ground.what = f"layer {layer.number + 1} {what}"
    return layer_places(ground, layer)


@kind("layer scaled", "metal", (1.02, 0.98))
def scaled(ground: Ground) -> list[Place]:
    """Scale a layer about its middle."""
    a = np.eye(2) * ground.variant
    low, high = bounds(ground.text)
    return _whole(ground, a, about(a, 0.5 * (low + high)), f"is scaled by {ground.variant:g}")


@kind("layer shifted", "metal", (0.3, 2.0))
def shifted(ground: Ground) -> list[Place]:
    """Shift a layer."""
    angle = ground.random.uniform(0.0, 2.0 * np.pi)
    offset = ground.variant * np.array([np.cos(angle), np.sin(angle)])
    return _whole(ground, np.eye(2), offset, f"is shifted by {ground.variant:g} mm")


@kind("layer mirrored", "metal", subjects=("prism", "bored", "two-spheres"))
def mirrored(ground: Ground) -> list[Place]:
    """Mirror a layer about the middle of the part."""
    a = np.diag([-1.0, 1.0])
    low, high = bounds(ground.text)
    return _whole(ground, a, about(a, 0.5 * (low + high)), "is mirrored")


@kind("layer turned", "metal", (1.5, 90.0), subjects=("prism", "bored", "two-spheres"))
def turned(ground: Ground) -> list[Place]:
    """Turn a layer about the middle of the part."""
    a = turn(ground.variant)
    low, high = bounds(ground.text)
    return _whole(ground, a, about(a, 0.5 * (low + high)), f"is turned by {ground.variant:g} deg")


@kind("part mirrored", "metal", subjects=("prism", "two-spheres"))
def all_mirrored(ground: Ground) -> list[Place]:
    """Mirror the whole program."""
    text = ground.text
    a = np.diag([-1.0, 1.0])
    low, high = bounds(text)
    for file, lines in text.files.items():
        move_lines(text, file, range(len(lines)), a, about(a, 0.5 * (low + high)))
    ground.what = "every layer is mirrored"
    return [Place(file, 1, len(lines)) for file, lines in text.files.items()]


@kind("contour inset", "metal", (3.0, 0.3))
def contour_inset(ground: Ground) -> list[Place]:
    """Bring a contour nearer to its middle."""
    text, bead = ground.text, ground.bead(contour=True, motions=3)
    points = ends(text, bead.file, bead.motions)
    half = 0.5 * float(np.ptp(points, axis=0).min())
    a = np.eye(2) * (1.0 - ground.variant / max(half, 2.0 * ground.variant))
    way = [i for i in range(bead.travel, bead.on) if text.code(bead.file, i).startswith("G0 X")]
    move_lines(text, bead.file, (*way, *bead.motions), a, about(a, centre(text, bead.file, bead.motions)))
    ground.what = f"a contour moved inward by {ground.variant:g} mm"
    return ground.line(bead.file, bead.travel, bead.off)


@kind(
    "hatch turned",
    "metal",
    (45.0, 90.0),
    unseen="lines of another direction that stay within their island, and lay its metal within the limits, are a hatch as good",
)
def hatch_turned(ground: Ground) -> list[Place]:
    """Turn the lines of an island about its middle."""
    return _turned(ground, ground.bead(contour=False, motions=4))


@kind(
    "hatch turned across other beads",
    "metal",
    (45.0, 90.0),
    subjects=("prism", "bored", "torus", "two-spheres"),
)
def hatch_turned_across(ground: Ground) -> list[Place]:
    """Turn the lines of an island about its middle, so that one runs across a bead of its layer."""
    text = ground.text
    found = [b for b in text.beads(contour=False) if len(b.motions) >= 4 and _runs_across(text, b, turn(ground.variant))]  # fmt: skip
    return _turned(ground, ground.pick(found))


def _turned(ground: Ground, bead: Bead) -> list[Place]:
    text, a = ground.text, turn(ground.variant)
    way = [i for i in range(bead.travel, bead.on) if text.code(bead.file, i).startswith("G0 X")]
    move_lines(text, bead.file, (*way, *bead.motions), a, about(a, centre(text, bead.file, bead.motions)))
    ground.what = f"an island turned by {ground.variant:g} deg"
    return ground.line(bead.file, bead.travel, bead.off)


def _runs_across(text: ProgramText, bead: Bead, a: Floats) -> bool:
    """Whether a bead that is mapped by `a` about its middle runs across a straight line of another of its layer."""
    offset = about(a, centre(text, bead.file, bead.motions))
    mine = [shapely.LineString(np.array(line) @ a.T + offset) for line in _lines(text, bead)]
    others = [
        shapely.LineString(line)
        for other in text.beads()
        if other.layer == bead.layer and other != bead
        for line in _lines(text, other)
    ]
    return any(
        one.crosses(other) and min(other.distance(shapely.Point(end)) for end in one.coords) > ACROSS_MM
        for one in mine
        for other in others
    )


def _lines(text: ProgramText, bead: Bead) -> list[Line]:
    """Start and end of every straight motion of a bead."""
    codes = [text.code(bead.file, i) for i in bead.motions]
    places = [bead.start]
    for code in codes:
        places.append(end_of(code, places[-1]))
    return [line for line, code in zip(pairwise(places), codes, strict=True) if code.startswith("G1 ")]


def _bead_shifted(ground: Ground, bead: Bead) -> list[Place]:
    text = ground.text
    angle = ground.random.uniform(0.0, 2.0 * np.pi)
    way = [i for i in range(bead.travel, bead.on) if text.code(bead.file, i).startswith("G0 X")]
    offset = ground.variant * np.array([np.cos(angle), np.sin(angle)])
    move_lines(text, bead.file, (*way, *bead.motions), np.eye(2), offset)
    ground.what = f"a bead of {'a contour' if bead.contour else 'an island'} shifted by {ground.variant:g} mm"
    return ground.line(bead.file, bead.travel, bead.off)


@kind("contour shifted", "metal", (0.3, 1.5))
def contour_shifted(ground: Ground) -> list[Place]:
    """Shift a contour as a whole."""
    return _bead_shifted(ground, ground.bead(contour=True))


@kind("island shifted", "metal", (4.0, 6.0))
def island_shifted(ground: Ground) -> list[Place]:
    """Shift the lines of an island as a whole."""
    return _bead_shifted(ground, ground.bead(contour=False, motions=3))


@kind("island shifted a little", "metal", (0.3, 2.0), unseen="beads overlap by more, so that no gap over the limit opens")  # fmt: skip
def island_shifted_a_little(ground: Ground) -> list[Place]:
    """Shift the lines of an island by less than what the text's metal shows."""
    return _bead_shifted(ground, ground.bead(contour=False))


# -- order -------------------------------------------------------------------------------------------------


@kind("contours after the hatch", "metal", unseen="an order that changes no metal")
def contours_last(ground: Ground) -> list[Place]:
    """Lay the contours of a layer after its islands."""
    text = ground.text
    beads = text.beads()
    layer = ground.pick(
        [n for n in text.layers() if {True, False} <= {b.contour for b in beads if b.layer == n.number}]
    )
    lines = text.files[layer.file]
    a = next(i for i in range(layer.first, layer.end) if lines[i].startswith("; RING"))
    b = next(i for i in range(layer.first, layer.end) if lines[i].startswith("; ISLAND"))
    end = max(bead.off for bead in beads if bead.layer == layer.number) + 1
    rise = f"G0 Z{layer.safe_z:.6f}"
    lines[a:end] = [rise, *lines[b:end], rise, *lines[a:b]]
    ground.what = f"contours of layer {layer.number + 1} come after its islands"
    return ground.line(layer.file, a, end + 2)


@kind("islands in another order", "metal", unseen="an order that changes no metal")
def islands_swapped(ground: Ground) -> list[Place]:
    """Exchange two neighbouring islands."""
    text = ground.text
    found = []
    for layer in text.layers():
        lines = text.files[layer.file]
        marks = [i for i in range(layer.first, layer.end) if lines[i].startswith("; ISLAND")]
        last = max((b.off + 1 for b in text.beads() if b.layer == layer.number), default=0)
        found += [(layer, *x) for x in zip(marks, marks[1:], [*marks[2:], last], strict=False)]
    layer, a, b, c = ground.pick(found)
    lines = text.files[layer.file]
    rise = f"G0 Z{layer.safe_z:.6f}"
    lines[a:c] = [rise, *lines[b:c], rise, *lines[a:b]]
    ground.what = "two islands change places"
    return ground.line(layer.file, a, c + 2)


@kind("bead reversed", "metal", unseen="the same metal, laid from the other end")
def reversed_bead(ground: Ground) -> list[Place]:
    """Lay a single line from its end to its start."""
    text = ground.text
    found = [b for b in text.beads(contour=False) if len(b.motions) == 1 and text.code(b.file, b.first).startswith("G1 ")
             and any(text.code(b.file, i).startswith("G0 X") for i in range(b.travel, b.on))]  # fmt: skip
    bead = ground.pick(found)
    way = next(i for i in range(bead.travel, bead.on) if text.code(bead.file, i).startswith("G0 X"))
    end = bead_end(text, bead)
    for name, here, there in zip("XY", bead.start, end, strict=True):
        text.set_word(bead.file, way, name, there)
        text.set_word(bead.file, bead.first, name, here)
    ground.what = "a line laid from its end"
    return ground.line(bead.file, way, bead.off)


@kind(
    "seam moved",
    "metal",
    unseen="a contour that starts elsewhere is the same contour",
    subjects=("cube", "prism"),
)
def seam_moved(ground: Ground) -> list[Place]:
    """Start a contour at its second corner."""
    text = ground.text
    found = [
        b
        for b in text.beads(contour=True)
        if all(text.code(b.file, i).startswith("G1 ") for i in b.motions)
        and b.last - b.first == len(b.motions) - 1
    ]
    bead = ground.pick(found)
    points = ends(text, bead.file, bead.motions)
    way = next(i for i in range(bead.travel, bead.on) if text.code(bead.file, i).startswith("G0 X"))
    shifted_points = [*points[1:], points[0]]
    for name, value in zip("XY", points[0], strict=True):
        text.set_word(bead.file, way, name, float(value))
    for i, place in zip(bead.motions, shifted_points, strict=True):
        for name, value in zip("XY", place, strict=True):
            text.set_word(bead.file, i, name, float(value))
    ground.what = "a contour starts one corner later"
    return ground.line(bead.file, bead.travel, bead.off)


# -- other programs ----------------------------------------------------------------------------------------


@kind("program of another part", "metal")
def other_part(ground: Ground) -> list[Place]:
    """Put the program of another part in the place of this one's."""
    name = "cube" if ground.subject.name != "cube" else "prism"
    return _exchanged(ground, f"that of the part {name}", name)


@kind("program of another layer height", "metal", subjects=("cube", "prism", "bored"))
def other_layers(ground: Ground) -> list[Place]:
    """Put the program of the same part, cut into other layers, in the place of this one's."""
    return _exchanged(ground, "that of layers of 1.25 mm", layers={"layer_height_mm": 1.25})


@kind("program of another bead width", "metal", subjects=("cube", "prism", "bored"))
def other_width(ground: Ground) -> list[Place]:
    """Put the program of the same part by narrower beads in the place of this one's."""
    return _exchanged(ground, "that of beads of 5 mm", process={"bead_width_mm": 5.0})


def _exchanged(ground: Ground, what: str, name: str = "", **changes: dict[str, Any]) -> list[Place]:
    """Put another program in the place of this one's; every line of it is at fault."""
    if ground.other is None:
        raise NotHereError
    ground.text.files = ground.other(name or ground.subject.name, **changes).files
    ground.what = f"the program is {what}"
    return [Place(file, 1, len(lines)) for file, lines in ground.text.files.items()]


@kind("twelve sides made a circle", "metal", subjects=("twelve-sides",))
def made_round(ground: Ground) -> list[Place]:
    """Put the program of the circle about a part of twelve sides in the place of this one's."""
    if ground.other is None:
        raise NotHereError
    ground.text.files = ground.other("round").files
    ground.what = "the program is that of the circle about the part, 0.988 mm off"
    return [Place(file, 1, len(lines)) for file, lines in ground.text.files.items()]
