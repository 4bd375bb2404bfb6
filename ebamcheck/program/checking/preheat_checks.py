"""Checks of preheating: where the beam goes, out of focus and without wire, how often, and how warm the surface is by its text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.heat.balance import HeatColumn
from ebamcheck.numeric.rings import Bools
from ebamcheck.program.checking.checks import Check, count_check, event_place
from ebamcheck.program.checking.preheat_way import WAITS, scanned_heat, scans_of
from ebamcheck.program.checking.state_checks import extremes
from ebamcheck.program.checking.text_heat import sections_of_text, text_beads, text_bed_k, text_shapes
from ebamcheck.program.language.codes import BEAM_VALUES, FOCUS
from ebamcheck.program.language.files import layer_of_preheat
from ebamcheck.program.language.increments import increments_of
from ebamcheck.program.language.safe_end import safe_end_mm
from ebamcheck.program.reading.motions import RAPID, STRAIGHT, NCProgram
from ebamcheck.scan.filling.preheat_lines import pass_length_mm, pass_lines
from ebamcheck.scan.heat.preheating import BeamWay, SurfaceK, spot_peak_k
from ebamcheck.scan.plan.preheated import AIM_K, Scanned, asked_for, is_cold, passes_asked, scanned
from ebamcheck.settings.config import Config

VALUE_SHARE = 1e-3
"""Share by which a printed value may be off."""

PLACE_MM = 0.01
"""How far beside the region a line may end: the decimals of the program."""

LENGTH_SHARE, MOST_PASSES = 0.02, 20000
"""Share of a pass by which the way of a scan may be off that of whole passes; more of these are not counted."""

Faults = list[tuple[str, str]]


@dataclass
class _Found:
    """What is found of one scan."""

    layer: int
    on: Scanned
    way: BeamWay
    begins_k: float
    after: SurfaceK | None
    passes: int
    wanted: int
    where: str = ""


def preheat_checks(nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None) -> list[Check]:
    """Check the preheating subprograms of a program; nothing where the settings ask for none and it has none.

    `sections` (L,) are those of the layers; None: what the contours of the program enclose.
    """
    if config.preheat.when == "off":
        if nc.preheating is None:
            return []
        return [count_check("preheat calls", [(_first(nc), "preheats, and preheat.when is 'off'")], "")]
    if config.base_mm > 0.0:
        return []
    known = sections_of_text(nc, config, sections)
    calls = count_check("preheat calls", list(_calls(nc, config)), "each right before its layer")
    state = count_check(
        "preheat state", list(_states(nc, config)), "out of focus, no wire, values as set, focus taken back"
    )
    found = _scans(nc, config, known)
    path = count_check(
        "preheat path", _paths(nc, config, known), "over the region, at its height, at its speed"
    )
    return [calls, state, path, _count(found, config), *_temperatures(nc, found, config)]


def _first(nc: NCProgram) -> str:
    scans = nc.preheating
    return scans.where(0) if scans is not None and len(scans) else f"{nc.files[0].name}:1"


# -- calls and state ---------------------------------------------------------------------------------


def _calls(nc: NCProgram, config: Config) -> Iterator[tuple[str, str]]:
    """Scans that are not called by the main program right before their layer, and the one of the plate that is missing."""
    main = nc.files[0].name
    stem = main.rpartition(".")[0]
    calls = [
        (i, name.removeprefix("call ")) for i, name in enumerate(nc.events.name) if name.startswith("call ")
    ]
    layers = [file.rpartition(".")[0] for file in nc.layer_files]
    for n, (i, name) in enumerate(calls):
        k = layer_of_preheat(stem, name)
        if k is None:
            continue
        after = calls[n + 1][1] if n + 1 < len(calls) else ""
        if not 0 <= k < len(layers) or after != layers[k]:
            yield (
                event_place(nc, i),
                f"{name} is to be called right before layer {k + 1}, and {after or 'nothing'} follows",
            )
        if int(nc.events.file[i]) != 0:
            yield event_place(nc, i), f"{name} is called by another than the main program"
    if layer_of_preheat(stem, calls[0][1] if calls else "") != 0:
        where = event_place(nc, calls[0][0]) if calls else f"{main}:1"
        yield where, "the base plate is not preheated before the first layer (preheat.when)"
    inner = nc.preheating.events.name if nc.preheating is not None else ()
    for i, name in enumerate(inner):
        if name.startswith("call ") and nc.preheating is not None:
            yield event_place(nc.preheating, i), f"{name} within a preheating subprogram"


def _states(nc: NCProgram, config: Config) -> Iterator[tuple[str, str]]:
    """Wire, focus and values of the beam in the scans, and a focus that is not taken back."""
    for i, name in enumerate(nc.events.name):
        if name == FOCUS and nc.events.value[i] != 0.0:
            yield event_place(nc, i), f"focus {nc.events.value[i]:g} is set outside of preheating"
    scans = nc.preheating
    if scans is None:
        return
    rows = np.flatnonzero(scans.wire)
    if rows.size:
        yield scans.where(int(rows[0])), "the wire runs while it preheats"
    rapid = np.flatnonzero(scans.beam & (scans.kind == RAPID))
    if rapid.size:
        yield scans.where(int(rapid[0])), "beam is on during a rapid motion"
    yield from _events(scans, config)


def _events(scans: NCProgram, config: Config) -> Iterator[tuple[str, str]]:
    settings, process, steps = config.preheat, config.process, increments_of(config.machine)
    wanted = {
        "current_ma": settings.current_ma,
        "voltage_kv": process.voltage_kv,
        "power_w": settings.current_ma * process.voltage_kv,
    }
    file, state, beam, off = -1, dict[str, float](), False, set[str]()
    names, events = scans.events.name, scans.events
    for i, name in enumerate([*names, ""]):
        here = int(events.file[i]) if name else -1
        if here != file:
            if file >= 0:
                yield from _ended(scans, i - 1, state, beam)
            file, state, beam, off = here, {}, False, set()
        if not name:
            return
        value, where = float(events.value[i]), event_place(scans, i)
        if name == "beam_on":
            beam = True
            if state.get(FOCUS) != settings.defocus:
                yield (
                    where,
                    f"the beam is switched on in focus {state.get(FOCUS, 0.0):g}, preheat.defocus is {settings.defocus:g}",
                )
            if not {"beam_off", "wire_stop"} <= off:
                yield where, "the beam is switched on before beam and wire were commanded off"
            for key in BEAM_VALUES:
                known = state.get(key)
                slack = VALUE_SHARE * wanted[key] + 0.5 * steps.get(key, 0.0)
                if known is not None and not abs(known - wanted[key]) <= slack:
                    yield (
                        where,
                        f"the beam is switched on at {key} {known:g}, to preheat it is {wanted[key]:g} (preheat.current_ma)",
                    )
            if not set(state) & {"current_ma", "power_w"}:
                yield where, "the beam is switched on before its power is set"
        elif name in ("beam_off", "wire_stop"):
            off.add(name)
            beam = beam and name != "beam_off"
        elif name == "wire_start":
            yield where, "the wire is started while it preheats"
        elif name in WAITS and beam:
            yield where, f"waits {value:g} s with the beam on"
        elif name.startswith("lacks "):
            yield where, f"its template asks for {name.removeprefix('lacks ')!r} before this block"
        else:
            if beam and name in (*BEAM_VALUES, FOCUS):
                yield where, f"{name} {value:g} is set while the beam is on"
            state[name] = value


def _ended(scans: NCProgram, i: int, state: dict[str, float], beam: bool) -> Iterator[tuple[str, str]]:
    where = event_place(scans, i)
    if beam:
        yield where, "ends with the beam on"
    if state.get(FOCUS) != 0.0:
        yield where, "ends with the beam out of focus: beads would be laid with it"


# -- the way -----------------------------------------------------------------------------------------


def _paths(nc: NCProgram, config: Config, sections: list[BaseGeometry]) -> Faults:
    """Ways beside the region, at another height or speed, or beyond the travel."""
    scans = nc.preheating
    if scans is None or not len(scans):
        return []
    faults: Faults = []
    bottoms = _bottoms(nc, config)
    low, high = extremes(scans)
    limits = np.array(config.machine.travel_min_mm), np.array(config.machine.travel_max_mm)
    beyond = np.nan_to_num(np.fmax(limits[0] - low, high - limits[1]), nan=-np.inf).max(axis=1)
    faults += [
        (scans.where(row), f"{value:g} mm beyond the travel")
        for row, value in enumerate(beyond.tolist())
        if value > 1e-9
    ]
    for k in np.unique(scans.layer).tolist():
        rows = np.flatnonzero(scans.layer == k)
        if not 0 <= k < len(sections) or sections[k].is_empty:
            faults.append(
                (scans.where(int(rows[0])), f"preheats before layer {k + 1}, which is none of the program")
            )
            continue
        z_mm = safe_end_mm(float(bottoms[k]), config)
        region = scanned(sections, k, float(bottoms[k]), config).region
        faults += _rows_off(scans, rows, region, z_mm, config)
    return faults


def _rows_off(
    scans: NCProgram, rows: np.ndarray, region: BaseGeometry, z_mm: float, config: Config
) -> Iterator[tuple[str, str]]:
    lit = rows[scans.beam[rows]]
    bent = lit[scans.kind[lit] != STRAIGHT]
    if bent.size:
        yield scans.where(int(bent[0])), "is no straight line"
    idle = rows[~scans.beam[rows] & (scans.kind[rows] != RAPID)]
    if idle.size:
        yield scans.where(int(idle[0])), "a way with the beam off is driven at feed in place of a rapid"
    wrong = rows[~(np.abs(scans.end[rows, 2] - z_mm) <= PLACE_MM)]
    if wrong.size:
        at = float(scans.end[wrong[0], 2])
        yield scans.where(int(wrong[0])), f"at Z {at:g} mm, it preheats at {z_mm:g} mm, over all that stands"
    feed = scans.feed_mm_min[lit] / 60.0
    slow = lit[~(np.abs(feed - config.preheat.speed_mm_s) <= VALUE_SHARE * config.preheat.speed_mm_s)]
    if slow.size:
        value = float(scans.feed_mm_min[slow[0]] / 60.0)
        yield (
            scans.where(int(slow[0])),
            f"beam at {value:g} mm/s, preheat.speed_mm_s is {config.preheat.speed_mm_s:g}",
        )
    ends = np.stack([scans.start[lit, :2], scans.end[lit, :2]], axis=1)
    known: Bools = np.asarray(np.isfinite(ends).all(axis=(1, 2)))
    lines = shapely.linestrings(np.where(known[:, None, None], ends, 0.0))
    near = shapely.buffer(region, PLACE_MM)
    outside = lit[~known | ~shapely.covers(near, lines)]
    if outside.size:
        x, y = scans.end[outside[0], :2].tolist()
        yield (
            scans.where(int(outside[0])),
            f"the beam leaves what is to be preheated on its way to ({x:g}, {y:g})",
        )


def _bottoms(nc: NCProgram, config: Config) -> np.ndarray:
    """Z of what each layer lies on (L,)."""
    tops = np.nan_to_num(nc.layer_heights, nan=config.base_mm)
    return np.concatenate([[config.base_mm], tops])[: len(tops) + 1]


# -- count and heat ----------------------------------------------------------------------------------


def _scans(nc: NCProgram, config: Config, sections: list[BaseGeometry]) -> list[_Found]:
    """Follow the heat of the program, and drive every scan of its text; layers without a scan are told by their beginning."""
    scans, beads = scans_of(nc, config), text_beads(nc, config)
    bottoms, found = _bottoms(nc, config), list[_Found]()

    def seen(k: int, column: HeatColumn | None) -> None:
        if not asked_for(k, config) or k >= len(sections) or sections[k].is_empty:
            return
        on = scanned(sections, k, float(bottoms[k]), config)
        begins_k = config.process.ambient_temperature_k if column is None else column.surface_k
        nothing = BeamWay(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
        way = scans.get(k, nothing)
        driven = scanned_heat(way, sections, k, float(bottoms[k]), column, config)
        if driven is None:
            return
        passes = _passes(way, on, config)
        needed = column is None or is_cold(column, config)
        wanted = passes_asked(on, column, config) if needed else 0
        found.append(_Found(k, on, way, begins_k, driven[0].read(), passes, wanted, _place_of(nc, k)))

    seen(0, None)
    shapes = text_shapes(nc, config, sections)
    text_bed_k(
        beads, config, shapes, None, sections[0] if sections else None, lambda k, c: seen(k, c) if k else None
    )
    return found


def _place_of(nc: NCProgram, k: int) -> str:
    scans = nc.preheating
    if scans is not None and (scans.layer == k).any():
        return scans.where(int(np.flatnonzero(scans.layer == k)[0]))
    rows = np.flatnonzero(nc.layer == k)
    return nc.where(int(rows[0])) if rows.size else f"{nc.files[0].name}:1"


def _passes(way: BeamWay, on: Scanned, config: Config) -> int:
    """Whole passes that the way under the beam comes to; -1 where it is none."""
    length = float(np.hypot(*(way.end - way.start).T)[way.power_w > 0.0].sum())
    done, n = 0.0, 0
    while n <= MOST_PASSES:
        lines, joined = pass_lines(on.region, config, n)
        own = pass_length_mm(lines, joined)
        if abs(length - done) <= LENGTH_SHARE * own:
            return n
        if own <= 0.0 or done > length:
            return -1
        done, n = done + own, n + 1
    return -1


def _count(found: list[_Found], config: Config) -> Check:
    """Passes of each scan: those set, else the fewest that reach the target by the heat model."""
    faults = []
    for scan in found:
        room = 0 if config.preheat.passes is not None or scan.layer == 0 else 1
        if scan.passes < 0:
            faults.append(
                (scan.where, f"before layer {scan.layer + 1} the way of the beam is not that of whole passes")
            )
        elif abs(scan.passes - scan.wanted) > room:
            by = (
                "preheat.passes"
                if config.preheat.passes is not None
                else f"the fewest that come to preheat.target_k + {AIM_K:g} K"
            )
            faults.append(
                (
                    scan.where,
                    f"{scan.passes} passes before layer {scan.layer + 1} in place of {scan.wanted}, {by}",
                )
            )
    total = sum(max(scan.passes, 0) for scan in found)
    return count_check("preheat count", faults, f"{total} passes in {sum(s.passes > 0 for s in found)} scans")


def _temperatures(nc: NCProgram, found: list[_Found], config: Config) -> list[Check]:
    settings, solidus_k = config.preheat, config.material.solidus_k
    read = [(scan, scan.after) for scan in found if scan.after is not None]
    low = min(read, key=lambda pair: pair[1].mean_k, default=None)
    high = max((p for p in read if p[0].passes), key=lambda pair: pair[1].mean_k, default=None)
    uneven = max((p for p in read if p[0].passes), key=lambda pair: pair[1].spread_k, default=None)
    most_w = max((float(p[0].way.power_w.max(initial=0.0)) for p in read), default=0.0)
    checks = []
    if low is not None:
        text = f"layer {low[0].layer + 1} begins on {low[1].mean_k:.0f} K, preheat.target_k is {settings.target_k:g} K"
        ok = low[1].mean_k >= settings.target_k
        checks.append(
            Check(
                "preheat temperature",
                bool(ok),
                low[1].mean_k,
                settings.target_k,
                "K, at least",
                low[0].where,
                text,
            )
        )
    if high is not None and uneven is not None:
        limit = settings.target_k + settings.over_k
        text = f"preheated to {high[1].mean_k:.0f} K at most, preheat.target_k + over_k is {limit:g} K"
        checks.append(
            Check(
                "preheat overheating",
                bool(high[1].mean_k <= limit),
                high[1].mean_k,
                limit,
                "K",
                high[0].where,
                text,
            )
        )
        spread, at = uneven[1].spread_k, uneven[1]
        text = (
            f"{at.least_k:.0f} K at {at.least_at_mm} to {at.most_k:.0f} K at {at.most_at_mm} before layer {uneven[0].layer + 1}, "
            f"preheat.evenness_k is {settings.evenness_k:g} K"
        )
        checks.append(
            Check(
                "preheat evenness",
                bool(spread <= settings.evenness_k),
                spread,
                settings.evenness_k,
                "K",
                uneven[0].where,
                text,
            )
        )
        peak_k = high[1].mean_k + spot_peak_k(most_w, settings.speed_mm_s, config)
        text = f"the surface comes to {peak_k:.0f} K under a beam of {most_w:g} W and {settings.spot_mm:g} mm, solidus is {solidus_k:g} K"
        checks.append(
            Check("preheat melting", bool(peak_k < solidus_k), peak_k, solidus_k, "K", high[0].where, text)
        )
    return checks
