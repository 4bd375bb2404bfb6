"""What makes the heat of a plan fast leaves it what it is: exponentials, sums over tiles, columns after waits, weights."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from ebamcheck.heat.balance import HeatColumn, LayerShape
from ebamcheck.heat.field import LEAST, falling
from ebamcheck.heat.modes import section_grid
from ebamcheck.heat.near_field import FAR, between_pieces
from ebamcheck.heat.part_heat import AgedColumns, PartHeat
from ebamcheck.settings.config import Config


def test_a_falling_power_of_e_is_that_of_the_library():
    exponents = np.concatenate([-np.geomspace(1e-12, -LEAST, 500), [0.0]])
    found = np.array([falling(float(x)) for x in exponents])
    assert found == pytest.approx(np.exp(exponents), rel=1e-12, abs=1e-15)
    assert falling(-1e300) == falling(-np.inf) == pytest.approx(np.exp(LEAST), rel=1e-9)


def test_heat_between_islands_is_the_plain_sum_over_their_tiles():
    random = np.random.default_rng(1)
    first = np.array([0, 7, 7 + 12, 7 + 12 + 5])
    place, share = random.uniform(0.0, 40.0, (24, 2)), random.uniform(0.1, 1.0, 24)
    variance, spread = random.uniform(0.5, 2.0, 24), np.array([0.0, 3.0, 40.0])
    pairs = np.array([[0, 0], [0, 1], [1, 2]])
    found = between_pieces(first, place, share, variance, pairs, spread)
    for (one, other), row in zip(pairs, found, strict=True):
        a, b = np.arange(first[one], first[one + 1])[:, None], np.arange(first[other], first[other + 1])
        away = ((place[a] - place[b]) ** 2).sum(axis=-1)[..., None]
        wide = (variance[a] + variance[b])[..., None] + spread
        dense = np.where(away > FAR * wide, 0.0, np.exp(-0.5 * away / wide) / (2.0 * np.pi * wide))
        assert row == pytest.approx(((share[a] * share[b])[..., None] * dense).sum(axis=(0, 1)), rel=1e-12)


def test_a_column_after_a_wait_is_worked_out_once_and_is_the_one_waited_for():
    part, plain = (PartHeat(HeatColumn(Config())) for _ in range(2))
    for each in (part, plain):
        each.column.lay(LayerShape(2.0, 900.0, 120.0))
        each.column.advance(20.0, 8e4)
    aged = AgedColumns(part.column)
    assert aged.after(7.5) is aged.after(7.5)
    assert aged.after(0.0) is part.column
    found_k = part.bed_k(np.zeros(0), 7.5, None, aged)
    part.rest(7.5, aged)
    plain.rest(7.5)
    assert part.column.content.tobytes() == plain.column.content.tobytes()
    assert found_k == plain.bed_k(np.zeros(0)) < aged.after(0.0).bed_k
    assert part.column.radiated_j == plain.column.radiated_j


def test_weights_of_cells_are_those_of_the_products_along_both_axes():
    section = shapely.Point(0.0, 0.0).buffer(30.0).difference(shapely.Point(9.0, 0.0).buffer(6.0))
    grid = section_grid([section], 2.0)
    points = np.random.default_rng(2).uniform(-33.0, 33.0, (300, 2))
    table = grid.interpolation(points).toarray()
    some = table.sum(axis=1)
    assert set(np.round(some, 12)) == {0.0, 1.0}
    seen = {4: 0, 16: 0}
    for point, row in zip(points, table, strict=True):
        at = (point - grid.origin) / grid.step - 0.5
        corner = np.floor(at).astype(int)
        wanted = np.zeros_like(row)
        for reach in ((-1, 0, 1, 2), (0, 1)):
            cells = {}
            for dx in reach:
                for dy in reach:
                    x, y = int(corner[0]) + dx, int(corner[1]) + dy
                    if (
                        0 <= y < grid.number.shape[0]
                        and 0 <= x < grid.number.shape[1]
                        and grid.number[y, x] >= 0
                    ):
                        cells[int(grid.number[y, x])] = _weight(at - corner, dx, reach, 0) * _weight(
                            at - corner, dy, reach, 1
                        )
            if len(cells) == len(reach) ** 2 or len(reach) == 2:
                total = sum(cells.values())
                for cell, weight in cells.items():
                    wanted[cell] = weight / total if total > 0.0 else 0.0
                seen[len(reach) ** 2] += bool(cells)
                break
        assert row == pytest.approx(wanted, abs=1e-12)
    assert min(seen.values()) > 20


def _weight(share, node, nodes, axis):
    """Lagrange's polynomial of a node at a share of the middle interval."""
    return float(np.prod([(share[axis] - other) / (node - other) for other in nodes if other != node]))
