"""A preheating scan: the region that it covers, the lines of each pass, and its heat.

The heat's mean is that of the body, by the column of the balance; what differs across it goes by modes. The body is the base plate,
or what stands under the layer that comes. The beam is wide and moves along lines; heat enters at the surface. Its way is given as
pieces in time, from a plan or from the text of a program, and both are simulated by the same steps."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.raster import each_of
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
    """Way of the beam, in straight pieces (n,), in order of time."""

    start: Floats  # (n, 2) mm
    end: Floats  # (n, 2) mm
    time_s: Floats  # (n,)
    power_w: Floats  # (n,) 0 where the beam is off

    @property
    def energy_j(self) -> float:
        """Energy of the beam."""
        return float(self.power_w @ self.time_s)

    def cut(self, most_mm: float) -> BeamWay:
        """Return the same way in pieces of at most a length."""
        length = np.hypot(*(self.end - self.start).T)
        count = np.where(self.power_w > 0.0, np.maximum(np.ceil(length / most_mm), 1.0), 1.0).astype(np.int64)
        owner, number = each_of(count)
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
    """A body whose surface is scanned."""

    def __init__(
        self, column: HeatColumn, body: BaseGeometry, region: BaseGeometry, depth_mm: float, config: Config
    ) -> None:
        """Set up the heat of a body by its mean, which grows warmer, its outline, the region that is scanned, where temperatures are
        read, and its depth down to the table."""
        self.column, self._config = column, config
        medium, spacing_mm = Medium.of(config), config.preheat.spacing_mm
        largest = (2.0 * math.pi / max(2.0 * spacing_mm, 0.5 * config.preheat.spot_mm)) ** 2
        plane = contour_modes(body, largest, MOST_MODES, CELLS)
        depth = depth_modes(depth_mm, DEPTH_MODES, config.process.base == "cooled", medium.loss_per_mm)
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
        other = copy(self)
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
        scanned_s = np.cumsum(np.where(waits, 0.0, way.time_s))
        chunk = parts * CHUNKS + np.floor(scanned_s / CHUNK_S).astype(np.int64)
        for number in np.unique(chunk):
            rows = chunk == number
            energy_j = float(way.power_w[rows] @ way.time_s[rows]) * taken
            self.column.advance(float(way.time_s[rows].sum()), energy_j)
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
        at_places_k = self.column.surface_k + self._at_places @ self.field.surface()
        ends = int(np.argmin(at_places_k)), int(np.argmax(at_places_k))
        (x0, y0), (x1, y1) = (self._places[n].tolist() for n in ends)
        least_k, most_k = (float(at_places_k[n]) for n in ends)
        least_at, most_at = (round(x0, 2), round(y0, 2)), (round(x1, 2), round(y1, 2))
        return SurfaceK(float(at_places_k.mean()), least_k, least_at, most_k, most_at)

    def content_under_region(self) -> Floats:
        """Heat content of the cells of the column under what was scanned, J/mm^3."""
        edges, depth = self.column.edges_mm, self.model.depth
        below = np.maximum(edges[-1] - 0.5 * (edges[1:] + edges[:-1]), 0.0)
        away = self._at_places.mean(axis=0) @ self.field.state @ depth.at(np.minimum(below, depth.depth_mm)).T
        return self.column.material.heat_content(self.column.temperature_k + away)


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


def pass_lines(region: BaseGeometry, config: Config, number: int) -> tuple[Floats, Bools]:
    """Lines (n, 4) of one pass, x, y of the start and of the end of each, in order, back and forth; and whether the beam stays on from
    the line before (n,).

    Passes count from 0: every second one lies across (crossed), or half a spacing aside (lines).

    >>> lines, joined = pass_lines(shapely.box(0, 0, 60, 20), Config(), 0)
    >>> lines[:, 1].tolist(), joined.tolist()
    ([5.0, 15.0], [False, True])
    """
    settings = config.preheat
    across = settings.pattern == "crossed" and number % 2 == 1
    turned = shapely.transform(region, lambda points: points[:, ::-1]) if across else region
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
    lines = [np.zeros((0, 4))]
    for k, y in enumerate(rows[rows < y1].tolist()):
        cut = shapely.intersection(region, shapely.LineString([(x0 - 1.0, y), (x1 + 1.0, y)]))
        # From left to right: where a border touches the row, pieces of it come in either direction.
        pieces = [part for part in shapely.get_parts(cut) if part.length > LEAST_LINE_MM]
        ends = shapely.bounds(pieces).reshape(-1, 4)
        ends = ends[np.argsort(ends[:, 0])]
        lines.append(ends if k % 2 == 0 else ends[::-1][:, [2, 3, 0, 1]])
    return np.concatenate(lines)


@dataclass(frozen=True, eq=False)
class Scanned:
    """Surface that is scanned before a layer."""

    body: BaseGeometry  # that takes the heat
    region: BaseGeometry  # may be empty
    z_mm: float  # Z of the surface over the plate


def scanned(
    sections: Sequence[BaseGeometry], k: int, z_mm: float, config: Config, under: BaseGeometry | None = None
) -> Scanned:
    """Surface that is scanned before layer `k`, whose bottom lies at `z_mm`; `sections` (L,) are those of the layers.

    It is half a spot within the section below, or on the base plate around the lowest section; the plate without one in the settings
    is the box around that section and the margin. `under` is the section of what the lowest layer lies on; None: the base plate.
    """
    half_spot_mm, machine = 0.5 * config.preheat.spot_mm, config.machine
    body = under if k == 0 else sections[k - 1]
    if body is not None:
        return Scanned(body, _free(eroded(body, half_spot_mm), z_mm, config), z_mm)
    body = within = box = _grown_box(sections[0], config)
    if machine.base_plate_min_mm is not None and machine.base_plate_max_mm is not None:
        body = shapely.box(*machine.base_plate_min_mm, *machine.base_plate_max_mm)
        within = eroded(body, half_spot_mm)
    return Scanned(body, _free(shapely.intersection(within, box), 0.0, config), 0.0)


def _grown_box(section: BaseGeometry, config: Config) -> BaseGeometry:
    margin_mm = np.array([-1.0, -1.0, 1.0, 1.0]) * config.preheat.margin_mm
    box: BaseGeometry = shapely.box(*(shapely.bounds(section) + margin_mm))
    return box


def _free(region: BaseGeometry, z_mm: float, config: Config) -> BaseGeometry:
    """Region without clamps that stand over a height, and half a spot around them."""
    for place in config.process.keep_out:
        if place.z_mm[1] > z_mm:
            around = shapely.buffer(shapely.Polygon(place.outline_mm), 0.5 * config.preheat.spot_mm)
            region = shapely.difference(region, around)
    return region


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
    """Preheat what layer `k` lies on, if the settings ask for it: the heat then, and the passes; parameters as of :func:`scanned`."""
    if not asked_for(k, config) or sections[k].area <= 0.0:
        return part, 0
    on, bare = scanned(sections, k, z_mm, config, under), k == 0 and under is None
    if on.region.is_empty:
        return part, 0
    if not bare:
        # Colder than the target once the surface has had as long to even out as after a scan.
        rested = part.column.copy()
        rested.advance(max(config.preheat.soak_s, LEAST_REST_S))
        if not rested.surface_k < config.preheat.target_k:
            return part, 0
    column = bare_plate(on.body, config) if bare else part.column.copy()
    depth_mm = config.process.base_plate_mm + on.z_mm
    surface = SurfaceHeat(column, on.body, on.region, depth_mm, config)
    heat, passes, time_s = _simulated(surface, on.region, config)
    after = part.copy()
    if bare:
        after.column = HeatColumn(config)
        after.column.warm_plate = heat.content_under_region()
    else:
        after.column = heat.column
        after.field.age(time_s)
    return after, passes


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
        enough = n >= (settings.passes or settings.most_passes)
        if enough or soaked.read().mean_k >= settings.target_k + AIM_K:
            return soaked, n, time_s + settings.soak_s


def pass_way(lines: Floats, joined: Bools, config: Config, here: Floats | None = None) -> BeamWay:
    """Way of the beam in a pass: its lines, what joins them under the beam, and travel between the others, and from `here`."""
    settings = config.preheat
    full_w = settings.current_ma * config.process.voltage_kv
    # Ends of all pieces in turn: of the way to each line, and of the line.
    ends = lines.reshape(-1, 2)
    start, end = np.vstack([ends[:1] if here is None else here[None], ends[:-1]])[: len(ends)], ends
    on = np.ones(len(ends), np.bool_)
    on[::2] = joined
    speed_mm_s = np.where(on, settings.speed_mm_s, config.machine.rapid_mm_s)
    way = BeamWay(start, end, np.hypot(*(end - start).T) / speed_mm_s, np.where(on, full_w, 0.0))
    return way if here is not None else BeamWay(way.start[1:], way.end[1:], way.time_s[1:], way.power_w[1:])
