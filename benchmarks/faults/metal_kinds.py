"""Faults of the metal: beads too many, too few, in the wrong place or in the wrong order."""

from __future__ import annotations

import numpy as np

from benchmarks.faults.kinds import Ground, NotHereError, Place, kind
from benchmarks.faults.motion_kinds import layer_places
from benchmarks.faults.program_text import Bead, ProgramText
from benchmarks.faults.shapes import about, bounds, centre, ends, move_lines, turn

OUTSIDE_MM = 40.0
"""How far beside the part an extra bead lies."""

ROLES = ("in a role", "before the first role", "in the main program", "as turns")
"""Where an extra bead stands, and what its comments say."""


# -- beads too many -----------------------------------------------------------------------------------


def extra_bead(ground: Ground, bead: Bead, points: list[tuple[float, float]], how: str) -> list[Place]:
    """Lay one more bead of the same power and wire as another, after it or where `how` says."""
    text = ground.text
    z = text.layers()[bead.layer].z
    safe = text.layers()[bead.layer].safe_z
    on = [line for line in text.files[bead.file][bead.on : bead.first]]
    off = text.files[bead.file][_wire_off(text, bead) : bead.off + 1]
    mark = " ; TURN" if how == "as turns" else ""
    (x, y), rest = points[0], points[1:]
    block = [f"G0 Z{safe:.6f}", f"G0 X{x:.6f} Y{y:.6f}", f"G0 Z{z:.6f}", *on]
    block += [f"G1 X{x:.6f} Y{y:.6f}{' F600' if k == 0 else ''}{mark}" for k, (x, y) in enumerate(rest)]
    block += [*off, f"G0 Z{safe:.6f}"]
    file, i = _spot(text, bead, how)
    if (file, i) == (bead.file, bead.off + 1) and text.code(file, i).startswith("G0 X"):
        block += [f"G0 X{bead_end(text, bead)[0]:.6f} Y{bead_end(text, bead)[1]:.6f}", f"G0 Z{z:.6f}"]
    text.insert(file, i, *block)
    return ground.line(file, i, i + len(block))


def _wire_off(text: ProgramText, bead: Bead) -> int:
    return text.find(text.codes.wire_off, bead.file, bead.last, bead.off + 1)[0]


def bead_end(text: ProgramText, bead: Bead) -> tuple[float, float]:
    """Place where a bead ends."""
    return text.position(bead.file, bead.off)


def _spot(text: ProgramText, bead: Bead, how: str) -> tuple[str, int]:
    """File and line before which an extra bead is inserted."""
    layer = text.layers()[bead.layer]
    if how == "before the first role":
        first = next(b for b in text.beads() if b.layer == bead.layer)
        lines = text.files[first.file]
        role = next(i for i in range(layer.first, first.on) if lines[i].startswith("; RING"))
        return layer.file, role
    if how == "in the main program":
        if text.sinumerik:
            return text.main, text.find(layer.file[:-4])[0] + 1
        return text.main, text.layers()[0].first if bead.layer == 0 else layer.first
    return bead.file, bead.off + 1


@kind("bead beside the part", "metal", ROLES)
def outside(ground: Ground) -> list[Place]:
    """Lay a bead 40 mm beside the part."""
    least, greatest = bounds(ground.text)
    bead = ground.bead()
    x = float(least[0]) - OUTSIDE_MM
    y = float(ground.random.uniform(least[1], greatest[1]))
    ground.what = f"bead of 10 mm, {OUTSIDE_MM:g} mm beside the part, {ground.variant}"
    points = [(x, y), (x + 5, y), (x + 10, y)] if ground.variant == "as turns" else [(x, y), (x + 10, y)]
    return extra_bead(ground, bead, points, ground.variant)


