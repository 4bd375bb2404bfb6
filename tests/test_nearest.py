"""The nearest point of a ring is the same from any guess, and that of trying all segments."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from ebamcheck.curves.nearest import boxed, nearest


@pytest.mark.parametrize("count", [1, 3, 4, 5, 33, 700])
def test_the_nearest_point_does_not_depend_on_the_guess(count):
    random = np.random.default_rng(count)
    points = np.cumsum(random.normal(size=(count + 1, 2)), axis=0)
    ring, line = boxed(points), shapely.LineString(points)
    segments = shapely.linestrings(np.stack([points[:-1], points[1:]], axis=1))
    for x, y in random.normal(0.0, 10.0, (40, 2)):
        found = [nearest(ring, x, y, int(guess)) for guess in {0, count - 1, *random.integers(0, count, 5)}]
        exact = shapely.distance(line, shapely.Point(x, y))
        for one in found:
            assert one.distance == pytest.approx(exact, abs=1e-12)
            assert shapely.distance(segments[one.segment], shapely.Point(x, y)) == pytest.approx(
                exact, abs=1e-12
            )
            place = points[one.segment] + one.t * (points[one.segment + 1] - points[one.segment])
            assert np.hypot(*(place - [x, y])) == pytest.approx(exact, abs=1e-9)


def test_a_place_on_a_vertex_is_at_no_distance_from_any_guess():
    points = np.column_stack([np.arange(50.0), np.arange(50.0) % 2])
    ring = boxed(points)
    assert {nearest(ring, 17.0, 1.0, guess).distance for guess in range(49)} == {0.0}
