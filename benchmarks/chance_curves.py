"""Attack on the promise that curves are never farther from the part than its contours: ``python -m benchmarks.chance_curves``.

Random forms (smooth bodies and CAD solids whose kind and every dimension a seed decides), meshed at random, in random directions, out of random files. Each seed is a
case of its own; those that break the law are listed with what they are.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmarks.curve_parts import heights_of, part_of
from benchmarks.curve_parts_meshes import (
    FORMATS,
    as_file,
    bored,
    decimated,
    irregular_convex,
    irregular_torus,
    joined,
    noisy,
    quadric_decimated,
    split_edges,
    turn,
    turned,
)  # fmt: skip
from benchmarks.curve_parts_solids import (
    Bow,
    Floats,
    Profile,
    Solid,
    Triangles,
    extrusion,
    frustum,
    lathe,
    regular_prism,
    wedge,
)  # fmt: skip
from ebamcheck.curves import Curves, contour_error, fit
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.slicers.slicing import slice_part
from ebamcheck_models.outlines import Outline, circle, rounded_polygon

Rng = np.random.Generator

LEAST_TURN_RAD = math.radians(3.0)
"""Corners of random profiles that turn by less are left as they are."""


@dataclass(frozen=True)
class Form:
    """A form, and how it may be meshed."""

    name: str
    solid: Solid
    """Mesh by chord error, mm: that of its grid or of its generator."""
    scattered: Callable[[int, int], Triangles] | None = None
    """Mesh of so many random points of its surface by a seed; None where the form has no such mesh."""


def chance_form(rng: Rng) -> Form:
    """A form of any kind."""
    return KINDS[int(rng.integers(len(KINDS)))](rng)


# -- smooth bodies -----------------------------------------------------------------------------------------


def ball_of_waves(rng: Rng) -> Form:
    """Ellipsoid with a few gentle waves: any direction has one point of it."""
    axes = rng.uniform(12.0, 35.0, 3)
    waves = [
        (rng.normal(size=3) * rng.uniform(0.5, 3.0), rng.uniform(0.0, 0.06), rng.uniform(0, 6.3)) for _ in range(3)
    ]

    def surface(u: Floats) -> Floats:
        swell = np.zeros(len(u))
        for k, a, p in waves:
            swell += a * np.cos(u @ k + p)
        return np.asarray(u * axes * (1.0 + swell)[:, None])

    def grid(chord_mm: float) -> Triangles:
        n = max(4, math.ceil(0.5 * math.pi * math.sqrt(float(axes.max()) / (8.0 * chord_mm)) * 1.6))
        return _over_a_cube(surface, n)

    return Form("ball of waves", grid, lambda count, seed: irregular_convex(surface, count, seed, star=True))


def ellipsoid(rng: Rng) -> Form:
    """Ellipsoid of random axes."""
    axes = rng.uniform(10.0, 40.0, 3)

    def surface(u: Floats) -> Floats:
        return np.asarray(u * axes)

    def grid(chord_mm: float) -> Triangles:
        n = max(4, math.ceil(0.5 * math.pi * math.sqrt(float(axes.max()) / (8.0 * chord_mm)) * 1.4))
        return _over_a_cube(surface, n)

    return Form("ellipsoid", grid, lambda count, seed: irregular_convex(surface, count, seed))


def ring_of_waves(rng: Rng) -> Form:
    """Torus whose tube is an ellipse that swells and turns along the ring."""
    ring, tube, other = rng.uniform(20.0, 35.0), rng.uniform(5.0, 10.0), rng.uniform(5.0, 10.0)
    count, depth, twist = int(rng.integers(0, 6)), rng.uniform(0.0, 0.2), int(rng.integers(-1, 2))

    def surface(u: Floats, v: Floats) -> Floats:
        p, q = 2.0 * np.pi * u, 2.0 * np.pi * v
        swell = 1.0 + depth * np.cos(count * p)
        x, y = swell * tube * np.cos(q), swell * other * np.sin(q)
        c, s = np.cos(twist * p), np.sin(twist * p)
        r, z = ring + c * x - s * y, s * x + c * y
        return np.stack([r * np.cos(p), r * np.sin(p), z])

    def grid(chord_mm: float) -> Triangles:
        n = math.ceil(2.0 * math.pi * math.sqrt((ring + tube) * (1.0 + depth * count**2) / (4.0 * chord_mm)))
        m = math.ceil(2.0 * math.pi * math.sqrt(max(tube, other) * 1.6 / (4.0 * chord_mm)))
        return _over_a_torus(surface, max(n, 12), max(m, 8))

    return Form("ring of waves", grid, lambda points, seed: irregular_torus(surface, points, seed))


def _over_a_cube(surface: Callable[[Floats], Floats], n: int) -> Triangles:
    """Grid of n x n squares on each side of a cube, blown up to a sphere, and mapped."""
    at = np.tan(np.linspace(-0.25, 0.25, n + 1) * np.pi)
    u, v = np.meshgrid(at, at, indexing="ij")
    points: list[Floats] = []
    faces: list[NDArray[np.int64]] = []
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1)
    square = np.concatenate([np.column_stack([a, a + n + 1, a + n + 2]), np.column_stack([a, a + n + 2, a + 1])])
    for axis in range(3):
        for sign in (-1.0, 1.0):
            side = np.empty((u.size, 3))
            side[:, axis] = sign
            side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = u.reshape(-1), v.reshape(-1)
            faces.append((square if sign > 0 else square[:, ::-1]) + len(points) * u.size)
            points.append(side)
    flat = np.concatenate(points)
    _, first, ids = np.unique(np.round(flat, 9), axis=0, return_index=True, return_inverse=True)
    directions = flat[first] / np.linalg.norm(flat[first], axis=1)[:, None]
    return Triangles(surface(directions), ids.reshape(-1)[np.concatenate(faces)].astype(np.int64))


def _over_a_torus(surface: Callable[[Floats, Floats], Floats], n: int, m: int) -> Triangles:
    u, v = np.meshgrid(np.arange(n) / n, np.arange(m) / m, indexing="ij")
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b = i * m + j, (i + 1) % n * m + j
    c, d = (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return Triangles(surface(u.reshape(-1), v.reshape(-1)).T, faces.astype(np.int64))


# -- CAD solids --------------------------------------------------------------------------------------------


def rounded_box(rng: Rng) -> Form:
    """Box or draft box with rounded edges."""
    low = rng.uniform(10.0, 40.0, 2)
    high = low * (rng.uniform(0.7, 1.0) if rng.random() < 0.5 else 1.0)
    solid = frustum(_pair(low), _pair(high), rng.uniform(8.0, 30.0), rng.uniform(0.8, 6.0))
    return Form("rounded box", solid)


def rounded_wedge(rng: Rng) -> Form:
    """Prism over a triangle with rounded edges."""
    length, width, height = rng.uniform(15.0, 50.0, 3).tolist()
    return Form("rounded wedge", wedge(length, width, height, rng.uniform(0.8, 5.0)))


def turned_part(rng: Rng) -> Form:
    """Solid of revolution whose profile's corners are rounded, filleted or sharp."""
    return Form("turned part", lathe(_profile(rng)))


