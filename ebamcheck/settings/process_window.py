"""The process window: what wire, beam and layers a profile allows, held against the settings before anything is sliced; and the
feed along a bead."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Floats
from ebamcheck.result import Check, Severity
from ebamcheck.settings.config import Config

# Layer heights over that of one bead at which wire and beam need no trial: as far as published parameters of one machine vary; nominal
USUAL_OVER_BEAD = (0.75, 1.25)
# Greatest width of a bead over the spacing: it stands that much higher over the layer than its neighbours, which the next layer still melts
MOST_SPACINGS = 1.6
# Lines of one island whose ends are at most this many bead spacings apart are joined with the beam on: the turn is part of the melt pool,
# and a border at 60 degrees makes it 1.15 spacings long
TURN_SPACINGS = 1.5
ROUNDING = 1e-9  # of a ratio of floats


def wire_area_mm2(config: Config) -> float:
    """Section of the wire, mm2."""
    return math.pi * config.process.wire_diameter_mm**2 / 4.0


def wire_speed_mm_s(config: Config, width_mm: float, thickness_mm: float) -> float:
    """Wire speed of a bead that lays a width times the layer's height: ``v_wire pi d^2 / 4 = v_travel b h``.

    >>> round(wire_speed_mm_s(Config(), 4.0, 1.6755), 2)
    33.33
    """
    return config.process.travel_speed_mm_s * width_mm * thickness_mm / wire_area_mm2(config)


def nominal_wire_speed_mm_s(config: Config, layer_mm: float) -> float:
    """Wire speed of hatch lines, one spacing wide, in a layer of this height."""
    return wire_speed_mm_s(config, config.process.hatch_spacing_mm, layer_mm)


def line_energy_j_mm(config: Config) -> float:
    """Energy of the beam along a bead, P / v, J/mm."""
    return config.process.power_w / config.process.travel_speed_mm_s


def least_window_share(config: Config) -> float:
    """Share of the power under which its line energy, its current, or its energy for the wire of a bead leaves the process window.

    >>> round(least_window_share(Config(process={"line_energy_j_mm": (180.0, 3000.0)})), 3)
    0.25
    """
    process = config.process
    metal_mm3_s = wire_area_mm2(config) * nominal_wire_speed_mm_s(config, config.layer_height_mm)
    return max(
        process.line_energy_j_mm[0] / line_energy_j_mm(config),
        process.current_window_ma[0] / process.current_ma,
        process.metal_energy_j_mm3[0] * metal_mm3_s / process.power_w,
    )


def least_wall_mm(config: Config) -> float:
    """Thinnest wall that beads can lay: the one set, else the bead's width at the least wire speed, to which it is proportional."""
    process = config.process
    if process.least_wall_mm is not None:
        return process.least_wall_mm
    share = process.wire_speed_min_mm_s / nominal_wire_speed_mm_s(config, config.layer_height_mm)
    return process.bead_width_mm * min(share, 1.0)


def least_hole_mm(config: Config) -> float:
    """Narrowest hole that stays open: the one set, else the width of one bead, which bridges it."""
    return config.process.least_hole_mm or config.process.bead_width_mm


def layer_steps_mm(config: Config) -> list[tuple[str, float]]:
    """Heights of the layers that the settings ask for, each with the name of its setting; of listed cuts the steps from one to the
    next."""
    heights = config.layers.heights_mm
    if len(heights) < 2:
        named = "layers.layer_height_mm" if config.layers.layer_height_mm else "process.wire_speed_mm_s"
        return [(named, config.layer_height_mm)]
    return [(f"layers.heights_mm, layer {k}", b - a) for k, (a, b) in enumerate(pairwise(heights), 1)]


def outside_window(config: Config, severity: Severity = "fault") -> Iterator[Check]:
    """Settings outside of the process window, each with its limit and what to do; none where the profile is kept."""
    for setting, layer_mm in layer_steps_mm(config):
        if layer_mm > 0.0:  # heights that do not rise have an error of their own
            yield from _layer(config, severity, setting, layer_mm)
    process, energy = config.process, line_energy_j_mm(config)
    of_energy = "process.voltage_kv x current_ma / travel_speed_mm_s give"
    to_change = "change the current or the travel speed"
    for place, told, value, window, unit, remedy in (
        ("voltage_kv", "", process.voltage_kv, "voltage_window_kv", "kV", ""),
        ("current_ma", "", process.current_ma, "current_window_ma", "mA", ""),
        ("travel_speed_mm_s", "", process.travel_speed_mm_s, "travel_window_mm_s", "mm/s", ""),
        ("travel_speed_mm_s", of_energy, energy, "line_energy_j_mm", "J/mm", to_change),
    ):
        if (limit := _broken(value, getattr(process, window))) is not None:
            told = told or f"process.{place} is"
            text = f"{told} {value:.4g} {unit}, {_beyond(value, limit)} {limit:g} {unit} (process.{window})"
            where, remedy = f"process.{place}", remedy or f"change process.{place}"
            yield Check.finding(severity, "process-limit", text, where, value, limit, unit, remedy)


