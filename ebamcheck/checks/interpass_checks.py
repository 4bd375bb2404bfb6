"""Checks of a program's heat from its text: the waits and power that keep the part cool, and the entry temperature of each bead by
a heat balance."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.bead_end_checks import ramp_power
from ebamcheck.checks.checks import PRINTED, VALUE_SHARE, count_check, event_faults
from ebamcheck.checks.heat_again import MODELS_K, BeadHeat, entries_k, highest_entry_k, may_differ_k
from ebamcheck.checks.value_checks import melting_check, own_shares
from ebamcheck.geometry.regions import eroded
from ebamcheck.heat.balance import HeatColumn, LayerShape
from ebamcheck.heat.medium import entry_limit_k, scheduled_share
from ebamcheck.heat.preheating import BeamWay, SurfaceHeat, bare_plate
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.conventions import power_slack_w
from ebamcheck.nc.inputs import Interpass
from ebamcheck.nc.motions import RAPID, NCProgram
from ebamcheck.nc.timeline import PAUSE, Kind
from ebamcheck.result import Check
from ebamcheck.settings.config import Config

LONGEST_WAIT_S = 4.0 * 3600.0  # Longest wait that is looked for
LEAST_SHARE = 1e-6  # Least share of power to divide an energy by: a bead may have none
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
    """Beads (P,) of a program in its sequence, each from beam on to beam off. The text alone need not tell which beads are of one
    island: each bead is entered, and finds the part as warm as it then is. `wait_s` and `move_s` lie before a bead, `row` is its
    first motion; `stray` lists the waits within a bead or after the last: (event, what)."""

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
        return len(self.layer)

    @cached_property
    def enters_layer(self) -> np.ndarray:
        """Whether each bead is the first of its layer, (P,)."""
        return np.asarray(np.diff(self.layer, prepend=-1) != 0)

    def of_layers(self) -> Iterator[tuple[int, int]]:
        """First bead of each layer in its sequence, and the one after its last."""
        first = np.flatnonzero(self.enters_layer)
        return zip(first.tolist(), np.append(first, len(self))[1:].tolist(), strict=True)

    @cached_property
    def inner(self) -> np.ndarray:
        """Whether each bead is a further bead of the same island, (P,)."""
        return np.asarray((self.island >= 0) & (np.diff(self.island, prepend=-1) == 0) & ~self.enters_layer)

    def named(self, n: int) -> str:
        """Name bead `n` in a message."""
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
        """Time between motions (n,) s; infinite where a motion of zero feed never ends."""
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
    """Mean temperature of the surface, absolute, when each bead (P,) is entered, and when each layer (L,) is done (NaN without a
    bead). By the balance of :mod:`ebamcheck.heat.balance`, on what stands `before`: the plate, cold or as the text preheats it
    under the `lowest` section. `seen` is called with each layer when it is entered, before it is preheated."""
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
    """Preheat what stands under a layer, as the text does; :func:`begun_column` has preheated the bare plate."""
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


def sections_of_text(nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None) -> list[BaseGeometry]:
    """Sections of the layers of a program: `sections` if there is one for each layer, else what its contours enclose."""
    if sections is not None and len(sections) == len(nc.layer_files):
        return list(sections)
    outlines = sections_of(nc.contours(OUTLINE_STEP_MM))
    return [shapely.buffer(outline, config.contour_offset_mm) for outline in outlines]


def text_shapes(nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None) -> list[LayerShape]:
    """Shapes of the layers of a program, by the sections of :func:`sections_of_text`."""
    count = len(nc.layer_files)
    sections = sections_of_text(nc, config, sections)
    steps = np.diff(nc.layer_heights, prepend=config.base_mm)
    usual = float(np.nanmedian(steps)) if np.isfinite(steps).any() else config.layer_height_mm
    steps = np.where(steps > 0.0, steps, usual)
    return [LayerShape.of(sections[k], float(steps[k])) for k in range(count)]


def build_times_s(nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None) -> dict[str, float]:
    """Times of a program as it is, without its waits, and at full power with waits alone, s. The last is that of the same beads,
    each entered as soon as the balance finds the surface under the limit; NaN where the wait for one would be longer than
    :data:`LONGEST_WAIT_S`."""
    beads, known = text_beads(nc, config), sections_of_text(nc, config, sections)
    busy_s = float((beads.time_s + beads.move_s).sum())
    busy_s += sum(float(way.time_s.sum()) for way in beads.scans.values())
    dwell_s = _dwell_s(beads, config, text_shapes(nc, config, known), known[0] if known else None)
    programmed_s = busy_s + float(beads.wait_s.sum())
    return {"programmed": programmed_s, "without_measures": busy_s, "dwell": busy_s + dwell_s}


def _dwell_s(beads: TextBeads, config: Config, shapes: Sequence[LayerShape], lowest: BaseGeometry | None) -> float:
    """Sum of the waits at full power, s; each is found by time steps that grow by a half."""
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
    """What is preheated before a layer: the body that takes the heat, the region to scan, and its Z over the plate."""

    body: BaseGeometry
    region: BaseGeometry
    z_mm: float

    def heat(self, column: HeatColumn | None, config: Config) -> SurfaceHeat:
        """Surface heat of the body on `column`, which is not changed; None stands for the bare plate."""
        column = bare_plate(self.body, config) if column is None else column.copy()
        return SurfaceHeat(column, self.body, self.region, config.process.base_plate_mm + self.z_mm, config)


def scanned(
    sections: Sequence[BaseGeometry], k: int, z_mm: float, config: Config, under: BaseGeometry | None = None,
    spot_share: float = 1.0,
) -> Scanned:  # fmt: skip
    """Region that the beam's centre may scan before layer `k`, whose bottom lies at `z_mm`, by code of its own. On the plate it
    spans `preheat.margin_mm` around the box of the lowest section, and stays half a spot within the plate. On what stands,
    `under` or the layer below, it stays half a spot within its section. It keeps half a spot from every higher clamp. `spot_share`
    scales the spot, but not at the border of the plate."""
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
    `column` is that of what stands, which is not changed; None: the bare plate."""
    on = scanned(sections, k, z_mm, config, under)
    if on.region.is_empty or on.body.is_empty:
        return None
    heat = on.heat(column, config)
    heat.simulate(way)
    return heat, on