def turned_ring(rng: Rng) -> Form:
    """Ring of a rounded section."""
    r, w, h = rng.uniform(10.0, 25.0), rng.uniform(6.0, 15.0), rng.uniform(5.0, 20.0)
    corners = [(r, 0.0), (r + w, rng.uniform(-2.0, 2.0)), (r + w, h), (r + rng.uniform(-2.0, 3.0), h)]
    radii = rng.uniform(0.3, 2.5, 4) * (rng.random(4) < 0.7)
    return Form("turned ring", lathe(_rounded(corners, radii.tolist(), closed=True), closed=True))


def plate(rng: Rng) -> Form:
    """Extruded polygon with rounded corners and bores."""
    outline, inner = _outline(rng)
    return Form("plate", extrusion(outline, rng.uniform(6.0, 30.0), _bores(rng, inner)))


def prism(rng: Rng) -> Form:
    """True prism of few sides."""
    sides = int(rng.integers(5, 30))
    return Form("prism", regular_prism(sides, rng.uniform(10.0, 30.0), rng.uniform(10.0, 30.0)))


def bored_part(rng: Rng) -> Form:
    """Turned part or box with an inclined bore: slivers lie along the seam."""
    body = (turned_part if rng.random() < 0.5 else rounded_box)(rng)
    r = rng.uniform(1.5, 5.0)
    pin = lathe([(0.0, -90.0), (r, -90.0), (r, 90.0), (0.0, 90.0)])
    place, rotation = rng.uniform(-4.0, 4.0, 3) + np.array([0.0, 0.0, 8.0]), turn(int(rng.integers(1, 1000)))
    return Form("bored part", bored(body.solid, pin, place, rotation))


