"""Limits of the gates that a run has set wider than the default ones, and data of a material that are not its own.

A gate that passes under them proves less than its name says."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ebamcheck.nc.conventions import power_slack_w
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.materials import MaterialSettings, preset

WIDER_IF_GREATER = (
    "comparison.tolerance_mm", "comparison.evidence_share", "comparison.doubt_mm", "curves.largest_lift_mm",
    "curves.largest_bulge_mm", "curves.section_tolerance_mm", "scan.gap_width", "process.mass_tolerance",
    "process.inside_tolerance", "process.edge_tolerance", "process.outside_share", "process.outside_reach_mm",
    "process.longest_wait_s", "process.wire_speed_max_mm_s", "process.melting_efficiency", "machine.smoothing_tolerance_mm",
)  # fmt: skip
WIDER_IF_LESS = (
    "scan.least_coverage", "process.wire_speed_min_mm_s", "process.dilution", "machine.clearance_mm",
)  # fmt: skip
# Settings that are a least and a greatest value.
WINDOWS = (
    "process.layer_over_bead", "process.line_energy_j_mm", "process.voltage_window_kv", "process.current_window_ma",
    "process.travel_window_mm_s", "process.bead_section_mm2", "process.metal_energy_j_mm3",
)  # fmt: skip
OF_PREHEATING = ("preheat.over_k", "preheat.evenness_k")  # Limits of a preheating, where there is one
MOST_SLACK = 0.01  # Share of the power that increments may change unsaid: no check of the power sees less
TOLD = 4  # Settings that are told by name


def loose_limits(config: Config) -> Iterator[Check]:
    """Tell which limits are wider than the default ones, each with both values, and which data of a known material are others."""
    yield from _other_material(config)
    found = [*_wider(config), *_wider_than_derived(config)]
    if found:
        text = f"gates are judged by limits wider than the default ones: {_first(found)}"
        remedy = "say why on the certificate, or go back to the default limits"
        place, count = found[0].split()[0], float(len(found))
        yield Check.finding("warning", "limit-widened", text, place, count, 0.0, "limits", remedy)


def _first(found: list[str]) -> str:
    """The first of some texts, and how many there are more."""
    return ", ".join(found[:TOLD]) + (f" and {len(found) - TOLD} more" if len(found) > TOLD else "")


def _wider(config: Config) -> Iterator[str]:
    """Limits that are wider than by default, and windows that reach beyond the default ones on either side."""
    greater = WIDER_IF_GREATER + (OF_PREHEATING if config.preheat.when != "off" else ())
    for names, sign in ((greater, 1.0), (WIDER_IF_LESS, -1.0)):
        for name in names:
            value, default = _value(config, name), _value(Config(), name)
            if sign * (value - default) > 0.0:
                yield f"{name} {value:g} (default {default:g})"

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
        names = ("power_increment_w", "current_increment_ma", "voltage_increment_kv")
        name = next(n for n in names if getattr(config.machine, n))
        yield f"machine.{name} {getattr(config.machine, name):g} (the power may be {100.0 * slack:.3g} % off for it)"


def _other_material(config: Config) -> Iterator[Check]:
    """Data beside the name of a known material that are not those of that material: heat and melting are judged by them."""
    material = config.material
    if preset(material.name) is None:
        return
    usual = MaterialSettings(name=material.name)
    others = []
    for name in MaterialSettings.model_fields:
        value, known = getattr(material, name), getattr(usual, name)
        if value != known:
            both = isinstance(value, float) and isinstance(known, float)
            others.append(f"material.{name}" + (f" {value:g} (usual {known:g})" if both else ""))
    if others:
        text = f"heat and melting are judged by data that are not those of {material.name}: {_first(others)}"
        remedy = "say where they come from on the certificate, or leave them out"
        place, count = others[0].split()[0], float(len(others))
        yield Check.finding("warning", "material-data", text, place, count, 0.0, "values", remedy)


def _value(config: Config, name: str) -> Any:
    section, _, key = name.partition(".")
    return getattr(getattr(config, section), key)
