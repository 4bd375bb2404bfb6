"""Curves: contours become lines, arcs and splines, and how far these leave the contours and the part is measured."""

from __future__ import annotations

from ebamcheck.curves.accuracy import contour_error, error_reduction, polar_radius
from ebamcheck.curves.bezier import BezierSpans
from ebamcheck.curves.columns import Curves, Piece
from ebamcheck.curves.deviation import fit_deviation
from ebamcheck.curves.fitting import LIFTED, METHODS, fit, fit_for_program
from ebamcheck.curves.runs import ARC, LINE, SPLINE

__all__ = [
    "ARC",
    "LIFTED",
    "LINE",
    "METHODS",
    "SPLINE",
    "BezierSpans",
    "Curves",
    "Piece",
    "contour_error",
    "error_reduction",
    "fit",
    "fit_deviation",
    "fit_for_program",
    "polar_radius",
]
