"""Checks of the time line of a program: what is switched, set and waited for, in which order, and where the tool is then."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ebamcheck.checks.checks import Check, count_check, event_faults
from ebamcheck.checks.tolerances import PRINTED, TWO_PLACES_MM, VALUE_SHARE
from ebamcheck.nc.codes import BEAM_VALUES, DWELL, SWITCHES
from ebamcheck.nc.increments import increments_of
from ebamcheck.nc.motions import RAPID, NCProgram
from ebamcheck.nc.templates import checked_templates
from ebamcheck.nc.timeline import Kind
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.feed_along import along_window

RELEASED = re.compile(r"_K\d{4,}R\d+$")  # End of the name of a layer that is made between layers
Faults = list[tuple[str, str]]


# -- order -------------------------------------------------------------------------------------------


def order_faults(nc: NCProgram, config: Config) -> Faults:
    """Blocks that come before what they need: values, then the beam, then the wire, and no wait under the beam."""
    e = nc.events
    kind, beam, wire = e.kind, e.beam[:-1], e.wire[:-1]
    on, start, wait, m1 = kind == Kind.BEAM_ON, kind == Kind.WIRE_START, kind == Kind.WAIT, e.named("M1")
    lit, fed = (e.row == e.row_of_latest(switch)[:-1] for switch in (on, start))
    both = np.nan_to_num(e.set_before("voltage_kv")) * np.nan_to_num(e.set_before("current_ma"))
    own = e.set_before("power_w")
    power = np.where(np.isnan(own), both, own)[:-1] > 0.0
    late = (beam & lit & e.named(*BEAM_VALUES)) | (wire & fed & e.named("wire_mm_s"))
    return event_faults(
        nc,
        (on & ~power, "the beam is switched on before its power is set"),
        ((kind == Kind.BEAM_OFF) & beam & lit, "the beam is switched on and off without a motion between"),
        (start & ~beam, "the wire is started before the beam is on"),
        (start & beam & ~(e.set_before("wire_mm_s")[:-1] > 0.0), "the wire is started before its speed is set"),
        (wait & beam, "waits {value:g} s with the beam on"),
        (wait & ~beam & wire, "waits {value:g} s with the wire on"),
        (e.named("wire_retract_mm") & wire, "the wire is drawn back while it runs"),
        (kind == Kind.SKIPPED, "skipped or not, as the operator has chosen at the panel: the program would be two"),
        (kind == Kind.LACKS, "its template asks for {said!r} before this block"),
        (kind == Kind.NOT_ALONG, "{said!r} sets a value at once, and the tool stands for it under the beam: along a bead the profile has another block"),
        (m1 & (beam | wire), "stops with beam or wire on"),
        (m1 & ~(beam | wire) & (not config.machine.optional_stop), "stops for the operator, which the profile does not allow"),
        (late, "{name} {value:g} is set after the switch, and before the first motion"),
    )  # fmt: skip


def switch_faults(nc: NCProgram, on: Kind, off: Kind, what: str) -> Faults:
    """Faults of a switch: on twice, on at a call or at the end of a file, or for good."""
    kind = nc.events.kind
    known = nc.events.since(kind == on, kind == off)
    ends = (kind == Kind.END) | (kind == Kind.CALL)
    faults = event_faults(
        nc,
        ((kind == on) & known[:-1], f"{what} is switched on while it is on"),
        (ends & known[:-1], f"{what} is still on at {{name}}"),
    )
    if known[-1]:
        faults.append((nc.where_event(len(nc.events) - 1), f"{what} is never switched off"))
    return faults


def retract_check(nc: NCProgram, config: Config) -> Check:
    """Every stop of the wire is followed by its retract, before the beam or the wire is switched again, and by no other.

    A wire that is drawn back twice, or where it did not run, begins the next bead without metal.
    """
    wanted, e = config.process.wire_retract_mm, nc.events
    stops, back = (e.kind == Kind.WIRE_STOP) & e.wire[:-1], e.named("wire_retract_mm")
    ends = back | (e.kind == Kind.WIRE_START) | (e.kind == Kind.BEAM_OFF)
    asked = e.since(stops, ends)[:-1]
    # Whether what ends the wait for a retract is one: for each event the next of these.
    answered = np.append(back[ends], False)[np.cumsum(ends)]
    faults = event_faults(
        nc,
        (back & asked & (np.abs(e.value - wanted) > PRINTED), f"wire drawn back by {{value:g}} mm in place of {wanted:g} mm"),
        (back & ~asked & (e.value != 0.0), "wire drawn back by {value:g} mm, which no stop of the running wire asks for"),
        (stops & ~answered, f"the wire stops and is not drawn back by {wanted:g} mm"),
    )  # fmt: skip
    return count_check("wire retract", faults, f"the wire is drawn back by {wanted:g} mm after each bead")


# -- waits -----------------------------------------------------------------------------------------


def wait_height_check(nc: NCProgram, config: Config) -> Check:
    """Check that the tip is clear of all that has been laid, by the clearance of the machine, wherever the program waits.

    Where it stands at work height with beam off, the tip of the wire freezes into the pool that it has just left, and the head
    takes the heat of the part for as long as the wait is. A rest that the profile's own templates hold beside a switch of beam or
    wire is the user's: it may be where they stand.
    """
    e, clear_mm = nc.events, config.machine.clearance_mm
    stands = (e.kind == Kind.WAIT) | (e.kind == Kind.STOP)
    switched = np.isin(e.row, e.row[e.named(*SWITCHES)])
    rests = e.named(DWELL) & switched & np.isin(e.value, list(_rests(config)))
    laid = np.where(nc.deposit, np.fmax(nc.start[:, 2], nc.end[:, 2]), -np.inf)
    top = np.append(-np.inf, np.fmax.accumulate(laid))[e.row]
    z = np.append(np.nan, nc.end[:, 2])[e.row]
    # Where nothing is laid, there is nothing that the tool could stand over.
    low = stands & ~rests & np.isfinite(top) & ~(z >= top + clear_mm - TWO_PLACES_MM)
    faults = event_faults(
        nc,
        (low, lambda i: f"waits or stops at Z {z[i]:g} mm, {z[i] - top[i]:.4g} mm over what is laid, {clear_mm:g} mm is clear of it"),
    )  # fmt: skip
    text = f"{int(stands.sum())} waits and stops, all {clear_mm:g} mm or more over what is laid"
    return count_check("waits over the part", faults, text)


def _rests(config: Config) -> set[float]:
    """Waits in the templates of the profile that switch beam or wire, s."""
    templates = checked_templates(config.machine, config.machine.control)
    actions = (action for name in SWITCHES for _, held in templates.get(name, ()) for action in held)
    return {float(a.number) for a in actions if a.meaning == DWELL and a.number is not None}


# -- a layer by itself -----------------------------------------------------------------------------


def released_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check the files of a layer that is called by itself; nothing for a whole program.

    Its file sets what it needs, comes from above, and leaves nothing on. A main program that waits between layers calls one file after
    the other. What its own main program sets before the call, or does after it, does not happen then: values are those that the layer
    below has left, and the tool stands where that one ended, for as long as it takes until the next layer is released.
    """
    if not RELEASED.search(config.machine.program_name):
        return []
    # The table's ways are none of the part.
    full = nc if nc.machine is None else nc.machine
    called = [file for file in np.unique(full.file[full.beam]).tolist() if file > 0]
    faults = [fault for file in called for fault in (*_left_open(full, file), *_ways(full, file, config))]
    return [
        count_check("layer by itself", faults, "its file sets its values, comes from above, and ends clear of it, all off")
    ]  # fmt: skip


