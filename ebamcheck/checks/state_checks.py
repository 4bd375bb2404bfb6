"""Checks of what the machine does: modes, feeds, travel, what is switched, set and waited for, in which order, and where the tool
is then."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ebamcheck.checks.checks import (
    LIMIT_ROUNDING_MM,
    PLACE_MM,
    PRINTED,
    TWO_PLACES_MM,
    VALUE_SHARE,
    Faults,
    count_check,
    event_faults,
    limit_check,
    row_faults,
    worst_check,
)
from ebamcheck.kernels import Bools, Floats
from ebamcheck.nc.codes import BEAM_VALUES, DWELL, SWITCHES, templates_of
from ebamcheck.nc.control import Group, control
from ebamcheck.nc.conventions import safe_end_mm
from ebamcheck.nc.motions import ARC, RAPID, NCProgram
from ebamcheck.nc.templates import checked_templates
from ebamcheck.nc.timeline import Kind
from ebamcheck.nc.words import group_of, wanted_words
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import TURN_SPACINGS

LEAST_SPLINE_BLOCKS = 6  # Wanted among any 10 (NC Programming manual, BSPLINE)
FLOW = "program flow"  # Group whose words have checks of their own: ends of programs, stops
TRANSFORMATION_OFF = "TRAFOOF"  # Word of a SINUMERIK
RELEASED = re.compile(r"_K\d{4,}R\d+$")  # End of the name of a layer that is made between layers


def state_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check the state of the machine in every motion."""
    # Of a program whose table turns, what its axes do, and not what that is on the part.
    driven = nc if nc.machine is None else nc.machine
    over = beyond_travel_mm(driven, config)
    worst = over.max(axis=1)
    found = worst_check("travel", driven, np.arange(len(driven)), worst, LIMIT_ROUNDING_MM, "mm", "")
    axis = "XYZ"[int(np.argmax(over[int(np.argmax(worst))]))] if len(driven) else ""
    margin = -found.value if found.passed else found.value
    text = f"{margin:g} mm of {axis} {'left' if found.passed else 'beyond the limits'}, on the true curve"
    travel = replace(found, limit=0.0, text=text)
    return [*machine_state_checks(driven, config), *_motions(nc, config), travel, *_switches(nc, config)]


def _motions(nc: NCProgram, config: Config) -> Iterator[Check]:
    """Feeds, known positions, and blocks of splines and polynomials."""
    low, high = config.machine.feed_min_mm_s, config.machine.feed_max_mm_s
    rows = np.flatnonzero(nc.kind != RAPID)
    feed = nc.feed_mm_min[rows] / 60.0
    bad = ~((feed >= low) & (feed <= high))
    faults = row_faults(nc, rows[bad], f"feed {{:g}} mm/s is not within {low:g} .. {high:g} mm/s", feed[bad])
    # A way at the feed of the beads is a bead that was not switched on, or lets the part cool longer than planned.
    idle = (nc.kind != RAPID) & ~nc.beam & ~nc.wire
    faults += row_faults(nc, idle, "a way with beam and wire off is driven at feed in place of a rapid")
    yield count_check("feed", faults, f"every feed within {low:g} .. {high:g} mm/s, travel by rapids")
    unknown = (nc.kind != RAPID) & ~(np.isfinite(nc.start).all(axis=1) & np.isfinite(nc.end).all(axis=1))
    faults = row_faults(nc, unknown, "feed motion from a position that is not known")
    yield count_check("start of path", faults, "every feed motion starts where the one before ended")
    short = nc.events.named("BSPLINE") & (nc.events.value < LEAST_SPLINE_BLOCKS)
    what = f"a BSPLINE of {{value:g}} blocks: at least {LEAST_SPLINE_BLOCKS} are needed"
    good = f"every BSPLINE has at least {LEAST_SPLINE_BLOCKS} blocks"
    yield count_check("spline blocks", event_faults(nc, (short, what)), good)
    # Of POLY blocks a wrong parameter length bends its span a little; the reader notes those that are not 1.
    said = nc.header.get("POLY", "").startswith("PL=1 ")
    what = "PL={value:g} in a POLY block, where the header says PL=1 in every one"
    faults = event_faults(nc, (nc.events.named("POLY") & said, what))
    good = "PL=1 in every POLY block" if said else "the header says nothing of PL in POLY blocks"
    yield count_check("polynomial blocks", faults, good)


