"""Faults of single beads: too many, too few, too long or too short, in the wrong place, or over nothing."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import shapely

from benchmarks.faults.kinds import METAL, Ground, Place, kind
from benchmarks.faults.program_text import Bead, Floats, Point, ProgramText, about, end_of, turn
from benchmarks.faults.subjects import ROUND_PARTS

OUTSIDE_MM = 40.0
"""How far beside the part an extra bead lies."""

ACROSS_MM = 0.1
"""By so much at least a line runs past another that it crosses."""

ROLES = ("in a role", "before the first role", "in the main program", "as turns")
"""Where an extra bead stands, and what its comments say."""


# -- beads too many ------------------------------------------------------------------------------------


def extra_bead(ground: Ground, bead: Bead, points: list[Point], how: str = "in a role") -> list[Place]:
    """Lay one more bead of the same power and wire as another, after it or where `how` says."""
    text = ground.text
    layer = text.layers()[bead.layer]
    wire_off = text.find(text.codes.wire_off, bead.file, bead.last, bead.off + 1)[0]
    mark = " ; TURN" if how == "as turns" else ""
    lines = [f"G1 X{x:.6f} Y{y:.6f}{' F600' if k == 0 else ''}{mark}" for k, (x, y) in enumerate(points[1:])]
    on, off = text.files[bead.file][bead.on : bead.first], text.files[bead.file][wire_off : bead.off + 1]
    block = [*layer.way_to(points[0]), *on, *lines, *off, f"G0 Z{layer.safe_z:.6f}"]
    file, i = _spot(text, bead, how)
    if (file, i) == (bead.file, bead.off + 1) and text.code(file, i).startswith("G0 X"):
        block += layer.way_to(text.position(bead.file, bead.off))[1:]
    return ground.insert(file, i, *block)


def _spot(text: ProgramText, bead: Bead, how: str) -> tuple[str, int]:
    """File and line before which an extra bead is inserted."""
    layer = text.layers()[bead.layer]
    if how == "before the first role":
        first = next(b for b in text.beads() if b.layer == bead.layer)
        lines = text.files[first.file]
        return layer.file, next(i for i in range(layer.first, first.on) if lines[i].startswith("; RING"))
    if how == "in the main program":
        return text.main, text.find(layer.file[:-4])[0] + 1 if text.sinumerik else layer.first
    return bead.file, bead.off + 1


def _beside_part(ground: Ground) -> list[Place]:
    least, greatest = ground.text.bounds()
    bead = ground.bead()
    x, y = float(least[0]) - OUTSIDE_MM, float(ground.random.uniform(least[1], greatest[1]))
    middle = [(x + 5, y)] if ground.variant == "as turns" else []
    return extra_bead(ground, bead, [(x, y), *middle, (x + 10, y)], ground.variant)


def _across_channel(ground: Ground) -> list[Place]:
    points = [(x, 0.0) for x in (-18.0, -14.0, -10.0, -6.0, -2.0)]
    some = points if ground.variant == "as turns" else points[::4]
    return extra_bead(ground, ground.bead(contour=False), some, ground.variant)


def _over_island(ground: Ground) -> list[Place]:
    bead = ground.bead(contour=False, motions=2)
    inner = ground.text.ends(bead.file, bead.motions)
    a, b = inner[0], inner[-1] if np.ptp(inner, axis=0).max() > 3.0 else inner[0] + 6.0
    return extra_bead(ground, bead, [tuple(a), tuple(0.5 * (a + b)), tuple(b)], ground.variant)


def _in_a_bore(ground: Ground) -> list[Place]:
    bead = ground.bead(contour=False, least_layer=1)
    ground.facts["layer"] = bead.layer + 1
    return extra_bead(ground, bead, [(-10.5, 0.0), (-9.5, 0.0)])


SPELLINGS: dict[str, Callable[[str], str]] = {
    "lower case": str.lower,
    "tabs": lambda code: code.replace(" ", "\t"),
    "no blanks": lambda code: code.replace(" ", ""),
    "leading zeros": lambda code: re.sub(r"\bG(\d)\b", r"G0\1", code),
}
"""How a control takes a block, and a reader may not."""


def _spelled(ground: Ground) -> list[Place]:
    text = ground.text
    least, _ = text.bounds()
    bead = ground.bead(least_layer=1)
    x, y = float(least[0]) - OUTSIDE_MM, float(least[1])
    places = extra_bead(ground, bead, [(x, y), (x + 10.0, y)])
    for i in range(places[0].first - 1, places[0].last):
        code = text.code(bead.file, i)
        if re.match(r"G[01] ", code):
            text.set(bead.file, i, SPELLINGS[ground.variant](code))
    return places


def _repeated(ground: Ground, contour: bool) -> list[Place]:
    bead = ground.bead(contour)
    lines = ground.text.files[bead.file][bead.on : bead.off + 1]
    return ground.insert(bead.file, bead.off + 1, *ground.text.layers()[bead.layer].way_to(bead.start), *lines)


# -- beads too few, too short or too long --------------------------------------------------------------


def _omitted(ground: Ground, **which: Any) -> list[Place]:
    """The way to the bead stays."""
    bead = ground.bead(**which)
    ground.facts["line"] = bead.first + 1
    ground.text.delete(bead.file, bead.on, bead.off + 1)
    return ground.line(bead.file, bead.travel, bead.on + 4)


def _line_omitted(ground: Ground) -> list[Place]:
    """A line of an island and its turn, so that its neighbours are joined."""
    text = ground.text
    inner = [(b, b.motions[k - 1 : k + 2]) for b in text.beads(contour=False) for k in range(2, len(b.motions) - 2)]
    bead, (before, line, its_turn) = ground.pick([
        (b, rows) for b, rows in inner if text.is_turn(b.file, rows[2]) and not text.is_turn(b.file, rows[1])
        and np.ptp(text.ends(b.file, rows[:2]), axis=0).max() > 6.0
    ])  # fmt: skip
    for i in (its_turn, line):
        text.delete(bead.file, i)
    return ground.line(bead.file, before, line + 1)


def _stretched(ground: Ground, sign: float) -> list[Place]:
    """The last line of an island, longer or shorter."""
    text, by_mm = ground.text, sign * ground.variant
    found = []
    for bead in text.beads(contour=False):
        start, end = (np.array(text.position(bead.file, i)) for i in (bead.last, bead.off))
        length = float(np.hypot(*(end - start)))
        if text.code(bead.file, bead.last).startswith("G1 ") and length > max(4.0, 1.1 * -by_mm):
            found.append((bead, start, end, length))
    bead, start, end, length = ground.pick(found)
    text.set_words(bead.file, bead.last, "XY", end + by_mm / length * (end - start))
    ground.what = f"the last line of an island is {by_mm:+g} mm longer"
    return ground.line(bead.file, bead.last)


# -- beads elsewhere -----------------------------------------------------------------------------------

By = Callable[[Any, float], Floats]
"""Matrix by which a bead is mapped about its middle, of the variant and half of the bead's lesser extent."""


