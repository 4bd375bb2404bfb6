"""Post-processor for the heat simulator 3DThesis: a whole case around one table of spots and lines, with power and speed.

Each row is a mode, a position in mm, a power as a share of the beam's, and a parameter: mode 1 stays at the position for the
parameter in seconds, mode 0 moves there from the last position at the parameter in m/s. Travel without beam is a spot of no
power that lasts as long as the rapid move. The first line, where the status is, is skipped. The other files of a case are those of
:mod:`~ebamcheck.controls.thesis_case`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from ebamcheck.controls.thesis_case import thesis_files
from ebamcheck.errors import SettingsError
from ebamcheck.nc.control import Control
from ebamcheck.nc.control import control as control_named
from ebamcheck.nc.files import NOT_VALIDATED, VALIDATED, ProgramFiles, write_files
from ebamcheck.nc.inputs import CurveColumns, Interpass, ScanColumns, interpass_of
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import driven_path
from ebamcheck.writing.bead_power import power_shares
from ebamcheck.writing.tracks import Toolpath

SCRIPT = "run.sh"
"""What runs a case."""

STATUS = "@status@"
"""Stands in the texts of a case where its status will be."""

LINE_MODE, SPOT_MODE = 0, 1

LEAST_SPOT_S = 1e-6
"""Shortest time of a spot: simulators divide by the time of a row."""

DECIMALS = 6
"""Of a millimetre."""

METRES = 1e-3
"""Metres in a millimetre; and m/s in a mm/s."""

THESIS = Control("3dthesis", f"{__name__}:write_3dthesis")
"""The simulator as a control, whose cases no reader proves."""


@dataclass(frozen=True, eq=False)
class HeatPath:
    """The path of a stack as simulators take it.

    Parameters
    ----------
    rows
        (n, 6) mode, X, Y, Z in mm, share of the power, and s for a spot or m/s for a line.
    layer, island
        (n,) of each row; -1 for the island of a contour.
    """

    rows: Floats
    layer: Ints
    island: Ints

    @property
    def is_line(self) -> Bools:
        """(n,) rows that move."""
        return np.asarray(self.rows[:, 0] == LINE_MODE)

    @property
    def end_s(self) -> Floats:
        """(n,) time at which each row is done, from the beginning of the path, as simulators add it up."""
        way = np.zeros(len(self.rows))
        way[1:] = np.linalg.norm(np.diff(self.rows[:, 1:4], axis=0), axis=1)
        line = self.is_line
        moved = np.divide(way * METRES, self.rows[:, 5], out=np.zeros(len(way)), where=line)
        return np.asarray(np.cumsum(np.where(line, moved, self.rows[:, 5])), np.float64)

    def of_layer(self, layer: int | None) -> HeatPath:
        """Path of one layer, which begins where its first bead does; the whole path for None.

        Raises
        ------
        SettingsError
            If the path has no such layer.
        """
        if layer is None:
            return self
        if not (self.layer == layer).any():
            found = f"{self.layer.min() + 1} to {self.layer.max() + 1}" if len(self.layer) else "none"
            raise SettingsError(f"--layer {layer + 1}: the path has no bead there; its layers are {found}")
        mine = self.layer == layer
        rows = self.rows[mine]
        rows[0, 5] = LEAST_SPOT_S
        return HeatPath(rows, self.layer[mine], self.island[mine])

    def without_power(self, rows: Bools) -> HeatPath:
        """Return the same path with the beam off on some rows."""
        changed = self.rows.copy()
        changed[rows, 4] = 0.0
        return replace(self, rows=changed)


class CasePost(Protocol):
    """A post of this module: it takes a layer, which programs for controls do not."""

    def __call__(
        self,
        curves: CurveColumns,
        plan: ScanColumns,
        config: Config,
        folder: str | Path,
        *,
        validated: bool = False,
        header: Mapping[str, str] | None = None,
        layer: int | None = None,
    ) -> ProgramFiles:
        """Write a case."""
        ...


def case_post(control: str) -> CasePost:
    """Post of a simulator; raises :class:`SettingsError` for a control, which no single layer can be written for."""
    found = control_named(control)
    if found.is_read:
        raise SettingsError(f"--layer: {control} takes a whole program; one layer is for heat simulators")
    post: CasePost = found.load("writer")
    return post


def write_3dthesis(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: str | Path,
    *,
    validated: bool = False,
    header: Mapping[str, str] | None = None,
    layer: int | None = None,
) -> ProgramFiles:
    """Write a case of 3DThesis, its ``Path.txt`` first; of one layer where one is given. `header` has no place in it.

    Takes and raises what :func:`ebamcheck.controls.sinumerik.writing.write_program` does.
    """
    path = heat_path(curves, plan, config).of_layer(layer)
    return write_thesis(path, thesis_files(path.rows, config), folder, validated=validated)


def write_thesis(
    path: HeatPath, others: Mapping[str, str], folder: str | Path, *, validated: bool = False
) -> ProgramFiles:
    """Write a case of 3DThesis from its path and its other files."""
    title = f"Mode\tX(mm)\tY(mm)\tZ(mm)\tPmod\ttParam\t{STATUS}"
    text = _table(path.rows, "%d\t%.6f\t%.6f\t%.6f\t%g\t%.9g\n")
    return _write({"Path.txt": f"{title}\n{text}", **others}, folder, validated)


def fill_case(texts: Mapping[str, str], *, validated: bool = False) -> dict[str, str]:
    """Texts of a case with their status."""
    status = VALIDATED if validated else NOT_VALIDATED
    return {name: text.replace(STATUS, status, 1) for name, text in texts.items()}


def _write(texts: Mapping[str, str], folder: str | Path, validated: bool) -> ProgramFiles:
    return write_files(fill_case(texts, validated=validated), Path(folder), validated=validated)


def _table(rows: Floats, line: str) -> str:
    return (line * len(rows)) % tuple(rows.ravel().tolist())


def heat_path(curves: CurveColumns, plan: ScanColumns, config: Config) -> HeatPath:
    """Path of a stack: a spot without power leads to each bead, and lasts as long as the way there."""
    path = driven_path(curves, plan, config, DECIMALS, "all chords", config.machine.line_tolerance_mm)
    sizes = np.diff(path.track_starts)
    tracks = np.flatnonzero(sizes > 0)
    sizes = sizes[tracks]
    z = np.repeat(path.z, np.diff(path.layer_starts))[tracks]
    rows = np.empty((int(sizes.sum()) + tracks.size, 6))
    spot = np.concatenate([[0], np.cumsum(sizes + 1)])[:-1].astype(np.int64)
    line = np.ones(len(rows), np.bool_)
    line[spot] = False
    rows[:, 0] = np.where(line, LINE_MODE, SPOT_MODE)
    rows[spot, 1:3], rows[line, 1:3] = path.start[tracks], path.end
    rows[:, 3] = np.repeat(z, sizes + 1)
    rows[line, 5] = config.process.travel_speed_mm_s * METRES
    rows[spot, 5] = _travel_s(path, rows, spot, config)
    heat = interpass_of(plan, config)
    layer = np.repeat(np.arange(len(path.z)), np.diff(path.layer_starts))[tracks]
    rows[spot, 5] += _waits_s(layer, path.ring[tracks], path.island[tracks], heat)
    rows[spot, 4], rows[line, 4] = 0.0, power_shares(path, heat, config)
    return HeatPath(rows, np.repeat(layer, sizes + 1), np.repeat(path.island[tracks], sizes + 1))


def _waits_s(layer: Ints, ring: Ints, island: Ints, heat: Interpass) -> Floats:
    """Wait before each track (T,): before a layer that is not the first, a further contour, an island, or within it."""
    new_layer = np.diff(layer, prepend=-1) != 0
    new_island = (island >= 0) & (np.diff(island, prepend=-1) != 0)
    waits = np.where(new_layer, heat.wait_s[layer], np.where(ring >= 0, heat.ring_wait_s[layer], 0.0))
    waits[:1] = 0.0
    inner = (island >= 0) & ~new_island
    waits[new_island] += heat.island_wait_s[island[new_island]]
    waits[inner] += heat.inner_wait_s[island[inner]]
    return np.asarray(waits, np.float64)


def _travel_s(
    path: Toolpath, rows: Floats, spot: np.ndarray[tuple[int], np.dtype[np.int64]], config: Config
) -> Floats:
    """Time of the rapid move to each track; the first is where the beam is."""
    away = np.zeros(spot.size)
    if spot.size:
        away[1:] = np.linalg.norm(rows[spot[1:], 1:4] - rows[spot[1:] - 1, 1:4], axis=1)
    return np.maximum(away / config.machine.rapid_mm_s, LEAST_SPOT_S)
