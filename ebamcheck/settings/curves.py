"""Settings of the curves."""

from __future__ import annotations

from typing import Annotated, Literal

from ebamcheck.settings.base import Between, InnerAngle, Section, Tolerance


class CurveSettings(Section):
    """Cleaning and fitting of contours."""

    method: Literal["bounded", "surface", "chord", "paper"] = "bounded"
    """Fit: the fewest lines, arcs and cubics within the tolerance of the surface that the mesh stands for; a cubic for
    each of its points; an interpolating spline by chord length; or that of the paper."""
    tolerance_mm: Annotated[float, Between(1e-6, 10.0)] = 0.02
    """Distance that `bounded` may keep from the smooth curve."""
    crease_angle_deg: InnerAngle = 40.0
    """Edges of the mesh whose facets differ by this angle are sharp, for `bounded` and `surface`."""
    polygon_angle_deg: InnerAngle = 12.0
    """Flat strips between two rims are a cylinder or cone where they turn by less than this from one to the next (30 sides
    around)."""
    polygon_sagitta_mm: Tolerance = 0.1
    """Strips that turn by more are still a cylinder where they leave it by less than this, times the square of the ratio of
    the angle above and theirs: 0.064 mm for 24 sides, 0.016 mm for 12. 0.1 mm is as coarse as CAD systems export by
    default; who rounds a polygon leaves its part, who keeps one loses no more than the export has. Else they are the sides
    of a polygon and stay so, unless roundings of the part that touch their flat sides as tangents are as coarse. 0: go by
    the angle alone."""
    corner_angle_deg: InnerAngle = 140.0
    """A contour splits where the angle between its segments is under this (paper, section 3.2)."""
    near_point_mm: Tolerance = 0.001
    """Neighbouring points closer than this become one."""
    collinear_mm: Tolerance = 0.001
    """Inner points nearer than this to the chord of a straight run go."""
    straight_run_mm: Annotated[float, Between(0.001, 1e4)] = 5.0
    """A segment at least this long, and three times longer than those beside it, is a straight run, not part of a
    curve."""
    largest_lift_mm: Annotated[float, Between(0.001, 1000.0)] = 1.0
    """How far a curve of `bounded` or `surface` may lie from the chords of the mesh, which it leaves for the surface behind
    them: the limit of the fit's gate. More is a mesh too coarse for its part."""
    largest_bulge_mm: Annotated[float, Between(0.001, 1e6)] = 0.2
    """A curved run that leaves the chords of its contour by more than this stays a polyline: the mesh is too coarse
    there to tell the curve that it stands for. For `paper` and `chord` it is the limit of the fit's gate, too."""
    section_tolerance_mm: Annotated[float, Between(0.001, 100.0)] = 0.25
    """How far the contour path may leave the section of the mesh at any place, whatever the fit has evidence for: the largest
    bulge of a run that the mesh can tell, and what fit and inset leave. A ring of curves that would leave it farther stays
    the polygon of its contour."""
