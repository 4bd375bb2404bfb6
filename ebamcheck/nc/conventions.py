"""Conventions of every program, whatever its control: comments, header, numbers, and the height at which it ends."""

from __future__ import annotations

from collections.abc import Mapping

from ebamcheck.json_values import sha256_of_json
from ebamcheck.nc.control import Control
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings
from ebamcheck.version import __version__

LONGEST_COMMENT = 199  # Characters of a comment line; a SINUMERIK takes blocks of under 200


def comment(text: str) -> str:
    """Return one comment line: ASCII, without the reserved characters ! and ?, cut to the length of a block.

    >>> comment("PART: ready?")
    '; PART: ready_'
    """
    allowed = "".join(c if c.isascii() and c.isprintable() and c not in "!?;" else "_" for c in text)
    return f"; {allowed}"[:LONGEST_COMMENT]


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


DECIMALS = 6  # Decimals of a process value, trailing zeros left out


def plain(value: float) -> str:
    """Print a process value: no exponent, no trailing zeros, no negative zero.

    >>> plain(33.50), plain(-1e-9)
    ('33.5', '0')
    """
    text = f"{float(value):.{DECIMALS}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def safe_end_mm(top_mm: float, config: Config) -> float:
    """Z at which a program ends: over its last layer by the safe height, over clamps by the clearance, within the travel."""
    machine = config.machine
    clamps = (zone.z_mm[1] + machine.clearance_mm for zone in config.process.keep_out)
    tops = [top_mm + machine.safe_height_mm, *clamps]
    return max(tops[0], min(max(tops), machine.travel_max_mm[2]))


def increments_of(machine: MachineSettings) -> dict[str, float]:
    """Increment of each process value by the name of its placeholder, of those that have one."""
    every = {
        "feed_mm_min": machine.feed_increment_mm_min, "power_w": machine.power_increment_w,
        "voltage_kv": machine.voltage_increment_kv, "current_ma": machine.current_increment_ma,
        "wire_mm_s": machine.wire_increment_mm_s,
    }  # fmt: skip
    return {name: increment for name, increment in every.items() if increment > 0.0}


def to_increment(value: float, increment: float) -> float:
    """Round a value to the nearest multiple of an increment; what is not 0 does not become 0. An increment of 0 leaves it."""
    if increment <= 0.0 or value == 0.0:
        return value
    return max(round(value / increment), 1) * increment


def power_slack_w(machine: MachineSettings, voltage_kv: float, current_ma: float) -> float:
    """By how much the beam's power may differ for the increments of its values: half a step of each."""
    found: Mapping[str, float] = increments_of(machine)
    product = found.get("voltage_kv", 0.0) * current_ma + found.get("current_ma", 0.0) * voltage_kv
    return 0.5 * max(product, found.get("power_w", 0.0))