def joined_part(rng: Rng) -> Form:
    """Two bodies put together: a sharp seam that runs anywhere."""
    body, other = rounded_box(rng), (turned_part if rng.random() < 0.5 else turned_ring)(rng)
    place, rotation = rng.uniform(-8.0, 8.0, 3), turn(int(rng.integers(1, 1000)))
    return Form("joined part", joined(body.solid, other.solid, place, rotation))


def _profile(rng: Rng) -> Profile:
    count = int(rng.integers(2, 6))
    z = np.concatenate([[0.0], np.sort(rng.uniform(3.0, 40.0, count))])
    z += 4.0 * np.arange(count + 1)
    r = rng.uniform(8.0, 28.0, count + 1)
    if rng.random() < 0.5:
        r[rng.integers(count)] = r[-1]
    corners = [(0.0, 0.0), *zip(r.tolist(), z.tolist(), strict=True), (0.0, float(z[-1]))]
    radii = [0.0, *(rng.uniform(0.4, 6.0, count + 1) * (rng.random(count + 1) < 0.75)).tolist(), 0.0]
    return _rounded(corners, radii)


def _rounded(corners: list[tuple[float, float]], radii: list[float], closed: bool = False) -> Profile:
    """Corners of a profile with arcs in their place, as large as the sides beside them allow."""
    points = np.array(corners)
    found: list[tuple[float, float] | Bow] = []
    for n, (corner, radius) in enumerate(zip(points, radii, strict=True)):
        if radius <= 0.0 or (not closed and n in (0, len(points) - 1)):
            found.append(_pair(corner))
            continue
        before, after = corner - points[n - 1], points[(n + 1) % len(points)] - corner
        room = 0.45 * min(math.hypot(*before), math.hypot(*after))
        before, after = before / math.hypot(*before), after / math.hypot(*after)
        turn_rad = math.atan2(before[0] * after[1] - before[1] * after[0], float(before @ after))
        if abs(turn_rad) < LEAST_TURN_RAD:
            found.append(_pair(corner))
            continue
        reach = min(radius * math.tan(0.5 * abs(turn_rad)), room)
        radius = reach / math.tan(0.5 * abs(turn_rad))
        inward = math.copysign(radius, turn_rad) * np.array([-before[1], before[0]])
        centre = corner - reach * before + inward
        start = math.degrees(math.atan2(-inward[1], -inward[0]))
        found.append(Bow(*_pair(centre), radius, start, start + math.degrees(turn_rad)))
    return found


def _outline(rng: Rng) -> tuple[Outline, float]:
    """Polygon about the origin with rounded corners, and the radius of the circle inside of it."""
    count = int(rng.integers(3, 8))
    angle = 2.0 * np.pi * (np.arange(count) + rng.uniform(-0.25, 0.25, count)) / count
    radius = rng.uniform(18.0, 35.0, count)
    points = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    sides = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    corners = []
    for n in range(count):
        before, after = points[n] - points[n - 1], points[(n + 1) % count] - points[n]
        cosine = float(before @ after) / float(np.linalg.norm(before) * np.linalg.norm(after))
        half = max(math.tan(0.5 * math.acos(min(max(cosine, -1.0), 1.0))), 1e-3)
        most = 0.4 * min(float(sides[n - 1]), float(sides[n])) / half
        corners.append((*_pair(points[n]), min(rng.uniform(0.0, 8.0), most) if rng.random() < 0.8 else 0.0))
    ends = np.roll(points, -1, axis=0)
    inner = float(np.min(np.abs(points[:, 0] * ends[:, 1] - points[:, 1] * ends[:, 0]) / sides))
    return rounded_polygon(corners), inner


