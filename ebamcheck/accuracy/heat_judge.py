"""One layer judged: how warm its islands are when the beam enters them, by 3DThesis and by our own model, both linear and cold at
first.

3DThesis heats a half space, so that ranks and ratios of orders compare, and rises until heat comes to the sides; with mirrors a
box, the body of our model for a rectangle on an insulated base. It heats line by line: where the beam enters beside what it has
just laid, it finds more."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.controls import thesis
from ebamcheck.curves import Curves
from ebamcheck.errors import NothingCompared, SettingsError
from ebamcheck.heat.island_heat import island_heat
from ebamcheck.kernels import Floats, Ints
from ebamcheck.nc.files import ProgramFiles
from ebamcheck.nc.inputs import CurveColumns, deposition_heights
from ebamcheck.scan.order.entries import entry_temperatures
from ebamcheck.scan.plan.columns import ScanPlan
from ebamcheck.scratch import scratch_folder
from ebamcheck.settings.config import Config
from ebamcheck.slicers.outside.lattices import Program

# Beads that heat: those of the islands, which are what our model of the islands counts, or those along the contour, too
BEADS = ("islands", "all")
# What 3DThesis heats: a half space, or the box around the section, whose sides, and an insulated base, let no heat through
BODIES = ("half-space", "box")
# Places over which an island is averaged, about: the greatest means of ten plans lie within 10 % of those over 400, over 16 within 21 %
PLACES = 64
# Columns of a judged layer; all temperatures in K
COLUMNS = {
    "island": "number of the island in the plan",
    "rank": "its place in the order",
    "entered_s": "when the beam enters it, from the beginning of the layer",
    "x_mm": "where the beam enters it",
    "y_mm": "likewise",
    "model_k": "mean rise of the island when it is entered, by our model",
    "thesis_k": "the same by 3DThesis",
    "thesis_spot_k": "rise where the beam enters it, by 3DThesis",
    "thesis_hottest_k": "rise at the hottest of the places of the island, by 3DThesis",
}


@dataclass(frozen=True, eq=False)
class IslandVisits:
    """When and where the beam enters the islands of a path that have beads (E,), in its order; `beam_s` is the time with the beam
    on, by power."""

    island: Ints
    entered_s: Floats
    left_s: Floats
    beam_s: Floats
    place: Floats

    @classmethod
    def of(cls, path: thesis.HeatPath) -> IslandVisits:
        """Visits of a path of one layer."""
        end_s, line = path.end_s, path.is_line & (path.island >= 0)
        rows = np.flatnonzero(line)
        islands, first = np.unique(path.island[rows], return_index=True)
        entered = np.sort(first)
        order = path.island[rows][entered]
        number = np.searchsorted(islands, path.island[rows])
        lasted = end_s[rows] - end_s[rows - 1]
        beam_s = np.bincount(number, lasted * path.rows[rows, 4], len(islands)).astype(np.float64)
        left_s = np.zeros(len(islands))
        left_s[number] = end_s[rows]  # the last row of each stays
        at = np.searchsorted(islands, order)
        before = rows[entered] - 1  # a spot leads to every bead
        return cls(order, end_s[before], left_s[at], beam_s[at], path.rows[before, 1:4])


@dataclass(frozen=True, eq=False)
class JudgedLayer:
    """Islands of a layer when they are entered, by two models: a table with :data:`COLUMNS`, in scan order."""

    table: pd.DataFrame

    def figures(self) -> dict[str, float]:
        """Greatest rises, agreement in rank, and how much hotter one model is than the other."""
        from scipy.stats import kendalltau, spearmanr

        table = self.table
        ours, theirs = table["model_k"].to_numpy(), table["thesis_k"].to_numpy()
        rises = ("model", "thesis", "thesis_spot", "thesis_hottest")
        # The first island is cold in any model.
        many, rest = len(table) > 2, (ours[1:], theirs[1:])
        return {
            "islands": float(len(table)),
            **{f"{name}_max_k": float(table[f"{name}_k"].max()) for name in rises},
            "kendall_tau": float(kendalltau(*rest).statistic) if many else math.nan,
            "spearman": float(spearmanr(*rest).statistic) if many else math.nan,
            "thesis_over_model": float(theirs.sum() / ours.sum()) if ours.sum() > 0.0 else math.nan,
        }


@dataclass(frozen=True, eq=False)
class LayerCase:
    """A layer as 3DThesis gets it."""

    path: thesis.HeatPath
    islands: NDArray[np.object_]  # (E,) that the beam enters
    visits: IslandVisits
    section: BaseGeometry
    height_mm: float  # over the base plate
    mirrors: thesis.Mirrors | None  # sides of the body of 3DThesis; None: a half space
    owner: Ints  # (P,) visit of each place
    places: Floats  # (P, 3) where temperatures are read: of each island where the beam enters it, then over its area

    @classmethod
    def of(
        cls,
        plan: ScanPlan,
        layer: int,
        section: BaseGeometry,
        config: Config,
        *,
        curves: CurveColumns | None = None,
        height_mm: float | None = None,
        beads: str = BEADS[0],
        body: str = BODIES[0],
        places: int = PLACES,
    ) -> LayerCase:
        """Case of one layer of any plan; without `curves` there are no contour beads, in place or time. About so many `places` make
        an island's mean."""
        for option, value, choices in (("--beads", beads, BEADS), ("--body", body, BODIES)):
            if value not in choices:
                raise SettingsError(f"{option} {value!r}: choose from {', '.join(choices)}")
        whole = thesis.heat_path(_no_contours(plan) if curves is None else curves, plan, config)
        if not (whole.island[whole.layer == layer] >= 0).any():
            raise NothingCompared(f"layer {layer + 1} has no islands whose temperature could be judged")
        path = whole.of_layer(layer)
        visits = IslandVisits.of(path)
        islands = plan.islands[visits.island]
        if height_mm is None:
            height_mm = float(deposition_heights(plan.heights, config.layer_height_mm, config.base_mm)[layer])
        mirrors = None
        if body == BODIES[1]:
            x0, y0, x1, y1 = section.bounds
            # Images are of insulated planes alone, so that a cooled base is left out.
            base_mm = float(path.rows[0, 3]) - height_mm - config.process.base_plate_mm
            mirrors = thesis.Mirrors((x0, x1), (y0, y1), base_mm if config.process.base == "insulated" else None)
        if beads == BEADS[0]:
            path.rows[path.island < 0, 4] = 0.0
        where = _places(islands, visits.place, places)
        return cls(path, islands, visits, section, height_mm, mirrors, *where)

    def write(self, folder: str | Path, config: Config) -> ProgramFiles:
        """Write the whole case: it reads all places at all times, of which each island's own are those judged by."""
        wanted = thesis.readings(self.visits.entered_s.tolist(), self.places, self.mirrors)
        files = {**wanted, **thesis.physics(config)}
        return thesis.write_thesis(self.path, files, folder)


