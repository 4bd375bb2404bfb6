"""Checks of preheating: where the beam goes, out of focus and without wire, how often, and how warm the surface is by its text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.heat.balance import HeatColumn
from ebamcheck.numeric.rings import Bools
from ebamcheck.program.checking.checks import Check, count_check, event_place
from ebamcheck.program.checking.machine_state import modes_of_scans
from ebamcheck.program.checking.preheat_heat import (
    Known,
    bottoms_of,
    count_of,
    found_scans,
    temperature_again,
    temperatures_of,
)
from ebamcheck.program.checking.preheat_region import WIDEST, wanted_region, widest_gap_mm
from ebamcheck.program.checking.preheat_way import WAITS
from ebamcheck.program.checking.state_checks import extremes
from ebamcheck.program.checking.text_heat import sections_of_text
from ebamcheck.program.language.codes import BEAM_VALUES, FOCUS
from ebamcheck.program.language.files import layer_of_preheat
from ebamcheck.program.language.increments import increments_of
from ebamcheck.program.language.safe_end import safe_end_mm
from ebamcheck.program.reading.motions import RAPID, STRAIGHT, NCProgram
from ebamcheck.settings.config import Config

VALUE_SHARE = 1e-3
"""Share by which a printed value may be off."""

PLACE_MM = 0.01
"""How far beside the region a line may end: the decimals of the program."""

Faults = list[tuple[str, str]]


def preheat_checks(
    nc: NCProgram,
    config: Config,
    sections: Sequence[BaseGeometry] | None,
    before: HeatColumn | None = None,
    under: BaseGeometry | None = None,
) -> list[Check]:
    """Check the preheating scans of a program; nothing where the settings ask for none and it has none.

    Parameters
    ----------
    sections
        (L,) those of the layers; None: what the contours of the program enclose.
    before, under
        Heat of what stands when the program begins on a part that is half built, and its section; None: not known, and how often it
        is scanned, and how warm it is then, are not judged.
    """
    if config.preheat.when == "off":
        if nc.preheating is None:
            return []
        return [count_check("preheat calls", [(_first(nc), "preheats, and preheat.when is 'off'")], "")]
    known = Known(sections_of_text(nc, config, sections), before, under)
    calls = count_check("preheat calls", list(_calls(nc, config)), "each right before its layer")
    state = count_check(
        "preheat state", list(_states(nc, config)), "out of focus, no wire, values as set, focus taken back"
    )
    path = count_check(
        "preheat path", _paths(nc, config, known), "over the region, at its height, at its speed"
    )
    lines = _lines(nc, config, known)
    if config.base_mm > 0.0 and (before is None or under is None):
        return [calls, state, path, lines]
    found = found_scans(nc, config, known)
    judged = count_of(found, config), *temperatures_of(nc, found, config), *temperature_again(found, config)
    return [calls, state, path, lines, *judged]


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
    if config.preheat.scan_in == "layer":
        yield from _within_layers(nc, config)
    elif layer_of_preheat(stem, calls[0][1] if calls else "") != 0:
        where = event_place(nc, calls[0][0]) if calls else f"{main}:1"
        yield where, "the base plate is not preheated before the first layer (preheat.when)"
    inner = nc.preheating.events.name if nc.preheating is not None else ()
    for i, name in enumerate(inner):
        if name.startswith("call ") and nc.preheating is not None:
            yield event_place(nc.preheating, i), f"{name} within a preheating subprogram"


def _within_layers(nc: NCProgram, config: Config) -> Iterator[tuple[str, str]]:
    """Scans in the subprograms of layers that come after a bead of theirs, that are two, or that are missing on the plate."""
    scans, beads = nc.preheating, np.flatnonzero(nc.deposit)
    lines: dict[int, list[int]] = {}
    for i, name in enumerate(scans.events.name if scans is not None else ()):
        if scans is not None and name == FOCUS and scans.events.value[i] != 0.0:
            file, line = int(scans.events.file[i]), int(scans.events.line[i])
            lines.setdefault(file, []).append(line)
            laid = beads[(nc.file[beads] == file) & (nc.line[beads] < line)]
            if laid.size:
                yield event_place(scans, i), "preheats after beads of its layer"
            if len(lines[file]) == 2:
                yield event_place(scans, i), "preheats twice before one layer"
            if file == 0:
                yield event_place(scans, i), "preheats in the main program"
    first = nc.file[beads[0]] if beads.size else 0
    if config.base_mm == 0.0 and int(first) not in lines:
        yield (
            nc.where(int(beads[0])) if beads.size else f"{nc.files[0].name}:1",
            ("the base plate is not preheated before the first layer (preheat.when)"),
        )


def _states(nc: NCProgram, config: Config) -> Iterator[tuple[str, str]]:
    """Wire, focus and values of the beam in the scans, and a focus that is not taken back."""
    for i, name in enumerate(nc.events.name):
        if name == FOCUS and nc.events.value[i] != 0.0:
            yield event_place(nc, i), f"focus {nc.events.value[i]:g} is set outside of preheating"
    scans = nc.preheating
    if scans is None:
        return
    yield from modes_of_scans(scans, config)
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


def _paths(nc: NCProgram, config: Config, known: Known) -> Faults:
    """Ways beside the region, at another height or speed, or beyond the travel."""
    scans, sections = nc.preheating, known.sections
    if scans is None or not len(scans):
        return []
    faults: Faults = []
    bottoms = bottoms_of(nc, config)
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
        if k == 0 and config.base_mm > 0.0 and known.under is None:
            continue  # What stands there is not known.
        region = wanted_region(sections, k, float(bottoms[k]), config, known.under)
        faults += _rows_off(scans, rows, region, z_mm, config)
    return faults


def _lines(nc: NCProgram, config: Config, known: Known) -> Check:
    """Whether the lines of every scan leave nothing of what is to be preheated out: they lie evenly, about a spacing apart."""
    scans, sections, bottoms = nc.preheating, known.sections, bottoms_of(nc, config)
    worst, where, layer, limit_mm = 0.0, "", 0, WIDEST * config.preheat.spacing_mm + PLACE_MM
    for k in np.unique(scans.layer).tolist() if scans is not None else ():
        unknown = k == 0 and config.base_mm > 0.0 and known.under is None
        if scans is None or unknown or not 0 <= k < len(sections) or sections[k].is_empty:
            continue
        rows = np.flatnonzero((scans.layer == k) & scans.beam)
        start, end = (np.nan_to_num(at[rows, :2]) for at in (scans.start, scans.end))
        region = wanted_region(sections, k, float(bottoms[k]), config, known.under)
        gap_mm = widest_gap_mm(region, start, end, config)
        if gap_mm > worst:
            worst, where, layer = gap_mm, scans.where(int(np.flatnonzero(scans.layer == k)[0])), k
    text = f"lines of the scan before layer {layer + 1} are up to {worst:.4g} mm apart, preheat.spacing_mm is {config.preheat.spacing_mm:g} mm"
    return Check("preheat lines", worst <= limit_mm, worst, limit_mm, "mm", where, text)


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