def _inward(by_mm: float, half_mm: float) -> Floats:
    return np.eye(2) * (1.0 - by_mm / max(half_mm, 2.0 * by_mm))


def _turned(angle_deg: float, half_mm: float) -> Floats:
    return turn(angle_deg)


def _mapped(ground: Ground, by: By | None = None, across: bool = False, **which: Any) -> list[Place]:
    """A bead and the way to it, mapped about its middle, or shifted at random where no `by` is given."""
    text = ground.text
    if across:
        beads = [b for b in text.beads(contour=False) if len(b.motions) >= 4]
        bead = ground.pick([b for b in beads if _runs_across(text, b, turn(ground.variant))])
    else:
        bead = ground.bead(**which)
    matrix, offset = np.eye(2), np.zeros(2)
    if by is None:
        offset = ground.step(ground.variant)
    else:
        half = 0.5 * float(np.ptp(text.ends(bead.file, bead.motions), axis=0).min())
        matrix = by(ground.variant, half)
        offset = about(matrix, text.centre(bead.file, bead.motions))
    ground.facts["bead"] = "a contour" if bead.contour else "an island"
    text.move(bead.file, (*text.ways(bead), *bead.motions), matrix, offset)
    return ground.line(bead.file, bead.travel, bead.off)


def _runs_across(text: ProgramText, bead: Bead, matrix: Floats) -> bool:
    """Whether a bead that is mapped about its middle runs across a straight line of another of its layer."""
    offset = about(matrix, text.centre(bead.file, bead.motions))
    mine = [shapely.LineString(np.array(line) @ matrix.T + offset) for line in _lines(text, bead)]
    beside = [other for other in text.beads() if other.layer == bead.layer and other != bead]
    others = [shapely.LineString(line) for other in beside for line in _lines(text, other)]
    return any(
        one.crosses(other) and min(other.distance(shapely.Point(end)) for end in one.coords) > ACROSS_MM
        for one in mine
        for other in others
    )


