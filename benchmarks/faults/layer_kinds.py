"""Faults of layers as a whole: left out, doubled, in another order or place, in the air, or of another part."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.faults.kinds import METAL, Ground, NotHereError, Place, kind
from benchmarks.faults.program_text import NUMBER, Bead, Floats, Layer, about, turn, word

BESIDE_MM = 30.0
"""Between the part and a body that is laid beside it: further than any pool or bead reaches."""

MIRROR = np.diag([-1.0, 1.0])


def layer_places(ground: Ground, layer: Layer) -> list[Place]:
    """Lines of a layer, and of its call."""
    calls = ground.text.find(layer.file[:-4]) if ground.text.sinumerik else []
    places = ground.line(layer.file, layer.first, layer.end)
    return places + [place for i in calls for place in ground.line(ground.text.main, i)]


# -- layers that are swapped, left out or doubled ------------------------------------------------------


def _swapped(ground: Ground) -> list[Place]:
    text = ground.text
    layers = text.layers()
    k = int(ground.random.integers(len(layers) - 1))
    low, high = layers[k : k + 2]
    ground.what = f"layer {k + 2} is laid before layer {k + 1}"
    lines = text.files[text.main]
    if text.sinumerik:
        i, j = (text.find(layer.file[:-4])[0] for layer in (low, high))
        lines[i], lines[j] = lines[j], lines[i]
        files = [place for layer in (low, high) for place in ground.line(layer.file, 0, layer.end)]
        return [*ground.line(text.main, i, j + 1), *files]
    lines[low.first : high.end] = lines[high.first : high.end] + lines[low.first : low.end]
    return ground.line(text.main, low.first, high.end)


def _taken_out(ground: Ground, layer: Layer) -> int:
    """Take a layer out, with its call and its file; the line at which it stood in the main program."""
    text = ground.text
    if not text.sinumerik:
        text.delete(text.main, layer.first, layer.end)
        return layer.first
    call = text.find(layer.file[:-4])[0]
    text.delete(text.main, call)
    del text.files[layer.file]
    return call


def _omitted(ground: Ground) -> list[Place]:
    text, layer = ground.text, ground.layer()
    ground.facts["layer"] = layer.number + 1
    at = _taken_out(ground, layer)
    if not text.sinumerik:
        return ground.line(text.main, at - 1, at + 12)
    following = [n.file for n in text.layers()][layer.number : layer.number + 1]
    return ground.line(text.main, at - 1, at + 1) + [Place(f, 1, len(text.files[f])) for f in following]


def _last_omitted(ground: Ground) -> list[Place]:
    text = ground.text
    at = _taken_out(ground, text.layers()[-1])
    if text.sinumerik:
        return ground.line(text.main, at - 2, at + 2)
    return [Place(text.main, max(at - 12, 1), len(text.files[text.main]))]


def _twice(ground: Ground) -> list[Place]:
    text, layer = ground.text, ground.layer()
    ground.facts["layer"] = layer.number + 1
    if text.sinumerik:
        again = ground.insert(text.main, text.find(layer.file[:-4])[0] + 1, layer.file[:-4])
        return again + ground.line(layer.file, 0, layer.end)
    return ground.insert(text.main, layer.end, *text.files[text.main][layer.first : layer.end])


# -- layers elsewhere ----------------------------------------------------------------------------------


def _mapped(ground: Ground, by: Callable[[Any], Floats] | None = None) -> list[Place]:
    """A layer, mapped by a matrix of the variant about the middle of the part, or shifted at random."""
    if by is None:
        matrix, offset = np.eye(2), ground.step(ground.variant)
    else:
        matrix = by(ground.variant)
        offset = about(matrix, 0.5 * sum(ground.text.bounds()))
    layer = ground.layer()
    ground.text.move(layer.file, range(layer.first, layer.end), matrix, offset)
    ground.facts["layer"] = layer.number + 1
    return layer_places(ground, layer)


def _all_mirrored(ground: Ground) -> list[Place]:
    offset = about(MIRROR, 0.5 * sum(ground.text.bounds()))
    for file, lines in ground.text.files.items():
        ground.text.move(file, range(len(lines)), MIRROR, offset)
    return ground.whole_program()


def _at_another_height(ground: Ground) -> list[Place]:
    text, layer = ground.text, ground.layer(1)
    for i in text.rises(layer, layer.z):
        text.set_words(layer.file, i, "Z", [layer.z + ground.variant])
    ground.what = f"layer {layer.number + 1} at Z {layer.z + ground.variant:.3f} in place of {layer.z:.3f}"
    return layer_places(ground, layer)


def _lifted(ground: Ground) -> list[Place]:
    """A layer and all over it, lifted by its height, so that nothing is under them."""
    text, layers = ground.text, ground.text.layers()
    first = ground.pick(layers[1:])
    by_mm = first.z - layers[first.number - 1].z
    for layer in layers[first.number :]:
        for i in text.find(rf"G0 Z{NUMBER}", layer.file, layer.first, layer.end):
            text.set_words(layer.file, i, "Z", [(word(text.code(layer.file, i), "Z") or 0.0) + by_mm])
    ground.what = f"layers from {first.number + 1} on are lifted by {by_mm:.3f} mm"
    return [Place(layer.file, layer.first + 1, layer.end) for layer in layers[first.number :]]


# -- metal over nothing --------------------------------------------------------------------------------


def _ends_of(ground: Ground, layer: Layer) -> tuple[Bead, Bead]:
    """First and last bead of a layer."""
    beads = [bead for bead in ground.text.beads() if bead.layer == layer.number]
    if not beads:
        raise NotHereError
    return beads[0], beads[-1]


def _body_in_the_air(ground: Ground) -> list[Place]:
    """All that a layer and those over it have once more, beside the part."""
    text, first = ground.text, ground.variant
    low, high = text.bounds()
    offset = (-(float(high[0] - low[0]) + BESIDE_MM), 0.0)
    places: list[Place] = []
    for layer in reversed(text.layers()[first:]):
        begin, end = _ends_of(ground, layer)
        lines = [f"G0 Z{layer.safe_z:.6f}", *text.files[layer.file][begin.travel : end.off + 1]]
        again = ground.insert(layer.file, end.off + 1, *lines)
        text.move(layer.file, range(end.off + 1, end.off + 1 + len(lines)), np.eye(2), offset)
        places = again + places
    if not places:
        raise NotHereError
    ground.facts["layer"] = first + 1
    return places


def _over_an_empty_layer(ground: Ground) -> list[Place]:
    """A layer without beads is called, and those over it are laid."""
    text, layers = ground.text, ground.text.layers()
    layer = ground.pick(layers[:-1])
    begin, end = _ends_of(ground, layer)
    text.delete(layer.file, begin.travel, end.off + 1)
    over = layers[layer.number + 1]
    gone = end.off + 1 - begin.travel if over.file == layer.file else 0
    ground.facts["layer"] = layer.number + 1
    return ground.line(layer.file, begin.travel) + ground.line(over.file, over.first - gone, over.end - gone)


# -- order within a layer ------------------------------------------------------------------------------


def _exchanged(ground: Ground, layer: Layer, a: int, b: int, c: int) -> list[Place]:
    """Exchange the lines from `a` and those from `b` up to `c`, with a rise before each."""
    lines, rise = ground.text.files[layer.file], f"G0 Z{layer.safe_z:.6f}"
    lines[a:c] = [rise, *lines[b:c], rise, *lines[a:b]]
    return ground.line(layer.file, a, c + 2)


def _contours_last(ground: Ground) -> list[Place]:
    text, beads = ground.text, ground.text.beads()
    both = [n for n in text.layers() if {True, False} <= {b.contour for b in beads if b.layer == n.number}]
    layer = ground.pick(both)
    lines = text.files[layer.file]
    a, b = (
        next(i for i in range(layer.first, layer.end) if lines[i].startswith(f"; {role}"))
        for role in ("RING", "ISLAND")
    )
    ground.facts["layer"] = layer.number + 1
    return _exchanged(ground, layer, a, b, max(b.off for b in beads if b.layer == layer.number) + 1)


def _islands_swapped(ground: Ground) -> list[Place]:
    text, found = ground.text, []
    for layer in text.layers():
        lines = text.files[layer.file]
        marks = [i for i in range(layer.first, layer.end) if lines[i].startswith("; ISLAND")]
        last = max((b.off + 1 for b in text.beads() if b.layer == layer.number), default=0)
        found += [(layer, *x) for x in zip(marks, marks[1:], [*marks[2:], last], strict=False)]
    return _exchanged(ground, *ground.pick(found))


# -- other programs ------------------------------------------------------------------------------------


def _another_program(ground: Ground, part: str = "", **changes: dict[str, Any]) -> list[Place]:
    """Another program in the place of this one's; every line of it is at fault."""
    if ground.other is None:
        raise NotHereError
    name = part or ground.subject.name
    if name == part == ground.subject.name:
        name = "prism"
    ground.text.files = ground.other(name, **changes).files
    ground.facts["part"] = name
    return ground.whole_program()


