"""Faults of single motions: ways through metal, Z in the wrong place, mistyped numbers, arcs and splines that are bent."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np

from benchmarks.faults.kinds import LINUXCNC, METAL, MOTION, SINUMERIK, Ground, NotHereError, Place, kind
from benchmarks.faults.program_text import NUMBER, Bead, Layer, end_of, reversed_arc, with_word, word
from benchmarks.faults.subjects import ROUND_PARTS

LEAST_HOP_MM = 12.0
"""Ways shorter than two bead spacings need no retract."""

LEAST_CHANGE_MM = 0.15
"""Smaller changes of a contour are within what slicers and fits may differ by."""

LEAST_HATCH_MM = 1.5
"""Smaller changes of a hatch line, a quarter of a bead, are within what its gaps and overlaps may differ by."""

BEAD_MM = 6.0
"""Width of the beads of all programs."""


# -- ways ----------------------------------------------------------------------------------------------


def _hop(ground: Ground, least_layer: int = 1) -> tuple[Layer, int, int, int]:
    """Layer, and lines of retract, way in X and Y, and descent, of a long way within a layer."""
    text = ground.text
    layers = {layer.number: layer for layer in text.layers()}
    found = []
    for before, bead in itertools.pairwise(text.beads()):
        if before.layer != bead.layer or bead.layer < least_layer:
            continue
        rows = [i for i in range(before.off, bead.on) if text.code(bead.file, i).startswith("G0")]
        goes_up_and_down = [text.code(bead.file, i)[:4] for i in rows] == ["G0 Z", "G0 X", "G0 Z"]
        if goes_up_and_down and math.dist(text.position(bead.file, rows[1]), bead.start) >= LEAST_HOP_MM:
            found.append((layers[bead.layer], *rows))
    return ground.pick(found)  # type: ignore[return-value]


def _low(ground: Ground) -> list[Place]:
    layer, up, way, _ = _hop(ground)
    heights = {"under the top": 0.5 * layer.z, "at the top": layer.z, "just over the top": layer.z + 0.4}
    z = heights[ground.variant]
    ground.text.set_words(layer.file, up, "Z", [z])
    ground.what = f"way over the part at Z {z:.3f}, top of the layer {layer.z:.3f}"
    return ground.line(layer.file, up, way + 1)


def _no_retract(ground: Ground) -> list[Place]:
    layer, up, way, _ = _hop(ground)
    ground.text.delete(layer.file, up)
    return ground.line(layer.file, way - 1)


def _no_retracts(ground: Ground) -> list[Place]:
    text = ground.text
    heights = {layer.safe_z for layer in text.layers()}
    rows = [(f, i) for f, i in text.everywhere(rf"G0 Z{NUMBER}") if word(text.code(f, i), "Z") in heights]
    for file, i in reversed(rows[1:]):
        text.delete(file, i)
    return [place for file, i in text.everywhere(r"G0 X.*") for place in ground.line(file, i)]


def _low_retracts(ground: Ground) -> list[Place]:
    rows = [(layer, i) for layer in ground.text.layers() for i in ground.text.rises(layer, layer.safe_z)]
    if not rows:
        raise NotHereError
    for layer, i in rows:
        ground.text.set_words(layer.file, i, "Z", [layer.z + 0.1])
    return [place for layer, i in rows for place in ground.line(layer.file, i, i + 2)]


def _diagonal(ground: Ground) -> list[Place]:
    layer, _, way, down = _hop(ground)
    text = ground.text
    text.set(layer.file, way, f"{text.code(layer.file, way)} Z{text.code(layer.file, down).partition('Z')[2]}")
    text.delete(layer.file, down)
    return ground.line(layer.file, way)


def _early_descent(ground: Ground) -> list[Place]:
    layer, _, way, down = _hop(ground)
    lines = ground.text.files[layer.file]
    lines[way], lines[down] = lines[down], lines[way]
    return ground.line(layer.file, way, down + 1)


def _plunge(ground: Ground) -> list[Place]:
    bead = ground.bead(least_layer=1)
    layer = ground.text.layers()[bead.layer]
    step = layer.z / (bead.layer + 1)
    depths = {
        "into the plate": 0.5,
        "into the layer below": layer.z - step,
        "a quarter of a layer": layer.z - 0.25 * step,
    }
    depth = depths[ground.variant]
    ground.text.insert(bead.file, bead.off + 1, f"G0 Z{depth:.6f}", f"G0 Z{layer.z:.6f}")
    ground.what = f"G0 Z{depth:.3f} in the metal of Z {layer.z:.3f}"
    return ground.line(bead.file, bead.off + 1)


def _into_clamp(ground: Ground) -> list[Place]:
    layer, _, way, _ = _hop(ground)
    safe, low = f"G0 Z{layer.safe_z:.6f}", f"G0 Z{layer.z:.6f}"
    ground.text.insert(layer.file, way, safe, "G0 X60 Y-20", low, "G0 X60 Y20", safe)
    return ground.line(layer.file, way + 3)


def _beyond(ground: Ground) -> list[Place]:
    layer, up, way, _ = _hop(ground)
    i = up if ground.variant == "Z" else way
    return ground.insert(layer.file, i + 1, f"G0 {ground.variant}{1600 if ground.variant == 'Z' else -1001}")


def _slow_way(ground: Ground) -> list[Place]:
    layer, _, way, _ = _hop(ground)
    return ground.replace(layer.file, way, "^..", "G1")


def _no_end_rise(ground: Ground) -> list[Place]:
    """Every rise after the last bead, left out or as high as the part."""
    text, last = ground.text, ground.text.beads()[-1]
    z = text.layers()[-1].z
    calls = text.find(r"MAIN_L\d+") if text.sinumerik else []
    places = []
    for file, first in [(last.file, last.off), *((text.main, i) for i in calls[-1:])]:
        for i in reversed(text.find(rf"G0 Z{NUMBER}", file, first)):
            if ground.variant == "deleted":
                text.delete(file, i)
            else:
                text.set_words(file, i, "Z", [z])
        places += ground.line(file, first, len(text.files[file]))
    return places


def _way_word_deleted(ground: Ground) -> list[Place]:
    text, bead = ground.text, ground.bead()
    i = ground.pick(text.ways(bead))
    text.set(bead.file, i, re.sub(rf" {ground.variant}-?[\d.]+", "", text.code(bead.file, i)))
    return ground.line(bead.file, i, bead.first + 1)


def _point_lost(ground: Ground) -> list[Place]:
    """A place without its decimal point, so that the way leads kilometres away."""
    text = ground.text
    bead = ground.bead({"contour": True, "hatch": False}.get(ground.variant))
    i = ground.pick(text.ways(bead) if ground.variant == "rapid" else bead.motions)
    found = re.search(r"(?<=[XY])-?\d+\.\d{3,}", text.code(bead.file, i))
    if found is None:
        raise NotHereError
    ground.replace(bead.file, i, r"(?<=[XY])-?\d+\.\d{3,}", found[0].replace(".", ""))
    ground.what = f"{found[0]} lost its point"
    # An arc behind it has no circle any more, and is refused before the place is judged.
    return ground.line(bead.file, i, max(bead.first, i + 1) + 1)


# -- heights of beads ----------------------------------------------------------------------------------


def _rapid_in_bead(ground: Ground) -> list[Place]:
    bead, i = ground.motion("G1 ")
    code = re.sub(r" F\S+", "", ground.text.code(bead.file, i))
    ground.text.set(bead.file, i, "G0" + code[2:])
    return ground.line(bead.file, i)


def _climbing(ground: Ground) -> list[Place]:
    bead, i = ground.motion("G1 ")
    z = ground.text.layers()[bead.layer].z + ground.variant
    ground.replace(bead.file, i, r"( F\S+)?$", rf" Z{z:.6f}\1")
    return ground.line(bead.file, i, bead.off)


def _creeping(ground: Ground) -> list[Place]:
    bead, i = long_line(ground)
    z = ground.text.layers()[bead.layer].z + ground.variant
    ground.replace(bead.file, i, "$", f" Z{z:.6f}")
    return ground.line(bead.file, i, bead.off)


def _at_another_height(ground: Ground) -> list[Place]:
    layer, _, _, down = _hop(ground, 0)
    z = layer.z + ground.variant
    ground.text.set_words(layer.file, down, "Z", [z])
    ground.what = f"bead at Z {z:.3f} in the layer of Z {layer.z:.3f}"
    return ground.line(layer.file, down, ground.text.find(ground.text.codes.beam_off, layer.file, down)[0])


def _circle(ground: Ground) -> list[Place]:
    bead, i = long_line(ground)
    x, y = ground.text.position(bead.file, i)
    ground.text.insert(bead.file, i, f"G3 X{x:.6f} Y{y:.6f} I2.000000 J0.000000")
    return ground.line(bead.file, i, i + 2)


def long_line(ground: Ground, least_mm: float = 3.0) -> tuple[Bead, int]:
    """A straight motion within an island, of more than so much in X or Y."""
    text = ground.text

    def is_long(bead: Bead, i: int) -> bool:
        a, b = text.position(bead.file, i), text.position(bead.file, i + 1)
        return max(abs(p - q) for p, q in zip(a, b, strict=True)) > least_mm

    lines = [(b, i) for b in text.beads(contour=False) for i in b.motions[1:]]
    straight = rf"G1 X{NUMBER} Y{NUMBER}"
    return ground.pick([x for x in lines if re.fullmatch(straight, text.code(x[0].file, x[1])) and is_long(*x)])


# -- slips of the hand ---------------------------------------------------------------------------------


def _mistyped(ground: Ground, contour: bool, least_mm: float, most_mm: float = np.inf) -> list[Place]:
    """A slip in X or Y of a motion that moves its end by at least, and less than, so much."""
    text = ground.text
    for _ in range(500):
        bead, i = ground.motion(r"G[123] ", contour)
        axis = "XY"[int(ground.random.integers(2))]
        code = text.code(bead.file, i)
        digits = re.search(rf"(?<![A-Z]){axis}(-?\d+\.\d+)", code)
        changed = _slip(digits[1], ground.variant, ground.random) if digits else None
        if digits and changed and least_mm <= abs(float(changed) - float(digits[1])) < most_mm:
            text.set(bead.file, i, code.replace(digits[0], f"{axis}{changed}", 1))
            ground.what = f"{axis}{changed} in place of {axis}{digits[1]} ({ground.variant})"
            return ground.line(bead.file, i, i + 2)
    raise NotHereError


def _slip(number: str, edit: str, random: np.random.Generator) -> str | None:
    """A number with one digit, two digits, the sign or the decimal point mistyped."""
    sign, whole = ("-", number[1:]) if number.startswith("-") else ("", number)
    point = whole.index(".")
    if edit == "sign":
        return whole if sign else f"-{whole}"
    if edit == "point":
        return f"{sign}{whole[: point - 1]}.{whole[point - 1]}{whole[point + 1 :]}" if point > 1 else None
    places = [k for k in range(min(point + 2, len(whole))) if whole[k] != "."]
    letters = list(whole)
    if edit == "digit":
        k = places[int(random.integers(len(places)))]
        letters[k] = str((int(whole[k]) + int(random.integers(1, 10))) % 10)
    elif swaps := [(a, b) for a, b in itertools.pairwise(places) if whole[a] != whole[b]]:
        a, b = swaps[int(random.integers(len(swaps)))]
        letters[a], letters[b] = letters[b], letters[a]
    else:
        return None
    return sign + "".join(letters)


def _far_line(ground: Ground) -> list[Place]:
    text = ground.text
    bead, i = ground.motion("G1 ", contour=False, inner=True)
    lines = (i,) if ground.variant == "end" else (i, bead.after(i))
    for k in lines:
        text.set_words(bead.file, k, "X", [(word(text.code(bead.file, k), "X") or 0.0) + 100.0])
    return ground.line(bead.file, i, i + len(lines) + 1)


def _motion_deleted(ground: Ground) -> list[Place]:
    """A motion whose end lies off the line between its neighbours' ends."""
    text = ground.text

    def is_off(motion: tuple[Bead, int]) -> bool:
        bead, i = motion
        a, b, c = (np.array(text.position(bead.file, k)) for k in (i, i + 1, bead.after(i) + 1))
        along = (c - a) / max(float(np.hypot(*(c - a))), 1e-9)
        return float(np.hypot(*(b - a - along * float(along @ (b - a))))) > LEAST_HATCH_MM

    contour = ground.variant == "contour"
    bead, i = ground.pick_until(lambda: ground.motion(r"G[1235] |POLY", contour, inner=True), is_off)
    text.delete(bead.file, i)
    return ground.line(bead.file, i - 1, i + 1)


