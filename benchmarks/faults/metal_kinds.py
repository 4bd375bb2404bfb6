"""Faults of single beads: too many, too few, too long or too short."""

from __future__ import annotations

import numpy as np

from benchmarks.faults.kinds import Ground, Place, kind
from benchmarks.faults.program_text import Bead, ProgramText
from benchmarks.faults.shapes import bounds, ends

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
    on = text.files[bead.file][bead.on : bead.first]
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


@kind("short bead omitted", "metal", unseen="spots as narrow as those that it fills may stay bare")
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


@kind("bead cut short", "metal", (8.0,))
def cut_short(ground: Ground) -> list[Place]:
    """End a bead before its end by more than its width."""
    return _stretched(ground, -ground.variant)


@kind("bead cut short a little", "metal", (3.0,), unseen="the round end of a bead covers half its width")
def cut_short_a_little(ground: Ground) -> list[Place]:
    """End a bead before its end by half its width."""
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
        if text.code(bead.file, bead.last).startswith("G1 ") and length > max(4.0, 1.1 * -by_mm):
            found.append((bead, np.array(start), np.array(end), length))
    bead, begin, stop, length = ground.pick(found)
    place = stop + by_mm / length * (stop - begin)
    for name, value in zip("XY", place, strict=True):
        text.set_word(bead.file, bead.last, name, float(value))
    ground.what = f"the last line of an island is {by_mm:+g} mm longer"
    return ground.line(bead.file, bead.last)
