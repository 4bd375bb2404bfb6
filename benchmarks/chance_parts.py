"""Parts that nobody chose: solids whose kind and every dimension a hash of their name decides.

Kinds are those that wire electron-beam machines build: plates with holes, rounded blocks, turned parts, tubes, lofts
between two outlines, blocks with inclined bores. Walls are 8 to 30 mm: from under two beads of the default process to five.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any, TypeAlias

import manifold3d as m3
import numpy as np

from ebamcheck.kernels import Floats
from ebamcheck.mesh.part import Part, from_arrays

CIRCLE_SEGMENTS = 96

Rng = np.random.Generator
Solid: TypeAlias = Any
"""A manifold of manifold3d, which has no types."""


def chance_part(name: str) -> Part:
    """Make the part of a name; the same name is always the same part."""
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")
    rng = np.random.default_rng(seed)
    kind = KINDS[int(rng.integers(len(KINDS)))]
    solid = kind(rng)
    mesh = solid.to_mesh()
    return from_arrays(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts), name)


def kind_of(name: str) -> str:
    """Kind of the part of a name, in words."""
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")
    kind = KINDS[int(np.random.default_rng(seed).integers(len(KINDS)))]
    return kind.__name__.replace("_", " ")


def star(rng: Rng, size_mm: float) -> Floats:
    """Corners (n, 2) of a polygon around the origin, star-shaped, of about a size."""
    count = int(rng.integers(4, 10))
    angle = 2.0 * np.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    radius = 0.5 * size_mm * rng.uniform(0.65, 1.0, count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def plate_with_holes(rng: Rng) -> Solid:
    """Extruded polygon, its corners rounded or not, with round holes that leave 8 mm of wall at least."""
    size = rng.uniform(70.0, 150.0)
    outline = m3.CrossSection([star(rng, size)])
    if rng.random() < 0.5:
        round_mm = rng.uniform(2.0, 10.0)
        outline = outline.offset(-round_mm, m3.JoinType.Round, circular_segments=CIRCLE_SEGMENTS)
        outline = outline.offset(round_mm, m3.JoinType.Round, circular_segments=CIRCLE_SEGMENTS)
    taken = m3.CrossSection()
    for _ in range(int(rng.integers(1, 5))):
        radius, wall = rng.uniform(6.0, 0.16 * size), rng.uniform(8.0, 30.0)
        place = rng.uniform(-0.4, 0.4, 2) * size
        hole = m3.CrossSection.circle(radius, CIRCLE_SEGMENTS).translate(tuple(place))
        around = m3.CrossSection.circle(radius + wall, CIRCLE_SEGMENTS).translate(tuple(place))
        if (around - outline).is_empty() and (around ^ taken).is_empty():
            taken = taken + around
            outline = outline - hole
    return outline.extrude(rng.uniform(15.0, 40.0))


def rounded_block(rng: Rng) -> Solid:
    """Box whose edges are all rounded."""
    size = np.array([rng.uniform(40.0, 120.0), rng.uniform(40.0, 120.0), rng.uniform(20.0, 45.0)])
    round_mm = float(rng.uniform(3.0, 0.3 * size.min()))
    ball = m3.Manifold.sphere(round_mm, CIRCLE_SEGMENTS)
    corners = [ball.translate(tuple(s * (0.5 * size - round_mm))) for s in _signs()]
    return m3.Manifold.batch_hull(corners)


def turned(rng: Rng) -> Solid:
    """Ring with an outer and an inner profile of a few steps."""
    height, levels = rng.uniform(20.0, 45.0), int(rng.integers(2, 5))
    z = np.linspace(0.0, height, levels)
    inner = rng.uniform(8.0, 30.0) + np.cumsum(rng.uniform(-5.0, 5.0, levels))
    inner = np.maximum(inner, 7.0)
    outer = inner + rng.uniform(10.0, 30.0, levels)
    profile = np.concatenate([np.column_stack([outer, z]), np.column_stack([inner, z])[::-1]])
    return m3.CrossSection([profile]).revolve(CIRCLE_SEGMENTS)


def tube(rng: Rng) -> Solid:
    """Tube whose bore stands off its middle: the wall varies between 8 and 30 mm around."""
    thin, thick = np.sort(rng.uniform(8.0, 30.0, 2))
    bore = rng.uniform(10.0, 40.0)
    outside = m3.CrossSection.circle(bore + 0.5 * (thin + thick), CIRCLE_SEGMENTS)
    hole = m3.CrossSection.circle(bore, CIRCLE_SEGMENTS).translate((0.5 * (thick - thin), 0.0))
    return (outside - hole).extrude(rng.uniform(20.0, 50.0)).rotate((0.0, 0.0, float(rng.uniform(0, 360))))


def loft(rng: Rng) -> Solid:
    """Hull of two polygons at two heights, one of them turned, smaller and moved."""
    size, height = rng.uniform(60.0, 130.0), rng.uniform(20.0, 45.0)
    low, high = star(rng, size), star(rng, size * rng.uniform(0.6, 1.0)) + rng.uniform(-6.0, 6.0, 2)
    points = np.concatenate([np.c_[low, np.zeros(len(low))], np.c_[high, np.full(len(high), height)]])
    return m3.Manifold.hull_points(points)


def block_with_bores(rng: Rng) -> Solid:
    """Box with one to three bores, each inclined by up to 30 degrees from the vertical."""
    size = np.array([rng.uniform(60.0, 140.0), rng.uniform(60.0, 120.0), rng.uniform(20.0, 40.0)])
    block = m3.Manifold.cube(tuple(size), True)
    for _ in range(int(rng.integers(1, 4))):
        radius = rng.uniform(6.0, 16.0)
        bore = m3.Manifold.cylinder(4.0 * size.max(), radius, radius, CIRCLE_SEGMENTS, True)
        bore = bore.rotate((float(rng.uniform(-30, 30)), float(rng.uniform(-30, 30)), 0.0))
        room = np.maximum(0.5 * size[:2] - radius - 20.0, 0.0)
        block = block - bore.translate((*(rng.uniform(-1.0, 1.0, 2) * room), 0.0))
    return block


def frame(rng: Rng) -> Solid:
    """Rectangle of walls of 8 to 30 mm with a cross wall, on a plate of a few layers."""
    size = rng.uniform(70.0, 150.0, 2)
    walls, cross = rng.uniform(8.0, 22.0, 2), rng.uniform(8.0, 22.0)
    outside = m3.CrossSection.square(tuple(size), True)
    inside = m3.CrossSection.square(tuple(size - 2.0 * walls), True)
    bar = m3.CrossSection.square((cross, size[1]), True)
    bar = bar.translate((float(rng.uniform(-0.15, 0.15) * size[0]), 0.0))
    open_part = (outside - (inside - bar)).extrude(rng.uniform(20.0, 40.0))
    return open_part + outside.extrude(rng.uniform(0.0, 1.0) * 8.0) if rng.random() < 0.5 else open_part


def _signs() -> Floats:
    return np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


KINDS: tuple[Callable[[Rng], Solid], ...] = (
    plate_with_holes,
    rounded_block,
    turned,
    tube,
    loft,
    block_with_bores,
    frame,
)
