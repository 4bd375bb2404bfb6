"""Post-processors for controls that take one file: LinuxCNC (G5, arcs, lines) and plain G-code (arcs, lines).

LinuxCNC G-code reference: G5 carries a cubic span as ``I J P Q``; G64 P is the tolerance of the path; G91.1 makes I and J relative.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ebamcheck.controls.gcode.control import LINUXCNC, PLAIN_GCODE
from ebamcheck.nc.conventions import comment, plain
from ebamcheck.nc.files import NOT_VALIDATED, VALIDATED, ProgramFiles, write_files
from ebamcheck.nc.inputs import CurveColumns, ScanColumns
from ebamcheck.settings.config import Config
from ebamcheck.writing.layer_text import Post, layer_blocks, motion_text
from ebamcheck.writing.segments import CUBIC, Form
from ebamcheck.writing.tracks import Toolpath


def write_linuxcnc(
    curves: CurveColumns, plan: ScanColumns, config: Config, folder: str | Path, *, validated: bool = False,
    header: Mapping[str, str] | None = None, path: Toolpath | None = None,
) -> ProgramFiles:  # fmt: skip
    """Write one ``.ngc`` file: splines as G5, exactly, or as arcs or lines; takes and raises what :func:`ebamcheck.write_program`
    does."""
    forms: Mapping[str, Form] = {"arcs": "arcs", "lines": "chords"}
    tolerance = plain(config.machine.smoothing_tolerance_mm)
    modes = ["G17 G21 G90 G91.1 G94", "G40 G49 G80", "G92.1", config.machine.work_offset, f"G64 P{tolerance}"]
    post = Post.of(curves, plan, config, LINUXCNC, forms.get(config.machine.curve_form, "cubics"), path)
    return _write(post, modes, Path(folder), validated, header)


def write_plain_gcode(
    curves: CurveColumns, plan: ScanColumns, config: Config, folder: str | Path, *, validated: bool = False,
    header: Mapping[str, str] | None = None, path: Toolpath | None = None,
) -> ProgramFiles:  # fmt: skip
    """Write one ``.gcode`` file of G0 to G3, splines as arcs or lines; takes and raises what :func:`ebamcheck.write_program`
    does."""
    form: Form = "chords" if config.machine.curve_form == "lines" else "arcs"
    modes = ["G17 G21 G90 G94", "G40 G49 G80", "G92.1", config.machine.work_offset]
    post = Post.of(curves, plan, config, PLAIN_GCODE, form, path)
    return _write(post, modes, Path(folder), validated, header)


def _write(
    post: Post, modes: list[str], folder: Path, validated: bool, header: Mapping[str, str] | None
) -> ProgramFiles:
    program = post.config.machine.program_name
    text = "\n".join([comment(program), *one_file(post, modes, validated, header), "M2"]) + "\n"
    return write_files({f"{program}{post.control.suffixes[0].lower()}": text}, folder, validated=validated)


def one_file(post: Post, modes: list[str], validated: bool, header: Mapping[str, str] | None) -> list[str]:
    """Lines of a program that is one file, from its status to the place where the tool is parked."""
    path = post.path
    at = path.kind == CUBIC
    cubics = post.form.beziers(path.bezier, path.segment_start[at], path.end[at])
    motions = motion_text(path, post.form, cubics)
    lines = [VALIDATED if validated else NOT_VALIDATED, *post.begin(modes, header)]
    for k in range(len(path.z)):
        message = [f"(MSG, LAYER {k + 1} OF {len(path.z)})"] if post.control is LINUXCNC else []
        lines += layer_blocks(post, k, motions, [*modes, *message])
    return [*lines, *post.end()]
