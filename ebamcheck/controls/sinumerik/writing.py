"""Post-processor for the SINUMERIK 840D sl: one main program, one subprogram a layer, straight-line code.

Sources: Siemens NC Programming manual 12/2019, section 3.7 (POLY, BSPLINE). X and Y are those of the part, Z 0 is the base plate.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from ebamcheck.controls.sinumerik.control import AS_WRITTEN, CONTROL
from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Floats
from ebamcheck.nc.conventions import plain
from ebamcheck.nc.files import NOT_VALIDATED, VALIDATED, ProgramFiles, legal_name, preheat_name, write_files
from ebamcheck.nc.inputs import DEGREE, SPLINE, CurveColumns, ScanColumns
from ebamcheck.nc.templates import process_values
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings
from ebamcheck.writing.blocks import BlockFormat, numbered, off_blocks
from ebamcheck.writing.layer_text import Post, layer_blocks, motion_text, preheat_blocks, preheat_passes
from ebamcheck.writing.segments import CUBIC, Form
from ebamcheck.writing.table import tilt_of
from ebamcheck.writing.tracks import Toolpath

# What splines become for each `machine.curve_form`.
FORMS: Mapping[str, Form] = {"poly": "cubics", "bspline": "cubics", "arcs": "arcs", "lines": "chords"}


def write_program(
    curves: CurveColumns, plan: ScanColumns, config: Config, folder: str | Path, *, validated: bool = False,
    header: Mapping[str, str] | None = None, path: Toolpath | None = None,
) -> ProgramFiles:  # fmt: skip
    """Write the program of a stack: contour rings first, then islands in scan order, layer by layer.

    Takes and raises what :func:`ebamcheck.write_program` does; `path` are the tracks of curves and plan, where they are laid out
    already."""
    machine, name = config.machine, config.machine.program_name
    post = Post.of(curves, plan, config, CONTROL, _licensed_form(curves, machine), path)
    layers = len(post.path.z)
    digits = max(4, len(str(layers)))
    layer_names = [legal_name(f"{name}_L{k + 1:0{digits}d}") for k in range(layers)]
    status = VALIDATED if validated else NOT_VALIDATED
    scans, inside = _preheating(post), config.preheat.scan_in == "layer"
    scan_names = {} if inside else {k: legal_name(preheat_name(name, k, digits)) for k in scans}
    tilt = tilt_of(config, post.form)

    def subprogram(own: str, blocks: list[str]) -> str:
        return numbered([*_opening(own, "SPF", config, status), *blocks, "M17"])

    calls = [called for k, layer in enumerate(layer_names) for called in (scan_names.get(k), layer) if called]
    main = [
        *_opening(name, "MPF", config, status),
        *post.begin(modes(machine), header),
        *calls,
        *post.end(None if tilt is None else tilt.up_mm - machine.safe_height_mm),
        "M30",
    ]
    texts = {f"{legal_name(name)}.MPF": numbered(main)}
    motions = motion_text(post.path, post.form, _cubics(post.path, curves, machine, post.form))
    for k, layer_name in enumerate(layer_names):
        entry = [*modes(machine), f'MSG("LAYER {k + 1} OF {layers}")']
        before, after = [*(scans.get(k, []) if inside else [])], list[str]()
        first, stop = post.path.layer_starts[k : k + 2].tolist()
        if tilt is not None and first < stop:
            off = off_blocks(post.values(k), post.templates)
            before += tilt.before(off, post.path.start[first], config, post.form)
            after = tilt.after(off, config, post.form)
        blocks = layer_blocks(post, k, motions, entry, (before, after))
        texts[f"{layer_name}.SPF"] = subprogram(layer_name, blocks)
    for k, scan_name in scan_names.items():
        texts[f"{scan_name}.SPF"] = subprogram(scan_name, scans[k])
    return write_files(texts, Path(folder), validated=validated)


def _preheating(post: Post) -> dict[int, list[str]]:
    """Blocks of the preheating scans, by the layer before which each comes."""
    path, config, passes = post.path, post.config, preheat_passes(post.plan)
    found = {}
    for k in np.flatnonzero(passes).tolist():
        bottom_mm = float(path.z[k - 1]) if k else config.base_mm
        values = process_values(config, k + 1, bottom_mm, float(path.thickness[k]))
        entry = [f'MSG("PREHEATING BEFORE LAYER {k + 1}")']
        after = values.at(float(post.heat.power_share[k]), 1.0)
        if config.preheat.scan_in == "own":
            # Its layer begins with modes and power of its own.
            entry, after = [*modes(config.machine), *entry], values
        found[k] = preheat_blocks(post, k, int(passes[k]), values, after, entry)
    return found


def _licensed_form(curves: CurveColumns, machine: MachineSettings) -> Form:
    """What splines become; refused where the control has no licence for it, or none for uneven knots."""
    form = machine.curve_form
    licensed = {"poly": machine.poly_licensed, "bspline": machine.bspline_licensed}
    if not licensed.get(form, True):
        said = "the control does not have that option; use 'arcs' or 'lines'"
        raise SettingsError(f"machine.curve_form {form!r}: {said}")
    if form == "bspline" and machine.bspline_shift == "uniform" and not machine.poly_licensed:
        pieces = np.flatnonzero(np.asarray(curves.kind) == SPLINE)
        if not all(even(_knots(curves, int(p))) for p in pieces):
            what = "a spline of the contours has uneven knots, which the control could drive as POLY alone"
            how = "and it is not licensed; use curve_form 'arcs' or 'lines'"
            raise SettingsError(f"machine.bspline_shift 'uniform': {what}, {how}")
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


def _opening(name: str, suffix: str, config: Config, status: str) -> list[str]:
    directory = legal_name(config.machine.workpiece_directory)
    return [f"%_N_{name}_{suffix}", f";$PATH=/_N_WKS_DIR/_N_{directory}_WPD", status]


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


# The control wants at least 6 spline blocks among any 10; shorter splines get further knots, exactly.
LEAST_SPLINE_BLOCKS = 6


def spline_blocks(control: Floats, knots: Floats, form: BlockFormat, shift: Literal[2, 3, "uniform"]) -> list[str]:
    """Blocks of one spline: its own G1, so that the control starts it anew, BSPLINE, and the control points."""
    opening = ["G1", f"BSPLINE SD={DEGREE}"]
    if shift == "uniform":
        while len(control) - 1 < LEAST_SPLINE_BLOCKS:
            control, knots = halved(control, knots)
        return opening + form.even_control_points(control)
    control, knots = refined(control, knots, LEAST_SPLINE_BLOCKS)
    # The derivative lies in the hull of `3 (C[i+1] - C[i]) / (U[i+4] - U[i+1])`.
    length = knots[DEGREE + 1 : DEGREE + len(control)] - knots[1 : len(control)]
    leg = np.hypot(*np.diff(control, axis=0).T)
    fastest = float(np.max(DEGREE * leg[length > 0.0] / length[length > 0.0]))
    # Those of a fit run at 1 mm for each mm of their knots; at over twice that the rounding of the knots would count.
    return opening + form.control_points(control, knots * (fastest if fastest > 2.0 else 1.0), shift)


def even(knots: Floats) -> bool:
    """Whether the intervals of a clamped knot vector are all alike."""
    intervals = np.diff(knots[DEGREE : knots.size - DEGREE])
    return bool(np.ptp(intervals) <= 1e-9 * intervals.max())


def refined(control: Floats, knots: Floats, blocks: int) -> tuple[Floats, Floats]:
    """Return the same spline with at least `blocks` control points after its first: knots go to the middle of the longest span
    (Boehm)."""
    from scipy.interpolate import BSpline  # half of the time that this package takes to import

    spline = BSpline(knots, control, DEGREE)
    while len(spline.c) - 1 < blocks:
        longest = int(np.argmax(np.diff(spline.t)))
        spline = spline.insert_knot(0.5 * (spline.t[longest] + spline.t[longest + 1]))
    return np.asarray(spline.c), np.asarray(spline.t)


def halved(control: Floats, knots: Floats) -> tuple[Floats, Floats]:
    """Return the same spline with a further knot in the middle of every span, so that even knots stay even."""
    from scipy.interpolate import BSpline  # half of the time that this package takes to import

    spline = BSpline(knots, control, DEGREE)
    breaks = np.unique(knots)
    for knot in 0.5 * (breaks[1:] + breaks[:-1]):
        spline = spline.insert_knot(knot)
    return np.asarray(spline.c), np.asarray(spline.t)
