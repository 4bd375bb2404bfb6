"""Where a program ends, and where it preheats: clear of all that stands, within the travel of the machine."""

from __future__ import annotations

from ebamcheck.settings.config import Config


def safe_end_mm(top_mm: float, config: Config) -> float:
    """Z at which a program ends: over its last layer by the safe height, over clamps by the clearance, within the travel."""
    machine = config.machine
    clamps = (zone.z_mm[1] + machine.clearance_mm for zone in config.process.keep_out)
    tops = [top_mm + machine.safe_height_mm, *clamps]
    return max(tops[0], min(max(tops), machine.travel_max_mm[2]))
