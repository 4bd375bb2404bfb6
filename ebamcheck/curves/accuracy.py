"""Error of contours against a reference: polar radius (paper, section 5.2) and true normal distance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from ebamcheck.curves.columns import Curves, SampledRings
from ebamcheck.errors import SettingsError
from ebamcheck.geometry import rings
from ebamcheck.geometry.nearest import nearest, segments_along, signed_distance, tree_over
from ebamcheck.kernels import Floats, Ints, kernel
from ebamcheck.layers.stack import Layers
from ebamcheck.threads import run_blocks

RAYS = 3600  # Rays per ring: one every tenth of a degree
SAMPLES = 4000  # Places per ring at which the normal distance is taken, equally spaced along it
CURVE_TOLERANCE_MM = 1e-5
"""Chord error of the polylines as which curves are measured: far below any error that matters."""

LAYERS_A_STEP = 32  # Layers sampled at a time; bounds the working memory

MEASURES = ("min", "max", "squares", "absolute")
"""Statistics kept of the errors along one ring: enough to compute every figure of a layer; sums but for the first two."""


def contour_error(
    measured: Layers | Curves,
    reference: Layers | Curves,
    *,
    rays: int = RAYS,
    samples: int = SAMPLES,
    by: Literal["layer", "ring"] = "layer",
) -> pd.DataFrame:
    """Error of contours or curves against a reference of the same part at the same heights.

    Closed rings of one direction are paired by their boxes. The polar error of an outer ring is
    ``rho_measured - rho_reference`` about the centre of the reference ring's enveloping rectangle, on
    `rays` equally spaced directions; it is defined where every ray meets both rings once. The normal
    distance is taken from `samples` equally spaced places of the measured ring to the nearest point of
    the reference ring, for holes and any other shape too. Both are positive where there is too much metal.

    The reference is a far finer tessellation of the same part, or an analytic model. There is one row a layer, or one a pair of
    rings, with the columns ``layer, height_mm, rings`` (pairs), ``unmatched`` (closed rings of
    either side without a partner), ``outer_rings, polar_rings`` (outer pairs, and those with a polar
    error), ``polar_defined`` (all of them), ``polar_min_mm, polar_max_mm, polar_rms_mm,
    polar_mean_abs_mm, polar_max_abs_mm``, the same of ``normal_``, and ``samples``. By ring, the columns ``ring``
    and ``reference_ring`` take the place of the counts. Figures without data are NaN.

    Raises :class:`SettingsError` if the heights differ, or a count is not positive.
    """
    _check(measured, reference, rays, samples)
    directions = (np.arange(rays, dtype=np.float64) + 0.5) * (2.0 * math.pi / rays)

    def work(start: int, stop: int) -> list[tuple[Ints, Floats]]:
        steps = [(a, min(a + LAYERS_A_STEP, stop)) for a in range(start, stop, LAYERS_A_STEP)]
        return [_block_errors(measured, reference, a, b, directions, samples) for a, b in steps]

    blocks = [found for block in run_blocks(work, len(measured)) for found in block]
    ring, partner = np.concatenate([pairs for pairs, _ in blocks] or [np.zeros((0, 2), np.int64)]).T
    polar, normal = np.concatenate([e for _, e in blocks] or [np.zeros((0, 2, len(MEASURES)))]).swapaxes(0, 1)
    layer, outer = measured.ring_layer[ring], _orientation(measured)[ring] > 0
    defined = ~np.isnan(polar[:, 0])
    columns: dict[str, NDArray[Any]]
    if by == "ring":
        counts = np.full(ring.size, rays), np.full(ring.size, samples)
        columns = {
            "layer": layer,
            "height_mm": measured.heights[layer],
            "ring": ring,
            "reference_ring": partner,
            "outer": outer,
            "polar_defined": defined,
        }
    else:
        count = len(measured)
        pairs, outers, polars = (np.bincount(layer[of], minlength=count) for of in (..., outer, defined))
        closed = [np.bincount(s.ring_layer[s.closed], minlength=count) for s in (measured, reference)]
        polar = _layer_sums(polar[defined], layer[defined], count)
        normal = _layer_sums(normal, layer, count)
        counts = polars * rays, pairs * samples
        columns = {
            "layer": np.arange(count),
            "height_mm": measured.heights,
            "rings": pairs,
            "unmatched": closed[0] + closed[1] - 2 * pairs,
            "outer_rings": outers,
            "polar_rings": polars,
            "polar_defined": (polars == outers) & (outers > 0),
        }
    for kind, sums, places in (("polar", polar, counts[0]), ("normal", normal, counts[1])):
        low, high, squares, absolute = sums.T
        columns[f"{kind}_min_mm"], columns[f"{kind}_max_mm"] = low, high
        columns[f"{kind}_rms_mm"] = np.sqrt(squares / np.maximum(places, 1))
        columns[f"{kind}_mean_abs_mm"] = absolute / np.maximum(places, 1)
        columns[f"{kind}_max_abs_mm"] = np.maximum(np.abs(low), np.abs(high))
    return pd.DataFrame({**columns, "samples": counts[1]})


def _layer_sums(sums: Floats, layer: Ints, count: int) -> Floats:
    """:data:`MEASURES` of the rings, combined by layer; NaN for a layer without rings."""
    result = np.tile([np.inf, -np.inf, 0.0, 0.0], (count, 1))
    for column, combine in enumerate((np.minimum, np.maximum, np.add, np.add)):
        combine.at(result[:, column], layer, sums[:, column])
    result[np.bincount(layer, minlength=count) == 0] = np.nan
    return result


def error_reduction(before: pd.DataFrame, after: pd.DataFrame) -> pd.Series:
    """How much smaller the error of a whole stack became, as fractions of 1, from two tables of :func:`contour_error`.

    ``polar_range`` (greatest less least error), ``polar_max`` (greatest magnitude), ``polar_rms``, ``polar_mean_abs``, and the same
    of ``normal``; polar figures are over the rows where both are defined. NaN where there is nothing to compare, or where the
    error before was only rounding. The paper calls its reduction 34.2 % without saying of what: its range shrinks by 45.9 %, its
    greatest magnitude by 55.1 %.
    """
    if len(before) != len(after):
        raise SettingsError(f"errors of {len(before)} and {len(after)} rows: compare the same layers")
    found: dict[str, float] = {}
    for kind, weight in (("polar", "polar_rings"), ("normal", "rings")):
        both = (before[f"{kind}_rms_mm"].notna() & after[f"{kind}_rms_mm"].notna()).to_numpy()
        old, new = (_totals(table[both], kind, weight) for table in (before, after))
        for name in old:
            # Errors of 1e-9 mm are rounding of coordinates a metre from the origin.
            found[f"{kind}_{name}"] = 1.0 - new[name] / old[name] if old[name] > 1e-9 else math.nan
    return pd.Series(found, name="reduction")


def _totals(table: pd.DataFrame, kind: str, weight: str) -> dict[str, float]:
    """Figures over all rows of a table of errors; each row is weighted by the rings that it stands for."""
    if table.empty:
        return dict.fromkeys(("range", "max", "rms", "mean_abs"), math.nan)
    weights = table[weight].to_numpy(float) if weight in table else np.ones(len(table))
    low, high = table[f"{kind}_min_mm"].min(), table[f"{kind}_max_mm"].max()
    return {
        "range": float(high - low),
        "max": float(max(abs(low), abs(high))),
        "rms": float(np.sqrt(np.average(table[f"{kind}_rms_mm"].to_numpy(float) ** 2, weights=weights))),
        "mean_abs": float(np.average(table[f"{kind}_mean_abs_mm"].to_numpy(float), weights=weights)),
    }


# -- one block of layers ---------------------------------------------------------------------------


def _check(measured: Layers | Curves, reference: Layers | Curves, rays: int, samples: int) -> None:
    if len(measured) != len(reference):
        counts = f"{len(measured)} layers cannot be measured against {len(reference)}"
        raise SettingsError(f"{counts}: cut both at the same heights")
    apart = np.abs(measured.heights - reference.heights)
    if len(measured) and apart.max() > 1e-6:  # mm
        k = int(np.argmax(apart))
        raise SettingsError(
            f"layer {k + 1} lies at {measured.heights[k]:g} mm and its reference at {reference.heights[k]:g} mm: "
            "cut both at the same heights"
        )
    for name, value in (("rays", rays), ("samples", samples)):
        if value < 1:
            raise SettingsError(f"{name} {value}: give at least 1")


def _polylines(stack: Layers | Curves) -> SampledRings:
    if isinstance(stack, Curves):
        return stack.sampled_rings(CURVE_TOLERANCE_MM)
    return SampledRings(np.ascontiguousarray(stack.points), stack.ring_starts)


def _orientation(stack: Layers | Curves) -> Floats:
    """Sign of the area of each ring; 0 for open paths."""
    if isinstance(stack, Layers):
        return np.sign(stack.ring_areas)
    # The control polygon turns the way its curve does.
    return np.sign(rings.signed_areas(stack.control, stack.control_starts[stack.ring_starts], stack.closed))


def _block_errors(
    measured: Layers | Curves, reference: Layers | Curves, start: int, stop: int, theta: Floats, samples: int
) -> tuple[Ints, Floats]:
    """Pairs (n, 2) of rings of both stacks, and the :data:`MEASURES` (n, 2, 4) of their polar and normal errors."""
    ours, theirs = measured.block(start, stop), reference.block(start, stop)
    a, b = _polylines(ours), _polylines(theirs)
    boxes, others = rings.bounds(a.points, a.ring_starts), rings.bounds(b.points, b.ring_starts)
    sign = _orientation(ours)
    pairs = _pairs(boxes, others, (sign, _orientation(theirs)), (ours.layer_starts, theirs.layer_starts))
    errors = np.full((len(pairs), 2, len(MEASURES)), np.nan)
    for k, (i, j) in enumerate(pairs.tolist()):
        ring = a.points[a.ring_starts[i] : a.ring_starts[i + 1]]
        other = b.points[b.ring_starts[j] : b.ring_starts[j + 1]]
        if sign[i] > 0:
            centre = 0.5 * (other.min(axis=0) + other.max(axis=0))
            errors[k, 0] = _measures(polar_radius(ring, centre, theta) - polar_radius(other, centre, theta))
        errors[k, 1] = _measures(_normal_distances(ring, samples, other))
    return pairs + np.array([measured.layer_starts[start], reference.layer_starts[start]]), errors


def _pairs(boxes: Floats, others: Floats, signs: Sequence[Floats], starts: Sequence[Ints]) -> Ints:
    """Pairs (n, 2) of closed rings of one direction whose boxes overlap, those with the nearest boxes first."""
    found: list[tuple[int, int]] = []
    sign, other_sign = signs
    for (a, b), (c, d) in zip(*(np.column_stack([s[:-1], s[1:]]) for s in starts), strict=True):
        p, q = boxes[a:b, None], others[None, c:d]
        fits = (sign[a:b, None] != 0.0) & (sign[a:b, None] == other_sign[None, c:d])
        fits &= ~((p[..., :2] > q[..., 2:]) | (q[..., :2] > p[..., 2:])).any(axis=2)
        i, j = np.nonzero(fits)
        order = np.argsort(np.abs(boxes[a + i] - others[c + j]).max(axis=1, initial=0.0), kind="stable")
        taken, given = set[int](), set[int]()
        for one, other in zip((a + i[order]).tolist(), (c + j[order]).tolist(), strict=True):
            if one not in taken and other not in given:
                taken.add(one)
                given.add(other)
                found.append((one, other))
    return np.array(found, np.int64).reshape(-1, 2)


def _measures(errors: Floats) -> list[float]:
    """The :data:`MEASURES` of some errors; NaN if one of them is."""
    return [errors.min(), errors.max(), (errors * errors).sum(), np.abs(errors).sum()]


@kernel
def _normal_distances(ring: Floats, count: int, reference: Floats) -> Floats:
    """Signed distances (count,) of equally spaced places along a closed ring (n, 2) from a closed reference ring (m, 2)."""
    travelled = np.zeros(len(ring) + 1)
    for i in range(len(ring)):
        k = i + 1 if i + 1 < len(ring) else 0
        travelled[i + 1] = travelled[i] + math.hypot(ring[k, 0] - ring[i, 0], ring[k, 1] - ring[i, 1])
    tree = tree_over(segments_along(reference, True))
    result = np.empty(count)
    guess = i = 0
    for n in range(count):
        wanted = (n + 0.5) / count * travelled[-1]
        while i + 1 < len(ring) and travelled[i + 1] <= wanted:
            i += 1
        k = i + 1 if i + 1 < len(ring) else 0
        step, along = travelled[i + 1] - travelled[i], wanted - travelled[i]
        x = (ring[k, 0] - ring[i, 0]) / step * along + ring[i, 0]
        y = (ring[k, 1] - ring[i, 1]) / step * along + ring[i, 1]
        found = nearest(tree, x, y, guess)
        guess = found.segment
        result[n] = signed_distance(tree, x, y, found)
    return result


# -- Polar radius of a contour about a centre, by the exact crossing of ray and segment (paper, section 5.2) ---


def polar_radius(ring: ArrayLike, centre: ArrayLike, theta_rad: ArrayLike) -> Floats:
    """Distance (m,), mm, from `centre` at which a ray in each direction (m,), counter-clockwise from +x, meets a closed ring (n,
    2); NaN where a ray meets the ring never or more than once.
    """
    points = np.asarray(ring, dtype=np.float64).reshape(-1, 2)
    middle = np.asarray(centre, dtype=np.float64).reshape(-1)
    if len(points) < 3 or middle.size != 2:
        raise SettingsError(
            f"a polar radius needs a ring of at least 3 points and a centre (x, y); got {len(points)} points, {middle.size} coordinates"
        )
    theta = np.mod(np.asarray(theta_rad, dtype=np.float64).reshape(-1), 2.0 * math.pi)
    order = np.argsort(theta, kind="stable")
    theta = theta[order]
    radii = np.empty(theta.size)
    radii[order] = _radii_of(points - middle, theta, np.cos(theta), np.sin(theta))
    return radii


@kernel
def _radii_of(ring: Floats, theta: Floats, cos: Floats, sin: Floats) -> Floats:
    """Radii (m,) of a closed ring (n, 2) about the origin, on rays in sorted directions.

    A ray crosses a segment whose ends lie on different sides of its line, a point on the line counting
    as left: a ray through a vertex thus counts once.
    """
    turn = 2.0 * math.pi
    margin = 1e-9  # rad: rays this far beyond the ends are tested, too; angles are rounded, crossings are not
    radii, crossed = np.empty(len(theta)), np.zeros(len(theta), np.int64)
    px, py = ring[-1, 0], ring[-1, 1]
    begin = math.atan2(py, px)
    for i in range(len(ring)):
        qx, qy = ring[i, 0], ring[i, 1]
        end = math.atan2(qy, qx)
        low, high = min(begin, end), max(begin, end)
        if high - low > math.pi:
            low, high = high, low + turn
        wide = high - low > 3.1  # the segment passes so near to the centre that every ray is tested on it
        # The directions run from 0 to 2 pi, low from -pi to pi.
        shift = 0.0 if wide else -turn
        while shift <= turn:
            first, last = 0, len(theta)
            if not wide:
                while first < last:
                    middle = (first + last) // 2
                    if theta[middle] < low + shift - margin:
                        first = middle + 1
                    else:
                        last = middle
            for k in range(first, len(theta)):
                if not wide and theta[k] > high + shift + margin:
                    break
                c, s = cos[k], sin[k]
                if (c * py - s * px >= 0.0) != (c * qy - s * qx >= 0.0):
                    away = (px * qy - py * qx) / (c * (qy - py) - s * (qx - px))
                    if away > 0.0:
                        radii[k] = away
                        crossed[k] += 1
            shift += 4.0 * turn if wide else turn
        px, py, begin = qx, qy, end
    for k in range(len(theta)):
        if crossed[k] != 1:
            radii[k] = math.nan
    return radii
