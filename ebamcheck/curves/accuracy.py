"""Error of contours against a reference: polar radius (paper, section 5.2) and true normal distance."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ebamcheck.curves.columns import Curves, SampledRings
from ebamcheck.errors import SettingsError
from ebamcheck.geometry import rings
from ebamcheck.geometry.nearest import nearest, segments_along, signed_distance, tree_over
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.layers.stack import Layers
from ebamcheck.threads import run_blocks

RAYS = 3600  # Rays per ring: one every tenth of a degree
SAMPLES = 4000  # Places per ring at which the normal distance is taken, equally spaced along it
CURVE_TOLERANCE_MM = 1e-5
"""Chord error of the polylines as which curves are measured: far below any error that matters."""

NO_ERROR_MM = 1e-9
"""Errors below this are rounding of coordinates a metre from the origin: there is nothing to reduce."""

SAME_HEIGHT_MM = 1e-6  # Layers of two stacks belong together if their heights differ by no more than this
LAYERS_A_STEP = 32  # Layers sampled at a time; bounds the working memory

MEASURES = ("min", "max", "sum", "squares", "absolute")
"""Statistics kept of the error along one ring: enough to compute every figure of a layer."""


class RingErrors(NamedTuple):
    """Errors of pairs of rings."""

    measured: Ints  # (n,) ring of the measured stack
    reference: Ints  # (n,) ring of the reference that it is paired with
    polar: Floats  # (n, 5) MEASURES of the polar error; NaN where it is not defined
    normal: Floats  # (n, 5) MEASURES of the normal distance


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

    Parameters
    ----------
    measured
        What is judged.
    reference
        A far finer tessellation of the same part, or an analytic model, cut at the same heights.
    rays, samples
        Directions and places per ring.
    by
        One row per layer, or one row per pair of rings.

    Returns
    -------
    DataFrame with the columns ``layer, height_mm, rings`` (pairs), ``unmatched`` (closed rings of
    either side without a partner), ``outer_rings, polar_rings`` (outer pairs, and those with a polar
    error), ``polar_defined`` (all of them), ``polar_min_mm, polar_max_mm, polar_rms_mm,
    polar_mean_abs_mm, polar_max_abs_mm``, the same of ``normal_``, and ``samples``. By ring, the columns ``ring``
    and ``reference_ring`` take the place of the counts. Figures without data are NaN.

    Raises
    ------
    SettingsError
        If the heights differ, or a count is not positive.
    """
    _check(measured, reference, rays, samples)
    beams = (np.arange(rays, dtype=np.float64) + 0.5) * (2.0 * math.pi / rays)

    def work(start: int, stop: int) -> list[RingErrors]:
        steps = range(start, stop, LAYERS_A_STEP)
        return [
            _block_errors(measured, reference, a, min(a + LAYERS_A_STEP, stop), beams, samples) for a in steps
        ]

    blocks = [errors for block in run_blocks(work, len(measured)) for errors in block]
    if blocks:
        errors = RingErrors(*(np.concatenate(columns) for columns in zip(*blocks, strict=True)))
    else:
        none = np.zeros(0, np.int64)
        errors = RingErrors(none, none, np.zeros((0, len(MEASURES))), np.zeros((0, len(MEASURES))))
    layer = measured.ring_layer[errors.measured]
    outer = _orientation(measured)[errors.measured] > 0
    if by == "ring":
        return _by_ring(measured, errors, layer, outer, rays, samples)
    return _by_layer(measured, reference, errors, layer, outer, rays, samples)


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
            found[f"{kind}_{name}"] = 1.0 - new[name] / old[name] if old[name] > NO_ERROR_MM else math.nan
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


# -- tables ----------------------------------------------------------------------------------------


def _by_ring(
    measured: Layers | Curves, errors: RingErrors, layer: Ints, outer: Bools, rays: int, samples: int
) -> pd.DataFrame:
    table = pd.DataFrame(
        {
            "layer": layer,
            "height_mm": measured.heights[layer],
            "ring": errors.measured,
            "reference_ring": errors.reference,
            "outer": outer,
            "polar_defined": ~np.isnan(errors.polar[:, 0]),
        }
    )
    for kind, sums, count in (("polar", errors.polar, rays), ("normal", errors.normal, samples)):
        _add_figures(table, kind, sums, np.full(len(table), count))
    table["samples"] = samples
    return table


