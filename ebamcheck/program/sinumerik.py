"""Post-processor for the SINUMERIK 840D sl: one main program, one subprogram a layer, straight-line code.

Sources: Siemens NC Programming manual 12/2019, section 3.7 (POLY, BSPLINE); program conventions of the
840D sl. Positions are those of the part in X and Y; Z 0 is the base plate under the part's lowest point, and
the tool works at the top of the layer.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np

from ebamcheck import __version__
from ebamcheck.config import Config
from ebamcheck.errors import SettingsError
from ebamcheck.program.blocks import BlockFormat, moving, numbered
from ebamcheck.program.files import NOT_VALIDATED, VALIDATED, ProgramFiles, legal_name, write_files
from ebamcheck.program.inputs import (
    LINE,
    CurveColumns,
    ScanColumns,
    check_same_stack,
    deposition_heights,
    hatch_columns,
    layer_thickness,
)
from ebamcheck.program.polynomials import Spans, chords, refined, spans
from ebamcheck.program.templates import LONGEST_BLOCK, ProcessValues, plain, process_values
from ebamcheck.rings import Bools, Floats, Ints
from ebamcheck.store import sha256_of_json

TURN_SPACINGS = 1.5
"""Hatch lines of one island whose ends are at most this many bead spacings apart are joined with the beam on:
the turn is part of the melt pool. 1.5, because a border at 60 degrees makes the turn 1.15 spacings long."""

NEAR_SPACINGS = 2.0
"""A beam-off move of at most this many bead spacings stays at the layer's height; a longer one rises."""

LEAST_SPLINE_BLOCKS = 6
"""The control wants at least 6 spline blocks among any 10; shorter splines get further knots, exactly."""


