"""Sweeps and percentiles against plain ways to the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from test_comparison_kernels import circle, lattice_rings, layer

from ebamcheck.comparison import depth as status
from ebamcheck.comparison.hausdorff import PERCENTILE, _percentile
from ebamcheck.comparison.outline import outline
from ebamcheck.comparison.sweep import overlap

ORIGIN = (0.0, 0.0)


def halved(distances, lengths):
    """Percentile by halving a bracket, all sums from the first piece to the last: (distance, how often a sum was as wanted)."""
    pieces = [
        (min(a, b), max(a, b), w)
        for a, b, w in zip(distances, distances[1:], lengths, strict=False)
        if w >= 0.0
    ]
    total = 0.0
    for _, _, w in pieces:
        total += w
    wanted = PERCENTILE * total
    bottom, top = min(p[0] for p in pieces), max(p[1] for p in pieces)
    below, rate, met = 0.0, 0.0, 0

    def settled():
        nonlocal pieces, below, rate
        under, rise, left = 0.0, 0.0, []
        for low, high, w in pieces:
            if high <= bottom:
                under += w
            elif low <= bottom and high >= top:
                slope = w / (high - low)
                under += slope * (bottom - low)
                rise += slope
            elif low < top:
                left.append((low, high, w))
        below, rate, pieces = below + under, rate + rise, left

    settled()
    if below >= wanted:
        return bottom, met
    while pieces:
        middle = 0.5 * (bottom + top)
        if not bottom < middle < top:
            return top, met
        under = below + rate * (middle - bottom)
        for low, high, w in pieces:
            if high <= middle:
                under += w
            elif low < middle:
                under += w * (middle - low) / (high - low)
        met += under == wanted
        if under >= wanted:
            top = middle
        else:
            below += rate * (middle - bottom)
            bottom = middle
        settled()
    return (min(bottom + (wanted - below) / rate, top) if rate > 0.0 else top), met


def percentile(distances, lengths):
    return _percentile(distances, lengths, distances.min(), distances.max())


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("seed", range(80))
def test_a_percentile_has_the_bits_of_sums_in_one_order(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 400))
    distances = rng.exponential(size=count) ** rng.integers(1, 6)
    if seed % 4 == 0:
        # So pieces stay at a distance that is the middle of a bracket.
        distances = np.minimum(np.round(distances * 8.0), 8.0) / 8.0
        distances[:2] = 0.0, 1.0
    lengths = rng.exponential(size=count)
    lengths[rng.random(count) < 0.05] = -1.0
    lengths[0], lengths[-1] = 1.0, -1.0
    assert percentile(distances, lengths) == halved(distances, lengths)[0]


def test_a_piece_that_is_as_far_as_the_middle_of_a_bracket_does_not_exceed_it():
    distances = np.array([0.0, 0.25, 0.5, 0.5, 1.0, 1.0])
    lengths = np.array([0.9, 0.04, 0.03, 0.01, 0.02, -1.0])
    assert percentile(distances, lengths) == halved(distances, lengths)[0] == 0.5


@pytest.mark.parametrize("length", [1.0, 0.1, 1 / 3])
def test_a_percentile_between_sums_that_are_as_wanted_has_the_same_bits(length):
    # 19 of 20 pieces of one length lie below the first middle: to the last bit as much as is wanted, or not quite.
    distances = np.concatenate([np.linspace(0.0, 0.25, 20), [1.0, 1.0]])
    lengths = np.full(22, length)
    lengths[19], lengths[-1] = -1.0, -1.0
    found, met = halved(distances, lengths)
    assert percentile(distances, lengths) == found
    if length == 1.0:
        assert met > 0


@pytest.mark.in_turn(3, 1)
@pytest.mark.parametrize("seed", range(30))
def test_trapezoids_written_down_change_no_area_and_add_up_to_the_difference(seed):
    rng = np.random.default_rng(seed)
    if seed % 2:
        pair = layer(*lattice_rings(rng)), layer(*lattice_rings(rng))
    else:
        # So many crossings that room is made anew in the middle of levels.
        pair = layer(circle(10.0, 500)), layer(circle(10.0, 500, phase=rng.uniform(0.001, 0.01)))
    a, b = (outline(x, 0, ORIGIN) for x in pair)
    plain, written = overlap(a, b, False), overlap(a, b, True)
    assert plain[:3] == written[:3]
    assert len(plain.difference) == 0
    t = written.difference
    widths = (t[:, status.R0] - t[:, status.L0]) + (t[:, status.R1] - t[:, status.L1])
    areas = np.maximum(0.5 * widths * (t[:, status.Y1] - t[:, status.Y0]), 0.0)
    assert areas.sum() == pytest.approx(written.symmetric_difference_mm2, rel=1e-12, abs=1e-12)
    if seed % 2 == 0:
        assert len(t) > 500


def test_a_sweep_over_nothing_and_something_finds_the_area_of_that():
    nothing, ring = outline(layer(), 0, ORIGIN), outline(layer(circle(2.0, 60)), 0, ORIGIN)
    area = overlap(ring, ring, False).area_a_mm2
    assert overlap(nothing, ring, True)[:3] == (0.0, area, area)
    assert overlap(ring, nothing, True)[:3] == (area, 0.0, area)
    assert overlap(nothing, nothing, True)[:3] == (0.0, 0.0, 0.0)
