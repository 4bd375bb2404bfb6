"""Faults of single blocks: digits, signs, blocks deleted, doubled or exchanged, arcs and polynomials bent."""

from __future__ import annotations

import itertools
import re

import numpy as np

from benchmarks.faults.kinds import LINUXCNC, SINUMERIK, Ground, NotHereError, Place, kind
from benchmarks.faults.program_text import Bead, end_of, with_word, word
from benchmarks.faults.shapes import swapped

LEAST_CHANGE_MM = 0.15
"""Smaller changes of a contour are within what slicers and fits may differ by."""

LEAST_HATCH_MM = 1.5
"""Smaller changes of a hatch line, a quarter of a bead, are within what its gaps and overlaps may differ by."""

BEAD_MM = 6.0
"""Width of the beads of all programs."""


def _motion(
    ground: Ground, pattern: str, contour: bool | None = None, inner: bool = False
) -> tuple[Bead, int]:
    """A motion of a bead whose block begins with a pattern; an inner one is neither the first nor the last."""
    found = [
        (b, i)
        for b in ground.text.beads(contour)
        for i in (b.motions[1:-1] if inner else b.motions)
        if re.match(pattern, ground.text.code(b.file, i))
    ]
    return ground.pick(found)


def _change(
    ground: Ground, edit: str, contour: bool, least_mm: float, most_mm: float = np.inf
) -> list[Place]:
    """Change X or Y of a straight motion by a slip of the hand."""
    text = ground.text
    for _ in range(500):
        bead, i = _motion(ground, r"G[123] ", contour)
        axis = "XY"[int(ground.random.integers(2))]
        code = text.code(bead.file, i)
        digits = re.search(rf"(?<![A-Z]){axis}({r'-?'}\d+\.\d+)", code)
        changed = _slip(digits[1], edit, ground.random) if digits else None
        if digits and changed and least_mm <= abs(float(changed) - float(digits[1])) < most_mm:
            text.set(bead.file, i, code.replace(digits[0], f"{axis}{changed}", 1))
            ground.what = f"{axis}{changed} in place of {axis}{digits[1]} ({edit})"
            return ground.line(bead.file, i, i + 2)
    raise NotHereError


def _slip(number: str, edit: str, random: np.random.Generator) -> str | None:
    sign, whole = ("-", number[1:]) if number.startswith("-") else ("", number)
    point = whole.index(".")
    if edit == "sign":
        return whole if sign else f"-{whole}"
    if edit == "point":
        return f"{sign}{whole[: point - 1]}.{whole[point - 1]}{whole[point + 1 :]}" if point > 1 else None
    places = [k for k in range(min(point + 2, len(whole))) if whole[k] != "."]
    if edit == "digit":
        k = places[int(random.integers(len(places)))]
        return f"{sign}{whole[:k]}{(int(whole[k]) + int(random.integers(1, 10))) % 10}{whole[k + 1 :]}"
    swaps = [(a, b) for a, b in itertools.pairwise(places) if whole[a] != whole[b]]
    if not swaps:
        return None
    a, b = swaps[int(random.integers(len(swaps)))]
    letters = list(whole)
    letters[a], letters[b] = letters[b], letters[a]
    return sign + "".join(letters)


@kind("slip in a contour", "metal", ("digit", "transposed", "sign", "point"))
def contour_slip(ground: Ground) -> list[Place]:
    """Mistype a number of a contour."""
    return _change(ground, ground.variant, True, LEAST_CHANGE_MM)


@kind("slip in the hatch", "metal", ("digit", "transposed", "sign", "point"))
def hatch_slip(ground: Ground) -> list[Place]:
    """Mistype a number of an island, so that a line ends further away than a bead is wide."""
    return _change(ground, ground.variant, False, BEAD_MM)


@kind(
    "slip in the hatch by less than a bead",
    "metal",
    ("digit", "transposed", "sign"),
    unseen="the metal lies within its limits where a line ends less than a bead's width away, if its bead has no lines to and fro",
)
def small_hatch_slip(ground: Ground) -> list[Place]:
    """Mistype a number of an island, so that a line ends elsewhere by less than the width of a bead."""
    return _change(ground, ground.variant, False, LEAST_HATCH_MM, BEAD_MM)


@kind("hatch line 100 mm out", "metal", ("end", "whole line"))
def far_line(ground: Ground) -> list[Place]:
    """Lead a line of an island far out of the part."""
    text = ground.text
    bead, i = _motion(ground, "G1 ", contour=False, inner=True)
    later = bead.motions[bead.motions.index(i) + 1]
    lines = (i,) if ground.variant == "end" else (i, later)
    for k in lines:
        text.set_word(bead.file, k, "X", (word(text.code(bead.file, k), "X") or 0.0) + 100.0)
    ground.what = f"X of a hatch line is 100 mm greater ({ground.variant})"
    return ground.line(bead.file, i, i + len(lines) + 1)