def write_program(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: str | Path,
    *,
    validated: bool = False,
    header: Mapping[str, str] | None = None,
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

    Raises
    ------
    SettingsError
        If curves and plan are of different stacks, heights do not rise, a name is not legal, a template
        makes no block, or the control does not have the form of curves that is asked for.
    """
    check_same_stack(curves, plan)
    _check_licence(config)
    deposition = deposition_heights(np.asarray(curves.heights), config.layer_height_mm)
    if (layer_thickness(deposition) <= 0.0).any():
        raise SettingsError("layer heights must rise from layer to layer: sort them and drop repeats")
    name = config.machine.program_name
    digits = max(4, len(str(len(deposition))))
    layer_names = [legal_name(f"{name}_L{k + 1:0{digits}d}") for k in range(len(deposition))]
    status = VALIDATED if validated else NOT_VALIDATED
    texts = {f"{legal_name(name)}.MPF": _main_program(config, status, deposition, layer_names, header or {})}
    stack = _Stack(curves, plan, config)
    for k, layer_name in enumerate(layer_names):
        texts[f"{layer_name}.SPF"] = _layer_program(stack, k, deposition, layer_name, status)
    return write_files(texts, Path(folder), validated=validated)


def _check_licence(config: Config) -> None:
    machine = config.machine
    licensed = {"poly": machine.poly_licensed, "bspline": machine.bspline_licensed, "lines": True}
    if not licensed[machine.curve_form]:
        raise SettingsError(
            f"machine.curve_form {machine.curve_form!r}: the control does not have that option; use 'lines'"
        )


# -- main program ----------------------------------------------------------------------------------


def _opening(name: str, suffix: str, config: Config, status: str) -> list[str]:
    directory = legal_name(config.machine.workpiece_directory)
    return [f"%_N_{name}_{suffix}", f";$PATH=/_N_WKS_DIR/_N_{directory}_WPD", status]


def _main_program(
    config: Config, status: str, deposition: Floats, layer_names: list[str], header: Mapping[str, str]
) -> str:
    machine = config.machine
    form = BlockFormat(machine.decimals)
    first = float(deposition[0]) if len(deposition) else 0.0
    values = process_values(config, 1, first, first)
    top = float(deposition[-1]) if len(deposition) else 0.0
    lines = [
        *_opening(machine.program_name, "MPF", config, status),
        *(_comment(f"{key}: {value}") for key, value in _header(config, len(layer_names), header).items()),
        "G17 G71 G90 G94",
        machine.work_offset,
        *([" ".join(machine.smoothing)] if machine.smoothing else []),
        f"CTOL={plain(machine.smoothing_tolerance_mm)}",
        *values.fill("set_beam", machine.set_beam),
        *layer_names,
        f"G0 Z{form.value(top + machine.safe_height_mm)}",
        "M30",
    ]
    return numbered(lines)


def _header(config: Config, layers: int, header: Mapping[str, str]) -> dict[str, str]:
    """Comment block of the main program: what made it, from what, and how to read it."""
    machine, process, material = config.machine, config.process, config.material
    values = {
        "SOFTWARE": f"ebamcheck {__version__}",
        "CONTROL": "SINUMERIK 840D sl",
        "MACHINE": machine.name,
        "SETTINGS SHA-256": sha256_of_json(config.model_dump()),
        "LAYERS": str(layers),
        "COORDINATES": "X Y of the part, Z 0 under its lowest point, Z at the top of the layer",
        "CURVES": machine.curve_form,
        "SMOOTHING": f"{' '.join(machine.smoothing)}, path may leave the program by "
        f"{machine.smoothing_tolerance_mm:g} mm",
        "BEAM": f"{process.power_w:g} W ({process.voltage_kv:g} kV, {process.current_ma:g} mA)",
        "WIRE": f"{material.name}, {process.wire_diameter_mm:g} mm, speed by mass balance with the layer height",
    }
    if machine.curve_form == "bspline":
        s = machine.bspline_shift
        values["BSPLINE CONVENTION"] = f"s={s}, block i carries PL = U(i+{s}) - U(i+{s - 1}), U clamped"
        values["BSPLINE NOTE"] = (
            "PL=0 in the end blocks is outside the range documented for PL, prove on the control"
        )
    return values | dict(header)


def _comment(text: str) -> str:
    """Return one comment line: ASCII, without the reserved characters ! and ?, cut to the length of a block."""
    plain = "".join(c if c.isascii() and c.isprintable() and c not in "!?;" else "_" for c in text)
    return f"; {plain}"[: LONGEST_BLOCK - 1]


# -- layers ----------------------------------------------------------------------------------------


class _Stack:
    """Curves and hatch of all layers, ready to print: rounded to the decimals of the program."""

    def __init__(self, curves: CurveColumns, plan: ScanColumns, config: Config) -> None:
        self.config = config
        self.form = BlockFormat(config.machine.decimals)
        self.curves = curves
        self.control = self.form.rounded(np.asarray(curves.control, dtype=np.float64))
        self._spans: Spans = spans(curves)
        self._curve_blocks = self._all_curve_blocks()
        island, ends = hatch_columns(plan)
        self.island, self.hatch = island, self.form.rounded(ends)
        layer = np.asarray(plan.island_layer, dtype=np.int64)[island]
        if (np.diff(layer) < 0).any():
            raise SettingsError("hatch vectors of the scan plan are not in the order of layers")
        self.hatch_starts = np.searchsorted(layer, np.arange(len(curves.heights) + 1))
        self.joined = self._joined()

    def _all_curve_blocks(self) -> tuple[Ints, list[str]]:
        """Blocks of every spline piece (unless BSPLINE), and the first block of each piece."""
        machine, found = self.config.machine, self._spans
        if machine.curve_form == "lines":
            starts, points = chords(found, machine.line_tolerance_mm)
            return starts, self.form.lines(self.form.rounded(points))
        rows = np.stack([found.end, found.quadratic, found.cubic], axis=2).reshape(-1, 6)
        return found.starts, self.form.polynomials(rows)

    def _joined(self) -> Bools:
        """Whether hatch vector i begins by a turn with the beam on from the end of vector i - 1 (V,)."""
        joined = np.zeros(len(self.hatch), np.bool_)
        gap = np.linalg.norm(self.hatch[1:, :2] - self.hatch[:-1, 2:], axis=1)
        limit = TURN_SPACINGS * self.config.process.hatch_spacing_mm
        joined[1:] = (gap <= limit) & (self.island[1:] == self.island[:-1])
        return joined

    def piece(self, p: int) -> list[str]:
        """Blocks of one piece, from the position at its start."""
        curves = self.curves
        a, b = int(curves.control_starts[p]), int(curves.control_starts[p + 1])
        if curves.kind[p] == LINE:
            points = self.control[a:b]
            return self.form.lines(points[1:][moving(points[1:], points[0])])
        if self.config.machine.curve_form == "bspline":
            knots = np.asarray(curves.knots)[int(curves.knot_starts[p]) : int(curves.knot_starts[p + 1])]
            control, knots = refined(self.control[a:b], knots, LEAST_SPLINE_BLOCKS)
            shift = self.config.machine.bspline_shift
            return ["G1", "BSPLINE SD=3", *self.form.control_points(control, knots, shift)]
        starts, blocks = self._curve_blocks
        return blocks[int(starts[p]) : int(starts[p + 1])]


class _Layer:
    """Blocks of one layer, and where the tool is while they are written."""

    def __init__(self, config: Config, form: BlockFormat, z_mm: float, values: ProcessValues) -> None:
        self.lines: list[str] = []
        self._config = config
        self._form = form
        self._z, self._safe_z = form.value(z_mm), form.value(z_mm + config.machine.safe_height_mm)
        self._feed = f" F{plain(values.feed_mm_min)}"
        machine = config.machine
        self._on = values.fill("beam_on", machine.beam_on) + values.fill("wire_start", machine.wire_start)
        self._off = values.fill("wire_stop", machine.wire_stop) + values.fill("beam_off", machine.beam_off)
        self._position: Floats | None = None

    def rise(self) -> None:
        """Go to the safe height, with the beam off."""
        self.lines.append(f"G0 Z{self._safe_z}")

    def deposit(self, start: Floats, end: Floats, blocks: list[str]) -> None:
        """Travel to `start`, beam and wire on, `blocks`, wire and beam off at `end`."""
        if not blocks:
            return
        self._travel(start)
        first = next(i for i, block in enumerate(blocks) if block.startswith(("G1", "POLY")))
        self.lines += self._on
        self.lines += [*blocks[:first], blocks[first] + self._feed, *blocks[first + 1 :]]
        self.lines += self._off
        self._position = end

    def _travel(self, to: Floats) -> None:
        x_y = f"G0 X{self._form.value(to[0])} Y{self._form.value(to[1])}"
        near = NEAR_SPACINGS * self._config.process.hatch_spacing_mm
        if self._position is None:
            self.lines += [x_y, f"G0 Z{self._z}"]
        elif float(np.hypot(*(to - self._position))) > near:
            self.lines += [f"G0 Z{self._safe_z}", x_y, f"G0 Z{self._z}"]
        elif (to != self._position).any():
            self.lines.append(x_y)


def _layer_program(stack: _Stack, k: int, deposition: Floats, name: str, status: str) -> str:
    config = stack.config
    z = float(deposition[k])
    thickness = z - (float(deposition[k - 1]) if k else 0.0)
    values = process_values(config, k + 1, z, thickness)
    layer = _Layer(config, stack.form, z, values)
    layer.rise()
    for r in range(int(stack.curves.layer_starts[k]), int(stack.curves.layer_starts[k + 1])):
        _write_ring(stack, layer, r)
    _write_hatch(stack, layer, int(stack.hatch_starts[k]), int(stack.hatch_starts[k + 1]))
    layer.rise()
    lines = [
        *_opening(name, "SPF", config, status),
        _comment(f"LAYER: {k + 1} OF {len(deposition)}, CUT AT {stack.curves.heights[k]:.6f}, Z {z:.6f}"),
        *values.fill("layer_begin", config.machine.layer_begin),
        *layer.lines,
        *values.fill("layer_end", config.machine.layer_end),
        "M17",
    ]
    return numbered(lines)


def _write_ring(stack: _Stack, layer: _Layer, r: int) -> None:
    pieces = range(int(stack.curves.ring_starts[r]), int(stack.curves.ring_starts[r + 1]))
    if not pieces:
        return
    start = stack.control[int(stack.curves.control_starts[pieces[0]])]
    end = stack.control[int(stack.curves.control_starts[pieces[-1] + 1]) - 1]
    layer.lines.append(f"; RING {r}")
    layer.deposit(start, end, [block for p in pieces for block in stack.piece(p)])


def _write_hatch(stack: _Stack, layer: _Layer, first: int, stop: int) -> None:
    """Hatch vectors ``first .. stop - 1``: each run of joined vectors is one track."""
    begins = [*np.flatnonzero(~stack.joined[first:stop]) + first, stop] if stop > first else []
    island = -1
    for a, b in pairwise(begins):
        if stack.island[a] != island:
            island = int(stack.island[a])
            layer.lines.append(f"; ISLAND {island}")
        points = stack.hatch[a:b].reshape(-1, 2)
        moves = moving(points[1:], points[0])
        blocks = stack.form.lines(points[1:][moves])
        turns = [f"{block} ; TURN" if i % 2 else block for block, i in zip(blocks, moves, strict=True)]
        layer.deposit(points[0], points[-1], turns)