def begun_column(scans: Mapping[int, BeamWay], lowest: BaseGeometry | None, config: Config) -> HeatColumn:
    """Return the column with which a program begins on the plate: preheated as its text says, else cold."""
    column = HeatColumn(config)
    if config.base_mm == 0.0 and 0 in scans and lowest is not None and not lowest.is_empty:
        found = scanned_heat(scans[0], [lowest], 0, 0.0, None, config)
        if found is not None:
            column.warm_plate = found[0].content_under_region()
    return column


INTERPASS, AGAIN = "interpass temperature", "balance of the heat"  # Names of two checks
# Share of the limit's rise, and kelvins below it, under which a layer has room for more power, and the step of the power: the balance of
# a text, which knows one temperature a section, and the plan differ by less (by 64 K at most, of 50 parts and settings).
ROOM, ROOM_K, PERCENT = 0.85, 80.0, 0.01
OVER_RANGE = "over the model's range: metal would boil"  # Of a figure clipped to the boiling point
COLD = "least entry temperature"  # Name of the check
# Least share of the rise over the chamber that a wait leaves: of the limit's rise, or of the bead's before where it is
# less. Plans wait for the hottest place of a section, so its mean is lower: at least 0.66 of the limit's rise in eleven
# sections and settings, 0.82 in the demo part. There, two minutes too many leave 0.66 to 0.70, five leave 0.51 to 0.56.
WARM_SHARE = 0.6


