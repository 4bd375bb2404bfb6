"""Parts on which curves are measured: of every kind, each with the sections of the part that its mesh stands for.

The truth of a closed form is its formula. That of a CAD solid is a tessellation of the same generator with a chord
error of :data:`TRUTH_MM`, cut at the same heights; planes are exact in both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import shapely

from benchmarks.curve_parts_meshes import (
    FORMATS,
    as_file,
    bored,
    decimated,
    irregular_convex,
    irregular_torus,
    noisy,
    split_edges,
    turn,
    turned,
)
from benchmarks.curve_parts_solids import (
    Bow,
    Floats,
    Profile,
    Solid,
    Triangles,
    extruded,
    extrusion,
    frustum,
    lathe,
    regular_prism,
    wedge,
)
from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.slicers.slicing import slice_part
from ebamcheck_models import BLADE, IMPELLER, LADDER, TORUS, Model
from ebamcheck_models.outlines import circle, rounded_polygon

TRUTH_MM = 1e-4
"""Chord error of the meshes that stand for CAD solids, and of the rings of closed forms."""

CAD_MM = 0.05
"""Chord error of the CAD solids as they are exported."""

REGULAR_MM = (1.0, 0.3, 0.1, 0.01)
NOISES_MM = (0.05, 0.1, 0.3)
DIRECTIONS = (0, 11, 12)
"""Seeds of the directions of each CAD solid; 0 is upright."""

END_SHARE = 0.02
"""Part of the height at both ends in which no layer is measured: a plane that touches a rounding there cuts slivers
whose truth is a matter of rounding."""


@dataclass(frozen=True)
class CurvePart:
    """A mesh, and what it stands for."""

    name: str
    kind: str
    """``regular 1``, ``regular 0.3``, ..., ``irregular``, ``cad``, ``flat``, ``decimated`` or ``noise``."""
    mesh: Callable[[], Part]
    truth: Callable[[Floats], Layers]
    """Exact sections at heights, mm."""


def heights_of(part: Part, count: int) -> Floats:
    """Evenly spread heights of a part's layers, off its ends and off the places that a grid prefers."""
    low, high = part.bounds[:, 2]
    share = END_SHARE + (1.0 - 2.0 * END_SHARE) * (np.arange(count) + 0.5 + 0.1 * math.sqrt(2.0)) / (count + 0.3)
    return np.asarray(low + (high - low) * share, dtype=np.float64)


def parts(quick: bool = False) -> list[CurvePart]:
    """All parts; a few of each kind if quick."""
    found = [*_regular(), *_irregular(), *_cad(), *_flat(), *_decimated(), *_noise()]
    if not quick:
        return found
    first = {part.kind: part for part in reversed(found)}
    return [part for part in found if first[part.kind] is part and part.kind != "regular 0.01"]


def part_of(mesh: Triangles, name: str) -> Part:
    """The mesh as a part."""
    return from_arrays(mesh.vertices, mesh.faces, name)


# -- kinds -------------------------------------------------------------------------------------------------


def _regular() -> Iterator[CurvePart]:
    for mm in REGULAR_MM:
        for model in (LADDER, TORUS, IMPELLER, BLADE) if mm >= 0.1 else (LADDER, TORUS):
            mesh = partial(model.tessellate, mm)
            yield CurvePart(f"{model.name} {mm:g}", f"regular {mm:g}", mesh, partial(_formula, model))


def _formula(model: Model, heights: Floats) -> Layers:
    return from_polygons(heights, [model.section(z, TRUTH_MM) for z in heights.tolist()])


def _irregular() -> Iterator[CurvePart]:
    for seed, kept in ((0, "float64"), (11, "float32"), (12, "ascii4")):
        for name, mesh, truth in (
            ("ellipsoid", _scattered_ellipsoid, partial(_ellipsoid_sections, rotation=turn(seed))),
            ("torus", _scattered_torus, partial(_cut, TORUS_RING, seed)),
        ):
            label = f"{name} of random points, {_where(seed)}, {kept}"
            yield CurvePart(label, "irregular", partial(_made, mesh, seed, kept, name), truth)


def _scattered_ellipsoid() -> Triangles:
    return irregular_convex(_ellipsoid, 3000, 5)


def _scattered_torus() -> Triangles:
    return irregular_torus(_torus, 4000, 6)


def _made(mesh: Callable[[], Triangles], seed: int, kept: str, name: str) -> Part:
    """A mesh that is turned and went through a file."""
    return part_of(as_file(turned(mesh(), seed), kept), name)


def _cad() -> Iterator[CurvePart]:
    for k, (name, solid) in enumerate(CAD.items()):
        for n, seed in enumerate(DIRECTIONS):
            kept = FORMATS[(k + n) % 3]
            yield _case(f"{name}, {_where(seed)}, {kept}", "cad", solid, seed, kept)


