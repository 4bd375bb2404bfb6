"""Checks of the promise: sections lie within the declared bound, and the bound is not idle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import shapely

from ebamcheck.errors import BackendFailed
from ebamcheck.geometry.regions import eroded
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.mesh.topology import weld
from ebamcheck.plugins.registry import Model
from ebamcheck.testing import solids
from ebamcheck.testing.solids import SIMPLE, box, house_rule, joined, mapped, named, sections, simple, turn
from ebamcheck.testing.subject import NO_LAYER, Figure, Subject, generic_heights, rounding_mm, truth

LOOSEST = 3.0  # a bound more than this many times the worst case that the kit finds is idle
SHIFT_SHARE = (
    0.2  # share of the bound by which the centroids of round sections may be off, on the mean of a body's layers
)
# The same for one layer alone: by chance a torus's thin ring is 0.37 of a bound off, half a pixel is 0.63 of a raster's, half a row all of it
LAYER_SHIFT_SHARE = 0.5
SHIFT_LAYERS = 9  # layers of a body over which chance averages out
ROUND = ("sphere", "torus", "upright torus")
FINE_FEATURES_MM = 1e-3  # what the features of attacking solids are scaled by where a bound is mere rounding
MODEL_TOLERANCE = 0.003  # tessellation of reference models, over their size; within .01 .. .5 mm
SECTION_SHARE = 0.05  # chord error of a model's exact section, over the tessellation's tolerance
BUFFER_SHARE = 0.003  # what a buffer's polygonal arcs take off its radius (16 segments a quarter)


def bound_held(subject: Subject) -> list[Figure]:
    """On every solid and layer, the exact section eroded by the bound lies in the result, and the reverse."""
    return [f for part, z in _solids() for f in _depths("bound held", subject, part, z)]


def bound_attacked(subject: Subject) -> list[Figure]:
    """The same on walls, slits, posts, pores and wedges about as thin as the bound."""
    parts = _attackers(subject).values()
    return [f for part in parts for f in _depths("bound attacked", subject, part, generic_heights(part, 1))]


def bound_not_idle(subject: Subject) -> list[Figure]:
    """The worst case that the attack finds is more than a third of the bound; exact slicers' is rounding."""
    if subject.slicer.exact:
        return []
    shares = []
    for part in _attackers(subject).values():
        deepest = float(subject.differences(part, generic_heights(part, 1)).depth_mm.max())
        shares.append(deepest / subject.bound_mm(part))
    value = 1.0 / max(*shares, 1e-300)
    text = f"the bound is {value:.3g} times the worst case; its share in each attack: {np.round(shares, 2)}"
    return [Figure("bound not idle", "worst case", NO_LAYER, value, LOOSEST, text)]


def no_shift(subject: Subject) -> list[Figure]:
    """On round bodies errors average out: sections do not lie to one side of the exact ones."""
    found = []
    for part, heights in _solids(ROUND, SHIFT_LAYERS):
        layers, exact = subject.cut(part, heights), sections(part, heights, house_rule)
        promise_mm, rounding = subject.promise_mm(part), rounding_mm(part)
        limit, one_limit = (share * promise_mm + rounding for share in (SHIFT_SHARE, LAYER_SHIFT_SHARE))
        shifts = []
        for k in range(len(heights)):
            cut, true = solids.region(layers, k), solids.region(exact, k).centroid
            off = (np.inf, np.inf) if cut.is_empty else (cut.centroid.x - true.x, cut.centroid.y - true.y)
            shifts.append(off)
        # A small section lies off by chance; what is wrong lies off the same way in all.
        shift = float(np.hypot(*np.mean(shifts, axis=0)))
        text = f"mean distance of the centroids of {len(heights)} layers, mm"
        found.append(Figure("no shift", part.name, NO_LAYER, shift, limit, text))
        # The mean would hide a layer that lies off alone.
        text = "distance of the centroids, mm"
        for k, one in enumerate(shifts):
            found.append(Figure("no shift", part.name, k, float(np.hypot(*one)), one_limit, text))
    return found


def topology(subject: Subject) -> list[Figure]:
    """Rings and holes are those of the exact section; if sampled, those thicker than twice the limit."""
    found = []
    for part, heights in _solids():
        seen = subject.differences(part, heights)
        if subject.slicer.exact:
            layers, exact = subject.cut(part, heights), sections(part, heights, house_rule)
            agree = layers.outer_counts() == exact.outer_counts()
            seen = seen._replace(topology_agrees=agree & (layers.hole_counts() == exact.hole_counts()))
        found += seen.topology_figures("topology", part.name)
    return found