def _left_open(nc: NCProgram, file: int) -> Iterator[tuple[str, str]]:
    """Switches before which the file has not set what holds then, and those that are left on at its end."""
    own = replace(nc, events=nc.events.chosen(nc.events.file == file))
    e = own.events
    text = "{name} before the file has set %s: the layer below has left another"
    missed, rules = np.zeros(len(e), np.bool_), []
    for switch, values in ((Kind.BEAM_ON, BEAM_VALUES), (Kind.WIRE_START, ("wire_mm_s",))):
        for value in values:
            lacks = (e.kind == switch) & (e.latest(e.named(value))[:-1] < 0) & ~missed
            if nc.events.named(value).any():
                rules.append((lacks, text % value))
                missed |= lacks
    yield from event_faults(own, *rules)
    on = [
        (e.latest(e.named(name))[-1], name)
        for name, left in (("beam_on", e.beam), ("wire_start", e.wire))
        if left[-1]
    ]
    for i, name in sorted(on):
        yield own.where_event(int(i)), f"{name} is not taken back within the file"


def _ways(nc: NCProgram, file: int, config: Config) -> Iterator[tuple[str, str]]:
    """A first way that does not rise by itself, and an end within the clearance over the layer."""
    rows = np.flatnonzero(nc.file == file)
    first, last = int(rows[0]), int(rows[-1])
    still = np.array_equal(nc.start[first, :2], nc.end[first, :2], equal_nan=True)
    if nc.kind[first] != RAPID or not still:
        yield (
            nc.where(first),
            "the file does not begin with a rise: the tool stands at a height that it does not know",
        )
    if nc.table is not None:
        return  # Heights are those of the axes: the checks of the table have them.
    clear_mm = config.machine.clearance_mm - TWO_PLACES_MM
    if not nc.end[first, 2] >= config.base_mm + clear_mm:
        yield (
            nc.where(first),
            f"begins at Z {nc.end[first, 2]:g} mm, on a layer that ends at {config.base_mm:g} mm",
        )
    top = float(np.fmax(nc.start[rows, 2], nc.end[rows, 2])[nc.deposit[rows]].max(initial=-np.inf))
    if not nc.end[last, 2] >= top + clear_mm:
        yield (
            nc.where(last),
            f"ends at Z {nc.end[last, 2]:g} mm, where the tool waits for the next layer: the beads end at {top:g} mm",
        )


# -- values ----------------------------------------------------------------------------------------


