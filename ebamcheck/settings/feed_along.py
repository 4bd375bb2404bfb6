"""The feed along a bead where the feeder alone cannot give it its wire: as much slower or faster as the wire is short or too much.

Wire over feed is the metal of a bead: where the wire stands at a limit of its feeder, the feed does what is left, within the windows of
feed, travel and line energy of the process.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import line_energy_j_mm

SHARE_DIGITS = 6
"""Decimals of a feed over that of the process."""


def speed_window(config: Config, power_share: float = 1.0) -> tuple[float, float]:
    """Least and greatest feed over that of the process, by the windows of feed, travel and line energy, at a share of the power.

    Examples
    --------
    >>> [round(share, 3) for share in speed_window(Config())]
    [0.24, 4.8]
    """
    process, machine = config.process, config.machine
    usual, energy = process.travel_speed_mm_s, power_share * line_energy_j_mm(config)
    low = max(
        machine.feed_min_mm_s / usual,
        process.travel_window_mm_s[0] / usual,
        energy / process.line_energy_j_mm[1],
    )
    high = min(
        machine.feed_max_mm_s / usual,
        process.travel_window_mm_s[1] / usual,
        energy / process.line_energy_j_mm[0],
    )
    return low, high


def along_window(config: Config, power_share: float = 1.0) -> tuple[float, float]:
    """Least and greatest feed along a bead over that of the process; 1 and 1 where the feed stays (``process.feed_along_path``)."""
    if not config.process.feed_along_path:
        return 1.0, 1.0
    low, high = speed_window(config, power_share)
    return min(low, 1.0), max(high, 1.0)


def feed_shares(wire_mm_s: Floats, config: Config, power_share: float = 1.0) -> Floats:
    """Feed over that of the process for beads that would take wire (n,) at it; the wire is then as much less or more.

    Examples
    --------
    >>> fast = Config().changed(process={"feed_along_path": True})
    >>> feed_shares(np.array([50.0, 125.0, 12.5]), fast).tolist()
    [1.0, 0.8, 1.333333]
    """
    process, (low, high) = config.process, along_window(config, power_share)
    with np.errstate(divide="ignore"):
        within = np.clip(wire_mm_s, process.wire_speed_min_mm_s, process.wire_speed_max_mm_s)
        share = np.where(wire_mm_s > 0.0, within / np.maximum(wire_mm_s, 1e-12), 1.0)
    return np.round(np.clip(share, low, high), SHARE_DIGITS)


def wire_at(wire_mm_s: Floats, shares: Floats, config: Config) -> Floats:
    """Wire (n,) of beads whose feed is changed: at the limit of its feeder, to which the rounding of the feed is nothing."""
    process = config.process
    limited = np.clip(wire_mm_s * shares, process.wire_speed_min_mm_s, process.wire_speed_max_mm_s)
    return np.where(shares != 1.0, limited, wire_mm_s)
