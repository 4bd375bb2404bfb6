"""Attack on the promise that curves are never farther from the part than its contours: ``python -m benchmarks.chance_curves``.

Random forms (:mod:`benchmarks.chance_forms`), meshed at random, in random directions, out of random files. Each seed is a
case of its own; those that break the law are listed with what they are.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from benchmarks.chance_forms import Form, Rng, chance_form
from benchmarks.curve_parts import heights_of, part_of
from benchmarks.curve_parts_meshes import FORMATS, as_file, decimated, noisy, split_edges, turned
from benchmarks.curve_parts_solids import Floats, Triangles
from benchmarks.quadric_decimation import quadric_decimated
from ebamcheck.curves import Curves, contour_error, fit
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.slicers.slicing import slice_part

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
    return split_edges(
        form.solid(chord_mm), 120, float(10.0 ** rng.uniform(-7.0, -4.0)), int(rng.integers(1000))
    )


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
