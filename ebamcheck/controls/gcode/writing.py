"""Post-processors for controls that take one file: LinuxCNC (G5, arcs, lines) and plain G-code (arcs, lines).

Sources: LinuxCNC G-code reference (G5 carries a cubic span as ``I J P Q``, from the start to the second Bezier
point and from the end to the third; G64 P is the tolerance of the path; G91.1 makes I and J relative).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ebamcheck.controls.gcode.control import LINUXCNC, PLAIN_GCODE
from ebamcheck.nc.control import Control
from ebamcheck.nc.conventions import comment, header_lines, plain
from ebamcheck.nc.files import NOT_VALIDATED, VALIDATED, ProgramFiles, write_files
from ebamcheck.nc.inputs import CurveColumns, ScanColumns, interpass_of
from ebamcheck.nc.templates import process_values, usable_templates
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import driven_path
from ebamcheck.writing.blocks import BlockFormat
from ebamcheck.writing.layer_text import (
    layer_blocks,
    motion_text,
)
from ebamcheck.writing.safe_states import end_blocks, start_blocks
from ebamcheck.writing.segments import CUBIC, Form
from ebamcheck.writing.tracks import Toolpath


def write_linuxcnc(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: str | Path,
    *,
    validated: bool = False,
    header: Mapping[str, str] | None = None,
    path: Toolpath | None = None,
) -> ProgramFiles:
    """Write one ``.ngc`` file: splines as G5, exactly, unless ``machine.curve_form`` asks for arcs or lines.

    Takes and raises what :func:`ebamcheck.controls.sinumerik.writing.write_program` does.
    """
    machine = config.machine
    forms: Mapping[str, Form] = {"arcs": "arcs", "lines": "chords"}
    form = forms.get(machine.curve_form, "cubics")
    tolerance = plain(machine.smoothing_tolerance_mm)
    modes = ["G17 G21 G90 G91.1 G94", "G40 G49 G80", "G92.1", machine.work_offset, f"G64 P{tolerance}"]
    return _write(curves, plan, config, Path(folder), LINUXCNC, form, modes, validated, header, path)


def write_plain_gcode(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: str | Path,
    *,
    validated: bool = False,
    header: Mapping[str, str] | None = None,
    path: Toolpath | None = None,
) -> ProgramFiles:
    """Write one ``.gcode`` file of G0 to G3: splines as arcs within ``machine.line_tolerance_mm``, or as lines.

    Takes and raises what :func:`ebamcheck.controls.sinumerik.writing.write_program` does.
    """
    machine = config.machine
    form: Form = "chords" if machine.curve_form == "lines" else "arcs"
    modes = ["G17 G21 G90 G94", "G40 G49 G80", "G92.1", machine.work_offset]
    return _write(curves, plan, config, Path(folder), PLAIN_GCODE, form, modes, validated, header, path)


def _write(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: Path,
    control: Control,
    splines: Form,
    modes: list[str],
    validated: bool,
    header: Mapping[str, str] | None,
    path: Toolpath | None,
) -> ProgramFiles:
    lines = one_file(curves, plan, config, control, splines, modes, validated, header or {}, path)
    name = f"{config.machine.program_name}{control.suffixes[0].lower()}"
    text = "\n".join([comment(config.machine.program_name), *lines, "M2"]) + "\n"
    return write_files({name: text}, folder, validated=validated)


def one_file(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    control: Control,
    splines: Form,
    modes: list[str],
    validated: bool,
    header: Mapping[str, str],
    path: Toolpath | None = None,
) -> list[str]:
    """Lines of a program that is one file, from its status to the place where the tool is parked."""
    templates = usable_templates(config, control.name)
    form = BlockFormat(config.machine.printed_decimals)
    path = path or driven_path(curves, plan, config, form.decimals, splines, config.machine.line_tolerance_mm)
    at = path.kind == CUBIC
    motions = motion_text(path, form, form.beziers(path.bezier, path.segment_start[at], path.end[at]))
    heat = interpass_of(plan, config)
    values, top = process_values(config, 1, *_first(path)), float(path.z[-1]) if len(path.z) else 0.0
    lines = [
        VALIDATED if validated else NOT_VALIDATED,
        *_comments(config, control, path, header),
        *start_blocks(modes, values, templates),
    ]
    for k in range(len(path.z)):
        message = [f"(MSG, LAYER {k + 1} OF {len(path.z)})"] if control is LINUXCNC else []
        lines += layer_blocks(path, k, motions, config, form, templates, heat, [*modes, *message])
    return [*lines, *end_blocks(top, values, config, form, templates)]


def _comments(config: Config, control: Control, path: Toolpath, header: Mapping[str, str]) -> list[str]:
    every = header_lines(config, control, len(path.z)) | dict(header)
    return [comment(f"{key}: {value}") for key, value in every.items()]


def _first(path: Toolpath) -> tuple[float, float]:
    first = float(path.z[0]) if len(path.z) else 0.0
    return first, first
