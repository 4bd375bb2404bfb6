"""Heat of a layer: exact in time on the layer's own outline (facts of conduction: Carslaw & Jaeger 1959).

The body is the section extruded down to its base. Its temperature rise is a sum of products of a mode of the
outline (:mod:`~ebamcheck.heat.modes`) and one of the depth (:mod:`~ebamcheck.heat.depth`); each decays by itself, so that
a step of any length is exact (:mod:`~ebamcheck.heat.model`).
"""

from ebamcheck.heat.depth import DepthModes, depth_modes
from ebamcheck.heat.medium import Medium
from ebamcheck.heat.model import HeatModel
from ebamcheck.heat.modes import ContourModes, contour_modes
from ebamcheck.heat.projection import carried

__all__ = [
    "ContourModes",
    "DepthModes",
    "HeatModel",
    "Medium",
    "carried",
    "contour_modes",
    "depth_modes",
]
