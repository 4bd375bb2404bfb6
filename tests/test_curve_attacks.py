"""Data that a fit must not stumble over: uneven, degenerate, spiked, stepped."""

from __future__ import annotations

import numpy as np
import pytest
from fitted_rings import circle, one, paper_fit, raw, wavy

from ebamcheck.curves import LINE, SPLINE, fit_deviation
from ebamcheck.curves.fitting import ungated
from ebamcheck.curves.interpolation import BULGE_LIMIT
from ebamcheck.layers.stack import from_rings
from ebamcheck.settings.stages import CurveSettings


def test_uneven_points_never_make_the_curve_leave_its_chords_far() -> None:
    rng = np.random.default_rng(5)
    paths = []
    for _ in range(400):
        turns = np.deg2rad(rng.uniform(-39.9, 39.9, 30))
        chords = 10.0 ** rng.uniform(-3, 2, 30)
        heading = np.cumsum(turns)
        paths.append(np.cumsum(chords[:, None] * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0))
    # The interpolation by itself: paths that cross themselves, as these do, are polylines of a whole fit.
    settings = CurveSettings(near_point_mm=0, collinear_mm=0, largest_bulge_mm=1e6)
    spans = ungated("paper", from_rings([0.0], [[]], [paths]), settings, None).bezier_spans()
    B = spans.points[spans.kind == SPLINE]
    chord = B[:, 3] - B[:, 0]
    length = np.hypot(*chord.T)
    assert len(B) > 5000
    for t in np.linspace(0, 1, 33)[1:-1]:
        at = (
            (1 - t) ** 3 * B[:, 0]
            + 3 * (1 - t) ** 2 * t * B[:, 1]
            + 3 * (1 - t) * t**2 * B[:, 2]
            + t**3 * B[:, 3]
        )
        f = np.clip(((at - B[:, 0]) * chord).sum(axis=1) / length**2, 0, 1)
        off = np.hypot(*(at - B[:, 0] - f[:, None] * chord).T)
        assert (off / length).max() < BULGE_LIMIT


@pytest.mark.in_turn(3)
@pytest.mark.parametrize(
    "ring",
    [
        [(0, 0), (1, 0), (0, 1)],
        [(0, 0), (10, 0), (10, 1e-9)],
        [(0, 0), (1e-5, 0), (1e-5, 1e-5), (0, 1e-5)],
        [(0, 0), (10, 0), (20, 1e-7), (10, 2e-7)],
        [(0, 0), (10, 0), (4, 1e-6), (12, 2e-6), (0, 5)],
        1e-4 * circle(50, 1.0),
        1e6 + circle(50, 1.0),
        np.repeat(circle(30), 3, axis=0) + np.tile([[0.0], [1e-10], [-1e-10]], (30, 1)),
    ],
    ids=["triangle", "sliver", "tiny", "flat", "spike", "tiny circle", "far", "triples"],
)
@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("angle", [140.0, 1.0, 179.0])
def test_degenerate_rings_give_finite_curves_that_end_where_they_should(
    ring: object, closed: bool, angle: float
) -> None:
    ring = np.asarray(ring, float)
    layers = raw(ring, closed)
    curves = paper_fit(layers, corner_angle_deg=angle)
    assert curves.closed.size == 1
    assert curves.kind.size >= 1
    assert np.isfinite(curves.control).all()
    assert np.isfinite(curves.lengths()).all()
    if not closed:
        assert np.array_equal(curves.control[0], ring[0])
        assert np.array_equal(curves.control[-1], ring[-1])
    if angle < 179:
        return
    low, high = ring.min(axis=0), ring.max(axis=0)
    room = 0.6 * np.hypot(*(high - low)) + 1e-12
    assert np.all(curves.control >= low - room)
    assert np.all(curves.control <= high + room)


@pytest.mark.parametrize(("points", "pieces"), [(0, 0), (1, 0), (2, 1)])
def test_rings_of_too_few_points_are_lines_or_nothing(points: int, pieces: int) -> None:
    ring = np.array([(0.0, 0.0), (3.0, 4.0)])[:points]
    for closed in (True, False):
        curves = paper_fit(raw(ring, closed))
        assert curves.kind.tolist() == [LINE] * pieces
        assert curves.lengths().sum() == (0 if points < 2 else (10 if closed else 5))
        assert fit_deviation(curves, raw(ring, closed))["points_mm"].max() == 0


def test_a_spike_is_kept() -> None:
    spike = [(0, 0), (10, 0), (10, 10), (5, 10), (5, 18), (5, 10.0005), (0, 10)]
    curves = one(spike)
    assert np.hypot(*(curves.control - [5, 18]).T).min() == 0


def test_cleaning_does_not_drift_along_a_slow_bend() -> None:
    fine = circle(40_000, 100.0)
    layers = from_rings([0.0], [[fine]])
    curves = paper_fit(layers)
    assert curves.block_count() < 1000
    assert fit_deviation(curves, layers)["points_mm"].max() < 0.0011
    assert np.abs(np.hypot(*curves.sample(0.1).points.T) - 100).max() < 0.0011


def test_near_points_become_one() -> None:
    ring = np.repeat(wavy(), 2, axis=0)
    ring[1::2] += 0.0004
    assert one(ring).block_count() == 90
    assert one(ring, near_point_mm=0.0, collinear_mm=0.0).block_count() == 180


def test_stairs_from_pixels_come_back_as_they_are_or_smooth_on_request() -> None:
    pixel = 0.1
    y, x = np.mgrid[-120:121, -120:121] * pixel
    from skimage.measure import find_contours

    (found,) = find_contours((np.hypot(x, y) <= 10.0).astype(float), 0.5)
    layers = from_rings([0.0], [[((found[:-1] - 120) * pixel)[:, ::-1]]])
    as_is = paper_fit(layers)
    assert fit_deviation(as_is, layers)["points_mm"].max() < 0.0011
    assert fit_deviation(as_is, layers)["bulge_mm"].max() < pixel
    smooth = paper_fit(layers, collinear_mm=pixel)
    assert smooth.block_count() < as_is.block_count() / 5
    assert np.abs(np.hypot(*smooth.sample(0.05).points.T) - 10.0).max() < 2 * pixel


def test_inner_points_of_the_flats_of_a_cylinder_do_not_make_it_straight() -> None:
    """The section of a cylinder's mesh has a point on each chord, where it cuts a facet's diagonal."""
    corners = circle(36)
    inner = corners + 0.3 * (np.roll(corners, -1, axis=0) - corners)
    curves = one(np.stack([corners, inner], axis=1).reshape(-1, 2))
    assert curves.kind.tolist() == [SPLINE]
    assert curves.block_count() == 36
    assert np.abs(np.hypot(*curves.sample(0.1).points.T) - 20).max() < 1e-4