def _bores(rng: Rng, inner: float) -> list[Outline]:
    if rng.random() < 0.4 or inner < 5.0:
        return []
    r = 0.28 * inner
    count = int(rng.integers(1, 4))
    around = np.arange(count) * 2.0 * np.pi / count
    far = 0.0 if count == 1 else 0.42 * inner
    return [circle(far * math.cos(a), far * math.sin(a), r * rng.uniform(0.4, 0.9)) for a in around]


def _pair(two: Floats) -> tuple[float, float]:
    return float(two[0]), float(two[1])


KINDS: tuple[Callable[[Rng], Form], ...] = (
    ball_of_waves,
    ellipsoid,
    ring_of_waves,
    rounded_box,
    rounded_wedge,
    turned_part,
    turned_part,
    turned_ring,
    plate,
    prism,
    bored_part,
    joined_part,
)


# -- the law ------------------------------------------------------------------------------------------------


LAYERS = 4
SAMPLES = 1500

TRUTH_SHARE = 0.01
"""Chord error of the truth over that of the mesh; and what it leaves undecided."""

LEAST_TRUTH_MM = 2e-4
LARGEST_GROWTH = 1.05
"""Of the largest error, that the law allows."""

NOISE_GROWTH = 1.02
"""Of the RMS error of a mesh that was made noisy, that the law allows."""


@dataclass(frozen=True)
class Verdict:
    """Normal distances over all rings of one case, mm."""

    name: str
    meshing: str
    before: tuple[float, float]
    """RMS and largest of the contours."""
    after: tuple[float, float]
    """The same of the curves."""
    slack_mm: float
    """What truth and rounding leave undecided."""

    @property
    def held(self) -> bool:
        """Whether the curves are no farther from the part than the contours."""
        grown = NOISE_GROWTH if self.meshing == "noise" else 1.0
        return (
            self.after[0] <= grown * self.before[0] + self.slack_mm
            and self.after[1] <= LARGEST_GROWTH * self.before[1] + 2.0 * self.slack_mm
        )

    @property
    def gain(self) -> float:
        """How much smaller the RMS became, as a fraction of 1; 0 where there was nothing to gain."""
        return 1.0 - self.after[0] / self.before[0] if self.before[0] > 2.0 * self.slack_mm else 0.0

    def __str__(self) -> str:
        """One line."""
        (rms, largest), (fitted, farthest) = self.before, self.after
        return (
            f"{self.name}: RMS {rms:.5f} -> {fitted:.5f} mm, largest {largest:.5f} -> {farthest:.5f} mm"
            f" ({100.0 * self.gain:.0f} %)"
        )


@dataclass(frozen=True)
class Case:
    """A mesh, and the fine one that stands for its part."""

    name: str
    meshing: str
    part: Part
    truth: Part
    slack_mm: float


def chance_case(seed: int) -> Case:
    """The case of a seed; the same seed is always the same case."""
    rng = np.random.default_rng([seed, 20])
    form = chance_form(rng)
    chord_mm = float(np.exp(rng.uniform(math.log(0.02), math.log(0.4))))
    names = [m for m in MESHINGS if m != "irregular" or form.scattered is not None]
    meshing = names[int(rng.integers(len(names)))]
    direction = int(rng.integers(1, 10_000)) * int(rng.random() < 0.8)
    kept = FORMATS[int(rng.integers(3))]
    mesh = MESHINGS[meshing](form, chord_mm, rng)
    truth_mm = max(TRUTH_SHARE * chord_mm, LEAST_TRUTH_MM)
    label = f"seed {seed}: {form.name}, {meshing}, {chord_mm:.3f} mm, direction {direction}, {kept}"
    return Case(
        label,
        meshing,
        part_of(as_file(turned(mesh, direction), kept), label),
        part_of(turned(form.solid(truth_mm), direction), "truth"),
        truth_mm + (1e-4 if kept == "ascii4" else 1e-5),
    )


def judge(case: Case, method: str = "bounded") -> Verdict:
    """Cut, fit and measure a case."""
    layers = slice_part(case.part, heights_of(case.part, LAYERS))
    truth = slice_part(case.truth, layers.heights)
    curves = fit(layers, method, part=case.part)
    before, after = errors_of(layers, truth), errors_of(curves, truth)
    return Verdict(case.name, case.meshing, before, after, case.slack_mm)