def _by_layer(
    measured: Layers | Curves,
    reference: Layers | Curves,
    errors: RingErrors,
    layer: Ints,
    outer: Bools,
    rays: int,
    samples: int,
) -> pd.DataFrame:
    count = len(measured)
    defined = ~np.isnan(errors.polar[:, 0])
    pairs = np.bincount(layer, minlength=count)
    outers = np.bincount(layer[outer], minlength=count)
    polars = np.bincount(layer[defined], minlength=count)
    closed = sum(
        np.bincount(stack.ring_layer[stack.closed], minlength=count) for stack in (measured, reference)
    )
    table = pd.DataFrame(
        {
            "layer": np.arange(count),
            "height_mm": measured.heights,
            "rings": pairs,
            "unmatched": closed - 2 * pairs,
            "outer_rings": outers,
            "polar_rings": polars,
            "polar_defined": (polars == outers) & (outers > 0),
        }
    )
    _add_figures(table, "polar", _layer_sums(errors.polar[defined], layer[defined], count), polars * rays)
    _add_figures(table, "normal", _layer_sums(errors.normal, layer, count), pairs * samples)
    table["samples"] = pairs * samples
    return table


def _layer_sums(sums: Floats, layer: Ints, count: int) -> Floats:
    """:data:`MEASURES` of the rings, combined by layer; NaN for a layer without rings."""
    result = np.zeros((count, len(MEASURES)))
    result[:, 0], result[:, 1] = np.inf, -np.inf
    np.minimum.at(result[:, 0], layer, sums[:, 0])
    np.maximum.at(result[:, 1], layer, sums[:, 1])
    for column in range(2, len(MEASURES)):
        result[:, column] = np.bincount(layer, sums[:, column], minlength=count)
    result[np.bincount(layer, minlength=count) == 0] = np.nan
    return result


def _add_figures(table: pd.DataFrame, kind: str, sums: Floats, counts: Ints) -> None:
    divisor = np.maximum(counts, 1)
    table[f"{kind}_min_mm"] = sums[:, 0]
    table[f"{kind}_max_mm"] = sums[:, 1]
    table[f"{kind}_rms_mm"] = np.sqrt(sums[:, 3] / divisor)
    table[f"{kind}_mean_abs_mm"] = sums[:, 4] / divisor
    table[f"{kind}_max_abs_mm"] = np.maximum(np.abs(sums[:, 0]), np.abs(sums[:, 1]))


# -- one block of layers ---------------------------------------------------------------------------


def _check(measured: Layers | Curves, reference: Layers | Curves, rays: int, samples: int) -> None:
    if len(measured) != len(reference):
        raise SettingsError(
            f"{len(measured)} layers cannot be measured against {len(reference)}: cut both at the same heights"
        )
    apart = np.abs(measured.heights - reference.heights)
    if len(measured) and apart.max() > SAME_HEIGHT_MM:
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
    ends = SampledRings(
        stack.control, stack.control_starts[stack.ring_starts]
    )  # the control polygon turns the way its curve does
    return np.sign(rings.signed_areas(ends.points, ends.ring_starts, stack.closed))


def _block_errors(
    measured: Layers | Curves, reference: Layers | Curves, start: int, stop: int, theta: Floats, samples: int
) -> RingErrors:
    ours, theirs = measured.block(start, stop), reference.block(start, stop)
    a, b = _polylines(ours), _polylines(theirs)
    mine, partner = _pairs(
        rings.bounds(a.points, a.ring_starts),
        rings.bounds(b.points, b.ring_starts),
        _orientation(ours),
        _orientation(theirs),
        ours.layer_starts,
        theirs.layer_starts,
    )
    polar, normal = np.full((2, mine.size, len(MEASURES)), np.nan)
    outer = _orientation(ours) > 0
    for k, (i, j) in enumerate(zip(mine.tolist(), partner.tolist(), strict=True)):
        ring = a.points[a.ring_starts[i] : a.ring_starts[i + 1]]
        other = b.points[b.ring_starts[j] : b.ring_starts[j + 1]]
        if outer[i]:
            centre = 0.5 * (other.min(axis=0) + other.max(axis=0))
            polar[k] = _measures(_ray_radii(ring, centre, theta) - _ray_radii(other, centre, theta))
        normal[k] = _measures(_normal_distances(ring, samples, other))
    return RingErrors(
        mine + measured.layer_starts[start], partner + reference.layer_starts[start], polar, normal
    )


