"""Heat of a layer and of a whole program: conduction in modes of the outline and a balance along z.

The modal model takes the body as the section extruded down to its base. Its temperature rise is a sum of products of a mode of the
outline (:mod:`~ebamcheck.heat.modes`) and one of the depth (:mod:`~ebamcheck.heat.model`; Carslaw & Jaeger 1959). Each decays by
itself, so a time step of any length is exact.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ebamcheck.names_on_demand import on_demand

if TYPE_CHECKING:
    from ebamcheck.heat.medium import Medium as Medium
    from ebamcheck.heat.model import DepthModes as DepthModes
    from ebamcheck.heat.model import HeatModel as HeatModel
    from ebamcheck.heat.model import carried as carried
    from ebamcheck.heat.model import depth_modes as depth_modes
    from ebamcheck.heat.modes import ContourModes as ContourModes
    from ebamcheck.heat.modes import contour_modes as contour_modes

# Module of each name, loaded on first use: limits and the balance need no modes, and modes load much of SciPy
_HOMES = {
    "ContourModes": "modes",
    "DepthModes": "model",
    "HeatModel": "model",
    "Medium": "medium",
    "carried": "model",
    "contour_modes": "modes",
    "depth_modes": "model",
}
__getattr__ = on_demand(__name__, _HOMES)