@kind("bead across a channel", "metal", ROLES, subjects=("bored",))
def across_channel(ground: Ground) -> list[Place]:
    """Close a bore with a bead."""
    bead = ground.bead(contour=False)
    ground.what = f"bead across the bore, {ground.variant}"
    points = [(-18.0, 0.0), (-14.0, 0.0), (-10.0, 0.0), (-6.0, 0.0), (-2.0, 0.0)]
    return extra_bead(ground, bead, points if ground.variant == "as turns" else points[::4], ground.variant)


@kind("extra bead in an island", "metal", ("in a role", "as turns"))
def extra_in_island(ground: Ground) -> list[Place]:
    """Lay a bead over those of an island."""
    bead = ground.bead(contour=False, motions=2)
    inner = ends(ground.text, bead.file, bead.motions)
    ground.what = f"bead over those of an island, {ground.variant}"
    a, b = inner[0], inner[-1] if np.ptp(inner, axis=0).max() > 3.0 else inner[0] + 6.0
    return extra_bead(ground, bead, [tuple(a), tuple(0.5 * (a + b)), tuple(b)], ground.variant)


def _repeat(ground: Ground, bead: Bead, what: str) -> list[Place]:
    text = ground.text
    layer = text.layers()[bead.layer]
    lines = text.files[bead.file][bead.on : bead.off + 1]
    x, y = bead.start
    block = [f"G0 Z{layer.safe_z:.6f}", f"G0 X{x:.6f} Y{y:.6f}", f"G0 Z{layer.z:.6f}", *lines]
    text.insert(bead.file, bead.off + 1, *block)
    ground.what = what
    return ground.line(bead.file, bead.off + 1, bead.off + 1 + len(block))


@kind("contour twice", "metal")
def contour_twice(ground: Ground) -> list[Place]:
    """Lay a contour again."""
    return _repeat(ground, ground.bead(contour=True), "a contour laid twice")


@kind("island twice", "metal")
def island_twice(ground: Ground) -> list[Place]:
    """Lay the lines of an island again."""
    return _repeat(ground, ground.bead(contour=False), "an island laid twice")


# -- beads too few --------------------------------------------------------------------------------------


def _omit(ground: Ground, bead: Bead) -> list[Place]:
    ground.text.delete(bead.file, bead.on, bead.off + 1)
    return ground.line(bead.file, bead.travel, bead.on + 4)


@kind("contour omitted", "metal")
def no_contour(ground: Ground) -> list[Place]:
    """Leave a contour out; its travel stays."""
    ground.what = "a contour is not laid"
    return _omit(ground, ground.bead(contour=True))


@kind("island omitted", "metal")
def no_island(ground: Ground) -> list[Place]:
    """Leave an island out; its travel stays."""
    ground.what = "an island is not laid"
    return _omit(ground, ground.bead(contour=False, motions=3))


@kind("short bead omitted", "metal")
def no_gap_bead(ground: Ground) -> list[Place]:
    """Leave out a bead of one motion: of a gap, or the rest of an island."""
    text = ground.text
    short = [b for b in text.beads(contour=False) if len(b.motions) == 1]
    bead = ground.pick(short)
    ground.what = f"a bead of one motion is not laid at line {bead.first + 1}"
    return _omit(ground, bead)


@kind("hatch line omitted", "metal")
def no_line(ground: Ground) -> list[Place]:
    """Take a line of an island out, so that its neighbours are joined."""
    text = ground.text
    found = [
        (b, k)
        for b in text.beads(contour=False)
        for k in range(2, len(b.motions) - 2)
        if text.is_turn(b.file, b.motions[k + 1]) and not text.is_turn(b.file, b.motions[k])
        and np.ptp(ends(text, b.file, b.motions[k - 1 : k + 1]), axis=0).max() > 6.0
    ]  # fmt: skip
    bead, k = ground.pick(found)
    for i in (bead.motions[k + 1], bead.motions[k]):
        text.delete(bead.file, i)
    ground.what = "a hatch line and its turn are left out"
    return ground.line(bead.file, bead.motions[k - 1], bead.motions[k] + 1)


