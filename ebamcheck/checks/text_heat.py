"""The heat of a program from its text: the beads that it lays, its times, waits and power, and the balance driven by them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.regions import eroded
from ebamcheck.heat.balance import HeatColumn, LayerShape
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.heat.preheating import BeamWay, SurfaceHeat, bare_plate
from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.motions import RAPID, NCProgram
from ebamcheck.nc.timeline import PAUSE, Kind
from ebamcheck.settings.config import Config

LONGEST_WAIT_S = 4.0 * 3600.0  # Longest wait that is looked for
LEAST_SHARE = 1e-6  # Keeps a bead without power from being divided by
OUTLINE_STEP_MM = 0.5  # Chords of contours where no section is known
LONGEST_S = 86400.0  # A motion or wait of a scan is simulated for a day at most; a negative one not at all


def motion_seconds(nc: NCProgram, config: Config) -> Floats:
    """Time of each motion (B,): length over feed, rapids over ``machine.rapid_mm_s``."""
    length = np.nan_to_num(nc.lengths)
    speed = np.where(nc.kind == RAPID, config.machine.rapid_mm_s, nc.feed_mm_min / 60.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(length > 0.0, length / speed, 0.0), np.float64)


@dataclass(frozen=True, eq=False)
class TextBeads:
    """Beads (P,) of a program in its sequence, one from where the beam comes on to where it goes off.

    Who reads the text alone need not know which of them are of one island: each is entered, and finds the part as warm as it then is. Waits
    and moves are those before a bead, `row` its first motion; `stray` are waits within a bead or after the last: (event, what)."""

    layer: Ints
    ring: Ints
    island: Ints
    row: Ints
    wait_s: Floats
    move_s: Floats
    time_s: Floats
    energy_j: Floats
    peak_w: Floats
    stray: tuple[tuple[int, str], ...]
    # Way of the beam that preheats before a layer, by its index.
    scans: Mapping[int, BeamWay] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of beads."""
        return len(self.layer)

    @cached_property
    def enters_layer(self) -> np.ndarray:
        """Whether each is the first of its layer, (P,)."""
        return np.asarray(np.diff(self.layer, prepend=-1) != 0)

    def of_layers(self) -> Iterator[tuple[int, int]]:
        """First bead of each layer in its sequence, and the one after its last."""
        first = np.flatnonzero(self.enters_layer)
        return zip(first.tolist(), np.append(first, len(self))[1:].tolist(), strict=True)

    @cached_property
    def inner(self) -> np.ndarray:
        """Whether each is a further bead of the island before, (P,)."""
        return np.asarray((self.island >= 0) & (np.diff(self.island, prepend=-1) == 0) & ~self.enters_layer)

    def named(self, n: int) -> str:
        """Name one of them."""
        if self.enters_layer[n]:
            return f"layer {self.layer[n] + 1}"
        what = f"island {self.island[n]}" if self.island[n] >= 0 else f"ring {self.ring[n]}"
        what = f"a further bead of {what}" if self.inner[n] else what
        return f"{what} of layer {self.layer[n] + 1}"


