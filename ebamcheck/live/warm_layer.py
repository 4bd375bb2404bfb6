"""Preheating of layers that are released one by one: the scan is part of the layer's file, and goes over what stands under it."""

from __future__ import annotations

from ebamcheck.program.checking.text_heat import scans_of
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.scan.plan.preheated import asked_for
from ebamcheck.settings.config import Config


def preheated_in_layers(config: Config) -> Config:
    """Settings of layers that are released one by one: a scan that preheats is part of its layer's file."""
    if config.preheat.when == "off":
        return config
    return config.model_copy(update={"preheat": config.preheat.model_copy(update={"scan_in": "layer"})})


def height_under_mm(config: Config) -> float | None:
    """Height over the plate at which the section of what a layer lies on is taken, half a layer under its bottom.

    None where nothing is preheated there.
    """
    if config.base_mm == 0.0 or not asked_for(0, config):
        return None
    return max(config.base_mm - 0.5 * config.layer_height_mm, 0.0)


def scan_seconds(program: NCProgram, config: Config) -> float:
    """Time of the scan of a layer's program, with its wait."""
    return sum(float(way.time_s.sum()) for way in scans_of(program, config).values())