def extremes(nc: NCProgram) -> tuple[Floats, Floats]:
    """Least and greatest X, Y, Z (B, 3) on each motion, exactly: roots of the derivative, quadrants of arcs."""
    low, high = np.fmin(nc.start, nc.end), np.fmax(nc.start, nc.end)
    with np.errstate(divide="ignore", invalid="ignore"):
        c0, c1, c2, c3 = (nc.coefficients[:, :, k] for k in range(4))
        root = np.sqrt(np.maximum(c2**2 - 3.0 * c3 * c1, 0.0))
        q = -(c2 + np.copysign(root, c2))
        for t in (q / (3.0 * c3), c1 / q):
            inside = (t > 0.0) & (t < 1.0)
            t = np.where(inside, t, 0.0)
            value = np.where(inside, ((c3 * t + c2) * t + c1) * t + c0, nc.end[:, :2])
            low[:, :2], high[:, :2] = np.fmin(low[:, :2], value), np.fmax(high[:, :2], value)
    for row in np.flatnonzero(nc.kind == ARC):
        cx, cy, sweep = nc.arc[row]
        dx, dy = nc.start[row, 0] - cx, nc.start[row, 1] - cy
        radius, first = math.hypot(dx, dy), math.atan2(dy, dx)
        for quadrant in (0.5 * math.pi * k for k in range(4)):
            if (math.copysign(1.0, sweep) * (quadrant - first)) % (2.0 * math.pi) <= abs(sweep):
                point = (cx + radius * math.cos(quadrant), cy + radius * math.sin(quadrant))
                low[row, :2], high[row, :2] = np.fmin(low[row, :2], point), np.fmax(high[row, :2], point)
    return low, high


def far_away(nc: NCProgram, config: Config) -> Check | None:
    """Check ``travel`` of a program that goes farther beyond its limits than the machine is long; None for any other. A number that
    lost its point leads kilometres away: nothing else can be said of it, and what follows its path would take hours."""
    longest = float(np.subtract(config.machine.travel_max_mm, config.machine.travel_min_mm).max())
    for each in (nc if nc.machine is None else nc.machine, nc.preheating):
        if each is not None and len(each):
            worst = beyond_travel_mm(each, config).max(axis=1)
            row = int(np.argmax(worst))
            if worst[row] > longest:
                text = f"{worst[row]:g} mm beyond the limits: that is over the machine's travel of {longest:g} mm, and nothing else is judged"
                return limit_check("travel", worst[row], 0.0, "mm", text, each.where(row))
    return None


def beyond_travel_mm(nc: NCProgram, config: Config) -> Floats:
    """How far each motion goes beyond the limits of each axis (B, 3), mm; negative within them."""
    low, high = extremes(nc)
    least, most = np.array(config.machine.travel_min_mm), np.array(config.machine.travel_max_mm)
    over = np.fmax(least - low, high - most)
    return np.asarray(np.nan_to_num(over, nan=-np.inf, posinf=np.inf), np.float64)


