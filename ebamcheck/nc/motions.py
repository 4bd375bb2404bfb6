"""The motions that a program commands, as columns: what the reader returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.even_odd import oriented_by_nesting
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.nc.timeline import Events
from ebamcheck.showing import short_text
from ebamcheck.showing.columns import Columns, index_of

RAPID, STRAIGHT, POLYNOMIAL, SPLINE_SPAN, ARC = range(5)
# Of motions; a BSPLINE gives one row for each knot span.
KIND_NAMES = "rapid", "line", "poly", "bspline span", "arc"
Place = tuple[float, float, float]
DRAWN_STEP_MM = 0.25  # Curved motions are drawn as straight parts of at most this length


@dataclass(frozen=True, eq=False)
class TableColumns:
    """Rotary positions and frames in force, one row for each motion (B,)."""

    axes: tuple[str, ...]  # Names of the rotary axes (A,)
    positions_deg: Floats  # (P, A) every set of positions that the table stands at, the first all 0
    # (F, 3, 4) every frame that is in force, turn and shift, the first none: a place p of the program lies at turn @ p + shift.
    frames: Floats
    before: Ints  # (B,) positions of the table before and after the motion, by their row
    after: Ints
    frame: Ints  # (B,) frame during the motion, by its row
    # (B,) how far table and frame put the end of the motion from where it belongs on the part, mm.
    off_mm: Floats
    # (B,) ways of the machine itself, with neither frame nor beam, and turns of the table: they are none of a layer.
    apart: Bools

    def rows(self, kept: Bools) -> TableColumns:
        """Some of the motions."""
        columns = (getattr(self, name)[kept] for name in ("before", "after", "frame", "off_mm", "apart"))
        return TableColumns(self.axes, self.positions_deg, self.frames, *columns)


@dataclass(frozen=True)
class SourceFile:
    """One file of a program: its bytes as they are on disk, and what its header says."""

    name: str
    data: bytes
    line_count: int
    end_line: int  # Line of M30, M17 or RET; 0 where there is none
    end_code: str

    def __repr__(self) -> str:
        size = f"{len(self.data)} bytes", f"{self.line_count} lines"
        return short_text.line("SourceFile", self.name, *size, self.end_code)


@dataclass(frozen=True, slots=True)
class Motion:
    """One motion that a block of the program commands."""

    index: int
    where: str  # `FILE:line` of its block
    kind: str  # `rapid`, `line`, `poly`, `bspline span` or `arc`
    layer: int  # -1 outside of the layers
    start_mm: Place
    end_mm: Place
    length_mm: float
    feed_mm_min: float
    beam: bool
    wire: bool
    power_w: float
    wire_mm_s: float

    @property
    def deposits(self) -> bool:
        """Whether metal is laid: at feed with the beam on."""
        return self.beam and self.kind != "rapid"

    def __repr__(self) -> str:
        to = ", ".join(f"{value:.3f}" for value in self.end_mm)
        states = [name for name, on in (("beam", self.beam), ("wire", self.wire)) if on]
        return short_text.line(
            f"Motion {self.index}",
            f"{self.kind} to ({to}) mm",
            f"{self.length_mm:.6g} mm long",
            f"{self.feed_mm_min:g} mm/min" if self.kind != "rapid" else "",
            " and ".join(states) + " on" if states else "beam off",
            self.where,
        )


@dataclass(frozen=True, eq=False, repr=False)
class NCProgram(Columns[Motion]):
    """A program as its text says it, one row for each motion (B,), in the order of execution."""

    files: tuple[SourceFile, ...]  # in the order in which they were first opened
    header: Mapping[str, str]  # ``KEY: VALUE`` comments of the main program
    folder: Path
    file: Ints  # (B,) where the block stands: index of its file, and line from 1
    line: Ints
    layer: Ints  # (B,) of the subprogram's call, or of the level of Z without calls; -1 outside
    kind: Ints  # (B,) :data:`RAPID` ... :data:`ARC`
    start: Floats  # (B, 3) mm; NaN where an axis has not been given yet
    end: Floats
    coefficients: Floats  # (B, 2, 4) powers of t in X and Y over 0 <= t <= 1, mm; an arc has none (NaN)
    arc: Floats  # (B, 3) centre X, Y and signed sweep in radians; NaN but for arcs
    feed_mm_min: Floats  # (B,) feed in force; NaN before the first F
    beam: Bools  # (B,) state during the motion
    wire: Bools
    power_w: Floats  # (B,) values in force; NaN where none was set
    wire_mm_s: Floats
    ring: Ints  # (B,) number of contour or island, by the roles that beads have; -1 for none
    island: Ints
    turn: Bools  # (B,) a turn between two hatch lines
    goes_on: Bools  # (B,) a further part of the hatch line before it
    events: Events  # State changes
    numbers: Ints  # (N, 3) file, line, value of every block number
    layer_files: tuple[str, ...]  # (L,) file of each layer
    # Motions and events of the preheating subprograms, which are none of the others; `layer` is the one before which each comes. None:
    # there are none.
    preheating: NCProgram | None = None
    # All motions as the axes drive them in the work offset, those of the machine itself among them, of a program that turns a tilt table
    # or sets a frame; its `table` tells of both. None: the program does neither.
    machine: NCProgram | None = None
    table: TableColumns | None = None  # What table and frame do during each motion; None: nothing
    # Language of the text, by the name of a control: `sinumerik-840d-sl`, `linuxcnc` or `plain-gcode`.
    dialect: str = "sinumerik-840d-sl"

    _item_in = ("motion", "program")

    def __len__(self) -> int:
        return int(self.kind.size)

    def _item(self, index: int) -> Motion:
        x0, y0, z0 = self.start[index].tolist()
        x1, y1, z1 = self.end[index].tolist()
        return Motion(
            index=index, where=self.where(index), kind=KIND_NAMES[int(self.kind[index])],
            layer=int(self.layer[index]), start_mm=(x0, y0, z0), end_mm=(x1, y1, z1),
            length_mm=float(self.lengths[index]), feed_mm_min=float(self.feed_mm_min[index]),
            beam=bool(self.beam[index]), wire=bool(self.wire[index]), power_w=float(self.power_w[index]),
            wire_mm_s=float(self.wire_mm_s[index]),
        )  # fmt: skip

    def _facts(self) -> dict[str, int | str]:
        return {
            "main program": self.files[0].name if self.files else "no file",
            "files": len(self.files),
            "layers": len(self.layer_files),
            "motions": len(self),
            "control": self.dialect,
        }

    def _more(self) -> dict[str, int | str]:
        return {"beam on": f"{self.lengths[self.deposit].sum() / 1000.0:.6g} m", **self.header}

    def where(self, row: int) -> str:
        """``FILE:line`` of a motion."""
        return f"{self.files[int(self.file[row])].name}:{int(self.line[row])}"

    def where_event(self, event: int) -> str:
        """``FILE:line`` of an event."""
        return f"{self.files[int(self.events.file[event])].name}:{int(self.events.line[event])}"

    @property
    def beginning(self) -> str:
        """``FILE:line`` of the first motion; of the main program where there is none."""
        return self.where(0) if len(self) else f"{self.files[0].name}:1"

    @cached_property
    def deposit(self) -> Bools:
        """Motions with feed and beam (B,)."""
        return np.asarray(self.beam & (self.kind != RAPID))

    @cached_property
    def beads(self) -> Beads:
        """Beads of all motions with beam or wire on; ``beads.among(rows)`` are those of some."""
        metal, begins = self.beam | self.wire, np.zeros(len(self) + 1, np.bool_)
        for column in (metal, self.end[:, 2], self.layer):
            begins[1:-1] |= column[1:] != column[:-1]
        begins[self.events.row[self.events.named("beam_on", "wire_start")]] = True
        return Beads.of(np.flatnonzero(metal), np.cumsum(begins[:-1]))

    def evaluate(self, rows: Ints, t: Floats) -> Floats:
        """Positions X, Y (n, 2) at parameters `t` (n,) of the motions `rows` (n,), or (n, m, 2) at the same `t` (1, m) of each."""
        each = t if t.ndim > 1 else t[:, None]
        # (4, n, 2, 1) powers of the parameter.
        c0, c1, c2, c3 = np.moveaxis(self.coefficients[rows], 2, 0)[..., None]
        at = each[:, None]
        points: Floats = np.moveaxis(((c3 * at + c2) * at + c1) * at + c0, 1, 2)
        round_ = np.flatnonzero(self.kind[rows] == ARC)
        if round_.size:
            r = rows[round_]
            centre = self.arc[r, :2, None]
            turn = self.arc[r, 2, None] * (each if len(each) == 1 else each[round_])
            spoke = self.start[r, :2, None] - centre
            cos, sin = np.cos(turn), np.sin(turn)
            points[round_, :, 0] = centre[:, 0] + cos * spoke[:, 0] - sin * spoke[:, 1]
            points[round_, :, 1] = centre[:, 1] + sin * spoke[:, 0] + cos * spoke[:, 1]
        return points if t.ndim > 1 else points[:, 0]

    @cached_property
    def lengths(self) -> Floats:
        """Length of each motion, (B,) mm: chords in space, 16-point Gauss quadrature on curves in X and Y."""
        result = np.linalg.norm(self.end - self.start, axis=1)
        curved = np.flatnonzero((self.kind == POLYNOMIAL) | (self.kind == SPLINE_SPAN))
        if curved.size:
            nodes, weights = np.polynomial.legendre.leggauss(16)
            t = 0.5 * (nodes + 1.0)
            c = self.coefficients[curved][:, :, :, None]
            speed = np.hypot(*np.moveaxis(c[:, :, 1] + t * (2.0 * c[:, :, 2] + 3.0 * t * c[:, :, 3]), 1, 0))
            result[curved] = 0.5 * speed @ weights
        arcs = np.flatnonzero(self.kind == ARC)
        radius = np.linalg.norm(self.start[arcs, :2] - self.arc[arcs, :2], axis=1)
        result[arcs] = np.abs(self.arc[arcs, 2]) * radius
        return np.asarray(result)

    def samples(self, rows: Ints, step_mm: float) -> tuple[Ints, Floats]:
        """Points along motions at most `step_mm` apart, each motion's start left out: motion (n,) of each, and position (n, 2),
        mm."""
        if not step_mm > 0.0:
            raise SettingsError(f"step {step_mm} mm: give a positive number of millimetres")
        curved = self.kind[rows] != STRAIGHT
        parts = np.ceil(np.nan_to_num(self.lengths[rows]) / step_mm).astype(np.int64)
        parts = np.maximum(parts, np.where(curved, 2, 1))
        starts = np.concatenate([[0], np.cumsum(parts)])
        which = np.repeat(np.arange(rows.size), parts)
        t = (np.arange(starts[-1]) - starts[:-1][which] + 1) / parts[which]
        row = np.asarray(rows, dtype=np.int64)[which]
        return row, self.evaluate(row, t)

    def lines(self, rows: Ints, step_mm: float) -> tuple[Ints, Floats]:
        """Points along motions, each motion's start with them, at most `step_mm` apart: index (n,) in `rows`, and position (n, 2),
        mm."""
        row, points = self.samples(rows, step_mm)
        index = np.concatenate([np.arange(rows.size), np.searchsorted(rows, row)])
        order = np.argsort(index, kind="stable")
        return index[order], np.concatenate([self.start[rows, :2], points])[order]

    def chords(self, rows: Ints, step_mm: float) -> tuple[Ints, Floats]:
        """Chords of motions, rising: motion (S,) of each, and its ends (S, 4) x0, y0, x1, y1, mm; of a curve several, at most
        `step_mm` long."""
        straight = self.kind[rows] <= STRAIGHT
        index, points = self.lines(rows[~straight], step_mm)
        within = index[1:] == index[:-1]
        bent = np.hstack([points[:-1], points[1:]])[within]
        owner = np.concatenate([rows[straight], rows[~straight][index[1:][within]]])
        order = np.argsort(owner, kind="stable")
        ends = np.hstack([self.start[rows[straight], :2], self.end[rows[straight], :2]])
        return owner[order], np.concatenate([ends, bent])[order]

    @cached_property
    def layer_heights(self) -> Floats:
        """Z of the first deposit of each layer, (L,) mm; NaN for a layer without any."""
        heights = np.full(len(self.layer_files), np.nan)
        rows = np.flatnonzero(self.deposit & (self.layer >= 0))
        layers, first = np.unique(self.layer[rows], return_index=True)
        heights[layers] = self.end[rows[first], 2]
        return heights

    def sample(self, step_mm: float) -> Layers:
        """Return the beam-on path as layers at the Z of the program; a track is a ring where it closes."""
        return self._layers(np.flatnonzero(self.deposit & (self.layer >= 0)), step_mm)

    def contours(self, step_mm: float) -> Layers:
        """Return the contour rings alone as layers, in canonical form, without what overlaps their starts, whichever way they are
        driven."""
        rows = self.deposit & (self.ring >= 0) & (self.layer >= 0) & ~self.overlap
        return oriented_by_nesting(self._layers(np.flatnonzero(rows), step_mm))

    @cached_property
    def overlap(self) -> Bools:
        """Motions (B,) of a contour ring after it has come back to its start."""
        rows = np.flatnonzero(self.deposit & (self.ring >= 0))
        beads = self.beads.among(rows)
        back = (self.end[rows, :2] == self.start[beads.first, :2][beads.bead]).all(axis=1)
        came_back = np.cumsum(back) - back
        result = np.zeros(len(self), np.bool_)
        # How often the rings before had come back does not count.
        result[rows] = came_back > came_back[np.searchsorted(rows, beads.first)][beads.bead]
        return result

    def _layers(self, rows: Ints, step_mm: float) -> Layers:
        beads = self.beads.among(rows)
        row, points = self.samples(rows, step_mm)
        first, count = self.start[beads.first, :2], len(beads)
        bead = np.concatenate([beads.bead[np.searchsorted(rows, row)], np.arange(count)])
        order = np.lexsort((np.concatenate([np.ones(row.size), np.zeros(count)]), bead))
        points = np.concatenate([points, first])[order]
        closed = (first == self.end[beads.last, :2]).all(axis=1)
        starts = np.concatenate([[0], np.cumsum(np.bincount(bead, minlength=count))])
        layer_starts = np.searchsorted(self.layer[beads.first], np.arange(len(self.layer_files) + 1))
        return canonical(self.layer_heights, points, starts, layer_starts, closed, backend="program")

    def vectors(self) -> pd.DataFrame:
        """Hatch vectors in the order of the program: layer, island, x0, y0, x1, y1, row of the first part of each."""
        rows = np.flatnonzero(self.deposit & (self.island >= 0) & ~self.turn)
        first = np.flatnonzero(~self.goes_on[rows])
        last = rows[np.append(first[1:], rows.size) - 1] if first.size else rows[:0]
        rows = rows[first]
        return pd.DataFrame(
            {
                "layer": self.layer[rows], "island": self.island[rows], "x0": self.start[rows, 0],
                "y0": self.start[rows, 1], "x1": self.end[last, 0], "y1": self.end[last, 1], "row": rows,
            }
        )  # fmt: skip

    def plot(self, layer: int | None = None, ax: Any = None) -> Any:
        """Draw the path of a program, or of a layer (SettingsError if there is none), as its text commands it, on matplotlib
        axes."""
        from ebamcheck.showing.plotting import Lines, plot_lines

        chosen = np.isfinite(self.start[:, :2]).all(axis=1) & np.isfinite(self.end[:, :2]).all(axis=1)
        if layer is not None:
            layer = index_of(layer, len(self.layer_files))
            chosen &= self.layer == layer
        groups = []
        for name, which, colour, width, dashes in (
            ("beam off", ~self.deposit, "#999999", 0.6, ":"),
            ("hatch, beam on", self.deposit & (self.island >= 0), "#0072b2", 0.8, "-"),
            ("contour, beam on", self.deposit & (self.island < 0), "#d55e00", 1.5, "-"),
        ):
            index, points = self.lines(np.flatnonzero(which & chosen), DRAWN_STEP_MM)
            lines = np.split(points, np.flatnonzero(np.diff(index)) + 1) if index.size else []
            groups.append(Lines(lines, colour, width, dashes, name))
        title = "whole program" if layer is None else f"layer {layer + 1}: {self.layer_files[layer]}"
        return plot_lines(groups, title, ax)


@dataclass(frozen=True, eq=False)
class Beads:
    """Beads of a program, or of some of its motions, in the order in which they are laid.
    One ends where beam or wire are switched on, at a travel, and where the height or the layer changes."""

    rows: Ints  # (n,) motions
    bead: Ints  # (n,) bead of each, from 0 without gaps
    first: Ints  # (P,) first and last motion of each bead
    last: Ints
    # (B,) numbers that rise from one bead to another, of all motions of the program, also of those that lay nothing.
    group: Ints

    @classmethod
    def of(cls, rows: Ints, group: Ints) -> Beads:
        """Beads of motions `rows` (n,), rising: rows in a row whose `group` (B,) is one are one bead."""
        begins = np.append(True, (np.diff(rows) > 1) | (np.diff(group[rows]) != 0))[: rows.size]
        at = np.flatnonzero(begins)
        last = np.append(at[1:], rows.size)[: at.size] - 1
        return cls(rows, np.cumsum(begins) - 1, rows[at], rows[last], group)

    def among(self, rows: Ints) -> Beads:
        """Beads that some of the motions make, numbered anew from 0; a bead that others of its motions part is several."""
        return Beads.of(rows, self.group)

    def __len__(self) -> int:
        return int(self.first.size)

    def total(self, values: Floats) -> Floats:
        """Sum (P,) over each bead of the `values` (n,) of its motions."""
        return np.bincount(self.bead, values, minlength=len(self)).astype(np.float64)

    def any(self, which: np.ndarray) -> np.ndarray:
        """Whether each bead (P,) has a motion that is marked in `which` (n,)."""
        return np.asarray(np.bincount(self.bead, which, minlength=len(self)) > 0)

    def greatest(self, values: Floats) -> Floats:
        """Greatest (P,) of the `values` (n,) of each bead; NaN where one is."""
        first = np.searchsorted(self.bead, np.arange(len(self)))
        return np.maximum.reduceat(values, first) if len(self) else values[:0]

    def middles(self, length_mm: Floats) -> tuple[Floats, Floats]:
        """Distance (n,) of the middle of each motion from the start of its bead, and the length (P,) of each bead, mm."""
        whole = self.total(length_mm)
        before = np.concatenate([[0.0], np.cumsum(whole)])[self.bead]
        return np.cumsum(length_mm) - 0.5 * length_mm - before, whole

    def spread(self, values: Ints, size: int) -> Ints:
        """Give each motion (size,) the value of its bead; -1 for those of none."""
        result = np.full(size, -1, np.int64)
        result[self.rows] = values[self.bead]
        return result
