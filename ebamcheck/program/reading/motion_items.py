"""A program, one motion at a time: small values to look at, iterate over and draw."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ebamcheck.layers.items import index_of
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.showing import short_text

if TYPE_CHECKING:
    from ebamcheck.program.reading.motions import NCProgram

Place = tuple[float, float, float]

STEP_MM = 0.25
"""Curved motions are drawn as straight parts of at most this length."""


@dataclass(frozen=True, slots=True)
class Motion:
    """One motion that a block of the program commands."""

    index: int
    where: str
    """``FILE:line`` of its block."""
    kind: str
    """``rapid``, ``line``, ``poly``, ``bspline span`` or ``arc``."""
    layer: int
    """-1 outside of the layers."""
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


# -- what NCProgram itself gets of them --------------------------------------------------------------


def motion(program: NCProgram, index: int) -> Motion:
    """One motion by its index in the order of execution; a negative one counts from the end.

    Raises
    ------
    IndexError
        If the program has no such motion.
    """
    from ebamcheck.program.reading.motions import KIND_NAMES

    if not -len(program) <= index < len(program):
        raise IndexError(
            f"no motion {index}: the program has {short_text.counted(len(program), 'motion')}, from 0"
        )
    row = index % len(program)
    x0, y0, z0 = program.start[row].tolist()
    x1, y1, z1 = program.end[row].tolist()
    return Motion(
        index=row,
        where=program.where(row),
        kind=KIND_NAMES[int(program.kind[row])],
        layer=int(program.layer[row]),
        start_mm=(x0, y0, z0),
        end_mm=(x1, y1, z1),
        length_mm=float(program.lengths[row]),
        feed_mm_min=float(program.feed_mm_min[row]),
        beam=bool(program.beam[row]),
        wire=bool(program.wire[row]),
        power_w=float(program.power_w[row]),
        wire_mm_s=float(program.wire_mm_s[row]),
    )


def motion_iterator(program: NCProgram) -> Iterator[Motion]:
    """Go through the motions in the order of execution."""
    return (motion(program, row) for row in range(len(program)))


def program_line(program: NCProgram) -> str:
    """Write a program as one line."""
    return short_text.line(
        "NCProgram",
        program.files[0].name if program.files else "no file",
        short_text.counted(len(program.files), "file"),
        short_text.counted(len(program.layer_files), "layer"),
        short_text.counted(len(program), "motion"),
        program.dialect,
    )


def program_html(program: NCProgram) -> str:
    """Show a program in a notebook."""
    lengths = program.lengths
    facts = {
        "main program": program.files[0].name if program.files else "none",
        "files": len(program.files),
        "layers": len(program.layer_files),
        "motions": len(program),
        "beam on": f"{lengths[program.deposit].sum() / 1000.0:.6g} m",
        "control": program.dialect,
        **dict(program.header),
    }
    return short_text.html("NCProgram", facts)


def program_plot(program: NCProgram, layer: int | None = None, ax: Any = None) -> Any:
    """Draw the path of a program, or of one of its layers, as its text commands it, on matplotlib axes.

    Raises
    ------
    SettingsError
        If the program has no such layer.
    """
    from ebamcheck.showing.plotting import Lines, plot_lines

    count = len(program.layer_files)
    if layer is not None:
        layer = index_of(layer, count)
    chosen = np.isfinite(program.start[:, :2]).all(axis=1) & np.isfinite(program.end[:, :2]).all(axis=1)
    if layer is not None:
        chosen &= program.layer == layer
    kinds = (
        ("beam off", ~program.deposit, "#999999", 0.6, ":"),
        ("hatch, beam on", program.deposit & (program.island >= 0), "#0072b2", 0.8, "-"),
        ("contour, beam on", program.deposit & (program.island < 0), "#d55e00", 1.5, "-"),
    )
    groups = [
        Lines(_polylines(program, np.flatnonzero(which & chosen)), colour, width, dashes, name)
        for name, which, colour, width, dashes in kinds
    ]
    title = "whole program" if layer is None else f"layer {layer + 1}: {program.layer_files[layer]}"
    return plot_lines(groups, title, ax)


def _polylines(program: NCProgram, rows: Ints) -> list[Floats]:
    """Points (n, 2) along each motion."""
    if not rows.size:
        return []
    row, points = program.samples(rows, STEP_MM)
    parts = np.split(points, np.searchsorted(row, rows)[1:])
    return [np.vstack([start, part]) for start, part in zip(program.start[rows, :2], parts, strict=True)]
