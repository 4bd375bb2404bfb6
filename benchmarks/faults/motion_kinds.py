"""Faults of travel: rapids through metal, retracts left out, Z in the wrong place."""

from __future__ import annotations

import math
import re

from benchmarks.faults.kinds import Ground, NotHereError, Place, kind
from benchmarks.faults.program_text import NUMBER, Bead, Layer, word

LEAST_HOP_MM = 12.0
"""Ways shorter than two bead spacings need no retract."""


def _hops(ground: Ground, least_layer: int = 1) -> list[tuple[Layer, int, int, int]]:
    """Layer, and lines of retract, way in X and Y, and descent, of every long way within a layer."""
    text = ground.text
    found: list[tuple[Layer, int, int, int]] = []
    layers = {layer.number: layer for layer in text.layers()}
    for before, bead in zip(text.beads(), text.beads()[1:], strict=False):
        layer = layers[bead.layer]
        if before.layer != bead.layer or bead.layer < least_layer:
            continue
        rows = [i for i in range(before.off, bead.on) if text.code(bead.file, i).startswith("G0")]
        words = [text.code(bead.file, i)[:4] for i in rows]
        if words != ["G0 Z", "G0 X", "G0 Z"]:
            continue
        x, y = text.position(bead.file, rows[1])
        if math.dist((x, y), bead.start) >= LEAST_HOP_MM:
            found.append((layer, rows[0], rows[1], rows[2]))
    return found


@kind("rapid through the metal", "motion", ("under the top", "at the top", "just over the top"))
def rapid_low(ground: Ground) -> list[Place]:
    """Lower the retract of a long way."""
    layer, up, way, _ = ground.pick(_hops(ground))
    z = {"under the top": 0.5 * layer.z, "at the top": layer.z, "just over the top": layer.z + 0.4}[
        ground.variant
    ]
    ground.text.set_word(layer.file, up, "Z", z)
    ground.what = f"way over the part at Z {z:.3f}, top of the layer {layer.z:.3f}"
    return ground.line(layer.file, up, way + 1)


@kind("retract deleted", "motion")
def no_retract(ground: Ground) -> list[Place]:
    """Take the retract of one long way out."""
    layer, up, way, _ = ground.pick(_hops(ground))
    ground.text.delete(layer.file, up)
    ground.what = "no retract before a long way"
    return ground.line(layer.file, way - 1)


@kind("every retract deleted", "motion")
def no_retracts(ground: Ground) -> list[Place]:
    """Take out every rise but the first."""
    text = ground.text
    heights = {layer.safe_z for layer in text.layers()}
    rows = [
        (file, i) for file, i in text.everywhere(rf"G0 Z{NUMBER}") if word(text.code(file, i), "Z") in heights
    ]
    for file, i in reversed(rows[1:]):
        text.delete(file, i)
    ground.what = "no rise at all after the first"
    return [p for file, i in text.everywhere(r"G0 X.*") for p in ground.line(file, i)]


@kind("X, Y and Z in one rapid", "motion")
def diagonal(ground: Ground) -> list[Place]:
    """Come down along the way."""
    layer, _, way, down = ground.pick(_hops(ground))
    text = ground.text
    z = text.code(layer.file, down).partition("Z")[2]
    text.set(layer.file, way, f"{text.code(layer.file, way)} Z{z}")
    text.delete(layer.file, down)
    ground.what = "way and descent in one block"
    return ground.line(layer.file, way)


@kind("descent before the way", "motion")
def early_descent(ground: Ground) -> list[Place]:
    """Exchange way and descent."""
    layer, _, way, down = ground.pick(_hops(ground))
    lines = ground.text.files[layer.file]
    lines[way], lines[down] = lines[down], lines[way]
    ground.what = "down first, then along at the layer's height"
    return ground.line(layer.file, way, down + 1)


@kind("plunge", "motion", ("into the plate", "into the layer below", "a quarter of a layer"))
def plunge(ground: Ground) -> list[Place]:
    """Go down beside a bead, in rapid, and up again."""
    bead: Bead = ground.bead(least_layer=1)
    layer = ground.text.layers()[bead.layer]
    step = layer.z / (bead.layer + 1)
    z = {
        "into the plate": 0.5,
        "into the layer below": layer.z - step,
        "a quarter of a layer": layer.z - 0.25 * step,
    }
    depth = z[ground.variant]
    ground.text.insert(bead.file, bead.off + 1, f"G0 Z{depth:.6f}", f"G0 Z{layer.z:.6f}")
    ground.what = f"G0 Z{depth:.3f} in the metal of Z {layer.z:.3f}"
    return ground.line(bead.file, bead.off + 1)


@kind("rapid into a clamp", "motion")
def into_clamp(ground: Ground) -> list[Place]:
    """Rapid through the place to keep out of, at the layer's height."""
    layer, _, way, _ = ground.pick(_hops(ground))
    ground.text.insert(layer.file, way, f"G0 Z{layer.safe_z:.6f}", "G0 X60 Y-20", f"G0 Z{layer.z:.6f}", "G0 X60 Y20",
                       f"G0 Z{layer.safe_z:.6f}")  # fmt: skip
    ground.what = "G0 through the clamp at the layer's height"
    return ground.line(layer.file, way + 3)


@kind("beyond the travel limits", "motion", ("X", "Y", "Z"))
def beyond(ground: Ground) -> list[Place]:
    """Drive past a software limit."""
    layer, up, way, _ = ground.pick(_hops(ground))
    i = up if ground.variant == "Z" else way
    ground.text.insert(layer.file, i + 1, f"G0 {ground.variant}{1600 if ground.variant == 'Z' else -1001}")
    ground.what = f"beyond the limit of {ground.variant}"
    return ground.line(layer.file, i + 1)