def _motion_doubled(ground: Ground) -> list[Place]:
    bead, i = ground.motion("G1 ", inner=True)
    at = i + 1 if ground.variant == "in place" else bead.after(i) + 1
    return ground.insert(bead.file, at, ground.text.files[bead.file][i])


def _motions_exchanged(ground: Ground) -> list[Place]:
    text = ground.text
    bead, i = ground.motion("G1 ", contour=False, inner=True)
    first, second = text.code(bead.file, i), text.code(bead.file, bead.after(i))
    text.set(bead.file, i, second)
    text.set(bead.file, bead.after(i), first)
    return ground.line(bead.file, i, bead.after(i) + 2)


def _left_open(ground: Ground) -> list[Place]:
    bead = ground.bead(contour=True, motions=3)
    ground.text.delete(bead.file, bead.last)
    return ground.line(bead.file, bead.last - 1, bead.last + 1)


def _word_deleted(ground: Ground) -> list[Place]:
    text, axis = ground.text, ground.variant

    def counts(motion: tuple[Bead, int]) -> bool:
        here = text.position(motion[0].file, motion[1])["XY".index(axis)]
        return abs((word(text.code(motion[0].file, motion[1]), axis) or 0.0) - here) > LEAST_HATCH_MM

    bead, i = ground.pick_until(lambda: ground.motion("G1 "), counts)
    text.set(bead.file, i, re.sub(rf" {axis}-?[\d.]+", "", text.code(bead.file, i)))
    return ground.line(bead.file, i, i + 2)