def _lines(text: ProgramText, bead: Bead) -> list[tuple[Point, Point]]:
    """Start and end of every straight motion of a bead."""
    codes = [text.code(bead.file, i) for i in bead.motions]
    places = [bead.start]
    for code in codes:
        places.append(end_of(code, places[-1]))
    return [line for line, code in zip(pairwise(places), codes, strict=True) if code.startswith("G1 ")]


def _reversed(ground: Ground) -> list[Place]:
    """A single line, laid from its end."""
    text = ground.text
    single = [b for b in text.beads(contour=False) if len(b.motions) == 1]
    bead = ground.pick([b for b in single if text.code(b.file, b.first).startswith("G1 ") and text.ways(b)])
    way, end = text.ways(bead)[0], text.position(bead.file, bead.off)
    text.set_words(bead.file, way, "XY", end)
    text.set_words(bead.file, bead.first, "XY", bead.start)
    return ground.line(bead.file, way, bead.off)


def _seam_moved(ground: Ground) -> list[Place]:
    """A contour of straight motions starts at its second corner."""
    text = ground.text
    straight = [b for b in text.beads(True) if all(text.code(b.file, i).startswith("G1 ") for i in b.motions)]
    bead = ground.pick([b for b in straight if b.last - b.first == len(b.motions) - 1])
    points = text.ends(bead.file, bead.motions)
    for i, place in zip((text.ways(bead)[0], *bead.motions), (points[0], *points[1:], points[0]), strict=True):
        text.set_words(bead.file, i, "XY", place)
    return ground.line(bead.file, bead.travel, bead.off)


# -- the kinds -------------------------------------------------------------------------------------------

# fmt: off
kind("bead beside the part", METAL, _beside_part, ROLES, what="bead of 10 mm, 40 mm beside the part, {v}")
kind("bead beside the part in other letters", METAL, _spelled, tuple(SPELLINGS), what="a bead beside the part, {v}")
kind("bead across a channel", METAL, _across_channel, ROLES, subjects=("bored",), what="bead across the bore, {v}")
kind("extra bead in an island", METAL, _over_island, ("in a role", "as turns"), what="bead over those of an island, {v}")
kind("island that floats in a bore", METAL, _in_a_bore, subjects=("bored",),
     what="bead in the middle of a bore, on layer {layer} alone")
kind("contour twice", METAL, _repeated, contour=True, what="a contour laid twice")
kind("island twice", METAL, _repeated, contour=False, what="an island laid twice")
kind("contour omitted", METAL, _omitted, contour=True, what="a contour is not laid")
kind("island omitted", METAL, _omitted, contour=False, motions=3, what="an island is not laid")
kind("short bead omitted", METAL, _omitted, contour=False, most=1, what="a bead of one motion is not laid at line {line}",
     unseen="spots as narrow as those that it fills may stay bare")
kind("hatch line omitted", METAL, _line_omitted, what="a hatch line and its turn are left out")
kind("bead cut short", METAL, _stretched, (8.0,), sign=-1.0)
kind("bead cut short a little", METAL, _stretched, (3.0,), sign=-1.0, unseen="the round end of a bead covers half its width")
kind("bead runs on", METAL, _stretched, (8.0,), sign=1.0)
kind("contour inset", METAL, _mapped, (3.0, 0.3), by=_inward, contour=True, motions=3,
     what="a contour moved inward by {v:g} mm")
kind("hatch turned", METAL, _mapped, (45.0, 90.0), by=_turned, contour=False, motions=4, what="an island turned by {v:g} deg",
     unseen="lines of another direction that stay within their island, and lay its metal within the limits, are a hatch as good")
kind("hatch turned across other beads", METAL, _mapped, (45.0, 90.0), by=_turned, across=True,
     what="an island turned by {v:g} deg", subjects=("prism", *ROUND_PARTS))
kind("contour shifted", METAL, _mapped, (0.3, 1.5), contour=True, what="a bead of {bead} shifted by {v:g} mm")
kind("island shifted", METAL, _mapped, (4.0, 6.0), contour=False, motions=3, what="a bead of {bead} shifted by {v:g} mm")
kind("island shifted a little", METAL, _mapped, (0.3, 2.0), contour=False, what="a bead of {bead} shifted by {v:g} mm",
     unseen="beads overlap by more, so that no gap over the limit opens")
kind("bead reversed", METAL, _reversed, what="a line laid from its end", unseen="the same metal, laid from the other end")
kind("seam moved", METAL, _seam_moved, what="a contour starts one corner later", subjects=("cube", "prism"),
     unseen="a contour that starts elsewhere is the same contour")
# fmt: on
