"""Settings of the curves."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ebamcheck.settings.base import NotNegative, Positive, Section


class CurveSettings(Section):
    """Cleaning and fitting of contours."""

    method: Literal["bounded", "surface", "chord", "paper"] = "bounded"
    """Fit: the fewest lines, arcs and cubics within the tolerance of the surface that the mesh stands for; a cubic for
    each of its points; an interpolating spline by chord length; or that of the paper."""
    tolerance_mm: Positive = 0.02
    """Distance that `bounded` may keep from the smooth curve."""
    crease_angle_deg: Annotated[float, Field(gt=0, lt=180)] = 40.0
    """Edges of the mesh whose facets differ by this angle are sharp, for `bounded` and `surface`."""
    corner_angle_deg: Annotated[float, Field(gt=0, lt=180)] = 140.0
    """A contour splits where the angle between its segments is under this (paper, section 3.2)."""
    near_point_mm: NotNegative = 0.001
    """Neighbouring points closer than this become one."""
    collinear_mm: NotNegative = 0.001
    """Inner points nearer than this to the chord of a straight run go."""
    straight_run_mm: Positive = 5.0
    """A segment at least this long, and three times longer than those beside it, is a straight run, not part of a
    curve."""
    largest_lift_mm: Positive = 1.0
    """How far a curve of `bounded` or `surface` may lie from the chords of the mesh, which it leaves for the surface behind
    them: the limit of the fit's gate. More is a mesh too coarse for its part."""
    largest_bulge_mm: Positive = 0.2
    """A curved run that leaves the chords of its contour by more than this stays a polyline: the mesh is too coarse
    there to tell the curve that it stands for. For `paper` and `chord` it is the limit of the fit's gate, too."""
    section_tolerance_mm: Positive = 0.25
    """How far the contour path may leave the section of the mesh at any place, whatever the fit has evidence for: the largest
    bulge of a run that the mesh can tell, and what fit and inset leave."""
