"""Checks of preheating: where the beam goes, out of focus and without wire, how often, and how warm the surface is by its text."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import Check, count_check, event_faults, row_faults
from ebamcheck.checks.preheat_heat import (
    Known,
    bottoms_of,
    count_of,
    found_scans,
    temperature_again,
    temperatures_of,
)
from ebamcheck.checks.state_checks import extremes, modes_of_scans
from ebamcheck.checks.text_heat import sections_of_text
from ebamcheck.geometry.regions import eroded
from ebamcheck.heat.balance import HeatColumn
from ebamcheck.nc.codes import BEAM_VALUES, FOCUS
from ebamcheck.nc.conventions import safe_end_mm
from ebamcheck.nc.files import layer_of_preheat
from ebamcheck.nc.increments import increments_of
from ebamcheck.nc.motions import RAPID, STRAIGHT, NCProgram
from ebamcheck.nc.timeline import Kind
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.settings.config import Config

VALUE_SHARE = 1e-3
"""Share by which a printed value may be off."""

PLACE_MM = 0.01
"""How far beside the region a line may end: the decimals of the program."""

ROUND_SHARE = 2e-3
"""Share of the spot by which a rounding of chords may lie beside its circle."""

WIDEST = 1.5
"""Lines lie evenly between the ends of the region: at most so many spacings apart, where one more would lie nearer than one."""

SLIVER_MM = 0.1
"""Lines across a narrower place may be left out."""

ALONG_MM = 1e-3
"""A line along an axis leaves it by no more: the decimals of a program, at their coarsest."""


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
        where = nc.preheating.beginning if len(nc.preheating) else f"{nc.files[0].name}:1"
        return [count_check("preheat calls", [(where, "preheats, and preheat.when is 'off'")], "")]
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


# -- calls and state ---------------------------------------------------------------------------------


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
        late[out] = [
            ((nc.file[beads] == f) & (nc.line[beads] < k)).any() for f, k in zip(file, line, strict=True)
        ]
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
    """Events that set the beam out of focus."""
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
    yield from event_faults(
        scans,
        (
            on & (focus[:-1] != settings.defocus),
            lambda i: (
                f"the beam is switched on in focus {np.nan_to_num(focus[i]):g}, preheat.defocus is {settings.defocus:g}"
            ),
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
    z, feed = scans.end[:, 2], scans.feed_mm_min / 60.0
    speed = config.preheat.speed_mm_s
    for wrong, what in (
        (lit[scans.kind[lit] != STRAIGHT], "is no straight line"),
        (rows[~scans.beam[rows] & (scans.kind[rows] != RAPID)], "a way with the beam off is driven at feed in place of a rapid"),
        (rows[~(np.abs(z[rows] - z_mm) <= PLACE_MM)], "at Z {z:g} mm, it preheats at {wanted:g} mm, over all that stands"),
        (lit[~(np.abs(feed[lit] - speed) <= VALUE_SHARE * speed)], "beam at {feed:g} mm/s, preheat.speed_mm_s is {speed:g}"),
    ):  # fmt: skip
        for row in wrong[:1].tolist():
            yield scans.where(row), what.format(z=z[row], wanted=z_mm, feed=feed[row], speed=speed)
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


# -- region ----------------------------------------------------------------------------------------


def wanted_region(
    sections: list[BaseGeometry], k: int, z_mm: float, config: Config, under: BaseGeometry | None
) -> BaseGeometry:
    """Region that the beam's middle may go over before layer `k`, whose bottom lies at `z_mm`, by code of its own.

    Plan and writer take region and lines from one place: a mistake there would be in the program and in what it is held against.

    On the plate: as far as `preheat.margin_mm` around the box of the lowest section, half a spot within the plate. On what stands, `under`
    or the layer below: half a spot within its section. Nowhere nearer to a clamp that is higher than half a spot.
    """
    half_mm = (0.5 - ROUND_SHARE) * config.preheat.spot_mm
    below = under if k == 0 else sections[k - 1]
    region: BaseGeometry
    if below is not None:
        region = eroded(below, half_mm)
    else:
        (x0, y0), (x1, y1) = np.reshape(shapely.bounds(sections[0]), (2, 2)).tolist()
        margin_mm = config.preheat.margin_mm
        region = shapely.box(x0 - margin_mm, y0 - margin_mm, x1 + margin_mm, y1 + margin_mm)
        low, high = config.machine.base_plate_min_mm, config.machine.base_plate_max_mm
        if low is not None and high is not None:
            spot_mm = 0.5 * config.preheat.spot_mm
            plate = shapely.box(low[0] + spot_mm, low[1] + spot_mm, high[0] - spot_mm, high[1] - spot_mm)
            region = shapely.intersection(region, plate)
    floor_mm = 0.0 if below is None else z_mm
    for place in config.process.keep_out:
        if place.z_mm[1] > floor_mm:
            clamp = shapely.buffer(shapely.Polygon(place.outline_mm), half_mm)
            region = shapely.difference(region, clamp)
    return region


def widest_gap_mm(region: BaseGeometry, start: Floats, end: Floats, config: Config) -> float:
    """Greatest distance between two lines of the beam, (n, 2) each, that run across the region side by side, and from its ends to the next.

    A line counts where all of it within the region is driven. Lines along X are asked for, and along Y where there are any.
    """
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