def value_check(nc: NCProgram, config: Config) -> Check:
    """Every value that is set, and the feed of every motion that lays metal, against the settings of the process.

    Voltage, feed and length of wire drawn back are those of the settings, or 0 where beam or wire are off; current and power are at most
    those of the settings, since ramps and the heat of the part take from them; the wire is within the feeder's limits. A product hides an
    exchange of its factors (120 kV and 60 mA are the power of 60 kV and 120 mA), and wide limits hide a program that is half as fast
    throughout: each value is held against the one of the settings.
    """
    faults = [*_set_values(nc, config), *_feeds(nc, config)]
    faults.sort(key=lambda fault: fault[0])
    process = config.process
    good = (
        f"{process.voltage_kv:g} kV, up to {process.current_ma:g} mA, at {process.travel_speed_mm_s:g} mm/s"
    )
    return count_check("process values", [(where, what) for _, where, what in faults], good)


def _set_values(nc: NCProgram, config: Config) -> Iterator[tuple[int, str, str]]:
    process = config.process
    fixed = {
        "voltage_kv": (process.voltage_kv, "kV"),
        "wire_retract_mm": (process.wire_retract_mm, "mm of wire drawn back"),
    }
    greatest = {
        "current_ma": (process.current_ma, "mA"),
        "power_w": (process.power_w, "W"),
        "wire_mm_s": (process.wire_speed_max_mm_s, "mm/s of wire"),
    }
    steps, events = increments_of(config.machine), nc.events
    for i in np.flatnonzero(events.kind == Kind.VALUE).tolist():
        name, value, row = events.name[i], float(events.value[i]), int(events.row[i])
        half = 0.5 * steps.get(name, 0.0)
        if name in fixed:
            wanted, unit = fixed[name]
            if value != 0.0 and not abs(value - wanted) <= VALUE_SHARE * wanted + half:
                yield row, nc.where_event(i), f"{value:g} {unit} in place of {wanted:g} {unit}"
        elif name in greatest:
            limit, unit = greatest[name]
            if not 0.0 <= value <= limit * (1.0 + VALUE_SHARE) + half:
                yield row, nc.where_event(i), f"{value:g} {unit}, at most {limit:g} {unit} are set"


def _feeds(nc: NCProgram, config: Config) -> Iterator[tuple[int, str, str]]:
    wanted = config.process.travel_speed_mm_s
    half = 0.5 * increments_of(config.machine).get("feed_mm_min", 0.0) / 60.0
    rows = np.flatnonzero(nc.deposit)
    feed, wire = nc.feed_mm_min[rows] / 60.0, nc.wire_mm_s[rows]
    process, (slow, fast) = config.process, along_window(config)
    for row, value, fed in zip(rows.tolist(), feed.tolist(), wire.tolist(), strict=True):
        room = VALUE_SHARE * wanted + half
        if abs(value - wanted) <= room:
            continue
        where = nc.where(row)
        if not process.feed_along_path:
            yield row, where, f"feed {value:g} mm/s in place of {wanted:g} mm/s"
            continue
        slower = value < wanted
        limit = process.wire_speed_max_mm_s if slower else process.wire_speed_min_mm_s
        # The feed goes on where the wire ends, and nowhere else.
        if not abs(fed - limit) <= VALUE_SHARE * limit:
            what = f"feed {value:g} mm/s in place of {wanted:g} mm/s, where the wire has {fed:g} mm/s and not its limit of {limit:g} mm/s"
            yield row, where, what
        elif not slow * wanted - room <= value <= fast * wanted + room:
            yield (
                row,
                where,
                f"feed {value:g} mm/s, from {slow * wanted:g} to {fast * wanted:g} mm/s are in the process window",
            )


def increment_check(nc: NCProgram, config: Config) -> Check:
    """Check values that are set, and feeds along beads, against the increments of the machine profile.

    A control rounds what lies between, or refuses the block: then it drives other values than those that were proved.
    """
    steps, events, faults = increments_of(config.machine), nc.events, []
    for name, step in steps.items():
        if name == "feed_mm_min":
            continue
        at = np.flatnonzero(events.named(name))
        for i in at[_between(events.value[at], step)].tolist():
            said = f"{name} {float(events.value[i]):g} is no multiple of {step:g}"
            faults.append((int(events.row[i]), nc.where_event(i), said))
    if "feed_mm_min" in steps:
        rows = np.flatnonzero(nc.deposit)
        step = steps["feed_mm_min"]
        for row in rows[_between(nc.feed_mm_min[rows], step)].tolist():
            said = f"feed {nc.feed_mm_min[row]:g} mm/min is no multiple of {step:g}"
            faults.append((row, nc.where(row), said))
    faults.sort(key=lambda fault: fault[0])
    known = ", ".join(f"{name} {step:g}" for name, step in steps.items())
    good = f"values are multiples of {known}" if known else "the profile names none (machine.*_increment_*)"
    return count_check("increments", [(where, what) for _, where, what in faults], good)


def _between(values: Floats, step: float) -> Bools:
    """Which values (n,) lie between two multiples of a step, or are not known."""
    off = np.abs(values - np.round(values / step) * step)
    return np.asarray(~(off <= PRINTED), np.bool_)
