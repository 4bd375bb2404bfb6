"""Walls under a bead: where they are, and what a bead as narrow as they are would take.

A pool as wide as the wall lays the wall's metal and nothing beside it. The section of a pool grows with the energy that it gets
along its way, so that its width goes with the root of the line energy (Rosenthal 1946, for a thick body); the bead's metal goes with the width
alone. At the travel speed that is set, a bead of half the width takes half the wire and a quarter of the power, until wire feed,
line energy or the melting of the wire stand in the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.regions import mean_width_mm, valid_polygons
from ebamcheck.heat.melting import least_power_share
from ebamcheck.scan.islands.regions import CRUMB, split_thin
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import line_energy_j_mm, wire_speed_mm_s


@dataclass(frozen=True)
class ThinWall:
    """The thinnest wall of a section: its width, and a point in it, mm."""

    width_mm: float
    x_mm: float
    y_mm: float


@dataclass(frozen=True)
class NarrowBead:
    """What a bead takes that is as wide as a wall, at the travel speed that is set.

    Parameters
    ----------
    width_mm
        Its width.
    wire_mm_s, power_w, current_ma
        Wire speed, beam power, and the current that gives it.
    layer_mm
        Height of the layer.
    limits_mm
        Least width that each limit of the process allows, by the limit's name.
    """

    width_mm: float
    wire_mm_s: float
    power_w: float
    current_ma: float
    layer_mm: float
    limits_mm: dict[str, float]

    @property
    def least_mm(self) -> float:
        """Least width within the process window."""
        return max(self.limits_mm.values())

    @property
    def can_be_laid(self) -> bool:
        """Whether the process window allows it."""
        return self.width_mm >= self.least_mm

    def __str__(self) -> str:
        """Say what the bead takes, or which limit stands in its way."""
        if self.can_be_laid:
            return (
                f"a bead of {self.width_mm:.1f} mm is within the process window ({self.wire_mm_s:.1f} mm/s of wire, "
                f"{self.power_w:.0f} W): set process.bead_width_mm {self.width_mm:.1f}, process.current_ma {self.current_ma:.1f} "
                f"and layers.layer_height_mm {self.layer_mm:.4g}"
            )
        name = max(self.limits_mm, key=lambda key: self.limits_mm[key])
        return f"no bead of this wire, travel speed and layer height is narrower than {self.least_mm:.1f} mm, by {name}"


def thinnest_wall(section: BaseGeometry, bead_width_mm: float) -> ThinWall | None:
    """Find the thinnest piece of a section that no bead fits into; None where beads fit everywhere but in corners."""
    _, thin = split_thin(section, bead_width_mm, CRUMB * bead_width_mm**2)
    alone = [part for part in valid_polygons(section) if mean_width_mm(part) < bead_width_mm]
    found = [*thin, *alone]
    if not found:
        return None
    wall = min(found, key=mean_width_mm)
    point: shapely.Point = wall.representative_point()
    return ThinWall(mean_width_mm(wall), point.x, point.y)


def narrow_bead(wall_mm: float, thickness_mm: float, config: Config) -> NarrowBead:
    """Bead as wide as a wall.

    Examples
    --------
    >>> bead = narrow_bead(4.0, Config().layer_height_mm, Config())
    >>> round(bead.wire_mm_s, 1), round(bead.power_w)
    (33.3, 3200)
    """
    process = config.process
    bead_mm = process.bead_width_mm
    per_mm = wire_speed_mm_s(config, 1.0, thickness_mm)
    energy = line_energy_j_mm(config)
    # Power for the wire goes with the width, power for the pool with its square: under this width the wire wins.
    melting_mm = bead_mm**2 * least_power_share(config, thickness_mm) / process.hatch_spacing_mm
    share = (wall_mm / bead_mm) ** 2
    return NarrowBead(
        wall_mm,
        per_mm * wall_mm,
        process.power_w * share,
        process.current_ma * share,
        thickness_mm,
        {
            "process.wire_speed_min_mm_s": process.wire_speed_min_mm_s / per_mm,
            "process.line_energy_j_mm": bead_mm * (process.line_energy_j_mm[0] / energy) ** 0.5,
            "the power that melts the wire (process.melting_efficiency, process.dilution)": melting_mm,
        },
    )
