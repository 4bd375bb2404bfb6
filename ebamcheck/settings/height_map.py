"""Settings of measured surfaces: where the grid of a height map lies on the machine, and how uneven a layer may be."""

from __future__ import annotations

from typing import Annotated, Literal

from ebamcheck.settings.base import Angle, Between, Place, Section, Share

Step = Annotated[float, Between(0.001, 100.0)]
"""Distance of the points of a grid, mm."""


class HeightMapSettings(Section):
    """Maps of the measured surface (`relayer --height-map`, `live`), where a map does not bring its own frame."""

    origin_mm: tuple[Place, Place] = (0.0, 0.0)
    """X and Y of the point of the first column and the lowest row, in the coordinates of the program."""
    step_mm: tuple[Step, Step] = (1.0, 1.0)
    """Distance of columns and of rows; of NPY and TIFF, whose files do not tell it."""
    turn_deg: Angle = 0.0
    """Turn of the grid about its origin, counterclockwise."""
    rows: Literal["up", "down"] = "down"
    """Whether Y grows from the first row of the file to the last, or falls, as in a picture."""
    unit_mm: Annotated[float, Between(1e-9, 1000.0)] = 1.0
    """Height that a value of 1 stands for: 0.001 for micrometres."""
    zero_mm: Place = 0.0
    """Height over the base plate that a value of 0 stands for."""
    hole: Annotated[float, Between(-1e12, 1e12)] | None = None
    """Value that stands for a hole, beside NaN and infinite ones; None: there is none."""
    spike_mm: Annotated[float, Between(0.01, 1000.0)] = 5.0
    """Points further than this from the median of the layer count as holes: spatter, and what is not the part."""
    least_known: Share = 0.6
    """Share of the layer of which the height has to be known; holes get that of the nearest place."""
    uneven_mm: Annotated[float, Between(0.001, 100.0)] | None = None
    """How far a spot of a bead may lie over or under the mean of the layer; a layer that is more uneven is refused with the place.
    None: half the usual height of a layer, and no more than process.surface_tolerance_mm."""