# -- the kinds -------------------------------------------------------------------------------------------

UNEVEN_PARTS = ("prism", "bored", "two-spheres")
FLAT_PARTS = ("cube", "prism", "bored")
# fmt: off
kind("layers swapped", METAL, _swapped)
kind("layer omitted", METAL, _omitted, what="layer {layer} is not laid")
kind("last layer missing", METAL, _last_omitted, what="the last layer is missing")
kind("layer twice", METAL, _twice, what="layer {layer} is laid twice")
kind("layer scaled", METAL, _mapped, (1.02, 0.98), by=lambda factor: np.eye(2) * factor, what="layer {layer} is scaled by {v:g}")
kind("layer shifted", METAL, _mapped, (0.3, 2.0), what="layer {layer} is shifted by {v:g} mm")
kind("layer mirrored", METAL, _mapped, by=lambda _: MIRROR, subjects=UNEVEN_PARTS, what="layer {layer} is mirrored")
kind("layer turned", METAL, _mapped, (1.5, 90.0), by=turn, subjects=UNEVEN_PARTS, what="layer {layer} is turned by {v:g} deg")
kind("part mirrored", METAL, _all_mirrored, subjects=("prism", "two-spheres"), what="every layer is mirrored")
kind("layer at another height", METAL, _at_another_height, (0.3, -0.3))
kind("layers lifted", METAL, _lifted)
kind("body that begins in the air", METAL, _body_in_the_air, (1, 2),
     what="a body beside the part from layer {layer} on, with nothing under it")
kind("body over an empty layer", METAL, _over_an_empty_layer,
     what="layer {layer} lays nothing, those over it lie in the air")
kind("contours after the hatch", METAL, _contours_last, what="contours of layer {layer} come after its islands",
     unseen="an order that changes no metal")
kind("islands in another order", METAL, _islands_swapped, what="two islands change places", unseen="an order that changes no metal")
kind("program of another part", METAL, _another_program, part="cube", what="the program is that of the part {part}")
kind("program of another layer height", METAL, _another_program, subjects=FLAT_PARTS, layers={"layer_height_mm": 1.25},
     what="the program is that of layers of 1.25 mm")
kind("program of another bead width", METAL, _another_program, subjects=FLAT_PARTS, process={"bead_width_mm": 5.0},
     what="the program is that of beads of 5 mm")
kind("twelve sides made a circle", METAL, _another_program, subjects=("twelve-sides",), part="round",
     what="the program is that of the circle about the part, 0.988 mm off")
# fmt: on
