"""Faults of metal in the air: bodies and islands that begin where nothing stands under them."""

from __future__ import annotations

import re

from benchmarks.faults.kinds import Ground, NotHereError, Place, kind
from benchmarks.faults.metal_kinds import extra_bead
from benchmarks.faults.program_text import NUMBER, Bead, Layer, word
from benchmarks.faults.shapes import bounds, move_lines, turn

BESIDE_MM = 30.0
"""Between the part and a body that is laid beside it: further than any pool or bead reaches."""


def _beads(ground: Ground, layer: Layer) -> tuple[Bead, Bead]:
    """First and last bead of a layer."""
    mine = [bead for bead in ground.text.beads() if bead.layer == layer.number]
    if not mine:
        raise NotHereError
    return mine[0], mine[-1]


@kind("body that begins in the air", "metal", (1, 2))
def body_in_the_air(ground: Ground) -> list[Place]:
    """Lay all that a layer and those over it have once more, beside the part, where nothing stands under it."""
    text, first = ground.text, ground.variant
    low, high = bounds(text)
    offset = (-(float(high[0] - low[0]) + BESIDE_MM), 0.0)
    places: list[Place] = []
    for layer in reversed(text.layers()[first:]):
        begin, end = _beads(ground, layer)
        lines = [f"G0 Z{layer.safe_z:.6f}", *text.files[layer.file][begin.travel : end.off + 1]]
        at = end.off + 1
        text.insert(layer.file, at, *lines)
        move_lines(text, layer.file, range(at, at + len(lines)), turn(0.0), offset)
        places = [*ground.line(layer.file, at, at + len(lines)), *places]
    if not places:
        raise NotHereError
    ground.what = f"a body beside the part from layer {first + 1} on, with nothing under it"
    return places


@kind("island that floats in a bore", "metal", subjects=("bored",))
def floats_in_a_bore(ground: Ground) -> list[Place]:
    """Lay a bead in the middle of a bore, over nothing."""
    bead = ground.bead(contour=False, least_layer=1)
    ground.what = f"bead in the middle of a bore, on layer {bead.layer + 1} alone"
    return extra_bead(ground, bead, [(-10.5, 0.0), (-9.5, 0.0)], "in a role")


@kind("body over an empty layer", "metal")
def over_an_empty_layer(ground: Ground) -> list[Place]:
    """Take all beads out of a layer; it is called, and those over it are laid."""
    text = ground.text
    layers = text.layers()
    layer = ground.pick(layers[:-1])
    begin, end = _beads(ground, layer)
    text.delete(layer.file, begin.travel, end.off + 1)
    ground.what = f"layer {layer.number + 1} lays nothing, those over it lie in the air"
    over = layers[layer.number + 1]
    gone = end.off + 1 - begin.travel if over.file == layer.file else 0
    return [
        *ground.line(layer.file, begin.travel),
        *ground.line(over.file, over.first - gone, over.end - gone),
    ]


@kind("layers lifted", "metal")
def lifted(ground: Ground) -> list[Place]:
    """Lift a layer and all over it by its height, so that nothing is under them."""
    text, layers = ground.text, ground.text.layers()
    first = ground.pick(layers[1:])
    by_mm = first.z - layers[first.number - 1].z
    for layer in layers[first.number :]:
        for i in range(layer.first, layer.end):
            code = text.code(layer.file, i)
            if re.fullmatch(rf"G0 Z{NUMBER}", code):
                text.set_word(layer.file, i, "Z", (word(code, "Z") or 0.0) + by_mm)
    ground.what = f"layers from {first.number + 1} on are lifted by {by_mm:.3f} mm"
    return [Place(layer.file, layer.first + 1, layer.end) for layer in layers[first.number :]]
