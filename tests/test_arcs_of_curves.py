"""Arcs and splines of fitted curves, evaluated by our own code and by two others, and read from their file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from curve_parts import sliced
from geomdl import NURBS
from geomdl import BSpline as GeomdlBSpline
from scipy.interpolate import BSpline

from ebamcheck.curves import ARC, LINE, SPLINE, Curves, fit
from ebamcheck.curves.bezier import Arcs, arcs_through
from ebamcheck.plugins.registry import models

MODELS = models()


def arc_of(curves: Curves, i: int) -> Arcs:
    """The one arc of a piece."""
    arcs = arcs_through(curves.piece(i).control[None])
    return Arcs(*(column[0] for column in arcs))


def test_a_circle_is_written_as_arcs_of_its_radius() -> None:
    part = MODELS["cylinder"].tessellate(0.05)
    layers = sliced(part, 4)
    curves = fit(layers, part=part)
    assert set(curves.kind) == {ARC}
    assert curves.block_count() <= 3 * 4
    truth_mm = np.hypot(*layers.points.T).max()
    for i in range(curves.kind.size):
        arc = arc_of(curves, i)
        assert arc.radius == pytest.approx(truth_mm, abs=0.003)
        assert abs(np.degrees(arc.sweep)) <= 171.0


def test_geomdl_and_scipy_evaluate_every_piece_alike() -> None:
    part = MODELS["ladder"].tessellate(0.4)
    for method in ("surface", "bounded"):
        curves = fit(sliced(part, 2), method, part=part)
        for i in range(curves.kind.size):
            piece = curves.piece(i)
            if piece.kind == SPLINE:
                at = np.linspace(0.0, piece.knots[-1], 17)
                ours = curves.evaluate(i, at)
                assert np.abs(ours - BSpline(piece.knots, piece.control, 3)(at)).max() < 1e-9
                other = GeomdlBSpline.Curve()
                other.degree = 3
                other.ctrlpts = piece.control.tolist()
                other.knotvector = (piece.knots / piece.knots[-1]).tolist()
                theirs = np.array(other.evaluate_list((at / piece.knots[-1]).tolist()))
                assert np.abs(ours - theirs).max() < 1e-9
            elif piece.kind == ARC:
                assert_is_rational_quadratic(curves, i)


def assert_is_rational_quadratic(curves: Curves, i: int) -> None:
    """The arc is geomdl's rational quadratic through the same ends, with the corner of the tangents between."""
    arc = arc_of(curves, i)
    start, end = curves.piece(i).control[[0, 2]]
    middle = arc.start + 0.5 * arc.sweep
    weight = np.cos(0.5 * arc.sweep)
    tip = arc.centre + arc.radius / weight * np.array([np.cos(middle), np.sin(middle)])
    curve = NURBS.Curve()
    curve.degree = 2
    curve.ctrlptsw = [[*start, 1.0], [*(weight * tip), weight], [*end, 1.0]]
    curve.knotvector = [0, 0, 0, 1, 1, 1]
    points = np.array(curve.evaluate_list(np.linspace(0.0, 1.0, 9).tolist()))
    assert np.abs(np.hypot(*(points - arc.centre).T) - arc.radius).max() < 1e-9
    half = curves.evaluate(i, [0.5 * abs(arc.sweep) * arc.radius])
    assert np.abs(half - points[4]).max() < 1e-9


def test_bezier_spans_of_an_arc_stay_on_it() -> None:
    part = MODELS["cylinder"].tessellate(0.05)
    curves = fit(sliced(part, 1), part=part)
    spans = curves.bezier_spans()
    t = np.linspace(0.0, 1.0, 7)[:, None, None]
    s = 1.0 - t
    B = spans.points
    points = s**3 * B[:, 0] + 3 * s * s * t * B[:, 1] + 3 * s * t * t * B[:, 2] + t**3 * B[:, 3]
    arcs = [arc_of(curves, i) for i in range(curves.kind.size)]
    for k, i in enumerate(spans.piece):
        off = np.hypot(*(points[:, k] - arcs[i].centre).T) - arcs[i].radius
        assert np.abs(off).max() < 1e-9
    assert curves.lengths().sum() == pytest.approx(sum(abs(a.sweep) * a.radius for a in arcs), rel=1e-9)


def test_arcs_come_back_from_their_file(tmp_path: Path) -> None:
    part = MODELS["prism"].tessellate(0.1)
    curves = fit(sliced(part, 3), part=part)
    assert {LINE, ARC} <= set(curves.kind)
    curves.to_parquet(tmp_path / "curves.parquet")
    back = Curves.from_parquet(tmp_path / "curves.parquet")
    for name in ("kind", "control", "knots", "control_starts", "knot_starts", "ring_starts", "closed"):
        assert np.array_equal(getattr(back, name), getattr(curves, name))
