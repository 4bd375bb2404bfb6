"""The form of the table of limits: what is judged, and how a figure of so many times its limit is planted in a sound program.

The table itself stands in `limits_of_*.py`, by what is judged. Every figure is planted by the number that stands there, and by no
constant of the code: a limit that is changed no longer lies between its two cases.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from nc_stack import make_curves, make_plan
from small_parts import made

from ebamcheck.layers.stack import from_polygons
from ebamcheck.nc.motions import STRAIGHT, NCProgram
from ebamcheck.nc.timeline import Events
from ebamcheck.program import Check, read_program, verify_program, write_program
from ebamcheck.settings.config import Config

INSIDE, OUTSIDE = 1.0 / 1.2, 1.2
HIGH_MM = 1.5 * (np.pi * 0.8**2 * 2000.0 / 60.0 / 10.0) / 6.0
"""Height of a layer: of a bead of 1.6 mm wire at 2 m/min and 10 mm/s, 6 mm wide."""

FOLDERS: list[tempfile.TemporaryDirectory] = []


@dataclass(frozen=True, eq=False)
class Subject:
    """A program, the settings it is judged by, and what else is known of it: what `verify_program` takes."""

    nc: NCProgram
    config: Config
    known: dict[str, Any] = field(default_factory=dict)

    def checks(self, *needs: str) -> dict[str, Check]:
        """Checks by name; of what is known only `needs` is given."""
        given = {name: self.known.get(name, True) for name in needs}
        return {check.name: check for check in verify_program(self.nc, config=self.config, **given)}

    # -- the same with something changed ---------------------------------------------------------------

    def by(self, **sections: dict[str, Any]) -> Subject:
        """Judged by other settings."""
        return replace(self, config=self.config.changed(**sections))

    def given(self, **known: Any) -> Subject:
        """With something else known."""
        return replace(self, known=self.known | known)

    def with_columns(self, rows: Any, **values: Any) -> Subject:
        """Other values in some rows of its columns."""
        columns = {name: getattr(self.nc, name).copy() for name in values}
        for name, value in values.items():
            columns[name][rows] = value
        return replace(self, nc=replace(self.nc, **columns))

    def with_ends(self, rows: Any, by_mm: Any, axis: int) -> Subject:
        """Ends of motions elsewhere, and with them the starts of the motions behind them."""
        start, end = self.nc.start.copy(), self.nc.end.copy()
        rows = np.atleast_1d(rows)
        end[rows, axis] += by_mm
        after = rows + 1 < len(end)
        start[rows[after] + 1, axis] += np.broadcast_to(by_mm, rows.shape)[after]
        return replace(self, nc=replace(self.nc, start=start, end=end, coefficients=_straight(self.nc, start, end)))

    def with_values(self, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Subject:
        """Other numbers of all events of a name, but of those that are 0."""
        events, value = self.nc.events, self.nc.events.value.copy()
        mine = np.array([n == name for n in events.name]) & (value != 0.0)
        assert mine.any(), name
        value[mine] = change(value[mine])
        return replace(self, nc=replace(self.nc, events=replace(events, value=value)))

    def with_event(self, row: int, name: str, value: float = np.nan) -> Subject:
        """One more event before a motion."""
        e, nc = self.nc.events, self.nc
        at = int(np.searchsorted(e.row, row, side="right"))
        line = int(nc.line[min(row, len(nc) - 1)])
        events = Events(
            np.insert(e.file, at, nc.file[min(row, len(nc) - 1)]), np.insert(e.line, at, line), np.insert(e.row, at, row),
            (*e.name[:at], name, *e.name[at:]), np.insert(e.value, at, value),
        )  # fmt: skip
        return replace(self, nc=replace(nc, events=events))

    def with_text(self, change: Callable[[dict[str, list[str]]], Any]) -> Subject:
        """With other lines, by the name of their file."""
        lines = {file.name: file.data.decode().split("\n") for file in self.nc.files}
        change(lines)
        folder = _folder()
        for name, text in lines.items():
            (folder / name).write_bytes("\n".join(text).encode("latin-1"))
        return replace(self, nc=read_program(folder / self.nc.files[0].name, self.config))

    # -- where things are ------------------------------------------------------------------------------

    @property
    def metal(self) -> np.ndarray:
        """Rows with metal."""
        return np.flatnonzero(self.nc.deposit)

    def of_layer(self, k: int) -> np.ndarray:
        """Rows with metal of a layer, from 0."""
        return self.metal[self.nc.layer[self.metal] == k]


def _straight(nc: NCProgram, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    found = nc.coefficients.copy()
    flat = nc.kind <= STRAIGHT
    found[flat, :, 0], found[flat, :, 1] = start[flat, :2], (end - start)[flat, :2]
    return found


@dataclass(frozen=True, eq=False)
class Case:
    """A limit with its two cases.

    Parameters
    ----------
    check
        Name of the check.
    limits
        Constants (``module.NAME``) and settings (``section.name``) that make the limit.
    plant
        Subject in which the figure is so many times the limit.
    needs
        What the check has to know: names of parameters of `verify_program`.
    judge
        How the check is made, where `verify_program` does not make it.
    inside, outside
        Times the limit with which the check passes and fails.
    """

    check: str
    limits: tuple[str, ...]
    plant: Callable[[float], Any]
    needs: tuple[str, ...] = ()
    judge: Callable[[Any], Check] | None = None
    inside: float = INSIDE
    outside: float = OUTSIDE

    def verdict(self, factor: float) -> Check:
        """The check of the case with a figure of so many times the limit."""
        subject = self.plant(factor)
        return self.judge(subject) if self.judge else subject.checks(*self.needs)[self.check]

    def __str__(self) -> str:
        return f"{self.check}: {', '.join(self.limits)}"


def upwards(check: str, limits: str, plant: Callable[[float], Any], *needs: str, **more: Any) -> Case:
    """A figure that fails over its limit; `limits` in one text, with blanks between."""
    return Case(check, tuple(limits.split()), plant, needs, **more)


def downwards(check: str, limits: str, plant: Callable[[float], Any], *needs: str, **more: Any) -> Case:
    """A figure that fails under its limit."""
    return upwards(check, limits, plant, *needs, inside=OUTSIDE, outside=INSIDE, **more)


# -- programs ------------------------------------------------------------------------------------------


def _folder() -> Path:
    FOLDERS.append(tempfile.TemporaryDirectory())
    return Path(FOLDERS[-1].name)


@cache
def cube() -> Subject:
    """A cube of 30 mm in four layers, with its plan and its sections."""
    part = made("cube")
    files = write_program(part.beads, part.plan, part.config, _folder())
    known = {"curves": part.beads, "plan": part.plan, "layers": part.sections}
    return Subject(read_program(files.main, part.config), part.config, known)


def program_of(layers, sections=None, rings=None, **settings) -> Subject:
    """A program of beads of given points, 1.5 mm a layer: ``[[[(x, y), ...], ...], ...]`` by layer and bead; every bead is an island.

    `rings` are closed contours by layer, and `sections` one polygon for all layers or one each.
    """
    config = Config().changed(**{"layers": {"layer_height_mm": 1.5}, "process": {"interpass": "off"}} | settings)
    heights = (np.arange(len(layers)) + 0.5) * 1.5
    rings = rings or [[] for _ in layers]
    curves = make_curves(
        heights, [[[(np.asarray(ring, float), None)] for ring in layer] for layer in rings], [True] * sum(map(len, rings))
    )  # fmt: skip
    islands = [
        (k, [(*a, *b) for a, b in pairwise(bead)]) for k, beads in enumerate(layers) for bead in beads
    ]  # fmt: skip
    plan = make_plan(heights, islands)
    files = write_program(curves, plan, config, _folder())
    known: dict[str, Any] = {"curves": curves, "plan": plan, "heights": heights}
    if sections is not None:
        each = sections if isinstance(sections, list) else [sections] * len(layers)
        known["layers"] = from_polygons(heights, [list(shapely.get_parts(section)) for section in each])
    return Subject(read_program(files.main, config), config, known)