def errors_of(stack: Layers | Curves, truth: Layers) -> tuple[float, float]:
    """RMS and largest normal distance over the rings of layers whose rings all have partners; 0 without any.

    The largest is taken at the points and joints, too: it lies at a kink as a rule, which even steps miss.
    """
    table = contour_error(stack, truth, rays=1, samples=SAMPLES, by="ring")
    pairs = np.bincount(table["layer"], minlength=len(stack))
    whole = np.ones(len(stack), np.bool_)
    for one in (stack, truth):
        whole &= np.bincount(one.ring_layer[one.closed], minlength=len(stack)) == pairs
    known = table[whole[table["layer"]]]
    if known.empty:
        return 0.0, 0.0
    rms = math.sqrt(float((known["normal_rms_mm"] ** 2).mean()))
    largest = float(known["normal_max_abs_mm"].max())
    ends = rings_of_ends(stack)
    for ring, other in zip(known["ring"], known["reference_ring"], strict=True):
        points = truth.points[truth.ring_starts[other] : truth.ring_starts[other + 1]]
        away = shapely.distance(shapely.LinearRing(points), shapely.points(ends[ring]))
        largest = max(largest, float(away.max(initial=0.0)))
    return rms, largest


def rings_of_ends(stack: Layers | Curves) -> list[Floats]:
    """Points of each ring: those of contours, and where the pieces of curves meet."""
    if isinstance(stack, Layers):
        return np.split(stack.points, stack.ring_starts[1:-1])
    return np.split(stack.control[stack.control_starts[:-1]], stack.ring_starts[1:-1])


# -- meshings ----------------------------------------------------------------------------------------------


def _regular(form: Form, chord_mm: float, rng: Rng) -> Triangles:
    return form.solid(chord_mm)


def _slivers(form: Form, chord_mm: float, rng: Rng) -> Triangles:
    return split_edges(form.solid(chord_mm), 120, float(10.0 ** rng.uniform(-7.0, -4.0)), int(rng.integers(1000)))


def _irregular(form: Form, chord_mm: float, rng: Rng) -> Triangles:
    assert form.scattered is not None
    return form.scattered(int(np.clip(400.0 / chord_mm, 800, 6000)), int(rng.integers(1000)))


def _simplified(form: Form, chord_mm: float, rng: Rng) -> Triangles:
    return decimated(form.solid(0.2 * chord_mm), chord_mm)


def _by_quadrics(form: Form, chord_mm: float, rng: Rng) -> Triangles:
    return quadric_decimated(form.solid(max(chord_mm, 0.05)), float(rng.uniform(0.2, 0.7)))


def _noisy(form: Form, chord_mm: float, rng: Rng) -> Triangles:
    mesh = form.solid(chord_mm) if form.scattered is None else _irregular(form, chord_mm, rng)
    return noisy(mesh, float(rng.uniform(0.05, 0.3)), int(rng.integers(1000)))


Meshing = Callable[[Form, float, Rng], Triangles]

MESHINGS: dict[str, Meshing] = {
    "regular": _regular,
    "slivers": _slivers,
    "irregular": _irregular,
    "simplified": _simplified,
    "by quadrics": _by_quadrics,
    "noise": _noisy,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Judge seeds, and name those that break the law."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.chance_curves", description=__doc__)
    parser.add_argument("seeds", type=int, nargs="*", help="seeds, in place of a range")
    parser.add_argument("--first", type=int, default=0, help="first seed of the range")
    parser.add_argument("--count", type=int, default=300, help="seeds of the range")
    parser.add_argument("--all", action="store_true", help="print every case")
    asked = parser.parse_args(arguments)
    gains: dict[str, list[float]] = {}
    broken = 0
    seeds = asked.seeds or range(asked.first, asked.first + asked.count)
    for seed in seeds:
        verdict = judge(chance_case(seed))
        broken += not verdict.held
        gains.setdefault(verdict.meshing, []).append(verdict.gain)
        if asked.all or not verdict.held:
            print(f"{'held  ' if verdict.held else 'BROKEN'} {verdict}", flush=True)
    for meshing, some in sorted(gains.items()):
        print(
            f"{meshing}: {len(some)} cases, median gain {100.0 * float(np.median(some)):.1f} %, worst {100.0 * min(some):.1f} %"
        )
    print(f"{broken} of {len(seeds)} seeds break the law")


if __name__ == "__main__":
    main()