def _switches(nc: NCProgram, config: Config) -> Iterator[Check]:
    """Beam and wire along every motion, and turns under the beam."""
    e, rapid = nc.events, nc.kind == RAPID
    marked = ~rapid & ((nc.ring >= 0) | (nc.island >= 0))
    faults = row_faults(nc, nc.beam & rapid, "beam is on during a rapid motion")
    faults += row_faults(nc, ~nc.beam & marked, "beam is off along a deposit")
    faults += _switched(nc, Kind.BEAM_ON, Kind.BEAM_OFF, "beam")
    yield count_check("beam", faults, "off in every rapid and layer change, each on has its off")
    faults = row_faults(nc, nc.wire & ~nc.beam, "wire runs while the beam is off")
    faults += row_faults(nc, nc.wire & rapid, "wire runs during a rapid motion")
    faults += row_faults(nc, ~nc.wire & marked, "wire stands along a deposit")
    faults += _switched(nc, Kind.WIRE_START, Kind.WIRE_STOP, "wire")
    late = (e.kind == Kind.BEAM_OFF) & e.wire[:-1]
    faults += event_faults(nc, (late, "beam goes off before the wire stops"))
    yield count_check("wire", faults, "runs under the beam alone, stops before it")
    rows = np.flatnonzero(nc.turn & nc.deposit)
    # Positions are rounded to the program's decimals; six is the coarsest that matters here.
    most_mm = TURN_SPACINGS * config.process.hatch_spacing_mm + 1e-6
    yield worst_check("turns", nc, rows, nc.lengths[rows], most_mm, "mm", "longest turn between hatch lines")


def _switched(nc: NCProgram, on: Kind, off: Kind, what: str) -> Faults:
    """Faults of a switch: on twice, on at a call or at the end of a file, or for good."""
    kind = nc.events.kind
    known = nc.events.since(kind == on, kind == off)
    ends = (kind == Kind.END) | (kind == Kind.CALL)
    twice = (kind == on) & known[:-1], f"{what} is switched on while it is on"
    faults = event_faults(nc, twice, (ends & known[:-1], f"{what} is still on at {{name}}"))
    if known[-1]:
        faults.append((nc.where_event(len(nc.events) - 1), f"{what} is never switched off"))
    return faults


