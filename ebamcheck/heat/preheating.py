"""A preheating scan: the region that it covers, the lines of each pass, and its heat.

The heat's mean is that of the body, by the column of the balance; what differs across it goes by modes. The body is the base plate,
or what stands under the layer that comes. The beam is wide and moves along lines; heat enters at the surface. Its way is given as
pieces in time, from a plan or from the text of a program, and both are simulated by the same steps."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.regions import eroded
from ebamcheck.heat import HeatModel, Medium, contour_modes, depth_modes
from ebamcheck.heat.balance import LARGEST_CELL_MM, HeatColumn
from ebamcheck.heat.field import Field
from ebamcheck.heat.modes import one_blas_thread
from ebamcheck.heat.part_heat import PartHeat
from ebamcheck.kernels import Bools, Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.stages import AIM_K, JOINED_SPACINGS, LEAST_LINE_MM, LEAST_REST_S

SIGMAS = 4.0  # diameter of a spot over the standard deviation of its intensity (ISO 11146)
MOST_MODES, DEPTH_MODES = 500, 12  # modes of the section and of the depth
CELLS = 4.0  # cells of the section in the shortest wave
# The column is stepped by about so long a time; waits from so long on are stepped by themselves; more than there ever are
CHUNK_S, LONG_S, CHUNKS = 10.0, 1.0, 1_000_000
MOST_PLACES = 900  # places at which the temperature is read, about
MOMENTS = 400  # moments of the past in the sum for the temperature under a moving spot
WITHIN_MM = 1e-6  # rounding of a way within a region


@dataclass(frozen=True, eq=False)
class BeamWay:
    """What the beam does, piece by piece (n,), straight, in order of time.

    `start`, `end`: (n, 2) mm; `time_s`, `power_w`: (n,) time of each, and the beam's power in it; 0 where it is off.
    """

    start: Floats
    end: Floats
    time_s: Floats
    power_w: Floats

    @property
    def energy_j(self) -> float:
        """Energy of the beam."""
        return float(self.power_w @ self.time_s)

    def cut(self, most_mm: float) -> BeamWay:
        """Return the same way in pieces of at most a length."""
        length = np.hypot(*(self.end - self.start).T)
        count = np.where(self.power_w > 0.0, np.maximum(np.ceil(length / most_mm), 1.0), 1.0).astype(np.int64)
        owner = np.repeat(np.arange(count.size), count)
        number = np.arange(owner.size) - np.repeat(np.cumsum(count) - count, count)
        low, high = (number / count[owner])[:, None], ((number + 1) / count[owner])[:, None]
        way = (self.end - self.start)[owner]
        a = self.start[owner]
        return BeamWay(a + low * way, a + high * way, (self.time_s / count)[owner], self.power_w[owner])


@dataclass(frozen=True)
class SurfaceK:
    """Temperatures of a scanned surface, absolute, K, and where it is coldest and hottest."""

    mean_k: float
    least_k: float
    least_at_mm: tuple[float, float]
    most_k: float
    most_at_mm: tuple[float, float]

    @property
    def spread_k(self) -> float:
        """Greatest difference."""
        return self.most_k - self.least_k


class SurfaceHeat:
    """A body whose surface is scanned.

    `column`: its mean, which grows warmer; `body`, `region`: outline of what the heat spreads in, and of what is scanned,
    where temperatures are read; `depth_mm`: of the body, down to the table.
    """

    def __init__(
        self, column: HeatColumn, body: BaseGeometry, region: BaseGeometry, depth_mm: float, config: Config
    ) -> None:
        self.column, self._config = column, config
        medium, spacing_mm = Medium.of(config), config.preheat.spacing_mm
        largest = (2.0 * math.pi / max(2.0 * spacing_mm, 0.5 * config.preheat.spot_mm)) ** 2
        plane = contour_modes(body, largest, MOST_MODES, CELLS)
        loss = medium.radiation_w_mm2k / medium.conductivity_w_mmk
        depth = depth_modes(depth_mm, DEPTH_MODES, config.process.base == "cooled", loss)
        self.model = HeatModel(plane, depth, medium, min(LARGEST_CELL_MM, depth_mm))
        flat = plane.integral()
        self._mean = np.asarray((flat / (flat @ flat))[:, None], np.float64)
        sigma_mm = config.preheat.spot_mm / SIGMAS
        self._blur = np.exp(-0.5 * plane.eigenvalue * sigma_mm**2)[:, None]
        self.field = Field.of(self.model)
        self._places = _places(region)
        self._at_places = plane.at(self._places) - self._mean.T
        self._piece_mm = 2.0 * spacing_mm

    def copy(self) -> SurfaceHeat:
        """Return the same body, to be simulated by itself."""
        other = object.__new__(SurfaceHeat)
        vars(other).update(vars(self))
        other.column, other.field = self.column.copy(), self.field.copy()
        return other

    @one_blas_thread()
    def simulate(self, way: BeamWay) -> None:
        """Let the beam go its way."""
        if not way.time_s.size:
            return
        taken = self._config.material.absorptivity
        # A long wait is a time of its own: what is heated before it is not spread over it.
        waits = (way.power_w == 0.0) & (way.time_s > LONG_S)
        parts = np.cumsum(waits | np.concatenate([[False], waits[:-1]]))
        chunk = parts * CHUNKS + np.floor(np.cumsum(np.where(waits, 0.0, way.time_s)) / CHUNK_S).astype(
            np.int64
        )
        for number in np.unique(chunk):
            rows = chunk == number
            self.column.advance(
                float(way.time_s[rows].sum()), float(way.power_w[rows] @ way.time_s[rows]) * taken
            )
        fine = way.cut(self._piece_mm)
        shapes = (self.model.plane.at(0.5 * (fine.start + fine.end)).T - self._mean) * self._blur
        source = fine.power_w * taken / self.model.medium.heat_capacity_j_mm3k
        self.field.add(shapes, source, fine.time_s)

    def rest(self, duration_s: float) -> None:
        """Let a time go by with the beam off."""
        here = np.zeros((1, 2)) + self._places[:1]
        self.simulate(BeamWay(here, here, np.array([duration_s]), np.zeros(1)))

    def read(self) -> SurfaceK:
        """Read the temperatures of the scanned surface."""
        away = self._at_places @ self.field.surface()
        found = self.column.surface_k + away
        low, high = int(np.argmin(found)), int(np.argmax(found))
        return SurfaceK(
            float(found.mean()), float(found[low]), self._place(low), float(found[high]), self._place(high)
        )

    def _place(self, n: int) -> tuple[float, float]:
        x, y = self._places[n].tolist()
        return round(x, 2), round(y, 2)

    def content_under_region(self) -> Floats:
        """Heat content of the cells of the column under what was scanned, J/mm^3."""
        edges, depth = self.column.edges_mm, self.model.depth
        below = np.maximum(edges[-1] - 0.5 * (edges[1:] + edges[:-1]), 0.0)
        away = self._at_places.mean(axis=0) @ self.field.state @ depth.at(np.minimum(below, depth.depth_mm)).T
        tables = self.column.tables
        assert tables is not None
        return tables.heat_content(self.column.temperature_k + away)


def _places(region: BaseGeometry) -> Floats:
    """Places on a lattice within a region (m, 2); at least one."""
    step = math.sqrt(max(region.area, 1e-9) / MOST_PLACES)
    x0, y0, x1, y1 = shapely.bounds(region)
    x, y = (np.arange(a + 0.5 * step, b, step) for a, b in ((x0, x1), (y0, y1)))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    inside = grid[shapely.contains_xy(region, grid[:, 0], grid[:, 1])] if grid.size else grid
    if len(inside):
        return np.asarray(inside, np.float64)
    return np.array([shapely.point_on_surface(region).coords[0]], np.float64)


def bare_plate(body: BaseGeometry, config: Config) -> HeatColumn:
    """Return the column of a base plate on which nothing stands yet, cold."""
    column = HeatColumn(config)
    column.lay_plate(body.area)
    return column


def spot_peak_k(power_w: float, speed_mm_s: float, config: Config) -> float:
    """Rise of the surface under a moving beam of the settings' spot over what it comes to, K, at most.

    A Gaussian source on a half space of constant data: each moment of the past has spread to the variance sigma^2 + 2 alpha t and
    sunk in by 1 / sqrt(pi alpha t) (Cline and Anthony 1977). The sum is over sqrt(t), which takes the pole away.
    """
    medium, sigma = Medium.of(config), config.preheat.spot_mm / SIGMAS
    alpha = medium.diffusivity_mm2_s
    longest_s = 20.0 * sigma / speed_mm_s + sigma**2 / alpha
    root = (np.arange(MOMENTS) + 0.5) * math.sqrt(longest_s) / MOMENTS
    past_s, width = root**2, sigma**2 + 2.0 * alpha * root**2
    behind = np.linspace(-2.0 * sigma, 6.0 * sigma, 81)[:, None]
    away = np.exp(-((behind - speed_mm_s * past_s) ** 2) / (2.0 * width))
    per_moment = away / (2.0 * math.pi * width) / np.sqrt(math.pi * alpha)
    source = power_w * config.material.absorptivity / medium.heat_capacity_j_mm3k
    return float(source * (2.0 * per_moment).sum(axis=1).max() * math.sqrt(longest_s) / MOMENTS)


# -- region and lines ---------------------------------------------------------------------------------


def plate_of(section: BaseGeometry, config: Config) -> BaseGeometry:
    """Base plate of the settings; where they have none, the box around the lowest section and the margin."""
    low, high = config.machine.base_plate_min_mm, config.machine.base_plate_max_mm
    if low is not None and high is not None:
        return shapely.box(*low, *high)
    return _grown_box(section, config)


def plate_region(section: BaseGeometry, config: Config) -> BaseGeometry:
    """Region of the base plate that is scanned: around the lowest section, and half a spot within the plate."""
    room_mm = 0.5 * config.preheat.spot_mm
    plate = plate_of(section, config)
    if config.machine.base_plate_min_mm is not None:
        plate = eroded(plate, room_mm)
    return _free(shapely.intersection(plate, _grown_box(section, config)), 0.0, config)


def layer_region(section: BaseGeometry, top_mm: float, config: Config) -> BaseGeometry:
    """Region of what stands that is scanned: half a spot within its section. It may be empty."""
    return _free(eroded(section, 0.5 * config.preheat.spot_mm), top_mm, config)


def _grown_box(section: BaseGeometry, config: Config) -> BaseGeometry:
    x0, y0, x1, y1 = shapely.bounds(section)
    margin_mm = config.preheat.margin_mm
    box: BaseGeometry = shapely.box(x0 - margin_mm, y0 - margin_mm, x1 + margin_mm, y1 + margin_mm)
    return box


def _free(region: BaseGeometry, z_mm: float, config: Config) -> BaseGeometry:
    """Region without clamps that stand over a height, and half a spot around them."""
    for place in config.process.keep_out:
        if place.z_mm[1] > z_mm:
            around = shapely.buffer(shapely.Polygon(place.outline_mm), 0.5 * config.preheat.spot_mm)
            region = shapely.difference(region, around)
    return region


def pass_lines(region: BaseGeometry, config: Config, number: int) -> tuple[Floats, Bools]:
    """Lines of one pass, in order, back and forth.

    `number`: of the pass, from 0: every second one lies across (crossed), or half a spacing aside (lines).

    Returns `lines`: (n, 4) x, y of the start and of the end of each; `joined`: (n,) whether the beam stays on from the line
    before.

    Examples
    --------
    >>> lines, joined = pass_lines(shapely.box(0, 0, 60, 20), Config(), 0)
    >>> lines[:, 1].tolist(), joined.tolist()
    ([5.0, 15.0], [False, True])
    """
    settings = config.preheat
    across = settings.pattern == "crossed" and number % 2 == 1
    turned = _swapped(region) if across else region
    aside = number // 2 % 2 if settings.pattern == "crossed" else number % 2
    lines = _rows(turned, settings.spacing_mm, 0.5 * settings.spacing_mm * aside)
    if across:
        lines = lines[:, [1, 0, 3, 2]]
    joined = np.zeros(len(lines), np.bool_)
    near = shapely.buffer(region, WITHIN_MM)
    for n, (a, b) in enumerate(itertools.pairwise(lines), 1):
        way = shapely.LineString([a[2:], b[:2]])
        joined[n] = way.length <= JOINED_SPACINGS * settings.spacing_mm and near.covers(way)
    return lines, joined


def _rows(region: BaseGeometry, spacing_mm: float, shift_mm: float) -> Floats:
    """Lines along X (n, 4) over a region, row by row, every second row the other way; rows lie evenly between its ends."""
    if region.is_empty:
        return np.zeros((0, 4))
    x0, y0, x1, y1 = shapely.bounds(region)
    count = max(1, round((y1 - y0) / spacing_mm))
    step = (y1 - y0) / count
    rows = y0 + (np.arange(count) + 0.5) * step + shift_mm
    found: list[Floats] = []
    for k, y in enumerate(rows[rows < y1].tolist()):
        cut = shapely.intersection(region, shapely.LineString([(x0 - 1.0, y), (x1 + 1.0, y)]))
        # From left to right: where a border touches the row, pieces of it come in either direction.
        ends = shapely.bounds(
            [part for part in shapely.get_parts(cut) if part.length > LEAST_LINE_MM]
        ).reshape(-1, 4)
        ends = ends[np.argsort(ends[:, 0])]
        found.append(ends if k % 2 == 0 else ends[::-1][:, [2, 3, 0, 1]])
    return np.concatenate(found) if found else np.zeros((0, 4))


def _swapped(region: BaseGeometry) -> BaseGeometry:
    found: BaseGeometry = shapely.transform(region, lambda points: points[:, ::-1])
    return found


@dataclass(frozen=True, eq=False)
class Scanned:
    """What is scanned before a layer: the body that takes the heat, the region, and Z of its surface over the plate."""

    body: BaseGeometry
    region: BaseGeometry
    z_mm: float


def scanned(
    sections: Sequence[BaseGeometry], k: int, z_mm: float, config: Config, under: BaseGeometry | None = None
) -> Scanned:
    """Return what is scanned before layer `k`, whose bottom lies at `z_mm`; `sections` (L,) are those of the layers.

    `under` is the section of what the lowest layer lies on; None: the base plate.
    """
    if k == 0 and under is not None:
        return Scanned(under, layer_region(under, z_mm, config), z_mm)
    if k == 0:
        return Scanned(plate_of(sections[0], config), plate_region(sections[0], config), 0.0)
    return Scanned(sections[k - 1], layer_region(sections[k - 1], z_mm, config), z_mm)


def asked_for(k: int, config: Config) -> bool:
    """Whether the settings ask for a scan before a layer of a program, if it is cold."""
    on_plate = k == 0 and config.base_mm == 0.0
    return config.preheat.when == "layers" or (config.preheat.when == "plate" and on_plate)


def preheated(
    part: PartHeat,
    sections: Sequence[BaseGeometry],
    k: int,
    z_mm: float,
    config: Config,
    under: BaseGeometry | None = None,
) -> tuple[PartHeat, int]:
    """Preheat what layer `k` lies on, if the settings ask for it; the heat then, and the passes.

    `z_mm`: Z over the plate of the bottom of the layer; `under`: section of what the lowest layer lies on; None: the base
    plate.
    """
    if not asked_for(k, config) or sections[k].area <= 0.0:
        return part, 0
    on, bare = scanned(sections, k, z_mm, config, under), k == 0 and under is None
    if on.region.is_empty or not (bare or is_cold(part.column, config)):
        return part, 0
    column = bare_plate(on.body, config) if bare else part.column.copy()
    depth_mm = config.process.base_plate_mm + on.z_mm
    body = SurfaceHeat(column, on.body, on.region, depth_mm, config)
    heat, passes, time_s = _simulated(body, on.region, config)
    after = part.copy()
    if bare:
        after.column = HeatColumn(config)
        after.column.warm_plate = heat.content_under_region()
    else:
        after.column = heat.column
        after.field.age(time_s)
    return after, passes


def is_cold(column: HeatColumn, config: Config) -> bool:
    """Whether what stands is colder than the target once its surface has had as long to even out as after a scan."""
    rested = column.copy()
    rested.advance(max(config.preheat.soak_s, LEAST_REST_S))
    return rested.surface_k < config.preheat.target_k


def _simulated(heat: SurfaceHeat, region: BaseGeometry, config: Config) -> tuple[SurfaceHeat, int, float]:
    """Scan until the target is reached when the soak is over, or as often as the settings say."""
    settings, time_s, n = config.preheat, 0.0, 0
    here: Floats | None = None
    while True:
        way = pass_way(*pass_lines(region, config, n), config, here)
        here = way.end[-1] if way.time_s.size else None
        heat.simulate(way)
        time_s, n = time_s + float(way.time_s.sum()), n + 1
        if settings.passes is not None and n < settings.passes:
            continue
        soaked = heat.copy()
        soaked.rest(settings.soak_s)
        if (
            n >= (settings.passes or settings.most_passes)
            or soaked.read().mean_k >= settings.target_k + AIM_K
        ):
            return soaked, n, time_s + settings.soak_s


def pass_way(lines: Floats, joined: Bools, config: Config, here: Floats | None = None) -> BeamWay:
    """Way of the beam in a pass: its lines, what joins them under the beam, and travel between the others, and from `here`."""
    settings = config.preheat
    full_w = settings.current_ma * config.process.voltage_kv
    rows: list[tuple[Floats, Floats, float, float]] = []
    if here is not None and len(lines):
        rows.append(
            (here, lines[0, :2], float(np.hypot(*(lines[0, :2] - here))) / config.machine.rapid_mm_s, 0.0)
        )
    for n, line in enumerate(lines):
        if n:
            before = lines[n - 1]
            length = float(np.hypot(*(line[:2] - before[2:])))
            speed, power_w = (settings.speed_mm_s, full_w) if joined[n] else (config.machine.rapid_mm_s, 0.0)
            rows.append((before[2:], line[:2], length / speed, power_w))
        length = float(np.hypot(*(line[2:] - line[:2])))
        rows.append((line[:2], line[2:], length / settings.speed_mm_s, full_w))
    return BeamWay(
        np.array([row[0] for row in rows], np.float64).reshape(-1, 2),
        np.array([row[1] for row in rows], np.float64).reshape(-1, 2),
        np.array([row[2] for row in rows], np.float64),
        np.array([row[3] for row in rows], np.float64),
    )