def _flat() -> Iterator[CurvePart]:
    for k, (name, solid) in enumerate(FLAT.items()):
        for n, seed in enumerate((0, 11)):
            kept = FORMATS[(k + n) % 3]
            yield _case(f"{name}, {_where(seed)}, {kept}", "flat", solid, seed, kept)


def _decimated() -> Iterator[CurvePart]:
    for name, tolerance_mm in (("boss", 0.05), ("bearing ring", 0.1), ("box r 2.5", 0.05), ("torus", 0.2)):
        for seed in (0, 11):
            solid = CAD.get(name, TORUS_RING)

            def coarse(solid: Solid = solid, tolerance_mm: float = tolerance_mm) -> Triangles:
                return decimated(solid(0.01), tolerance_mm)

            label = f"{name} decimated by {tolerance_mm:g} mm, {_where(seed)}"
            mesh = partial(_made, coarse, seed, "float64", "decimated")
            yield CurvePart(label, "decimated", mesh, partial(_cut, solid, seed))
    for name in ("box r 5", "draft box r 5"):
        for seed in (0, 12):
            solid = CAD[name]

            def split(solid: Solid = solid) -> Triangles:
                return split_edges(solid(CAD_MM), 120, 1e-5, 3)

            mesh = partial(_made, split, seed, "float64", "slivers")
            yield CurvePart(f"{name} of slivers, {_where(seed)}", "decimated", mesh, partial(_cut, solid, seed))


def _noise() -> Iterator[CurvePart]:
    def ladder() -> Triangles:
        part = LADDER.tessellate(0.3)
        return Triangles(part.vertices, part.faces.astype(np.int64))

    for noise_mm in NOISES_MM:
        for name, seed, mesh, truth in (
            ("ladder 0.3", 7, ladder, partial(_formula, LADDER)),
            ("ellipsoid", 8, _scattered_ellipsoid, partial(_ellipsoid_sections, rotation=np.eye(3))),
            ("torus", 9, _scattered_torus, partial(_cut, TORUS_RING, 0)),
        ):

            def shaken(mesh: Callable[[], Triangles] = mesh, noise_mm: float = noise_mm, seed: int = seed) -> Triangles:
                return noisy(mesh(), noise_mm, seed)

            made = partial(_made, shaken, 0, "float64", name.split()[0])
            yield CurvePart(f"{name}, {noise_mm:g} mm of noise", "noise", made, truth)


def _case(name: str, kind: str, solid: Solid, seed: int, kept: str) -> CurvePart:
    mesh = partial(_made, partial(solid, CAD_MM), seed, kept, name)
    return CurvePart(name, kind, mesh, partial(_cut, solid, seed))


def _cut(solid: Solid, seed: int, heights: Floats) -> Layers:
    """Sections of a solid's fine mesh."""
    return slice_part(part_of(turned(solid(TRUTH_MM), seed), "truth"), heights)


def _where(seed: int) -> str:
    return f"direction {seed}" if seed else "upright"


# -- closed forms ------------------------------------------------------------------------------------------

AXES_MM = np.array([30.0, 20.0, 25.0])
RING_MM, TUBE_MM = 30.0, 10.0


def _ellipsoid(directions: Floats) -> Floats:
    return np.asarray(directions * AXES_MM)


def _ellipsoid_sections(heights: Floats, rotation: Floats) -> Layers:
    """Sections of the turned ellipsoid: q = y^T M y = 1 with M = R diag(1 / a^2) R^T, at z given an ellipse."""
    M = rotation @ np.diag(AXES_MM**-2.0) @ rotation.T
    A, b, c = M[:2, :2], M[:2, 2], M[2, 2]
    values, vectors = np.linalg.eigh(A)
    sections = []
    for z in heights.tolist():
        centre = -z * np.linalg.solve(A, b)
        level = 1.0 - c * z * z + float(centre @ A @ centre)
        radii = np.sqrt(level / values)
        count = math.ceil(math.pi / math.acos(1.0 - TRUTH_MM / float(radii.max())))
        angle = 2.0 * np.pi * np.arange(count) / count
        ring = (np.column_stack([np.cos(angle), np.sin(angle)]) * radii) @ vectors.T + centre
        sections.append([shapely.Polygon(ring)])
    return from_polygons(heights, sections)


def _torus(u: Floats, v: Floats) -> Floats:
    r = RING_MM + TUBE_MM * np.cos(2.0 * np.pi * v)
    return np.stack([r * np.cos(2.0 * np.pi * u), r * np.sin(2.0 * np.pi * u), TUBE_MM * np.sin(2.0 * np.pi * v)])


TORUS_RING = lathe([Bow(RING_MM, 0.0, TUBE_MM, -180.0, 180.0)], closed=True)


# -- CAD ---------------------------------------------------------------------------------------------------


