"""Figure 8: a layer divided into hexagons by the paper's rule, with the order of its text."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import shapely

from ebamcheck.scan import minimum_rectangle, plan_scan
from ebamcheck.scan.islands.lattice import HEXAGON, hexagons_across, rows_along
from ebamcheck.settings.config import Config
from ebamcheck_reports import scan_picture
from ebamcheck_reports.markup import Markup
from ebamcheck_reports.paper.subject import Subject

RECTANGLE: Final = "paper"
ORDER: Final = "nearest"
"""Rotations in steps of pi/10 (equation 11), and the nearest centroid next (section 4.2)."""

UNTURNED: Final = {"lattice_angle_deg": 0.0, "lattice_shift": False}
"""The paper aligns its hexagons with the rectangle on every layer."""


def measure(subject: Subject) -> tuple[dict[str, Any], list[Markup]]:
    """Partition the largest layer and picture its islands in their order."""
    section = subject.largest_section
    config = Config().changed(scan={"rectangle": RECTANGLE, "order": ORDER, **UNTURNED})
    regions = section.polygons(0)
    plan = plan_scan(regions, config, layer=subject.largest_layer, height_mm=float(section.heights[0]))
    figures = plan.metrics.iloc[0]
    record = {
        "layer": subject.largest_layer + 1,
        "height_mm": float(section.heights[0]),
        "area_mm2": float(figures["area_mm2"]),
        **lattice(shapely.get_coordinates(regions), float(figures["side_mm"])),
        "islands": len(plan.islands),
        "hexagons": int((plan.island_kind == HEXAGON).sum()),
        "order": ORDER,
        "rectangle": RECTANGLE,
        "covered_fraction": float(figures["covered_fraction"]),
        "bead_width_mm": config.process.bead_width_mm,
    }
    picture = scan_picture.draw(
        plan, section, 0, config.process.bead_width_mm, "hexagons of the layer and their order"
    )
    return record, [scan_picture.key(), picture]


def lattice(points: np.ndarray[Any, np.dtype[np.float64]], side_mm: float) -> dict[str, Any]:
    """Sides of the enclosing rectangle and the paper's count of hexagons along the short one (section 4.1).

    ``rounded`` is round(L1 / d) + 1; where it is even, one hexagon more is laid. Without a solid that can be
    divided there is no side, and nothing is counted.
    """
    around = minimum_rectangle(points, RECTANGLE)
    found: dict[str, Any] = {
        "L1_mm": around.short_mm,
        "L2_mm": around.long_mm,
        "angle_deg": math.degrees(around.angle_rad),
        "d_mm": side_mm,
    }
    if math.isnan(side_mm):
        return {**found, "rounded": None, "case": "none", "n": 0, "rows": 0}
    rounded = math.floor(around.short_mm / side_mm + 0.5) + 1
    return {
        **found,
        "rounded": rounded,
        "case": "odd" if rounded % 2 else "even",
        "n": hexagons_across(around.short_mm, side_mm),
        "rows": rows_along(around.long_mm, side_mm),
    }