def points_on_contours(subject: Subject) -> list[Figure]:
    """Points of an exact slicer lie on the exact contours to within rounding, and so do its areas."""
    if not subject.slicer.exact:
        return []
    found = []
    for part, heights in _solids():
        layers, exact = subject.cut(part, heights), sections(part, heights, house_rule)
        limit = subject.promise_mm(part)
        for k in range(len(heights)):
            rings = [layers.ring(r) for r in layers.rings_of(k)]
            points = shapely.points(np.concatenate([np.zeros((0, 2)), *rings]))
            off = shapely.distance(points, solids.region(exact, k).boundary).max(initial=0.0)
            found.append(Figure("points on contours", part.name, k, float(off), limit, "farthest point, mm"))
            error = float(abs(layers.areas()[k] - exact.areas()[k]))
            allowed = limit * float(exact.perimeters()[k])
            found.append(Figure("points on contours", part.name, k, error, allowed, "area, mm2"))
    return found


def coplanar_planes(subject: Subject) -> list[Figure]:
    """Planes through vertices and faces give the section of z = h + 0, if that is the declared rule."""
    parts = {
        "steps": solids.steps(),
        "turned steps": mapped(solids.steps(), turn(29.0)),
        "pyramid": simple("pyramid"),
        "sphere": simple("sphere"),
        "upside-down steps": mapped(solids.steps(), turn(180.0, "x")),
    }
    found = []
    for name, made in parts.items():
        part = named(name, made)
        levels = np.unique(part.vertices[:, 2])
        if not subject.half_open:
            layers = subject.cut(part, levels)
            found.append(truth("coplanar planes", name, len(layers) == levels.size, "layers are missing"))
            continue
        found += _depths("coplanar planes", subject, part, levels)
    return found


def inside_rule(subject: Subject) -> list[Figure]:
    """Where shells overlap, nest or are inside out, the solid is what the declared rule makes of it."""
    first, second = box((0, 0, 0), (9, 8, 5)), box((4, 3, 1), (14, 12, 6))
    third = mapped(box((2, 2, 0.5), (7, 6, 4.5)), turn(11.0))
    parts = {
        "two shells": joined(first, second),
        "three shells": joined(first, second, third),
        "shell in a shell": joined(first, box((2, 2, 1), (5, 5, 4))),
        "inside out": joined(mapped(first, shift=(20, 0, 0)), second.reversed()),
    }
    found: list[Figure] = []
    for name, made in parts.items():
        part = named(name, made)
        heights = generic_heights(part, 4)
        layers = subject.cut_unless_refused("inside rule", part, heights, found)
        if layers is None:
            continue
        rule = subject.inside_rule(layers)
        if solids.winding_rule(rule) is None:
            found.append(truth("inside rule", name, False, f"unknown rule {rule!r}"))
            continue
        differences = subject.differences(part, heights)
        limit = subject.limit_mm(part)
        for k, depth in enumerate(differences.depth_mm):
            found.append(Figure("inside rule", name, k, float(depth), limit, differences.places[k]))
            twice = abs(float(layers.areas()[k]) - solids.region(layers, k).area)
            rounding_mm2 = rounding_mm(part) * float(layers.perimeters()[k])
            found.append(Figure("inside rule", name, k, twice, rounding_mm2, "area under two rings, mm2"))
    return found


def touching_bodies(subject: Subject) -> list[Figure]:
    """Bodies that touch in a face are one region, those that share an edge two; a gap wider than twice the limit is kept.

    Turned, their faces touch within rounding: what that opens is narrower than any bound, and may be closed or kept. So may be
    what is narrower than the bound of a slicer that samples.
    """
    base = box((0, 0, 0), (8, 8, 5))
    gap = max(FINE_FEATURES_MM, 2.5 * subject.limit_mm(joined(base, box((8, 2, 0), (14, 6, 5)))))
    halves = box((0, 0, 0), (8, 8, 5)), box((8, 0, 0), (16, 8, 5))
    parts = {
        "part of a face": (joined(base, box((8, 2, 0), (14, 6, 5))), 1),
        "whole faces": (joined(*halves), 1),
        "whole faces, welded": (from_arrays(*weld(joined(*halves).triangles)), 1),
        "an edge": (joined(base, box((8, 8, 0), (14, 13, 5))), 2),
        "a gap": (joined(base, box((8 + gap, 2, 0), (14 + gap, 6, 5))), 2),
    }
    found: list[Figure] = []
    for name, (made, bodies) in parts.items():
        for degrees in (0.0, 29.0):
            part = named(f"{name}, {degrees:g} degrees", mapped(made, turn(degrees)))
            heights = generic_heights(part, 2)
            layers = subject.cut_unless_refused("touching bodies", part, heights, found)
            if layers is None:
                continue
            seen, limit = subject.differences(part, heights), subject.limit_mm(part)
            for k, rings in enumerate(layers.ring_counts().tolist()):
                free = degrees > 0.0 or not subject.slicer.exact
                right = rings == bodies or (free and bool(seen.topology_agrees[k]))
                text = f"{rings} rings in place of {bodies}"
                found.append(truth("touching bodies", part.name, right, text, k))
                text = f"depth, mm, at {seen.places[k]}"
                found.append(Figure("touching bodies", part.name, k, float(seen.depth_mm[k]), limit, text))
    return found


