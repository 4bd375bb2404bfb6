"""Checks of what the machine does: modes, feeds, travel, beam and wire, and power."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ebamcheck.checks.checks import Check, count_check, event_faults, row_faults, worst_check
from ebamcheck.checks.event_checks import order_faults, switch_faults
from ebamcheck.checks.tolerances import LIMIT_ROUNDING_MM, PLACE_MM, VALUE_SHARE
from ebamcheck.nc.codes import BEAM_VALUES, SWITCHES, templates_of
from ebamcheck.nc.control import Group, control
from ebamcheck.nc.conventions import safe_end_mm
from ebamcheck.nc.motions import ARC, RAPID, NCProgram
from ebamcheck.nc.timeline import Kind
from ebamcheck.nc.words import group_of, wanted_words
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import TURN_SPACINGS

LEAST_SPLINE_BLOCKS = 6  # Spline blocks that the control wants among any 10 (NC Programming manual, BSPLINE)
FLOW = "program flow"  # Group whose words have checks of their own: ends of programs, stops
TRANSFORMATION_OFF = "TRAFOOF"  # Word of a SINUMERIK
Faults = list[tuple[str, str]]


def state_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check the state of the machine in every motion."""
    # Of a program whose table turns, what its axes do, and not what that is on the part.
    driven = nc if nc.machine is None else nc.machine
    return [
        *machine_state_checks(driven, config),
        _feed(nc, config),
        _known_positions(nc),
        _splines(nc),
        _polynomials(nc),
        _travel(driven, config),
        _beam(nc),
        _wire(nc),
        _turns(nc, TURN_SPACINGS * config.process.hatch_spacing_mm),
    ]


def _feed(nc: NCProgram, config: Config) -> Check:
    machine = config.machine
    rows = np.flatnonzero(nc.kind != RAPID)
    feed = nc.feed_mm_min[rows] / 60.0
    low, high = machine.feed_min_mm_s, machine.feed_max_mm_s
    bad = ~((feed >= low) & (feed <= high))
    faults = [
        (nc.where(int(row)), f"feed {value:g} mm/s is not within {low:g} .. {high:g} mm/s")
        for row, value in zip(rows[bad], feed[bad], strict=True)
    ]
    # A way at the feed of the beads is a bead that was not switched on, or lets the part cool longer than planned.
    idle = (nc.kind != RAPID) & ~nc.beam & ~nc.wire
    faults += row_faults(nc, idle, "a way with beam and wire off is driven at feed in place of a rapid")
    return count_check("feed", faults, f"every feed within {low:g} .. {high:g} mm/s, travel by rapids")


def _known_positions(nc: NCProgram) -> Check:
    unknown = (nc.kind != RAPID) & ~(np.isfinite(nc.start).all(axis=1) & np.isfinite(nc.end).all(axis=1))
    return count_check(
        "start of path", row_faults(nc, unknown, "feed motion from a position that is not known"), "every feed motion starts where the one before ended"
    )  # fmt: skip


def _splines(nc: NCProgram) -> Check:
    short = nc.events.named("BSPLINE") & (nc.events.value < LEAST_SPLINE_BLOCKS)
    what = f"a BSPLINE of {{value:g}} blocks: at least {LEAST_SPLINE_BLOCKS} are needed"
    good = f"every BSPLINE has at least {LEAST_SPLINE_BLOCKS} blocks"
    return count_check("spline blocks", event_faults(nc, (short, what)), good)


def _polynomials(nc: NCProgram) -> Check:
    """Parameter lengths of POLY blocks, where the header says that all are 1: a wrong one bends its span a little."""
    if not nc.header.get("POLY", "").startswith("PL=1 "):
        return count_check("polynomial blocks", [], "the header says nothing of PL in POLY blocks")
    what = "PL={value:g} in a POLY block, where the header says PL=1 in every one"
    faults = event_faults(nc, (nc.events.named("POLY"), what))
    return count_check("polynomial blocks", faults, "PL=1 in every POLY block")


