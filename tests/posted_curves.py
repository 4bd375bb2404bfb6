"""Curves with arcs, splines and lines as posts write them, and measures of what their programs drive."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import shapely
from nc_stack import make_curves, make_plan
from planned_roles import as_planned
from scipy.interpolate import BSpline

from ebamcheck.program import write_program
from ebamcheck.settings.config import Config

CONTROLS = ("sinumerik-840d-sl", "linuxcnc", "plain-gcode", "3dthesis")
TEXT_CONTROLS = CONTROLS[:3]

EXACT = {
    "poly": {"curve_form": "poly"},
    "bspline s=2": {"curve_form": "bspline", "bspline_shift": 2},
    "bspline s=3": {"curve_form": "bspline", "bspline_shift": 3},
    "bspline uniform": {"curve_form": "bspline", "bspline_shift": "uniform"},
    "linuxcnc": {"control": "linuxcnc"},
}
WITHIN = {
    "arcs": {"curve_form": "arcs"},
    "lines": {"curve_form": "lines"},
    "linuxcnc arcs": {"control": "linuxcnc", "curve_form": "arcs"},
    "linuxcnc lines": {"control": "linuxcnc", "curve_form": "lines"},
    "plain arcs": {"control": "plain-gcode"},
    "plain lines": {"control": "plain-gcode", "curve_form": "lines"},
}
TOLERANCE_MM = 0.01
"""Default of machine.line_tolerance_mm."""


def arc_through(centre, radius, first_rad, sweep_rad):
    """Control points of an arc piece: start, the point half-way, end."""
    at = first_rad + sweep_rad * np.array([0.0, 0.5, 1.0])
    return np.asarray(centre) + radius * np.column_stack([np.cos(at), np.sin(at)])


def with_arcs(curves):
    """Make every polyline of three points a circular arc."""
    sizes = np.diff(curves.control_starts)
    return replace(curves, kind=np.where((sizes == 3) & (curves.kind == 0), 2, curves.kind).astype(np.uint8))


def curve_points(curves, piece, count=400):
    """Points of a piece, by SciPy and by trigonometry; not by the code under test."""
    control = curves.control[curves.control_starts[piece] : curves.control_starts[piece + 1]]
    if curves.kind[piece] == 1:
        knots = curves.knots[curves.knot_starts[piece] : curves.knot_starts[piece + 1]]
        return BSpline(knots, control, 3)(np.linspace(0, knots[-1], count))
    if curves.kind[piece] == 0:
        return np.vstack([a + np.linspace(0, 1, count)[:, None] * (b - a) for a, b in pairwise(control)])
    return circle_points(*control, np.linspace(0, 1, count))


def circle_points(a, m, b, t):
    """Arc at shares t of its sweep through three points, by the circumcentre as the solution of two linear equations."""
    centre = np.linalg.solve(2.0 * np.array([m - a, b - a]), [m @ m - a @ a, b @ b - a @ a])
    angle = [np.arctan2(*(p - centre)[::-1]) for p in (a, m, b)]
    half = (angle[1] - angle[0] + np.pi) % (2 * np.pi) - np.pi
    at = angle[0] + 2 * half * t
    return centre + np.hypot(*(a - centre)) * np.column_stack([np.cos(at), np.sin(at)])


def spans_at(curves, t):
    """Every segment, knot span and arc of the curves at the parameters t, (E, t, 2), ring by ring."""
    found = []
    for piece in range(len(curves.kind)):
        control = curves.control[curves.control_starts[piece] : curves.control_starts[piece + 1]]
        if curves.kind[piece] == 1:
            knots = curves.knots[curves.knot_starts[piece] : curves.knot_starts[piece + 1]]
            spline = BSpline(knots, control, 3)
            found += [spline(a + (b - a) * t) for a, b in pairwise(np.unique(knots))]
        elif curves.kind[piece] == 0:
            found += [a + t[:, None] * (b - a) for a, b in pairwise(control)]
        else:
            found.append(circle_points(*control, t))
    return np.stack(found)


def same_parameters(nc, curves):
    """Largest distance of the contour motions from the curves at the same parameters."""
    t = np.linspace(0, 1, 11)
    nc = as_planned(nc, curves, None, Config())
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0))
    wanted = spans_at(curves, t)
    assert rows.size == len(wanted)
    driven = nc.evaluate(np.repeat(rows, t.size), np.tile(t, rows.size)).reshape(wanted.shape)
    return np.linalg.norm(driven - wanted, axis=2).max()


def away(points, polyline):
    """Largest distance of points from a polyline."""
    return shapely.distance(shapely.points(points), shapely.LineString(polyline)).max()


def deviation(nc, curves):
    """Largest distance, both ways, of the driven rings from the curves as shapes."""
    worst = 0.0
    nc = as_planned(nc, curves, None, Config())
    for ring in range(len(curves.closed)):
        first, last = curves.ring_starts[ring : ring + 2]
        rows = np.flatnonzero((nc.ring == ring) & nc.deposit)
        path = [nc.evaluate(np.full(50, row), np.linspace(0, 1, 50)) for row in rows]
        for piece in range(first, last):
            dense = curve_points(curves, piece, 4000)
            worst = max(worst, away(dense[::50], np.vstack(path)))
        whole = np.vstack([curve_points(curves, piece, 4000) for piece in range(first, last)])
        worst = max(worst, away(np.vstack([points[::7] for points in path]), whole))
    return worst


def smooth_curves():
    """A ring of a spline, two arcs and lines; a ring of four arcs; an open spline with double inner knots."""
    first = arc_through((0, 0), 30.0, 0.0, 1.2)
    second = arc_through((0, 0), 30.0, 1.2, 0.9)
    line = np.vstack([second[-1], [-45.0, 10.0], [-45.0, -5.0], [-40.0, -20.0]])
    knots = np.array([0, 0, 0, 0, 20, 20, 45, 45, 80, 80, 80, 80], float)
    spline = np.vstack([line[-1], [-25, -30], [0, -45], [12, -40], [20, -36], [28, -30], [30, -12], first[0]])
    quarter = [arc_through((100, 0), 8.0, -k * np.pi / 2, -np.pi / 2) for k in range(4)]
    for a, b in pairwise([*quarter, quarter[0]]):
        b[0] = a[2]
    path = np.array([(0, 60), (5, 72), (12, 75), (24, 62), (31, 55), (40, 60), (50, 66)], float)
    rings = [
        [(first, None), (second, None), (line, None), (spline, knots)],
        [(arc, None) for arc in quarter],
        [(path, np.array([0, 0, 0, 0, 15, 30, 45, 60, 60, 60, 60], float))],
    ]
    return with_arcs(make_curves([0.8], [rings], [True, True, False]))


def wrote(tmp_path, machine, curves, plan=None, name="program"):
    config = Config().changed(machine=machine)
    plan = plan if plan is not None else make_plan(curves.heights, [])
    return write_program(curves, plan, config, tmp_path / name), config