def _pairs(
    boxes: Floats, others: Floats, sign: Floats, other_sign: Floats, layer_starts: Ints, other_starts: Ints
) -> tuple[Ints, Ints]:
    """Pair closed rings of one direction whose boxes overlap, those with the nearest boxes first."""
    found: list[tuple[int, int]] = []
    for a, b, c, d in zip(
        layer_starts[:-1], layer_starts[1:], other_starts[:-1], other_starts[1:], strict=True
    ):
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
    rows = np.array(found, np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def _measures(errors: Floats) -> list[float]:
    """The :data:`MEASURES` of some errors; NaN if one of them is."""
    return [errors.min(), errors.max(), errors.sum(), (errors * errors).sum(), np.abs(errors).sum()]


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


NEARLY_HALF_TURN_RAD = 3.1
"""A segment that spans a larger angle passes so near to the centre that every ray is tested on it."""

ANGLE_MARGIN_RAD = 1e-9
"""Rays this far beyond the ends of a segment are tested too: angles are rounded, crossings are not."""


def polar_radius(ring: ArrayLike, centre: ArrayLike, theta_rad: ArrayLike) -> Floats:
    """Distance (m,), mm, from `centre` at which a ray in each direction (m,), counter-clockwise from +x, meets a closed ring (n,
    2).

    NaN where a ray meets the ring never or more than once.
    """
    points = np.asarray(ring, dtype=np.float64).reshape(-1, 2)
    middle = np.asarray(centre, dtype=np.float64).reshape(-1)
    if len(points) < 3 or middle.size != 2:
        raise SettingsError(
            f"a polar radius needs a ring of at least 3 points and a centre (x, y); got {len(points)} points, {middle.size} coordinates"
        )
    theta = np.mod(np.asarray(theta_rad, dtype=np.float64).reshape(-1), 2.0 * math.pi)
    order = np.argsort(theta, kind="stable")
    radii = np.empty(theta.size)
    radii[order] = _ray_radii(points, middle, theta[order])
    return radii


def _ray_radii(ring: Floats, centre: Floats, theta: Floats) -> Floats:
    """As :func:`polar_radius`, in sorted directions (m,), 0 .. 2 pi."""
    return _radii_of(ring - centre, theta, np.cos(theta), np.sin(theta))


@kernel
def _radii_of(ring: Floats, theta: Floats, cos: Floats, sin: Floats) -> Floats:
    """Radii (m,) of a closed ring (n, 2) about the origin, on rays in sorted directions.

    A ray crosses a segment whose ends lie on different sides of its line, a point on the line counting
    as left: a ray through a vertex thus counts once.
    """
    turn = 2.0 * math.pi
    radii, crossed = np.empty(len(theta)), np.zeros(len(theta), np.int64)
    px, py = ring[-1, 0], ring[-1, 1]
    begin = math.atan2(py, px)
    for i in range(len(ring)):
        qx, qy = ring[i, 0], ring[i, 1]
        end = math.atan2(qy, qx)
        low, high = min(begin, end), max(begin, end)
        if high - low > math.pi:
            low, high = high, low + turn
        wide = high - low > NEARLY_HALF_TURN_RAD
        # The directions run from 0 to 2 pi, low from -pi to pi.
        shift = 0.0 if wide else -turn
        while shift <= turn:
            first, last = 0, len(theta)
            if not wide:
                while first < last:
                    middle = (first + last) // 2
                    if theta[middle] < low + shift - ANGLE_MARGIN_RAD:
                        first = middle + 1
                    else:
                        last = middle
            for k in range(first, len(theta)):
                if not wide and theta[k] > high + shift + ANGLE_MARGIN_RAD:
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
