"""A layer of a turned part on a machine whose program turns the table: its settings, and what its certificate tells of the table."""

from __future__ import annotations

from typing import Any

from ebamcheck.mesh.on_table import on_table
from ebamcheck.mesh.part import Part
from ebamcheck.program.language.tilt_rules import checked_tilt
from ebamcheck.program.writing.blocks import BlockFormat
from ebamcheck.program.writing.tilt_text import Tilt, tilt_of
from ebamcheck.settings.config import Config


def tilted(before: Part, now: Part, config: Config, built_mm: float = 0.0) -> Config:
    """Settings of layers of a part that was built up to a height and is turned by the table; those given where the user turns it.

    Raises
    ------
    SettingsError
        If the control has no frames, or the table cannot turn the part so.
    """
    if not config.machine.rotary:
        return config
    part = config.part.model_copy(update={"on_table": on_table(before, now, built_mm)})
    config = config.model_copy(update={"part": part})
    checked_tilt(config, config.machine.control)
    tilt_of_config(config)
    return config


def tilt_of_config(config: Config) -> Tilt | None:
    """How the program turns the table; None where it turns none."""
    return tilt_of(config, BlockFormat(config.machine.printed_decimals))


def told_of_table(config: Config) -> dict[str, Any]:
    """What a certificate tells of a table: positions of its axes, zero and turn of the frame; nothing where nothing is turned."""
    tilt = tilt_of_config(config)
    if tilt is None:
        return {}
    names = [axis.name for axis in config.machine.rotary]
    return {
        "table": {
            "positions_deg": dict(zip(names, tilt.positions_deg, strict=True)),
            "frame_zero_mm": tilt.zero_mm.tolist(),
            "frame_turn_deg": tilt.turn_deg,
            "turns_at_z_mm": tilt.up_mm,
        }
    }