def machine_state_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check modes and smoothing at every motion, start state, order of events, and safe end."""
    wanted = list(wanted_words(nc.dialect, config.machine).values())
    modes, paths = _broken_groups(nc, config)
    modes += _offset_lost(nc, config) + _uneven_entries(nc, wanted)
    words = [word for word in wanted if not _is_path(nc, word)]
    # The first blocks have a start state that depends on nothing before it.
    set_beam = " ".join(templates_of(config.machine, nc.dialect)["set_beam"])
    needs = {"beam_off": "the beam is not switched off", "wire_stop": "the wire is not stopped"}
    needs |= {name: f"{name} is not set" for name in BEAM_VALUES if f"{{{name}" in set_beam}
    for name in nc.events.chosen(nc.events.row == 0).name:
        needs.pop(name, None)
    lacking = [(nc.beginning, f"{what} before the first motion") for what in needs.values()]
    return [
        count_check("modes", modes, f"{' '.join(words)} at every motion"),
        _smoothing(nc, config, wanted, paths),
        count_check("start state", lacking, "modes, beam and wire off, values, before the first motion"),
        count_check("order of events", _order(nc, config), "values, then beam, then wire; off in turn"),
        count_check("safe end", _end(nc, config), "beam and wire off, values 0, retracted and parked"),
    ]  # fmt: skip


def _broken_groups(nc: NCProgram, config: Config) -> tuple[Faults, Faults]:
    """Words that set a group to another than the one wanted, or change one that was set; those of the path apart."""
    # The main program sets every group itself, before its first motion or call.
    wanted = wanted_words(nc.dialect, config.machine)
    faults: dict[bool, Faults] = {False: [], True: []}
    state: dict[str, str] = {}
    places: dict[str, str] = {}
    begun = False
    for i, name in enumerate([*nc.events.name, ""]):
        moved = not name or nc.events.row[i] > 0 or nc.events.kind[i] == Kind.CALL
        if moved and not begun:
            begun, where = True, next(iter(places.values()), nc.beginning)
            # What is not set by then is missing where the group before it is set.
            for other, word in wanted.items():
                where = places.get(other, where)
                if other not in places:
                    unset = group_of(nc.dialect, word) or Group(other, (word,))
                    faults[unset.path].append((where, f"{word} is not set by the program's own first blocks"))
        group = group_of(nc.dialect, name)
        if group is None or group.name == FLOW:
            continue
        held = wanted.get(group.name) or (state.get(group.name) if begun else None)
        if held is not None and name != held:
            what = f"{name}: {group.name} is to be {held} at every motion"
            faults[group.path].append((nc.where_event(i), what))
        state[group.name] = name
        places.setdefault(group.name, nc.where_event(i))
    return faults[False], faults[True]


def _offset_lost(nc: NCProgram, config: Config) -> Faults:
    """Motions whose work offset went with a transformation that was switched off, and was not chosen again behind it."""
    # Source: Siemens, Job Planning, constraints when selecting a transformation: the control deselects the frame in force.
    e, offset = nc.events, wanted_words(nc.dialect, config.machine).get("work offset")
    off = e.named(TRANSFORMATION_OFF)
    chosen = np.append(0, np.cumsum(off | e.named(offset or "")))
    moved = np.searchsorted(e.row, e.row, side="right")
    lost = off & (e.row < len(nc)) & (chosen[moved] == chosen[1:])
    return event_faults(nc, (lost, f"TRAFOOF takes {offset} back, which no block behind it chooses again"))


def modes_of_scans(scans: NCProgram, config: Config) -> Faults:
    """Words in preheating scans other than those that hold at every motion of the program, and stops; a scan may leave words
    out."""
    e, wanted = scans.events, wanted_words(scans.dialect, config.machine)
    said = {}
    for name in set(e.name):
        group = group_of(scans.dialect, name)
        if group is not None and group.name != FLOW and wanted.get(group.name) != name:
            held = wanted.get(group.name, "as the control has it")
            said[name] = f"{name}: {group.name} is to be {held} at every motion"
    stops, (other, what) = e.kind == Kind.STOP, _other_tolerance(scans, config)
    words = e.named(*said) & ~stops & ~other, lambda i: said[e.name[i]]
    rules = (stops, "{name} stops while it preheats"), (other, what), words
    return _offset_lost(scans, config) + event_faults(scans, *rules)


def _other_tolerance(nc: NCProgram, config: Config) -> tuple[Bools, str]:
    """Tolerances that are another than the one set, and what to say of them."""
    limit, e = config.machine.smoothing_tolerance_mm, nc.events
    other = ~(np.abs(e.value - limit) <= VALUE_SHARE * limit)
    return (e.kind == Kind.TOLERANCE) & other, f"{{name}} {{value:g}} mm in place of {limit:g} mm"


def _smoothing(nc: NCProgram, config: Config, wanted: list[str], faults: Faults) -> Check:
    """How the control may leave the path: its words at every motion, and every tolerance within the one set."""
    e, limit, smoothing = nc.events, config.machine.smoothing_tolerance_mm, config.machine.smoothing
    of = control(nc.dialect)
    if not of.tolerance_word:
        # What tolerance words of the path leave is not known where the profile knows none.
        own = {name for name in set(e.name) if _is_path(nc, name) and name not in wanted}
        what = "{name}: the profile of this control sets no smoothing, and knows none of its tolerances"
        faults = faults + event_faults(nc, (e.named("CTOL", *own), what))
        return count_check("smoothing", faults, "no word for a tolerance: the control's own")
    tolerances, (other, what) = e.kind == Kind.TOLERANCE, _other_tolerance(nc, config)
    alone = (
        e.named("ADIS") & ~other & ("G641" not in smoothing),
        "ADIS belongs to G641, which the profile does not set",
    )
    faults = faults + event_faults(nc, (other, what), alone)
    if not (e.row[tolerances][:1] == 0).any():
        faults.append((nc.beginning, "no tolerance of the path is set before the first motion"))
    if of.keeps_tolerance and not set(of.keeps_tolerance) & set(smoothing):
        said, keeps = " ".join(smoothing) or "nothing", ", ".join(of.keeps_tolerance)
        what = f"machine.smoothing is {said}, without {keeps}: no other word keeps the path within the tolerance"
        faults.append((nc.beginning, what))
    # A tolerance of its own stands in the same block.
    block = np.cumsum(np.append(True, (np.diff(e.file) != 0) | (np.diff(e.line) != 0)))[: len(e)]
    bare = e.named(of.smoothing_needs_tolerance) & ~np.isin(block, block[e.named("CTOL")])
    what = f"{{name}} without {of.tolerance_word}: the path may leave its corners by any distance"
    faults += event_faults(nc, (bare, what))
    value = max(e.value[tolerances].tolist(), default=math.inf)
    words = " ".join(word for word in wanted if _is_path(nc, word))
    found = count_check("smoothing", faults, f"{words}{of.tolerance_word}{value:g} at every motion")
    return replace(found, value=value, limit=limit, unit="mm")


def _is_path(nc: NCProgram, word: str) -> bool:
    group = group_of(nc.dialect, word)
    return group is not None and group.path


def _uneven_entries(nc: NCProgram, wanted: list[str]) -> Faults:
    """Layers that lack a mode or value with which others begin: the control could not enter the program there."""
    # A row of blocks that set modes, where the program and its layers begin, ends with the next motion, and where a mode follows a switch
    # or a value: in one file the first blocks of the program are followed by those of its first layer.
    e, faults = nc.events, Faults()
    mode, value = e.named(*wanted), e.named(*BEAM_VALUES)
    before, switched = e.latest(mode)[:-1], e.latest(value | e.named(*SWITCHES))[:-1]
    here = (before >= 0) & (e.file == e.file[before]) & (e.row == e.row[before])
    begins = mode & ~(here & (switched < before))
    called, last = bool((e.kind == Kind.CALL).any()), len(nc) - 1
    runs: list[tuple[int, dict[str, str]]] = []  # Layer (or file), and place of each name
    fullest: Counter[int] = Counter()
    for i in np.flatnonzero(mode | (value & here)).tolist():
        if begins[i]:
            of_layer = int(nc.layer[min(e.row[i], last)]) if runs and last >= 0 else -1
            runs.append((int(e.file[i]) if called else of_layer, {}))
        layer, names = runs[-1]
        names.setdefault(e.name[i], nc.where_event(i))
        fullest[layer] = max(fullest[layer], len(names))
    # Single words that are said again later on, fewer than half of the fullest row of their layer, are none.
    rows = [names for layer, names in runs if 2 * len(names) >= fullest[layer]]
    found = Counter(name for names in rows for name in names)
    usual = [name for name in (*wanted, *BEAM_VALUES) if 2 * found[name] > len(rows)]
    for names in rows:
        where = next(iter(names.values()))
        for name in usual:
            if name not in names:
                faults.append((where, f"{name} is not set where the layer begins, as it is in the others"))
            where = names.get(name, where)
    return faults


def _end(nc: NCProgram, config: Config) -> Faults:
    """What the last blocks lack: beam and wire off, values 0, the tool retracted and parked."""
    if not nc.deposit.any():
        return []
    where = f"{nc.files[0].name}:{nc.files[0].end_line or nc.files[0].line_count}"
    late = nc.events.chosen(nc.events.row > int(np.flatnonzero(nc.deposit)[-1]))
    after = dict(zip(late.name, late.value.tolist(), strict=True))
    templates = templates_of(config.machine, nc.dialect)
    settable = " ".join(line for name in ("set_beam", "set_power", "set_wire") for line in templates[name])
    known = {name for name in nc.events.name if f"{{{name}" in settable}
    off = [name for name in ("wire_stop", "beam_off") if name not in after]
    faults = [(where, f"{name} does not come after the last bead") for name in off]
    values = [name for name in (*BEAM_VALUES, "wire_mm_s") if name in known and after.get(name) != 0.0]
    faults += [(where, f"{name} is not 0 at the end") for name in values]
    x, y, z = nc.end[-1]
    least = safe_end_mm(float(np.nanmax(nc.end[nc.deposit, 2])), config)
    if not z >= least - PLACE_MM:
        faults.append((nc.where(len(nc) - 1), f"ends at Z {z:g} mm, {least:g} mm is over all that stands"))
    if not math.dist((x, y), config.machine.park_position_mm) <= 2.0 * PLACE_MM:
        place = "X {:g} Y {:g}".format(*config.machine.park_position_mm)
        faults.append((nc.where(len(nc) - 1), f"ends at X {x:g} Y {y:g}, to be parked at {place}"))
    return faults


def _order(nc: NCProgram, config: Config) -> Faults:
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


def retract_check(nc: NCProgram, config: Config) -> Check:
    """Every stop of the wire is followed by its retract, before the beam or the wire is switched again, and by no other."""
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


def wait_height_check(nc: NCProgram, config: Config) -> Check:
    """Check that the tip is clear of all that has been laid, by the clearance of the machine, wherever the program waits.
    At work height the tip of the wire freezes into the pool, and the head takes the heat of the part. A rest that the profile's own
    templates hold beside a switch of beam or wire may be where they stand."""
    e, clear_mm = nc.events, config.machine.clearance_mm
    templates = checked_templates(config.machine, config.machine.control)
    actions = (action for name in SWITCHES for _, held in templates.get(name, ()) for action in held)
    of_profile = {float(a.number) for a in actions if a.meaning == DWELL and a.number is not None}
    stands = (e.kind == Kind.WAIT) | (e.kind == Kind.STOP)
    switched = np.isin(e.row, e.row[e.named(*SWITCHES)])
    rests = e.named(DWELL) & switched & np.isin(e.value, list(of_profile))
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


def released_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check the files of a layer that is called by itself: each sets what it needs, comes from above, leaves nothing on; none of a
    whole program. What its own main program sets before the call, or does after it, does not happen then: values, and the place of
    the tool, are those that the layer below has left."""
    if not RELEASED.search(config.machine.program_name):
        return []
    # The table's ways are none of the part.
    full = nc if nc.machine is None else nc.machine
    called = [file for file in np.unique(full.file[full.beam]).tolist() if file > 0]
    faults = [fault for file in called for fault in (*_left_open(full, file), *_ways(full, file, config))]
    good = "its file sets its values, comes from above, and ends clear of it, all off"
    return [count_check("layer by itself", faults, good)]


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
    left = (("beam_on", e.beam), ("wire_start", e.wire))
    for i, name in sorted((e.latest(e.named(name))[-1], name) for name, on in left if on[-1]):
        yield own.where_event(int(i)), f"{name} is not taken back within the file"


