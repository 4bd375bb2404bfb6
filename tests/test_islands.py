"""Islands of a partition: laws over sections of every sort at any place of the lattice, and hatches that part."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from section_zoo import ZOO, crooked
from shapely import affinity

from ebamcheck.geometry.regions import equivalent_rectangles_mm
from ebamcheck.scan import plan_scan
from ebamcheck.scan.filling.hatch import hatch
from ebamcheck.scan.islands.clipping import (
    Cells,
    clip_lattice,
    column,
    hatch_directions,
    least_island_mm,
    least_turn_deg,
    partition,
    polygon_edges,
    shared_borders,
    shared_edges,
    sliver_groups,
    turn_between_deg,
)
from ebamcheck.scan.islands.lattice import LATTICES, long_direction_rad, rectangle_along
from ebamcheck.scan.islands.regions import layer_regions
from ebamcheck.settings.config import Config

PROFILE = Config()
WIDTH, SPACING = PROFILE.process.bead_width_mm, PROFILE.process.hatch_spacing_mm
SOLIDS = {name: layer_regions(section, PROFILE).solids for name, section in ZOO.items()}
SOLIDS = {name: solids for name, solids in SOLIDS.items() if solids}
KINDS = st.sampled_from(sorted(LATTICES))
SIDES, TURNS = st.floats(5.0, 40.0), st.floats(0.0, 2.0 * math.pi)


def laid_over(solids, kind, side, turn):
    return LATTICES[kind](rectangle_along(shapely.get_coordinates(solids), turn), side)


def check_laws(solids, kind, side, turn):
    lattice = laid_over(solids, kind, side, turn)
    islands = partition(solids, lattice, WIDTH, SPACING).polygons
    assert set(shapely.get_type_id(islands)) == {shapely.GeometryType.POLYGON}
    assert shapely.is_valid(islands).all()
    solid = shapely.area(solids)
    assert shapely.area(islands).sum() == pytest.approx(solid.sum(), rel=1e-9)
    assert shapely.union_all(islands).area == pytest.approx(solid.sum(), rel=1e-9), "none lies on another"
    inside = shapely.area(shapely.intersection(islands[:, None], column(solids))).sum(axis=0)
    assert inside == pytest.approx(solid, rel=1e-9), "each solid is divided, and nothing beside it"
    least_mm2, least_mm = least_island_mm(lattice, WIDTH, SPACING)
    width, _ = equivalent_rectangles_mm(islands)
    for n in np.flatnonzero((shapely.area(islands) < least_mm2) | (width < least_mm * (1.0 - 1e-9))):
        assert np.abs(solid - islands[n].area).min() < 1e-9 * solid.sum(), "but a whole solid"


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("name", SOLIDS)
@settings(deadline=None, max_examples=6)
@given(KINDS, SIDES, TURNS)
@example("hexagons", 5.0, 5e-324)
def test_islands_of_every_section_are_its_solids_and_none_is_a_sliver(name, kind, side, turn):
    check_laws(SOLIDS[name], kind, side, turn)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6), KINDS, SIDES, TURNS)
def test_islands_of_crooked_sections_are_their_solids_and_none_is_a_sliver(seed, kind, side, turn):
    solids = layer_regions(crooked(seed), PROFILE).solids
    if solids:
        check_laws(solids, kind, side, turn)


@settings(deadline=None, max_examples=20)
@given(st.sampled_from(["squares", "hexagons"]), st.floats(-1e-12, 1e-12), st.integers(0, 40))
@example("squares", 0.0, 0)
def test_borders_that_lie_on_the_lattice_leave_no_hairs(kind, off, steps):
    """A border along the sides of cells, and within rounding of them, is where cuts one by one leave hairs."""
    side = 12.0 / math.sqrt(3.0)
    box = shapely.box(0.0, 0.0, 120.0, 12.0 * 15 + off)
    hole = shapely.box(24.0 + off, 12.0 * (steps % 10 + 1), 60.0, 12.0 * (steps % 10 + 3) + off)
    for turn in (0.0, 0.3):
        solid = affinity.rotate(box.difference(hole), turn, (0, 0), use_radians=True)
        check_laws([solid], kind, side, turn)


def test_parts_of_cells_share_their_borders_to_the_last_bit():
    solids = SOLIDS["plate with 54 holes"]
    pieces, cell = clip_lattice(solids, laid_over(solids, "hexagons", 11.0, 0.37))
    assert (np.diff(cell) >= 0).all()
    edges, _ = polygon_edges(pieces)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() == 2
    border = shapely.length(pieces).sum() - 2.0 * shared_edges(pieces)[1].sum()
    assert border == pytest.approx(shapely.length(solids).sum(), rel=1e-9), "what is not common is the solid's border"
    near, length = shared_borders(pieces)
    exact, same = shared_edges(pieces)
    by_pair = dict(zip(map(tuple, near.tolist()), length.tolist(), strict=True))
    assert {tuple(p): by_pair[tuple(p)] for p in exact.tolist()} == pytest.approx(
        dict(zip(map(tuple, exact.tolist()), same.tolist(), strict=True)), abs=1e-5
    )


def test_slivers_that_join_each_other_are_joined_on():
    """Two hairs side by side are one hair: it joins its neighbour as well."""
    cuts = [0.0, 10.0, 10.2, 10.5, 10.9, 20.0]
    pieces = column([shapely.box(a, 0, b, 10) for a, b in itertools.pairwise(cuts)])
    groups = sliver_groups(pieces, 20.0, 2.0)
    assert np.unique(groups).tolist() == [0, 4]
    assert groups[0] == 0
    assert groups[4] == 4
    assert sliver_groups(pieces, 0.0, 0.0).tolist() == [0, 1, 2, 3, 4]
    assert np.unique(sliver_groups(pieces, 1e6, 0.0)).tolist() == [0], "named by the largest, the first of equals"


# -- directions ----------------------------------------------------------------------------------------


def check_directions(found, turn_deg, island_angle_deg):
    asked = hatch_directions(found, SPACING, turn_deg, island_angle_deg)
    _, used = hatch(found.polygons, asked, WIDTH, SPACING)
    pairs, _ = shared_borders(found.polygons)
    width, _ = equivalent_rectangles_mm(found.polygons)
    parted = turn_between_deg(*np.degrees(used)[pairs.T])
    one_is_wide = (width[pairs] >= SPACING).any(axis=1)
    assert (parted[one_is_wide] >= least_turn_deg(island_angle_deg) - 1e-4).all()
    return asked


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("angle", [60.0, 90.0, 67.0, 45.0, 20.0])
@pytest.mark.parametrize("kind", sorted(LATTICES))
def test_islands_that_touch_do_not_share_a_direction(kind, angle):
    """Where one of the two is wider than the spacing: of two narrow ones each is filled along its long side."""
    rng = np.random.default_rng(5)
    for solids in SOLIDS.values():
        lattice = laid_over(solids, kind, rng.uniform(7.0, 20.0), rng.uniform(0.0, 6.0))
        found = partition(solids, lattice, WIDTH, SPACING)
        turn = float(rng.uniform(0.0, 360.0))
        first = check_directions(found, turn, angle)
        assert np.array_equal(first, hatch_directions(found, SPACING, turn, angle))


def test_directions_are_those_of_the_lattice_where_nothing_was_merged():
    solids = [shapely.box(0, 0, 200, 150)]
    lattice = laid_over(solids, "hexagons", 12.0, 0.2)
    inner = shapely.contains_properly(solids[0].buffer(-25.0), lattice.cells)
    found = Cells(lattice.cells[inner], np.full(inner.sum(), "hexagon"), lattice.colour[inner])
    assert np.degrees(hatch_directions(found, SPACING, 15.0, 60.0)) == pytest.approx(15.0 + 60.0 * found.colour)


def test_islands_of_one_colour_that_touch_are_parted():
    """A row of boxes, and a hub with a ring of petals around it."""
    ring = [shapely.box(20.0 * n, 0, 20.0 * n + 20.0, 20) for n in range(9)]
    found = Cells(column(ring), np.full(9, "square"), np.zeros(9, np.int64))
    assert np.unique(check_directions(found, 0.0, 60.0)).size <= 3, "multiples are enough"
    corners = [complex(math.cos(n * math.pi / 4), math.sin(n * math.pi / 4)) for n in range(9)]
    hub = shapely.Polygon([(20 * c.real, 20 * c.imag) for c in corners])
    petals = [
        shapely.Polygon([(r * c.real, r * c.imag) for r, c in ((20, a), (60, a), (60, b), (20, b))])
        for a, b in itertools.pairwise(corners)
    ]
    found = Cells(column([hub, *petals]), np.full(9, "square"), np.zeros(9, np.int64))
    assert len(shared_borders(found.polygons)[0]) == 16
    check_directions(found, 33.0, 60.0)


def test_a_wide_island_turns_away_from_a_narrow_one():
    strip, plate = shapely.box(0, 0, 60, 3), shapely.box(0, 3, 60, 40)
    found = Cells(column([plate, strip]), np.full(2, "hexagon"), np.zeros(2, np.int64))
    plate_deg, strip_deg = np.degrees(check_directions(found, 0.0, 60.0))
    assert strip_deg % 180.0 == pytest.approx(0.0)
    assert plate_deg == pytest.approx(60.0)
    assert math.degrees(long_direction_rad(affinity.rotate(strip, 25))) % 180.0 == pytest.approx(25.0)


def test_no_turn_from_island_to_island_leaves_the_layer_one_direction():
    solids = SOLIDS["gear"]
    found = partition(solids, laid_over(solids, "hexagons", 12.0, 0.1), WIDTH, SPACING)
    width, _ = equivalent_rectangles_mm(found.polygons)
    for angle in (0.0, 180.0):
        asked = np.degrees(hatch_directions(found, SPACING, 40.0, angle))
        assert asked[width >= SPACING] % 180.0 == pytest.approx(40.0)


def test_plans_take_their_directions_from_it():
    plan = plan_scan(ZOO["crooked 100"], PROFILE.changed(scan={"partition": "squares"}), layer=3)
    width, _ = equivalent_rectangles_mm(plan.islands)
    cells = (plan.island_kind == "square") & (width >= SPACING)
    angle = np.full(len(plan.islands), np.nan)
    lines = plan.vectors.drop_duplicates("island")
    angle[lines["island"]] = lines["angle"]
    pairs = plan.neighbours[cells[plan.neighbours].all(axis=1)]
    assert len(pairs) > 10
    assert turn_between_deg(*angle[pairs.T]).min() > 14.99