@kind("motion deleted", "metal", ("contour", "hatch"))
def motion_deleted(ground: Ground) -> list[Place]:
    """Take out one motion of a bead."""
    text = ground.text
    for _ in range(100):
        bead, i = _motion(ground, r"G[1235] |POLY", ground.variant == "contour", inner=True)
        a, b, c = (
            np.array(text.position(bead.file, k))
            for k in (i, i + 1, bead.motions[bead.motions.index(i) + 1] + 1)
        )
        along = (c - a) / max(float(np.hypot(*(c - a))), 1e-9)
        off = b - a - along * float(along @ (b - a))
        if float(np.hypot(*off)) > LEAST_HATCH_MM:
            text.delete(bead.file, i)
            ground.what = "a motion is missing"
            return ground.line(bead.file, i - 1, i + 1)
    raise NotHereError


@kind("motion doubled", "motion", ("in place", "further down"))
def motion_doubled(ground: Ground) -> list[Place]:
    """Say a motion twice: on the spot, or again after the next one."""
    text = ground.text
    bead, i = _motion(ground, "G1 ", inner=True)
    later = bead.motions[bead.motions.index(i) + 1]
    line = text.files[bead.file][i]
    at = i + 1 if ground.variant == "in place" else later + 1
    text.insert(bead.file, at, line)
    ground.what = f"a motion stands twice, {ground.variant}"
    return ground.line(bead.file, at, at + 1)


@kind("motions exchanged", "metal")
def motions_exchanged(ground: Ground) -> list[Place]:
    """Exchange two neighbouring motions."""
    text = ground.text
    bead, i = _motion(ground, "G1 ", contour=False, inner=True)
    later = bead.motions[bead.motions.index(i) + 1]
    first, second = text.code(bead.file, i), text.code(bead.file, later)
    text.set(bead.file, i, second)
    text.set(bead.file, later, first)
    ground.what = "two neighbouring motions change places"
    return ground.line(bead.file, i, later + 2)


@kind("contour left open", "metal")
def left_open(ground: Ground) -> list[Place]:
    """Take out the last motion of a contour."""
    bead = ground.bead(contour=True, motions=3)
    ground.text.delete(bead.file, bead.last)
    ground.what = "a contour ends before its start"
    return ground.line(bead.file, bead.last - 1, bead.last + 1)


@kind("coordinate deleted", "metal", ("X", "Y"))
def word_deleted(ground: Ground) -> list[Place]:
    """Take out X or Y of a motion."""
    text = ground.text
    for _ in range(100):
        bead, i = _motion(ground, "G1 ")
        here = text.position(bead.file, i)["XY".index(ground.variant)]
        code = text.code(bead.file, i)
        if abs((word(code, ground.variant) or 0.0) - here) > LEAST_HATCH_MM:
            text.set(bead.file, i, re.sub(rf" {ground.variant}-?[\d.]+", "", code))
            ground.what = f"{ground.variant} is missing in a motion"
            return ground.line(bead.file, i, i + 2)
    raise NotHereError


@kind("coordinate of a way deleted", "metal", ("X", "Y"))
def way_word_deleted(ground: Ground) -> list[Place]:
    """Take out X or Y of the way to a bead."""
    text, bead = ground.text, ground.bead()
    ways = [i for i in range(max(bead.travel, 0), bead.on) if text.code(bead.file, i).startswith("G0 X")]
    i = ground.pick(ways)
    text.set(bead.file, i, re.sub(rf" {ground.variant}-?[\d.]+", "", text.code(bead.file, i)))
    ground.what = f"{ground.variant} is missing in the way to a bead"
    return ground.line(bead.file, i, bead.first + 1)


# -- arcs and polynomials -----------------------------------------------------------------------------


@kind("arc the other way round", "metal", subjects=("bored", "torus", "two-spheres"))
def arc_swapped(ground: Ground) -> list[Place]:
    """G2 for G3."""
    bead, i = _motion(ground, r"G[23] ", contour=True)
    ground.text.set(bead.file, i, swapped(ground.text.code(bead.file, i)))
    ground.what = "G2 and G3 exchanged in an arc"
    return ground.line(bead.file, i)


@kind("centre of an arc mirrored", "metal", subjects=("bored", "torus", "two-spheres"))
def centre_mirrored(ground: Ground) -> list[Place]:
    """Mirror the centre of an arc about its chord: the radius stays."""
    text = ground.text
    for _ in range(100):
        bead, i = _motion(ground, r"G[23] ", contour=True)
        code = text.code(bead.file, i)
        chord = np.array([word(code, "X"), word(code, "Y")]) - text.position(bead.file, i)
        spoke = np.array([word(code, "I"), word(code, "J")])
        length = float(np.hypot(*chord))
        along = chord / max(length, 1e-9)
        mirrored = 2.0 * float(spoke @ along) * along - spoke
        rise = float(np.hypot(*spoke)) - float(np.sqrt(max(spoke @ spoke - 0.25 * length**2, 0.0)))
        if length > 1.0 and 2.0 * rise > LEAST_CHANGE_MM:
            for name, value in zip("IJ", mirrored, strict=True):
                code = with_word(code, name, float(value))
            text.set(bead.file, i, code)
            ground.what = "the centre of an arc lies on the other side of its chord"
            return ground.line(bead.file, i)
    raise NotHereError


