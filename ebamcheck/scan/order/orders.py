"""Orders in which the islands of a layer are scanned, by name: entry points of the group ``ebamcheck.orders``.

The paper's sentence (section 4.2) takes next the island whose distance "to all processed centroids is the smallest": to the nearest
of them (``nearest-any``, which ``nearest`` is), to the last one (``nearest-last``), or in sum (``nearest-sum``). All of them
contradict the paper's aim ("increase the molding time interval of adjacent regions"), since the nearest island is a neighbour that
is still hot. ``farthest`` does the opposite; ``raster`` is what a machine does without a strategy, ``stride`` leaves out all but
every n-th island of it at first, ``random`` is a seeded shuffle. Distance has no memory of time; ``least-heat`` and ``thermal`` ask
a heat model which island is coolest when the beam gets there, the latter with a price on the way there, and at its coolest end; the
others enter at the nearest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.errors import SettingsError
from ebamcheck.heat.island_heat import IslandHeat, island_heat, with_fresh_heat
from ebamcheck.kernels import Floats, Ints
from ebamcheck.plugins import registry
from ebamcheck.scan.filling.hatch import Vectors
from ebamcheck.scan.filling.schedule import IslandSchedule
from ebamcheck.scan.order.entries import NEAREST, clocked, cool_options
from ebamcheck.scan.order.search import greedy_order, thermal_order, touching
from ebamcheck.settings.config import Config

LAST, ANY, SUM, FARTHEST = 0, 1, 2, 3  # rules of orders by distance


@dataclass(frozen=True, eq=False)
class LayerIslands:
    """What an order may know of the islands of one layer but their heat, which is a value of its own."""

    centroid: Floats  # (I, 2) mm
    area_mm2: Floats  # (I,)
    neighbours: Ints  # (P, 2) pairs of islands with a common border
    layer: int = 0  # index of the layer
    seed: int = 0  # of the run; :meth:`random` mixes the layer into it
    config: Config = field(default_factory=Config)
    height_mm: float = 0.0  # of the layer over the base plate
    section: BaseGeometry = field(default_factory=shapely.Polygon)  # solid region of the layer
    polygons: NDArray[np.object_] = field(default_factory=lambda: np.zeros(0, object))  # (I,) the islands
    # When and where each is scanned; without it, orders that ask for times or heat cannot be used
    schedule: IslandSchedule | None = None
    lines: Vectors | None = None  # of the islands, sorted by island; None: each counts as a blob of its area

    def __len__(self) -> int:
        """Return the number of islands."""
        return len(self.centroid)

    def random(self) -> np.random.Generator:
        """Random numbers of this layer, the same whenever it is planned."""
        return np.random.default_rng((self.seed, self.layer))

    @property
    def known_schedule(self) -> IslandSchedule:
        """When and where the islands are scanned; raises :class:`SettingsError` where that is not known."""
        if self.schedule is None:
            raise SettingsError("this order asks how long islands take: give LayerIslands their polygons and schedule")
        return self.schedule

    def cold_heat(self) -> IslandHeat:
        """Set up the heat model of the layer, which begins as on a cold part."""
        schedule = self.known_schedule
        times = schedule.beam_s, schedule.time_s
        modes = island_heat(self.section, self.polygons, *times, self.config, self.height_mm)
        return self.with_fresh_heat(modes)

    def with_fresh_heat(self, modes: IslandHeat) -> IslandHeat:
        """Add the fresh heat between these islands to a heat model of the layer that has its modes alone."""
        lines = self.lines or Vectors(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
        columns, entry = (lines.island, lines.start, lines.end), self.known_schedule.entry
        return with_fresh_heat(modes, entry, columns, self.section, self.polygons, self.config)


# From the islands of a layer, :class:`LayerIslands`, a permutation (I,) of their indices. One whose attribute `needs_heat` is true is called with the
# :class:`IslandHeat` with which the layer begins, too; the islands of one whose `cool_entries` is true are entered at their coolest ends near enough.
Order = Callable[..., Ints]


@dataclass(frozen=True)
class HeatOrder:
    """An order that asks the heat model."""

    plan: Callable[[LayerIslands, IslandHeat], Ints]
    cool_entries: bool = False
    needs_heat: ClassVar[bool] = True

    def __call__(self, islands: LayerIslands, heat: IslandHeat) -> Ints:
        """Order the islands."""
        return self.plan(islands, heat)


def scan_order(name: str | Order, islands: LayerIslands, heat: IslandHeat | None = None) -> Ints:
    """Order the islands of a layer by an order or its name, (I,) indices; raises SettingsError if there is no order of that name.

    `heat` is that with which the layer begins; None: that of a cold part, set up where the order needs it.
    """
    order = named_order(name)
    if len(islands) < 2:
        return np.arange(len(islands))
    known = [islands.cold_heat() if heat is None else heat] if needs_heat(order) else []
    found = np.asarray(order(islands, *known), np.int64)
    if not np.array_equal(np.sort(found), np.arange(len(islands))):
        raise SettingsError(
            f"scan.order {name!r} did not return every island of layer {islands.layer + 1} once: "
            f"{len(found)} places for {len(islands)} islands"
        )
    return found


def needs_heat(name: str | Order) -> bool:
    """Whether an order asks the heat model: what it says itself, and no for one that says nothing.

    >>> needs_heat("raster"), needs_heat("thermal")
    (False, True)
    """
    return bool(getattr(named_order(name), "needs_heat", False))


def named_order(name: str | Order) -> Order:
    """Installed order of that name; raises :class:`SettingsError` with the names there are."""
    if not isinstance(name, str):
        return name
    if name not in (installed := registry.names(registry.ORDERS)):
        raise SettingsError(f"scan.order {name!r} is unknown: choose one of {', '.join(installed)}")
    found: Order = registry.plugin(registry.ORDERS, name)
    return found


def _seeded_start(islands: LayerIslands) -> int:
    """Index of the first island: random, as in the paper, but seeded."""
    return int(islands.random().integers(len(islands)))


def _by_distance(islands: LayerIslands, rule: int) -> Ints:
    """Islands one by one by their distance to those taken; among equal ones, the first."""
    centroid, order = islands.centroid, [_seeded_start(islands)]
    sign = -1.0 if rule == FARTHEST else 1.0
    left = np.full(len(centroid), True)
    score = np.zeros(len(centroid)) if rule == SUM else np.full(len(centroid), np.inf)
    while len(order) < len(centroid):
        left[order[-1]] = False
        distance = np.hypot(*(centroid - centroid[order[-1]]).T)
        score = distance if rule == LAST else score + distance if rule == SUM else np.minimum(score, distance)
        signed = np.where(left, sign * score, np.inf)
        # A lattice is full of ties, which rounding must not decide.
        order.append(int(np.argmax(signed < signed.min() + 1e-6)))
    return np.array(order, np.int64)


nearest_any = partial(_by_distance, rule=ANY)  # next the island nearest to any processed one
nearest_last = partial(_by_distance, rule=LAST)  # next the island nearest to the one processed last
nearest_sum = partial(_by_distance, rule=SUM)  # next that with the least sum of distances to all processed
farthest = partial(_by_distance, rule=FARTHEST)  # next that farthest from its nearest processed one (max-min)


def raster(islands: LayerIslands) -> Ints:
    """Row by row from below, alternating in direction; a row is as high as an average island is wide."""
    pitch = float(np.sqrt(islands.area_mm2.mean()))
    y = islands.centroid[:, 1] - islands.centroid[:, 1].min()
    row = np.floor(y / pitch + 0.5) if pitch > 0 else np.zeros(len(islands))
    x = np.where(row % 2 == 0, islands.centroid[:, 0], -islands.centroid[:, 0])
    return np.lexsort((np.arange(len(islands)), x, row)).astype(np.int64)


def stride(islands: LayerIslands) -> Ints:
    """Every n-th island of the raster, then those after them, and so on."""
    rows, step = raster(islands), islands.config.scan.stride
    return np.concatenate([rows[n::step] for n in range(step)])


def shuffled(islands: LayerIslands) -> Ints:
    """A random order."""
    return islands.random().permutation(len(islands)).astype(np.int64)


def least_heat(islands: LayerIslands, heat: IslandHeat) -> Ints:
    """Next the island that is coolest when the beam gets there, however far it is."""
    rapid = islands.config.machine.rapid_mm_s
    beside = touching(islands.neighbours, len(islands))
    return greedy_order(heat, islands.known_schedule, beside, rapid, _seeded_start(islands), 0.0, 0.0)


def thermal(islands: LayerIslands, heat: IslandHeat) -> Ints:
    """Next a cool island that is near: the coolest plan whose travel is well under that of `farthest`."""
    settings = islands.config.scan
    return thermal_order(
        heat,
        islands.known_schedule,
        touching(islands.neighbours, len(islands)),
        islands.config.machine.rapid_mm_s,
        width_mm=float(np.sqrt(islands.area_mm2.mean())),
        longest_mm=longest_travel_mm(islands),
        start_travel_mm=settings.start_travel_mm,
        steps=settings.annealing_steps,
        random=islands.random(),
    )


def longest_travel_mm(islands: LayerIslands) -> float:
    """Travel between islands that `thermal` may take: its share of that of `farthest`."""
    *_, travel_mm = clocked(islands.known_schedule, farthest(islands), islands.config.machine.rapid_mm_s)
    return islands.config.scan.travel_share * travel_mm


def chosen_options(name: str | Order, islands: LayerIslands, order: Ints, heat: IslandHeat | None = None) -> Ints:
    """Entry option (I,) of each island of an order: the nearest, or for an order of cool entries the coolest near enough.

    The heat is that with which the layer begins; None: that of a cold part, set up where the order has cool entries.
    """
    if len(order) > 1 and getattr(named_order(name), "cool_entries", False):
        rapid = islands.config.machine.rapid_mm_s
        known = islands.cold_heat() if heat is None else heat
        return cool_options(known, islands.known_schedule, order, rapid, longest_travel_mm(islands))
    return np.full(len(order), NEAREST, np.int64)


LEAST_HEAT = HeatOrder(least_heat)
THERMAL = HeatOrder(thermal, cool_entries=True)
