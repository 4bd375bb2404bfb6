"""Sections of exact surfaces: contour points move to where a layer cuts one surface, or two that meet at an edge, and points are
put between them where one cubic would not follow the section."""

from __future__ import annotations

import numpy as np

from ebamcheck.columns_file import starts_of
from ebamcheck.curves.oriented_contours import NO_FORM, NO_PLANE, Sides
from ebamcheck.curves.runs import angles, around
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.surface.exact_forms import FLAT, KIND, SIDE, signed_distances
from ebamcheck.surface.exact_surfaces import ExactSurfaces

MOST_STEPS = 40  # Most Newton steps; each doubles the digits, so a few are enough on all but level surfaces
CLOSE_MM = 1e-10  # A point this near to a surface lies on it

LEAST_SLOPE = 0.02
"""Horizontal part of a unit gradient below which a surface is level in the layer: a point does not determine its section."""

MOST_GROWTH = 3.0  # Farthest move of a point, over its first-order distance from the surface: a section farther off is another one


def on_one(rows: Floats, places: Floats) -> tuple[Bools, Floats]:
    """The places (n, 2) straight ahead of points (n, 3) on the section of one surface each, and whether there is one."""
    at = places.copy()
    off = signed_distances(rows, at)
    slope = np.hypot(off[:, 1], off[:, 2])
    known = slope >= LEAST_SLOPE
    allowed = MOST_GROWTH * np.abs(off[:, 0]) / np.maximum(slope, 1e-300) + CLOSE_MM
    for _ in range(MOST_STEPS):
        moving = np.flatnonzero(known & (np.abs(off[:, 0]) > CLOSE_MM))
        if not moving.size:
            break
        some = off[moving]
        square = some[:, 1] ** 2 + some[:, 2] ** 2
        level = square < LEAST_SLOPE * LEAST_SLOPE
        known[moving[level]] = False
        moving, some, square = moving[~level], some[~level], square[~level]
        at[moving, :2] -= some[:, :1] * some[:, 1:3] / square[:, None]
        off[moving] = signed_distances(rows[moving], at[moving])
    known &= (np.abs(off[:, 0]) <= CLOSE_MM) & (np.hypot(*(at - places)[:, :2].T) <= allowed)
    return known, np.where(known[:, None], at[:, :2], places[:, :2])


def on_both(rows: Floats, others: Floats, places: Floats) -> tuple[Bools, Floats]:
    """The places (n, 2) beside points (n, 3) where the sections of two surfaces meet, and whether there is one.

    Where two touch it is midway between both, and on the plane if one is a plane.
    """
    at = places.copy()
    one, two = signed_distances(rows, at), signed_distances(others, at)
    slopes = np.hypot(one[:, 1], one[:, 2]), np.hypot(two[:, 1], two[:, 2])
    known = (slopes[0] >= LEAST_SLOPE) & (slopes[1] >= LEAST_SLOPE)
    product = np.maximum(slopes[0] * slopes[1], 1e-300)
    # Sections that make an angle of less than 5 degrees determine no common point.
    sine = np.abs(one[:, 1] * two[:, 2] - one[:, 2] * two[:, 1])
    touching = known & (sine < np.sin(np.deg2rad(5.0)) * product)
    ways = [np.abs(o[:, 0]) / np.maximum(s, 1e-300) for o, s in zip((one, two), slopes, strict=True)]
    allowed = CLOSE_MM + MOST_GROWTH * (ways[0] + ways[1])
    for _ in range(MOST_STEPS):
        far = np.maximum(np.abs(one[:, 0]), np.abs(two[:, 0])) > CLOSE_MM
        moving = np.flatnonzero(known & ~touching & far)
        if not moving.size:
            break
        a, b = one[moving], two[moving]
        determinant = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
        lost = np.abs(determinant) < 1e-9
        known[moving[lost]] = False
        moving, a, b, determinant = moving[~lost], a[~lost], b[~lost], determinant[~lost]
        at[moving, 0] -= (a[:, 0] * b[:, 2] - b[:, 0] * a[:, 2]) / determinant
        at[moving, 1] -= (a[:, 1] * b[:, 0] - b[:, 1] * a[:, 0]) / determinant
        one[moving] = signed_distances(rows[moving], at[moving])
        two[moving] = signed_distances(others[moving], at[moving])
    close = np.maximum(np.abs(one[:, 0]), np.abs(two[:, 0])) <= CLOSE_MM
    met = known & ~touching & close & (np.hypot(*(at - places)[:, :2].T) <= allowed)
    found = np.where(met[:, None], at[:, :2], places[:, :2])
    k = np.flatnonzero(touching)
    if k.size:
        (near, a), (far, b) = on_one(rows[k], places[k]), on_one(others[k], places[k])
        flat = rows[k, KIND] == FLAT, others[k, KIND] == FLAT
        met[k] = np.where(flat[0], near, np.where(flat[1], far, near & far))
        share = np.where(flat[0], 0.0, np.where(flat[1], 1.0, 0.5))[:, None]
        found[k] = np.where(met[k, None], (1.0 - share) * a + share * b, places[k, :2])
    return met, found


def directions(rows: Floats, places: Floats) -> tuple[Bools, Floats]:
    """Directions (n, 2) of sections with the solid to their left, and whether they have one."""
    _, u, v, _ = signed_distances(rows, places).T
    slope = np.hypot(u, v)
    turned = np.column_stack([-v, u]) * (rows[:, SIDE] / np.maximum(slope, 1e-300))[:, None]
    return slope >= LEAST_SLOPE, turned


