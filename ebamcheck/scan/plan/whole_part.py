"""Layers put in order from below, each beginning with what those under it have left: its contours heat it first, then come its
islands."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.heat.balance import HeatColumn, LayerShape
from ebamcheck.heat.interpass import LayerJob, SimulatedLayer, cooled_layer
from ebamcheck.heat.island_heat import IslandHeat
from ebamcheck.heat.modes import one_blas_thread
from ebamcheck.heat.part_heat import BeadPower, Beads, PartHeat
from ebamcheck.heat.preheating import preheated
from ebamcheck.kernels import Floats, Ints
from ebamcheck.scan.filling.hatch import Vectors
from ebamcheck.scan.order.orders import LayerIslands, Order, chosen_options, needs_heat, scan_order
from ebamcheck.scan.plan.laying import ContourBeads, LaidLayer, bead_sequence, contour_beads, lay_islands
from ebamcheck.settings.config import Config
from ebamcheck.threads import thread_count, worker_threads

AHEAD = 8  # layers that are laid out and whose modes are found side by side, while those before them are put in order
_Prepared = TypeVar("_Prepared")

# Columns of a row of :func:`scan_part`: index of the layer, its height over the base plate, its islands, and figures of its heat
WHOLE_PART = (
    "layer", "height_mm", "islands", "body_mean_k", "entry_max_k", "entry_sd_k", "travel_mm", "time_s", "wait_s",
    "power_share", "enter_k", "leave_k", "stored_j",
)  # fmt: skip


@dataclass(frozen=True)
class LayerHeat:
    """A layer simulated on the heat model."""

    figures: dict[str, float]  # as :data:`~ebamcheck.scan.plan.columns.METRICS` and :data:`WHOLE_PART` name them
    island_wait_s: Floats  # (I,) wait before each island
    inner_wait_s: Floats  # (I,) wait before each further bead of an island
    mean_k: Floats  # (B,) mean temperature of the surface when each bead is entered, contours first, absolute
    preheat_passes: int = 0  # passes of the preheating scan before it


@dataclass(frozen=True, eq=False)
class ReadyIslands:
    """Islands of a layer that is laid, ready for an order."""

    laid: LaidLayer
    islands: LayerIslands
    cold: IslandHeat | None  # their heat model as it begins on a cold part; None where there are none
    contours: ContourBeads


@dataclass(frozen=True, eq=False)
class OrderedLayer:
    """A layer, what its order knew of its islands, and in which order they are scanned."""

    laid: LaidLayer
    islands: LayerIslands
    order: Ints  # (I,)
    options: Ints  # (I,) entry option of each island, see :func:`~ebamcheck.scan.order.entries.in_sequence`
    heat: LayerHeat | None = None  # where it was simulated

    @classmethod
    def of(cls, name: str | Order, laid: LaidLayer, islands: LayerIslands, heat: IslandHeat | None) -> OrderedLayer:
        """Put islands in an order; `heat` is that with which the layer begins, where the order asks for it."""
        order = scan_order(name, islands, heat)
        return cls(laid, islands, order, chosen_options(name, islands, order, heat))

    @cached_property
    def lines(self) -> Vectors:
        """Lines in scan order, every island entered by its option."""
        return self.laid.driven(self.order, self.options)


# Gives the power along the beads of a layer by the layer in order and its height, mm; asked for each layer once, from below
PowerOf = Callable[[OrderedLayer, float], BeadPower]


@dataclass(frozen=True, eq=False)
class Stack:
    """Layers to be put in order."""

    sections: Sequence[BaseGeometry]  # valid, from below
    heights_mm: Floats  # (L,), rising
    numbers: Sequence[int]  # indices in the part, which turn hatch and cells and seed random choices
    plate_mm: float = 0.0  # height of the base plate
    contours: Sequence[BaseGeometry] | None = None  # regions of the contour beads, where they are known

    def __len__(self) -> int:
        """Return the number of layers."""
        return len(self.sections)

    @cached_property
    def _steps_mm(self) -> list[float]:
        """Heights over the layer below, (L,), for the lowest that of the next; none where there is but one layer."""
        steps = np.diff(self.heights_mm)
        return [*steps[:1].tolist(), *steps.tolist()]

    def laid(self, layer: int, config: Config) -> LaidLayer:
        """One layer with its islands and lines."""
        contour = None if self.contours is None else self.contours[layer]
        height_mm = float(self.heights_mm[layer])
        return lay_islands(self.sections[layer], config, self.numbers[layer], height_mm, contour)

    def thickness_mm(self, layer: int, config: Config) -> float:
        """Height of one layer: the step from the one below, for the lowest that to the next, or the one set."""
        return self._steps_mm[layer] if self._steps_mm else config.layer_height_mm

    def bottom_mm(self, layer: int, config: Config) -> float:
        """Z over the base plate on which one layer lies, by the sum of those under it."""
        return sum(self._steps_mm[:layer]) if self._steps_mm else layer * config.layer_height_mm


def ordered_layers(
    stack: Stack,
    config: Config,
    order: str | Order,
    seed: int,
    carry: bool,
    simulated: bool = True,
    power_of: PowerOf | None = None,
) -> Iterator[OrderedLayer]:
    """Put layers in order, from below; each is yielded as soon as it is done.

    `carry` lets each order know the heat that is left below, else it is that of a cold part; `simulated` simulates each layer for
    its waits and power, which is always done where heat is carried; `power_of` gives the power along beads, else each has that of
    its layer."""
    if not (carry or simulated):

        @one_blas_thread()
        def cold(k: int) -> OrderedLayer:
            laid = stack.laid(k, config)
            islands = laid.choices(config, seed, stack.plate_mm)
            heat = islands.cold_heat() if needs_heat(order) and len(islands) > 1 else None
            return OrderedLayer.of(order, laid, islands, heat)

        yield from _prepared(stack, cold)
        return
    part, last = PartHeat(HeatColumn(config)), None
    for k, ready in enumerate(_prepared(stack, lambda k: laid_layer(stack, k, config, seed))):
        part, passes = preheated(part, stack.sections, k, stack.bottom_mm(k, config), config)
        how = stack.thickness_mm(k, config), config, order, carry, last is None, power_of
        done, part, last = ordered_on(part, last, ready, *how)
        yield done if done.heat is None else replace(done, heat=replace(done.heat, preheat_passes=passes))


def ordered_on(
    part: PartHeat,
    last: SimulatedLayer | None,
    ready: ReadyIslands,
    thickness_mm: float,
    config: Config,
    order: str | Order,
    carry: bool,
    lowest: bool,
    power_of: PowerOf | None = None,
) -> tuple[OrderedLayer, PartHeat, SimulatedLayer | None]:
    """Put one layer in order on the heat of the `part` that those under it have left, and simulate it; `last` is how the layer
    under it was simulated.

    `carry` lets the order know the heat; `lowest`: nothing lies under it, so that there is nothing to wait for; `power_of` as for
    :func:`ordered_layers`. Returns the layer, and part and simulation when it is done: those before where it has no metal."""
    laid, islands, cold = ready.laid, ready.islands, ready.cold
    with one_blas_thread():
        part = part.under(None if cold is None else cold.model)
        shape = LayerShape.of(islands.section, thickness_mm)
        begins = None if cold is None else _warmed(cold, ready, part, last) if carry else cold
        ordered = OrderedLayer.of(order, laid, islands, begins)
        if islands.section.area <= 0.0:
            return ordered, part, last
        sequence = ordered.order, ordered.options
        beads, travel_mm = bead_sequence(laid, ready.contours, config, cold, *sequence)
        if power_of is not None:
            beads = replace(beads, power=power_of(ordered, thickness_mm))
        guess = 0.0 if last is None else last.power_share
        done = cooled_layer(LayerJob(beads, shape, islands.height_mm, lowest), part, config, guess)
    heat = _layer_heat(done, travel_mm, beads, len(islands), config)
    return replace(ordered, heat=heat), done.after, done


def scan_part(
    sections: Sequence[BaseGeometry], heights_mm: Floats, config: Config, order: str | Order, seed: int
) -> Generator[dict[str, Any], None, None]:
    """Order all layers of a part with the heat of those under them; a row of :data:`WHOLE_PART` for each as soon as it is done.

    `sections` are valid, from below; `heights_mm` (L,) are their heights over the base plate, rising.
    """
    stack = Stack(sections, heights_mm, range(len(sections)))
    nothing = {**dict.fromkeys(WHOLE_PART, np.nan), "travel_mm": 0.0, "time_s": 0.0}
    for done in ordered_layers(stack, config, order, seed, carry=True):
        figures = nothing if done.heat is None else done.heat.figures
        place = {"layer": done.laid.layer, "height_mm": done.islands.height_mm, "islands": len(done.islands)}
        yield {name: {**figures, **place}[name] for name in WHOLE_PART}


def _prepared(stack: Stack, prepare: Callable[[int], _Prepared]) -> Iterator[_Prepared]:
    """Prepare layers on all threads, some ahead of who takes them; who stops taking them stops the threads, too.

    With each layer that is taken one more is begun, so that the work goes on evenly beside that of who takes them.
    """
    if thread_count() == 1:
        yield from map(prepare, range(len(stack)))
        return
    threads, left = worker_threads(), iter(range(len(stack)))
    try:
        coming = deque(threads.submit(prepare, k) for k in itertools.islice(left, AHEAD))
        while coming:
            ready = coming.popleft().result()
            coming.extend(threads.submit(prepare, k) for k in itertools.islice(left, 1))
            yield ready
    finally:
        threads.shutdown(cancel_futures=True)


@one_blas_thread()
def laid_layer(stack: Stack, k: int, config: Config, seed: int) -> ReadyIslands:
    """Divide one layer into islands, set up its heat model, and put its contours in sequence."""
    laid = stack.laid(k, config)
    islands = laid.choices(config, seed, stack.plate_mm)
    cold = islands.cold_heat() if len(islands) else None
    return ReadyIslands(laid, islands, cold, contour_beads(laid, config, cold))


def _warmed(cold: IslandHeat, ready: ReadyIslands, part: PartHeat, last: SimulatedLayer | None) -> IslandHeat:
    """Heat with which the islands of a layer begin: its contours are laid on what the part has left.

    Power and wait are those of the layer below, since those of this one depend on its order.
    """
    config, ahead = ready.islands.config, part.copy()
    share, wait_s = (1.0, 0.0) if last is None else (last.power_share, last.wait_s)
    ahead.rest(wait_s)
    none = np.zeros(0, np.int64)
    beads, _ = bead_sequence(ready.laid, ready.contours, config, cold, none, none)
    ahead.column.lay(LayerShape.of(ready.islands.section, config.layer_height_mm))
    for ring in range(len(beads)):
        ahead.rest(float(beads.move_s[ring]))
        ahead.lay_bead(beads, ring, share * config.process.power_w * config.material.absorptivity)
    return replace(cold, start_k=ahead.amplitudes())


def _layer_heat(done: SimulatedLayer, travel_mm: float, beads: Beads, islands: int, config: Config) -> LayerHeat:
    # Beyond the boiling point the model says that it is too hot, not how hot.
    boiling_k, ambient_k = config.material.boiling_k, config.process.ambient_temperature_k
    rise_k = np.minimum(done.bed_k, boiling_k) - ambient_k
    entry_k = rise_k if rise_k.size else np.zeros(1)
    names = "body_mean_k", "time_s", "wait_s", "ring_wait_s", "power_share"
    figures = {name: getattr(done, name) for name in names} | {
        "entry_max_k": float(entry_k.max()),
        "entry_sd_k": float(entry_k.std()),
        "travel_mm": travel_mm,
        "enter_k": min(done.enter_k, boiling_k),
        "leave_k": min(done.leave_k, boiling_k),
        "stored_j": done.after.column.stored_j,
    }
    island_wait_s, inner_wait_s = np.zeros(islands), np.zeros(islands)
    waits, inner = done.bead_wait_s[beads.rings :], beads.inner[beads.rings :]
    island_wait_s[beads.islands[~inner]] = waits[~inner]
    inner_wait_s[beads.islands[inner]] = waits[inner]
    return LayerHeat(figures, island_wait_s, inner_wait_s, done.mean_k)
