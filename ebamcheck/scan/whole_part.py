"""Layers put in order from below, each beginning with what those under it have left.

Contour beads, and the time and heat that they take, are not part of it. What the sides of the part radiate is taken
out of the whole body between layers, by its mean temperature: it is next to nothing while a layer is scanned, and
most of what a tall part loses.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.config import Config
from ebamcheck.heat import carried
from ebamcheck.heat.medium import STEFAN_BOLTZMANN_W_M2K4, cooled_by_radiation_k
from ebamcheck.heat.model import HeatModel
from ebamcheck.heat.one_blas_thread import one_blas_thread
from ebamcheck.kernels import run_blocks, thread_count
from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.driving import clocked, entered
from ebamcheck.scan.laying import LaidLayer, lay_islands
from ebamcheck.scan.order import LayerIslands, Order, scan_order

AHEAD = 8
"""Layers that are laid out and whose modes are found side by side, while those before them are put in order."""

_Prepared = TypeVar("_Prepared")

WHOLE_PART = {
    "layer": "index of the layer",
    "height_mm": "its height over the base plate",
    "islands": "islands",
    "body_mean_k": "mean temperature rise of the body under it when it begins",
    "entry_max_k": "greatest mean temperature rise of an island when the beam enters it",
    "entry_sd_k": "standard deviation of it over the islands",
    "travel_mm": "jumps between islands",
    "time_s": "time of the layer",
    "stored_j": "heat in the body at its end",
}
"""Columns of a row of :func:`scan_part` and what they are."""


@dataclass(frozen=True)
class LayerHeat:
    """A layer driven on the heat model; figures as in :data:`WHOLE_PART`."""

    body_mean_k: float
    entry_max_k: float
    entry_sd_k: float
    travel_mm: float
    time_s: float
    stored_j: float


@dataclass(frozen=True, eq=False)
class OrderedLayer:
    """A layer, what its order knew of it, the order (I,), and its heat where it was driven."""

    laid: LaidLayer
    islands: LayerIslands
    order: Ints
    heat: LayerHeat | None = None


@dataclass(frozen=True, eq=False)
class Stack:
    """Layers to be put in order.

    Parameters
    ----------
    sections
        Valid sections, from below.
    heights_mm
        (L,) their heights, rising.
    numbers
        Indices in the part, which turn hatch and cells and seed random choices.
    plate_mm
        Height of the base plate.
    """

    sections: Sequence[BaseGeometry]
    heights_mm: Floats
    numbers: Sequence[int]
    plate_mm: float = 0.0

    def __len__(self) -> int:
        """Return the number of layers."""
        return len(self.sections)


def ordered_layers(
    stack: Stack, profile: Config, order: str | Order, seed: int, carry: bool
) -> Iterator[OrderedLayer]:
    """Put layers in order, from below.

    Parameters
    ----------
    carry
        Drive each layer on the heat model and let the next one begin with what it leaves; else each is cold.

    Yields
    ------
    OrderedLayer
        As soon as it is done.
    """
    if not carry:
        yield from _prepared(stack, lambda k: _cold(stack, k, profile, order, seed))
        return
    left: tuple[HeatModel, Floats] | None = None
    for laid, islands in _prepared(stack, lambda k: _laid(stack, k, profile, seed)):
        warm = islands if left is None else _before(islands, left)
        with one_blas_thread():
            found = scan_order(order, warm)
            heat, left = _driven(warm, found, left)
        yield OrderedLayer(laid, warm, found, heat)


def scan_part(
    sections: Sequence[BaseGeometry],
    heights_mm: Floats,
    profile: Config,
    order: str | Order,
    seed: int,
) -> Generator[dict[str, Any], None, None]:
    """Order all layers of a part with the heat of those under them.

    Parameters
    ----------
    sections
        Valid sections of the layers, from below.
    heights_mm
        (L,) their heights over the base plate, rising.

    Yields
    ------
    dict
        One row a layer as :data:`WHOLE_PART` names them, as soon as it is done.
    """
    stack = Stack(sections, heights_mm, range(len(sections)))
    nothing = {**dict.fromkeys(WHOLE_PART, np.nan), "travel_mm": 0.0, "time_s": 0.0}
    for done in ordered_layers(stack, profile, order, seed, carry=True):
        figures = nothing if done.heat is None else vars(done.heat)
        place = {"layer": done.laid.layer, "height_mm": done.islands.height_mm, "islands": len(done.islands)}
        yield {name: {**figures, **place}[name] for name in WHOLE_PART}


def _prepared(stack: Stack, prepare: Callable[[int], _Prepared]) -> Iterator[_Prepared]:
    """Prepare layers on all threads, a block ahead of who takes them; who stops taking them stops the threads, too."""
    stopped = threading.Event()

    def work(block: range) -> list[_Prepared]:
        def some(start: int, stop: int) -> list[_Prepared]:
            return [prepare(k) for k in block[start:stop] if not stopped.is_set()]

        return [found for part in run_blocks(some, len(block)) for found in part]

    blocks = [range(a, min(a + AHEAD, len(stack))) for a in range(0, len(stack), AHEAD)]
    if thread_count() == 1:
        for block in blocks:
            yield from work(block)
        return
    with ThreadPoolExecutor(1) as ahead:
        try:
            coming = [ahead.submit(work, block) for block in blocks[:1]]
            for n in range(len(blocks)):
                ready = coming.pop().result()
                coming = [ahead.submit(work, block) for block in blocks[n + 1 : n + 2]]
                yield from ready
        finally:
            stopped.set()


@one_blas_thread()
def _cold(stack: Stack, k: int, profile: Config, order: str | Order, seed: int) -> OrderedLayer:
    """Divide one layer into islands and put them in order as on a cold part."""
    laid = lay_islands(stack.sections[k], profile, stack.numbers[k], float(stack.heights_mm[k]))
    islands = laid.choices(profile, seed, stack.plate_mm)
    return OrderedLayer(laid, islands, scan_order(order, islands))


@one_blas_thread()
def _laid(stack: Stack, k: int, profile: Config, seed: int) -> tuple[LaidLayer, LayerIslands]:
    """Divide one layer into islands, and set up its heat model."""
    laid = lay_islands(stack.sections[k], profile, stack.numbers[k], float(stack.heights_mm[k]))
    islands = laid.choices(profile, seed, stack.plate_mm)
    if len(islands):
        _ = islands.cold_heat
    return laid, islands


def _before(islands: LayerIslands, left: tuple[HeatModel, Floats]) -> LayerIslands:
    """Let a layer begin with the heat that another one left: its model, and amplitudes."""
    model, amplitudes = left
    after = replace(islands, before=lambda new: carried(model, amplitudes, new))
    if len(islands):
        # The modes are found already; only the beginning is another one.
        vars(after)["cold_heat"] = islands.cold_heat
    return after


def _driven(
    islands: LayerIslands, order: Ints, left: tuple[HeatModel, Floats] | None
) -> tuple[LayerHeat | None, tuple[HeatModel, Floats] | None]:
    """Drive one layer: its heat, and what it leaves. A layer without islands leaves what it found, after the pause."""
    pause_s = islands.profile.process.layer_pause_s
    if not len(islands):
        return None, None if left is None else (left[0], left[0].after(left[1], pause_s))
    heat, drive = islands.heat, islands.driven
    start_s, end_s, travel = clocked(
        order, drive.entry, drive.leave, drive.time_s, islands.profile.machine.rapid_mm_s
    )
    model = heat.model
    volume_mm3 = islands.section.area * model.depth.depth_mm
    entry_k, state = entered(heat, order, start_s, end_s)
    figures = LayerHeat(
        body_mean_k=model.stored_j(heat.start_k) / (model.medium.heat_capacity_j_mm3k * volume_mm3),
        entry_max_k=float(entry_k.max()),
        entry_sd_k=float(entry_k.std()),
        travel_mm=float(travel),
        time_s=float(end_s.max()),
        stored_j=model.stored_j(_radiated(islands, model, state, float(end_s.max()))),
    )
    rested = model.after(state, pause_s)
    return figures, (model, _radiated(islands, model, rested, float(end_s.max()) + pause_s))


def _radiated(islands: LayerIslands, model: HeatModel, state: Floats, time_s: float) -> Floats:
    """Amplitudes after the sides over the plate have radiated for a time."""
    process, material = islands.profile.process, islands.profile.material
    section = islands.section
    heat_j_k = model.medium.heat_capacity_j_mm3k * section.area * model.depth.depth_mm
    rise_k = model.stored_j(state) / heat_j_k
    if rise_k <= 0.0:
        return state
    sides_mm2 = section.length * max(model.depth.depth_mm - process.base_plate_mm, 0.0)
    per_k4 = material.emissivity * 1e-6 * STEFAN_BOLTZMANN_W_M2K4 * sides_mm2 / heat_j_k
    left_k = cooled_by_radiation_k(rise_k, process.ambient_temperature_k, per_k4, time_s)
    return np.asarray(state * (left_k / rise_k), np.float64)