def place(exact: ExactSurfaces, before: Ints, after: Ints, heights: Floats, i: Ints, found: Sides) -> Bools:
    """Place those points `i` of contours that have known surfaces on both sides, one of them curved; which these are.

    `before` and `after` are the facets of the segments that end and begin at each. Planes count as surfaces beside others;
    two of them have a straight edge.
    """
    label, forms = exact
    done = np.zeros(i.size, np.bool_)
    if not len(forms):
        return done
    curved = forms[:, KIND] != FLAT
    mine, other = label[before], label[after]
    k = np.flatnonzero((mine >= 0) & (other >= 0))
    k = k[curved[mine[k]] | curved[other[k]]]
    one, two = mine[k], other[k]
    places = np.column_stack([found.points[i[k]], heights[k]])
    known, at = np.zeros(k.size, np.bool_), places[:, :2].copy()
    same = one == two
    known[same], at[same] = on_one(forms[one[same]], places[same])
    known[~same], at[~same] = on_both(forms[one[~same]], forms[two[~same]], places[~same])
    places[:, :2] = at
    ways = [directions(forms[way], places) for way in (one, two)]
    known &= ways[0][0] & ways[1][0]
    rows = i[k[known]]
    found.points[rows] = at[known]
    found.before[rows], found.after[rows] = ways[0][1][known], ways[1][1][known]
    # A joint of more than half a degree is a corner: its uncertain place would let a larger one bend a long segment beside it.
    cosine = np.einsum("ij,ij->i", ways[0][1], ways[1][1])[known]
    found.smooth[rows] = cosine >= np.cos(np.deg2rad(0.5))
    found.form_before[rows] = np.where(curved[one], one, NO_FORM)[known]
    found.form_after[rows] = np.where(curved[two], two, NO_FORM)[known]
    done[k[known]] = True
    return done


# -- Refinement: points are inserted into a contour, on the section of its exact surface, where a cubic would not follow that.


MOST_PARTS = 32  # Most parts into which a segment is divided


def refined(forms: Floats, sides: Sides, heights: Floats, ring_starts: Ints, closed: Bools) -> tuple[Sides, Ints]:
    """Contours with points inserted on exact surfaces, and the new starts of their rings.

    `forms` are the exact surfaces, `heights` (R,) those of the rings.
    """
    if not len(forms):
        return sides, ring_starts
    ring, following, _ = around(ring_starts)
    form = sides.form_after
    asked = (form != NO_FORM) & (form == sides.form_before[following])
    asked &= closed[ring] | (following > np.arange(ring.size))
    pending = np.flatnonzero(asked)
    parts = np.ones(ring.size, np.int64)
    kept: dict[int, tuple[Ints, Floats, Floats]] = {}
    count = 1
    while pending.size:
        own, z = forms[form[pending]], heights[ring[pending]]
        known, followed, *between = _divided(own, sides, pending, following[pending], z, count)
        good = known & (followed | (count == MOST_PARTS))
        parts[pending[good]] = count
        kept[count] = pending[good], between[0][good], between[1][good]
        pending = pending[known & ~good]
        count *= 2
    if (parts == 1).all():
        return sides, ring_starts
    at = starts_of(parts)
    more = Sides._make(np.repeat(column, parts, axis=0) for column in sides)
    for count, (i, places, ways) in kept.items():
        if count == 1 or not i.size:
            continue
        rows = at[i][:, None] + np.arange(1, count)
        more.points[rows], more.before[rows], more.after[rows] = places, ways, ways
        more.smooth[rows], more.unknown[rows] = True, False
        more.plane_before[rows] = more.plane_after[rows] = NO_PLANE
        more.form_before[rows] = form[i][:, None]
        more.share[rows], more.plausible[rows] = 1.0, np.inf
    return more, at[ring_starts]


def _divided(
    rows: Floats, sides: Sides, i: Ints, j: Ints, heights: Floats, parts: int
) -> tuple[Bools, Bools, Floats, Floats]:
    """Divide the segments from points i to j on the sections of one surface each, into equal parts.

    Returns whether their sections are known, whether cubics follow them, and the places and directions (n, parts - 1, 2) between.
    """
    n = i.size
    p, q = sides.points[i], sides.points[j]
    share = (np.arange(1, parts) / parts)[None, :, None]
    chords = p[:, None] + (q - p)[:, None] * share
    places = np.concatenate([chords, np.repeat(heights, parts - 1).reshape(n, -1, 1)], axis=2).reshape(-1, 3)
    every = np.repeat(rows, parts - 1, axis=0)
    known, places[:, :2] = on_one(every, places)
    directed, ways = directions(every, places)
    at, ways = places[:, :2].reshape(n, -1, 2), ways.reshape(n, -1, 2)
    chord = np.diff(np.concatenate([p[:, None], at, q[:, None]], axis=1), axis=1)
    start = angles(np.concatenate([sides.after[i][:, None], ways], axis=1), chord)
    end = angles(chord, np.concatenate([ways, sides.before[j][:, None]], axis=1))
    # A cubic that spans no more than 20 degrees follows the section to some 1e-5 of its length, if its ends bend alike.
    span = np.abs(start) + np.abs(end)
    uneven = (span > np.deg2rad(1.0)) & (np.abs(start - end) > 0.05 * span)
    follows = ~((span > np.deg2rad(20.0)) | uneven).any(axis=1)
    return np.asarray((known & directed).reshape(n, -1).all(axis=1)), follows, at, ways