def extremes(nc: NCProgram) -> tuple[Floats, Floats]:
    """Least and greatest X, Y, Z (B, 3) on each motion, exactly: roots of the derivative, quadrants of arcs."""
    low, high = np.fmin(nc.start, nc.end), np.fmax(nc.start, nc.end)
    with np.errstate(divide="ignore", invalid="ignore"):
        c1, c2, c3 = (nc.coefficients[:, :, k] for k in (1, 2, 3))
        root = np.sqrt(np.maximum(c2**2 - 3.0 * c3 * c1, 0.0))
        q = -(c2 + np.copysign(root, c2))
        for t in (q / (3.0 * c3), c1 / q):
            inside = (t > 0.0) & (t < 1.0)
            t = np.where(inside, t, 0.0)
            c0 = nc.coefficients[:, :, 0]
            value = np.where(inside, ((c3 * t + c2) * t + c1) * t + c0, nc.end[:, :2])
            low[:, :2], high[:, :2] = np.fmin(low[:, :2], value), np.fmax(high[:, :2], value)
    for row in np.flatnonzero(nc.kind == ARC):
        cx, cy, sweep = nc.arc[row]
        dx, dy = nc.start[row, 0] - cx, nc.start[row, 1] - cy
        radius, first = math.hypot(dx, dy), math.atan2(dy, dx)
        for k in range(4):
            quadrant = 0.5 * math.pi * k
            if (math.copysign(1.0, sweep) * (quadrant - first)) % (2.0 * math.pi) <= abs(sweep):
                point = (cx + radius * math.cos(quadrant), cy + radius * math.sin(quadrant))
                low[row, :2], high[row, :2] = np.fmin(low[row, :2], point), np.fmax(high[row, :2], point)
    return low, high


def far_away(nc: NCProgram, config: Config) -> Check | None:
    """Check ``travel`` of a program that goes farther beyond its limits than the machine is long; None for any other.

    A number that lost its point leads kilometres away. Nothing else can be said of such a program, and what follows its path
    would take hours and all memory.
    """
    machine = config.machine
    longest = float(np.subtract(machine.travel_max_mm, machine.travel_min_mm).max())
    for each in (nc if nc.machine is None else nc.machine, nc.preheating):
        if each is None or not len(each):
            continue
        worst = _over(each, config).max(axis=1)
        row = int(np.argmax(worst))
        if worst[row] > longest:
            text = f"{worst[row]:g} mm beyond the limits: that is over the machine's travel of {longest:g} mm, and nothing else is judged"
            return Check("travel", False, float(worst[row]), 0.0, "mm", each.where(row), text)
    return None


def _over(nc: NCProgram, config: Config) -> Floats:
    """How far each motion goes beyond the limits of each axis (B, 3), mm; negative within them."""
    low, high = extremes(nc)
    machine = config.machine
    over = np.fmax(np.array(machine.travel_min_mm) - low, high - np.array(machine.travel_max_mm))
    return np.asarray(np.nan_to_num(over, nan=-np.inf, posinf=np.inf), np.float64)


def _travel(nc: NCProgram, config: Config) -> Check:
    over = _over(nc, config)
    rows = np.arange(len(nc))
    worst = over.max(axis=1)
    found = worst_check("travel", nc, rows, worst, LIMIT_ROUNDING_MM, "mm", "beyond the travel limits")
    axis = "XYZ"[int(np.argmax(over[int(np.argmax(worst))]))] if len(nc) else ""
    margin = -found.value if found.passed else found.value
    text = f"{margin:g} mm of {axis} {'left' if found.passed else 'beyond the limits'}, on the true curve"
    return Check("travel", found.passed, found.value, 0.0, "mm", found.where, text)


def _beam(nc: NCProgram) -> Check:
    faults = row_faults(nc, nc.beam & (nc.kind == RAPID), "beam is on during a rapid motion")
    marked = (nc.ring >= 0) | (nc.island >= 0)
    faults += row_faults(nc, ~nc.beam & (nc.kind != RAPID) & marked, "beam is off along a deposit")
    faults += switch_faults(nc, Kind.BEAM_ON, Kind.BEAM_OFF, "beam")
    return count_check("beam", faults, "off in every rapid and layer change, each on has its off")


def _wire(nc: NCProgram) -> Check:
    faults = row_faults(nc, nc.wire & ~nc.beam, "wire runs while the beam is off")
    faults += row_faults(nc, nc.wire & (nc.kind == RAPID), "wire runs during a rapid motion")
    marked = (nc.ring >= 0) | (nc.island >= 0)
    faults += row_faults(nc, ~nc.wire & (nc.kind != RAPID) & marked, "wire stands along a deposit")
    faults += switch_faults(nc, Kind.WIRE_START, Kind.WIRE_STOP, "wire")
    off = (nc.events.kind == Kind.BEAM_OFF) & nc.events.wire[:-1]
    faults += event_faults(nc, (off, "beam goes off before the wire stops"))
    return count_check("wire", faults, "runs under the beam alone, stops before it")