def reference_models(subject: Subject) -> list[Figure]:
    """Sections of tessellated reference models lie about their closed forms, within bound and tolerance."""
    found: list[Figure] = []
    refused = []
    for name, model in subject.models.items():
        try:
            found += _model_figures(subject, name, model)
        except BackendFailed as refusal:
            refused.append(f"{name}: {refusal}")
    if subject.models and not found:
        found.append(truth("reference models", "all", False, f"every model was refused: {refused[0]}"))
    return found


def _model_figures(subject: Subject, name: str, model: Model) -> list[Figure]:
    """Area by which layers of one model break their promise. No point of the mesh is farther than `t` from the surface, so its
    section at z lies within the union of the exact sections at z - t .. z + t dilated by t, and contains their intersection eroded
    by t."""
    size_mm = float((model.bounds[1] - model.bounds[0]).max())
    t = min(max(MODEL_TOLERANCE * size_mm, 0.01), 0.5)
    part = model.tessellate(t)
    low, high = model.bounds[:, 2].tolist()
    heights = low + (high - low) * np.array([0.137, 0.431, 0.683, 0.859])
    layers = subject.cut(part, heights)
    reach_mm = (subject.promise_mm(part) + t * (1.0 + SECTION_SHARE)) * (1.0 + BUFFER_SHARE)
    found = []
    told_otherwise = _by_another_rule(subject, part, layers, heights)
    for k, z in enumerate(heights.tolist()):
        if k in told_otherwise:
            found.append(told_otherwise[k])
            continue
        heights_near = z + t * np.linspace(-1.0, 1.0, 5)
        near = [shapely.union_all(model.section(at, SECTION_SHARE * t)) for at in heights_near.tolist()]
        most = shapely.union_all(near).buffer(reach_mm, quad_segs=16)
        least = eroded(shapely.intersection_all(near), reach_mm)
        cut = solids.region(layers, k)
        beyond = float(cut.difference(most).area + least.difference(cut).area)
        rounding_mm2 = rounding_mm(part) * max(float(most.length), 1.0)
        text = f"area beyond, mm2, at z = {z:.9g} mm"
        found.append(Figure("reference models", name, k, beyond, rounding_mm2, text))
    return found


def _by_another_rule(subject: Subject, part: Part, layers: Layers, heights: Floats) -> dict[int, Figure]:
    """Figures of the layers where the declared inside rule asks for another solid than the house's, the union of shells, which is a
    model's closed form: there the slicer is held against the section of the mesh by that rule, as on solids (`inside_rule`)."""
    rule = solids.winding_rule(subject.inside_rule(layers))
    if rule is None or subject.inside_rule(layers) == solids.HOUSE_RULE:
        return {}
    own, house = (sections(part, heights, by) for by in (rule, house_rule))
    other = np.flatnonzero(~np.isclose(own.areas(), house.areas(), rtol=1e-9, atol=rounding_mm(part) ** 2))
    if not other.size:
        return {}
    found, limit = subject.differences(part, heights), subject.limit_mm(part)
    told = f"depth, mm, from the section by the rule {subject.inside_rule(layers)!r}, at "
    return {
        k: Figure("reference models", part.name, k, float(found.depth_mm[k]), limit, told + found.places[k])
        for k in other.tolist()
    }


def _solids(names: Iterable[str] = tuple(SIMPLE), layers: int = 3) -> Iterator[tuple[Part, Floats]]:
    """Solids by name, each with as many generic heights."""
    for name in names:
        part = simple(name)
        yield part, generic_heights(part, layers)


def _attackers(subject: Subject) -> dict[str, Part]:
    bound_mm = max(subject.bound_mm(solids.frame()), FINE_FEATURES_MM)
    return solids.attackers(min(bound_mm, 0.02 * solids.FRAME_MM))


def _depths(check: str, subject: Subject, part: Part, heights: Floats) -> list[Figure]:
    return subject.differences(part, heights).depth_figures(check, part.name, subject.limit_mm(part))


# In the order in which they are run
CHECKS = (
    bound_held, bound_attacked, bound_not_idle, no_shift, topology, points_on_contours, coplanar_planes, inside_rule,
    touching_bodies, reference_models,
)  # fmt: skip