@kind("rapid along a bead", "metal")
def rapid_in_bead(ground: Ground) -> list[Place]:
    """G0 for G1 with beam and wire on."""
    beads = [
        (b, i)
        for b in ground.text.beads()
        for i in b.motions
        if ground.text.code(b.file, i).startswith("G1 ")
    ]
    bead, i = ground.pick(beads)
    code = re.sub(r" F\S+", "", ground.text.code(bead.file, i))
    ground.text.set(bead.file, i, "G0" + code[2:])
    ground.what = "G0 in place of G1 in a bead"
    return ground.line(bead.file, i)


@kind("feed in place of rapid", "motion")
def slow_travel(ground: Ground) -> list[Place]:
    """G1 for G0 above the part."""
    layer, _, way, _ = ground.pick(_hops(ground))
    ground.text.set(layer.file, way, "G1" + ground.text.code(layer.file, way)[2:])
    ground.what = "way at the feed of the beads"
    return ground.line(layer.file, way)


@kind("no rise at the end", "motion", ("deleted", "stays on the part"))
def no_end_rise(ground: Ground) -> list[Place]:
    """Spoil every rise after the last bead."""
    text, last = ground.text, ground.text.beads()[-1]
    z = text.layers()[-1].z
    calls = text.find(r"MAIN_L\d+") if text.sinumerik else []
    spans = [(last.file, last.off), *([(text.main, calls[-1])] if calls else [])]
    places = []
    for file, first in spans:
        for i in reversed(text.find(rf"G0 Z{NUMBER}", file, first)):
            if ground.variant == "deleted":
                text.delete(file, i)
            else:
                text.set_word(file, i, "Z", z)
        places += ground.line(file, first, len(text.files[file]))
    ground.what = "the tool stays on the part at the end"
    return places


@kind("Z along a bead", "metal", (0.5, -0.5))
def bead_climbs(ground: Ground) -> list[Place]:
    """Let a bead climb or dive."""
    beads = [
        (b, i)
        for b in ground.text.beads()
        for i in b.motions
        if ground.text.code(b.file, i).startswith("G1 ")
    ]
    bead, i = ground.pick(beads)
    layer = ground.text.layers()[bead.layer]
    code = ground.text.code(bead.file, i)
    ground.text.set(bead.file, i, re.sub(r"( F\S+)?$", rf" Z{layer.z + ground.variant:.6f}\1", code, count=1))
    ground.what = f"Z changes by {ground.variant:g} mm along a bead"
    return ground.line(bead.file, i, bead.off)


@kind("bead at another height", "metal", (0.5, -0.5, 1.7))
def bead_height(ground: Ground) -> list[Place]:
    """Lay one bead too high or too low."""
    layer, _, _, down = ground.pick(_hops(ground, 0))
    ground.text.set_word(layer.file, down, "Z", layer.z + ground.variant)
    ground.what = f"bead at Z {layer.z + ground.variant:.3f} in the layer of Z {layer.z:.3f}"
    off = ground.text.find(ground.text.codes.beam_off, layer.file, down)[0]
    return ground.line(layer.file, down, off)


@kind("layer at another height", "metal", (0.3, -0.3))
def layer_height(ground: Ground) -> list[Place]:
    """Change Z in a whole layer."""
    layer = ground.layer(1)
    text = ground.text
    for i in text.find(rf"G0 Z{NUMBER}", layer.file, layer.first, layer.end):
        if word(text.code(layer.file, i), "Z") == layer.z:
            text.set_word(layer.file, i, "Z", layer.z + ground.variant)
    ground.what = f"layer {layer.number + 1} at Z {layer.z + ground.variant:.3f} in place of {layer.z:.3f}"
    return layer_places(ground, layer)


def layer_places(ground: Ground, layer: Layer) -> list[Place]:
    """Lines of a layer, and of its call."""
    text = ground.text
    found = ground.line(layer.file, layer.first, layer.end)
    if text.sinumerik:
        found += [p for i in text.find(layer.file[:-4]) for p in ground.line(text.main, i)]
    return found


@kind("retract lowered everywhere", "motion")
def low_retracts(ground: Ground) -> list[Place]:
    """Fly a tenth of a millimetre over the metal all the time."""
    text, places = ground.text, []
    for layer in text.layers():
        for i in text.find(rf"G0 Z{NUMBER}", layer.file, layer.first, layer.end):
            if word(text.code(layer.file, i), "Z") == layer.safe_z:
                text.set_word(layer.file, i, "Z", layer.z + 0.1)
                places += ground.line(layer.file, i, i + 2)
    if not places:
        raise NotHereError
    ground.what = "retracts of 0.1 mm"
    return places


@kind("place kilometres away", "motion", ("contour", "hatch", "rapid"))
def point_lost(ground: Ground) -> list[Place]:
    """Take the decimal point out of a place, so that the way leads kilometres away."""
    text = ground.text
    bead = ground.bead({"contour": True, "hatch": False}.get(ground.variant))
    ways = [i for i in range(max(bead.travel, 0), bead.on) if text.code(bead.file, i).startswith("G0 X")]
    i = ground.pick(ways if ground.variant == "rapid" else bead.motions)
    code = text.code(bead.file, i)
    found = re.search(r"(?<=[XY])-?\d+\.\d{3,}", code)
    if found is None:
        raise NotHereError
    text.set(bead.file, i, f"{code[: found.start()]}{found[0].replace('.', '')}{code[found.end() :]}")
    ground.what = f"{found[0]} lost its point"
    # An arc behind it has no circle any more, and is refused before the place is judged.
    return ground.line(bead.file, i, max(bead.first, i + 1) + 1)