# -- arcs and splines ----------------------------------------------------------------------------------


def _arc_reversed(ground: Ground) -> list[Place]:
    bead, i = ground.motion(r"G[23] ", contour=True)
    ground.text.set(bead.file, i, reversed_arc(ground.text.code(bead.file, i)))
    return ground.line(bead.file, i)


def _chord_and_spoke(ground: Ground, bead: Bead, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Vectors from the start of an arc to its end and to its centre."""
    code = ground.text.code(bead.file, i)
    chord = np.array([word(code, "X"), word(code, "Y")]) - ground.text.position(bead.file, i)
    return chord, np.array([word(code, "I"), word(code, "J")])


def _centre_mirrored(ground: Ground) -> list[Place]:
    """The centre of an arc on the other side of its chord: the radius stays."""

    def bends(arc: tuple[Bead, int]) -> bool:
        chord, spoke = _chord_and_spoke(ground, *arc)
        length = float(np.hypot(*chord))
        rise = float(np.hypot(*spoke)) - float(np.sqrt(max(spoke @ spoke - 0.25 * length**2, 0.0)))
        return length > 1.0 and 2.0 * rise > LEAST_CHANGE_MM

    bead, i = ground.pick_until(lambda: ground.motion(r"G[23] ", contour=True), bends)
    chord, spoke = _chord_and_spoke(ground, bead, i)
    along = chord / max(float(np.hypot(*chord)), 1e-9)
    ground.text.set_words(bead.file, i, "IJ", 2.0 * float(spoke @ along) * along - spoke)
    return ground.line(bead.file, i)


def _arc_radius(ground: Ground) -> list[Place]:
    """The centre of an arc, moved along the bisector of its chord."""
    for _ in range(200):
        bead, i = ground.motion(r"G[23] ", contour=True)
        chord, spoke = _chord_and_spoke(ground, bead, i)
        half = 0.5 * chord
        other = half + ground.variant * (spoke - half)
        rise, changed = (float(np.hypot(*s)) - float(np.hypot(*(s - half))) for s in (spoke, other))
        if abs(changed - rise) > LEAST_CHANGE_MM and float(np.hypot(*half)) > 0.5:
            ground.text.set_words(bead.file, i, "IJ", other)
            ground.what = f"the arc rises by {changed:.3f} mm over its chord in place of {rise:.3f}"
            return ground.line(bead.file, i)
    raise NotHereError


def _axis_across(ground: Ground, bead: Bead, i: int) -> int:
    """Number of the axis across the way of a span: along it, the same path would be driven unevenly."""
    end = end_of(ground.text.code(bead.file, i), (0.0, 0.0))
    return int(np.argmin(np.abs(np.subtract(end, ground.text.position(bead.file, i)))))


def _coefficient(ground: Ground) -> list[Place]:
    bead, i = ground.motion("POLY", contour=True)
    code, axis = ground.text.code(bead.file, i), "XY"[_axis_across(ground, bead, i)]
    begin = code.index(f"PO[{axis}]=(") + len(f"PO[{axis}]=(")
    end = code.index(")", begin)
    values = [float(v) for v in code[begin:end].split(",")]
    values[1 if ground.variant == "second" else 2] += 0.8
    ground.text.set(bead.file, i, f"{code[:begin]}{','.join(f'{v:.6f}' for v in values)}{code[end:]}")
    ground.what = f"the {ground.variant} coefficient of {axis} is 0.8 greater"
    return ground.line(bead.file, i)


def _handle(ground: Ground) -> list[Place]:
    bead, i = ground.motion("G5 ", contour=True)
    code = ground.text.code(bead.file, i)
    name = {"I": "IJ", "P": "PQ"}[ground.variant][_axis_across(ground, bead, i)]
    ground.text.set(bead.file, i, with_word(code, name, (word(code, name) or 0.0) + 0.8))
    ground.facts["name"] = name
    return ground.line(bead.file, i, i + 2)


def _spans(ground: Ground, pattern: str) -> list[tuple[Bead, int, list[float]]]:
    """Splines of a kind, and the numbers in them."""
    text = ground.text
    rows = [(b, i) for b in text.beads() for i in b.motions if re.match(pattern, text.code(b.file, i))]
    if not rows:
        raise NotHereError
    return [(b, i, [float(v) for v in re.findall(r"-?\d+\.\d+", text.code(b.file, i))]) for b, i in rows]


def _parameter_length(ground: Ground) -> list[Place]:
    """PL of the POLY block that it bends most."""
    bead, i, _ = max(_spans(ground, "POLY"), key=lambda span: sum(abs(span[2][k]) for k in (1, 2, 4, 5)))
    return ground.replace(bead.file, i, "PL=1", f"PL={ground.variant:g}")


def _chord(ground: Ground) -> list[Place]:
    """G1 for the most bent POLY or G5."""
    text = ground.text

    def bend(span: tuple[Bead, int, list[float]]) -> float:
        bead, i, numbers = span
        if text.code(bead.file, i).startswith("POLY"):
            return abs(numbers[1]) + abs(numbers[4])
        return math.dist(text.position(bead.file, i), text.position(bead.file, i + 1))

    bead, i, _ = max(_spans(ground, r"G5 |POLY"), key=bend)
    (x, y), feed = text.position(bead.file, i + 1), " F600" if " F" in text.code(bead.file, i) else ""
    text.set(bead.file, i, f"G1 X{x:.6f} Y{y:.6f}{feed}")
    return ground.line(bead.file, i)


# -- the kinds -------------------------------------------------------------------------------------------

# fmt: off
kind("rapid through the metal", MOTION, _low, ("under the top", "at the top", "just over the top"))
kind("retract deleted", MOTION, _no_retract, what="no retract before a long way")
kind("every retract deleted", MOTION, _no_retracts, what="no rise at all after the first")
kind("retract lowered everywhere", MOTION, _low_retracts, what="retracts of 0.1 mm")
kind("X, Y and Z in one rapid", MOTION, _diagonal, what="way and descent in one block")
kind("descent before the way", MOTION, _early_descent, what="down first, then along at the layer's height")
kind("plunge", MOTION, _plunge, ("into the plate", "into the layer below", "a quarter of a layer"))
kind("rapid into a clamp", MOTION, _into_clamp, what="G0 through the clamp at the layer's height")
kind("beyond the travel limits", MOTION, _beyond, ("X", "Y", "Z"), what="beyond the limit of {v}")
kind("feed in place of rapid", MOTION, _slow_way, what="way at the feed of the beads")
kind("no rise at the end", MOTION, _no_end_rise, ("deleted", "stays on the part"), what="the tool stays on the part at the end")
kind("coordinate of a way deleted", METAL, _way_word_deleted, ("X", "Y"), what="{v} is missing in the way to a bead")
kind("place kilometres away", MOTION, _point_lost, ("contour", "hatch", "rapid"))
kind("rapid along a bead", METAL, _rapid_in_bead, what="G0 in place of G1 in a bead")
kind("Z along a bead", METAL, _climbing, (0.5, -0.5), what="Z changes by {v:g} mm along a bead")
kind("Z creeps along a bead", METAL, _creeping, (0.05, -0.05), what="Z is {v:+g} mm from a motion on")
kind("bead at another height", METAL, _at_another_height, (0.5, -0.5, 1.7))
kind("full circle in a bead", METAL, _circle, what="a circle on the way of a bead")
kind("slip in a contour", METAL, _mistyped, ("digit", "transposed", "sign", "point"), contour=True, least_mm=LEAST_CHANGE_MM)
kind("slip in the hatch", METAL, _mistyped, ("digit", "transposed", "sign", "point"), contour=False, least_mm=BEAD_MM)
kind("slip in the hatch by less than a bead", METAL, _mistyped, ("digit", "transposed", "sign"),
     contour=False, least_mm=LEAST_HATCH_MM, most_mm=BEAD_MM,
     unseen="the metal lies within its limits where a line ends less than a bead's width away, if its bead has no lines to and fro")
kind("hatch line 100 mm out", METAL, _far_line, ("end", "whole line"), what="X of a hatch line is 100 mm greater ({v})")
kind("motion deleted", METAL, _motion_deleted, ("contour", "hatch"), what="a motion is missing")
kind("motion doubled", MOTION, _motion_doubled, ("in place", "further down"), what="a motion stands twice, {v}")
kind("motions exchanged", METAL, _motions_exchanged, what="two neighbouring motions change places")
kind("contour left open", METAL, _left_open, what="a contour ends before its start")
kind("coordinate deleted", METAL, _word_deleted, ("X", "Y"), what="{v} is missing in a motion")
kind("arc the other way round", METAL, _arc_reversed, subjects=ROUND_PARTS, what="G2 and G3 exchanged in an arc")
kind("centre of an arc mirrored", METAL, _centre_mirrored, subjects=ROUND_PARTS,
     what="the centre of an arc lies on the other side of its chord")
kind("radius of an arc", METAL, _arc_radius, (0.8, 1.3), subjects=ROUND_PARTS)
kind("coefficient of a polynomial", METAL, _coefficient, ("second", "third"), controls=(SINUMERIK,), subjects=ROUND_PARTS)
kind("parameter length of a polynomial", METAL, _parameter_length, (0.5, 2.0), controls=(SINUMERIK,), subjects=ROUND_PARTS[1:],
     what="PL={v:g} in place of 1")
kind("handle of a G5", METAL, _handle, ("I", "P"), controls=(LINUXCNC,), subjects=ROUND_PARTS,
     what="{name} of a G5 is 0.8 mm greater")
kind("spline made a chord", METAL, _chord, controls=(SINUMERIK, LINUXCNC), subjects=ROUND_PARTS[1:],
     what="a bent span is driven as a chord")
# fmt: on