@kind("bead cut short", "metal", (3.0,))
def cut_short(ground: Ground) -> list[Place]:
    """End a bead before its end."""
    return _stretched(ground, -ground.variant)


@kind("bead runs on", "metal", (8.0,))
def runs_on(ground: Ground) -> list[Place]:
    """End a bead after its end."""
    return _stretched(ground, ground.variant)


def _stretched(ground: Ground, by_mm: float) -> list[Place]:
    text = ground.text
    found = []
    for bead in text.beads(contour=False):
        start, end = text.position(bead.file, bead.last), bead_end(text, bead)
        length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
        if text.code(bead.file, bead.last).startswith("G1 ") and length > 4.0:
            found.append((bead, np.array(start), np.array(end), length))
    bead, start, end, length = ground.pick(found)
    place = end + by_mm / length * (end - start)
    for name, value in zip("XY", place, strict=True):
        text.set_word(bead.file, bead.last, name, float(value))
    ground.what = f"the last line of an island is {by_mm:+g} mm longer"
    return ground.line(bead.file, bead.last)


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


def _whole(ground: Ground, matrix: np.ndarray, offset: np.ndarray, what: str, least: int = 0) -> list[Place]:
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


@kind("hatch turned", "metal", (20.0, 90.0))
def hatch_turned(ground: Ground) -> list[Place]:
    """Turn the lines of an island about its middle."""
    text, bead = ground.text, ground.bead(contour=False, motions=4)
    a = turn(ground.variant)
    way = [i for i in range(bead.travel, bead.on) if text.code(bead.file, i).startswith("G0 X")]
    move_lines(text, bead.file, (*way, *bead.motions), a, about(a, centre(text, bead.file, bead.motions)))
    ground.what = f"an island turned by {ground.variant:g} deg"
    return ground.line(bead.file, bead.travel, bead.off)


@kind("bead shifted", "metal", (0.3, 1.5))
def bead_shifted(ground: Ground) -> list[Place]:
    """Shift one bead as a whole."""
    text, bead = ground.text, ground.bead()
    angle = ground.random.uniform(0.0, 2.0 * np.pi)
    way = [i for i in range(bead.travel, bead.on) if text.code(bead.file, i).startswith("G0 X")]
    offset = ground.variant * np.array([np.cos(angle), np.sin(angle)])
    move_lines(text, bead.file, (*way, *bead.motions), np.eye(2), offset)
    ground.what = f"a bead of {'a contour' if bead.contour else 'an island'} shifted by {ground.variant:g} mm"
    return ground.line(bead.file, bead.travel, bead.off)


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
        if text.code(b.file, b.first).startswith("G1 ") and len(b.motions) > 3
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
    if ground.other is None:
        raise NotHereError
    name = "cube" if ground.subject.name != "cube" else "prism"
    ground.text.files = ground.other(name).files
    ground.what = f"the program is that of the part {name}"
    return [Place(file, 1, len(lines)) for file, lines in ground.text.files.items()]


@kind("program of another layer height", "metal", subjects=("cube", "prism", "bored"))
def other_layers(ground: Ground) -> list[Place]:
    """Put the program of the same part, cut into other layers, in the place of this one's."""
    if ground.other is None:
        raise NotHereError
    ground.text.files = ground.other(ground.subject.name, layers={"layer_height_mm": 1.25}).files
    ground.what = "the program is that of layers of 1.25 mm"
    return [Place(file, 1, len(lines)) for file, lines in ground.text.files.items()]


@kind("program of another bead width", "metal", subjects=("cube", "prism", "bored"))
def other_width(ground: Ground) -> list[Place]:
    """Put the program of the same part by narrower beads in the place of this one's."""
    if ground.other is None:
        raise NotHereError
    ground.text.files = ground.other(ground.subject.name, process={"bead_width_mm": 5.0}).files
    ground.what = "the program is that of beads of 5 mm"
    return [Place(file, 1, len(lines)) for file, lines in ground.text.files.items()]