def wait_check(nc: NCProgram, config: Config, heat: Interpass | None) -> Check:
    """Check the waits before layers, contours, islands and further beads: exactly those of the plan; without one the least between
    layers."""
    beads = text_beads(nc, config)
    least_s = config.process.layer_pause_s
    first = beads.enters_layer & (np.arange(len(beads)) > 0)
    faults = [(nc.where_event(event), what) for event, what in beads.stray]
    events, longest_s = nc.events, config.process.longest_wait_s
    out = (events.kind == Kind.WAIT) & ~((events.value >= 0.0) & (events.value <= longest_s))
    what = f"waits {{value:g}} s, a wait is from 0 to {longest_s:g} s (process.longest_wait_s)"
    faults += event_faults(nc, (out, what))
    if heat is None:
        wanted = np.where(first, least_s, 0.0)
        bad = beads.wait_s < wanted - PRINTED
        if config.process.interpass in ("off", "power"):
            bad |= beads.wait_s > wanted + PRINTED
    else:
        wanted = np.where(beads.ring >= 0, _of(heat.ring_wait_s, beads.layer), 0.0)
        inner = beads.island >= 0
        wanted[inner] = _of(heat.island_wait_s, beads.island[inner])
        wanted[beads.inner] = _of(heat.inner_wait_s, beads.island[beads.inner])
        wanted[first] = _of(heat.wait_s, beads.layer[first]) + np.where(inner, wanted, 0.0)[first]
        wanted[:1] = np.where(inner, wanted, 0.0)[:1]
        bad = np.abs(beads.wait_s - wanted) > PRINTED
    for n in np.flatnonzero(bad).tolist():
        what = f"waits {beads.wait_s[n]:g} s before {beads.named(n)} in place of {wanted[n]:g} s"
        faults.append((nc.where(int(beads.row[n])), what))
    within = float(beads.wait_s[~first].sum())
    good = f"waits {beads.wait_s[first].sum():.6g} s between layers and {within:.6g} s within them"
    return count_check("layer pause", faults, good)


def heat_checks(
    nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None, before: HeatColumn | None = None,
    witness: Sequence[BaseGeometry] | None = None,
) -> list[Check]:  # fmt: skip
    """Check that the power of each layer melts its wire, and the temperature at which beads are entered. Without `sections` those
    count that the contours enclose; `witness` are those of the second balance. On a part that is half built, heat `before` the
    program has to be known: nothing in its text tells how warm the part is."""
    known = sections_of_text(nc, config, sections)
    beads, shapes = text_beads(nc, config), text_shapes(nc, config, known)
    melting = melting_check(nc, config, ramp_power(nc, np.flatnonzero(nc.deposit), config)[1] > 0.0)
    if before is None and config.base_mm > 0.0:
        return [melting]
    bed_k, _ = text_bed_k(beads, config, shapes, before, known[0] if known else None)
    checked = beads.enters_layer if config.process.interpass_at == "layer" else np.ones(len(beads), np.bool_)
    entries = _entries(nc, beads, bed_k, checked, config)
    checks = [melting, entries, cold_check(nc, beads, bed_k, checked, config)]
    own = sections_of_text(nc, config, witness or sections)
    if before is None and not beads.scans and own:
        checks.append(_again(nc, beads, own, config))
    return checks


def layer_shares(nc: NCProgram, config: Config) -> Floats:
    """Share of the power in each layer, (L,): that of its strongest motion whose own wire asks for less; NaN where it lays nothing.
    Where every bead has the power that its own wire needs, the least of them; ramps tell only where there is nothing else."""
    rows = np.flatnonzero(nc.deposit & (nc.layer >= 0))
    share = nc.power_w[rows] / config.process.power_w
    slack = power_slack_w(config.machine, config.process.voltage_kv, config.process.current_ma)
    own = own_shares(nc, rows, config) * (1.0 + VALUE_SHARE) + slack / config.process.power_w
    along, step = ramp_power(nc, rows, config)
    count, layer = len(nc.layer_files), nc.layer[rows]
    shares, on_ramps, least = np.full(count, -np.inf), np.full(count, -np.inf), np.full(count, np.inf)
    plain = ~(share <= own)
    np.fmax.at(shares, layer[plain & (step == 0.0)], share[plain & (step == 0.0)])
    np.fmax.at(on_ramps, layer[plain], share[plain] / along[plain])
    np.fmin.at(least, layer, share)
    shares = np.where(np.isinf(shares), on_ramps, shares)
    shares = np.where(np.isinf(shares), least, shares)
    return np.where(np.isinf(shares), np.nan, shares)


