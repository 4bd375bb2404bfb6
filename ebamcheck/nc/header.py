"""Comment block at the head of a program: what made it, from what, and how to read it."""

from __future__ import annotations

from ebamcheck.json_values import sha256_of_json
from ebamcheck.nc.control import Control
from ebamcheck.settings.config import Config
from ebamcheck.version import __version__


def header_lines(config: Config, control: Control, layers: int) -> dict[str, str]:
    """``KEY: VALUE`` lines of a program for a control: those common to all, and its own on how curves are written."""
    machine, process, material = config.machine, config.process, config.material
    return {
        "SOFTWARE": f"ebamcheck {__version__}",
        "CONTROL": control.title or control.name,
        "MACHINE": machine.name,
        "SETTINGS SHA-256": sha256_of_json(config.model_dump()),
        "LAYERS": str(layers),
        "COORDINATES": "X Y of the part, Z 0 under its lowest point, Z at the top of the layer",
        **control.form_lines(machine),
        "BEAM": f"{process.power_w:g} W ({process.voltage_kv:g} kV, {process.current_ma:g} mA)",
        "WIRE": f"{material.name}, {process.wire_diameter_mm:g} mm, speed by mass balance with the layer height",
    }