def judge_layer(case: LayerCase, config: Config, progress: Callable[[int], None] = lambda done: None) -> JudgedLayer:
    """Judge one layer: its islands when the beam enters them, by 3DThesis and by our own model; `progress` is told how many are
    done."""
    owner, visits, islands = case.owner, case.visits, case.islands
    lasted = visits.left_s - visits.entered_s
    heat = island_heat(case.section, islands, visits.beam_s, lasted, config, case.height_mm, fine=True)
    area, order = np.asarray(shapely.area(islands), np.float64), np.arange(len(islands))
    ours = entry_temperatures(heat, area, order, visits.entered_s, visits.left_s)[0]
    rises = rises_k(case.path, config, visits.entered_s, owner, case.places, case.mirrors, progress)
    spot = np.searchsorted(owner, order)
    inside = np.delete(np.arange(len(owner)), spot)
    means = np.bincount(owner[inside], rises[inside]) / np.bincount(owner[inside])
    columns = (
        *(visits.island, order, visits.entered_s, visits.place[:, 0], visits.place[:, 1]),
        *(ours, means, rises[spot], np.maximum.reduceat(rises, spot)),
    )
    return JudgedLayer(pd.DataFrame(dict(zip(COLUMNS, columns, strict=True))))


def _places(islands: NDArray[np.object_], entered: Floats, count: int) -> tuple[Ints, Floats]:
    """Where temperatures are read: owner (P,) and place (P, 3); of each island its entry, then places over its area."""
    places = []
    for island, entry in zip(islands, entered, strict=True):
        inside = _spread(island, count)
        places.append(np.vstack([entry, np.column_stack([inside, np.full(len(inside), entry[2])])]))
    return np.repeat(np.arange(len(places)), [len(mine) for mine in places]), np.concatenate(places)


