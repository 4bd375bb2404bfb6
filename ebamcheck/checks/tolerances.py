"""Tolerances of the checks that no setting makes: the decimals of a program, and what fits and sections may be off by."""

from __future__ import annotations

from ebamcheck.settings.config import Config

PLACE_MM = 1e-3  # Places and heights nearer than this are one: three decimals are the fewest of a program
TWO_PLACES_MM = 2.0 * PLACE_MM  # Distance of two places of which each is rounded to the decimals of a program
VALUE_SHARE = 1e-3  # Share by which a printed value may be off: volts, milliamperes, feeds, wire speeds
# The same of a figure at the border of a window: process values are printed with six decimals, wire speeds with the fewest.
WINDOW_SHARE = 1e-5
PRINTED = 1e-6  # Decimals of a process value, of a wait, and of heights in comments
# Path read back against the fitted curve, after decimal rounding: a tenth of what a slicer agrees to.
PATH_TOLERANCE_MM = 1e-3
# Contour path against the section: the fit of the curves and the roundness of the inset's corners.
SECTION_TOLERANCE_MM = 0.05
# Metal of a bead over what is asked for: the decimals of wire speed and feed, and nothing else.
WIRE_TOLERANCE = 0.01
# Lines nearer than this, along one another, are one line laid twice: far under any spacing.
SAME_LINE_MM = 0.01
# Points nearer to the chord of their neighbours are made by facets that were cut in two: they end no chord.
COLLINEAR_MM = 1e-3
# Width up to which a slit is what rounding left of a face that two bodies share: far under any gap that a bead leaves open.
SLIT_MM = 1e-3
# Direction of a line of a few tenths of a millimetre whose ends are rounded to the program's decimals.
DIRECTION_ROUNDING_DEG = 0.01
LIMIT_ROUNDING_MM = 1e-9  # Rounding of a curve's extreme
SAME_SIZE = 1e-4  # Share of its size by which a part may be off: coordinates of an STL file have seven digits
# Share of the greatest section by which those of the mesh and of a slicer differ only where bodies overlap, or it is open.
SAME_AREA = 1e-3
# Wire changes between blocks, whose ends are rounded, and which other curve forms place elsewhere by so much.
WIRE_PLACE_MM = 0.2


def smooth_tolerance_mm(config: Config) -> float:
    """Distance of the path from a smooth section that was sliced and fitted anew.

    Both sections and the bead's path were fitted within the tolerance, and cleaned before.
    """
    curves = config.curves
    return SECTION_TOLERANCE_MM + 2.0 * curves.tolerance_mm + curves.near_point_mm + curves.collinear_mm
