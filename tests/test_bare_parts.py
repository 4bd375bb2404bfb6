"""Bare parts between beads: cut out where samples are bare, they are what the union of all beads leaves."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from ebamcheck.program.checking.bare_parts import bare_parts

WIDTH_MM = 6.0
REGION = shapely.box(0.0, 0.0, 120.0, 80.0).difference(shapely.Point(70.0, 40.0).buffer(9.0))


def lines_without(*missing):
    """Hatch lines 5 mm apart over the region, some left out."""
    y = np.array([2.0 + 5.0 * n for n in range(17) if n not in missing])
    return np.column_stack([np.zeros(y.size), y, np.full(y.size, 120.0), y])


def diameter_mm(part):
    return 2.0 * float(shapely.length(shapely.maximum_inscribed_circle(part, tolerance=1e-4)))


def union_of_all(segments):
    beads = shapely.buffer(shapely.linestrings(segments.reshape(-1, 2, 2)), 0.5 * WIDTH_MM)
    return shapely.get_parts(REGION.difference(shapely.union_all(beads)))


@pytest.mark.parametrize("missing", [(5,), (2, 3), (4, 9, 10, 11)])
def test_the_widest_spot_is_that_of_the_union_of_all_beads(missing):
    segments = lines_without(*missing)
    found = [diameter_mm(part) for part in bare_parts(REGION, segments, WIDTH_MM)]
    assert max(found) == pytest.approx(max(map(diameter_mm, union_of_all(segments))), abs=1e-3)
    assert max(found) > 3.9


def test_the_area_of_spots_is_that_of_the_union_of_all_beads():
    random = np.random.default_rng(3)
    segments = lines_without() + random.normal(0.0, 0.8, (17, 4))
    wanted = [part for part in union_of_all(segments) if diameter_mm(part) > 0.5]
    found = shapely.union_all(list(bare_parts(REGION, segments, WIDTH_MM)))
    assert len(wanted) >= 3
    assert all(shapely.covers(shapely.buffer(found, 1e-6), part.representative_point()) for part in wanted)
    assert found.area == pytest.approx(sum(part.area for part in union_of_all(segments)), rel=0.02)


def test_what_is_narrower_than_asked_for_is_not_cut_out():
    segments, asked = lines_without(5, 10, 11), [0.0]
    widths = []
    for part in bare_parts(REGION, segments, WIDTH_MM, lambda: asked[0]):
        widths.append(diameter_mm(part))
        asked[0] = max(widths)
    every = sorted(diameter_mm(part) for part in bare_parts(REGION, segments, WIDTH_MM))
    assert max(widths) == every[-1]
    assert len(widths) < len(every)


def test_beads_that_leave_nothing_leave_no_part():
    assert not list(bare_parts(REGION, lines_without(), WIDTH_MM))
