"""Comment block at the head of a program: what made it, from what, and how to read it."""

from __future__ import annotations

from collections.abc import Mapping

from ebamcheck.pipeline.run_folder import sha256_of_json
from ebamcheck.program.language.dialects import LINUXCNC, SINUMERIK
from ebamcheck.program.language.templates import plain
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings
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


def form_lines(machine: MachineSettings, control: str) -> dict[str, str]:
    """``KEY: VALUE`` lines that say how a control is given curves, and how far it may leave the path."""
    if control == SINUMERIK:
        return _sinumerik_form(machine)
    g1 = machine.curve_form == "lines"
    within = f"{'G1' if g1 else 'G2 and G3'}, within {machine.line_tolerance_mm:g} mm"
    if control != LINUXCNC:
        return {"CURVES": within}
    tolerance = plain(machine.smoothing_tolerance_mm)
    return {
        "CURVES": within if machine.curve_form in ("arcs", "lines") else "G5, exactly",
        "SMOOTHING": f"G64 P{tolerance}, path may leave the program by {tolerance} mm",
    }


def _sinumerik_form(machine: MachineSettings) -> dict[str, str]:
    values = {
        "CURVES": machine.curve_form,
        "POLY": "PL=1 in every block, coefficients over 0 .. 1",
        "SMOOTHING": f"{' '.join(machine.smoothing)}, path may leave the program by "
        f"{machine.smoothing_tolerance_mm:g} mm",
    }
    if machine.curve_form in ("arcs", "lines"):
        values["CURVES"] += f", within {machine.line_tolerance_mm:g} mm"
    elif machine.curve_form == "bspline" and machine.bspline_shift == "uniform":
        values["BSPLINE CONVENTION"] = "uniform, no PL, U clamped with even intervals, other splines as POLY"
    elif machine.curve_form == "bspline":
        s = machine.bspline_shift
        values["BSPLINE CONVENTION"] = f"s={s}, block i carries PL = U(i+{s}) - U(i+{int(s) - 1}), U clamped"
        values["BSPLINE NOTE"] = (
            "PL=0 in the end blocks and at repeated knots is outside the range documented for PL, "
            "prove on the control"
        )
    return values
