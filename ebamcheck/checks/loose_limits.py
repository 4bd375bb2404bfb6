"""Limits of the gates that a run has set wider than the default ones, and data of a material that are not its own.

A gate that passes under them proves less than its name says.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ebamcheck.nc.increments import power_slack_w
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.materials import MaterialSettings, preset

WIDER_IF_GREATER = (
    "comparison.tolerance_mm",
    "comparison.evidence_share",
    "comparison.doubt_mm",
    "curves.largest_lift_mm",
    "curves.largest_bulge_mm",
    "curves.section_tolerance_mm",
    "scan.gap_width",
    "process.mass_tolerance",
    "process.inside_tolerance",
    "process.edge_tolerance",
    "process.outside_share",
    "process.outside_reach_mm",
    "process.longest_wait_s",
    "process.wire_speed_max_mm_s",
    "process.melting_efficiency",
    "machine.smoothing_tolerance_mm",
)
# Settings that gates and checks rest on and that no motion is made of, by the way in which they let more pass.
WIDER_IF_LESS = (
    "scan.least_coverage",
    "process.wire_speed_min_mm_s",
    "process.dilution",
    "machine.clearance_mm",
)
# Settings that are a least and a greatest value.
WINDOWS = (
    "process.layer_over_bead",
    "process.line_energy_j_mm",
    "process.voltage_window_kv",
    "process.current_window_ma",
    "process.travel_window_mm_s",
    "process.bead_section_mm2",
    "process.metal_energy_j_mm3",
)
OF_PREHEATING = ("preheat.over_k", "preheat.evenness_k")  # Limits of a preheating, where there is one
# Share of the power that the increments of a control may change unsaid: no check of the power sees less.
MOST_SLACK = 0.01
TOLD = 4  # Settings that are told by name


def loose_limits(config: Config) -> Iterator[Check]:
    """Tell which limits are wider than the default ones, each with both values, and which data of a known material are others.

    Nothing where neither is.
    """
    yield from _other_material(config)
    found = [*_wider(config), *_wider_windows(config), *_wider_than_derived(config)]
    if not found:
        return
    more = f" and {len(found) - TOLD} more" if len(found) > TOLD else ""
    yield Check.finding(
        "warning",
        "limit-widened",
        f"gates are judged by limits wider than the default ones: {', '.join(found[:TOLD])}{more}",
        found[0].split()[0],
        float(len(found)),
        0.0,
        "limits",
        "say why on the certificate, or go back to the default limits",
    )


def _wider(config: Config) -> Iterator[str]:
    """Single limits that are wider than by default."""
    greater = WIDER_IF_GREATER + (OF_PREHEATING if config.preheat.when != "off" else ())
    for names, sign in ((greater, 1.0), (WIDER_IF_LESS, -1.0)):
        for name in names:
            value, default = _value(config, name), _value(Config(), name)
            if sign * (value - default) > 0.0:
                yield f"{name} {value:g} (default {default:g})"


def _wider_windows(config: Config) -> Iterator[str]:
    """Windows that reach beyond the default ones on either side."""
    for name in WINDOWS:
        (low, high), (least, greatest) = _value(config, name), _value(Config(), name)
        if low < least or high > greatest:
            yield f"{name} {low:g} .. {high:g} (default {least:g} .. {greatest:g})"


def _wider_than_derived(config: Config) -> Iterator[str]:
    """Limits whose default follows from other settings."""
    process, material = config.process, config.material
    unevenness_mm, half_mm = process.largest_unevenness_mm, 0.5 * process.bead_width_mm
    if unevenness_mm > half_mm:
        yield f"process.surface_tolerance_mm {unevenness_mm:g} (default {half_mm:g})"
    hottest_k, melts_k = process.interpass_limit_k, material.interpass_limit_k
    if hottest_k is not None and hottest_k > melts_k:
        yield f"process.interpass_limit_k {hottest_k:g} (of the material {melts_k:g})"
    if process.interpass_at != "bead":
        yield f"process.interpass_at {process.interpass_at} (default bead)"
    slack = power_slack_w(config.machine, process.voltage_kv, process.current_ma) / process.power_w
    if slack > MOST_SLACK:
        name = next(
            n
            for n in ("power_increment_w", "current_increment_ma", "voltage_increment_kv")
            if getattr(config.machine, n)
        )
        yield f"machine.{name} {getattr(config.machine, name):g} (the power may be {100.0 * slack:.3g} % off for it)"


def _other_material(config: Config) -> Iterator[Check]:
    """Data beside the name of a known material that are not those of that material: heat and melting are judged by them."""
    material = config.material
    if preset(material.name) is None:
        return
    usual = MaterialSettings(name=material.name)
    others = [
        name for name in MaterialSettings.model_fields if getattr(material, name) != getattr(usual, name)
    ]
    if not others:
        return
    told = [f"material.{name}{_both(getattr(material, name), getattr(usual, name))}" for name in others]
    more = f" and {len(told) - TOLD} more" if len(told) > TOLD else ""
    yield Check.finding(
        "warning",
        "material-data",
        f"heat and melting are judged by data that are not those of {material.name}: {', '.join(told[:TOLD])}{more}",
        f"material.{others[0]}",
        float(len(others)),
        0.0,
        "values",
        "say where they come from on the certificate, or leave them out",
    )


def _both(value: object, usual: object) -> str:
    """Both values of a number; nothing of a table or a text."""
    return f" {value:g} (usual {usual:g})" if isinstance(value, float) and isinstance(usual, float) else ""


def _value(config: Config, name: str) -> Any:
    section, _, key = name.partition(".")
    return getattr(getattr(config, section), key)