def scheduled_shares(heights: ArrayLike | None, config: Config) -> Floats | None:
    """Share of the power of each layer, (L,), of cuts at `heights` (L,), where the settings have a table of it; None where the heat
    decides."""
    cuts = np.asarray(() if heights is None else heights, np.float64)
    if isinstance(config.process.power_schedule, str) or not cuts.size:
        return None
    plate_mm = float(cuts.min()) - 0.5 * config.layer_height_mm
    return np.array([scheduled_share(config, float(z) - plate_mm) for z in cuts], np.float64)


def shares_of_text(nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None) -> Floats:
    """Share of the power that each layer is to have where no plan is known, (L,): its own, but full where nothing asks for less.
    Power is taken back only where a bead would else be entered above the limit."""
    shares = np.minimum(layer_shares(nc, config), 1.0)
    # The text does not tell how warm the part under a program is: only the melting of the wire is left to check.
    if config.process.power_schedule != "taper" or config.base_mm > 0.0:
        return shares
    if config.process.interpass not in ("power", "both"):
        return np.where(np.isnan(shares), np.nan, 1.0)
    beads = text_beads(nc, config)
    if not len(beads) or not np.isfinite(beads.time_s).all():
        return shares
    known = sections_of_text(nc, config, sections)
    bed_k, _ = text_bed_k(beads, config, text_shapes(nc, config, known), lowest=known[0] if known else None)
    hottest_k = np.full(shares.size, -np.inf)
    np.maximum.at(hottest_k, beads.layer, bed_k - config.process.ambient_temperature_k)
    rise_k = highest_entry_k(config) - config.process.ambient_temperature_k
    allowed_k = min(ROOM * rise_k, rise_k - ROOM_K)
    # The balance spreads heat over all of a section. Pieces that do not touch, as parts of a plate, keep theirs: the least of them that
    # is no mere spot may be as much hotter as it is smaller, but takes no more than its share of the layer's.
    for k, section in enumerate(known):
        pieces = shapely.area(shapely.get_parts(section))
        pieces = pieces[pieces >= config.process.bead_width_mm**2]
        hottest_k[k] *= min(pieces.sum() / pieces.min(), pieces.size) if pieces.size else 1.0
    # What lies below does not get hotter with the layer's own power: all of it counts as if it did.
    with np.errstate(divide="ignore", invalid="ignore"):
        could_have_more = hottest_k * (shares + PERCENT) / shares < allowed_k
    return np.where(could_have_more, 1.0, shares)


def _of(values: Floats, number: Ints) -> Floats:
    """Values (n,) of layers or islands by their number; 0 for those that the plan does not know."""
    known = (number >= 0) & (number < values.size)
    result = np.zeros(number.size)
    result[known] = values[number[known]]
    return result


def _entries(nc: NCProgram, beads: TextBeads, bed_k: Floats, checked: Bools, config: Config) -> Check:
    """Check the surface temperature when a bead is entered, by the balance, against the limit."""
    limit_k = highest_entry_k(config)
    if not checked.any():
        return Check(INTERPASS, True, 0.0, limit_k, "K", "", "nothing is laid")
    rows = np.flatnonzero(checked)
    worst = int(rows[np.argmax(bed_k[rows])])
    figure_k, mark = within_range(float(bed_k[worst]), config)
    over = int((bed_k[rows] > limit_k).sum())
    text = f"surface at {figure_k:.0f} K{mark} when {beads.named(worst)} is entered, by the balance of the heat"
    if over:
        text += f"; {over} of {rows.size} entries are over {limit_k:.0f} K"
    return Check(INTERPASS, not over, figure_k, limit_k, "K", nc.where(int(beads.row[worst])), text)


