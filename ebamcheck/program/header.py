"""Comment block at the head of a program: what made it, from what, and how to read it."""

from __future__ import annotations

from collections.abc import Mapping

from ebamcheck.config import Config
from ebamcheck.program.dialects import SINUMERIK
from ebamcheck.store import sha256_of_json
from ebamcheck.version import __version__

CONTROL_NAMES: Mapping[str, str] = {SINUMERIK: "SINUMERIK 840D sl"}
"""What a header calls a control, where it is not the name of its post-processor."""


def header_lines(config: Config, control: str, layers: int, form: Mapping[str, str]) -> dict[str, str]:
    """``KEY: VALUE`` lines common to all controls; `form` says how curves are written."""
    machine, process, material = config.machine, config.process, config.material
    return {
        "SOFTWARE": f"ebamcheck {__version__}",
        "CONTROL": control,
        "MACHINE": machine.name,
        "SETTINGS SHA-256": sha256_of_json(config.model_dump()),
        "LAYERS": str(layers),
        "COORDINATES": "X Y of the part, Z 0 under its lowest point, Z at the top of the layer",
        **form,
        "BEAM": f"{process.power_w:g} W ({process.voltage_kv:g} kV, {process.current_ma:g} mA)",
        "WIRE": f"{material.name}, {process.wire_diameter_mm:g} mm, speed by mass balance with the layer height",
    }
