"""Post-processor for the SINUMERIK 840D sl: one main program, one subprogram a layer, straight-line code.

Sources: Siemens NC Programming manual 12/2019, section 3.7 (POLY, BSPLINE); program conventions of the
840D sl. Positions are those of the part in X and Y; Z 0 is the base plate under the part's lowest point, and
the tool works at the top of the layer.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ebamcheck.controls.sinumerik.control import AS_WRITTEN, CONTROL, NAME
from ebamcheck.controls.sinumerik.spline_writing import even, spline_blocks
from ebamcheck.errors import SettingsError
from ebamcheck.nc.conventions import comment, header_lines, plain
from ebamcheck.nc.files import (
    NOT_VALIDATED,
    VALIDATED,
    ProgramFiles,
    layer_of_preheat,
    legal_name,
    preheat_name,
    write_files,
)
from ebamcheck.nc.inputs import SPLINE, CurveColumns, ScanColumns, interpass_of
from ebamcheck.nc.templates import process_values, usable_templates
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings
from ebamcheck.writing.bead_ends import driven_path
from ebamcheck.writing.blocks import BlockFormat, numbered
from ebamcheck.writing.layer_text import (
    layer_blocks,
    motion_text,
)
from ebamcheck.writing.preheat_text import preheat_blocks, preheat_passes
from ebamcheck.writing.safe_states import end_blocks, off_blocks, start_blocks
from ebamcheck.writing.segments import CUBIC, Form
from ebamcheck.writing.table import Tilt, tilt_of
from ebamcheck.writing.tracks import Toolpath

FORMS: Mapping[str, Form] = {"poly": "cubics", "bspline": "cubics", "arcs": "arcs", "lines": "chords"}
"""What splines become for each ``machine.curve_form``."""

NOT_THERE = "machine.curve_form {form!r}: the control does not have that option; use 'arcs' or 'lines'"


def write_program(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: str | Path,
    *,
    validated: bool = False,
    header: Mapping[str, str] | None = None,
    path: Toolpath | None = None,
) -> ProgramFiles:
    """Write the program of a stack: contour rings first, then islands in scan order, layer by layer.

    Parameters
    ----------
    curves
        Centre lines of the contour beads, mm.
    plan
        Islands, their order and their hatch vectors.
    config
        The machine and process sections say all that is not geometry.
    folder
        Is replaced as a whole by the program, or stays as it was.
    validated
        Status line of every file; see :func:`mark_validated` for the order in which a run does it.
    header
        Further lines ``KEY: VALUE`` of the main program's comment block (part hash, commit).
    path
        The tracks laid out of curves and plan by :func:`~ebamcheck.writing.bead_ends.planned_path`, where they are
        there already.

    Raises
    ------
    SettingsError
        If curves and plan are of different stacks, heights do not rise, a name is not legal, a template
        makes no block, or the control does not have the form of curves that is asked for.
    """
    machine = config.machine
    templates = usable_templates(config, NAME)
    form = BlockFormat(machine.printed_decimals)
    splines = _licensed_form(curves, machine)
    path = path or driven_path(curves, plan, config, form.decimals, splines, machine.line_tolerance_mm)
    layers = len(path.z)
    name = machine.program_name
    digits = max(4, len(str(layers)))
    layer_names = [legal_name(f"{name}_L{k + 1:0{digits}d}") for k in range(layers)]
    status = VALIDATED if validated else NOT_VALIDATED
    scans = _preheating(plan, path, config, form, templates)
    own = {
        legal_name(preheat_name(name, k, digits)): blocks
        for k, blocks in scans.items()
        if config.preheat.scan_in == "own"
    }
    tilt = tilt_of(config, form)
    texts = {
        f"{legal_name(name)}.MPF": _main_program(
            config, form, status, path, layer_names, list(own), templates, header or {}, tilt
        )
    }
    motions = motion_text(path, form, _cubics(path, curves, machine, form))
    heat = interpass_of(plan, config)
    for k, layer_name in enumerate(layer_names):
        entry = [*modes(machine), f'MSG("LAYER {k + 1} OF {layers}")']
        around = _turned(tilt, path, k, config, form, templates)
        if k in scans and not own:
            around = [*scans[k], *around[0]], around[1]
        blocks = layer_blocks(path, k, motions, config, form, templates, heat, entry, around)
        texts[f"{layer_name}.SPF"] = numbered([*_opening(layer_name, "SPF", config, status), *blocks, "M17"])
    for scan_name, blocks in own.items():
        texts[f"{scan_name}.SPF"] = numbered([*_opening(scan_name, "SPF", config, status), *blocks, "M17"])
    return write_files(texts, Path(folder), validated=validated)


def _turned(
    tilt: Tilt | None,
    path: Toolpath,
    k: int,
    config: Config,
    form: BlockFormat,
    templates: Mapping[str, tuple[str, ...]],
) -> tuple[list[str], list[str]]:
    """Blocks that turn the table before layer `k`, and back after it; none where nothing is turned."""
    first = int(path.layer_starts[k])
    if tilt is None or first == int(path.layer_starts[k + 1]):
        return [], []
    off = off_blocks(process_values(config, k + 1, float(path.z[k]), float(path.thickness[k])), templates)
    return tilt.before(off, path.start[first], config, form), tilt.after(off, config, form)


def _preheating(
    plan: ScanColumns,
    path: Toolpath,
    config: Config,
    form: BlockFormat,
    templates: Mapping[str, tuple[str, ...]],
) -> dict[int, list[str]]:
    """Blocks of the preheating scans, by the layer before which each comes."""
    passes, heat = preheat_passes(plan), interpass_of(plan, config)
    found = {}
    for k in np.flatnonzero(passes).tolist():
        bottom_mm = float(path.z[k - 1]) if k else config.base_mm
        values = process_values(config, k + 1, bottom_mm, float(path.thickness[k]))
        entry = [f'MSG("PREHEATING BEFORE LAYER {k + 1}")']
        after = values.at(float(heat.power_share[k]), 1.0)
        if config.preheat.scan_in == "own":
            # Its layer begins with modes and power of its own.
            entry, after = [*modes(config.machine), *entry], values
        found[k] = preheat_blocks(
            plan, k, bottom_mm, int(passes[k]), values, after, config, form, templates, entry
        )
    return found


# -- forms of curves -------------------------------------------------------------------------------


def _licensed_form(curves: CurveColumns, machine: MachineSettings) -> Form:
    """What splines become; refused where the control has no licence for it, or none for uneven knots."""
    form = machine.curve_form
    licensed = {"poly": machine.poly_licensed, "bspline": machine.bspline_licensed}
    if not licensed.get(form, True):
        raise SettingsError(NOT_THERE.format(form=form))
    if form == "bspline" and machine.bspline_shift == "uniform" and not machine.poly_licensed:
        pieces = np.flatnonzero(np.asarray(curves.kind) == SPLINE)
        if not all(even(_knots(curves, int(p))) for p in pieces):
            raise SettingsError(
                "machine.bspline_shift 'uniform': a spline of the contours has uneven knots, which the control could "
                "drive as POLY alone, and it is not licensed; use curve_form 'arcs' or 'lines'"
            )
    return FORMS[form]


def _knots(curves: CurveColumns, piece: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    a, b = (int(i) for i in curves.knot_starts[piece : piece + 2])
    return np.asarray(curves.knots[a:b], dtype=np.float64)


def _cubics(path: Toolpath, curves: CurveColumns, machine: MachineSettings, form: BlockFormat) -> list[str]:
    """Text of the cubic segments: POLY, or BSPLINE of a whole piece with the first of its segments."""
    at = np.flatnonzero(path.kind == CUBIC)
    if machine.curve_form != "bspline" or not at.size:
        return form.polynomials(path.bezier, path.end[at])
    text = [""] * at.size
    polynomials: list[str] = []
    piece = path.piece[at]
    begins = np.flatnonzero(np.diff(piece, prepend=-2))
    for i, stop in zip(begins.tolist(), [*begins[1:].tolist(), at.size], strict=True):
        p = int(piece[i])
        knots = _knots(curves, p) if p >= 0 else np.zeros(0)
        if p < 0 or (machine.bspline_shift == "uniform" and not even(knots)):
            polynomials = polynomials or form.polynomials(path.bezier, path.end[at])
            text[i:stop] = polynomials[i:stop]
            continue
        control = np.asarray(curves.control[curves.control_starts[p] : curves.control_starts[p + 1]])
        text[i] = "\n".join(spline_blocks(form.rounded(control), knots, form, machine.bspline_shift))
    return text


# -- main program ----------------------------------------------------------------------------------


def _opening(name: str, suffix: str, config: Config, status: str) -> list[str]:
    directory = legal_name(config.machine.workpiece_directory)
    return [f"%_N_{name}_{suffix}", f";$PATH=/_N_WKS_DIR/_N_{directory}_WPD", status]


def _main_program(
    config: Config,
    form: BlockFormat,
    status: str,
    path: Toolpath,
    layer_names: list[str],
    scans: list[str],
    templates: Mapping[str, tuple[str, ...]],
    header: Mapping[str, str],
    tilt: Tilt | None,
) -> str:
    machine = config.machine
    first, top = (float(path.z[0]), float(path.z[-1])) if len(path.z) else (0.0, 0.0)
    if tilt is not None:
        top = tilt.up_mm - machine.safe_height_mm
    values = process_values(config, 1, first, first)
    before = {layer_of_preheat(config.machine.program_name, scan): scan for scan in scans}
    calls = [
        name
        for k, layer in enumerate(layer_names)
        for name in ([before[k], layer] if k in before else [layer])
    ]
    known = header_lines(config, CONTROL, len(layer_names)) | dict(header)
    lines = [
        *_opening(machine.program_name, "MPF", config, status),
        *(comment(f"{key}: {value}") for key, value in known.items()),
        *start_blocks(modes(machine), values, templates),
        *calls,
        *end_blocks(top, values, config, form, templates),
        "M30",
    ]
    return numbered(lines)


def modes(machine: MachineSettings) -> list[str]:
    """Blocks of the modes that hold in a program: plane, units, offsets and frames taken back, smoothing."""
    return [
        f"G17 {machine.length_unit} G90 G94",
        "G40 D0",
        # It takes the work offset with it, which is why that comes after it.
        "TRAFOOF",
        "TRANS",
        machine.work_offset,
        " ".join(AS_WRITTEN),
        *([" ".join(machine.smoothing)] if machine.smoothing else []),
        f"CTOL={plain(machine.smoothing_tolerance_mm)}",
    ]