def text_beads(nc: NCProgram, config: Config) -> TextBeads:
    """Find the beads of a program, and the waits before them."""
    rows = np.flatnonzero(nc.deposit & (nc.layer >= 0))
    seconds = motion_seconds(nc, config)
    found = nc.beads.among(rows)
    first, last = found.first, found.last
    clock = np.concatenate([[0.0], np.cumsum(seconds)])

    def between(late: Ints, early: Ints) -> Floats:
        """Time between motions (n,) s; endless where a feed of nothing never ends."""
        known = np.isfinite(clock[late]) & np.isfinite(clock[early])
        return np.where(known, clock[late] - np.where(known, clock[early], 0.0), np.inf)

    power_w = np.nan_to_num(nc.power_w[rows])
    paused = np.flatnonzero(nc.events.named(PAUSE))
    row, following = nc.events.row[paused], np.searchsorted(first, nc.events.row[paused])
    within = np.append(-1, last)[following] >= row
    after = ~within & (following == first.size)
    before = paused[~(within | after)]
    wait_s = np.bincount(following[~(within | after)], nc.events.value[before], first.size)
    stray = [
        (i, "waits within a bead" if inside else "waits after the last bead")
        for i, inside in zip(paused[within | after].tolist(), within[within | after].tolist(), strict=True)
    ]
    return TextBeads(
        layer=nc.layer[first], ring=nc.ring[first], island=nc.island[first], row=first,
        wait_s=wait_s.astype(np.float64),
        move_s=between(first, np.append(0, last + 1)[: first.size]), time_s=between(last + 1, first),
        energy_j=found.total(power_w * seconds[rows]),
        peak_w=found.greatest(power_w), stray=tuple(stray), scans=scans_of(nc, config),
    )  # fmt: skip