def checked_window(config: Config) -> None:
    """Refuse settings outside of the process window."""
    for found in outside_window(config):
        raise SettingsError(f"{found.text}: {found.remedy}")


def unusual_layers(config: Config) -> Iterator[Check]:
    """Tell of layer heights within the window and far from that of one bead: the farthest of them."""
    bead = config.process.bead_height_mm
    setting, layer_mm = max(layer_steps_mm(config), key=lambda step: abs(step[1] - bead))
    ratio = layer_mm / bead
    limit = _broken(ratio, USUAL_OVER_BEAD)
    if limit is not None and _broken(ratio, config.process.layer_over_bead) is None:
        text = f"a layer of {layer_mm:.4g} mm is {ratio:.3g} of the height of one bead ({bead:.4g} mm)"
        remedy = "try wire and beam on a bead of this height first"
        yield Check.finding("note", "layer-over-bead", text, setting, ratio, limit, "of the bead", remedy)


def _layer(config: Config, severity: Severity, setting: str, layer_mm: float) -> Iterator[Check]:
    process = config.process
    ratio, wire = layer_mm / process.bead_height_mm, nominal_wire_speed_mm_s(config, layer_mm)
    low, high = allowed_layers_mm(config)
    remedy = (
        f"choose a layer height from {low:.3g} to {high:.3g} mm, or another bead"
        if low <= high
        else "choose another wire, bead or travel speed: no layer height suits these"
    )
    if (limit := _broken(ratio, process.layer_over_bead)) is not None:
        text = (
            f"{setting}: {layer_mm:.6g} mm is {ratio:.3g} times the height of one bead ({process.bead_height_mm:.4g} mm), "
            f"{_beyond(ratio, limit)} {limit:g} (process.layer_over_bead)"
        )
        yield Check.finding(severity, "process-limit", text, setting, ratio, limit, "of the bead", remedy)
        return
    least, greatest = process.wire_speed_min_mm_s, process.wire_speed_max_mm_s
    if (limit := _broken(wire, (least, greatest))) is not None:
        name = "wire_speed_min_mm_s" if limit == least else "wire_speed_max_mm_s"
        text = (
            f"{setting}: layers of {layer_mm:.6g} mm take {wire:.4g} mm/s of wire, {_beyond(wire, limit)} {limit:.4g} mm/s "
            f"(process.{name})"
        )
        yield Check.finding(severity, "process-limit", text, setting, wire, limit, "mm/s", remedy)


def allowed_layers_mm(config: Config) -> tuple[float, float]:
    """Least and greatest layer height within the process window, mm."""
    process = config.process
    per_mm = nominal_wire_speed_mm_s(config, 1.0)
    low, high = (share * process.bead_height_mm for share in process.layer_over_bead)
    return max(low, process.wire_speed_min_mm_s / per_mm), min(high, process.wire_speed_max_mm_s / per_mm)


def _broken(value: float, limits: tuple[float, float]) -> float | None:
    """Return the limit that a value breaks; None where it keeps both."""
    low, high = limits
    if not value >= low * (1.0 - ROUNDING):
        return low
    return high if value > high * (1.0 + ROUNDING) else None


def _beyond(value: float, limit: float) -> str:
    return "over" if value > limit else "under"


SHARE_DIGITS = 6  # decimals of a feed over that of the process


def speed_window(config: Config, power_share: float = 1.0) -> tuple[float, float]:
    """Least and greatest feed over that of the process, by the windows of feed, travel and line energy, at a share of the power.

    >>> [round(share, 3) for share in speed_window(Config())]
    [0.24, 4.8]
    """
    process, machine = config.process, config.machine
    usual, energy = process.travel_speed_mm_s, power_share * line_energy_j_mm(config)
    (slow, fast), (least, most) = process.travel_window_mm_s, process.line_energy_j_mm
    low = max(machine.feed_min_mm_s / usual, slow / usual, energy / most)
    return low, min(machine.feed_max_mm_s / usual, fast / usual, energy / least)


def along_window(config: Config, power_share: float = 1.0) -> tuple[float, float]:
    """Least and greatest feed along a bead over that of the process; 1 and 1 where the feed stays (``process.feed_along_path``)."""
    if not config.process.feed_along_path:
        return 1.0, 1.0
    low, high = speed_window(config, power_share)
    return min(low, 1.0), max(high, 1.0)


def feed_shares(wire_mm_s: Floats, config: Config, power_share: float = 1.0) -> Floats:
    """Feed over that of the process for beads that would take wire (n,) at it; the wire is then as much less or more.

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