def _ways(nc: NCProgram, file: int, config: Config) -> Iterator[tuple[str, str]]:
    """A first way that does not rise by itself, and an end within the clearance over the layer."""
    rows = np.flatnonzero(nc.file == file)
    first, last = int(rows[0]), int(rows[-1])
    still = np.array_equal(nc.start[first, :2], nc.end[first, :2], equal_nan=True)
    if nc.kind[first] != RAPID or not still:
        what = "the file does not begin with a rise: the tool stands at a height that it does not know"
        yield nc.where(first), what
    if nc.table is not None:
        return  # Heights are those of the axes: the checks of the table have them.
    clear_mm = config.machine.clearance_mm - TWO_PLACES_MM
    if not nc.end[first, 2] >= config.base_mm + clear_mm:
        what = f"begins at Z {nc.end[first, 2]:g} mm, on a layer that ends at {config.base_mm:g} mm"
        yield nc.where(first), what
    top = float(np.fmax(nc.start[rows, 2], nc.end[rows, 2])[nc.deposit[rows]].max(initial=-np.inf))
    if not nc.end[last, 2] >= top + clear_mm:
        what = f"ends at Z {nc.end[last, 2]:g} mm, where the tool waits for the next layer: the beads end at {top:g} mm"
        yield nc.where(last), what
