"""The program 3DThesis: run a case, and read the temperatures that it finds."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ebamcheck.controls.thesis import (
    INPUT,
    HeatPath,
    Mirrors,
    fill_case,
    physics,
    readings,
    snapshot,
    write_thesis,
)
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scratch import scratch_folder
from ebamcheck.settings.config import Config
from ebamcheck.slicers.outside.programs import Program

TIMES_A_RUN = 16
"""Moments that one run of 3DThesis is asked for. It takes all places at all moments, of which only each island's own are
wanted: many at once cost their square, few cost a start each."""

TIME_LIMIT_S = 600.0
"""Time that one run may take."""

PLACE_MM = 1e-3
"""A place that 3DThesis gives back is this near to the one asked for: it prints six digits."""

FEWEST_K = -1e-3
"""Least rise that is no fault: nothing is cooled, but for the digits that are printed."""


@dataclass(frozen=True)
class _Thesis(Program):
    @property
    def hint(self) -> str:
        return f"build github.com/ORNL-MDF/3DThesis (cmake), and name the executable in {self.variable} or put it on the PATH"

    def path(self) -> Path:
        """Where it is, whatever folder it is run in."""
        return super().path().absolute()


THESIS = _Thesis("3DThesis", "3DThesis", "EBAMCHECK_3DTHESIS", "", (), "")
"""3DThesis of Oak Ridge National Laboratory (Stump and Plotkowski 2019): it tells no version."""


def rises_k(
    path: HeatPath,
    config: Config,
    times_s: Floats,
    owner: Ints,
    places: Floats,
    mirrors: Mirrors | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Floats:
    """Temperature rises at places, each at the moment of its owner, by 3DThesis.

    Parameters
    ----------
    path
        Path of one layer.
    times_s
        (E,) moments from the beginning of the path.
    owner, places
        (P,) moment of each place, rising; (P, 3) mm.
    mirrors
        Sides of the body; a half space if None.
    progress
        Told how many moments are done.

    Returns
    -------
    rises
        (P,) K over ``process.ambient_temperature_k``.

    Raises
    ------
    BackendMissing
        If 3DThesis is not installed.
    BackendFailed
        If it fails, runs too long, leaves no temperatures, or finds that a place was cooled.
    """
    THESIS.path()
    rises = np.empty(len(places))
    by_time = np.argsort(times_s, kind="stable")
    with scratch_folder() as folder:
        case = folder / "case"
        write_thesis(path, physics(config), case)
        for begin in range(0, len(times_s), TIMES_A_RUN):
            chosen = by_time[begin : begin + TIMES_A_RUN]
            mine = np.flatnonzero(np.isin(owner, chosen))
            found = _run(case, times_s[chosen], places[mine], mirrors)
            moment = np.argsort(chosen)[np.searchsorted(np.sort(chosen), owner[mine])]
            rises[mine] = found[moment, np.arange(mine.size)]
            progress(len(chosen))
    rises -= config.process.ambient_temperature_k
    if (rises < FEWEST_K).any():
        raise THESIS.failed(f"found a place {-rises.min():.3g} K colder than it was at the beginning")
    return rises


def _run(case: Path, times_s: Floats, places: Floats, mirrors: Mirrors | None) -> Floats:
    """Temperatures (E, P) of places at all of the moments."""
    for name, text in fill_case(readings(times_s.tolist(), places, mirrors)).items():
        (case / name).write_text(text, encoding="ascii")
    results = case / "Data"
    shutil.rmtree(results, ignore_errors=True)
    said = THESIS.run([INPUT], case, TIME_LIMIT_S)
    return np.stack([_table(results / snapshot(n), places, said) for n in range(len(times_s))])


def _table(file: Path, places: Floats, said: str) -> Floats:
    """Temperatures (P,) of one result file, which must be of these places."""
    try:
        lines = file.read_text(encoding="ascii").splitlines()
        table = np.array([[float(word) for word in line.split(",")] for line in lines[1:]])
    except (OSError, ValueError):
        raise THESIS.failed(f"left no temperatures in {file.name}", said) from None
    if table.shape != (len(places), 4) or not np.isfinite(table).all():
        raise THESIS.failed(f"left no temperature for each of {len(places)} places in {file.name}", said)
    away_mm = np.abs(1e3 * table[:, :3] - places).max(initial=0.0)
    if away_mm > PLACE_MM * max(1.0, float(np.abs(places).max(initial=0.0)) / 100.0):
        raise THESIS.failed(f"gave temperatures of other places in {file.name}, {away_mm:.3g} mm away", said)
    return np.asarray(table[:, 3], np.float64)