@kind("radius of an arc", "metal", (0.8, 1.3), subjects=("bored", "torus", "two-spheres"))
def arc_radius(ground: Ground) -> list[Place]:
    """Move the centre of an arc along the bisector of its chord."""
    text = ground.text
    for _ in range(200):
        bead, i = _motion(ground, r"G[23] ", contour=True)
        code = text.code(bead.file, i)
        half = 0.5 * (np.array([word(code, "X"), word(code, "Y")]) - text.position(bead.file, i))
        spoke = np.array([word(code, "I"), word(code, "J")])
        other = half + ground.variant * (spoke - half)
        rise, changed = (float(np.hypot(*s)) - float(np.hypot(*(s - half))) for s in (spoke, other))
        if abs(changed - rise) > LEAST_CHANGE_MM and float(np.hypot(*half)) > 0.5:
            for name, value in zip("IJ", other, strict=True):
                code = with_word(code, name, float(value))
            text.set(bead.file, i, code)
            ground.what = f"the arc rises by {changed:.3f} mm over its chord in place of {rise:.3f}"
            return ground.line(bead.file, i)
    raise NotHereError


@kind("coefficient of a polynomial", "metal", ("second", "third"), controls=(SINUMERIK,), subjects=("bored", "torus", "two-spheres"))  # fmt: skip
def coefficient(ground: Ground) -> list[Place]:
    """Change a coefficient of a POLY block."""
    text = ground.text
    bead, i = _motion(ground, "POLY", contour=True)
    code = text.code(bead.file, i)
    way = np.subtract(end_of(code, (0.0, 0.0)), text.position(bead.file, i))
    # Across its way: along it, the same path would be driven unevenly.
    axis, k = "XY"[int(np.argmin(np.abs(way)))], 1 if ground.variant == "second" else 2
    begin = code.index(f"PO[{axis}]=(") + len(f"PO[{axis}]=(")
    end = code.index(")", begin)
    values = [float(v) for v in code[begin:end].split(",")]
    values[k] += 0.8
    text.set(bead.file, i, f"{code[:begin]}{','.join(f'{v:.6f}' for v in values)}{code[end:]}")
    ground.what = f"the {ground.variant} coefficient of {axis} is 0.8 greater"
    return ground.line(bead.file, i)


@kind("parameter length of a polynomial", "metal", (0.5, 2.0), controls=(SINUMERIK,), subjects=("torus", "two-spheres"))  # fmt: skip
def parameter_length(ground: Ground) -> list[Place]:
    """Change PL of the POLY block that it bends most."""
    text = ground.text
    found = []
    for b in ground.text.beads():
        for i in b.motions:
            if text.code(b.file, i).startswith("POLY"):
                values = [float(v) for v in re.findall(r"-?\d+\.\d+", text.code(b.file, i))]
                found.append((abs(values[1]) + abs(values[2]) + abs(values[4]) + abs(values[5]), b, i))
    if not found:
        raise NotHereError
    _, bead, i = max(found, key=lambda x: x[0])
    text.set(bead.file, i, text.code(bead.file, i).replace("PL=1", f"PL={ground.variant:g}"))
    ground.what = f"PL={ground.variant:g} in place of 1"
    return ground.line(bead.file, i)


@kind("handle of a G5", "metal", ("I", "P"), controls=(LINUXCNC,), subjects=("bored", "torus", "two-spheres"))
def handle(ground: Ground) -> list[Place]:
    """Pull at a handle of a Bezier span."""
    text = ground.text
    bead, i = _motion(ground, "G5 ", contour=True)
    code = text.code(bead.file, i)
    way = np.subtract(end_of(code, (0.0, 0.0)), text.position(bead.file, i))
    name = {"I": "IJ", "P": "PQ"}[ground.variant][int(np.argmin(np.abs(way)))]
    text.set(bead.file, i, with_word(code, name, (word(code, name) or 0.0) + 0.8))
    ground.what = f"{name} of a G5 is 0.8 mm greater"
    return ground.line(bead.file, i, i + 2)


@kind("spline made a chord", "metal", controls=(SINUMERIK, LINUXCNC), subjects=("torus", "two-spheres"))
def chord(ground: Ground) -> list[Place]:
    """G1 for the most bent POLY or G5."""
    text = ground.text
    found = []
    for b in text.beads():
        for i in b.motions:
            code = text.code(b.file, i)
            if re.match(r"G5 |POLY", code):
                numbers = [float(v) for v in re.findall(r"-?\d+\.\d+", code)]
                here = text.position(b.file, i)
                x, y = end_of(code, here)
                length = float(np.hypot(x - here[0], y - here[1]))
                bent = abs(numbers[1]) + abs(numbers[4]) if code.startswith("POLY") else length
                found.append((bent, b, i, f"G1 X{x:.6f} Y{y:.6f}"))
    if not found:
        raise NotHereError
    _, bead, i, code = max(found, key=lambda f: f[0])
    text.set(bead.file, i, code + (" F600" if " F" in text.code(bead.file, i) else ""))
    ground.what = "a bent span is driven as a chord"
    return ground.line(bead.file, i)
