"""Blocks that bring the machine to a known state before a layer, and to a safe one at the end.

Every layer begins with them, so that a program can be entered at any layer: nothing that holds in it depends on what ran
before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ebamcheck.nc.codes import BEAM_VALUES
from ebamcheck.nc.safe_end import safe_end_mm
from ebamcheck.nc.templates import ProcessValues
from ebamcheck.settings.config import Config
from ebamcheck.writing.blocks import BlockFormat

Templates = Mapping[str, tuple[str, ...]]


def start_blocks(modes: Sequence[str], values: ProcessValues, templates: Templates) -> list[str]:
    """Blocks that begin a program: modes, wire and beam off, and the values of the beam."""
    return [*modes, *_filled(("wire_stop", "beam_off", "set_beam"), values, templates)]


def entry_blocks(modes: Sequence[str], values: ProcessValues, templates: Templates) -> list[str]:
    """Blocks that begin a layer: modes, and the values of the beam."""
    return [*modes, *_filled(("set_beam",), values, templates)]


def off_blocks(values: ProcessValues, templates: Templates) -> list[str]:
    """Blocks that command wire and beam off."""
    return _filled(("wire_stop", "beam_off"), values, templates)


def _filled(names: Sequence[str], values: ProcessValues, templates: Templates) -> list[str]:
    return [line for name in names for line in values.fill(name, templates[name])]


def end_blocks(
    top_mm: float, values: ProcessValues, config: Config, form: BlockFormat, templates: Templates
) -> list[str]:
    """Wire and beam off, their values 0, up over all that stands, and to the place where the tool is parked."""
    off = replace(values, power_w=0.0, voltage_kv=0.0, current_ma=0.0, wire_mm_s=0.0)
    names = ["wire_stop", "beam_off", "set_wire", "set_beam"]
    if not any(f"{{{value}" in line for value in BEAM_VALUES for line in templates["set_beam"]):
        names.append("set_power")
    x, y = config.machine.park_position_mm
    return [
        *_filled(names, off, templates),
        f"G0 Z{form.value(safe_end_mm(top_mm, config))}",
        f"G0 X{form.value(x)} Y{form.value(y)}",
    ]
