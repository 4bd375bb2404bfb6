"""Post-processors for heat simulators: one table of spots and lines, with power and speed.

Each row is a mode, a position, a power and a parameter: mode 1 stays at the position for the parameter in
seconds, mode 0 moves there from the last position at the parameter in m/s. Travel without beam is a spot of no
power that lasts as long as the rapid move. Formats: 3DThesis (``Path.txt``: mm, power as a share of that of the
beam), adamantine ("segment" scan path: m, share, blanks, number of rows in the second line), AdditiveFOAM
(``scanPath``: m, W). All three skip what stands in the first line, where the status is.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ebamcheck.config import Config
from ebamcheck.program.bead_ends import driven_path
from ebamcheck.program.files import NOT_VALIDATED, VALIDATED, ProgramFiles, write_files
from ebamcheck.program.inputs import CurveColumns, Interpass, ScanColumns, interpass_of
from ebamcheck.program.toolpath import Toolpath
from ebamcheck.rings import Floats, Ints

PATH_FILES = ("3dthesis", "adamantine", "additivefoam")
"""Names of these posts: what they write is no program, and is not read back."""

LINE_MODE, SPOT_MODE = 0, 1

LEAST_SPOT_S = 1e-6
"""Shortest time of a spot: simulators divide by the time of a row."""

DECIMALS = 6
"""Of a millimetre; a row in metres has three more."""

METRES = 1e-3
"""Metres in a millimetre; and m/s in a mm/s."""


def write_3dthesis(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: str | Path,
    *,
    validated: bool = False,
    header: Mapping[str, str] | None = None,
) -> ProgramFiles:
    """Write ``Path.txt`` of 3DThesis. `header` has no place in it.

    Takes and raises what :func:`ebamcheck.program.sinumerik.write_program` does.
    """
    rows = _rows(curves, plan, config)
    title = "Mode\tX(mm)\tY(mm)\tZ(mm)\tPmod\ttParam\t" + _status(validated)
    text = _table(rows, "%d\t%.6f\t%.6f\t%.6f\t%g\t%.9g\n")
    return write_files({"Path.txt": f"{title}\n{text}"}, Path(folder), validated=validated)


def write_adamantine(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: str | Path,
    *,
    validated: bool = False,
    header: Mapping[str, str] | None = None,
) -> ProgramFiles:
    """Write ``scan_path.txt`` of adamantine, in its format "segment". `header` has no place in it.

    Takes and raises what :func:`ebamcheck.program.sinumerik.write_program` does.
    """
    rows = _in_metres(_rows(curves, plan, config))
    title = f"Number of path segments {_status(validated)}\n{len(rows)}\nMode x y z pmod param"
    text = _table(rows, "%d %.9f %.9f %.9f %g %.9g\n")
    return write_files({"scan_path.txt": f"{title}\n{text}"}, Path(folder), validated=validated)


def write_additivefoam(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: str | Path,
    *,
    validated: bool = False,
    header: Mapping[str, str] | None = None,
) -> ProgramFiles:
    """Write ``scanPath`` of AdditiveFOAM. `header` has no place in it.

    Takes and raises what :func:`ebamcheck.program.sinumerik.write_program` does.
    """
    rows = _in_metres(_rows(curves, plan, config))
    rows[:, 4] *= config.process.power_w
    title = f"Mode X(m) Y(m) Z(m) Power(W) Parameter {_status(validated)}"
    text = _table(rows, "%d %.9f %.9f %.9f %.9g %.9g\n")
    return write_files({"scanPath": f"{title}\n{text}"}, Path(folder), validated=validated)


def _status(validated: bool) -> str:
    return VALIDATED if validated else NOT_VALIDATED


def _in_metres(rows: Floats) -> Floats:
    rows[:, 1:4] *= METRES
    return rows


def _table(rows: Floats, line: str) -> str:
    return (line * len(rows)) % tuple(rows.ravel().tolist())


def _rows(curves: CurveColumns, plan: ScanColumns, config: Config) -> Floats:
    """Rows (n, 6): mode, X, Y, Z in mm, share of the power, and s for a spot or m/s for a line."""
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
    rows[spot, 4], rows[line, 4] = 0.0, path.power
    rows[line, 5] = config.process.travel_speed_mm_s * METRES
    rows[spot, 5] = _travel_s(path, rows, spot, config)
    heat = interpass_of(plan, config)
    layer = np.repeat(np.arange(len(path.z)), np.diff(path.layer_starts))[tracks]
    rows[spot, 5] += _waits_s(layer, path.ring[tracks], path.island[tracks], heat)
    rows[line, 4] *= np.repeat(heat.power_share[layer], sizes)
    return rows


def _waits_s(layer: Ints, ring: Ints, island: Ints, heat: Interpass) -> Floats:
    """Wait before each track (T,): before a layer that is not the first, a further contour, or an island."""
    new_layer = np.diff(layer, prepend=-1) != 0
    new_island = (island >= 0) & (np.diff(island, prepend=-1) != 0)
    waits = np.where(new_layer, heat.wait_s[layer], np.where(ring >= 0, heat.ring_wait_s[layer], 0.0))
    waits[:1] = 0.0
    waits[new_island] += heat.island_wait_s[island[new_island]]
    return np.asarray(waits, np.float64)


def _travel_s(
    path: Toolpath, rows: Floats, spot: np.ndarray[tuple[int], np.dtype[np.int64]], config: Config
) -> Floats:
    """Time of the rapid move to each track; the first is where the beam is."""
    away = np.zeros(spot.size)
    if spot.size:
        away[1:] = np.linalg.norm(rows[spot[1:], 1:4] - rows[spot[1:] - 1, 1:4], axis=1)
    return np.maximum(away / config.machine.rapid_mm_s, LEAST_SPOT_S)