def _rectangle(x: float, y: float, radius: float) -> list[tuple[float, float, float]]:
    return [(0.0, 0.0, radius), (x, 0.0, radius), (x, y, radius), (0.0, y, radius)]


def sharp_bend(bend_deg: float, thickness_mm: float = 6.0, leg_mm: float = 40.0) -> Solid:
    """Plate with a sharp bend, upright on its edge."""
    a = math.radians(bend_deg)
    low = np.array([(-leg_mm, 0.0), (0.0, 0.0), (leg_mm * math.cos(a), leg_mm * math.sin(a))])
    inner = (-math.tan(0.5 * a) * thickness_mm, thickness_mm)
    tip = low[2] + np.array([-math.sin(a), math.cos(a)]) * thickness_mm
    ring = np.concatenate([low, [tip, inner, (-leg_mm, thickness_mm)]])
    return lambda chord_mm: extruded([ring], 30.0)


def _bent_plate() -> Solid:
    """Plate of 6 mm bent by 30 degrees about 8 mm."""
    a = math.radians(30.0)
    along, across = np.array([math.cos(a), math.sin(a)]), np.array([-math.sin(a), math.cos(a)])
    ends = [(-40.0, 0.0), (0.0, 0.0), tuple(40.0 * along), tuple(40.0 * along + 6.0 * across)]
    ends += [(-6.0 * math.tan(0.5 * a), 6.0), (-40.0, 6.0)]
    radii = (0.5, 14.0, 0.5, 0.5, 8.0, 0.5)
    return extrusion(rounded_polygon([(x, y, r) for (x, y), r in zip(ends, radii, strict=True)]), 30.0)


_BRACKET = [
    (0.0, 0.0, 4.0),
    (60.0, 0.0, 3.0),
    (60.0, 8.0, 1.0),
    (8.0, 8.0, 6.0),
    (8.0, 45.0, 1.0),
    (0.0, 45.0, 3.0),
]
_BOSS: Profile = [
    *((0.0, 0.0), (28.0, 0.0), Bow(28.0, 1.5, 1.5, -90.0, 0.0), (29.5, 5.0), (20.0, 5.0)),
    *(Bow(20.0, 11.0, 6.0, 270.0, 180.0), (14.0, 38.0), Bow(12.0, 38.0, 2.0, 0.0, 90.0), (0.0, 40.0)),
]
_CONE: Profile = [
    *((0.0, 0.0), (25.0, 0.0)),
    # The side of the cone touches its tip: 25 cos a - 30 sin a = 9.
    Bow(0.0, 30.0, 9.0, math.degrees(math.acos(9.0 / math.hypot(25.0, 30.0)) - math.atan2(30.0, 25.0)), 90.0),
]
_BEARING: Profile = [
    *((12.0, 2.0), Bow(14.0, 2.0, 2.0, 180.0, 270.0), Bow(23.0, 2.0, 2.0, -90.0, 0.0), (25.0, 10.0)),
    *(Bow(23.0, 10.0, 2.0, 0.0, 90.0), Bow(14.0, 10.0, 2.0, 90.0, 180.0)),
]
_PIN = lathe([(0.0, -40.0), (5.0, -40.0), (5.0, 40.0), (0.0, 40.0)])
_LYING = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])

CAD: dict[str, Solid] = {
    "box r 2.5": frustum((35.0, 25.0), (35.0, 25.0), 20.0, 2.5),
    "box r 5": frustum((35.0, 25.0), (35.0, 25.0), 20.0, 5.0),
    "draft box r 5": frustum((35.0, 25.0), (31.0, 21.0), 25.0, 5.0),
    "wedge r 3": wedge(50.0, 20.0, 25.0, 3.0),
    "plate with bores": extrusion(
        rounded_polygon(_rectangle(60.0, 40.0, 6.0)), 10.0, [circle(x, y, 4.0) for x in (12.0, 48.0) for y in (12.0, 28.0)]
    ),
    "bracket": extrusion(rounded_polygon(_BRACKET), 25.0, [circle(52.0, 4.0, 1.8), circle(4.0, 38.0, 1.8)]),
    "boss": lathe(_BOSS),
    "blunt cone": lathe(_CONE),
    "bearing ring": lathe(_BEARING, closed=True),
    "torus": TORUS_RING,
    "bent plate": _bent_plate(),
    "cross-bored boss": bored(lathe(_BOSS), _PIN, np.array([0.0, 0.0, 22.0]), _LYING),
}  # fmt: skip
"""Solids with planes, roundings, fillets, drafts and bores."""

FLAT: dict[str, Solid] = {
    **{f"prism of {n} sides": regular_prism(n, 20.0, 30.0) for n in (9, 10, 12, 16, 24)},
    "plate bent sharply by 10 degrees": sharp_bend(10.0),
}
"""Solids of planes alone: their contours are exact."""