def _turns(nc: NCProgram, limit_mm: float) -> Check:
    rows = np.flatnonzero(nc.turn & nc.deposit)
    # Positions are rounded to the program's decimals; six is the coarsest that matters here.
    return worst_check(
        "turns", nc, rows, nc.lengths[rows], limit_mm + 1e-6, "mm", "longest turn between hatch lines"
    )


# -- state of the machine ------------------------------------------------------------------------------


def machine_state_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check modes and smoothing at every motion, start state, order of events, and safe end."""
    modes, paths = _broken_groups(nc, config)
    modes += _offset_lost(nc, config)
    modes += _uneven_entries(nc, list(wanted_words(nc.dialect, config.machine).values()))
    return [
        _modes(nc, config, modes),
        _smoothing(nc, config, paths),
        count_check(
            "start state", _start(nc, config), "modes, beam and wire off, values, before the first motion"
        ),
        count_check("order of events", order_faults(nc, config), "values, then beam, then wire; off in turn"),
        count_check("safe end", _end(nc, config), "beam and wire off, values 0, retracted and parked"),
    ]


# -- modal groups --------------------------------------------------------------------------------------


def _broken_groups(nc: NCProgram, config: Config) -> tuple[Faults, Faults]:
    """Words that set a group to another than the one wanted, or change one that was set; those of the path apart.

    The main program sets every group itself, before its first motion or call.
    """
    wanted = wanted_words(nc.dialect, config.machine)
    faults: dict[bool, Faults] = {False: [], True: []}
    state: dict[str, str] = {}
    places: dict[str, str] = {}
    begun = False
    for i, name in enumerate([*nc.events.name, ""]):
        moved = not name or nc.events.row[i] > 0 or nc.events.kind[i] == Kind.CALL
        if moved and not begun:
            begun = True
            for lacking, fault in _missing(nc, wanted, places):
                faults[lacking.path].append(fault)
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
    """Motions whose work offset went with a transformation that was switched off, and was not chosen again behind it.

    Source: Siemens, Job Planning, constraints when selecting a transformation: the control deselects the frame in force.
    """
    e, offset = nc.events, wanted_words(nc.dialect, config.machine).get("work offset")
    off = e.named(TRANSFORMATION_OFF)
    chosen = np.append(0, np.cumsum(off | e.named(offset or "")))
    moved = np.searchsorted(e.row, e.row, side="right")
    lost = off & (e.row < len(nc)) & (chosen[moved] == chosen[1:])
    what = f"TRAFOOF takes {offset} back, which no block behind it chooses again"
    return event_faults(nc, (lost, what))


def modes_of_scans(scans: NCProgram, config: Config) -> Faults:
    """Words in preheating scans that are other than those that hold at every motion of the program, and stops.

    A scan may leave a word out, since the program around it has set it. In another work offset it would heat beside the part, and so
    would be what comes after it.
    """
    e, wanted = scans.events, wanted_words(scans.dialect, config.machine)
    groups = {name: group for name in set(e.name) if (group := group_of(scans.dialect, name))}
    held = {
        name: wanted.get(group.name, "as the control has it")
        for name, group in groups.items()
        if group.name != FLOW and wanted.get(group.name) != name
    }
    stops, (other, what) = e.kind == Kind.STOP, _other_tolerance(scans, config)
    return _offset_lost(scans, config) + event_faults(
        scans,
        (stops, "{name} stops while it preheats"),
        (other, what),
        (
            e.named(*held) & ~stops & ~other,
            lambda i: f"{e.name[i]}: {groups[e.name[i]].name} is to be {held[e.name[i]]} at every motion",
        ),
    )


def _other_tolerance(nc: NCProgram, config: Config) -> tuple[Bools, str]:
    """Tolerances that are another than the one set, and what to say of them."""
    limit, e = config.machine.smoothing_tolerance_mm, nc.events
    other = ~(np.abs(e.value - limit) <= VALUE_SHARE * limit)
    return (e.kind == Kind.TOLERANCE) & other, f"{{name}} {{value:g}} mm in place of {limit:g} mm"


def _missing(
    nc: NCProgram, wanted: dict[str, str], places: dict[str, str]
) -> Iterator[tuple[Group, tuple[str, str]]]:
    """Groups that are not set at the beginning, each at the place where the group before it is."""
    where = next(iter(places.values()), nc.beginning)
    for name, word in wanted.items():
        if name in places:
            where = places[name]
        else:
            what = f"{word} is not set by the program's own first blocks"
            yield group_of(nc.dialect, word) or Group(name, (word,)), (where, what)


def _modes(nc: NCProgram, config: Config, faults: Faults) -> Check:
    words = [
        word
        for word in wanted_words(nc.dialect, config.machine).values()
        if not getattr(group_of(nc.dialect, word), "path", False)
    ]
    return count_check("modes", faults, f"{' '.join(words)} at every motion")


def _smoothing(nc: NCProgram, config: Config, faults: Faults) -> Check:
    """How the control may leave the path: its words at every motion, and every tolerance within the one set."""
    limit = config.machine.smoothing_tolerance_mm
    if not control(nc.dialect).tolerance_word:
        known = set(wanted_words(nc.dialect, config.machine).values())
        return count_check(
            "smoothing", [*faults, *_own_smoothing(nc, known)], "no word for a tolerance: the control's own"
        )
    tolerances = nc.events.kind == Kind.TOLERANCE
    value = max(nc.events.value[tolerances].tolist(), default=math.inf)
    faults = [*faults, *_tolerances(nc, config, tolerances)]
    words = [w for w in wanted_words(nc.dialect, config.machine).values() if _is_path(nc, w)]
    name = control(nc.dialect).tolerance_word
    found = count_check("smoothing", faults, f"{' '.join(words)}{name}{value:g} at every motion")
    return replace(found, value=value, limit=limit, unit="mm")


def _own_smoothing(nc: NCProgram, wanted: set[str]) -> Faults:
    """Words of the path in a program whose profile knows none: what tolerance they leave is not known."""
    own = {name for name in set(nc.events.name) if _is_path(nc, name) and name not in wanted}
    what = "{name}: the profile of this control sets no smoothing, and knows none of its tolerances"
    return event_faults(nc, (nc.events.named("CTOL", *own), what))


def _is_path(nc: NCProgram, word: str) -> bool:
    group = group_of(nc.dialect, word)
    return group is not None and group.path


def _tolerances(nc: NCProgram, config: Config, tolerances: Bools) -> Faults:
    e, smoothing, of = nc.events, config.machine.smoothing, control(nc.dialect)
    other, what = _other_tolerance(nc, config)
    alone = e.named("ADIS") & ~other & ("G641" not in smoothing)
    faults = event_faults(nc, (other, what), (alone, "ADIS belongs to G641, which the profile does not set"))
    if not (e.row[tolerances][:1] == 0).any():
        faults.append((nc.beginning, "no tolerance of the path is set before the first motion"))
    keeps = of.keeps_tolerance
    if keeps and not set(keeps) & set(smoothing):
        said = " ".join(smoothing) or "nothing"
        what = f"machine.smoothing is {said}, without {', '.join(keeps)}: no other word keeps the path within the tolerance"
        faults.append((nc.beginning, what))
    # A tolerance of its own stands in the same block.
    block = np.cumsum(np.append(True, (np.diff(e.file) != 0) | (np.diff(e.line) != 0)))[: len(e)]
    bare = e.named(of.smoothing_needs_tolerance) & ~np.isin(block, block[e.named("CTOL")])
    what = f"{{name}} without {of.tolerance_word}: the path may leave its corners by any distance"
    return faults + event_faults(nc, (bare, what))


def _uneven_entries(nc: NCProgram, wanted: list[str]) -> Faults:
    """Layers that lack a mode or value with which others begin: the control could not enter the program there."""
    begins = _begun(nc, _entries(nc, set(wanted)))
    found = Counter(name for names in begins for name in names)
    usual = [name for name in (*wanted, *BEAM_VALUES) if 2 * found[name] > len(begins)]
    faults = []
    for names in begins:
        where = next(iter(names.values()))
        for name in usual:
            if name not in names:
                faults.append((where, f"{name} is not set where the layer begins, as it is in the others"))
            where = names.get(name, where)
    return faults


def _begun(nc: NCProgram, runs: list[tuple[int, int, dict[str, str]]]) -> list[dict[str, str]]:
    """The rows of modes with which layers begin, without single words that are said again later on.

    These are rows with fewer than half of the words of the fullest one of their layer: of their file, where each layer has one.
    """
    called = bool((nc.events.kind == Kind.CALL).any())
    last = len(nc) - 1
    of_layer = [
        file if called else int(nc.layer[min(row, last)]) if k and last >= 0 else -1
        for k, (file, row, _) in enumerate(runs)
    ]
    fullest: dict[int, int] = {}
    for layer, (_, _, names) in zip(of_layer, runs, strict=True):
        fullest[layer] = max(fullest.get(layer, 0), len(names))
    return [
        names for layer, (_, _, names) in zip(of_layer, runs, strict=True) if 2 * len(names) >= fullest[layer]
    ]


def _entries(nc: NCProgram, wanted: set[str]) -> list[tuple[int, int, dict[str, str]]]:
    """File, row of the next motion, and names and places of the modes and values with which the program and its layers begin.

    A row of blocks that set modes ends with the next motion, and where a mode follows a switch or a value: in one file
    the first blocks of the program are followed by those of its first layer.
    """
    e = nc.events
    mode, value = e.named(*wanted), e.named(*BEAM_VALUES)
    before, switched = e.latest(mode)[:-1], e.latest(value | e.named(*SWITCHES))[:-1]
    here = (before >= 0) & (e.file == e.file[before]) & (e.row == e.row[before])
    begins = mode & ~(here & (switched < before))
    runs: list[tuple[int, int, dict[str, str]]] = []
    for i in np.flatnonzero(mode | (value & here)).tolist():
        if begins[i]:
            runs.append((int(e.file[i]), int(e.row[i]), {}))
        runs[-1][2].setdefault(e.name[i], nc.where_event(i))
    return runs


# -- start and end -------------------------------------------------------------------------------------


def _start(nc: NCProgram, config: Config) -> Faults:
    """What the first blocks of the program lack of a start state that depends on nothing before it."""
    before = set(nc.events.chosen(nc.events.row == 0).name)
    set_beam = " ".join(templates_of(config.machine, nc.dialect)["set_beam"])
    wanted = {"beam_off": "the beam is not switched off", "wire_stop": "the wire is not stopped"}
    wanted |= {name: f"{name} is not set" for name in BEAM_VALUES if f"{{{name}" in set_beam}
    return [
        (nc.beginning, f"{what} before the first motion")
        for name, what in wanted.items()
        if name not in before
    ]


def _end(nc: NCProgram, config: Config) -> Faults:
    """What the last blocks lack: beam and wire off, values 0, the tool retracted and parked."""
    last = int(np.flatnonzero(nc.deposit)[-1]) if nc.deposit.any() else -1
    if last < 0:
        return []
    main = nc.files[0]
    where = f"{main.name}:{main.end_line or main.line_count}"
    late = nc.events.chosen(nc.events.row > last)
    after = dict(zip(late.name, late.value.tolist(), strict=True))
    templates = templates_of(config.machine, nc.dialect)
    settable = " ".join(line for name in ("set_beam", "set_power", "set_wire") for line in templates[name])
    known = {name for name in nc.events.name if f"{{{name}" in settable}
    faults = [
        (where, f"{name} does not come after the last bead")
        for name in ("wire_stop", "beam_off")
        if name not in after
    ]
    faults += [
        (where, f"{name} is not 0 at the end")
        for name in (*BEAM_VALUES, "wire_mm_s")
        if name in known and after.get(name) != 0.0
    ]
    x, y, z = nc.end[-1]
    least = safe_end_mm(float(np.nanmax(nc.end[nc.deposit, 2])), config)
    if not z >= least - PLACE_MM:
        faults.append((nc.where(len(nc) - 1), f"ends at Z {z:g} mm, {least:g} mm is over all that stands"))
    if not math.dist((x, y), config.machine.park_position_mm) <= 2.0 * PLACE_MM:
        place = "X {:g} Y {:g}".format(*config.machine.park_position_mm)
        faults.append((nc.where(len(nc) - 1), f"ends at X {x:g} Y {y:g}, to be parked at {place}"))
    return faults
