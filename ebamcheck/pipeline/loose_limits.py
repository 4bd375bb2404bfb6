"""Limits of the gates that a run has set wider than the default ones: a gate that passes under them proves less than its name says."""

from __future__ import annotations

from collections.abc import Iterator

from ebamcheck.findings import Finding
from ebamcheck.settings.config import Config

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
)
WIDER_IF_LESS = ("scan.least_coverage",)
"""Settings that are limits and nothing else, by the way in which they let more pass."""

TOLD = 4
"""Settings that are told by name."""


def loose_limits(config: Config) -> Iterator[Finding]:
    """Tell which limits are wider than the default ones, each with both values; nothing where none is."""
    usual = Config()
    found = [
        f"{name} {value:g} (default {default:g})"
        for names, sign in ((WIDER_IF_GREATER, 1.0), (WIDER_IF_LESS, -1.0))
        for name in names
        if sign * ((value := _value(config, name)) - (default := _value(usual, name))) > 0.0
    ]
    unevenness_mm, half_mm = config.process.largest_unevenness_mm, 0.5 * config.process.bead_width_mm
    if unevenness_mm > half_mm:
        found.append(f"process.surface_tolerance_mm {unevenness_mm:g} (default {half_mm:g})")
    hottest_k, melts_k = config.process.interpass_limit_k, config.material.interpass_limit_k
    if hottest_k is not None and hottest_k > melts_k:
        found.append(f"process.interpass_limit_k {hottest_k:g} (of the material {melts_k:g})")
    if not found:
        return
    more = f" and {len(found) - TOLD} more" if len(found) > TOLD else ""
    yield Finding(
        "warning",
        "limit-widened",
        f"gates are judged by limits wider than the default ones: {', '.join(found[:TOLD])}{more}",
        found[0].split()[0],
        float(len(found)),
        0.0,
        "limits",
        "say why on the certificate, or go back to the default limits",
    )


def _value(config: Config, name: str) -> float:
    section, _, key = name.partition(".")
    return float(getattr(getattr(config, section), key))
