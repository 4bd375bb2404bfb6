"""Checks of preheating: where the beam goes, out of focus and without wire, how often, and how warm and even the surface is by its
text.

Region, lines and passes are worked out by code of their own: plan and writer take them from one place, and a mistake there would be
in the program and in what it is held against. The heat goes by the model of the plan; on the plate a second balance is held against
it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import (
    LIMIT_ROUNDING_MM,
    VALUE_SHARE,
    Faults,
    count_check,
    event_faults,
    limit_check,
    row_faults,
)
from ebamcheck.checks.heat_again import MODELS_SHARE, plate_k
from ebamcheck.checks.interpass_checks import (
    Scanned,
    scanned,
    scanned_heat,
    scans_of,
    sections_of_text,
    text_beads,
    text_bed_k,
    text_shapes,
)
from ebamcheck.checks.state_checks import beyond_travel_mm, modes_of_scans
from ebamcheck.geometry.regions import eroded
from ebamcheck.heat.balance import HeatColumn
from ebamcheck.heat.preheating import BeamWay, SurfaceK, spot_peak_k
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.codes import BEAM_VALUES, FOCUS
from ebamcheck.nc.conventions import increments_of, safe_end_mm
from ebamcheck.nc.files import layer_of_preheat
from ebamcheck.nc.motions import RAPID, STRAIGHT, NCProgram
from ebamcheck.nc.timeline import Kind
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.stages import AIM_K, JOINED_SPACINGS, LEAST_LINE_MM, LEAST_REST_S

PLACE_MM = 0.01  # How far beside the region a line may end: the decimals of the program
ROUND_SHARE = 2e-3  # Share of the spot by which a rounding of chords may lie beside its circle
WIDEST = 1.5  # Spacings between lines at most, from where on one more would lie nearer than one
SLIVER_MM = 0.1  # Lines across a narrower place may be left out
ALONG_MM = 1e-3  # A line along an axis leaves it by no more: the decimals of a program, at their coarsest
# Share of a pass by which the way of a scan may be off that of whole passes; more of these are not counted.
LENGTH_SHARE, MOST_PASSES = 0.02, 20000
AT_ONCE_S = 10.0  # Time that the second balance takes at once


def preheat_checks(
    nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None, before: HeatColumn | None = None,
    under: BaseGeometry | None = None,
) -> list[Check]:  # fmt: skip
    """Check the preheating scans of a program; nothing where the settings ask for none and it has none. Without `sections` (L,)
    those count that its contours enclose. Where a program begins on a part that is half built, how often it is scanned, and how
    warm it is then, are judged by heat `before` and section `under` it alone."""
    if config.preheat.when == "off":
        if nc.preheating is None:
            return []
        where = nc.preheating.beginning if len(nc.preheating) else f"{nc.files[0].name}:1"
        return [count_check("preheat calls", [(where, "preheats, and preheat.when is 'off'")], "")]
    sections = sections_of_text(nc, config, sections)
    state = "out of focus, no wire, values as set, focus taken back"
    checks = [
        count_check("preheat calls", list(_calls(nc, config)), "each right before its layer"),
        count_check("preheat state", list(_states(nc, config)), state),
        *_paths(nc, config, sections, under),
    ]
    if config.base_mm > 0.0 and (before is None or under is None):
        return checks
    found = found_scans(nc, config, sections, before, under)
    return [
        *checks,
        count_of(found, config),
        *temperatures_of(found, config),
        *temperature_again(found, config),
    ]


def _calls(nc: NCProgram, config: Config) -> Iterator[tuple[str, str]]:
    """Scans that are not called by the main program right before their layer, and the one of the plate that is missing."""
    main, e = nc.files[0].name, nc.events
    stem = main.rpartition(".")[0]
    calls = np.flatnonzero(e.kind == Kind.CALL).tolist()
    names = [e.said(i) for i in calls]
    layers = [file.rpartition(".")[0] for file in nc.layer_files]
    for i, name, after in zip(calls, names, [*names, ""][1:], strict=True):
        k = layer_of_preheat(stem, name)
        if k is None:
            continue
        if not 0 <= k < len(layers) or after != layers[k]:
            what = f"{name} is to be called right before layer {k + 1}, and {after or 'nothing'} follows"
            yield nc.where_event(i), what
        if int(e.file[i]) != 0:
            yield nc.where_event(i), f"{name} is called by another than the main program"
    if config.preheat.scan_in == "layer":
        yield from _within_layers(nc, config)
    elif layer_of_preheat(stem, names[0] if names else "") != 0:
        where = nc.where_event(calls[0]) if calls else f"{main}:1"
        yield where, "the base plate is not preheated before the first layer (preheat.when)"
    if nc.preheating is not None:
        called = nc.preheating.events.kind == Kind.CALL
        yield from event_faults(nc.preheating, (called, "call {said} within a preheating subprogram"))


def _within_layers(nc: NCProgram, config: Config) -> Iterator[tuple[str, str]]:
    """Scans in the subprograms of layers that come after a bead of theirs, that are two, or that are missing on the plate."""
    scans, beads = nc.preheating, np.flatnonzero(nc.deposit)
    known: set[int] = set()
    if scans is not None:
        e = scans.events
        out = _out_of_focus(scans)
        file, line = e.file[out], e.line[out]
        known = set(file.tolist())
        late, second = np.zeros(len(e), np.bool_), np.zeros(len(e), np.bool_)
        places = zip(file, line, strict=True)
        late[out] = [((nc.file[beads] == f) & (nc.line[beads] < k)).any() for f, k in places]
        second[out] = [np.count_nonzero(file[: n + 1] == file[n]) == 2 for n in range(file.size)]
        yield from event_faults(
            scans,
            (late, "preheats after beads of its layer"),
            (second, "preheats twice before one layer"),
            (out & (e.file == 0), "preheats in the main program"),
        )
    first = nc.file[beads[0]] if beads.size else 0
    if config.base_mm == 0.0 and int(first) not in known:
        where = nc.where(int(beads[0])) if beads.size else f"{nc.files[0].name}:1"
        yield where, "the base plate is not preheated before the first layer (preheat.when)"


def _out_of_focus(nc: NCProgram) -> Bools:
    return np.asarray(nc.events.named(FOCUS) & (nc.events.value != 0.0))


def _states(nc: NCProgram, config: Config) -> Iterator[tuple[str, str]]:
    """Wire, focus and values of the beam in the scans, and a focus that is not taken back."""
    yield from event_faults(nc, (_out_of_focus(nc), "focus {value:g} is set outside of preheating"))
    scans = nc.preheating
    if scans is None:
        return
    yield from modes_of_scans(scans, config)
    yield from row_faults(scans, np.flatnonzero(scans.wire)[:1], "the wire runs while it preheats")
    rapid = np.flatnonzero(scans.beam & (scans.kind == RAPID))[:1]
    yield from row_faults(scans, rapid, "beam is on during a rapid motion")
    for events in scans.events.by_file():
        yield from _events(replace(scans, events=events), config)


def _events(scans: NCProgram, config: Config) -> Iterator[tuple[str, str]]:
    """What a scan, with the events of its file, switches and sets, waits for and leaves behind."""
    settings, process, steps, e = config.preheat, config.process, increments_of(config.machine), scans.events
    if not len(e):
        return
    wanted = {
        "voltage_kv": process.voltage_kv,
        "current_ma": settings.current_ma,
        "power_w": settings.current_ma * process.voltage_kv,
    }
    on, beam, never = e.kind == Kind.BEAM_ON, e.beam[:-1], np.zeros(len(e), np.bool_)
    known = {name: e.set_before(name)[:-1] for name in wanted}
    focus = e.set_before(FOCUS)
    off = e.since(e.kind == Kind.BEAM_OFF, never) & e.since(e.kind == Kind.WIRE_STOP, never)

    def other(name: str) -> tuple[Bools, Callable[[int], str]]:
        slack = VALUE_SHARE * wanted[name] + 0.5 * steps.get(name, 0.0)
        text = "the beam is switched on at {} {:g}, to preheat it is {:g} (preheat.current_ma)"
        wrong = on & (np.abs(known[name] - wanted[name]) > slack)
        return wrong, lambda i: text.format(name, known[name][i], wanted[name])

    unset = on & np.isnan(known["current_ma"]) & np.isnan(known["power_w"])
    at = "the beam is switched on in focus {:g}, preheat.defocus is {:g}"
    yield from event_faults(
        scans,
        (
            on & (focus[:-1] != settings.defocus),
            lambda i: at.format(np.nan_to_num(focus[i]), settings.defocus),
        ),
        (on & ~off[:-1], "the beam is switched on before beam and wire were commanded off"),
        *(other(name) for name in BEAM_VALUES),
        (unset, "the beam is switched on before its power is set"),
        (e.kind == Kind.WIRE_START, "the wire is started while it preheats"),
        ((e.kind == Kind.WAIT) & beam, "waits {value:g} s with the beam on"),
        (e.kind == Kind.LACKS, "its template asks for {said!r} before this block"),
        (e.named(*BEAM_VALUES, FOCUS) & beam, "{name} {value:g} is set while the beam is on"),
    )
    where = scans.where_event(len(e) - 1)
    if e.beam[-1]:
        yield where, "ends with the beam on"
    if focus[-1] != 0.0:
        yield where, "ends with the beam out of focus: beads would be laid with it"


def _paths(nc: NCProgram, config: Config, sections: list[BaseGeometry], under: BaseGeometry | None) -> list[Check]:
    """Ways beside the region, at another height or speed, or beyond the travel; and what the lines leave out of the region.
    They lie evenly, about a spacing apart."""
    scans, faults, worst = nc.preheating, Faults(), (0.0, "", 0)
    if scans is not None and len(scans):
        bottoms, beyond = bottoms_of(nc, config), beyond_travel_mm(scans, config).max(axis=1)
        far = beyond > LIMIT_ROUNDING_MM
        faults += row_faults(scans, far, "{:g} mm beyond the travel", beyond[far])
        for k in np.unique(scans.layer).tolist():
            rows, bottom_mm = np.flatnonzero(scans.layer == k), 0.0
            where = scans.where(int(rows[0]))
            if not 0 <= k < len(sections) or sections[k].is_empty:
                faults.append((where, f"preheats before layer {k + 1}, which is none of the program"))
                continue
            if k == 0 and config.base_mm > 0.0 and under is None:
                continue  # What stands there is not known.
            bottom_mm = float(bottoms[k])
            region = scanned(sections, k, bottom_mm, config, under, 1.0 - 2.0 * ROUND_SHARE).region
            faults += _rows_off(scans, rows, region, safe_end_mm(bottom_mm, config), config)
            start, end = (np.nan_to_num(at[rows[scans.beam[rows]], :2]) for at in (scans.start, scans.end))
            gap_mm = widest_gap_mm(region, start, end, config)
            worst = (gap_mm, where, k) if gap_mm > worst[0] else worst
    (gap_mm, where, k), spacing_mm = worst, config.preheat.spacing_mm
    text = f"lines of the scan before layer {k + 1} are up to {gap_mm:.4g} mm apart, preheat.spacing_mm is {spacing_mm:g} mm"
    return [
        count_check("preheat path", faults, "over the region, at its height, at its speed"),
        limit_check("preheat lines", gap_mm, WIDEST * spacing_mm + PLACE_MM, "mm", text, where),
    ]


def _rows_off(
    scans: NCProgram, rows: Ints, region: BaseGeometry, z_mm: float, config: Config
) -> Iterator[tuple[str, str]]:
    on, z, feed = scans.beam[rows], scans.end[rows, 2], scans.feed_mm_min[rows] / 60.0
    speed = config.preheat.speed_mm_s
    for wrong, what in (
        (on & (scans.kind[rows] != STRAIGHT), "is no straight line"),
        (~on & (scans.kind[rows] != RAPID), "a way with the beam off is driven at feed in place of a rapid"),
        (~(np.abs(z - z_mm) <= PLACE_MM), "at Z {z:g} mm, it preheats at {wanted:g} mm, over all that stands"),
        (on & ~(np.abs(feed - speed) <= VALUE_SHARE * speed), "beam at {feed:g} mm/s, preheat.speed_mm_s is {speed:g}"),
    ):  # fmt: skip
        for i in np.flatnonzero(wrong)[:1].tolist():
            yield scans.where(int(rows[i])), what.format(z=z[i], wanted=z_mm, feed=feed[i], speed=speed)
    lit = rows[on]
    ends = np.stack([scans.start[lit, :2], scans.end[lit, :2]], axis=1)
    known: Bools = np.asarray(np.isfinite(ends).all(axis=(1, 2)))
    lines = shapely.linestrings(np.where(known[:, None, None], ends, 0.0))
    for row in lit[~known | ~shapely.covers(shapely.buffer(region, PLACE_MM), lines)][:1].tolist():
        x, y = scans.end[row, :2].tolist()
        what = f"the beam leaves what is to be preheated on its way to ({x:g}, {y:g})"
        yield scans.where(row), what


def widest_gap_mm(region: BaseGeometry, start: Floats, end: Floats, config: Config) -> float:
    """Greatest distance between two lines of the beam, (n, 2) each, side by side across the region, and from its ends to the next.
    A line counts where all of it within the region is driven. Lines along X are asked for, and along Y where there are any."""
    way = np.abs(end - start)
    along, across = (way[:, 1] <= ALONG_MM), (way[:, 0] <= ALONG_MM)
    gap_mm = _gap_mm(region, start[along], end[along])
    # Shorter ones join two lines along X.
    if way[across, 1].max(initial=0.0) > 2.0 * WIDEST * config.preheat.spacing_mm:
        swapped = shapely.transform(region, lambda places: places[:, ::-1])
        gap_mm = max(gap_mm, _gap_mm(swapped, start[across, ::-1], end[across, ::-1]))
    return gap_mm


def _gap_mm(region: BaseGeometry, start: Floats, end: Floats) -> float:
    """The same of lines along X."""
    row = np.round(start[:, 1] / ALONG_MM).astype(np.int64)
    driven = {y * ALONG_MM: shapely.union_all(shapely.linestrings(np.stack([start[row == y], end[row == y]], axis=1)))
              for y in np.unique(row).tolist()}  # fmt: skip
    worst = 0.0
    for part in shapely.get_parts(eroded(region, 0.6 * SLIVER_MM)):
        x0, y0, x1, y1 = shapely.bounds(part).tolist()
        places = [y0]
        for y, lines in driven.items():
            if y0 < y < y1:
                whole = shapely.intersection(part, shapely.LineString([(x0 - 1.0, y), (x1 + 1.0, y)]))
                near = shapely.buffer(lines, SLIVER_MM)
                left = shapely.get_parts(shapely.difference(whole, near))
                if shapely.length(left).max(initial=0.0) <= SLIVER_MM:
                    places.append(y)
        worst = max(worst, float(np.diff([*places, y1]).max()))
    return worst


@dataclass
class Found:
    """What is found of one scan."""

    layer: int
    on: Scanned
    way: BeamWay
    after: SurfaceK | None
    passes: int
    wanted: int
    where: str = ""


def bottoms_of(nc: NCProgram, config: Config) -> np.ndarray:
    """Z of what each layer lies on (L,)."""
    tops = np.nan_to_num(nc.layer_heights, nan=config.base_mm)
    return np.concatenate([[config.base_mm], tops])[: len(tops) + 1]


def found_scans(
    nc: NCProgram, config: Config, sections: list[BaseGeometry], before: HeatColumn | None, under: BaseGeometry | None
) -> list[Found]:  # fmt: skip
    """Follow the heat of the program, and simulate every scan of its text; layers without a scan are told by their beginning."""
    scans, beads, bottoms = scans_of(nc, config), text_beads(nc, config), bottoms_of(nc, config)
    found, on_plate = list[Found](), config.base_mm == 0.0

    def seen(k: int, column: HeatColumn | None) -> None:
        alone = config.preheat.when == "plate" and (k or not on_plate)
        plate_again = column is not None and k == 0 and on_plate
        if k >= len(sections) or sections[k].is_empty or alone or plate_again:
            return
        nothing = BeamWay(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
        way = scans.get(k, nothing)
        reached = scanned_heat(way, sections, k, float(bottoms[k]), column, config, under)
        if reached is None:
            return
        surface, on = reached
        cold = column is None
        if column is not None:
            # Colder than the target once its surface has had as long to even out as after a scan.
            rested = column.copy()
            rested.advance(max(config.preheat.soak_s, LEAST_REST_S))
            cold = rested.surface_k < config.preheat.target_k
        wanted = _passes_wanted(on, column, config) if cold else 0
        places = [
            text.where(int(rows[0]))
            for text in (nc.preheating, nc)
            if text is not None and (rows := np.flatnonzero(text.layer == k)).size
        ]
        where = places[0] if places else f"{nc.files[0].name}:1"
        found.append(Found(k, on, way, surface.read(), _passes(way, on, config), wanted, where))

    if on_plate:
        seen(0, None)
    column, lowest = None if on_plate else before, sections[0] if sections else None
    text_bed_k(beads, config, text_shapes(nc, config, sections), column, lowest, seen)
    return found


def pass_way(region: BaseGeometry, config: Config, number: int, here: Floats | None = None) -> BeamWay:
    """Way of the beam in a pass, counted from 0, from `here` on: rows to and fro, the ways that join them, and rapids between
    others. Every second pass lies across (crossed), or half a spacing aside (lines)."""
    settings, nothing = config.preheat, np.zeros((0, 2))
    if region.is_empty:
        return BeamWay(nothing, nothing, np.zeros(0), np.zeros(0))
    crossed = settings.pattern == "crossed"
    axes = [1, 0] if crossed and number % 2 else [0, 1]
    turned = shapely.transform(region, lambda places: places[:, axes])
    x0, y0, x1, y1 = shapely.bounds(turned).tolist()
    count = max(1, round((y1 - y0) / settings.spacing_mm))
    aside = (number // 2 if crossed else number) % 2
    y = y0 + (np.arange(count) + 0.5) * (y1 - y0) / count + 0.5 * settings.spacing_mm * aside
    across = [[(x0 - 1.0, at), (x1 + 1.0, at)] for at in y[y < y1].tolist()]
    met = shapely.intersection(turned, shapely.linestrings(across))
    parts, row = shapely.get_parts(met, return_index=True)
    whole = shapely.length(parts) > LEAST_LINE_MM
    row, x = row[whole], shapely.bounds(parts[whole]).reshape(-1, 4)[:, [0, 2]]
    x[row % 2 == 1] *= -1.0  # rows that are driven backwards
    x.sort(axis=1)
    order = np.lexsort((x[:, 0], row))
    sign = np.where(row % 2 == 1, -1.0, 1.0)[:, None]
    ends = np.stack([sign * x, np.repeat(y[row][:, None], 2, 1)], axis=2)
    places = ends[order].reshape(-1, 2)[:, axes]
    lit = np.arange(max(len(places) - 1, 0)) % 2 == 0
    if here is not None and len(places):
        places, lit = np.vstack([here, places]), np.append(False, lit)
    start, end = places[:-1], places[1:]
    length = np.hypot(*(end - start).T)
    joins = np.flatnonzero(~lit & (length <= JOINED_SPACINGS * settings.spacing_mm))
    joins = joins[joins > 0] if here is not None else joins
    ways = shapely.linestrings(np.stack([start, end], axis=1)[joins])
    lit[joins] = shapely.covers(shapely.buffer(region, 1e-6), ways)  # the rounding of a way along its border
    power_w = settings.current_ma * config.process.voltage_kv * lit
    time_s = length / np.where(lit, settings.speed_mm_s, config.machine.rapid_mm_s)
    return BeamWay(start, end, time_s, power_w)


def _way_mm(way: BeamWay) -> float:
    return float(np.hypot(*(way.end - way.start).T)[way.power_w > 0.0].sum())


def _passes(way: BeamWay, on: Scanned, config: Config) -> int:
    """Whole passes that the way under the beam comes to; -1 where it is none."""
    length, done, n = _way_mm(way), 0.0, 0
    while n <= MOST_PASSES:
        own = _way_mm(pass_way(on.region, config, n))
        if abs(length - done) <= LENGTH_SHARE * own:
            return n
        if own <= 0.0 or done > length:
            return -1
        done, n = done + own, n + 1
    return -1


def _passes_wanted(on: Scanned, column: HeatColumn | None, config: Config) -> int:
    """Passes that are set, else the fewest by which what stands reaches the target when the soak is over, by the heat model."""
    settings, here, n = config.preheat, None, 0
    if settings.passes is not None:
        return settings.passes
    heat = on.heat(column, config)
    while n < settings.most_passes:
        way = pass_way(on.region, config, n, here)
        here, n = way.end[-1] if way.time_s.size else None, n + 1
        heat.simulate(way)
        soaked = heat.copy()
        soaked.rest(settings.soak_s)
        if soaked.read().mean_k >= settings.target_k + AIM_K:
            break
    return n


def count_of(found: list[Found], config: Config) -> Check:
    """Passes of each scan: those set, else the fewest that reach the target by the heat model."""
    faults, is_set = [], config.preheat.passes is not None
    by = "preheat.passes" if is_set else f"the fewest that come to preheat.target_k + {AIM_K:g} K"
    for scan in found:
        before, on_plate = f"before layer {scan.layer + 1}", scan.layer == 0 and config.base_mm == 0.0
        room = 0 if is_set or on_plate else 1
        if scan.passes < 0:
            faults.append((scan.where, f"{before} the way of the beam is not that of whole passes"))
        elif abs(scan.passes - scan.wanted) > room:
            faults.append((scan.where, f"{scan.passes} passes {before} in place of {scan.wanted}, {by}"))
    total = sum(max(scan.passes, 0) for scan in found)
    return count_check("preheat count", faults, f"{total} passes in {sum(s.passes > 0 for s in found)} scans")


def temperatures_of(found: list[Found], config: Config) -> list[Check]:
    """Temperature, evenness and peak of the scanned surfaces."""
    settings, solidus_k = config.preheat, config.material.solidus_k
    read = [(scan, scan.after) for scan in found if scan.after is not None]
    driven = [pair for pair in read if pair[0].passes]
    if not read:
        return []
    (scan, at), least_k = min(read, key=lambda pair: pair[1].mean_k), settings.target_k
    text = f"layer {scan.layer + 1} begins on {at.mean_k:.0f} K, preheat.target_k is {least_k:g} K"
    warm, unit = at.mean_k >= least_k, "K, at least"
    checks = [Check("preheat temperature", bool(warm), at.mean_k, least_k, unit, scan.where, text)]
    if not driven:
        return checks
    scan, at = max(driven, key=lambda pair: pair[1].mean_k)
    limit_k, most_w = least_k + settings.over_k, max(float(p[0].way.power_w.max(initial=0.0)) for p in read)
    text = f"preheated to {at.mean_k:.0f} K at most, preheat.target_k + over_k is {limit_k:g} K"
    checks.append(limit_check("preheat overheating", at.mean_k, limit_k, "K", text, scan.where))
    peak_k, where = at.mean_k + spot_peak_k(most_w, settings.speed_mm_s, config), scan.where
    (scan, at), limit_k = max(driven, key=lambda pair: pair[1].spread_k), settings.evenness_k
    text = (
        f"{at.least_k:.0f} K at {at.least_at_mm} to {at.most_k:.0f} K at {at.most_at_mm} before layer {scan.layer + 1}, "
        f"preheat.evenness_k is {limit_k:g} K"
    )
    checks.append(limit_check("preheat evenness", at.spread_k, limit_k, "K", text, scan.where))
    text = f"the surface comes to {peak_k:.0f} K under a beam of {most_w:g} W and {settings.spot_mm:g} mm, solidus is {solidus_k:g} K"
    return [*checks, Check("preheat melting", bool(peak_k < solidus_k), peak_k, solidus_k, "K", where, text)]


def temperature_again(found: list[Found], config: Config) -> list[Check]:
    """Temperature of the bare plate by a second balance of the heat: between that of all of the plate, and that of what is scanned
    alone."""
    scan = next((s for s in found if s.layer == 0 and s.after is not None), None)
    if scan is None or scan.after is None or config.base_mm > 0.0 or not scan.way.time_s.size:
        return []
    number = np.floor(np.cumsum(scan.way.time_s) / AT_ONCE_S).astype(np.int64)
    _, of = np.unique(number, return_inverse=True)
    times_s = np.bincount(of, scan.way.time_s).astype(np.float64)
    beam_j = np.bincount(of, scan.way.time_s * scan.way.power_w).astype(np.float64)
    heats_j = config.material.absorptivity * beam_j
    areas_mm2 = scan.on.body.area, scan.on.region.area
    low_k, high_k = sorted(plate_k(max(area, 1e-9), times_s, heats_j, config) for area in areas_mm2)
    off_k = max(low_k - scan.after.mean_k, scan.after.mean_k - high_k, 0.0)
    limit_k = MODELS_SHARE * max(low_k - config.process.ambient_temperature_k, 0.0)
    text = f"the plate is preheated to {scan.after.mean_k:.0f} K, by a second balance of the heat to {low_k:.0f} K"
    text += f" .. {high_k:.0f} K" if high_k > low_k + 1.0 else ""
    return [limit_check("preheat balance", off_k, limit_k, "K", text, scan.where)]
