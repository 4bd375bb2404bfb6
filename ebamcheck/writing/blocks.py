"""Text of NC blocks: columns of numbers as lines, safe states of the machine, and the numbering of blocks."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ebamcheck.kernels import Floats
from ebamcheck.nc.codes import BEAM_VALUES
from ebamcheck.nc.conventions import safe_end_mm
from ebamcheck.nc.templates import ProcessValues
from ebamcheck.settings.config import Config
from ebamcheck.writing.segments import Circles
from ebamcheck.writing.tracks import rounded


class BlockFormat:
    """Formats of the motions of one program, all with the same number of decimals."""

    def __init__(self, decimals: int) -> None:
        self.decimals = decimals
        self._number = f"%.{decimals}f"

    def rounded(self, values: Floats) -> Floats:
        """Values as they will be printed and read back; no negative zero."""
        return rounded(values, self.decimals)

    def value(self, number: float) -> str:
        """One number."""
        return self._number % (round(float(number), self.decimals) + 0.0)

    def lines(self, points: Floats) -> list[str]:
        """G1 blocks to rounded points (n, 2)."""
        return self._print("G1 X# Y#", points)

    def arcs(self, start: Floats, end: Floats, found: Circles) -> list[str]:
        """G2 and G3 blocks between rounded points (n, 2); I and J from the start to the centre."""
        rows = np.hstack([end, self.rounded(found.centre - start)])
        codes = np.where(found.counter_clockwise, "G3", "G2").tolist()
        texts = self._print(" X# Y# I# J#", rows)
        return [code + text for code, text in zip(codes, texts, strict=True)]

    def polynomials(self, bezier: Floats, end: Floats) -> list[str]:
        """POLY blocks over PL=1 of Bezier spans (n, 4, 2): end points, and coefficients of t^2 and t^3."""
        b = bezier
        second = 3.0 * (b[:, 0] - 2.0 * b[:, 1] + b[:, 2])
        third = b[:, 3] - b[:, 0] + 3.0 * (b[:, 1] - b[:, 2])
        rows = np.stack([end, self.rounded(second), self.rounded(third)], axis=2)
        return self._print("POLY PO[X]=(#,#,#) PO[Y]=(#,#,#) PL=1", rows.reshape(-1, 6))

    def beziers(self, bezier: Floats, start: Floats, end: Floats) -> list[str]:
        """G5 blocks of Bezier spans (n, 4, 2): I, J from the start to the second point, P, Q from the end to the third."""
        rows = np.hstack([self.rounded(bezier[:, 1] - start), self.rounded(bezier[:, 2] - end), end])
        return self._print("G5 I# J# P# Q# X# Y#", rows)

    def control_points(self, control: Floats, knots: Floats, shift: int) -> list[str]:
        """BSPLINE blocks for all control points but the first: block i carries ``PL = U[i + shift] - U[i + shift - 1]``, of knots
        as rounded."""
        knots = self.rounded(knots - knots[0])
        i = np.arange(1, len(control))
        interval = self.rounded(knots[i + shift] - knots[i + shift - 1])
        return self._print("X# Y# PL=#", np.column_stack([self.rounded(control[1:]), interval]))

    def even_control_points(self, control: Floats) -> list[str]:
        """BSPLINE blocks without PL."""
        return self._print("X# Y#", self.rounded(control[1:]))

    def _print(self, block: str, rows: Floats) -> list[str]:
        """Put each row in place of the # of a block: one % over all rows is an order faster than one each."""
        line = block.replace("#", self._number) + "\n"
        text: str = line * len(rows) % tuple(rows.ravel().tolist())
        return text.splitlines()


def numbered(lines: Iterable[str]) -> str:
    """Number blocks from N10 up; lines that begin with ``;`` or ``%`` stay without a number."""
    number = itertools.count(10, 10)
    return "".join(f"{line}\n" if line[0] in ";%" else f"N{next(number)} {line}\n" for line in lines)


# -- safe states -------------------------------------------------------------------------------------
# Every layer begins with them, so that a program can be entered at any layer: nothing that holds in it depends on what ran before.
Templates = Mapping[str, tuple[str, ...]]


def start_blocks(modes: Sequence[str], values: ProcessValues, templates: Templates) -> list[str]:
    """Blocks that begin a program: modes, wire and beam off, and the values of the beam."""
    return [*modes, *_filled(("wire_stop", "beam_off", "set_beam"), values, templates)]


def entry_blocks(modes: Sequence[str], values: ProcessValues, templates: Templates) -> list[str]:
    """Blocks that begin a layer: modes, and the values of the beam."""
    return [*modes, *_filled(("set_beam",), values, templates)]


def off_blocks(values: ProcessValues, templates: Templates) -> list[str]:
    """Blocks that command wire and beam off."""
    return _filled(("wire_stop", "beam_off"), values, templates)


def _filled(names: Sequence[str], values: ProcessValues, templates: Templates) -> list[str]:
    return [line for name in names for line in values.fill(name, templates[name])]


def end_blocks(
    top_mm: float, values: ProcessValues, config: Config, form: BlockFormat, templates: Templates
) -> list[str]:
    """Wire and beam off, their values 0, up over all that stands, and to the place where the tool is parked."""
    off = replace(values, power_w=0.0, voltage_kv=0.0, current_ma=0.0, wire_mm_s=0.0)
    names = ["wire_stop", "beam_off", "set_wire", "set_beam"]
    if not any(f"{{{value}" in line for value in BEAM_VALUES for line in templates["set_beam"]):
        names.append("set_power")
    x, y = config.machine.park_position_mm
    return [
        *_filled(names, off, templates),
        f"G0 Z{form.value(safe_end_mm(top_mm, config))}",
        f"G0 X{form.value(x)} Y{form.value(y)}",
    ]
