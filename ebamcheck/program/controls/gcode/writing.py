"""Post-processors for controls that take one file: LinuxCNC (G5, arcs, lines) and plain G-code (arcs, lines).

Sources: LinuxCNC G-code reference (G5 carries a cubic span as ``I J P Q``, from the start to the second Bezier
point and from the end to the third; G64 P is the tolerance of the path; G91.1 makes I and J relative).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ebamcheck.program.files import NOT_VALIDATED, VALIDATED, ProgramFiles, write_files
from ebamcheck.program.language.dialects import LINUXCNC, PLAIN
from ebamcheck.program.language.header import form_lines, header_lines
from ebamcheck.program.language.templates import plain, process_values, usable_templates
from ebamcheck.program.toolpath.bead_ends import driven_path
from ebamcheck.program.toolpath.inputs import CurveColumns, ScanColumns, interpass_of
from ebamcheck.program.toolpath.segments import CUBIC, Form
from ebamcheck.program.toolpath.tracks import Toolpath
from ebamcheck.program.writing.blocks import BlockFormat
from ebamcheck.program.writing.layer_text import comment, layer_blocks, motion_text
from ebamcheck.program.writing.safe_states import end_blocks, start_blocks
from ebamcheck.settings.config import Config


def write_linuxcnc(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: str | Path,
    *,
    validated: bool = False,
    header: Mapping[str, str] | None = None,
) -> ProgramFiles:
    """Write one ``.ngc`` file: splines as G5, exactly, unless ``machine.curve_form`` asks for arcs or lines.

    Takes and raises what :func:`ebamcheck.program.controls.sinumerik.writing.write_program` does.
    """
    machine = config.machine
    forms: Mapping[str, Form] = {"arcs": "arcs", "lines": "chords"}
    form = forms.get(machine.curve_form, "cubics")
    tolerance = plain(machine.smoothing_tolerance_mm)
    known = form_lines(machine, LINUXCNC)
    modes = ["G17 G21 G90 G91.1 G94", "G40 G49 G80", "G92.1", machine.work_offset, f"G64 P{tolerance}"]
    return _write(curves, plan, config, Path(folder), LINUXCNC, "ngc", form, known, modes, validated, header)


def write_plain_gcode(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: str | Path,
    *,
    validated: bool = False,
    header: Mapping[str, str] | None = None,
) -> ProgramFiles:
    """Write one ``.gcode`` file of G0 to G3: splines as arcs within ``machine.line_tolerance_mm``, or as lines.

    Takes and raises what :func:`ebamcheck.program.controls.sinumerik.writing.write_program` does.
    """
    machine = config.machine
    form: Form = "chords" if machine.curve_form == "lines" else "arcs"
    known = form_lines(machine, PLAIN)
    modes = ["G17 G21 G90 G94", machine.work_offset]
    return _write(curves, plan, config, Path(folder), PLAIN, "gcode", form, known, modes, validated, header)


def _write(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: Path,
    control: str,
    suffix: str,
    splines: Form,
    known: Mapping[str, str],
    modes: list[str],
    validated: bool,
    header: Mapping[str, str] | None,
) -> ProgramFiles:
    machine = config.machine
    templates = usable_templates(config, control)
    form = BlockFormat(machine.printed_decimals)
    path = driven_path(curves, plan, config, form.decimals, splines, machine.line_tolerance_mm)
    at = path.kind == CUBIC
    motions = motion_text(path, form, form.beziers(path.bezier, path.segment_start[at], path.end[at]))
    heat = interpass_of(plan, config)
    values, top = process_values(config, 1, *_first(path)), float(path.z[-1]) if len(path.z) else 0.0
    lines = [
        comment(machine.program_name),
        VALIDATED if validated else NOT_VALIDATED,
        *_comments(config, control, path, {**known, **(header or {})}),
        *start_blocks(modes, values, templates),
    ]
    for k in range(len(path.z)):
        message = [f"(MSG, LAYER {k + 1} OF {len(path.z)})"] if control == LINUXCNC else []
        lines += layer_blocks(path, k, motions, config, form, templates, heat, [*modes, *message])
    lines += [*end_blocks(top, values, config, form, templates), "M2"]
    text = "\n".join(lines) + "\n"
    return write_files({f"{machine.program_name}.{suffix}": text}, folder, validated=validated)


def _comments(config: Config, control: str, path: Toolpath, known: Mapping[str, str]) -> list[str]:
    every = header_lines(config, control, len(path.z), known)
    return [comment(f"{key}: {value}") for key, value in every.items()]


def _first(path: Toolpath) -> tuple[float, float]:
    first = float(path.z[0]) if len(path.z) else 0.0
    return first, first