def _again(nc: NCProgram, beads: TextBeads, sections: Sequence[BaseGeometry], config: Config) -> Check:
    """Check the same temperature by a second balance, against the limit plus what two balances may differ by."""
    ambient_k, limit_k = config.process.ambient_temperature_k, highest_entry_k(config)
    most_k = limit_k + may_differ_k(config)
    heat_j = beads.energy_j * config.material.absorptivity
    heat = BeadHeat(beads.layer, beads.move_s + beads.wait_s, beads.time_s, heat_j)
    if not len(beads):
        return Check(AGAIN, True, 0.0, most_k, "K", "", "nothing is laid")
    steps = np.diff(nc.layer_heights, prepend=config.base_mm)
    bed_k = entries_k(heat, sections, np.where(steps > 0.0, steps, config.layer_height_mm), config)
    if config.process.interpass_at == "layer":
        bed_k = np.where(beads.enters_layer, bed_k, ambient_k)
    bead = int(np.argmax(bed_k))
    figure_k, mark = within_range(float(bed_k[bead]), config)
    text = (
        f"surface at {figure_k:.0f} K{mark} when {beads.named(bead)} is entered, by a second balance of the heat; "
        f"{limit_k:.0f} K is the limit, and {most_k - limit_k:.0f} K more is what balances may differ by"
    )
    where = nc.where(int(beads.row[bead]))
    return Check(AGAIN, bool(bed_k[bead] <= most_k), figure_k, most_k, "K", where, text)


def within_range(temperature_k: float, config: Config) -> tuple[float, str]:
    """Temperature clipped to the boiling point, and the mark of one that was over it."""
    boiling_k = config.material.boiling_k
    return (temperature_k, "") if temperature_k <= boiling_k else (boiling_k, f" ({OVER_RANGE})")


def least_entries_k(beads: TextBeads, bed_k: Floats, config: Config) -> Floats:
    """Least temperature at which each bead may be entered, (P,) K: the one that is set, else by its wait; -inf where there is none.
    A bead that is waited for longer than `process.layer_pause_s`, without preheating, may be as cold as :data:`WARM_SHARE` allows,
    or as two balances of the heat differ."""
    process = config.process
    if process.least_entry_temperature_k is not None:
        return np.full(len(beads), process.least_entry_temperature_k)
    ambient_k = process.ambient_temperature_k
    before_k = np.concatenate([[ambient_k], bed_k[:-1]])[: len(beads)]
    warm_k = np.minimum(before_k, highest_entry_k(config)) - ambient_k
    least_k = ambient_k + np.minimum(WARM_SHARE * warm_k, warm_k - MODELS_K)
    asked_s = np.where(beads.enters_layer, process.layer_pause_s, 0.0)
    preheated = beads.enters_layer & np.isin(beads.layer, list(beads.scans))
    waited = (beads.wait_s > asked_s + PRINTED) & ~preheated
    return np.where(waited, least_k, -np.inf)


def cold_check(nc: NCProgram, beads: TextBeads, bed_k: Floats, checked: Bools, config: Config) -> Check:
    """Check the surface temperature when beads are entered, by the balance of the text, against the least, where `checked` (P,).
    A bead that waits longer is entered colder than the power is tapered for, and fuses worse with what lies under it."""
    least_k = np.where(checked, least_entries_k(beads, bed_k, config), -np.inf)
    if not np.isfinite(least_k).any():
        return Check(COLD, True, 0.0, 0.0, "K", "", "no bead is waited for longer than the settings ask")
    over_k = bed_k - least_k
    worst, under = int(np.argmin(over_k)), int((over_k < 0.0).sum())
    text = (
        f"surface at {bed_k[worst]:.0f} K when {beads.named(worst)} is entered after a wait of {beads.wait_s[worst]:g} s; "
        f"{least_k[worst]:.0f} K is the least"
    )
    if under:
        text += f"; {under} of {len(beads)} entries are under theirs"
    where = nc.where(int(beads.row[worst]))
    return Check(COLD, not under, float(bed_k[worst]), float(least_k[worst]), "K", where, text)
