"""Where a program ends: over all that stands, within the travel of the machine."""

from __future__ import annotations

from ebamcheck.settings.config import Config


def safe_end_mm(top_mm: float, config: Config) -> float:
    """Z at which a program ends: over its last layer by the safe height, and over clamps, within the travel."""
    tops = [top_mm + config.machine.safe_height_mm, *(zone.z_mm[1] for zone in config.process.keep_out)]
    return max(tops[0], min(max(tops), config.machine.travel_max_mm[2]))
