"""Beads that cross: each goes on beyond the pool of the other, whatever their direction; one that ends in it does not cross it."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from shapely import affinity

from ebamcheck.checks.bead_checks import _runs_across
from ebamcheck.scan.filling.schedule import follows

POOL_MM = 3.0
ALONG = shapely.LineString([(-20, 0), (20, 0)])


@pytest.mark.parametrize("turn_deg", [0.0, 33.0, 90.0])
@pytest.mark.parametrize(("beyond_mm", "crosses"), [(0.1, False), (2.9, False), (3.1, True), (15.0, True)])
def test_a_bead_crosses_another_only_beyond_its_pool(beyond_mm, crosses, turn_deg):
    ends = shapely.LineString([(0, 15), (0, -beyond_mm)])
    one, other = (affinity.rotate(line, turn_deg, origin=(5, 7)) for line in (ALONG, ends))
    assert _runs_across(one, other, POOL_MM) == crosses
    assert _runs_across(other, one, POOL_MM) == crosses


def test_a_corner_in_the_pool_of_another_bead_crosses_it_no_time():
    corner = shapely.LineString([(-10, 12), (0, -0.6), (10, 12)])
    assert not _runs_across(ALONG, corner, POOL_MM)
    assert _runs_across(ALONG, affinity.translate(corner, 0, -6), POOL_MM)


def test_short_chords_of_a_bead_do_not_hide_its_crossing():
    wavy = shapely.LineString(np.column_stack([0.1 * np.sin(np.arange(41)), np.linspace(10, -10, 41)]))
    assert _runs_across(ALONG, wavy, POOL_MM)


@pytest.mark.parametrize(("away_deg", "joined"), [(0.0, False), (15.0, False), (26.0, True), (90.0, True)])
def test_a_turn_that_goes_back_on_the_line_before_is_none(away_deg, joined):
    turn = 5.0 * np.array([-np.cos(np.radians(away_deg)), np.sin(np.radians(away_deg))])
    begin = np.array([20.0, 0.0]) + turn
    start, end = np.array([[0.0, 0.0], begin]), np.array([[20.0, 0.0], begin + np.array([0.0, 10.0])])
    assert follows(np.zeros(2, np.int64), start, end, 4.32).tolist() == [False, joined]


@pytest.mark.parametrize(("beside_mm", "joined"), [(0.3, False), (-0.9, False), (1.2, True), (-2.0, True)])
@pytest.mark.parametrize("driven", [1, -1])
def test_a_turn_leads_over_no_line_of_its_island(driven, beside_mm, joined):
    turn = np.array([[0.0, -5.0], [0.0, 0.0]]), np.array([[6.0, 1.0], [9.0, 8.0]])
    along = np.array([[3.5 + beside_mm, 9.0 - beside_mm], [2.5 + beside_mm, -9.0 - beside_mm]])
    start, end = np.array([turn[0][0], turn[1][0], along[0]]), np.array([turn[0][1], turn[1][1], along[1]])
    if driven < 0:
        start, end = end[::-1], start[::-1]
    on = follows(np.zeros(3, np.int64), start, end, 4.32)
    assert on[1 if driven > 0 else 2] == joined