def text_bed_k(
    beads: TextBeads, config: Config, shapes: Sequence[LayerShape], before: HeatColumn | None = None,
    lowest: BaseGeometry | None = None, seen: Callable[[int, HeatColumn], None] = lambda layer, column: None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Mean temperature of the surface, absolute, when each bead (P,) is entered, and when each layer (L,) is done (NaN without a bead).

    By the balance of :mod:`ebamcheck.heat.balance`, on what stands `before`: the plate, cold or as the text preheats it under the `lowest`
    section. `seen` is called with each layer when it is entered, before it is preheated."""
    # A plate that the program itself preheats was cold before.
    on_plate = before is None or (config.base_mm == 0.0 and 0 in beads.scans)
    column = begun_column(beads.scans, lowest, config) if before is None or on_plate else before.copy()
    bed_k, leave_k = np.zeros(len(beads)), np.full(len(shapes), np.nan)
    off_s, energy_j = beads.move_s + beads.wait_s, beads.energy_j * config.material.absorptivity
    for first, last in beads.of_layers():
        layer, following = int(beads.layer[first]), slice(first + 1, last)
        column.advance(float(off_s[first]))
        seen(layer, column)
        _scan(column, beads, layer, config)
        bed_k[first] = column.bed_k
        if shapes[layer].area_mm2 > 0.0:
            column.lay(shapes[layer])
        column.advance(float(beads.time_s[first]), float(energy_j[first]))
        bed_k[following], _ = column.drive((off_s[following], beads.time_s[following], energy_j[following]))
        leave_k[layer] = column.surface_k
    return bed_k, leave_k


def _scan(column: HeatColumn, beads: TextBeads, layer: int, config: Config) -> None:
    """Preheat what stands before a layer, as the text does; the plate was before it begins."""
    way = beads.scans.get(layer)
    if way is None or (layer == 0 and config.base_mm == 0.0):
        return
    column.advance(float(way.time_s.sum()), way.energy_j * config.material.absorptivity)


def known_sections(plan: Any, *stacks: Layers | None) -> list[BaseGeometry] | None:
    """Sections that a plan was made from, else those of the first stack that there is; None without either."""
    planned = getattr(plan, "sections", None)
    if planned is not None:
        return list(planned)
    return next((sections_of(stack) for stack in stacks if stack is not None), None)


def sections_of(layers: Layers) -> list[BaseGeometry]:
    """Sections of a stack as one geometry a layer."""
    return [layers.section(k) for k in range(len(layers))]


def sections_of_text(
    nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None
) -> list[BaseGeometry]:
    """Sections of the layers of a program: those known where they are as many, else what its contours enclose."""
    if sections is not None and len(sections) == len(nc.layer_files):
        return list(sections)
    outlines = sections_of(nc.contours(OUTLINE_STEP_MM))
    return [shapely.buffer(outline, config.contour_offset_mm) for outline in outlines]


def text_shapes(nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None) -> list[LayerShape]:
    """Shapes of the layers of a program, of the sections where they are as many, else of what its contours enclose."""
    count = len(nc.layer_files)
    sections = sections_of_text(nc, config, sections)
    steps = np.diff(nc.layer_heights, prepend=config.base_mm)
    usual = float(np.nanmedian(steps)) if np.isfinite(steps).any() else config.layer_height_mm
    steps = np.where(steps > 0.0, steps, usual)
    return [LayerShape.of(sections[k], float(steps[k])) for k in range(count)]


def build_times_s(nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None) -> dict[str, float]:
    """Times of a program as it is, without its waits, and at full power with waits alone, s.

    The last is that of the same beads, each entered as soon as the balance finds the surface under the limit; NaN where the wait for one
    would be longer than :data:`LONGEST_WAIT_S`.
    """
    beads, known = text_beads(nc, config), sections_of_text(nc, config, sections)
    busy_s = float((beads.time_s + beads.move_s).sum())
    busy_s += sum(float(way.time_s.sum()) for way in beads.scans.values())
    dwell_s = _dwell_s(beads, config, text_shapes(nc, config, known), known[0] if known else None)
    programmed_s = busy_s + float(beads.wait_s.sum())
    return {"programmed": programmed_s, "without_measures": busy_s, "dwell": busy_s + dwell_s}


def _dwell_s(
    beads: TextBeads, config: Config, shapes: Sequence[LayerShape], lowest: BaseGeometry | None
) -> float:
    """Waits at full power, each found by steps of time that grow by a half."""
    limit_k, at_bead = entry_limit_k(config), config.process.interpass_at == "bead"
    column, wait_s = begun_column(beads.scans, lowest, config), np.zeros(len(beads))
    # Ramps are part of the beads: their strongest motion has the full power of its layer.
    share = np.maximum(beads.peak_w / config.process.power_w, LEAST_SHARE)
    energy_j = beads.energy_j / share * config.material.absorptivity
    for first, last in beads.of_layers():
        shape, following = shapes[int(beads.layer[first])], slice(first + 1, last)
        column.advance(float(beads.move_s[first]))
        _scan(column, beads, int(beads.layer[first]), config)
        if first > 0 and column.bed_k > limit_k:
            wait_s[first] = column.wait_until(limit_k, LONGEST_WAIT_S)
        if shape.area_mm2 > 0.0:
            column.lay(shape)
        column.advance(float(beads.time_s[first]), float(energy_j[first]))
        rest = beads.move_s[following], beads.time_s[following], energy_j[following]
        _, wait_s[following] = column.drive(rest, limit_k if at_bead else math.inf, LONGEST_WAIT_S)
        if (wait_s[first:last] > LONGEST_WAIT_S).any():
            return math.nan
    # One after the other, as they come.
    return float(np.cumsum(wait_s)[-1]) if len(beads) else 0.0


def scans_of(nc: NCProgram, config: Config) -> dict[int, BeamWay]:
    """Way of the beam before each layer that is preheated, by its index, with waits as pieces that stand still."""
    scans = nc.preheating
    if scans is None:
        return {}
    time_s = np.clip(np.nan_to_num(motion_seconds(scans, config), posinf=0.0), 0.0, LONGEST_S)
    power_w = np.where(scans.beam, np.nan_to_num(scans.power_w), 0.0)
    start, end = np.nan_to_num(scans.start[:, :2]), np.nan_to_num(scans.end[:, :2])
    waits = scans.events.chosen(scans.events.kind == Kind.WAIT)
    layer_of_file = dict(zip(scans.file.tolist(), scans.layer.tolist(), strict=True))
    found = {}
    for layer in np.unique(scans.layer).tolist():
        rows = np.flatnonzero(scans.layer == layer)
        own = np.array([layer_of_file.get(file) == layer for file in waits.file.tolist()], np.bool_)
        at = np.searchsorted(rows, waits.row[own])
        here = end[rows[np.maximum(at - 1, 0)]]
        pause_s = np.clip(waits.value[own], 0.0, LONGEST_S)
        found[int(layer)] = BeamWay(
            np.insert(start[rows], at, here, axis=0),
            np.insert(end[rows], at, here, axis=0),
            np.insert(time_s[rows], at, pause_s),
            np.insert(power_w[rows], at, 0.0),
        )
    return found


@dataclass(frozen=True, eq=False)
class Scanned:
    """What is preheated before a layer: the body that takes the heat, the region, and Z of its surface over the plate."""

    body: BaseGeometry
    region: BaseGeometry
    z_mm: float

    def heat(self, column: HeatColumn | None, config: Config) -> SurfaceHeat:
        """Heat of it on what stands, `column`, which is not changed; None: the bare plate."""
        column = bare_plate(self.body, config) if column is None else column.copy()
        return SurfaceHeat(column, self.body, self.region, config.process.base_plate_mm + self.z_mm, config)


def scanned(
    sections: Sequence[BaseGeometry], k: int, z_mm: float, config: Config, under: BaseGeometry | None = None,
    spot_share: float = 1.0,
) -> Scanned:  # fmt: skip
    """What the beam's middle may go over before layer `k`, whose bottom lies at `z_mm`, by code of its own.

    On the plate: as far as `preheat.margin_mm` around the box of the lowest section, half a spot within the plate. On what stands, `under`
    or the layer below: half a spot within its section. Nowhere nearer to a clamp that is higher than half a spot. The spot counts by
    `spot_share`, that of the plate wholly."""
    half_mm = 0.5 * spot_share * config.preheat.spot_mm
    below = under if k == 0 else sections[k - 1]
    if below is not None:
        body, region, floor_mm = below, eroded(below, half_mm), z_mm
    else:
        (x0, y0), (x1, y1) = np.reshape(shapely.bounds(sections[0]), (2, 2)).tolist()
        margin_mm, floor_mm = config.preheat.margin_mm, 0.0
        body = region = shapely.box(x0 - margin_mm, y0 - margin_mm, x1 + margin_mm, y1 + margin_mm)
        low, high = config.machine.base_plate_min_mm, config.machine.base_plate_max_mm
        if low is not None and high is not None:
            edge_mm = 0.5 * config.preheat.spot_mm
            plate = shapely.box(low[0] + edge_mm, low[1] + edge_mm, high[0] - edge_mm, high[1] - edge_mm)
            body, region = shapely.box(*low, *high), shapely.intersection(region, plate)
    for place in config.process.keep_out:
        if place.z_mm[1] > floor_mm:
            clamp = shapely.buffer(shapely.Polygon(place.outline_mm), half_mm)
            region = shapely.difference(region, clamp)
    return Scanned(body, region, floor_mm)


def scanned_heat(
    way: BeamWay, sections: list[BaseGeometry], k: int, z_mm: float, column: HeatColumn | None, config: Config,
    under: BaseGeometry | None = None,
) -> tuple[SurfaceHeat, Scanned] | None:  # fmt: skip
    """Heat of what is :func:`scanned` before layer `k` when the beam has gone its way; None where there is nothing to scan.

    `column` is that of what stands, which is not changed; None: the bare plate.
    """
    on = scanned(sections, k, z_mm, config, under)
    if on.region.is_empty or on.body.is_empty:
        return None
    heat = on.heat(column, config)
    heat.simulate(way)
    return heat, on


def begun_column(scans: Mapping[int, BeamWay], lowest: BaseGeometry | None, config: Config) -> HeatColumn:
    """Return the column with which a program begins on the plate: as its text preheats it, cold without."""
    column = HeatColumn(config)
    if config.base_mm == 0.0 and 0 in scans and lowest is not None and not lowest.is_empty:
        found = scanned_heat(scans[0], [lowest], 0, 0.0, None, config)
        if found is not None:
            column.warm_plate = found[0].content_under_region()
    return column