def _spread(island: BaseGeometry, count: int) -> Floats:
    """Places (n, 2) spread evenly over an island: the middles of cells that lie in it."""
    x0, y0, x1, y1 = island.bounds
    step = math.sqrt(max(island.area, 0.0) / count)
    middle = shapely.get_coordinates(island.representative_point())
    if step <= 0.0:
        return middle
    axes = []
    for low, high in ((x0, x1), (y0, y1)):
        # A sliver is long for its area: more places along it than in all tell no more.
        parts = min(max(1, math.ceil((high - low) / step - 1e-9)), count)
        axes.append(low + (high - low) * (np.arange(parts) + 0.5) / parts)
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    found = grid[shapely.contains_xy(island, grid[:, 0], grid[:, 1])]
    return found if len(found) else middle


def _no_contours(plan: ScanPlan) -> Curves:
    none = np.zeros(0, np.int64)
    layers, start, kinds = np.zeros(len(plan) + 1, np.int64), np.zeros(1, np.int64), none.astype(np.uint8)
    closed, control = none.astype(np.bool_), np.zeros((0, 2))
    return Curves(plan.heights, layers, start, closed, kinds, start, control, start, np.zeros(0))


# Moments that one run is asked for, at all places: many at once cost their square, few cost a start each
TIMES_A_RUN = 16
TIME_LIMIT_S = 600.0  # time that one run may take
PLACE_MM = 1e-3  # a place that 3DThesis gives back is this near to the one asked for: it prints six digits


@dataclass(frozen=True)
class _Thesis(Program):
    @property
    def hint(self) -> str:
        return f"build github.com/ORNL-MDF/3DThesis (cmake), and name the executable in {self.variable} or put it on the PATH"

    def path(self) -> Path:
        """Where it is, whatever folder it is run in."""
        return super().path().absolute()


# 3DThesis of Oak Ridge National Laboratory (Stump and Plotkowski 2019): it tells no version
THESIS = _Thesis("3DThesis", "3DThesis", "EBAMCHECK_3DTHESIS", "", (), "")


def rises_k(
    path: thesis.HeatPath,
    config: Config,
    times_s: Floats,
    owner: Ints,
    places: Floats,
    mirrors: thesis.Mirrors | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Floats:
    """Temperature rises (P,), K over ``process.ambient_temperature_k``, at places (P, 3), mm, each at the moment of its owner (E,),
    by 3DThesis.

    Raises BackendMissing where it is not installed, BackendFailed where it fails, or finds that a place was cooled.
    """
    THESIS.path()
    rises = np.empty(len(places))
    by_time = np.argsort(times_s, kind="stable")
    with scratch_folder() as folder:
        case = folder / "case"
        thesis.write_thesis(path, thesis.physics(config), case)
        for begin in range(0, len(times_s), TIMES_A_RUN):
            chosen = by_time[begin : begin + TIMES_A_RUN]
            mine = np.flatnonzero(np.isin(owner, chosen))
            found = _run(case, times_s[chosen], places[mine], mirrors)
            moment = np.argsort(chosen)[np.searchsorted(np.sort(chosen), owner[mine])]
            rises[mine] = found[moment, np.arange(mine.size)]
            progress(len(chosen))
    rises -= config.process.ambient_temperature_k
    if (rises < -1e-3).any():  # of the digits that are printed
        raise THESIS.failed(f"found a place {-rises.min():.3g} K colder than it was at the beginning")
    return rises


def _run(case: Path, times_s: Floats, places: Floats, mirrors: thesis.Mirrors | None) -> Floats:
    for name, text in thesis.fill_case(thesis.readings(times_s.tolist(), places, mirrors)).items():
        (case / name).write_text(text, encoding="ascii")
    results = case / "Data"
    shutil.rmtree(results, ignore_errors=True)
    said = THESIS.run([thesis.INPUT], case, TIME_LIMIT_S)
    # Files with x, y, z in metres, and T in K.
    files = (results / f"{thesis.NAME}.Snapshot.{number:02d}.csv" for number in range(len(times_s)))
    return np.stack([_table(file, places, said) for file in files])


def _table(file: Path, places: Floats, said: str) -> Floats:
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
