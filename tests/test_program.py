"""The post-processor: the path that it writes is the curve."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from geomdl import BSpline
from hypothesis import given, settings
from hypothesis import strategies as st
from inset_layers import contour_paths
from nc_stack import REACHES_OUT, clamped_knots, hatch, make_curves, make_plan, stack

from ebamcheck.controls.sinumerik.writing import refined
from ebamcheck.layers.stack import from_polygons
from ebamcheck.nc.motions import POLYNOMIAL
from ebamcheck.program import (
    program_summary,
    read_program,
    verify_file,
    verify_program,
    write_program,
)
from ebamcheck.settings.config import Config
from ebamcheck.writing.segments import bezier_places, chords, spans

FORMS = {
    "poly": {"curve_form": "poly"},
    "bspline s=2": {"curve_form": "bspline", "bspline_shift": 2},
    "bspline s=3": {"curve_form": "bspline", "bspline_shift": 3},
    "lines": {"curve_form": "lines"},
}

SQUARE = np.array([(0, 0), (10, 0), (10, 10), (0, 10), (0, 0)], float)


def failed(checks):
    return [(c.name, c.where, c.text) for c in checks if not c.passed and c.name != REACHES_OUT]


def value(checks, name):
    return next(c.value for c in checks if c.name == name)


def geomdl_points(control, knots, u):
    curve = BSpline.Curve(normalize_kv=False)
    curve.degree = 3
    curve.ctrlpts = np.asarray(control).tolist()
    curve.knotvector = np.asarray(knots).tolist()
    return np.array(curve.evaluate_list(list(u)))


@pytest.mark.parametrize("form", FORMS)
def test_a_program_passes_every_check_in_every_form(form, tmp_path):
    config = Config().changed(machine=FORMS[form])
    curves, plan = stack()
    files = write_program(curves, plan, config, tmp_path / "program")
    checks = verify_file(files.main, config=config, curves=curves, plan=plan, sha256=files.sha256)
    assert failed(checks) == []
    # Knots of 6 decimals cost 5e-7 times the speed of the parameter, here up to 30 mm to 1 mm of knots.
    limit = {"poly": 2e-6, "lines": 0.0105}.get(form, 2e-4)
    assert value(checks, "contour path") < limit


@pytest.mark.parametrize("decimals", range(3, 9))
def test_the_path_is_exact_up_to_the_printed_decimals(decimals, tmp_path):
    config = Config().changed(machine={"decimals": decimals})
    curves, plan = stack(seed=decimals)
    files = write_program(curves, plan, config, tmp_path / "program")
    checks = verify_file(files.main, config=config, curves=curves, plan=plan)
    # Half a unit of the end point, plus max |t^2 - t| + max |t^3 - t| = 0.635 half units, in X and in Y.
    assert value(checks, "contour path") <= 0.5 * 1.64 * np.sqrt(2) * 10.0**-decimals
    assert value(checks, "hatch vectors") <= 0.51 * 10.0**-decimals


@given(st.integers(0, 2**32 - 1), st.integers(4, 30))
@settings(max_examples=60, deadline=None)
def test_spans_are_the_spline_by_geomdl(seed, controls):
    rng = np.random.default_rng(seed)
    control = rng.normal(size=(controls, 2)) * 50
    knots = clamped_knots(rng, controls)
    found = spans(make_curves([0.0], [[[(control, knots)]]], [False]))
    breaks = np.unique(knots)
    assert len(found.bezier) == breaks.size - 1
    b = found.bezier
    for t in (0.0, 0.3, 1.0):
        places = bezier_places(b, np.full(len(b), t))
        expected = geomdl_points(control, knots, np.minimum(breaks[:-1] + t * np.diff(breaks), knots[-1]))
        assert np.abs(places - expected).max() < 1e-9


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1.0))
@settings(max_examples=30, deadline=None)
def test_chords_keep_to_their_tolerance(seed, tolerance_mm):
    rng = np.random.default_rng(seed)
    control, knots = rng.normal(size=(6, 2)) * 20, clamped_knots(rng, 6)
    found = spans(make_curves([0.0], [[[(control, knots)]]], [False]))
    _, points = chords(found, tolerance_mm)
    polyline = np.vstack([control[:1], points])
    fine = geomdl_points(control, knots, np.linspace(0, knots[-1], 400))
    a, d = polyline[:-1], np.diff(polyline, axis=0)
    along = np.clip(((fine[:, None] - a) * d).sum(axis=2) / (d * d).sum(axis=1), 0, 1)
    away = np.linalg.norm(fine[:, None] - a - along[..., None] * d, axis=2).min(axis=1)
    assert away.max() <= tolerance_mm * (1 + 1e-9)


def test_repeated_inner_knots_give_no_empty_blocks(tmp_path):
    control = np.array([(0, 0), (5, 9), (12, -3), (20, 8), (26, 0), (30, 4), (40, 0)], float)
    knots = np.array([0, 0, 0, 0, 10, 10, 25, 40, 40, 40, 40], float)
    curves = make_curves([0.5], [[[(control, knots)]]], [False])
    for form in FORMS:
        config = Config().changed(machine=FORMS[form])
        plan = make_plan([0.5], [])
        files = write_program(curves, plan, config, tmp_path / "program")
        nc = read_program(files.main, config)
        assert failed(verify_program(nc, config=config, curves=curves, plan=plan)) == []
        if form == "poly":
            assert nc.deposit.sum() == 3


@given(st.integers(0, 2**32 - 1), st.integers(4, 7), st.integers(3, 12))
@settings(max_examples=30, deadline=None)
def test_refined_splines_are_the_same_curve(seed, controls, blocks):
    rng = np.random.default_rng(seed)
    control, knots = rng.normal(size=(controls, 2)) * 50, clamped_knots(rng, controls)
    more, finer = refined(control, knots, blocks)
    assert len(more) - 1 == max(blocks, controls - 1)
    assert np.array_equal(more[[0, -1]], control[[0, -1]])
    at = np.linspace(0, knots[-1], 50)
    assert np.abs(geomdl_points(more, finer, at) - geomdl_points(control, knots, at)).max() < 1e-10


def test_the_worked_example_of_the_facts(tmp_path):
    control = np.array([(0, 0), (5, 10), (15, 15), (28, 12), (34, 4), (40, 0)], float)
    knots = np.array([0, 0, 0, 0, 2, 5, 9, 9, 9, 9], float)
    curves = make_curves([0.5], [[[(control, knots)]]], [False])
    files = write_program(curves, make_plan([0.5], []), Config(), tmp_path / "program")
    nc = read_program(files.main)
    rows = np.flatnonzero(nc.kind == POLYNOMIAL)
    h = np.array([2.0, 3.0, 4.0])
    assert nc.end[rows, 0] == pytest.approx([12.555556, 25.800454, 40], abs=5e-7)
    assert nc.end[rows, 1] == pytest.approx([12.933333, 11.292517, 0], abs=5e-7)
    assert nc.coefficients[rows, 0, 2] / h**2 == pytest.approx([-0.75, -0.333333, -0.251701], abs=1e-6)
    assert nc.coefficients[rows, 1, 3] / h**3 == pytest.approx([0.866667, 0.050340, 0.037840], abs=1e-6)


def test_each_span_is_the_bezier_that_linuxcnc_would_drive(tmp_path):
    """G5 I J P Q: the tangents at both ends are three times the legs of the Bezier polygon."""
    curves, plan = stack(seed=4, count=1)
    files = write_program(curves, plan, Config(), tmp_path / "program")
    nc = read_program(files.main)
    rows = np.flatnonzero(nc.kind == POLYNOMIAL)
    piece = curves.piece(0)
    knots = np.unique(piece.knots)
    curve = BSpline.Curve(normalize_kv=False)
    curve.degree, curve.ctrlpts, curve.knotvector = 3, piece.control.tolist(), piece.knots.tolist()
    for i, (a, b) in enumerate(pairwise(knots)):
        (p0, d0), (p3, d3) = (np.array(curve.derivatives(u, order=1)) for u in (a, b))
        leg_i, leg_p = d0 * (b - a) / 3, -d3 * (b - a) / 3
        bezier = np.array([p0, p0 + leg_i, p3 + leg_p, p3])
        for t in np.linspace(0, 1, 7):
            weights = np.array([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
            driven = nc.evaluate(rows[i : i + 1], np.array([t]))[0]
            assert driven == pytest.approx(weights @ bezier, abs=1e-5)


def test_moving_the_part_moves_the_program(tmp_path):
    curves, plan = stack(seed=2)
    shift = np.array([12.5, -3.25])
    moved = replace(curves, control=curves.control + shift)
    vectors = plan.vectors.copy()
    vectors[["x0", "x1"]] += shift[0]
    vectors[["y0", "y1"]] += shift[1]
    there = write_program(moved, replace(plan, vectors=vectors), Config(), tmp_path / "there")
    here = write_program(curves, plan, Config(), tmp_path / "here")
    a, b = read_program(here.main), read_program(there.main)
    # The closing rise of the main program has no X and Y of its own; it moves with the rest. The tool is parked at one place.
    known = np.isfinite(a.end).all(axis=1)
    assert b.end[-1].tolist() == a.end[-1].tolist()
    known[-1] = False
    assert np.abs(b.end[known] - a.end[known] - [*shift, 0]).max() <= 1e-6 + 1e-9


def test_hatch_lines_far_apart_are_not_joined(tmp_path):
    plan = make_plan([0.5], [(0, [*hatch(0, 0, 2), *hatch(0, 40, 2)]), (0, hatch(0, 44.32, 1))])
    curves = make_curves([0.5], [[]], [])
    files = write_program(curves, plan, Config(), tmp_path / "program")
    nc = read_program(files.main)
    assert nc.events.name.count("beam_on") == 3
    assert nc.turn.sum() == 2
    assert failed(verify_program(nc, config=Config(), curves=curves, plan=plan)) == []
    assert nc.vectors()[["x0", "y0", "x1", "y1"]].to_numpy() == pytest.approx(
        plan.vectors[["x0", "y0", "x1", "y1"]].to_numpy()
    )


def test_the_path_against_sections_of_the_part(tmp_path):
    import shapely

    section = shapely.box(-30, -20, 50, 40)
    inset = np.array(shapely.get_coordinates(section.buffer(-3)), float)
    heights = [0.8, 2.4]
    curves = make_curves(heights, [[[(inset, None)]]] * 2, [True, True])
    files = write_program(curves, make_plan(heights, []), Config(), tmp_path / "program")
    layers = from_polygons(heights, [[section]] * 2)
    checks = verify_file(files.main, config=Config(), layers=layers)
    assert failed(checks) == []
    assert value(checks, "section") < 1e-6
    shifted = from_polygons(heights, [[section], [shapely.affinity.translate(section, 0.1)]])
    checks = verify_file(files.main, config=Config(), layers=shifted)
    ((name, where, _),) = failed(checks)
    assert name == "section"
    assert where.startswith("MAIN_L0002.SPF:")
    assert value(checks, "section") == pytest.approx(0.1, abs=1e-6)
    two = section.union(shapely.box(80, 0, 100, 20))
    missing = verify_file(files.main, config=Config(), layers=from_polygons(heights, [[two]] * 2))
    assert [c[0] for c in failed(missing)] == ["section"]
    for width, found in ((1e-6, []), (0.5, ["section"])):  # a slit of no width asks for no contour
        slit = section.difference(shapely.box(10, 0, 10 + width, 20))
        checks = verify_file(files.main, config=Config(), layers=from_polygons(heights, [[slit]] * 2))
        assert [c[0] for c in failed(checks)] == found


def test_a_path_may_go_around_a_narrow_hole_or_pass_it_by(tmp_path):
    import shapely

    section = shapely.box(-30, -20, 50, 40)
    holed = section.difference(shapely.box(-26, 0, -20, 0.1))  # its inset swallows part of the outer one
    heights = [0.8, 2.4]
    layers = from_polygons(heights, [[holed]] * 2)
    for made_of, k in ((section, 0), (holed, 1)):
        inset = [
            (np.array(ring.coords), None)
            for piece in shapely.get_parts(made_of.buffer(-3, quad_segs=16))
            for ring in (piece.exterior, *piece.interiors)
        ]
        curves = make_curves(heights, [[inset]] * 2, [True, True])
        files = write_program(curves, make_plan(heights, []), Config(), tmp_path / f"program{k}")
        checks = verify_file(files.main, config=Config(), layers=layers)
        assert failed(checks) == []


def test_layers_without_contours_and_islands_are_still_layers(tmp_path):
    heights = [0.5, 1.5, 2.5]
    curves, plan = make_curves(heights, [[], [[(SQUARE, None)]], []], [True]), make_plan(heights, [])
    files = write_program(curves, plan, Config(), tmp_path / "program")
    checks = verify_file(files.main, config=Config(), curves=curves, plan=plan)
    # What lies over an empty layer begins in the air.
    assert [name for name, *_ in failed(checks)] == ["support"]
    nc = read_program(files.main)
    assert len(nc.layer_files) == 3
    assert nc.layer_heights[1] == 2.0
    assert nc.contours(1.0).areas()[1] == 100.0
    assert program_summary(nc, Config()).contour_mm.tolist() == [0, 40, 0]


def test_hatch_and_contours_of_a_planned_part_pass(tmp_path):
    import shapely

    from ebamcheck.curves import fit
    from ebamcheck.scan import plan_stack

    disc = shapely.Point(3, -8).buffer(70, 64).difference(shapely.Point(0, 0).buffer(15, 32))
    layers = from_polygons([0.9, 2.5], [[disc], [shapely.box(-40, 0, 40, 30), shapely.box(60, 0, 64, 50)]])
    config = Config()
    curves, plan = fit(contour_paths(layers, config.contour_offset_mm)), plan_stack(layers, config)
    files = write_program(curves, plan, config, tmp_path / "program")
    checks = verify_file(files.main, config=config, curves=curves, plan=plan, layers=layers, sha256=files.sha256)
    assert failed(checks) == []
    # Contours whose wire changes are cut there, and compared as shapes: by chords that keep to 2 % of the limit.
    assert value(checks, "contour path") < 2.5e-5
    whole = replace(plan, sections=None)
    files = write_program(curves, whole, config, tmp_path / "one wire")
    checks = verify_file(files.main, config=config, curves=curves, plan=whole, layers=layers)
    assert failed(checks) == []
    assert value(checks, "contour path") < 2e-6
